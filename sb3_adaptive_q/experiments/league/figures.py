"""The figures of a league."""

from collections.abc import Sequence
from itertools import product

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter

from sb3_adaptive_q.experiments.drawing import MARKERS, line_style
from sb3_adaptive_q.experiments.league.analysis import Places, Scores, Sensitivity, Standing
from sb3_adaptive_q.experiments.league.findings import PAPER_LABELS
from sb3_adaptive_q.experiments.league.plan import CLIP, anytime
from sb3_adaptive_q.experiments.league.settings import Contestant, Track, league_data
from sb3_adaptive_q.experiments.statistics import (
    BOOTSTRAP_SEED,
    Estimate,
    band,
    bootstrap,
    bootstrap_aggregates,
    interquartile_mean,
    performance_profile,
)
from sb3_adaptive_q.plots.style import tidy

#: Rules whose curves are drawn: more could not be told apart
MOST_CURVES = 8
#: Points in the plane that are as near as this, in pixels, touch
TOUCHING = 13.0
#: Panels beside each other
COLUMNS = 4
#: Bootstrap samples of the band around a curve
BAND_RESAMPLES = 300


def shown(rows: Sequence[Standing]) -> list[str]:
    """
    :param rows: standings, the best first
    :return: the rules whose curves are drawn: the best, the references and the best of the paper's methods
    """
    of_paper = [row.label for row in rows if row.label in PAPER_LABELS][:1]
    wanted = dict.fromkeys([*league_data()["references"], *of_paper, *(row.label for row in rows)])
    chosen = [label for label in wanted if any(row.label == label for row in rows)][:MOST_CURVES]
    return [row.label for row in rows if row.label in chosen]


def plane_figure(track: Track, rows: Sequence[Standing], sensitivities: Sequence[Sensitivity]) -> Figure:
    """
    The sensitivity-performance plane (Adkins, Bowling and White, 2024): the useful rules stand at the top left.

    :param track: a track
    :param rows: standings
    :param sensitivities: of the rules
    :return: the figure
    """
    figure = Figure(figsize=(9.0, 6.0), layout="constrained")
    axis = figure.subplots()
    loss = {rule.label: each.loss for rule, each in zip(track.contestants, sensitivities, strict=True)}
    for i, row in enumerate(rows):
        color = line_style(i)["color"]
        margins = np.array([[row.score.value - row.score.low], [row.score.high - row.score.value]])
        marker, filling = MARKERS[i % len(MARKERS)], color if i < len(MARKERS) else "white"
        style = {"color": color, "marker": marker, "markerfacecolor": filling, "linestyle": ""}
        axis.errorbar(loss[row.label], row.score.value, yerr=margins, label=f"{i + 1} {row.label}", capsize=2, **style)
    # The good rules lie close together near 0, the others far apart
    axis.set_xscale("function", functions=(_signed_root, _signed_square))
    axis.set(
        xlabel="sensitivity: what one setting for all environments costs against the best in each",
        ylabel="score (interquartile mean, one setting for all)",
        title="Performance against sensitivity: top left is best",
    )
    axis.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize="x-small")
    tidy(axis)
    number_points(figure, axis, [(loss[row.label], row.score.value) for row in rows])
    return figure


def number_points(figure: Figure, axis: Axes, points: Sequence[tuple[float, float]]) -> None:
    """
    Write the number of each point beside it, those of points that touch in one place.

    :param figure: the figure
    :param axis: its axes, with all that is drawn in them
    :param points: their x and y
    """
    figure.draw_without_rendering()  # where the points are is known once everything has its place
    places = axis.transData.transform(points)
    groups: list[list[int]] = []
    for i, place in enumerate(places):
        touching = [group for group in groups if np.linalg.norm(places[group] - place, axis=1).min() < TOUCHING]
        groups = [group for group in groups if group not in touching] + [[*(j for group in touching for j in group), i]]
    for group in groups:
        right = max(points[i][0] for i in group), max(points[i][1] for i in group)
        numbers = [i + 1 for i in sorted(group)]
        in_a_row = len(group) > 2 and numbers[-1] - numbers[0] == len(group) - 1
        text = f"{numbers[0]}–{numbers[-1]}" if in_a_row else ", ".join(map(str, numbers))
        axis.annotate(text, right, (6, 4), textcoords="offset points", fontsize="x-small")


def _signed_root(values: np.ndarray) -> np.ndarray:
    return np.sign(values) * np.sqrt(np.abs(values))


def _signed_square(values: np.ndarray) -> np.ndarray:
    return np.sign(values) * np.square(values)


