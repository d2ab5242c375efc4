"""What a cell of the league measures, against ordinary learning, rollouts in gymnasium, and closed forms."""

import tempfile
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3.common.callbacks import BaseCallback

from sb3_adaptive_q import EpisodeSeriesCallback, TabularQ
from sb3_adaptive_q.envs.catalogue import PROBLEMS
from sb3_adaptive_q.experiments.league import greedy_episodes
from sb3_adaptive_q.experiments.league.judges import control_judge
from sb3_adaptive_q.experiments.league.measures import (
    Checkpoints,
    Judge,
    measure_control,
    measure_estimation,
    measure_prediction,
)
from sb3_adaptive_q.experiments.environments import reused_vec_env
from sb3_adaptive_q.experiments.league.settings import league_data
from sb3_adaptive_q.planning import action_values, value_iteration

OWN = "tests.helpers.own_rules:"


def recipe(environment: str, method: str = "constant", behaviour: str = "control", **changes: Any) -> dict[str, Any]:
    """As the league makes it."""
    problem = PROBLEMS.get(environment)
    settings = {
        **league_data()[behaviour],
        "gamma": changes.pop("gamma", problem.gamma if problem else 0.99),
        "initial_q": problem.initial_q if problem else 0.0,
    }
    learner = {
        "environment": environment,
        "algorithm": "tabular_q",
        "method": method,
        "parameters": changes.pop("parameters", {}),
        "settings": settings,
    }
    fixed = {
        "learner": learner,
        "arguments": {},
        "instances": 0,
        "scale": None,
        "steps": 5000,
        "checkpoints": 25,
        "seeds": [0],
    }
    return fixed | changes


# Control


class KeepTables(BaseCallback):
    """The table of every 200th step."""

    def __init__(self) -> None:
        super().__init__()
        self.tables: list[np.ndarray] = []

    def _on_step(self) -> bool:
        if self.num_timesteps % 200 == 0:
            self.tables.append(self.model.q_table.copy())  # type: ignore[attr-defined]
        return True


def return_of(policy: np.ndarray, env: gym.Env, horizon: int) -> float:
    """The mean return of a policy within a horizon, by plain recursion over gymnasium's table."""
    table: Any = env.unwrapped.P  # type: ignore[attr-defined]
    values = np.zeros(len(policy))
    for _ in range(horizon):
        values = np.array(
            [sum(p * (r + (0.0 if end else values[s])) for p, s, r, end in table[state][policy[state]]) for state in table]
        )
    return float(env.unwrapped.initial_state_distrib @ values)  # type: ignore[attr-defined]


def test_scores_are_the_exact_returns_of_what_is_learned_in_the_ordinary_environment() -> None:
    """FrozenLake: the optimum and the uniform policy return 0.74419 and 0.01394 within 100 steps."""
    measured = measure_control(recipe("lake4", seeds=[3]))
    model = TabularQ("MlpPolicy", gym.make("FrozenLake-v1"), method="constant", seed=3, gamma=0.99, **league_data()["control"])
    tables = KeepTables()
    model.learn(5000, callback=[tables, series := EpisodeSeriesCallback()])
    lake = gym.make("FrozenLake-v1")
    for i in (0, 9, 24):
        expected = (return_of(tables.tables[i].argmax(axis=1), lake, 100) - 0.01394) / (0.74419 - 0.01394)
        assert measured["scores"][0][i] == pytest.approx(expected, abs=2e-5)
    online = (series.returns.mean() - 0.01394) / (0.74419 - 0.01394)
    assert measured["online"][0] == pytest.approx(online, abs=2e-5)


def test_return_collected_while_learning_is_on_the_same_scale() -> None:
    """A learner that never stops exploring, with a rule that cannot move, collects what the uniform policy does: 0."""
    made = recipe("lake4", "constant", steps=500_000, behaviour="uniform", parameters={"alpha": 0.0})
    (online,) = measure_control(made)["online"]
    # Some 65 000 episodes of which 1.4% return 1: a standard error of 0.0006 on the scale
    assert online == pytest.approx(0.0, abs=0.003)


