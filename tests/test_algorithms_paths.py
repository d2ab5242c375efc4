"""
Every algorithm on both paths: the same bits in tables, step sizes, memory, traces and returns.

Algorithms, methods, environments and numbers of environments are combined so that every pair of any two of them is there; with
``EXHAUSTIVE=1`` in the environment, all of the full product.
"""

import itertools
import os
from typing import Any

import numpy as np
import pytest
from helpers.both_paths import make_vec
from stable_baselines3.common.callbacks import CallbackList

from sb3_adaptive_q import ALGORITHMS, EpisodeSeriesCallback, TabularAlgorithm
from sb3_adaptive_q.rollouts import step_rollout

#: For each algorithm the arguments by which its code differs; the pairs take them in turn
VARIANTS: dict[str, list[dict[str, Any]]] = {
    "tabular_q": [{}, {"exploration": "boltzmann", "exploration_final_eps": 0.2}],
    "sarsa": [{}, {"ties": "first"}],
    "expected_sarsa": [{}, {"exploration": "boltzmann", "exploration_final_eps": 0.2}, {"ties": "first"}],
    "double_q": [{}, {"target": "expected"}],
    "sarsa_lambda": [{}, {"true_online": True}, {"trace": "replacing"}, {"trace": "dutch"}],
    "q_lambda": [{}, {"variant": "peng"}, {"variant": "naive", "trace": "replacing"}, {"trace": "dutch"}],
    "n_step": [{"n": 3}, {"target": "tree_backup"}, {"target": "expected"}, {"target": "q", "n": 2}],
}
#: Methods whose functions are the same stand together, so that one compilation serves both
METHODS: list[list[int | str]] = [[1, 2], [3], [4], [5, 6], [7, 8], ["polynomial"], ["idbd"], ["autostep"]]
#: Names of ``helpers.both_paths``, and the steps to learn for
ENVIRONMENTS = {"slippery lake": 600, "Taxi": 600, "CliffWalking": 400, "CartPole": 300}
N_ENVS = (1, 3)

Combination = tuple[str, int, int | str, str, int]


