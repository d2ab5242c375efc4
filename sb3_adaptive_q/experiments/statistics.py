"""
Statistics over runs. A matrix of scores has the axes (runs, tasks): an environment is a task, a seed a run, and neither the
episodes nor the checkpoints of one run are replicates. Aggregates and intervals are those of Agarwal et al. (2021).
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

#: Of every interval
CONFIDENCE = 0.95
PROBABILITIES = ((1.0 - CONFIDENCE) / 2.0, (1.0 + CONFIDENCE) / 2.0)
#: Of every test
SIGNIFICANCE = 0.05
#: What the bootstrap draws from: the same results give the same report
BOOTSTRAP_SEED = 0
#: Bootstrap samples that are held at a time, and the decimals of those that are counted
BATCH, DECIMALS = 100, 12

Statistic = Callable[[np.ndarray], np.ndarray]


class Estimate(NamedTuple):
    """
    :param value: of a statistic
    :param low: the lower end of its 95% interval; NaN where one run cannot tell
    :param high: the upper end
    """

    value: float
    low: float
    high: float


class Comparison(NamedTuple):
    """
    A rule compared with a reference by the seeds that both have.

    :param difference: of the two interquartile means, with its interval
    :param p_value: of no difference, corrected after Holm for all rules that are compared with the reference
    """

    difference: Estimate
    p_value: float

    @property
    def is_significant(self) -> bool:
        """Whether the difference is significant."""
        return self.p_value < SIGNIFICANCE


def interquartile_mean(scores: np.ndarray) -> np.ndarray:
    """
    :param scores: of shape (..., runs, tasks)
    :return: the mean of the middle half of all runs of all tasks, of shape (...)
    """
    flat = scores.reshape(*scores.shape[:-2], -1)
    cut = flat.shape[-1] // 4
    ordered = np.partition(flat, (cut, flat.shape[-1] - cut - 1), axis=-1)
    return ordered[..., cut : flat.shape[-1] - cut].mean(axis=-1)


def mean(scores: np.ndarray) -> np.ndarray:
    """
    :param scores: of shape (..., runs, tasks)
    :return: the mean of all runs of all tasks, of shape (...)
    """
    return scores.mean(axis=(-2, -1))


def optimality_gap(scores: np.ndarray) -> np.ndarray:
    """
    :param scores: of shape (..., runs, tasks)
    :return: how far the runs fall short of 1 on average, those above counting as 1, of shape (...)
    """
    return 1.0 - np.minimum(scores, 1.0).mean(axis=(-2, -1))


def resampled(scores: np.ndarray, resamples: int, seed: int = BOOTSTRAP_SEED) -> Iterator[np.ndarray]:
    """
    Bootstrap samples, stratified by task: the runs of every task are drawn anew, with replacement, for all rules alike. So
    the runs of two rules with the same seed stay together.

    :param scores: of shape (rules, runs, tasks)
    :param resamples: how many
    :param seed: of the draws
    :return: them in batches of shape (batch, rules, runs, tasks)
    """
    columns = np.arange(scores.shape[2])
    for rows in _drawn_runs(scores.shape, resamples, seed):
        yield np.stack([of_rule[rows, columns] for of_rule in scores], axis=1)


def _drawn_runs(shape: tuple[int, ...], resamples: int, seed: int) -> Iterator[np.ndarray]:
    """Which runs of every task are drawn, in batches of shape (batch, runs, tasks)."""
    generator = np.random.default_rng(seed)
    _, runs, tasks = shape
    for start in range(0, resamples, BATCH):
        yield generator.integers(runs, size=(min(BATCH, resamples - start), runs, tasks))


def bootstrap(scores: np.ndarray, statistic: Statistic, resamples: int) -> np.ndarray:
    """
    :param scores: of shape (rules, runs, tasks)
    :param statistic: from shape (..., runs, tasks) to (..., *shape of the statistic)
    :param resamples: how many
    :return: the statistic of every bootstrap sample, of shape (resamples, rules, *shape of the statistic)
    """
    return np.concatenate([statistic(batch) for batch in resampled(scores, resamples)])


def interval(value: float, samples: np.ndarray) -> Estimate:
    """
    :param value: of a statistic
    :param samples: its bootstrap samples, of shape (resamples,)
    :return: both as an estimate with its percentile interval
    """
    low, high = np.quantile(samples, PROBABILITIES)
    return Estimate(float(value), float(low), float(high))


def band(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """
    :param samples: bootstrap samples of a curve, of shape (resamples, points)
    :return: the lower and the upper ends of its pointwise intervals, each of shape (points,)
    """
    low, high = np.quantile(samples, PROBABILITIES, axis=0)
    return low, high


def aggregates(scores: np.ndarray) -> np.ndarray:
    """
    :param scores: of shape (..., runs, tasks)
    :return: interquartile mean, mean and optimality gap, of shape (..., 3)
    """
    return np.stack([interquartile_mean(scores), mean(scores), optimality_gap(scores)], axis=-1)


def bootstrap_aggregates(scores: np.ndarray, resamples: int) -> np.ndarray:
    """
    The same as :func:`bootstrap` of :func:`aggregates`, up to rounding, in a quarter of the time: the runs of a sample are
    counted instead of copied, and those of each rule are sorted once.

    :param scores: finite, of shape (rules, runs, tasks)
    :param resamples: how many
    :return: interquartile mean, mean and optimality gap of every bootstrap sample, of shape (resamples, rules, 3)
    """
    _, runs, tasks = scores.shape
    flat, size = scores.reshape(len(scores), -1), runs * tasks
    orders = flat.argsort(axis=1)
    samples = []
    for rows in _drawn_runs(scores.shape, resamples, BOOTSTRAP_SEED):
        places = rows * tasks + np.arange(tasks) + size * np.arange(len(rows))[:, None, None]
        counts = np.bincount(places.ravel(), minlength=len(rows) * size).reshape(-1, size).astype(float)
        middles = [_middle_mean(counts[:, order], values[order]) for order, values in zip(orders, flat, strict=True)]
        gaps = 1.0 - counts @ np.minimum(flat, 1.0).T / size
        samples.append(np.stack([np.stack(middles, axis=1), counts @ flat.T / size, gaps], axis=-1))
    # Sums of the same scores in another order differ in their last digits, and equal samples shall be equal
    return np.concatenate(samples).round(DECIMALS)


def _middle_mean(counts: np.ndarray, ordered: np.ndarray) -> np.ndarray:
    """The mean of the middle half of samples, of shape (samples,), by how often each of the ordered scores is in them."""
    size = len(ordered)
    cut = size // 4
    inside = np.diff(np.clip(counts.cumsum(axis=1), cut, size - cut), axis=1, prepend=float(cut))
    return inside @ ordered / (size - 2 * cut)


def compare_with(reference: int, values: np.ndarray, samples: np.ndarray) -> dict[int, Comparison]:
    """
    The paired comparison of every rule with one of them, where the runs of all rules have the same seeds.

    :param reference: the index of the rule that the others are compared with
    :param values: of the interquartile mean, of shape (rules,)
    :param samples: its bootstrap samples, of shape (resamples, rules)
    :return: a comparison by the index of each other rule
    """
    others = [rule for rule in range(len(values)) if rule != reference]
    differences = samples[:, others] - samples[:, [reference]]
    tails = np.minimum((differences <= 0.0).sum(axis=0), (differences >= 0.0).sum(axis=0))
    p_values = holm(np.minimum(2.0 * (tails + 1.0) / (len(samples) + 1.0), 1.0))
    return {
        rule: Comparison(interval(values[rule] - values[reference], differences[:, i]), float(p_values[i]))
        for i, rule in enumerate(others)
    }


def rank_intervals(values: np.ndarray, samples: np.ndarray) -> list[tuple[int, int, int]]:
    """
    :param values: of the interquartile mean, of shape (rules,)
    :param samples: its bootstrap samples, of shape (resamples, rules)
    :return: for each rule its rank, 1 being the best, and the ends of the rank's 95% interval
    """
    ends = np.quantile(_ranks(samples), PROBABILITIES, axis=0, method="inverted_cdf")
    return [(int(rank), int(low), int(high)) for rank, low, high in zip(_ranks(values[None])[0], *ends, strict=True)]


def _ranks(values: np.ndarray) -> np.ndarray:
    """Ranks in rows, ties sharing the best rank of theirs."""
    return stats.rankdata(-values, method="min", axis=1)


def probability_of_improvement(first: np.ndarray, second: np.ndarray) -> float:
    """
    :param first: scores of a rule, of shape (runs, tasks)
    :param second: scores of another
    :return: the probability that a run of the first beats one of the second in the same task, ties counting half: the mean
        over the tasks
    """
    return float(np.mean([_wins(first[:, task], second[:, task]).mean() for task in range(first.shape[1])]))


def improvement_matrix(scores: np.ndarray, resamples: int) -> list[list[Estimate]]:
    """
    :param scores: of shape (rules, runs, tasks)
    :param resamples: of the bootstrap
    :return: in row i and column j the probability that rule i improves on rule j, see :func:`probability_of_improvement`
    """
    rules, runs, tasks = scores.shape
    generator = np.random.default_rng(BOOTSTRAP_SEED)
    # How often each run is drawn: as weights of the wins that stand once for all, many times faster than drawing the scores
    weights = generator.multinomial(runs, np.full(runs, 1.0 / runs), size=(tasks, resamples)) / runs
    values = [[Estimate(0.5, 0.5, 0.5)] * rules for _ in range(rules)]
    for i, j in combinations(range(rules), 2):
        wins = [_wins(scores[i, :, task], scores[j, :, task]) for task in range(tasks)]
        samples = np.mean([((weights[task] @ wins[task]) * weights[task]).sum(axis=1) for task in range(tasks)], axis=0)
        values[i][j] = interval(float(np.mean(wins)), samples)
        values[j][i] = Estimate(1.0 - values[i][j].value, 1.0 - values[i][j].high, 1.0 - values[i][j].low)
    return values


def _wins(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """For each pair of runs 1 where the first is better, 1/2 for a tie."""
    return (1.0 + np.sign(first[:, None] - second[None, :])) / 2.0


def performance_profile(scores: np.ndarray, thresholds: np.ndarray) -> np.ndarray:
    """
    :param scores: of shape (..., runs, tasks)
    :param thresholds: of shape (points,)
    :return: the share of all runs of all tasks that lie above each threshold, of shape (..., points)
    """
    return np.stack([(scores > threshold).mean(axis=(-2, -1)) for threshold in thresholds], axis=-1)


def tolerance_interval(runs: np.ndarray, confidence: float = 0.95, coverage: float = 0.9) -> tuple[float, float]:
    """
    Between which two values nine of ten runs lie, with 95% confidence and whatever their distribution.

    :param runs: of shape (runs,)
    :param confidence: of the statement
    :param coverage: the share of all runs that lie between
    :return: the two order statistics; NaN where there are too few runs to tell
    """
    orders = np.arange(1, len(runs) // 2 + 1)
    valid = orders[stats.binom.cdf(len(runs) - 2 * orders, len(runs), coverage) >= confidence]
    if not len(valid):
        return np.nan, np.nan
    ordered = np.sort(runs)
    return float(ordered[valid[-1] - 1]), float(ordered[-valid[-1]])


def holm(p_values: np.ndarray) -> np.ndarray:
    """
    :param p_values: of several tests
    :return: corrected after Holm (1979), in the same order
    """
    order = np.argsort(p_values)
    corrected = np.empty(len(order))
    corrected[order] = np.minimum(np.maximum.accumulate(np.arange(len(order), 0, -1) * p_values[order]), 1.0)
    return corrected


def rescaled(means: np.ndarray, all_means: np.ndarray) -> np.ndarray:
    """
    Scores that can be compared between environments (Adkins, Bowling and White, 2024).

    :param means: of the settings of a rule, of shape (settings, environments)
    :param all_means: of all settings of all rules
    :return: ``means``, in each environment 0 at the 5th and 1 at the 95th percentile of all
    """
    low, high = np.percentile(all_means, [5.0, 95.0], axis=0)
    return (means - low) / np.where(high > low, high - low, 1.0)


def sensitivity(gamma: np.ndarray) -> float:
    """
    :param gamma: rescaled scores of a rule, of shape (settings, environments)
    :return: what one setting for all environments costs against the best in each (Adkins et al., 2024); 0 if nothing
    """
    return float(gamma.max(axis=0).mean() - gamma.mean(axis=1).max())


def effective_dimension(gamma: np.ndarray, settings: Sequence[Mapping[str, Any]], share: float = 0.95) -> int:
    """
    :param gamma: rescaled scores of a rule, of shape (settings, environments)
    :param settings: the parameters by name, of each setting
    :param share: of the best that is to be kept
    :return: how many parameters have to be tuned in each environment to keep that share, the others being tuned once
    """
    names = list(dict.fromkeys(name for setting in settings for name in setting))
    best = gamma.max(axis=0).mean()
    for size in range(len(names)):
        for tuned in combinations(names, size):
            groups: dict[tuple[Any, ...], list[int]] = {}
            for i, setting in enumerate(settings):
                groups.setdefault(tuple(setting.get(name) for name in names if name not in tuned), []).append(i)
            if max(gamma[group].max(axis=0).mean() for group in groups.values()) >= share * best:
                return size
    return len(names)


def area_over_grid(gamma: np.ndarray) -> float:
    """
    :param gamma: rescaled scores of a rule, of shape (settings, environments)
    :return: what a setting chosen at random is worth
    """
    return float(gamma.mean())


def share_near_best(means: np.ndarray, share: float = 0.95) -> float:
    """
    :param means: scores of the settings of a rule in an environment, of shape (settings,)
    :param share: of the best score
    :return: how many of the settings reach that share of the best one's score
    """
    best = means.max()
    return float((means >= best - (1.0 - share) * abs(best)).mean())