def curves_figure(track: Track, scores: Scores, rows: Sequence[Standing]) -> Figure:
    """
    The interquartile mean over all environments at each checkpoint.

    :param track: a track
    :param scores: with one setting for all environments
    :param rows: standings
    :return: the figure
    """
    figure = Figure(figsize=(9.0, 5.0), layout="constrained")
    axis = figure.subplots()
    labels = [rule.label for rule in track.contestants]
    chosen = [labels.index(label) for label in shown(rows)]
    x = np.arange(1, len(scores.curves) + 1) / len(scores.curves)
    values = np.stack([interquartile_mean(at[chosen]) for at in scores.curves])
    samples = np.stack([bootstrap_aggregates(at[chosen], BAND_RESAMPLES)[..., 0] for at in scores.curves], axis=1)
    for i, rule in enumerate(chosen):
        style = line_style(i)
        axis.plot(x, values[:, i], label=labels[rule], linewidth=1.5, marker=MARKERS[i], markevery=(i % 3, 3), ms=5, **style)
        axis.fill_between(x, *band(samples[..., i]), color=style["color"], alpha=0.15, linewidth=0)
    axis.set(xlabel="share of the steps", ylabel="score (interquartile mean)")
    axis.set_title("Learning over all environments, shaded: 95 % bootstrap interval", loc="left", fontsize="medium")
    figure.legend(loc="outside right center", frameon=False, handlelength=3.0)
    tidy(axis)
    return figure


def environments_figure(track: Track, scores: Scores, rows: Sequence[Standing]) -> Figure:
    """
    Learning curves in each environment.

    :param track: a track
    :param scores: with one setting for all environments
    :param rows: standings
    :return: the figure
    """
    labels = [rule.label for rule in track.contestants]
    chosen = [labels.index(label) for label in shown(rows)]
    draws = _draws(scores.curves.shape[2])
    figure, axes = _panels([task.name for task in track.tasks], "steps", "score (mean)")
    for k, axis in enumerate(axes):
        x = np.arange(1, len(scores.curves) + 1) * track.tasks[k].steps / len(scores.curves)
        for i, rule in enumerate(chosen):
            runs, style = scores.curves[:, rule, :, k].T, line_style(i)
            axis.plot(x, runs.mean(axis=0), linewidth=1.2, label=labels[rule] if k == 0 else None, **style)
            axis.fill_between(x, *band(draws @ runs), color=style["color"], alpha=0.15, linewidth=0)
        axis.xaxis.set_major_formatter(EngFormatter())
    figure.legend(loc="outside lower center", ncols=4, frameon=False, fontsize="small", handlelength=3.0)
    return figure


def profiles_figure(track: Track, scores: Scores, rows: Sequence[Standing]) -> Figure:
    """
    Performance profiles: the share of all runs above each score.

    :param track: a track
    :param scores: with one setting for all environments
    :param rows: standings
    :return: the figure
    """
    figure = Figure(figsize=(9.0, 5.0), layout="constrained")
    axis = figure.subplots()
    labels = [rule.label for rule in track.contestants]
    chosen = [labels.index(label) for label in shown(rows)]
    thresholds = np.linspace(*CLIP, 151)
    part = scores.anytime[chosen]
    values = performance_profile(part, thresholds)
    samples = bootstrap(part, lambda drawn: performance_profile(drawn, thresholds[::5]), BAND_RESAMPLES)
    for i, rule in enumerate(chosen):
        style = line_style(i)
        axis.plot(
            thresholds, values[i], label=labels[rule], linewidth=1.5, marker=MARKERS[i], markevery=(2 * i, 20), ms=5, **style
        )
        axis.fill_between(thresholds[::5], *band(samples[:, i]), color=style["color"], alpha=0.15, linewidth=0)
    axis.set(xlabel="score τ", ylabel="share of the runs with a score above τ")
    axis.set_title("Performance profiles, shaded: 95 % bootstrap interval", loc="left", fontsize="medium")
    figure.legend(loc="outside right center", frameon=False, handlelength=3.0)
    tidy(axis)
    return figure