def test_hidden_change_is_judged_by_the_rules_of_the_moment() -> None:
    """
    What was learned before the goal jumps is worth little after: the score falls, and is never above 1. The jump comes after
    40 000 steps, at the 20th checkpoint, which belongs to the steps before it.
    """
    scores = np.array(measure_control(recipe("moving_goal", steps=50_000, seeds=[0, 1, 2]))["scores"])
    before, after = scores[:, 19].mean(), scores[:, 20].mean()
    assert before > 0.9 and after < 0.5 and scores.max() <= 1.0 + 1e-9


def test_instances_are_those_of_the_seed() -> None:
    """Instance 3 for the seeds 3 and 13; what they learn of it differs, its optimum does not."""
    made = recipe("garnet", steps=2500, instances=10, seeds=[3, 13, 4])
    env = reused_vec_env("garnet", instance=3)
    judge = control_judge(made, {"instance": 3}, env)
    model: Any = env.get_attr("unwrapped")[0]
    best = action_values(model, value_iteration(model, 0.95), 0.95)
    # The best policy of the discounted values loses a little of what is possible within 1000 steps
    assert 0.95 < judge.score(best, 100) <= 1.0
    assert len(set(map(tuple, measure_control(made)["scores"]))) == 3


def test_environment_without_a_table_is_judged_by_rollouts() -> None:
    """Two rewards of the number of the action: always the second action returns 2, always the first 0."""
    made = recipe(f"{OWN}CountingEnv", scale=[0.0, 4.0], steps=50)
    judge = control_judge(made, {}, reused_vec_env(f"{OWN}CountingEnv"))
    assert judge.score(np.array([[0.0, 1.0]] * 3), 50) == pytest.approx(0.5)
    assert judge.score(np.array([[1.0, 0.0]] * 3), 50) == pytest.approx(0.0)
    assert measure_control(made)["failure"] == [""]


def test_greedy_episodes_are_those_of_a_model_that_learns_nothing() -> None:
    """The league plays greedily in machine code, where the environment has it; a model does the same, many times slower."""
    limit = {"max_episode_steps": 200}
    in_machine_code = greedy_episodes.player("CartPole-v1", limit)
    ordinary = greedy_episodes._ordinary_player(reused_vec_env("CartPole-v1", "ordinary", **limit))
    for seed in range(3):
        table = np.random.default_rng(seed).normal(size=(11**4, 2))
        assert in_machine_code(table).tolist() == ordinary(table).tolist()
    assert len(set(in_machine_code(table))) > 10


