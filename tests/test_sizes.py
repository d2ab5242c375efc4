"""
Machine code looks at no sizes. What does not fit any more, because somebody has changed a model, an environment or a file, is
refused before it reaches machine code, with what was expected and what came.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from gymnasium.envs.toy_text.frozen_lake import FrozenLakeEnv
from stable_baselines3.common.env_util import make_vec_env

from sb3_adaptive_q import (
    CompiledVecEnv,
    LeanVecEnv,
    LearningRateCallback,
    NStep,
    SARSALambda,
    TabularQ,
    learn_many,
    method,
)
from sb3_adaptive_q.algorithms.q_learning import q_learning
from sb3_adaptive_q.algorithms.traces import accumulate, visit
from sb3_adaptive_q.algorithms.td_update import Transition
from sb3_adaptive_q.checks import MOST_STEPS
from sb3_adaptive_q.compiled.loops import check_transition
from sb3_adaptive_q.envs.switching_tables import moving_goal
from sb3_adaptive_q.planning import TabularModel
from sb3_adaptive_q.vec_env import TabularDynamics, register_dynamics
from sb3_adaptive_q.vec_env.tabular_dynamics import read_table
from wrappers import DiscretizeObservation

BOTH = pytest.mark.parametrize("kind", [CompiledVecEnv, LeanVecEnv])
LAKE = "FrozenLake-v1"
LARGE = {"map_name": "8x8"}


def cart_pole() -> gym.Env:
    return DiscretizeObservation(gym.make("CartPole-v1"), 4, low=[-2.4, -4.0, -0.2, -4.0], high=[2.4, 4.0, 0.2, 4.0])


def moving() -> gym.Env:
    return gym.wrappers.TimeLimit(moving_goal(), 100)


def learned(env: Any = LAKE, kind: Any = CompiledVecEnv, n_envs: int = 1, **arguments: Any) -> TabularQ:
    return TabularQ("MlpPolicy", make_vec_env(env, n_envs, vec_env_cls=kind), seed=0, **arguments).learn(
        100, log_interval=None
    )


def refuses(model: TabularQ, message: str) -> None:
    """To go on; the table is left as it was."""
    before = model.q_table.copy()
    with pytest.raises(ValueError, match=message):
        model.learn(1000, log_interval=None, reset_num_timesteps=False)
    np.testing.assert_array_equal(model.q_table, before)


def env_of(model: TabularQ) -> Any:
    assert model.env is not None
    return model.env.envs[0]  # type: ignore[attr-defined]


def another_environment(model: TabularQ) -> None:
    assert model.env is not None
    model.env.envs[0] = gym.make(LAKE, **LARGE)  # type: ignore[attr-defined,arg-type]
    model.env.reset()


def another_map(model: TabularQ) -> None:
    env_of(model).unwrapped.__init__(**LARGE)


def fewer_actions(model: TabularQ) -> None:
    env_of(model).unwrapped.action_space = spaces.Discrete(2)


def another_policy(model: TabularQ) -> None:
    model.policy = learned(lambda: gym.make(LAKE, **LARGE)).policy  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (another_environment, "FrozenLakeEnv has 64 states and 4 actions, but the model's table has 16 and 4"),
        (another_map, "FrozenLakeEnv has 64 states and 4 actions, but the model's table has 16 and 4"),
        (fewer_actions, "FrozenLakeEnv has 16 states and 2 actions, but the model's table has 16 and 4"),
        (another_policy, "FrozenLakeEnv has 16 states and 4 actions, but the model's table has 64 and 4"),
    ],
)
def test_an_environment_of_another_size(change: Callable[[TabularQ], None], message: str) -> None:
    model = learned()
    change(model)
    refuses(model, message)


def test_a_finer_grid() -> None:
    model = learned(cart_pole)
    grid: Any = env_of(model)
    while not isinstance(grid, DiscretizeObservation):
        grid = grid.env
    grid.edges = [np.linspace(-1.0, 1.0, 9)] * 4
    refuses(model, r"CartPoleEnv has 10000 states and 2 actions, but the model's table has 625 and 2")


@BOTH
@pytest.mark.parametrize("algorithm", [SARSALambda, NStep])
def test_fewer_environments_than_there_are(kind: Any, algorithm: Any) -> None:
    """The arrays of traces have a part for each."""
    model = algorithm("MlpPolicy", make_vec_env(LAKE, 4, vec_env_cls=kind), seed=0)
    model.n_envs = 1
    with pytest.raises(ValueError, match="The model was made for a VecEnv of 1, but this one has 4 environments"):
        model.learn(1000)


def test_a_count_that_is_loaded(tmp_path: Path) -> None:
    learned(kind=LeanVecEnv).save(tmp_path / "model")
    model = TabularQ.load(tmp_path / "model", env=make_vec_env(LAKE, 4, vec_env_cls=LeanVecEnv), n_envs=1)
    with pytest.raises(ValueError, match="The model was made for a VecEnv of 1, but this one has 4 environments"):
        model.learn(1000)


def test_more_environments_than_there_are() -> None:
    env = make_vec_env(LAKE, vec_env_cls=CompiledVecEnv)
    env.num_envs = 3
    with pytest.raises(ValueError, match="`envs` must hold 3 environments, but holds 1"):
        TabularQ("MlpPolicy", env).learn(1000)


@BOTH
@pytest.mark.parametrize(
    "tensor",
    [
        th.zeros((1, 2, 2), dtype=th.float64),
        th.zeros((0, 0, 0), dtype=th.float64),
        th.zeros((1, 16, 4), dtype=th.float32),
        th.zeros((1, 4, 16), dtype=th.float64).transpose(1, 2),
    ],
)
def test_another_memory(kind: Any, tensor: th.Tensor) -> None:
    model = learned(kind=kind, method="bakf")
    model.policy.register_buffer(f"memory_{model.policy.memory_names()[0]}", tensor)
    refuses(model, r"`memory_\w+` must be a contiguous tensor of float64 and of shape \(1, 16, 4\)")


def test_another_table_of_masks() -> None:
    model = learned("Taxi-v4", kind=LeanVecEnv, use_masking=True)
    model.policy.register_buffer("allowed", th.ones((500, 2), dtype=th.float64))
    refuses(model, r"`allowed` must be a contiguous tensor of float64 and of shape \(500, 6\)")


def test_masks_that_were_not_asked_for_in_time() -> None:
    model = learned(kind=LeanVecEnv)
    model.use_masking = True
    refuses(model, "There is no table of masks in the policy: please pass `use_masking=True`")


class AtStateAndAction(LearningRateCallback):
    """A slip: right only where the memory is as large as the table."""

    memory = {"v": 0.0}  # noqa: RUF012

    @staticmethod
    def step_size(mu: float, step: Any, v: Any) -> float:
        v[step.state, step.action] += 1.0
        return 1.0 / v[step.state, step.action]


@BOTH
@pytest.mark.parametrize("scope", ["state", "shared"])
def test_a_step_size_that_looks_beyond_its_memory(kind: Any, scope: str) -> None:
    model = TabularQ("MlpPolicy", make_vec_env(LAKE, vec_env_cls=kind), seed=0)
    before = model.q_table.copy()
    with pytest.raises(ValueError, match=r"AtStateAndAction.* looked beyond the end of an array .*is `\[step.row, step.col"):
        model.learn(1000, callback=AtStateAndAction(scope=scope, mu_0=0.1))
    np.testing.assert_array_equal(model.q_table, before)
    model.learn(1000, callback=AtStateAndAction())


class Own(LearningRateCallback):
    """Divides by what is not 0 while learning, and looks into a table of its own that has no entry for the last state."""

    memory = {"v": 1.0}  # noqa: RUF012

    @staticmethod
    def step_size(mu: float, step: Any, v: Any) -> float:
        v[step.row, step.column] += 1.0 / abs(step.value)
        return min(OWN[step.state], 1.0)


OWN = np.full(15, 0.1)


@pytest.mark.parametrize("scope", ["pair", "state", "shared"])
def test_a_step_size_that_works_though_not_for_a_step_of_zeros(scope: str) -> None:
    """The last state of a lake is terminal, so no update begins there."""
    model = TabularQ("MlpPolicy", make_vec_env(LAKE, vec_env_cls=CompiledVecEnv), initial_q=1.0, seed=0)
    model.learn(1000, callback=Own(scope=scope, mu_0=0.1))
    assert (model.q_table < 1.0).any()


class BeyondWhereTheErrorIsNegative(LearningRateCallback):
    memory = {"v": 0.0}  # noqa: RUF012

    @staticmethod
    def step_size(mu: float, step: Any, v: Any) -> float:
        if step.td_error < 0.0:
            v[step.state + 40, step.action] += 1.0
        return 0.1


@BOTH
def test_a_slip_in_a_branch_is_found_too(kind: Any) -> None:
    """Without a look at the index, this writes into memory that is not the array's, and ends the process."""
    model = TabularQ("MlpPolicy", make_vec_env(LAKE, vec_env_cls=kind), initial_q=1.0, seed=0)
    with pytest.raises(ValueError, match=r"BeyondWhereTheErrorIsNegative.* looked beyond the end of an array"):
        model.learn(1000, callback=BeyondWhereTheErrorIsNegative())
    model.learn(1000, callback=method(1))


