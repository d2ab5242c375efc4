"""What RL Zoo is given: the algorithms, their search spaces, their hyperparameters by environment."""

import inspect
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import optuna
import pytest
import rl_zoo3
import yaml
from hypothesis import given, strategies as st
from optuna.trial import FixedTrial
from rl_zoo3.hyperparams_opt import HYPERPARAMS_CONVERTER, HYPERPARAMS_SAMPLER
from rl_zoo3.utils import linear_schedule
from stable_baselines3.common.env_util import make_vec_env

from sb3_adaptive_q import (
    ALGORITHMS,
    METHODS,
    CompiledVecEnv,
    LeanVecEnv,
    TabularAlgorithm,
    TabularQ,
    search_space,
    zoo,
)
from sb3_adaptive_q.envs import PROBLEMS

CONFIG: dict[str, dict[str, Any]] = yaml.safe_load(zoo.CONFIG.read_text())


SEARCH_SPACE = st.fixed_dictionaries(
    {
        "method": st.sampled_from([1, 3, 4, 5, 6, 7, 8]),
        "upper": st.floats(0.002, 1.0),
        "lower_fraction": st.floats(0.001, 1.0),
        "change": st.floats(0.01, 10.0),
        "one_minus_gamma": st.floats(0.0001, 0.1),
        "exploration_fraction": st.floats(0.1, 1.0),
        "exploration_final_eps": st.floats(0.0, 0.2),
    }
)


def sample(trial: Any, algorithm: str = "tabular_q") -> dict[str, Any]:
    return search_space.sample(trial, n_actions=0, n_envs=1, additional_args={}, algorithm=algorithm)


def ask(algorithm: str, n_trials: int) -> list[tuple[optuna.Trial, dict[str, Any]]]:
    """Trials that are drawn at random, with what is drawn for each."""
    study = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=0))
    trials = [study.ask() for _ in range(n_trials)]
    return [(trial, sample(trial, algorithm)) for trial in trials]


@pytest.mark.parametrize("name", ALGORITHMS)
class TestAlgorithms:
    def test_register(self, name: str) -> None:
        zoo.register()
        assert rl_zoo3.ALGOS[name] is ALGORITHMS[name]
        (trial, _), *_ = ask(name, 1)
        sampled = HYPERPARAMS_SAMPLER[name](trial, 0, 1, {})  # type: ignore[operator]
        assert HYPERPARAMS_CONVERTER[name](trial.params) == sampled  # type: ignore[operator]

    def test_a_search_draws_what_the_constructor_takes(self, name: str) -> None:
        """All its own arguments but for the precision of traces; and RL Zoo prints them for the best trial."""
        drawn = set()
        for trial, sampled in ask(name, 30):
            model = ALGORITHMS[name]("MlpPolicy", "FrozenLake-v1", **sampled)
            assert {argument: getattr(model, argument) for argument in sampled} == sampled == trial.user_attrs
            drawn |= set(sampled)
        own, shared = (set(inspect.signature(each).parameters) for each in (ALGORITHMS[name], TabularAlgorithm))
        others = {"method", "method_kwargs", "gamma", "exploration_fraction", "exploration_final_eps"}
        assert drawn == others | (own - shared - {"args", "kwargs", "trace_threshold"})


@given(params=SEARCH_SPACE)
def test_every_sample_makes_a_model(params: dict[str, Any]) -> None:
    """Outside a study, where RL Zoo would take our ValueError for a pruned trial."""
    sampled = sample(FixedTrial(params))
    model = TabularQ("MlpPolicy", "FrozenLake-v1", **sampled)
    assert model.method == params["method"]
    assert 0.0 < model.mu <= 1.0
    assert model.gamma == 1.0 - params["one_minus_gamma"]
    # What a study stores are the numbers drawn: with `--trial-id` RL Zoo converts them again
    assert search_space.convert(params) == sampled