def pairs() -> list[Combination]:
    """Every algorithm with every method; variants, environments and their numbers go round, and meet all the others."""
    found: list[Combination] = []
    rounds = itertools.count()
    for row, name in enumerate(VARIANTS):
        for column, methods in enumerate(METHODS):
            variant, place = column % len(VARIANTS[name]), next(rounds) + row
            env, n_envs = list(ENVIRONMENTS)[place % len(ENVIRONMENTS)], N_ENVS[(column + place // 4) % 2]
            found += [(name, variant, method, env, n_envs) for method in methods]
    return found


def everything() -> list[Combination]:
    """The full product."""
    methods = [method for group in METHODS for method in group]
    variants = [(name, place) for name, given in VARIANTS.items() for place in range(len(given))]
    return [(*variant, *rest) for variant, *rest in itertools.product(variants, methods, ENVIRONMENTS, N_ENVS)]


def make(name: str, variant: int, method: int | str, env: str, n_envs: int, compiled: bool) -> TabularAlgorithm:
    """A model on one of the paths."""
    arguments = {"method": method, "gamma": 0.95, "initial_q": 0.1, "seed": 2, **VARIANTS[name][variant]}
    return ALGORITHMS[name]("MlpPolicy", make_vec(env, compiled, n_envs), **arguments)


def learn(model: TabularAlgorithm, n_steps: int, **arguments: Any) -> dict[str, bytes]:
    """
    :param model: learns
    :param n_steps: for so long
    :param arguments: further ones of ``learn``
    :return: all that it leaves behind, by name
    """
    series = EpisodeSeriesCallback()
    model.learn(n_steps, callback=CallbackList([series]), log_interval=None, **arguments)
    arrays = {name: buffer.numpy() for name, buffer in model.policy.named_buffers()}
    arrays |= {"record": model.training.record, "returns": series.returns, "rates": series.rates, "lengths": series.lengths}
    return {name: array.tobytes() for name, array in (arrays | model._working).items()}


def assert_same(ours: dict[str, bytes], theirs: dict[str, bytes]) -> None:
    """Fail unless all is equal, in every bit."""
    assert ours.keys() == theirs.keys()
    assert [name for name, content in ours.items() if content != theirs[name]] == []


COMBINATIONS = everything() if os.environ.get("EXHAUSTIVE") else pairs()


def test_every_pair_is_there() -> None:
    methods = [method for group in METHODS for method in group]
    assert methods == [1, 2, 3, 4, 5, 6, 7, 8, "polynomial", "idbd", "autostep"]
    assert set(VARIANTS) == set(ALGORITHMS)
    factors: list[Any] = [list(VARIANTS), methods, list(ENVIRONMENTS), N_ENVS]
    chosen = [(name, *others) for name, _, *others in COMBINATIONS]
    for one, other in itertools.combinations(range(len(factors)), 2):
        assert {(each[one], each[other]) for each in chosen} == set(itertools.product(factors[one], factors[other]))
    for name, variants in VARIANTS.items():
        mine = [each for each in COMBINATIONS if each[0] == name]
        assert {variant for _, variant, *_ in mine} == set(range(len(variants)))


@pytest.mark.parametrize("combination", COMBINATIONS, ids=lambda each: "-".join(map(str, each)))
def test_both_paths(combination: Combination, monkeypatch: pytest.MonkeyPatch) -> None:
    """The ordinary path runs as Python where there are several environments, and as machine code for one."""
    *_, env, n_envs = combination
    n_steps = ENVIRONMENTS[env] * n_envs
    compiled = learn(make(*combination, compiled=True), n_steps)
    if n_envs > 1:
        monkeypatch.setattr(step_rollout, "is_disabled", lambda: True)
    assert_same(compiled, learn(make(*combination, compiled=False), n_steps))


CONTINUED = [("double_q", 0), ("sarsa_lambda", 1), ("q_lambda", 0), ("n_step", 0)]


@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize(("name", "variant"), CONTINUED)
def test_learning_goes_on_in_the_middle_of_an_episode(name: str, variant: int, compiled: bool) -> None:
    """Two calls of ``learn`` leave what one leaves: traces and transitions that are not learned from yet are kept."""

    def constant(*_: Any) -> TabularAlgorithm:
        arguments = {"exploration_initial_eps": 0.3, "exploration_final_eps": 0.3, "gamma": 0.95, "initial_q": 0.1}
        env = make_vec("slippery lake", compiled, 3)
        return ALGORITHMS[name]("MlpPolicy", env, method="polynomial", seed=1, **arguments, **VARIANTS[name][variant])

    whole = constant()
    whole.learn(900, log_interval=None)
    parts = constant()
    parts.learn(450, log_interval=None)
    assert any(any(array.tobytes()) for array in parts._working.values()) or name == "double_q"
    parts.learn(450, reset_num_timesteps=False, log_interval=None)
    np.testing.assert_array_equal(parts.q_table, whole.q_table)
    for key, array in whole._working.items():
        assert array.tobytes() == parts._working[key].tobytes()
    for key, array in whole.memory.items():
        np.testing.assert_array_equal(parts.memory[key], array)


@pytest.mark.parametrize(("env", "masked"), [("slippery lake", False), ("Taxi", True)])
@pytest.mark.parametrize(("name", "variant"), CONTINUED)
def test_resumed_from_a_file_of_a_callback(
    name: str, variant: int, env: str, masked: bool, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the middle of an episode, with traces, transitions that are not learned from yet, and masks."""
    monkeypatch.setattr(step_rollout, "is_disabled", lambda: True)
    arguments = {"method": "polynomial", "seed": 1, "use_masking": masked, **VARIANTS[name][variant]}
    whole = ALGORITHMS[name]("MlpPolicy", make_vec(env, False, 2), **arguments)

    def save(found: dict[str, Any], _: dict[str, Any]) -> bool:
        if whole.num_timesteps == 202:
            whole.save(tmp_path / "model")
        return True

    whole.learn(300, callback=save, log_interval=None)
    resumed = ALGORITHMS[name].resume(tmp_path / "model", make_vec(env, False, 2))
    resumed.finish()
    assert resumed.num_timesteps == 300
    ours, theirs = ({**model.policy.state_dict(), **model._working} for model in (resumed, whole))
    assert ours.keys() == theirs.keys()
    for key, array in ours.items():
        assert np.asarray(array).tobytes() == np.asarray(theirs[key]).tobytes(), key


@pytest.mark.parametrize("name", ALGORITHMS)
def test_saved_and_loaded(name: str, tmp_path: Any) -> None:
    arguments = VARIANTS[name][-1]
    model = ALGORITHMS[name]("MlpPolicy", make_vec("slippery lake", True), method="polynomial", seed=0, **arguments)
    model.learn(2000, log_interval=None)
    model.save(tmp_path / "model")
    loaded = ALGORITHMS[name].load(tmp_path / "model", env=make_vec("slippery lake", True))
    assert loaded.q_table.tobytes() == model.q_table.tobytes() and loaded.mu == model.mu
    for key, array in model.memory.items():
        np.testing.assert_array_equal(loaded.memory[key], array)
    assert {key: getattr(loaded, key) for key in arguments} == arguments
    assert loaded.update_parameters() == model.update_parameters()
    loaded.learn(1000, reset_num_timesteps=False, log_interval=None)
    assert loaded.num_timesteps == 3000 and loaded.memory["visits"].sum() > model.memory["visits"].sum()
