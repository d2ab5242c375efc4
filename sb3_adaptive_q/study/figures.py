"""The paper's Figures 6 to 13, and what it has no figure of: all methods together, and the lake with what was learned."""

from collections.abc import Iterator
from io import BytesIO

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from sb3_adaptive_q.callbacks import METHODS
from sb3_adaptive_q.study.cells import WINDOW
from sb3_adaptive_q.study.lake import lake_map, optimal_values
from sb3_adaptive_q.study.results import MethodSeries, Results, trailing_mean
from sb3_adaptive_q.study.systems import PAPER_SYSTEMS, file_name, title_of

# From the palette of Okabe and Ito, which the colour-blind can tell apart; light and thin against dark and thick, so
# that grey print can as well
BLUE, GREEN, GREY, INK = "#56B4E9", "#00664B", "#AAAAAA", "#222222"
METHOD_COLORS = ("#000000", "#E69F00", "#0072B2", "#CC79A7")
#: The pairs that share a figure in the paper
PAIRS = ((1, 2), (3, 4), (5, 6), (7, 8))
#: Dots per inch of PNG files, and of the dense curves inside PDF files
RESOLUTION = 200
ARROWS = ((-1, 0), (0, 1), (1, 0), (0, -1))  # left, down, right, up as (x, y), y pointing down


def make_figures(results: Results, gamma: float) -> Iterator[tuple[str, Figure]]:
    """
    :param results: of a study
    :param gamma: the discount factor
    :return: the figures with the names of their files, one at a time: each holds much memory once it was drawn
    """
    for system in results.systems:
        yield from _pair_figures(results, system)
        yield f"all_methods_{file_name(system)}", all_methods_figure(results, system)
        letters = lake_map(system)
        if letters is not None:
            yield f"policies_{file_name(system)}", policies_figure(results, system, letters, optimal_values(system, gamma))


def render(figure: Figure, kind: str) -> bytes:
    """
    :param figure: a figure
    :param kind: ``"png"`` or ``"pdf"``
    :return: the content of its file, which is the same whenever it is made
    """
    buffer = BytesIO()
    figure.savefig(buffer, format=kind, dpi=RESOLUTION, metadata={"CreationDate": None} if kind == "pdf" else None)
    return buffer.getvalue()


def _pair_figures(results: Results, system: str) -> Iterator[tuple[str, Figure]]:
    for i, pair in enumerate(PAIRS):
        present = [number for number in pair if (system, number) in results.series]
        if present:
            number = PAPER_SYSTEMS[system].first_figure + i if system in PAPER_SYSTEMS else None
            name = f"figure_{number:02d}" if number else f"methods_{pair[0]}_{pair[1]}_{file_name(system)}"
            yield name, pair_figure(results, system, present)


def pair_figure(results: Results, system: str, numbers: list[int]) -> Figure:
    """
    One of Figures 6 to 13: a row for each method, its reward on the left and its μ on the right.

    :param results: of a study
    :param system: one of its systems
    :param numbers: the methods
    :return: the figure
    """
    figure = Figure(figsize=(9.0, 2.9 * len(numbers)), layout="constrained")
    axes = figure.subplots(len(numbers), 2, squeeze=False, sharex=True, sharey="col")
    for (left, right), number in zip(axes, numbers, strict=True):
        _draw_reward(left, results.series[system, number], system)
        _draw_rate(right, results.series[system, number])
        left.set_title(f"Method {number}: reward", loc="left")
        right.set_title(f"Method {number}: {METHODS[number].formula}", loc="left", fontsize="small")
    for axis in axes[-1]:
        axis.set_xlabel("episode")
    for axis in axes[0]:
        axis.legend(loc="upper left", frameon=False)
    figure.suptitle(title_of(system))
    return figure


def _draw_reward(axis: Axes, series: MethodSeries, system: str) -> None:
    _draw_with_mean(axis, series.returns, BLUE, GREEN)
    axis.set_ylabel("reward")
    if system in PAPER_SYSTEMS:
        limit = PAPER_SYSTEMS[system].limit
        axis.set_ylim(-0.03 * limit, 1.05 * limit)


def _draw_rate(axis: Axes, series: MethodSeries) -> None:
    _draw_with_mean(axis, series.mu, GREY, INK)
    axis.set_ylabel("μ at the episode's end")
    # The axis is shared: the larger rate decides, and the legend needs room above it
    axis.set_ylim(0.0, max(axis.get_ylim()[1], 1.35 * float(series.mu.max())))


def _draw_with_mean(axis: Axes, values: np.ndarray, color: str, mean_color: str) -> None:
    episodes = np.arange(1, len(values) + 1)
    axis.plot(episodes, values, color=color, linewidth=0.4, rasterized=True, label="mean over the runs")
    label = f"its {WINDOW}-episode mean"
    axis.plot(episodes, trailing_mean(values), color=mean_color, linewidth=1.8, rasterized=True, label=label)
    _tidy(axis)


def all_methods_figure(results: Results, system: str) -> Figure:
    """
    The 100-episode means of all methods on one axis, with 95% confidence bands over the runs, and where they end.

    :param results: of a study
    :param system: one of its systems
    :return: the figure
    """
    figure = Figure(figsize=(10.0, 5.0), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(3, 1))
    for number in results.methods(system):
        series = results.series[system, number]
        color, style = METHOD_COLORS[(number - 1) // 2], "-" if number % 2 else (0, (4, 1.5))
        x, y, margin = series.curve_episodes, series.curve, series.curve_margin
        left.plot(x, y, color=color, linestyle=style, linewidth=1.4, label=f"Method {number}")
        left.fill_between(x, y - margin, y + margin, color=color, alpha=0.15, linewidth=0)
        filling = color if number % 2 else "white"
        right.errorbar(y[-1], number, xerr=margin[-1], color=color, marker="o", markerfacecolor=filling, capsize=3)
    left.set(xlabel="episode", ylabel=f"reward, mean of the last {WINDOW} episodes")
    left.set_title(f"{title_of(system)}: mean over the runs, with 95% confidence bands", loc="left", fontsize="medium")
    left.legend(loc="upper left", frameon=False, handlelength=3.0)
    right.set(xlabel="the same at the end", yticks=results.methods(system))
    right.set_yticklabels([f"Method {number}" for number in results.methods(system)])
    right.invert_yaxis()
    for axis in (left, right):
        _tidy(axis)
    return figure


def policies_figure(results: Results, system: str, letters: np.ndarray, optimal: np.ndarray) -> Figure:
    """
    A Frozen Lake with the values and the greedy actions of every method's first run, beside the optimal ones.

    :param results: of a study
    :param system: one of its systems
    :param letters: its map
    :param optimal: Q*
    :return: the figure
    """
    tables = {"Q* (value iteration)": optimal}
    tables |= {f"Method {number}, run 0": results.q_tables[system, number] for number in results.methods(system)}
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


def _draw_lake(axis: Axes, letters: np.ndarray, table: np.ndarray, largest: float):  # type: ignore[no-untyped-def]
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


def _tidy(axis: Axes) -> None:
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(alpha=0.25, linewidth=0.6)