def test_sample_covers_the_methods() -> None:
    """Every method but 2, which is 1 with another constant, and each with the paper's own parameters in reach."""
    drawn = {sampled["method"] for _, sampled in ask("tabular_q", 100)}
    assert drawn == set(METHODS) - {2}


@pytest.mark.parametrize(
    ("method", "numbers", "expected"),
    [
        (1, {"upper": 0.01}, {"beta": 0.01}),
        (1, {"upper": 0.05}, {"beta": 0.05}),
        (3, {"upper": 0.05, "lower_fraction": 0.2}, {"beta_1": 0.01, "beta_3": 0.04}),
        (4, {"upper": 0.05, "lower_fraction": 0.2}, {"beta_1": 0.01, "beta_3": 0.04}),
        (5, {"change": 5.0}, {"gain": -0.05, "mu_0": 0.01, "lower": 0.001, "upper": 0.01}),
        (6, {"change": 5.0}, {"gain": 0.05, "mu_0": 0.01, "lower": 0.001, "upper": 0.01}),
        (7, {"change": 0.5}, {"step": 0.005, "mu_0": 0.01, "lower": 0.001, "upper": 0.01}),
        (8, {"change": 0.5}, {"step": -0.005, "mu_0": 0.01, "lower": 0.001, "upper": 0.01}),
    ],
)
def test_the_papers_parameters_are_in_the_search_space(
    method: int, numbers: dict[str, float], expected: dict[str, float]
) -> None:
    others = {"one_minus_gamma": 0.01, "exploration_fraction": 1.0, "exploration_final_eps": 0.05}
    params = {"method": method, "upper": 0.01, "lower_fraction": 0.1, "change": 1.0, **others, **numbers}
    assert sample(FixedTrial(params))["method_kwargs"] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(
    ("hyperparams", "method", "expected"),
    [
        (None, None, {}),
        ({"gamma": 0.5}, None, {"gamma": 0.5}),
        (None, 7, {"method": 7, "method_kwargs": None}),
        ({"gamma": 0.5}, 7, {"gamma": 0.5, "method": 7, "method_kwargs": None}),
        ({"method_kwargs": {"step": 0.1}}, 7, {"method": 7, "method_kwargs": {"step": 0.1}}),
        ({"method": 3}, None, {"method": 3, "method_kwargs": None}),
        ({"method_kwargs": {"beta": 0.1}}, None, {"method_kwargs": {"beta": 0.1}}),
        ({"learning_rate": 0.1}, None, {"learning_rate": 0.1, "method": None, "method_kwargs": None}),
    ],
)
def test_command_line_replaces_the_yaml_method_whole(
    hyperparams: dict[str, Any] | None, method: int | None, expected: dict[str, Any]
) -> None:
    given_before = dict(hyperparams or {})
    assert zoo.merge_method(hyperparams, method) == expected
    assert (hyperparams or {}) == given_before


@pytest.mark.parametrize("rival", ["method", "learning_rate"])
def test_two_learning_rates_on_the_command_line(rival: str) -> None:
    with pytest.raises(ValueError, match=f"--method 1 and -params {rival}:.*give one of them"):
        zoo.merge_method({rival: 1}, 1)


def test_config_has_the_environments() -> None:
    assert {"FrozenLake-v1", "CliffWalkingLimited-v1", "Taxi-v4", "CartPoleFriction-v0", "CartPole-v1"} < set(CONFIG)
    assert CONFIG["FrozenLake-v1"]["method"] == 1
    assert CONFIG["CartPoleFriction-v0"]["method"] == CONFIG["CartPole-v1"]["method"] == 2


@pytest.mark.parametrize("env_id", CONFIG)
def test_config_entries_are_complete(env_id: str) -> None:
    entry = CONFIG[env_id]
    assert entry["n_timesteps"] > 0
    assert entry["policy"] == "MlpPolicy"


def own_environments() -> list[str]:
    """The ids that this package registers."""
    return [
        env_id for env_id, spec in gym.registry.items() if "sb3_adaptive_q" in str(spec.entry_point) or "Limited" in env_id
    ]


