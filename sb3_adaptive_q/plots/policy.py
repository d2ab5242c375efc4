"""What was learned, in one picture."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from stable_baselines3.common.vec_env import VecEnv

from sb3_adaptive_q.plots.grid_maps import GridMap, find_map
from sb3_adaptive_q.plots.heat_maps import Plane, draw_plane, draw_table
from sb3_adaptive_q.plots.map_drawing import MapDrawing, map_size
from sb3_adaptive_q.plots.numbers import is_undecided
from sb3_adaptive_q.plots.sources import Quantity, find_components, find_env, read_quantity, read_table
from sb3_adaptive_q.plots.style import STYLE, PlotFigure, new_axes

#: How much larger a cell is that holds four numbers
_FOUR_NUMBERS = 1.45
_HEAT_MAP = (6.4, 4.4)


class Picture(NamedTuple):
    """
    A picture that is ready to be drawn.

    :param size: width and height of its figure in inches
    :param draw: draws it on axes
    """

    size: tuple[float, float]
    draw: Callable[[Axes], None]


def plot_policy(
    model: Any,
    env: gym.Env[Any, Any] | VecEnv | str | None = None,
    ax: Axes | None = None,
    what: str = "value",
    passenger: str | None = None,
    destination: str | None = None,
    dimensions: tuple[int, int] | None = None,
    at: Mapping[int, int] | None = None,
    limits: tuple[float, float] | None = None,
) -> Axes:
    """
    Draw the table of a model, or what its step size remembers.

    - Where the environment has a map (FrozenLake, CliffWalking, Taxi, or your own: see :mod:`sb3_adaptive_q.plots.grid_maps`):
      the value of every cell and an arrow for its greedy action; for ``"q"``, and memory of every state and action, four
      triangles a cell where the actions are four directions.
    - Where observations have two components or more, as with :class:`sb3_adaptive_q.wrappers.DiscretizeObservation`: two of
      them, with the number of the greedy action. A mean is taken over the states that were learned: those whose actions differ
      in value.
    - Otherwise: a heat map, states along x and actions along y. Dots mark the greedy actions.

    :param model: a model, or a table of shape (n_states, n_actions)
    :param env: its environment, or the id of one; ``None`` for the one that the model learns from
    :param ax: the axes to draw on; ``None`` for a new figure, whose PDF embeds TrueType fonts
    :param what: ``"value"``; ``"q"`` for every action; ``"memory:<name>"`` for an array of the step size, such as
        ``"memory:visits"``
    :param passenger: where Taxi's passenger is: ``"R"``, ``"G"``, ``"Y"``, ``"B"`` or ``"taxi"``; ``None`` for ``"R"``
    :param destination: where they want to go: one of the first four; ``None`` for the first other than the passenger's
    :param dimensions: the components of the observation along x and y, counted from 0; ``None`` for the first two
    :param at: the cells at which other components are held, by the component's number; over the rest the mean is taken
    :param limits: the values that the lightest and the darkest colour stand for; ``None`` for the least and the largest
    :return: the axes
    :raises ValueError: if there is nothing to draw under ``what``, or another argument does not fit the environment
    """
    picture = choose_picture(model, env, what, passenger, destination, dimensions, at, limits)
    with rc_context(STYLE):
        ax = new_axes(picture.size) if ax is None else ax
        picture.draw(ax)
    return ax


def choose_picture(
    model: Any,
    env: gym.Env[Any, Any] | VecEnv | str | None = None,
    what: str = "value",
    passenger: str | None = None,
    destination: str | None = None,
    dimensions: tuple[int, int] | None = None,
    at: Mapping[int, int] | None = None,
    limits: tuple[float, float] | None = None,
) -> Picture:
    """
    :param model: as in :func:`plot_policy`, like all the others
    :return: the picture that :func:`plot_policy` draws
    :raises ValueError: as there
    """
    quantity, table = read_quantity(model, what), read_table(model)
    found = find_env(model, env)
    first_action = int(getattr(getattr(model, "action_space", None), "start", 0))
    grid = find_map(found, len(table), passenger, destination)
    if grid is not None and dimensions is None and at is None:
        picture = _map_picture(grid, quantity, table, what, limits)
        if picture is not None:
            return picture
    components = find_components(model, found, len(table))
    is_plane = dimensions is not None or at is not None or (len(components.sizes) > 1 and what != "q")
    if not is_plane:
        shown = read_quantity(model, "q") if what == "value" else quantity
        first_state = components.starts[0] if len(components.starts) == 1 else 0
        draw = partial(draw_table, quantity=shown, limits=limits, first_state=first_state, first_action=first_action)
        return Picture(_table_size(shown.values), draw)
    has_actions = what in ("value", "q")
    is_known = ~is_undecided(table) if has_actions else np.ones(len(table), dtype=bool)
    plane = Plane(table if has_actions else quantity.values, components, dimensions or (0, 1), at or {}, is_known)
    label = read_quantity(model, "value").label if has_actions else quantity.label
    if not has_actions and quantity.values.shape[1] > 1:
        label += ", mean over the actions"
    draw = partial(
        draw_plane, plane=plane, label=label, limits=limits, has_actions=has_actions, first_action=first_action
    )  # fmt: skip
    return Picture(_HEAT_MAP, draw)


def draw_figure(model: Any, dpi: int, **choice: Any) -> PlotFigure:
    """
    Draw what :func:`plot_policy` draws without pyplot, so that no window opens and other threads may draw too.

    :param model: as in :func:`plot_policy`
    :param dpi: dots per inch
    :param choice: further arguments of :func:`plot_policy`
    :return: the figure
    :raises ValueError: as in :func:`plot_policy`
    """
    picture = choose_picture(model, **choice)
    with rc_context(STYLE):
        figure = PlotFigure(figsize=picture.size, dpi=dpi, layout="constrained")
        picture.draw(figure.subplots())
    return figure


def _map_picture(
    grid: GridMap, quantity: Quantity, table: np.ndarray, what: str, limits: tuple[float, float] | None
) -> Picture | None:
    """The picture on the map; None where a cell would need more numbers than it can hold."""
    is_single = quantity.values.shape[1] == 1
    if not is_single and not grid.has_four_directions():
        return None

    def draw(ax: Axes) -> None:
        drawing = MapDrawing(ax, grid, limits)
        if is_single:
            drawing.draw_values(quantity.values[:, 0], table if what == "value" else None)
        else:
            drawing.draw_numbers_of_actions(quantity.values, what == "q")
        ax.set_title("\n".join(part for part in (quantity.label, grid.title) if part), loc="left", fontsize="medium")

    return Picture(map_size(grid, 1.0 if is_single else _FOUR_NUMBERS), draw)


def _table_size(values: np.ndarray) -> tuple[float, float]:
    n_states, n_columns = values.shape
    return min(max(4.0, 0.55 * n_states + 2.0), 9.0), min(max(1.6, 0.5 * n_columns + 1.2), 6.0)
