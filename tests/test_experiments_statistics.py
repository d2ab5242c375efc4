"""Statistics over runs, against rliable, published examples, hand-worked matrices and stated error rates."""

import math
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays as numpy_arrays
from statsmodels.stats.multitest import multipletests

from sb3_adaptive_q.experiments.statistics import (
    Comparison,
    aggregates,
    area_over_grid,
    bootstrap,
    bootstrap_aggregates,
    compare_with,
    effective_dimension,
    holm,
    improvement_matrix,
    interquartile_mean,
    interval,
    mean,
    optimality_gap,
    performance_profile,
    probability_of_improvement,
    rank_intervals,
    rescaled,
    resampled,
    sensitivity,
    share_near_best,
    tolerance_interval,
)

#: Three runs of two tasks, and a rule that is better by 1 in the first task
HAND = np.array([[0.0, 10.0], [1.0, 20.0], [2.0, 60.0]])
BETTER = HAND + np.array([1.0, 0.0])


def matrices(seed: int, runs: int = 12, tasks: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """Two matrices of scores, some of them tied."""
    generator = np.random.default_rng(seed)
    return tuple(generator.normal(shift, 1.0, (runs, tasks)).round(1) for shift in (0.0, 0.4))  # type: ignore[return-value]


# Aggregates


def test_aggregates_by_hand() -> None:
    assert mean(HAND) == pytest.approx(93.0 / 6.0)
    # Of six values the least and the largest are cut
    assert interquartile_mean(HAND) == pytest.approx((1.0 + 2.0 + 10.0 + 20.0) / 4.0)
    assert optimality_gap(HAND) == pytest.approx(1.0 - (0.0 + 1.0 + 1.0 + 3.0) / 6.0)


@pytest.mark.parametrize("seed", range(5))
def test_aggregates_are_those_of_rliable(seed: int) -> None:
    metrics = pytest.importorskip("rliable.metrics")
    for scores in matrices(seed, runs=3 + seed):
        assert interquartile_mean(scores) == pytest.approx(metrics.aggregate_iqm(scores))
        assert mean(scores) == pytest.approx(metrics.aggregate_mean(scores))
        assert optimality_gap(scores) == pytest.approx(metrics.aggregate_optimality_gap(scores))


@pytest.mark.parametrize("seed", range(5))
def test_probability_of_improvement_is_that_of_rliable(seed: int) -> None:
    metrics = pytest.importorskip("rliable.metrics")
    first, second = matrices(seed)
    assert probability_of_improvement(first, second) == pytest.approx(metrics.probability_of_improvement(first, second))


def test_profile_is_that_of_rliable() -> None:
    library = pytest.importorskip("rliable.library")
    first, second = matrices(0)
    thresholds = np.linspace(-2.0, 2.0, 21)
    expected, _ = library.create_performance_profile({"first": first, "second": second}, thresholds, reps=2)
    assert performance_profile(np.stack([first, second]), thresholds) == pytest.approx(
        np.stack([expected["first"], expected["second"]])
    )


def test_intervals_are_those_of_rliable() -> None:
    """The two draw differently: at 4 000 samples the ends of intervals have a standard error of some 0.01."""
    library, metrics = pytest.importorskip("rliable.library"), pytest.importorskip("rliable.metrics")
    scores = np.stack(matrices(1, runs=20))
    _, expected = library.get_interval_estimates(
        {"rule": scores[0]}, lambda x: np.array([metrics.aggregate_iqm(x)]), reps=4000, random_state=np.random.RandomState(0)
    )
    estimate = interval(interquartile_mean(scores)[0], bootstrap(scores, interquartile_mean, 4000)[:, 0])
    assert [estimate.low, estimate.high] == pytest.approx(expected["rule"].ravel(), abs=0.05)
    assert estimate.low < estimate.value < estimate.high


# The bootstrap


def test_bootstrap_draws_runs_within_each_task() -> None:
    """Axes (runs, tasks): no value of one task is ever drawn into another, as with the axes swapped."""
    for batch in resampled(np.stack([HAND, BETTER]), 250):
        assert np.isin(batch[:, 0, :, 0], HAND[:, 0]).all() and np.isin(batch[:, 0, :, 1], HAND[:, 1]).all()


def test_bootstrap_keeps_the_seeds_of_two_rules_together() -> None:
    for batch in resampled(np.stack([HAND, BETTER]), 50):
        assert np.array_equal(batch[:, 1] - batch[:, 0], np.broadcast_to([1.0, 0.0], batch[:, 0].shape))


@given(
    numpy_arrays(float, st.tuples(st.integers(1, 4), st.integers(1, 7), st.integers(1, 5)), elements=st.floats(-3.0, 3.0)),
    st.integers(1, 150),
)
@settings(max_examples=60)
def test_counted_samples_have_the_aggregates_of_copied_ones(scores: np.ndarray, resamples: int) -> None:
    np.testing.assert_allclose(
        bootstrap_aggregates(scores, resamples), bootstrap(scores, aggregates, resamples), rtol=0.0, atol=1e-12
    )


def test_rules_whose_runs_differ_in_few_outliers_share_a_rank() -> None:
    """The middle half is the same, so every bootstrap sample is a tie, whatever the order in which it is summed."""
    scores = np.full((3, 100, 1), 0.9987)
    scores[1, ::10], scores[2, 5::20] = 0.0, 0.3
    samples = bootstrap_aggregates(scores, 500)[..., 0]
    assert (samples == samples[:, :1]).all()
    assert rank_intervals(interquartile_mean(scores), samples) == [(1, 1, 1)] * 3


def test_bootstrap_of_the_mean_has_the_variance_of_theory() -> None:
    """Var of the mean over tasks = mean of the tasks' population variances / (runs x tasks)."""
    scores = np.random.default_rng(3).normal(size=(1, 30, 4)) * [1.0, 2.0, 3.0, 4.0]
    samples = bootstrap(scores, mean, 8000)
    assert samples.shape == (8000, 1)
    assert samples.var() == pytest.approx(scores[0].var(axis=0).mean() / (30 * 4), rel=0.05)


def test_interval_covers_as_often_as_it_says() -> None:
    """Of 100 intervals at 95% fewer than 87 cover with probability 1e-3; the percentile interval is a little narrow."""
    generator = np.random.default_rng(4)
    covering = 0
    for _ in range(100):
        scores = generator.normal(1.0, 1.0, (1, 25, 4))
        _, low, high = interval(mean(scores)[0], bootstrap(scores, mean, 400)[:, 0])
        covering += low <= 1.0 <= high
    assert covering >= 86


def test_aggregates_are_side_by_side() -> None:
    assert aggregates(HAND) == pytest.approx([interquartile_mean(HAND), mean(HAND), optimality_gap(HAND)])


# Paired comparison


def compared(scores: np.ndarray, resamples: int) -> dict[int, Comparison]:
    return compare_with(0, interquartile_mean(scores), bootstrap(scores, interquartile_mean, resamples))


def ranked(scores: np.ndarray, resamples: int) -> list[tuple[int, int, int]]:
    return rank_intervals(interquartile_mean(scores), bootstrap(scores, interquartile_mean, resamples))


def test_comparison_by_seed_is_sharper_than_the_runs_are_noisy() -> None:
    """Runs that differ by 100 between seeds, and by 1 between rules with the same seed."""
    generator = np.random.default_rng(5)
    noise = generator.normal(0.0, 100.0, (40, 3))
    scores = np.stack([noise, noise + generator.normal(1.0, 0.1, noise.shape), noise])
    comparisons = compared(scores, 1000)
    assert set(comparisons) == {1, 2}
    assert comparisons[1].is_significant and 0.8 < comparisons[1].difference.low < comparisons[1].difference.high < 1.2
    assert not comparisons[2].is_significant and comparisons[2].difference.value == 0.0 and comparisons[2].p_value == 1.0


def test_comparisons_are_wrong_as_seldom_as_they_say() -> None:
    """Of 100 leagues of six equal rules at most 5% may tell any from the first: more than 13 has probability 1e-4."""
    generator = np.random.default_rng(6)
    found = 0
    for _ in range(100):
        comparisons = compared(generator.normal(size=(6, 25, 2)), 400)
        found += any(comparison.is_significant for comparison in comparisons.values())
    assert found <= 13


@pytest.mark.parametrize("seed", range(5))
def test_holm_is_that_of_statsmodels(seed: int) -> None:
    p_values = np.random.default_rng(seed).random(7) ** 3
    assert holm(p_values) == pytest.approx(multipletests(p_values, method="holm")[1])


def test_ranks_have_intervals() -> None:
    generator = np.random.default_rng(7)
    # The last two are equal; the first is far ahead
    scores = np.stack([generator.normal(center, 1.0, (30, 4)) for center in (9.0, 0.0, 0.0)])
    assert ranked(scores, 500)[0] == (1, 1, 1)
    assert sorted(ranked(scores, 500)[1:]) == [(2, 2, 3), (3, 2, 3)]


def test_equal_rules_share_a_rank() -> None:
    assert ranked(np.stack([HAND, HAND]), 50) == [(1, 1, 1), (1, 1, 1)]


def test_improvement_by_hand() -> None:
    """First task: 2 of 3 x 3 wins short of all but ties; second: all ties count half."""
    # Pairs of (0, 1, 2) + 1 against (0, 1, 2): six wins, two ties, one loss
    assert probability_of_improvement(BETTER, HAND) == pytest.approx(((6 + 2 / 2) / 9 + 1 / 2) / 2)


def test_improvement_matrix_is_that_of_pairs_and_its_own_mirror() -> None:
    scores = np.stack([*matrices(0), matrices(1)[0]])
    matrix = improvement_matrix(scores, 300)
    for i, j in combinations(range(3), 2):
        assert matrix[i][j].value == pytest.approx(probability_of_improvement(scores[i], scores[j]))
        assert matrix[j][i].value == pytest.approx(1.0 - matrix[i][j].value)
        assert matrix[i][j].low < matrix[i][j].value < matrix[i][j].high
        assert matrix[j][i].low == pytest.approx(1.0 - matrix[i][j].high)
    assert matrix[1][1] == (0.5, 0.5, 0.5)


def test_improvement_intervals_are_those_of_drawn_scores() -> None:
    """The weights of the wins are the same bootstrap as drawing the runs: their spreads agree within 4 standard errors."""
    scores = np.stack(matrices(2, runs=15, tasks=3))
    drawn = [probability_of_improvement(*sample) for batch in resampled(scores, 2000, seed=1) for sample in batch]
    estimate = improvement_matrix(scores, 2000)[0][1]
    assert [estimate.low, estimate.high] == pytest.approx(np.quantile(drawn, [0.025, 0.975]), abs=0.02)


# Tolerance intervals


@pytest.mark.parametrize(("runs", "orders"), [(100, (2, 99)), (200, (6, 195))])
def test_tolerance_interval_has_the_published_order_statistics(runs: int, orders: tuple[int, int]) -> None:
    """Patterson et al. (2024): of 100 runs the 2nd and the 99th, of 200 the 6th and the 195th."""
    values = np.random.default_rng(8).permutation(runs) + 1.0
    assert tolerance_interval(values) == orders


def test_tolerance_interval_covers_what_it_says() -> None:
    generator = np.random.default_rng(9)
    held = 0
    for _ in range(400):
        low, high = tolerance_interval(generator.random(100))
        held += high - low >= 0.9
    # 95% or more of 400 expected; 368 or fewer has probability 1e-2 at exactly 95%, and here it is 97.6%
    assert held > 368


def test_few_runs_have_no_tolerance_interval() -> None:
    assert math.isnan(tolerance_interval(np.arange(20.0))[0])


# Sensitivity


def test_sensitivity_by_hand() -> None:
    gamma = np.array([[1.0, 0.0], [0.6, 0.6], [0.0, 0.8]])
    assert sensitivity(gamma) == pytest.approx((1.0 + 0.8) / 2.0 - 0.6)
    assert area_over_grid(gamma) == pytest.approx(3.0 / 6.0)
    assert share_near_best(np.array([1.0, 0.96, 0.9])) == pytest.approx(2 / 3)
    assert share_near_best(np.array([-1.0, -1.04, -2.0])) == pytest.approx(2 / 3)


def test_one_setting_that_is_best_everywhere_costs_nothing() -> None:
    assert sensitivity(np.array([[0.9, 0.8], [0.1, 0.2]])) == 0.0


def test_effective_dimension_by_hand() -> None:
    """Two parameters, two environments: which of them has to be tuned in each decides."""
    settings = [{"a": a, "b": b} for a in (1, 2) for b in (1, 2)]
    assert effective_dimension(np.array([[1.0, 1.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]]), settings) == 0
    # With b = 1 fixed, a = 1 is best in the first and a = 2 in the second
    assert effective_dimension(np.array([[1.0, 0.0], [0.0, 0.0], [0.0, 1.0], [0.0, 0.0]]), settings) == 1
    # Both must change
    assert effective_dimension(np.array([[1.0, 0.0], [0.0, 0.0], [0.0, 0.0], [0.0, 1.0]]), settings) == 2


def test_rescaled_scores_are_between_the_percentiles_of_all() -> None:
    everything = np.linspace(0.0, 100.0, 101)[:, None] * [1.0, 0.0]
    assert rescaled(np.array([[5.0, 0.0], [50.0, 0.0], [95.0, 0.0]]), everything) == pytest.approx(
        np.array([[0.0, 0.0], [0.5, 0.0], [1.0, 0.0]])
    )