@BOTH
def test_an_update_of_ones_own_that_looks_beyond_its_table(kind: Any) -> None:
    class Beyond(TabularQ):
        @staticmethod
        def update(tables, agent, size, choose, expect, best, memory, draws, t):  # type: ignore[no-untyped-def]
            tables[0][t.next_state + 16, 0] = 1.0
            return q_learning(tables, agent, size, choose, expect, best, memory, draws, t)

    with pytest.raises(ValueError, match=r"The update of Beyond.* looked beyond the end of an array"):
        Beyond("MlpPolicy", make_vec_env(LAKE, vec_env_cls=kind), method="polynomial", seed=0).learn(1000)


def test_memory_that_was_dropped() -> None:
    model = learned(method="bakf")
    model.policy.forget_memory()
    refuses(model, "The policy has no buffer `memory_visits` any more")


def test_a_start_distribution_of_two_axes() -> None:
    model = learned()
    env_of(model).unwrapped.initial_state_distrib = np.full((1, 1000), 0.001)
    refuses(model, r"The probabilities of initial_state_distrib must sum to 1, but are an array of shape \(1, 1000\)")


@pytest.mark.parametrize("number", [-1, -50_000, 1e25, 0.5, float("nan"), "7", None])
@pytest.mark.parametrize("name", ["s", "clock"])
def test_numbers_that_no_environment_counts_to(name: str, number: Any) -> None:
    model = learned(moving)
    setattr(env_of(model).unwrapped, name, number)
    refuses(model, f"`{name}` of SwitchingTablesEnv must be a whole number from 0 to 2")


