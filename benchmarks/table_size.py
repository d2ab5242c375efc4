"""Steps per second against the size of the table, beside a walk through the same memory that does nothing else."""

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.wrappers import TimeLimit
from numba import njit
from stable_baselines3.common.monitor import Monitor

from benchmarks.bare_loops import BARE
from benchmarks.fastest_loops import GOLDEN, scramble
from benchmarks.measure import Contestant, Row, measure, print_rows, speed_ratio
from benchmarks.models import PlainCallback
from sb3_adaptive_q import CompiledVecEnv, TabularQ
from sb3_adaptive_q.random_numbers import random_float
from sb3_adaptive_q.vec_env import register_dynamics
from sb3_adaptive_q.vec_env.tabular_dynamics import TabularDynamics, TransitionTable, read_table

SIZES = (16, 256, 4_096, 65_536, 1_000_000, 10_000_000)
N_ACTIONS, EPISODE_STEPS = 2, 100
N_STEPS = 1_000_000
N_ROUNDS = 5


class RandomTableEnv(gym.Env):
    """
    Every action has two outcomes, drawn at random once: next states, rewards and their probabilities. Ten million states
    would not fit in memory as the lists of ``P``, so the table is made as the arrays that such lists are read into.

    :param n_states: the number of states
    """

    def __init__(self, n_states: int) -> None:
        self.observation_space = gym.spaces.Discrete(n_states)
        self.action_space = gym.spaces.Discrete(N_ACTIONS)
        self.table = _random_table(n_states)
        self.s = 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[int, dict[str, Any]]:
        super().reset(seed=seed)
        self.s = int(self.np_random.random() * len(self.table.outcomes))
        return self.s, {}

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        number = self.np_random.random()
        outcomes = self.table.outcomes[self.s, action]
        drawn = outcomes[int((outcomes["cumulative"][:-1] <= number).sum())]
        self.s = int(drawn["next_state"])
        return self.s, float(drawn["reward"]), False, False, {}

    def __deepcopy__(self, memo: dict[int, Any]) -> "RandomTableEnv":
        """With the same table, which nobody changes: it may take gigabytes."""
        duplicate = object.__new__(type(self))
        duplicate.__dict__.update(self.__dict__)
        return duplicate


@register_dynamics(RandomTableEnv)
class RandomTableDynamics(TabularDynamics):
    """
    As for any environment with a ``P``, but that an episode starts anywhere.

    :param env: the environment
    :param grid: unused
    """

    def __init__(self, env: Any, grid: Any) -> None:
        self.env = env
        self.parameters = env.table

    @staticmethod
    def reset(parameters, generator):
        """Draw the first state."""
        return int(random_float(generator) * parameters.outcomes.shape[0])


def main() -> None:
    """Print the curve."""
    title = f"TabularQ on random tables with {N_ACTIONS} actions, beside a walk through the same memory: speed, and the ratio"
    print_rows(title, [_row(n_states) for n_states in SIZES])


@njit(**BARE)
def walk(outcomes, table, n_steps):
    """Visit states: one random record of the transitions and one random entry of the table for each step, and no more."""
    state, counter = 0, np.uint64(0)
    for _ in range(n_steps):
        counter += GOLDEN
        number = scramble(counter)
        action = number & np.uint64(1)
        table[state, action] += 1.0
        state = outcomes[state, action, (number >> np.uint64(1)) & np.uint64(1)]["next_state"]
    return state


def _row(n_states: int) -> Row:
    env = RandomTableEnv(n_states)
    model = TabularQ(
        "MlpPolicy", CompiledVecEnv([lambda: Monitor(TimeLimit(env, EPISODE_STEPS))]), method=1, seed=0, ties="first"
    )
    visits = np.zeros((n_states, N_ACTIONS))

    def learn() -> Callable[[], Any]:
        return lambda: model.learn(N_STEPS, callback=PlainCallback())

    def stroll() -> Callable[[], Any]:
        return lambda: walk(env.table.outcomes, visits, N_STEPS)

    times = measure({"learn": Contestant(N_STEPS, learn), "walk": Contestant(N_STEPS, stroll)}, N_ROUNDS)
    megabytes = (env.table.outcomes.nbytes + visits.nbytes) / 1e6
    speeds = f"{times['learn'].steps_per_second():>15}, walk {times['walk'].steps_per_second():>15}"
    return speed_ratio(f"{n_states:>10,} states, {megabytes:>8,.2f} MB: {speeds}", times["learn"], times["walk"])


def _random_table(n_states: int) -> TransitionTable:
    small = read_table(_SmallTable())
    generator = np.random.default_rng(0)
    outcomes = np.empty((n_states, N_ACTIONS, small.outcomes.shape[2]), dtype=small.outcomes.dtype)
    outcomes["cumulative"] = small.outcomes["cumulative"][0, 0]
    outcomes["cumulative"][:, :, 0] = generator.random((n_states, N_ACTIONS))
    outcomes["reward"] = generator.random(outcomes.shape, dtype=np.float32)
    outcomes["next_state"] = generator.integers(n_states, size=outcomes.shape)
    outcomes["terminated"] = False
    return small._replace(outcomes=outcomes)


class _SmallTable:
    """What decides how a table with two outcomes is laid out in arrays."""

    observation_space = gym.spaces.Discrete(1)
    action_space = gym.spaces.Discrete(1)
    P = {0: {0: [(0.5, 0, 0.0, False), (0.5, 0, 0.0, False)]}}  # noqa: RUF012
    initial_state_distrib = (1.0,)
