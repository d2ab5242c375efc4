"""An episode as an animated GIF."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.error import DependencyNotInstalled
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image
from stable_baselines3.common.vec_env import VecEnv

from sb3_adaptive_q.plots.grid_maps import find_map, taxi_layer
from sb3_adaptive_q.plots.map_drawing import MapDrawing, map_size
from sb3_adaptive_q.plots.sources import read_table
from sb3_adaptive_q.plots.style import STYLE, PlotFigure
from sb3_adaptive_q.state_index import make_state_index

#: Seconds for which the last picture stays
_LAST = 1.5
#: Pictures per second, which a GIF file counts in hundredths of a second
SLOWEST, FASTEST = 0.01, 100
_DOTS_PER_INCH = 100


def animate(
    model: Any,
    env: gym.Env[Any, Any] | str,
    path: str | Path = "episode.gif",
    max_steps: int = 200,
    deterministic: bool = True,
    seed: int | None = None,
    frames_per_second: float = 4.0,
) -> Path:
    """
    Play an episode and keep it as an animated GIF: as the environment draws itself where its ``render_mode`` is
    ``"rgb_array"``, otherwise on its map, over the values and arrows of :func:`plot_policy`.

    :param model: the model that plays
    :param env: an environment of its own, not the one that the model learns from, or the id of one
    :param path: the file to write
    :param max_steps: after how many steps to end an episode that goes on
    :param deterministic: whether to leave exploration out
    :param seed: of the environment
    :param frames_per_second: how fast to play
    :return: the path of the file
    :raises ValueError: if the environment draws no pictures and has no map, or an argument does not fit
    :raises ModuleNotFoundError: if the environment needs pygame to draw itself, and it is not installed
    """
    path = Path(path)
    if path.suffix != ".gif":
        raise ValueError(f"`path` must end in .gif, but got {path}.")
    if isinstance(env, VecEnv):
        raise ValueError("`animate` plays in a single environment: please give a gymnasium environment, or its id.")
    if not (max_steps >= 1 and SLOWEST <= frames_per_second <= FASTEST):
        raise ValueError(
            f"`max_steps` must be at least 1, and `frames_per_second` from {SLOWEST} to {FASTEST}, but got {max_steps} and "
            f"{frames_per_second}."
        )
    if not path.parent.is_dir():
        raise ValueError(f"`path` must lie in a folder that exists, but there is no {path.parent}.")
    playground = _make(env) if isinstance(env, str) else env
    try:
        spaces = playground.observation_space, playground.action_space
        if hasattr(model, "observation_space") and spaces != (model.observation_space, model.action_space):
            raise ValueError(
                f"`env` must have the spaces of the model, {model.observation_space} and {model.action_space}, but has "
                f"{spaces[0]} and {spaces[1]}: please wrap it as for learning."
            )
        images = [Image.fromarray(frame) for frame in _play(model, playground, max_steps, deterministic, seed)]
    except DependencyNotInstalled as error:
        raise ModuleNotFoundError(
            "pygame is missing, with which this environment draws itself: please install it with "
            "pip install 'gymnasium[classic-control,toy-text]'."
        ) from error
    finally:
        if playground is not env:
            playground.close()
    pause = round(1000 / frames_per_second)
    durations = [pause] * (len(images) - 1) + [pause + round(1000 * _LAST)]
    images[0].save(path, save_all=True, append_images=images[1:], duration=durations, loop=0, optimize=True)
    return path


def _make(env_id: str) -> gym.Env[Any, Any]:
    env = gym.make(env_id)
    draws_itself = "rgb_array" in env.metadata.get("render_modes", [])
    return gym.make(env_id, render_mode="rgb_array") if draws_itself else env


def _play(model: Any, env: gym.Env[Any, Any], max_steps: int, deterministic: bool, seed: int | None) -> Iterator[np.ndarray]:
    """The pictures of an episode, before its first step and after every step, each of shape (height, width, 3)."""
    draw = _choose_renderer(model, env)
    observation, _ = env.reset(seed=seed)
    total = 0.0
    yield draw(observation, "start")
    for step in range(1, max_steps + 1):
        action, _ = model.predict(observation, deterministic=deterministic)
        observation, reward, terminated, truncated, _ = env.step(action)
        total += float(reward)
        yield draw(observation, f"step {step}, return {total:g}")
        if terminated or truncated:
            break


def _choose_renderer(model: Any, env: gym.Env[Any, Any]) -> Callable[[Any, str], np.ndarray]:
    if env.render_mode == "rgb_array":
        return lambda _observation, _caption: np.asarray(env.render())
    if find_map(env, len(read_table(model))) is None:
        raise ValueError(
            f"{type(env.unwrapped).__name__} has no map: please make it with render_mode='rgb_array', to draw itself; "
            f"got render_mode={env.render_mode!r}."
        )
    return _MapRenderer(model, env).draw


class _MapRenderer:
    """Moves a mark over the map. Each map is drawn once: Taxi has one for every passenger and destination."""

    def __init__(self, model: Any, env: gym.Env[Any, Any]) -> None:
        self.table = read_table(model)
        self.env = env
        self.index = make_state_index(env.observation_space)
        self.drawings: dict[str, MapDrawing] = {}
        self.drawing: MapDrawing | None = None

    def draw(self, observation: Any, caption: str) -> np.ndarray:
        """
        :param observation: where the agent is
        :param caption: what to write above the map
        :return: the picture, of shape (height, width, 3)
        """
        state = self.index.of(observation)
        with rc_context(STYLE):
            self._turn_to(state)
            drawing = self.drawing
            assert drawing is not None
            cell = drawing.grid.cell_of(state)
            if cell is not None:
                drawing.move_agent(*cell)
            title = "\n".join(part for part in (caption, drawing.grid.title) if part)
            drawing.ax.set_title(title, loc="left", fontsize="medium")
            canvas = FigureCanvasAgg(drawing.ax.get_figure(root=True))
            canvas.draw()
        return np.asarray(canvas.buffer_rgba())[:, :, :3].copy()

    def _turn_to(self, state: int) -> None:
        layer = taxi_layer(self.env, state)
        if self.drawing is not None and layer and layer["passenger"] == layer["destination"]:
            return  # delivered, which no map shows
        key = str(layer)
        if key not in self.drawings:
            self.drawings[key] = self._new_drawing(layer)
        self.drawing = self.drawings[key]

    def _new_drawing(self, layer: dict[str, str]) -> MapDrawing:
        grid = find_map(self.env, len(self.table), **layer)
        assert grid is not None
        figure = PlotFigure(figsize=map_size(grid), dpi=_DOTS_PER_INCH, layout="constrained")
        drawing = MapDrawing(figure.subplots(), grid, None)
        drawing.draw_values(self.table.max(axis=1), self.table)
        return drawing
