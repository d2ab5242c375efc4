"""Intervals and tests of methods whose runs are independent samples; SciPy computes them."""

from collections.abc import Callable, Mapping
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from sb3_adaptive_q.experiments.statistics import BOOTSTRAP_SEED, CONFIDENCE, SIGNIFICANCE, Estimate, holm

#: Bootstrap samples, and how many of them are held at a time
RESAMPLES, BATCH = 9999, 500

Samples = Mapping[str, np.ndarray]


class Pair(NamedTuple):
    """
    Two methods compared by the Mann-Whitney test.

    :param first: a method
    :param second: another
    :param difference: mean of the first less mean of the second
    :param p_value: corrected after Holm for all pairs of the comparison
    :param improvement: probability that a run of the first beats a run of the second, ties counting half
    """

    first: str
    second: str
    difference: float
    p_value: float
    improvement: float

    @property
    def is_significant(self) -> bool:
        """Whether the difference is significant."""
        return self.p_value < SIGNIFICANCE

    @property
    def worse_and_better(self) -> tuple[str, str]:
        """The two by the test, which compares ranks: the one with the larger mean may be the worse one."""
        return (self.second, self.first) if self.improvement > 0.5 else (self.first, self.second)


def mean(sample: np.ndarray, axis: int = -1) -> Any:
    """The arithmetic mean."""
    return np.mean(sample, axis=axis)


def population_std(sample: np.ndarray, axis: int = -1) -> Any:
    """The standard deviation with divisor n, as in the paper's tables."""
    return np.std(sample, axis=axis)


def interquartile_mean(sample: np.ndarray, axis: int = -1) -> Any:
    """The mean of the middle half (Agarwal et al., 2021)."""
    return stats.trim_mean(sample, 0.25, axis=axis)


def difference_of_means(first: np.ndarray, second: np.ndarray, axis: int = -1) -> Any:
    """Mean of the first less mean of the second."""
    return first.mean(axis=axis) - second.mean(axis=axis)


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


def share(successes: int, n: int) -> Estimate:
    """
    :param successes: runs that reached something
    :param n: all runs
    :return: their share, with Wilson's interval
    """
    interval = stats.binomtest(successes, n).proportion_ci(CONFIDENCE, method="wilson")
    return Estimate(successes / n, float(interval.low), float(interval.high))


def probability_best(samples: Samples) -> dict[str, float]:
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


def kruskal_wallis(samples: Samples) -> float:
    """
    :param samples: by method
    :return: the p-value of the test of Kruskal and Wallis that the methods do not differ at all; 1 where all values are equal
    """
    values = np.concatenate(list(samples.values()))
    return 1.0 if np.all(values == values[0]) else float(stats.kruskal(*samples.values()).pvalue)


def compare_pairs(samples: Samples) -> list[Pair]:
    """
    :param samples: by method
    :return: every pair, with p-values corrected after Holm
    """
    pairs = list(combinations(samples, 2))
    tests = [stats.mannwhitneyu(samples[first], samples[second]) for first, second in pairs]
    p_values = holm(np.array([test.pvalue for test in tests]))
    return [
        Pair(
            first,
            second,
            float(difference_of_means(samples[first], samples[second])),
            float(p_value),
            # U counts the couples in which the first is larger, a tie as half of one
            float(test.statistic / (len(samples[first]) * len(samples[second]))),
        )
        for (first, second), test, p_value in zip(pairs, tests, p_values, strict=True)
    ]


def _stacked_means(*samples: np.ndarray, axis: int = -1) -> np.ndarray:
    return np.stack([sample.mean(axis=axis) for sample in samples])


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