@pytest.mark.parametrize("state", [3.7, "3", -0.5, -1, None, float("nan"), 10**30])
def test_states_that_a_table_does_not_have(state: Any) -> None:
    model = learned()
    env_of(model).unwrapped.s = state
    refuses(model, "`s` of FrozenLakeEnv must be a whole number from 0 to 2")


@pytest.mark.parametrize("state", [None, 1.0, "text"])
def test_states_that_are_not_numbers(state: Any) -> None:
    model = learned(cart_pole)
    env_of(model).unwrapped.state = state
    refuses(model, "`state` of CartPoleEnv must be numbers, but is")


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("period", 0, "The period must be at least 1 step, but is 0"),
        ("period", float("nan"), "The period must be at least 1 step, but is nan"),
        ("n_changes", -1, "The number of changes must be at least 0, but is -1"),
    ],
)
def test_changes_that_cannot_be(name: str, value: Any, message: str) -> None:
    model = learned(moving)
    setattr(env_of(model).unwrapped, name, value)
    refuses(model, message)


def test_counts_beyond_what_a_training_reaches() -> None:
    model = learned()
    model.num_timesteps = MOST_STEPS + 1
    refuses(model, f"`num_timesteps` must be at most {MOST_STEPS}")
    assert model.learn(100, log_interval=None).num_timesteps == 100


def test_episodes_without_end_can_be_saved(tmp_path: Path) -> None:
    model = learned(total_episodes=MOST_STEPS)
    model.learn(100, log_interval=None, reset_num_timesteps=False).save(tmp_path / "model")
    assert TabularQ.load(tmp_path / "model").num_timesteps == 200


