"""The paper's Figures 6 to 13, and what it has no figure of: all methods together, and the lake with what was learned."""

from collections.abc import Iterator
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.toy_text.frozen_lake import FrozenLakeEnv
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sb3_adaptive_q import METHODS
from sb3_adaptive_q.experiments.drawing import BLUE, GREEN, GREY, INK, line_style, tidy
from sb3_adaptive_q.experiments.environments import make_env
from sb3_adaptive_q.experiments.episodes import WINDOW
from sb3_adaptive_q.experiments.paper.results import Results, Series, trailing_mean
from sb3_adaptive_q.experiments.paper.settings import PAPER_METHODS, PAPER_SYSTEMS, title_of
from sb3_adaptive_q.experiments.paper.tables import optimal_values
from sb3_adaptive_q.experiments.text import file_name

ARROWS = ((-1, 0), (0, 1), (1, 0), (0, -1))  # left, down, right, up as (x, y), y pointing down


def make_figures(results: Results, gamma: float) -> Iterator[tuple[str, str, str, Figure]]:
    """
    :param results: of a study
    :param gamma: the discount factor
    :return: the figures with their system, the name of their file and a caption, one at a time: each holds much memory once
        it was drawn
    """
    for system in results.systems:
        title = title_of(system)
        yield system, f"all_methods_{file_name(system)}", f"{title}: all methods", all_methods_figure(results, system)
        letters = lake_map(system)
        if letters is not None:
            figure = policies_figure(results, system, letters, optimal_values(system, gamma))
            yield system, f"policies_{file_name(system)}", f"{title}: greedy actions and values", figure
        yield from _pair_figures(results, system)


def _pair_figures(results: Results, system: str) -> Iterator[tuple[str, str, str, Figure]]:
    """Two methods a figure: the paper's pairs under the paper's numbers, then the others."""
    methods = results.methods(system)
    pairs = [[method for method in PAPER_METHODS[i : i + 2] if method in methods] for i in range(0, 8, 2)]
    others = [method for method in methods if method not in PAPER_METHODS]
    for i, pair in enumerate([*pairs, *(others[j : j + 2] for j in range(0, len(others), 2))]):
        if pair:
            of_paper = system in PAPER_SYSTEMS and i < len(pairs)
            number = PAPER_SYSTEMS[system].first_figure + i if of_paper else 0
            name = f"figure_{number:02d}" if of_paper else f"methods_{2 * i + 1}_{2 * i + 2}_{file_name(system)}"
            caption = f"{'the like of ' if of_paper else ''}{f'Figure {number}: ' if of_paper else ''}{' and '.join(pair)}"
            yield system, name, f"{title_of(system)}, {caption}", pair_figure(results, system, pair)


def pair_figure(results: Results, system: str, methods: list[str]) -> Figure:
    """
    One of Figures 6 to 13: a row for each method, its reward on the left and its μ on the right.

    :param results: of a study
    :param system: one of its systems
    :param methods: which of its methods
    :return: the figure
    """
    figure = Figure(figsize=(9.0, 2.9 * len(methods)), layout="constrained")
    axes = figure.subplots(len(methods), 2, squeeze=False, sharex=True, sharey="col")
    for (left, right), method in zip(axes, methods, strict=True):
        _draw_reward(left, results.series[system, method], system)
        _draw_rate(right, results.series[system, method])
        left.set_title(f"{method}: return", loc="left")
        number = PAPER_METHODS.index(method) + 1 if method in PAPER_METHODS else 0
        right.set_title(f"{method}: {METHODS[number].formula if number else 'μ'}", loc="left", fontsize="small")
    for axis in axes[-1]:
        axis.set_xlabel("episode")
    for axis in axes[0]:
        axis.legend(loc="upper left", frameon=False)
    figure.suptitle(title_of(system))
    return figure


def _draw_reward(axis: Axes, series: Series, system: str) -> None:
    _draw_with_mean(axis, series.returns, BLUE, GREEN)
    axis.set_ylabel("return per episode")
    if system in PAPER_SYSTEMS:
        limit = PAPER_SYSTEMS[system].limit
        axis.set_ylim(-0.03 * limit, 1.05 * limit)


def _draw_rate(axis: Axes, series: Series) -> None:
    _draw_with_mean(axis, series.mu, GREY, INK)
    axis.set_ylabel("μ at the end of the episode")
    # The axis is shared: the larger rate decides, and the legend needs room above it
    axis.set_ylim(0.0, max(axis.get_ylim()[1], 1.35 * float(series.mu.max())))


def _draw_with_mean(axis: Axes, values: np.ndarray, color: str, mean_color: str) -> None:
    episodes = np.arange(1, len(values) + 1)
    axis.plot(episodes, values, color=color, linewidth=0.4, rasterized=True, label="mean over the runs")
    label = f"the same, mean of the last {WINDOW} episodes"
    axis.plot(episodes, trailing_mean(values), color=mean_color, linewidth=1.8, rasterized=True, label=label)
    tidy(axis)


