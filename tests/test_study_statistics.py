"""The statistics of a study, against worked values, published examples and stated error rates."""

import math
from itertools import combinations

import gymnasium as gym
import numpy as np
import pytest
from scipy import stats
from statsmodels.stats.multitest import multipletests

from sb3_adaptive_q.study.lake import lake_map, optimal_values
from sb3_adaptive_q.study.results import _Sums, trailing_mean
from sb3_adaptive_q.study.statistics import (
    compare_pairs,
    estimate,
    friedman,
    interquartile_mean,
    mean,
    population_std,
    probability_best,
    share,
)

#: Seconds to round first base, 22 players by three ways (Hollander and Wolfe, 1973, table 7.1)
ROUNDING = """
5.40 5.50 5.55  5.85 5.70 5.75  5.20 5.60 5.50  5.55 5.50 5.40  5.90 5.85 5.70  5.45 5.55 5.60
5.40 5.40 5.35  5.45 5.50 5.35  5.25 5.15 5.00  5.85 5.80 5.70  5.25 5.20 5.10  5.65 5.55 5.45
5.60 5.35 5.45  5.05 5.00 4.95  5.50 5.50 5.40  5.45 5.55 5.50  5.55 5.55 5.35  5.45 5.50 5.55
5.50 5.45 5.25  5.65 5.60 5.40  5.70 5.65 5.55  6.30 6.30 6.25
"""


def test_friedman_of_a_published_example() -> None:
    columns = np.array(ROUNDING.split(), float).reshape(22, 3).T
    assert friedman(dict(enumerate(columns))) == pytest.approx(0.003805, abs=5e-7)


def test_friedman_of_equal_values_finds_nothing() -> None:
    assert friedman({number: np.ones(5) for number in (1, 2, 3)}) == 1.0


def test_holm_of_separated_samples() -> None:
    """Exact Mann-Whitney of 5 against 5 without overlap: 2 / C(10, 5), times 3 for the three pairs."""
    samples = {1: np.arange(5.0), 2: 10 + np.arange(5.0), 3: 20 + np.arange(5.0)}
    pairs = compare_pairs(samples)
    assert [(pair.first, pair.second, pair.difference) for pair in pairs] == [(1, 2, -10), (1, 3, -20), (2, 3, -10)]
    assert [pair.p_value for pair in pairs] == pytest.approx([3 * 2 / math.comb(10, 5)] * 3)
    assert [pair.improvement for pair in pairs] == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("seed", range(5))
def test_holm_is_that_of_statsmodels(seed: int) -> None:
    generator = np.random.default_rng(seed)
    samples = {number: generator.normal(0.4 * number, 1, 8) for number in range(1, 6)}
    raw = [stats.mannwhitneyu(samples[a], samples[b], method="exact").pvalue for a, b in combinations(samples, 2)]
    expected = multipletests(raw, method="holm")[1]
    assert [pair.p_value for pair in compare_pairs(samples)] == pytest.approx(expected)


def test_ties_count_half_in_the_improvement() -> None:
    (pair,) = compare_pairs({1: np.array([0.0, 1.0, 1.0, 1.0]), 2: np.array([0.0, 0.0, 1.0, 1.0])})
    wins, ties = 3 * 2, 1 * 2 + 3 * 2  # of 16 couples
    assert pair.improvement == (wins + ties / 2) / 16


def test_pairs_of_equal_samples_are_not_told_apart() -> None:
    (pair,) = compare_pairs({1: np.full(20, 200.0), 7: np.full(20, 200.0)})
    assert pair.p_value == 1.0 and not pair.is_significant and pair.improvement == 0.5


def test_tests_are_wrong_as_seldom_as_they_say() -> None:
    """Of 300 comparisons of eight equal methods at most 5% may find any pair: more than 30 has probability 2e-4."""
    generator = np.random.default_rng(1)
    found = 0
    for _ in range(300):
        samples = {number: generator.normal(size=20) for number in range(1, 9)}
        found += any(pair.is_significant for pair in compare_pairs(samples))
    assert found <= 30


def test_interval_of_the_mean_covers_it_as_often_as_it_says() -> None:
    """A percentile bootstrap of 20 values covers in about 93% of cases: below 170 of 200 has probability 1e-4."""
    generator = np.random.default_rng(2)
    intervals = [estimate(mean, generator.normal(3.0, 1.0, 20)) for _ in range(200)]
    assert 170 <= sum(low <= 3.0 <= high for _, low, high in intervals) <= 199


