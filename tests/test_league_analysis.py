"""What the runs of a league add up to, from runs made up so that the right answer is known."""

import re

import numpy as np
import pytest

from sb3_adaptive_q.experiments.league.analysis import (
    Scores,
    chosen_places,
    collect,
    of_tasks,
    runs_frame,
    sensitivities,
    standings,
)
from sb3_adaptive_q.experiments.league.findings import findings, paper_finding
from sb3_adaptive_q.experiments.league.plan import CHOICES, CLIP, Runs
from sb3_adaptive_q.experiments.league.settings import Contestant, Task, Track

RUNS, CHECKPOINTS = 40, 25
TASKS = (
    Task("still", "lake4", "deterministic", 100, 0.99),
    Task("noisy", "lake8", "noisy rewards", 100, 0.99),
    Task("moving", "moving_goal", "moving", 100, 0.99),
)
RULES = (
    Contestant("constant", "tabular_q", "constant", ({"alpha": 0.1}, {"alpha": 0.5})),
    Contestant("polynomial", "tabular_q", "polynomial", ({"omega": 0.8},)),
    Contestant("bakf", "tabular_q", "bakf", ({"nu_target": 0.05},)),
    Contestant("Method 1", "tabular_q", "1", ({},)),
    Contestant("Method 7", "tabular_q", "7", ({},)),
)
TRACK = Track("B", "module:measure", {}, TASKS, RULES)
#: Mean scores of rule, setting and task
MEANS = {
    (0, 0): (0.5, 0.5, 0.5),
    (0, 1): (0.8, 0.1, 0.1),
    (1, 0): (0.6, 0.65, 0.2),
    (2, 0): (0.8, 0.8, 0.1),
    (3, 0): (0.1, 0.1, 0.1),
    (4, 0): (0.2, 0.2, 0.2),
}


def made_up(seed: int) -> dict[tuple[int, int, int], Runs]:
    """Runs around these means; the later checkpoints are better by 0.2 than the earlier ones."""
    generator = np.random.default_rng(seed)
    runs = {}
    for (rule, setting), means in MEANS.items():
        for task, mean in enumerate(means):
            scores = mean + generator.normal(0.0, 0.02, (RUNS, CHECKPOINTS)) + np.linspace(-0.1, 0.1, CHECKPOINTS)
            runs[rule, setting, task] = Runs(scores, scores.mean(axis=1) - 0.05, [])
    return runs


@pytest.fixture(scope="module")
def chosen() -> dict[str, np.ndarray]:
    return chosen_places(TRACK, made_up(0))


@pytest.fixture(scope="module")
def scores(chosen: dict[str, np.ndarray]) -> Scores:
    return collect(TRACK, chosen["one for all"], made_up(1))


def test_settings_are_chosen_from_the_tuning_runs_in_three_ways(chosen: dict[str, np.ndarray]) -> None:
    assert set(chosen) == set(CHOICES)
    assert chosen["default"].tolist() == [[0, 0, 0]] * 5
    assert chosen["per environment"][0].tolist() == [1, 0, 0]
    # Left out the first, where the second setting shines, the first setting is best; and it is best on average too
    assert chosen["one for all"][0].tolist() == [0, 0, 0]


def test_scores_have_a_row_a_rule_and_a_column_a_task(scores: Scores) -> None:
    assert scores.anytime.shape == (5, RUNS, 3) and scores.curves.shape == (CHECKPOINTS, 5, RUNS, 3)
    assert scores.anytime.mean(axis=1)[2] == pytest.approx([0.8, 0.8, 0.1], abs=0.01)
    assert scores.curves.mean(axis=0) == pytest.approx(scores.anytime)
    assert scores.online == pytest.approx(scores.anytime - 0.05)


def test_final_score_is_that_of_the_last_three_checkpoints_where_there_is_an_end(scores: Scores) -> None:
    assert scores.final.shape == (5, RUNS, 2)
    assert scores.final.mean(axis=1)[2] == pytest.approx([0.8917, 0.8917], abs=0.01)  # 0.8 + 0.1 - 0.2 / 24


def test_return_that_is_not_defined_is_left_out(chosen: dict[str, np.ndarray]) -> None:
    runs = made_up(1)
    runs = {place: each._replace(online=each.online * (np.nan if place[2] == 1 else 1.0)) for place, each in runs.items()}
    assert collect(TRACK, chosen["default"], runs).online.shape == (5, RUNS, 2)


def test_failures_are_counted_and_never_dropped(chosen: dict[str, np.ndarray]) -> None:
    runs = made_up(1)
    failed = runs[2, 0, 1].scores.copy()
    failed[:10] = 0.0
    runs[2, 0, 1] = Runs(failed, failed.mean(axis=1), ["ValueError: no number"] * 10)
    broken = collect(TRACK, chosen["default"], runs)
    assert broken.failures.tolist()[2] == [0, 10, 0]
    assert broken.anytime[2, :, 1].mean() == pytest.approx(0.8 * 30 / 40, abs=0.01)
    rows = standings(TRACK, broken, 200)
    assert {row.label: row.failures for row in rows}["bakf"] == 10