@pytest.mark.parametrize("env_id", sorted({*CONFIG, *own_environments()} - {"default"}))
def test_every_environment_learns_with_its_entry(env_id: str) -> None:
    """Its own, or the default."""
    entry = dict(CONFIG.get(env_id, CONFIG["default"]))
    wrapper = rl_zoo3.get_wrapper_class(entry)
    arguments = {name: value for name, value in entry.items() if name not in ("n_timesteps", "policy", "env_wrapper")}
    env = gym.make(env_id)
    model = TabularQ("MlpPolicy", wrapper(env) if wrapper else env, seed=0, **arguments).learn(300)  # type: ignore[arg-type]
    assert model.num_timesteps == 300 and np.isfinite(model.q_table).all()


def test_config_agrees_with_the_catalogue() -> None:
    """The discount factors are those of the problems, and so are the start values where they are given."""
    for problem in PROBLEMS.values():
        if problem.env_id in CONFIG and not problem.arguments:
            entry = CONFIG[problem.env_id]
            assert (entry["gamma"], entry.get("initial_q", 0.0)) == (problem.gamma, problem.initial_q), problem


@pytest.mark.parametrize("env_id", ["CartPoleFriction-v0", "CartPole-v1"])
def test_cart_pole_has_the_papers_grid(env_id: str) -> None:
    (wrapper,) = CONFIG[env_id]["env_wrapper"]
    bounds = [2.4, 4.0, 0.2095, 4.0]
    expected = {"n_edges": 10, "low": [-bound for bound in bounds], "high": bounds}
    assert wrapper == {"sb3_adaptive_q.wrappers.DiscretizeObservation": expected}
    env = rl_zoo3.get_wrapper_class({"env_wrapper": wrapper})(gym.make(env_id))  # type: ignore[misc]
    assert env.observation_space == gym.spaces.Discrete(11**4)


def test_describe() -> None:
    """Mean 2, sample variance ((-1)² + 0² + 1²) / 2 = 1, so a standard error of 1 / √3 = 0.577."""
    assert zoo.describe([1.0, 2.0, 3.0]) == "mean reward 2.00 ± 0.58 (standard error)"
    assert zoo.describe([]) == zoo.describe([1.0]) == "fewer than two episodes"


@pytest.mark.parametrize(
    ("files", "found", "expected"),
    [
        ([".venv/bin/tensorboard"], None, ".venv/bin/tensorboard"),
        ([".venv/bin/tensorboard"], ".venv/bin/tensorboard", "tensorboard"),
        ([".venv/bin/tensorboard"], "elsewhere/tensorboard", ".venv/bin/tensorboard"),
        ([], None, "tensorboard"),
    ],
)
def test_tensorboard_command(
    files: list[str], found: str | None, expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for file in files:
        (tmp_path / file).parent.mkdir(parents=True)
        (tmp_path / file).touch()
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "executable", str(tmp_path / ".venv" / "bin" / "python"))
    monkeypatch.setattr(zoo, "shutil", SimpleNamespace(which=lambda name: found and str(tmp_path / found)))
    assert zoo.tensorboard_command() == expected
    (tmp_path / "other").mkdir()
    monkeypatch.chdir(tmp_path / "other")
    assert zoo.tensorboard_command() == (str(tmp_path / expected) if "/" in expected else expected)


def test_a_learning_rate_that_falls_in_a_line_compiles() -> None:
    """What RL Zoo makes of ``lin_0.1``: compiled, the same bits as by calling SB3's schedule before each update."""
    tables = []
    for kind, make in (
        (LeanVecEnv, lambda schedule: lambda left: schedule(left)),
        (CompiledVecEnv, lambda schedule: schedule),
    ):
        env = make_vec_env("FrozenLake-v1", vec_env_cls=kind)
        model = TabularQ("MlpPolicy", env, learning_rate=make(linear_schedule("0.1")), initial_q=1.0, seed=0)
        tables.append(model.learn(3000).q_table)
    assert (tables[0] < 1.0).any()
    np.testing.assert_array_equal(*tables)
