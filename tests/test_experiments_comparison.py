"""Tests and intervals of methods whose runs are independent, against worked values, published examples and error rates."""

import math
from itertools import combinations

import numpy as np
import pytest
from scipy import stats
from statsmodels.stats.multitest import multipletests

from sb3_adaptive_q.experiments.paper.comparison import (
    compare_pairs,
    estimate,
    interquartile_mean,
    kruskal_wallis,
    mean,
    population_std,
    probability_best,
    share,
)
from sb3_adaptive_q.experiments.paper.results import make_series, trailing_mean


def named(**samples: list[float]) -> dict[str, np.ndarray]:
    return {name: np.array(values) for name, values in samples.items()}


def test_kruskal_wallis_of_a_published_example() -> None:
    """
    Mucociliary efficiency of normal subjects, of patients with obstructive airways disease and with asbestosis (Hollander and
    Wolfe, 1973, table 6.2): H = 0.771, and of chi-squared with two degrees of freedom as much or more has 0.68.
    """
    samples = named(normal=[2.9, 3.0, 2.5, 2.6, 3.2], obstructive=[3.8, 2.7, 4.0, 2.4], asbestosis=[2.8, 3.4, 3.7, 2.2, 2.0])
    assert kruskal_wallis(samples) == pytest.approx(math.exp(-0.7714 / 2.0), abs=5e-4)


def test_kruskal_wallis_of_equal_values_finds_nothing() -> None:
    assert kruskal_wallis(named(a=[1.0] * 5, b=[1.0] * 5, c=[1.0] * 4)) == 1.0


def test_holm_of_separated_samples() -> None:
    """Exact Mann-Whitney of 5 against 5 without overlap: 2 / C(10, 5), times 3 for the three pairs."""
    samples = {"1": np.arange(5.0), "2": 10 + np.arange(5.0), "3": 20 + np.arange(5.0)}
    pairs = compare_pairs(samples)
    assert [(pair.first, pair.second, pair.difference) for pair in pairs] == [
        ("1", "2", -10),
        ("1", "3", -20),
        ("2", "3", -10),
    ]
    assert [pair.p_value for pair in pairs] == pytest.approx([3 * 2 / math.comb(10, 5)] * 3)
    assert [pair.improvement for pair in pairs] == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("seed", range(5))
def test_holm_is_that_of_statsmodels(seed: int) -> None:
    generator = np.random.default_rng(seed)
    samples = {str(number): generator.normal(0.4 * number, 1, 8) for number in range(1, 6)}
    raw = [stats.mannwhitneyu(samples[a], samples[b], method="exact").pvalue for a, b in combinations(samples, 2)]
    expected = multipletests(raw, method="holm")[1]
    assert [pair.p_value for pair in compare_pairs(samples)] == pytest.approx(expected)


def test_ties_count_half_in_the_improvement() -> None:
    (pair,) = compare_pairs(named(first=[0.0, 1.0, 1.0, 1.0], second=[0.0, 0.0, 1.0, 1.0]))
    wins, ties = 3 * 2, 1 * 2 + 3 * 2  # of 16 couples
    assert pair.improvement == (wins + ties / 2) / 16


def test_pairs_of_equal_samples_are_not_told_apart() -> None:
    (pair,) = compare_pairs(named(first=[200.0] * 20, second=[200.0] * 20))
    assert pair.p_value == 1.0 and not pair.is_significant and pair.improvement == 0.5


def test_tests_are_wrong_as_seldom_as_they_say() -> None:
    """Of 100 comparisons of eight equal methods at most 5% may find any pair: more than 13 has probability 2e-4."""
    generator = np.random.default_rng(1)
    found = 0
    for _ in range(100):
        samples = {str(number): generator.normal(size=20) for number in range(1, 9)}
        found += any(pair.is_significant for pair in compare_pairs(samples))
    assert found <= 13


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
    assert np.isnan(estimate(interquartile_mean, np.array([1.0]))[1:]).all()
    assert np.isnan(list(probability_best(named(first=[1.0], second=[0.0])).values())).all()


def test_interquartile_mean_is_that_of_the_middle_half() -> None:
    sample = np.array([-1000.0, 2, 3, 4, 5, 6, 7, 1000])
    value, low, high = estimate(interquartile_mean, sample)
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
    chances = probability_best({"first": first, "second": second})
    assert chances["second"] == pytest.approx(stats.norm.cdf(z), abs=0.02)
    assert sum(chances.values()) == pytest.approx(1.0)


def test_probability_best_is_shared_in_ties() -> None:
    chances = probability_best(named(a=[200.0] * 5, b=[200.0] * 5, c=[0.0] * 5, d=[200.0] * 5))
    assert chances == pytest.approx({"a": 1 / 3, "b": 1 / 3, "c": 0.0, "d": 1 / 3})


def test_trailing_mean_by_hand() -> None:
    values = np.arange(250.0)
    found = trailing_mean(values)
    assert found[0] == 0.0 and found[9] == 4.5
    assert found[249] == pytest.approx(np.mean(values[150:250]))


def test_curves_are_means_with_bootstrap_intervals_over_the_runs() -> None:
    """The bootstrap of a mean has the variance of the sample over the runs: here the ends of normal theory, within a tenth."""
    runs = np.random.default_rng(5).random((40, 250))
    series = make_series(list(runs), list(2 * runs))
    assert series.returns == pytest.approx(runs.mean(axis=0)) and series.mu == pytest.approx(2 * runs.mean(axis=0))
    last = runs[:, -100:].mean(axis=1)
    assert series.curve_episodes[-1] == 250 and series.curve[-1] == pytest.approx(last.mean())
    margin = 1.96 * last.std() / 40**0.5
    assert [series.low[-1], series.high[-1]] == pytest.approx([last.mean() - margin, last.mean() + margin], abs=0.1 * margin)


def test_curve_of_one_run_has_no_interval() -> None:
    assert np.isnan(make_series([np.ones(200)], [np.ones(200)]).low).all()