def test_interval_of_the_mean_is_as_wide_as_normal_theory_has_it() -> None:
    sample = np.random.default_rng(3).normal(size=400)
    _, low, high = estimate(mean, sample)
    assert high - low == pytest.approx(2 * 1.96 * sample.std() / 20, rel=0.05)


def test_standard_deviation_has_divisor_n() -> None:
    assert estimate(population_std, np.array([0.0, 0.0, 1.0, 1.0])).value == 0.5
    # The paper's own: seven of twenty runs at 1 make avg 0.35 and std 0.47
    assert estimate(population_std, np.repeat([0.0, 1.0], [13, 7])).value == pytest.approx(math.sqrt(0.35 * 0.65))


def test_equal_values_have_an_interval_of_no_width() -> None:
    for statistic in (mean, population_std):
        value, low, high = estimate(statistic, np.full(20, 200.0))
        assert value == low == high


def test_one_run_has_no_interval() -> None:
    assert np.isnan(estimate(mean, np.array([1.0]))[1:]).all()
    assert np.isnan(interquartile_mean(np.array([1.0]))[1:]).all()
    assert np.isnan(list(probability_best({1: np.array([1.0]), 2: np.array([0.0])}).values())).all()


def test_interquartile_mean_is_that_of_the_middle_half() -> None:
    sample = np.array([-1000.0, 2, 3, 4, 5, 6, 7, 1000])
    value, low, high = interquartile_mean(sample)
    assert value == (3 + 4 + 5 + 6) / 4
    assert low <= value <= high


def test_share_has_wilsons_interval() -> None:
    """Newcombe (1998), table I: 81 of 263 gives 0.2553 to 0.3662, and 1 of 29 gives 0.0061 to 0.1718."""
    assert share(81, 263) == pytest.approx((81 / 263, 0.2553, 0.3662), abs=5e-5)
    assert share(1, 29) == pytest.approx((1 / 29, 0.0061, 0.1718), abs=5e-5)


def test_probability_best_is_that_of_normal_theory() -> None:
    generator = np.random.default_rng(4)
    first, second = generator.normal(0.0, 1.0, 200), generator.normal(0.1, 1.0, 200)
    z = (second.mean() - first.mean()) / math.hypot(first.std() / 200**0.5, second.std() / 200**0.5)
    chances = probability_best({3: first, 5: second})
    assert chances[5] == pytest.approx(stats.norm.cdf(z), abs=0.02)
    assert sum(chances.values()) == pytest.approx(1.0)


def test_probability_best_is_shared_in_ties() -> None:
    chances = probability_best({1: np.full(5, 200.0), 2: np.full(5, 200.0), 3: np.zeros(5), 4: np.full(5, 200.0)})
    assert chances == pytest.approx({1: 1 / 3, 2: 1 / 3, 3: 0.0, 4: 1 / 3})


def test_trailing_mean_by_hand() -> None:
    values = np.arange(250.0)
    found = trailing_mean(values)
    assert found[0] == 0.0 and found[9] == 4.5
    assert found[249] == pytest.approx(np.mean(values[150:250]))


def test_curves_are_means_and_student_intervals_over_the_runs() -> None:
    generator = np.random.default_rng(5)
    runs = generator.random((7, 250))
    sums = _Sums(250)
    for run in runs:
        sums.add(run, 2 * run)
    series = sums.series()
    assert series.returns == pytest.approx(runs.mean(axis=0)) and series.mu == pytest.approx(2 * runs.mean(axis=0))
    last = [run[-100:].mean() for run in runs]
    low, high = stats.ttest_1samp(last, 0.0).confidence_interval(0.95)
    assert series.curve_episodes[-1] == 250
    assert (series.curve - series.curve_margin)[-1] == pytest.approx(low)
    assert (series.curve + series.curve_margin)[-1] == pytest.approx(high)


def test_optimal_values_solve_the_bellman_equation_and_are_the_known_ones() -> None:
    values, table = optimal_values("FrozenLake-v1", 0.99), gym.make("FrozenLake-v1").unwrapped.P
    for state, action in np.ndindex(16, 4):
        expected = sum(p * (r + (0.0 if end else 0.99 * values[s].max())) for p, s, r, end in table[state][action])
        assert values[state, action] == pytest.approx(expected, abs=1e-10)
    # Of the slippery 4x4 lake at this discount
    assert values[0].max() == pytest.approx(0.542, abs=5e-4) and values[14].max() == pytest.approx(0.863, abs=5e-4)


def test_map_of_the_lake_is_the_papers() -> None:
    letters = lake_map("FrozenLake-v1")
    assert letters is not None and ["".join(row) for row in letters] == ["SFFF", "FHFH", "FFFH", "HFFG"]
    assert lake_map("Taxi-v4") is None