def test_disasters_are_clipped_in_the_scores_and_not_in_the_data(chosen: dict[str, np.ndarray]) -> None:
    runs = made_up(1)
    runs[3, 0, 0] = Runs(np.full((RUNS, CHECKPOINTS), -1000.0), np.full(RUNS, -1000.0), [])
    collected = collect(TRACK, chosen["default"], runs)
    assert (collected.anytime[3, :, 0] == CLIP[0]).all() and (collected.online[3, :, 0] == CLIP[0]).all()
    frame = runs_frame(TRACK, runs, range(1000, 1000 + RUNS), "evaluation")
    disasters = frame[(frame["rule"] == "Method 1") & (frame["environment"] == "still")]
    assert len(disasters) == RUNS and disasters["scores"].iloc[0].min() == -1000.0
    assert disasters["seed"].tolist() == list(range(1000, 1000 + RUNS))


def test_standings_have_the_best_first_and_compare_it_with_the_references(scores: Scores) -> None:
    """Of 120 runs around 0.8, 0.8 and 0.1 the middle 60 are 50 around 0.8 and 10 around 0.1: 0.683."""
    rows = standings(TRACK, scores, 400)
    assert [row.label for row in rows] == ["bakf", "polynomial", "constant", "Method 7", "Method 1"]
    assert [row.rank for row in rows] == [(i, i, i) for i in (1, 2, 3, 4, 5)]
    best = rows[0]
    assert best.score.value == pytest.approx(0.683, abs=0.01)
    assert best.score.low < best.score.value < best.score.high and best.setting == "as published"
    assert set(best.comparisons) == {"constant", "polynomial"}
    difference = best.comparisons["constant"]
    assert difference.is_significant and difference.difference.value == pytest.approx(best.score.value - rows[2].score.value)
    assert "constant" not in rows[2].comparisons and rows[2].setting == "alpha = 0.1"


def test_sensitivity_is_that_of_the_settings(scores: Scores) -> None:
    """One setting for all costs the constant step size what the second is better in the first task, over three tasks."""
    constant, polynomial, *_ = sensitivities(TRACK, made_up(0))
    assert constant.gamma.shape == (2, 3) and constant.dimension == 1
    assert constant.loss == pytest.approx((constant.gamma[1, 0] - constant.gamma[0, 0]) / 3.0)
    assert constant.area == pytest.approx(constant.gamma.mean()) and constant.near_best == pytest.approx(0.5)
    assert polynomial.loss == 0.0 and polynomial.dimension == 0 and polynomial.near_best == 1.0


def test_scores_in_some_tasks(scores: Scores) -> None:
    part = of_tasks(scores, [2])
    assert part.anytime.shape == (5, RUNS, 1) and part.curves.shape == (CHECKPOINTS, 5, RUNS, 1)
    assert standings(TRACK._replace(tasks=(TASKS[2],)), part, 200)[0].label == "constant"


def test_findings_name_the_best_rule_of_every_kind_with_numbers(scores: Scores) -> None:
    everywhere, still, noisy, moving = findings(TRACK, scores, standings(TRACK, scores, 400), 400)
    assert everywhere.startswith("**Over all environments together** (still, noisy, moving), take **bakf**")
    assert "**Where everything is deterministic** (still), take **bakf** (as published): its score is 0.80 [" in still
    assert re.search(r"0\.30 \[.*\] above constant, 0\.20 \[.*\] above polynomial\. ", still)
    assert "Every other rule is significantly different." in still
    assert noisy.startswith("**Where rewards are noisy** (noisy), take **bakf**")
    assert moving.startswith("**Where the goal or the rewards move** (moving), take **constant** (alpha = 0.1)")
    assert "above polynomial" in moving and "above constant" not in moving


def test_rules_that_are_not_told_apart_are_named(chosen: dict[str, np.ndarray]) -> None:
    runs = made_up(1)
    runs |= {(2, 0, task): runs[1, 0, task] for task in range(3)}
    equal = collect(TRACK, chosen["default"], runs)
    text = findings(TRACK, equal, standings(TRACK, equal, 400), 400)[2]
    assert "take **bakf**" in text and "Not significantly different: polynomial." in text


def test_finding_on_the_paper_says_where_its_methods_stand(scores: Scores) -> None:
    rows = standings(TRACK, scores, 400)
    text = paper_finding(rows)
    assert text.startswith("**Of the paper's methods** Method 7 does best: rank 4 [4, 4] of 5, score 0.20 [")
    assert "below constant" in text and "The others: Method 1 0.10." in text
    assert paper_finding([row for row in rows if not row.label.startswith("Method")]) == ""


def test_prediction_is_scored_by_the_best_constant_step_size(chosen: dict[str, np.ndarray]) -> None:
    """Errors of 0.2 and 0.1 with the settings of the constant step size, 0.4 of another rule: it scores 0.25."""
    track = Track("C", "module:measure", {}, TASKS[:1], (RULES[0], RULES[2]))
    errors = {(0, 0, 0): 0.2, (0, 1, 0): 0.1, (1, 0, 0): 0.4}
    runs = {place: Runs(np.full((RUNS, CHECKPOINTS), error), np.full(RUNS, np.nan), []) for place, error in errors.items()}
    collected = collect(track, chosen_places(track, runs)["per environment"], runs)
    assert collected.anytime.mean(axis=1).ravel() == pytest.approx([1.0, 0.25])
    assert collected.online.shape == (2, RUNS, 0)
    assert np.isnan(standings(track, collected, 50)[0].online.value)
