"""Returns over the course of training, over several runs."""

from collections.abc import Iterable, Mapping
from itertools import cycle
from typing import Any, NamedTuple

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from scipy.stats import bootstrap, trim_mean

from sb3_adaptive_q.plots.style import COLORS, LINE_STYLES, STYLE, new_axes, tidy

#: Points of a curve: more cannot be told apart on paper
_POINTS = 200
_RESAMPLES = 2000
_SIZE = (6.4, 4.0)


class Run(NamedTuple):
    """
    The episodes of one training.

    :param returns: of shape (n_episodes,)
    :param lengths: steps of every episode, of the same shape; ``None`` where they are not known
    """

    returns: np.ndarray
    lengths: np.ndarray | None


def plot_learning_curves(
    runs: Mapping[str, Iterable[Any]],
    window: int = 100,
    ax: Axes | None = None,
    against: str = "episodes",
    center: str = "mean",
    confidence: float = 0.95,
) -> Axes:
    """
    Draw the returns of several trainings, averaged over the runs of each, with bootstrap intervals around them.

    A run is a :class:`sb3_adaptive_q.EpisodeSeriesCallback` that was handed to ``learn``, a model whose Monitor has the
    episodes (not on a compiled environment, where a Monitor keeps no lists), or an array of returns. Curves end where the
    shortest run ends. A single run gets no interval.

    :param runs: the runs by what the legend shall say
    :param window: over how many of the last episodes the mean of a run is taken
    :param ax: the axes to draw on; ``None`` for a new figure, whose PDF embeds TrueType fonts
    :param against: what is along x: ``"episodes"``, or ``"timesteps"`` where the lengths of the episodes are known
    :param center: ``"mean"`` over the runs, or ``"iqm"``, the interquartile mean (Agarwal et al., 2021): that of the middle
        half of the runs
    :param confidence: of the intervals, between 0 and 1
    :return: the axes
    :raises ValueError: if an argument is not one of these, or a run has fewer than ``window`` episodes
    """
    _check(runs, window, against, center, confidence)
    groups = {label: [_read_run(run, label) for run in group] for label, group in runs.items()}
    with rc_context(STYLE):
        ax = new_axes(_SIZE) if ax is None else ax
        for (label, group), color, style in zip(groups.items(), cycle(COLORS), cycle(LINE_STYLES), strict=False):
            x, curves = _curves(label, group, window, against)
            ax.plot(x, _center(curves, center), color=color, linestyle=style, linewidth=1.6, label=label)
            if len(group) > 1:
                low, high = _interval(curves, center, confidence)
                ax.fill_between(x, low, high, color=color, alpha=0.15, linewidth=0, gid=label)
        _label(ax, groups, window, against, center, confidence)
    return ax


def _check(runs: Any, window: Any, against: str, center: str, confidence: float) -> None:
    if not hasattr(runs, "items") or not runs:
        raise ValueError(f"`runs` must be a dict from labels to lists of runs, but got {runs!r}.")
    for label, group in runs.items():
        if not isinstance(group, Iterable) or isinstance(group, str):
            raise ValueError(f"`runs` must have a list of runs for {label!r}, but got {group!r}: please put it into a list.")
    if not (isinstance(window, int | np.integer) and window >= 1):
        raise ValueError(f"`window` must be a whole number of at least 1 episode, but got {window}.")
    if against not in ("episodes", "timesteps"):
        raise ValueError(f'`against` must be "episodes" or "timesteps", but got {against!r}.')
    if center not in ("mean", "iqm"):
        raise ValueError(f'`center` must be "mean" or "iqm", but got {center!r}.')
    if not 0.0 < confidence < 1.0:
        raise ValueError(f"`confidence` must lie between 0 and 1, but got {confidence}.")


def _read_run(run: Any, label: str) -> Run:
    if hasattr(run, "returns"):
        return Run(np.asarray(run.returns, dtype=np.float64), np.asarray(run.lengths))
    if hasattr(run, "get_env"):
        return _read_monitors(run, label)
    try:
        returns = np.asarray(run, dtype=np.float64)
    except (TypeError, ValueError):
        returns = np.zeros(0)
    if returns.ndim != 1 or not returns.size:
        raise ValueError(
            f"A run of {label!r} must be an EpisodeSeriesCallback that was handed to `learn`, a model, or an array of returns "
            f"of shape (n_episodes,), but got {run!r}."
        )
    return Run(returns, None)


