"""The paper's Figures 6 to 13, and what it has no figure of: all methods together, and the lake with what was learned."""

from collections.abc import Iterator

import gymnasium as gym
import numpy as np
from gymnasium.envs.toy_text.frozen_lake import FrozenLakeEnv
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sb3_adaptive_q import METHODS
from sb3_adaptive_q.experiments.drawing import line_style
from sb3_adaptive_q.experiments.environments import make_env
from sb3_adaptive_q.experiments.episodes import WINDOW
from sb3_adaptive_q.experiments.paper.results import Results, Series, trailing_mean
from sb3_adaptive_q.experiments.paper.settings import PAPER_METHODS, PAPER_SYSTEMS, title_of
from sb3_adaptive_q.experiments.paper.tables import optimal_values
from sb3_adaptive_q.experiments.text import file_name
from sb3_adaptive_q.plots import plot_policy
from sb3_adaptive_q.plots.style import COLORS, INK, tidy

GREEN, BLUE = COLORS[4], COLORS[6]
GREY = "#AAAAAA"


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
        if is_lake(system):
            figure = policies_figure(results, system, optimal_values(system, gamma))
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
    right.set_xlabel(f"mean return of the last {WINDOW} episodes\n(after training)", fontsize="small")
    right.set_yticks(range(len(methods)), methods)
    right.invert_yaxis()
    for axis in (left, right):
        tidy(axis)
    return figure


def is_lake(system: str) -> bool:
    """
    :param system: the name of an environment
    :return: whether it is a registered Frozen Lake
    """
    return system in gym.registry and isinstance(make_env(system).unwrapped, FrozenLakeEnv)


def policies_figure(results: Results, system: str, optimal: np.ndarray) -> Figure:
    """
    A Frozen Lake with the values and the greedy actions of every method's first run, beside the optimal ones.

    :param results: of a study
    :param system: one of its systems
    :param optimal: Q*
    :return: the figure
    """
    tables = {"optimal (value iteration)": optimal}
    tables |= {f"{method}, run 0": results.q_tables[system, method] for method in results.methods(system)}
    columns = min(3, len(tables))
    rows = -(-len(tables) // columns)
    side = max(3.0, 0.7 * len(optimal) ** 0.5)
    figure = Figure(figsize=(side * columns, (side + 0.3) * rows + 0.5), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis in axes[len(tables) :]:
        axis.set_axis_off()
    for axis, (title, table) in zip(axes, tables.items(), strict=False):
        plot_policy(table, system, ax=axis, limits=(0.0, max(float(optimal.max()), 1e-9)))
        axis.set_title(title, loc="left", fontsize="medium")
    figure.suptitle(f"{title_of(system)}: greedy actions and values")
    return figure
