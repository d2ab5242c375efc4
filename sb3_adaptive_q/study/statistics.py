"""Intervals and tests over the runs of a study; SciPy and rliable compute them."""

from collections.abc import Callable
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from rliable.metrics import aggregate_iqm
from scipy import stats

#: Of every interval
CONFIDENCE = 0.95
#: Of every test
SIGNIFICANCE = 0.05
#: Bootstrap samples, and how many of them are held at a time
RESAMPLES, BATCH = 9999, 500
#: What the bootstrap draws from: the same results give the same report
BOOTSTRAP_SEED = 0


class Estimate(NamedTuple):
    """
    :param value: of a statistic
    :param low: the lower end of its 95% interval; NaN where one run cannot tell
    :param high: the upper end
    """

    value: float
    low: float
    high: float


class Pair(NamedTuple):
    """
    Two methods compared by the Mann-Whitney test.

    :param first: number of a method
    :param second: number of another
    :param difference: mean of the first less mean of the second
    :param p_value: corrected after Holm for all pairs of the comparison
    :param improvement: probability that a run of the first beats a run of the second, ties counting half
    """

    first: int
    second: int
    difference: float
    p_value: float
    improvement: float

    @property
    def is_significant(self) -> bool:
        """Whether the test tells them apart."""
        return self.p_value < SIGNIFICANCE


def mean(sample: np.ndarray, axis: int = -1) -> Any:
    """The arithmetic mean."""
    return np.mean(sample, axis=axis)


def population_std(sample: np.ndarray, axis: int = -1) -> Any:
    """The standard deviation with divisor n, as in the paper's tables."""
    return np.std(sample, axis=axis)


def estimate(statistic: Callable[..., Any], *samples: np.ndarray) -> Estimate:
    """
    A statistic with its percentile bootstrap interval. Other intervals fail on samples such as twenty equal returns.

    :param statistic: of the samples, with an ``axis``
    :param samples: one or more, each of shape (runs,), resampled independently
    :return: its value and interval
    """
    value = float(statistic(*samples, axis=-1))
    if min(len(sample) for sample in samples) < 2:
        return Estimate(value, np.nan, np.nan)
    interval = _bootstrap(statistic, samples).confidence_interval
    return Estimate(value, float(interval.low), float(interval.high))


def interquartile_mean(sample: np.ndarray) -> Estimate:
    """
    :param sample: of shape (runs,)
    :return: the mean of the middle half (Agarwal et al., 2021), with its bootstrap interval
    """
    _, low, high = estimate(_middle_mean, sample)
    return Estimate(float(aggregate_iqm(sample)), low, high)


def share(successes: int, n: int) -> Estimate:
    """
    :param successes: runs that reached something
    :param n: all runs
    :return: their share, with Wilson's interval
    """
    interval = stats.binomtest(successes, n).proportion_ci(CONFIDENCE, method="wilson")
    return Estimate(successes / n, float(interval.low), float(interval.high))


def probability_best(samples: dict[int, np.ndarray]) -> dict[int, float]:
    """
    :param samples: by method
    :return: for each method, in how many of the bootstrap samples its mean is the largest; a tie is shared. All NaN
        for single runs
    """
    if min(len(sample) for sample in samples.values()) < 2:
        return dict.fromkeys(samples, np.nan)
    means = _bootstrap(_stacked_means, tuple(samples.values())).bootstrap_distribution
    is_best = means == means.max(axis=0)
    shares = (is_best / is_best.sum(axis=0)).mean(axis=-1)
    return dict(zip(samples, shares.tolist(), strict=True))


def friedman(samples: dict[int, np.ndarray]) -> float:
    """
    Friedman's test of whether the methods differ at all, run k of all methods being a block. The runs are independent,
    so that any blocks would do.

    :param samples: by method, at least three, of equal length
    :return: the p-value; 1 where all values are equal
    """
    values = np.stack(list(samples.values()))
    if np.all(values == values[0]):
        return 1.0
    return float(stats.friedmanchisquare(*values).pvalue)


def compare_pairs(samples: dict[int, np.ndarray]) -> list[Pair]:
    """
    :param samples: by method
    :return: every pair, with p-values corrected after Holm
    """
    pairs = list(combinations(samples, 2))
    if not pairs:
        return []
    first, second = (np.stack([samples[pair[i]] for pair in pairs]) for i in (0, 1))
    test = stats.mannwhitneyu(first, second, axis=1)
    columns = (
        (first.mean(axis=1) - second.mean(axis=1)).tolist(),
        _holm(test.pvalue).tolist(),
        # U counts the couples in which the first is larger, a tie as half of one
        (test.statistic / (first.shape[1] * second.shape[1])).tolist(),
    )
    return [Pair(a, b, *values) for (a, b), *values in zip(pairs, *columns, strict=True)]


def _holm(p_values: np.ndarray) -> np.ndarray:
    # SciPy has no such function, and the one of statsmodels collects garbage whenever it is called
    order = np.argsort(p_values)
    corrected = np.empty(len(order))
    corrected[order] = np.minimum(np.maximum.accumulate(np.arange(len(order), 0, -1) * p_values[order]), 1.0)
    return corrected


def _stacked_means(*samples: np.ndarray, axis: int = -1) -> np.ndarray:
    return np.stack([sample.mean(axis=axis) for sample in samples])


def _middle_mean(sample: np.ndarray, axis: int = -1) -> Any:
    # What rliable's function computes, which has no axis
    return stats.trim_mean(sample, 0.25, axis=axis)


def _bootstrap(statistic: Callable[..., Any], samples: tuple[np.ndarray, ...]) -> Any:
    return stats.bootstrap(
        samples,
        statistic,
        n_resamples=RESAMPLES,
        batch=BATCH,
        vectorized=True,
        confidence_level=CONFIDENCE,
        method="percentile",
        rng=np.random.default_rng(BOOTSTRAP_SEED),
    )