class Halves(FrozenLakeEnv):
    """A lake of which the agent sees only every second state."""

    def __init__(self) -> None:
        super().__init__()
        self.observation_space = spaces.Discrete(8)

    def reset(self, **arguments: Any) -> Any:
        state, info = super().reset(**arguments)
        return state // 2, info

    def step(self, action: Any) -> Any:
        state, *rest = super().step(action)
        return state // 2, *rest


@register_dynamics(Halves)
class HalvesDynamics(TabularDynamics):
    check = staticmethod(check_transition)

    def __init__(self, env: Any, grid: Any) -> None:
        self.env, self.parameters = env, read_table(FrozenLakeEnv())

    @staticmethod
    def index(parameters: Any, state: Any) -> Any:
        return state // 2


def test_states_may_be_more_than_rows() -> None:
    """What must be in range is the row, not the number of the state."""
    tables = []
    for kind in (CompiledVecEnv, LeanVecEnv):
        env = make_vec_env(lambda: gym.wrappers.TimeLimit(Halves(), 100), vec_env_cls=kind)
        model = TabularQ("MlpPolicy", env, learning_rate=0.1, seed=0).learn(3000, log_interval=None)
        tables.append(model.learn(3000, log_interval=None, reset_num_timesteps=False).q_table)
    np.testing.assert_array_equal(*tables)
    assert tables[0].any()


def share_policy(first: TabularQ, second: TabularQ) -> None:
    second.policy = first.policy


def share_table(first: TabularQ, second: TabularQ) -> None:
    second.policy.register_buffer("q_table", first.policy.q_table)


def share_environment(first: TabularQ, second: TabularQ) -> None:
    env_of(second).env = env_of(first).env


@pytest.mark.parametrize(
    ("share", "what"), [(share_policy, "tables"), (share_table, "tables"), (share_environment, "environments")]
)
def test_models_that_share_what_they_change(share: Callable[[TabularQ, TabularQ], None], what: str) -> None:
    models = [learned(), learned()]
    share(*models)
    with pytest.raises(ValueError, match=f"need {what} of their own, but two share one"):
        learn_many(models, 1000)


def test_a_full_list_of_traces_begins_anew() -> None:
    """As after a file, or after another λ with which fewer pairs are eligible at a time."""
    places, pairs = np.zeros((1, 4, 2), np.int64), np.array([[[0, 0], [1, 1]]])
    places[0, 0, 0], places[0, 1, 1] = 1, 2
    traces, n_pairs = np.array([[[0.5, 0.1], [0.9, 0.1]]]), np.array([2])
    t = Transition(3, 1, 0.0, 0, False, False, 0)
    visit((None, places, pairs, traces, n_pairs), 0, t, 0.25, accumulate)
    assert n_pairs.tolist() == [1] and pairs[0, 0].tolist() == [3, 1] and traces[0, 0].tolist() == [1.0, 0.25]
    assert np.argwhere(places).tolist() == [[0, 3, 1]] and places[0, 3, 1] == 1


@pytest.mark.parametrize("wrong", [-1.0, np.inf, np.nan])
@pytest.mark.parametrize("place", [0, 1])
def test_traces_that_no_training_leaves(wrong: float, place: int) -> None:
    model = SARSALambda("MlpPolicy", make_vec_env(LAKE, vec_env_cls=LeanVecEnv), seed=0).learn(7, log_interval=None)
    arrays = {name: array.copy() for name, array in model._working.items()}
    assert arrays["n_pairs"][0] > 0
    model.check_working_arrays(arrays)
    arrays["traces"][0, 0, place] = wrong
    with pytest.raises(ValueError, match="`traces` must hold a number of at least 0 and a step size from 0 to 1"):
        model.check_working_arrays(arrays)


def test_half_a_state_is_no_next_state() -> None:
    with pytest.raises(ValueError, match=r"The next states of P\[0\]\[0\] must be 0 to 1, but one is 0.5"):
        TabularModel.of(({0: {0: [(1.0, 0.5, 0.0, False)]}, 1: {0: [(1.0, 1, 0.0, True)]}}, [1.0, 0.0]))