@pytest.mark.parametrize(("environment", "scale"), [("chain", None), (f"{OWN}CountingEnv", [0.0, 4.0])])
def test_no_folder_is_made_for_a_log(
    environment: str, scale: list[float] | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SB3 makes a temporary one at every ``learn``: a whole league would leave hundreds of thousands."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    measure_control(recipe(environment, scale=scale, steps=50, seeds=[0, 1]))
    assert not list(tmp_path.iterdir())


def test_rollouts_leave_the_learning_alone() -> None:
    made = recipe("CartPole-v1", arguments={"max_episode_steps": 200}, scale=[0.0, 200.0], steps=2500)
    first, second = measure_control(made), measure_control(made | {"seeds": [0, 1]})
    assert first["scores"][0].tolist() == second["scores"][0].tolist()
    few = measure_control(made | {"checkpoints": 5})
    assert few["scores"][0].tolist() == first["scores"][0][4::5].tolist()
    # Always to the left falls within some 10 steps of 200
    judge = control_judge(made, made["arguments"], reused_vec_env("CartPole-v1", **made["arguments"]))
    assert 0.03 < judge.score(np.zeros((11**4, 2)), 0) < 0.06


# Failures


def test_rule_that_fails_scores_as_the_uniform_policy_from_then_on() -> None:
    measured = measure_control(recipe("dyna_maze", f"{OWN}Broken", steps=30_000, seeds=[0, 1]))
    assert all("ValueError" in reason and "nan" in reason for reason in measured["failure"])
    for scores in measured["scores"]:
        assert len(scores) == 25 and (scores[13:] == 0.0).all() and np.any(scores[:12] != 0.0)


class FakeModel:
    """A model whose table grows."""

    q_table = np.zeros((2, 2))
    num_timesteps = 0


@pytest.mark.parametrize(("entry", "fails"), [(999.0, False), (-1001.0, True), (np.nan, True), (np.inf, True)])
def test_table_that_diverges_ends_the_run(entry: float, fails: bool) -> None:
    """Beyond a thousand times the largest value that is possible."""
    checkpoints = Checkpoints(Judge(lambda table, step: 0.5, lambda returns: 0.0, largest_value=1.0), interval=10)
    model = FakeModel()
    model.q_table = np.array([[0.0, entry], [0.0, 0.0]])
    checkpoints.model = model  # type: ignore[assignment]
    checkpoints.num_timesteps = 10
    assert checkpoints._on_step() is not fails
    assert bool(checkpoints.failure) is fails and len(checkpoints.scores) == (not fails)


# Estimation


def test_estimation_is_the_error_of_the_values_that_can_be_reached() -> None:
    """With step size 1 a deterministic problem is learned exactly; with 0 nothing changes. Frozen Lake without ice."""
    exact = measure_estimation(recipe(f"{OWN}make_lake", behaviour="uniform", parameters={"alpha": 1.0}, steps=50_000))
    still = measure_estimation(recipe(f"{OWN}make_lake", behaviour="uniform", parameters={"alpha": 0.0}, steps=2500))
    assert exact["scores"][0][-1] == pytest.approx(1.0, abs=1e-9)
    assert still["scores"][0] == pytest.approx(np.zeros(25), abs=1e-12)


def test_all_rules_see_the_same_transitions() -> None:
    """A rule that holds μ at 0.1 by other means learns the same table, so both saw the same; another step size differs."""
    scores = [
        measure_estimation(recipe("chain", *rule, behaviour="uniform"))["scores"][0]
        for rule in (("constant",), ("unbiased_constant",))
    ]
    fixed = measure_estimation(recipe("chain", "2", behaviour="uniform", parameters={"beta": 0.1}))["scores"][0]
    assert scores[0].tolist() == fixed.tolist() and scores[0].tolist() != scores[1].tolist()


# Prediction


@pytest.mark.parametrize(("alpha", "name", "variance"), [(0.0951249, "drift_01", 0.01), (0.618034, "drift_1", 1.0)])
def test_tracking_error_of_the_best_constant_step_size_is_that_of_muth(alpha: float, name: str, variance: float) -> None:
    """
    Var(m - Q) = (α² + q) / (α (2 - α)), which is 0.105 and 1.618 (Muth, 1960). Checkpoints 400 steps apart are as good as
    independent: of 40 x 25 squared errors, close to normal, the mean has a relative standard error of √(2 / 1000) = 4.5%.
    """
    measured = measure_prediction(
        recipe(name, behaviour="uniform", parameters={"alpha": alpha}, steps=10_000, seeds=list(range(40)))
    )
    expected = (alpha**2 + variance) / (alpha * (2.0 - alpha))
    assert np.mean(measured["scores"]) == pytest.approx(expected, rel=0.18)


def test_random_walk_is_predicted_without_an_error_in_the_end() -> None:
    errors = measure_prediction(recipe("random_walk_19", "harmonic", "uniform", parameters={"a": 100.0}, steps=100_000))[
        "scores"
    ][0]
    # At first the mean of (s - 10)² / 100 over the 19 states is 0.3
    assert errors[0] < 0.3 and errors[-1] < 0.01


def test_prediction_follows_the_switch() -> None:
    """Values with the reward -1 are no longer right when it becomes 0.5: after 5000 steps, the error rises."""
    errors = np.mean(
        measure_prediction(recipe("hl_21_switch", behaviour="uniform", steps=12_500, seeds=list(range(10))))["scores"], axis=0
    )
    assert errors[10] > 2.0 * errors[8]