def all_methods_figure(results: Results, system: str) -> Figure:
    """
    The 100-episode means of all methods on one axis, with bootstrap intervals over the runs, and where they end.

    :param results: of a study
    :param system: one of its systems
    :return: the figure
    """
    methods = results.methods(system)
    runs = results.runs[results.runs["system"] == system].groupby("method").size()
    figure = Figure(figsize=(10.0, max(5.0, 0.25 * len(methods))), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(3, 1))
    for i, method in enumerate(methods):
        series, style = results.series[system, method], line_style(i)
        x, y = series.curve_episodes, series.curve
        left.plot(x, y, linewidth=1.4, label=method, **style)
        left.fill_between(x, series.low, series.high, color=style["color"], alpha=0.15, linewidth=0)
        filling = style["color"] if style["linestyle"] == "-" else "white"
        margins = np.array([[y[-1] - series.low[-1]], [series.high[-1] - y[-1]]])
        right.errorbar(y[-1], i, xerr=margins, color=style["color"], marker="o", markerfacecolor=filling, capsize=3)
    left.set(xlabel="episode", ylabel=f"mean return of the last {WINDOW} episodes")
    title = f"{title_of(system)}: mean of {runs.min()} runs, shaded: 95 % bootstrap interval"
    left.set_title(title, loc="left", fontsize="medium")
    left.legend(loc="upper left", frameon=False, handlelength=3.0)
    right.set(xlabel=f"mean return of the last {WINDOW} episodes\n(after training)", yticks=range(len(methods)))
    right.set_yticklabels(methods)
    right.invert_yaxis()
    for axis in (left, right):
        tidy(axis)
    return figure


def lake_map(system: str) -> np.ndarray | None:
    """
    :param system: the name of an environment
    :return: the letters of its map, of shape (rows, columns), if it is a registered Frozen Lake
    """
    env: Any = make_env(system).unwrapped
    return np.array(env.desc).astype(str) if isinstance(env, FrozenLakeEnv) and system in gym.registry else None


def policies_figure(results: Results, system: str, letters: np.ndarray, optimal: np.ndarray) -> Figure:
    """
    A Frozen Lake with the values and the greedy actions of every method's first run, beside the optimal ones.

    :param results: of a study
    :param system: one of its systems
    :param letters: its map
    :param optimal: Q*
    :return: the figure
    """
    tables = {"optimal (value iteration)": optimal}
    tables |= {f"{method}, run 0": results.q_tables[system, method] for method in results.methods(system)}
    columns = min(3, len(tables))
    rows = -(-len(tables) // columns)
    side = max(3.0, 0.62 * letters.shape[1])
    figure = Figure(figsize=(side * columns, side * rows + 0.5), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis in axes[len(tables) :]:
        axis.set_axis_off()
    for axis, (title, table) in zip(axes, tables.items(), strict=False):
        image = _draw_lake(axis, letters, table, max(float(optimal.max()), 1e-9))
        axis.set_title(title, loc="left", fontsize="medium")
    figure.colorbar(image, ax=list(axes), label="max Q(s, ·)", shrink=0.6, aspect=30)
    figure.suptitle(f"{title_of(system)}: greedy actions and values")
    return figure


def _draw_lake(axis: Axes, letters: np.ndarray, table: np.ndarray, largest: float) -> Any:
    values = table.max(axis=1).reshape(letters.shape)
    image = axis.imshow(values, cmap="cividis", vmin=0.0, vmax=largest)
    for (row, column), letter in np.ndenumerate(letters):
        color = "black" if values[row, column] > 0.55 * largest else "white"
        if letter in "HG":
            axis.text(column, row, letter, ha="center", va="center", color=color, fontweight="bold", fontsize="large")
            continue
        axis.text(column, row + 0.36, f"{values[row, column]:.2f}", ha="center", va="center", color=color, fontsize="x-small")
        _draw_greedy_action(axis, row, column, table[row * letters.shape[1] + column], color)
    axis.set_xticks(np.arange(0.5, letters.shape[1] - 1), [])
    axis.set_yticks(np.arange(0.5, letters.shape[0] - 1), [])
    axis.tick_params(length=0)
    axis.grid(color="white", linewidth=0.8)
    return image


def _draw_greedy_action(axis: Axes, row: int, column: int, values: np.ndarray, color: str) -> None:
    if np.all(values == values[0]):  # nothing learned here
        return
    x, y = ARROWS[int(values.argmax())]
    start = (column - 0.22 * x, row - 0.1 - 0.22 * y)
    end = (column + 0.22 * x, row - 0.1 + 0.22 * y)
    axis.annotate("", xy=end, xytext=start, arrowprops={"arrowstyle": "-|>", "color": color, "linewidth": 1.4})