def _read_monitors(model: Any, label: str) -> Run:
    env = model.get_env()
    try:
        columns = [env.env_method(f"get_episode_{name}") for name in ("rewards", "lengths", "times")]
    except AttributeError:
        columns = [[], [], []]
    returns, lengths, times = (np.array([value for values in column for value in values]) for column in columns)
    if not len(returns):
        raise ValueError(
            f"A model of {label!r} has no Monitor that kept its episodes; on a compiled environment none does. Please hand an "
            "EpisodeSeriesCallback to `learn` and give that instead of the model."
        )
    order = np.argsort(times, kind="stable")
    return Run(returns[order].astype(np.float64), lengths[order])


def _curves(label: str, group: list[Run], window: int, against: str) -> tuple[np.ndarray, np.ndarray]:
    """Where the points lie, of shape (n_points,), and the runs' means there, of shape (n_runs, n_points)."""
    if not group:
        raise ValueError(f"There are no runs of {label!r}.")
    shortest = min(len(run.returns) for run in group)
    if shortest < window:
        raise ValueError(f"A run of {label!r} has {shortest} episodes, too few for a mean over `window`={window}.")
    ends = [_ends(run, label, against) for run in group]
    first, last = max(end[window - 1] for end in ends), min(end[-1] for end in ends)
    if last < first:
        raise ValueError(
            f"A run of {label!r} ends after {last} timesteps, before another has finished `window`={window} episodes, "
            f"{first} timesteps after its start: please take a smaller window."
        )
    x = np.unique(np.linspace(first, last, _POINTS).round().astype(np.int64))
    curves = []
    for run, end in zip(group, ends, strict=True):
        means = np.convolve(run.returns, np.full(window, 1.0 / window), mode="valid")
        finished = np.searchsorted(end, x, side="right")
        curves.append(means[finished - window])
    return x, np.array(curves)


def _ends(run: Run, label: str, against: str) -> np.ndarray:
    """When each episode ended, in episodes or in timesteps."""
    if against == "episodes":
        return np.arange(1, len(run.returns) + 1)
    if run.lengths is None:
        raise ValueError(
            f'`against="timesteps"` needs the lengths of the episodes, but a run of {label!r} is an array of returns: please '
            "give the EpisodeSeriesCallback."
        )
    return np.cumsum(run.lengths)


def _center(curves: np.ndarray, center: str, axis: int = 0) -> np.ndarray:
    if center == "mean":
        return curves.mean(axis=axis)
    return np.asarray(trim_mean(curves, 0.25, axis=axis))


def _interval(curves: np.ndarray, center: str, confidence: float) -> tuple[np.ndarray, np.ndarray]:
    """Percentile bootstrap over the runs; always from the same random numbers, so that a figure can be made again."""
    result = bootstrap(
        (curves,), lambda sample, axis: _center(sample, center, axis), axis=0, n_resamples=_RESAMPLES, batch=100,
        vectorized=True, confidence_level=confidence, method="percentile", rng=np.random.default_rng(0),
    )  # fmt: skip
    return np.asarray(result.confidence_interval.low), np.asarray(result.confidence_interval.high)


def _label(ax: Axes, groups: dict[str, list[Run]], window: int, against: str, center: str, confidence: float) -> None:
    counts = sorted({len(group) for group in groups.values()})
    number = str(counts[0]) if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    words = "mean" if center == "mean" else "interquartile mean"
    title = "one run" if counts == [1] else f"{words} of {number} runs, shaded: {100 * confidence:g} % bootstrap interval"
    ax.set_title(title, loc="left", fontsize="medium")
    ax.set_xlabel("episode" if against == "episodes" else "timestep")
    ax.set_ylabel(f"return (mean of the last {window} episodes)" if window > 1 else "return per episode")
    ax.legend(frameon=False, handlelength=3.2)
    tidy(ax)