def wins_figure(rows: Sequence[Standing], labels: Sequence[str], wins: Sequence[Sequence[Estimate]]) -> Figure:
    """
    The matrix of wins: how probable it is that a run of one rule beats a run of another.

    :param rows: standings, the best first
    :param labels: of the rules
    :param wins: by their order in ``labels``
    :return: the figure
    """
    order = [labels.index(row.label) for row in rows]
    values = 100.0 * np.array([[wins[i][j].value for j in order] for i in order])
    side = 2.0 + 0.42 * len(order)
    figure = Figure(figsize=(max(side + 1.0, 6.0), side), layout="constrained")  # the title is 5 inches wide
    axis = figure.subplots()
    image = axis.imshow(values, cmap="cividis", vmin=0.0, vmax=100.0)
    for (row, column), value in np.ndenumerate(values):
        low, high = wins[order[row]][order[column]][1:]
        mark = "" if low <= 0.5 <= high else "*"
        color = "black" if value > 55.0 else "white"
        axis.text(column, row, f"{value:.0f}{mark}", ha="center", va="center", color=color, fontsize="x-small")
    names = [labels[i] for i in order]
    axis.set_xticks(range(len(names)), names, rotation=90, fontsize="small")
    axis.set_yticks(range(len(names)), names, fontsize="small")
    title = "How often a run of the row beats one of the column, in %\n(* 95 % interval without 50 %)"
    figure.suptitle(title, fontsize="medium")
    figure.colorbar(image, shrink=0.5)
    return figure


def free_parameters(rule: Contestant) -> list[str]:
    """
    :param rule: a contestant
    :return: the parameters that its settings differ in
    """
    return [name for name in rule.settings[0] if len({each[name] for each in rule.settings}) > 1]


def sensitivity_figure(track: Track, rule: int, tuning: Places, scale: Sequence[float]) -> Figure:
    """
    Scores against the first parameter that varies, from the tuning runs.

    :param track: a track
    :param rule: the index of one of its contestants, which has more than one setting
    :param tuning: its tuning runs
    :param scale: of the scores in each task, see :func:`~sb3_adaptive_q.experiments.league.plan.anytime`
    :return: the figure
    """
    contestant = track.contestants[rule]
    first, *others = free_parameters(contestant)
    figure, axes = _panels([task.name for task in track.tasks], first, "score (mean of the tuning runs)")
    x = np.array([each[first] for each in contestant.settings], float)
    lines = [tuple(each[name] for name in others) for each in contestant.settings]
    for k, axis in enumerate(axes):
        runs = np.stack([anytime(track, tuning[rule, j, k], scale[k]) for j in range(len(x))])
        draws = _draws(runs.shape[1])
        for i, line in enumerate(dict.fromkeys(lines)):
            of_line = sorted((j for j in range(len(x)) if lines[j] == line), key=lambda j: x[j])
            style, text = line_style(i), ", ".join(f"{name} = {value:g}" for name, value in zip(others, line, strict=True))
            axis.plot(x[of_line], runs[of_line].mean(axis=1), marker=".", label=text if k == 0 else None, **style)
            axis.fill_between(x[of_line], *band(draws @ runs[of_line].T), color=style["color"], alpha=0.15, linewidth=0)
        _set_log_axis(axis, x)
        # All panels have the same values: those of the lowest ones will do
        axis.tick_params(axis="x", which="both", labelbottom=k + COLUMNS >= len(axes))
    figure.suptitle(contestant.label, fontsize="medium")
    if others:
        figure.legend(loc="outside lower center", ncols=4, frameon=False, fontsize="small")
    return figure


def _set_log_axis(axis: Axes, x: np.ndarray) -> None:
    magnitudes = np.abs(x[x != 0.0])
    if (x > 0.0).all() and x.max() < 10.0 * x.min():
        return  # within a decade a linear axis has the plainer numbers
    if (x < 0.0).any():
        axis.set_xscale("symlog", linthresh=magnitudes.min())
    elif (x == 0.0).any():
        axis.set_xscale("symlog", linthresh=magnitudes.min(), linscale=0.3)
    else:
        axis.set_xscale("log")


def _draws(runs: int) -> np.ndarray:
    """Bootstrap weights of runs, of shape (resamples, runs)."""
    generator = np.random.default_rng(BOOTSTRAP_SEED)
    return generator.multinomial(runs, np.full(runs, 1.0 / runs), size=BAND_RESAMPLES) / runs


def _panels(titles: Sequence[str], xlabel: str, ylabel: str) -> tuple[Figure, list[Axes]]:
    columns = min(COLUMNS, len(titles))
    rows = -(-len(titles) // columns)
    figure = Figure(figsize=(2.9 * columns, 2.1 * rows + 0.8), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False)
    places = [grid[place] for place in product(range(rows), range(columns))]
    axes, unused = places[: len(titles)], places[len(titles) :]
    for axis in unused:
        axis.set_axis_off()
    for axis, title in zip(axes, titles, strict=True):
        axis.set_title(title, loc="left", fontsize="small")
        axis.tick_params(which="both", labelsize="x-small")
        tidy(axis)
    for axis in axes[-columns:]:  # below them are no panels: a label of the whole figure would hit the legend
        axis.set_xlabel(xlabel, fontsize="small")
    figure.supylabel(ylabel, fontsize="small")
    return figure, axes
