"""What the algorithms refuse, with what was expected and what came, before anything has changed."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from stable_baselines3.common.callbacks import ConvertCallback
from stable_baselines3.common.env_util import make_vec_env

from sb3_adaptive_q import (
    ALGORITHMS,
    CompiledVecEnv,
    LeanVecEnv,
    LearningRateCallback,
    NStep,
    QLambda,
    SARSALambda,
    TabularAlgorithm,
    TabularQ,
    policies,
)
from sb3_adaptive_q.rollouts import step_rollout

BAD = [
    *[(name, {"trace_decay": value}, "`trace_decay` must be a number from 0 to 1, but got")
      for name in ("sarsa_lambda", "q_lambda") for value in (-0.1, 1.1, float("nan"), "0.5")],
    *[("n_step", {"n": value}, "`n` must be a whole number of at least 1, but got") for value in (0, -3, 1.5, True, "2")],
    ("q_lambda", {"variant": "watson"}, "`variant` must be one of watkins, peng, naive, but got 'watson'"),
    ("q_lambda", {"trace": "replace"}, "`trace` must be one of accumulating, replacing, dutch, but got 'replace'"),
    ("sarsa_lambda", {"trace": 1}, "`trace` must be one of accumulating, replacing, dutch, but got 1"),
    ("sarsa_lambda", {"trace": "replacing", "true_online": True}, "`true_online=True` needs `trace='dutch'`, but got 'repl"),
    ("n_step", {"target": "max"}, "`target` must be one of sarsa, expected, tree_backup, q, but got 'max'"),
    ("double_q", {"target": "sarsa"}, "`target` must be one of max, expected, but got 'sarsa'"),
    *[("q_lambda", {"trace_threshold": value}, "`trace_threshold` must be a finite number of at least 0, but got")
      for value in (-1e-9, float("nan"), float("inf"), "0")],
]  # fmt: skip


@pytest.mark.parametrize(("name", "arguments", "message"), BAD)
def test_arguments(name: str, arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ALGORITHMS[name]("MlpPolicy", "FrozenLake-v1", **arguments)


@pytest.mark.parametrize(
    ("name", "attribute", "value"), [("sarsa_lambda", "trace_decay", 2.0), ("n_step", "n", 0), ("q_lambda", "variant", "x")]
)
def test_an_attribute_that_is_set_later(name: str, attribute: str, value: Any) -> None:
    model = ALGORITHMS[name]("MlpPolicy", "FrozenLake-v1")
    setattr(model, attribute, value)
    with pytest.raises(ValueError, match=f"`{attribute}` must be"):
        model.learn(10)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "sarsa_lambda",
            r"`places` of shape \(1, 16, 4\), `pairs` of shape \(1, \d+, 2\), `traces` of shape .* GiB of memory are free: "
            r"use a larger `trace_threshold`, fewer environments or fewer cells\.$",
        ),
        ("n_step", r"`taken, with rewards` of shape \(1, 4, 3\).* use a smaller `n`\.$"),
    ],
)
def test_more_than_the_memory_holds(name: str, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    model = ALGORITHMS[name]("MlpPolicy", "FrozenLake-v1")
    monkeypatch.setattr(policies, "SURELY_FREE", 0)
    monkeypatch.setattr(policies, "psutil", SimpleNamespace(virtual_memory=lambda: SimpleNamespace(available=10)))
    with pytest.raises(MemoryError, match=message):
        model.learn(10)


class TooLarge(LearningRateCallback):
    """A step size that is refused at the fifth visit of a pair."""

    counts = True

    @staticmethod
    def step_size(mu: float, step: Any) -> float:
        return 2.0 if step.count == 5.0 else 0.25


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("name", ["double_q", "sarsa_lambda", "q_lambda", "n_step"])
def test_a_refused_step_size_leaves_the_values_alone(name: str, compiled: bool) -> None:
    """The table, and what else the update works with, are as the update before left them."""
    kind = CompiledVecEnv if compiled else LeanVecEnv
    arguments = {"initial_q": np.linspace(0.0, 1.0, 64).reshape(16, 4), "seed": 0, "callback_interval": 1}
    model = ALGORITHMS[name]("MlpPolicy", make_vec_env("FrozenLake-v1", vec_env_cls=kind), **arguments)
    before: list[Any] = []

    def keep(*_: Any) -> bool:
        before[:] = [model.q_table.copy(), {name: array.copy() for name, array in model._working.items()}]
        return True

    callbacks = [TooLarge(), ConvertCallback(keep)]
    with pytest.raises(ValueError, match=r"TooLarge must give step sizes from 0 to 1, but at step .* it gave 2.0"):
        model.learn(5000, callback=callbacks, log_interval=None)
    np.testing.assert_array_equal(model.q_table, before[0])
    for array in ("places", "pairs", "traces", "n_pairs"):
        if array in before[1]:
            np.testing.assert_array_equal(model._working[array], before[1][array])


class TooLargeThenNegative(TooLarge):
    """Its rule makes a negative μ of the step size that is refused."""

    @staticmethod
    def rule(mu: float, step: Any) -> float:
        return -3.0 if step.size > 1.0 else step.size


@pytest.mark.parametrize("kind", [CompiledVecEnv, LeanVecEnv])
def test_the_refused_step_size_is_named_before_what_the_rule_made_of_it(kind: Any) -> None:
    model = TabularQ("MlpPolicy", make_vec_env("FrozenLake-v1", vec_env_cls=kind), seed=0)
    with pytest.raises(ValueError, match=r"it gave 2\.0: please check it"):
        model.learn(5000, callback=TooLargeThenNegative(), log_interval=None)


def bad_in_the_end(progress: float) -> float:
    return 0.5 if progress < 0.5 else -1.0


@pytest.mark.parametrize("name", ALGORITHMS)
def test_a_refused_temperature_does_not_enter_the_table(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(step_rollout, "is_disabled", lambda: True)
    arguments = {"exploration": "boltzmann", "exploration_schedule": bad_in_the_end, "initial_q": 0.5, "seed": 0}
    model = ALGORITHMS[name]("MlpPolicy", "FrozenLake-v1", learning_rate=0.5, **arguments)
    with pytest.raises(ValueError, match="`exploration_schedule` must give"):
        model.learn(100, log_interval=None)
    assert model.num_timesteps >= 50 and (np.abs(model.q_table) <= 1.0).all()


class TestChanges:
    def test_lambda_may_change_between_two_calls(self) -> None:
        """The list of eligible pairs is then as long as the new one needs."""
        model = SARSALambda("MlpPolicy", "FrozenLake-v1", trace_decay=0.1, trace_threshold=0.01, seed=0)
        model.learn(200, log_interval=None)
        shortest = model._working["pairs"].shape[1]
        model.trace_decay, model.gamma = 1.0, 1.0
        model.learn(200, reset_num_timesteps=False, log_interval=None)
        assert shortest < 10 and model._working["pairs"].shape[1] == 64

    @pytest.mark.parametrize("algorithm", [QLambda, NStep])
    def test_other_environments_begin_new_episodes(self, algorithm: type[TabularAlgorithm]) -> None:
        model = algorithm("MlpPolicy", make_vec_env("FrozenLake-v1", 2), seed=0)
        model.learn(100, log_interval=None)
        old = model._working
        model.set_env(make_vec_env("FrozenLake-v1", 2))
        model.learn(0, reset_num_timesteps=False, log_interval=None)
        assert any(any(array.tobytes()) for array in old.values())
        assert not any(any(array.tobytes()) for array in model._working.values())


class TestWorkingArrays:
    """They are saved under their names."""

    def shapes(self, name: str, **arguments: Any) -> dict[str, tuple[int, ...]]:
        model = ALGORITHMS[name]("MlpPolicy", make_vec_env("FrozenLake-v1", 2), **arguments)
        model.learn(0, log_interval=None)
        return {name: array.shape for name, array in model._working.items()}

    def test_n_step(self) -> None:
        expected = {"taken": (2, 4, 2), "rewards": (2, 4), "ends": (2, 2), "next_values": (4,)}
        assert self.shapes("n_step") == expected
        assert self.shapes("n_step", n=7) == expected | {"taken": (2, 7, 2), "rewards": (2, 7)}

    @pytest.mark.parametrize(
        ("name", "arguments", "further"),
        [
            ("sarsa_lambda", {}, {}),
            ("sarsa_lambda", {"true_online": True}, {"old_values": (2,)}),
            ("q_lambda", {}, {}),
            ("q_lambda", {"variant": "naive"}, {"next_values": (4,)}),
            ("q_lambda", {"variant": "peng"}, {"next_values": (4,)}),
        ],
    )
    @pytest.mark.parametrize(("decay", "longest"), [(1.0, 64), (0.0, 1)])
    def test_traces(self, name: str, arguments: dict[str, Any], further: dict[str, Any], decay: float, longest: int) -> None:
        pairs = {"pairs": (2, longest, 2), "traces": (2, longest, 2)}
        expected = {"places": (2, 16, 4), **pairs, "n_pairs": (2,), **further}
        assert self.shapes(name, gamma=1.0, trace_decay=decay, **arguments) == expected


class TestArraysOfAFile:
    """Machine code looks up what stands in them, so what is read from a file is checked first."""

    def running(self, name: str, **arguments: Any) -> Any:
        model = ALGORITHMS[name]("MlpPolicy", make_vec_env("FrozenLake-v1", 2), seed=0, **arguments)
        model.learn(40, log_interval=None)
        model.check_working_arrays(model._working)
        assert any(model._working["n_pairs" if "n_pairs" in model._working else "ends"].flat)
        return model

    @pytest.mark.parametrize(
        ("array", "place", "value", "message"),
        [
            ("n_pairs", 0, 65, "`n_pairs` must hold numbers from 0 to 64"),
            ("n_pairs", 0, -1, "`n_pairs` must hold numbers from 0 to 64"),
            ("n_pairs", 0, 0, "`places` must say where"),
            ("pairs", (0, 0, 0), 16, "`pairs` must hold numbers from 0 to 15"),
            ("pairs", (0, 0, 1), -1, "`pairs` must hold numbers from 0 to 3"),
            ("places", (0, 15, 0), 1, "`places` must say where"),
            ("places", (1, 3, 2), -5, "`places` must say where"),
        ],
    )
    def test_traces(self, array: str, place: Any, value: int, message: str) -> None:
        model = self.running("sarsa_lambda")
        model._working[array][place] = value
        with pytest.raises(ValueError, match=f"^{message}"):
            model.check_working_arrays(model._working)

    def test_a_list_of_all_pairs_is_sound(self) -> None:
        model = self.running("sarsa_lambda", trace_threshold=0.0)
        pairs = np.stack(np.divmod(np.arange(64), 4), axis=1)
        for env in range(2):
            model._working["pairs"][env], model._working["n_pairs"][env] = pairs, 64
            model._working["places"][env] = np.arange(1, 65).reshape(16, 4)
        model.check_working_arrays(model._working)

    def test_a_pair_that_is_listed_twice(self) -> None:
        model = self.running("sarsa_lambda")
        assert model._working["n_pairs"][0] >= 2
        model._working["pairs"][0, 1] = model._working["pairs"][0, 0]
        with pytest.raises(ValueError, match="`places` must say where"):
            model.check_working_arrays(model._working)

    @pytest.mark.parametrize(
        ("array", "place", "value"),
        [("ends", (0, 0), 3), ("ends", (1, 1), 3), ("ends", (0, 1), -1), ("taken", (0, 0, 0), 16), ("taken", (0, 2, 1), 4)],
    )
    def test_transitions(self, array: str, place: Any, value: int) -> None:
        model = self.running("n_step", n=3)
        model._working[array][place] = value
        with pytest.raises(ValueError, match=f"`{array}` must hold numbers from 0 to"):
            model.check_working_arrays(model._working)
