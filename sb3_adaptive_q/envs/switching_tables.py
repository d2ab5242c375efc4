"""Environments that play one table until a given step, and then another."""

from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.envs.toy_text.utils import categorical_sample

from sb3_adaptive_q.envs.hidden import ClockDynamics, HiddenChangeEnv, OutcomeArrays
from sb3_adaptive_q.envs.tables import Start, Table, blocking_mazes, moving_goals, ring_walk, shortcut_mazes
from sb3_adaptive_q.random_numbers import random_float
from sb3_adaptive_q.vec_env import Grid, register_dynamics

#: Changes that never stop
_ENDLESS = 2**50


class SwitchingTablesEnv(HiddenChangeEnv):
    """
    Plays several tables of one shape in turn.

    The number of steps so far decides which, so that the changes come at the same steps whatever the agent does.

    :param phases: tables and their start distributions, which must be the same
    :param period: how many steps a phase takes
    :param n_changes: how often the table changes; ``None``: for ever, the first after the last
    :param render_mode: ``None``; there is nothing to see
    :raises ValueError: if the tables differ in shape, start distributions differ, the period is below 1, or the number of
        changes below 0
    """

    def __init__(
        self,
        phases: list[tuple[Table, Start]],
        period: int,
        n_changes: int | None = None,
        render_mode: str | None = None,
    ) -> None:
        self.tables = [table for table, _ in phases]
        shapes = {(len(table), len(table[0])) for table in self.tables}
        if len(shapes) != 1 or any(start != phases[0][1] for _, start in phases):
            raise ValueError(
                f"The phases must have tables of one shape and one start distribution, but the shapes are {shapes}."
            )
        _check_changes(period, n_changes)
        super().__init__(*shapes.pop(), phases[0][1], render_mode)
        self.period = period
        self.n_changes = _ENDLESS if n_changes is None else n_changes

    def phase_at(self, step: int) -> int:
        """
        Tell which table is played.

        :param step: the number of steps so far
        :return: the number of the table, from 0
        """
        return min(step // self.period, self.n_changes) % len(self.tables)

    def table_at(self, step: int) -> tuple[Table, Start]:
        """
        Return the table that is played.

        :param step: the number of steps so far
        :return: the table, and the start distribution
        """
        return self.tables[self.phase_at(step)], self.start

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        """
        Draw from the table of this phase, as gymnasium does.

        :param action: the number of the action
        :return: next state, reward, whether the episode terminated, False, and the probability of what was drawn
        """
        outcomes = self.tables[self.phase_at(self.clock)][self.s][int(action)]
        drawn = categorical_sample([outcome[0] for outcome in outcomes], self.np_random)
        probability, self.s, reward, terminated = outcomes[drawn]
        self.clock += 1
        return self.s, reward, terminated, False, {"prob": probability}


def _check_changes(period: int, n_changes: int | None) -> None:
    if not period >= 1:
        raise ValueError(f"The period must be at least 1 step, but is {period}.")
    if n_changes is not None and not n_changes >= 0:
        raise ValueError(f"The number of changes must be at least 0, but is {n_changes}.")


class SwitchingTables(NamedTuple):
    """The cumulative start distribution, the tables as :class:`OutcomeArrays`, and when to change."""

    start: npt.NDArray[np.float64]
    cumulative: npt.NDArray[np.float64]
    next_states: npt.NDArray[np.int64]
    rewards: npt.NDArray[np.float64]
    terminated: npt.NDArray[np.bool_]
    period: int
    n_changes: int


@register_dynamics(SwitchingTablesEnv)
class SwitchingTablesDynamics(ClockDynamics):
    """
    The compiled twin of :class:`SwitchingTablesEnv`. Its state is (state, clock), both whole numbers.

    :param env: the environment
    :param grid: unused
    """

    def __init__(self, env: gym.Env, grid: Grid | None) -> None:
        super().__init__(env, grid)
        assert isinstance(env, SwitchingTablesEnv)
        _check_changes(env.period, env.n_changes)
        arrays = OutcomeArrays.of(env.tables)
        self.parameters = SwitchingTables(np.cumsum(env.start), *arrays, env.period, env.n_changes)

    @staticmethod
    def step(parameters: Any, state: Any, action: Any, generator: Any) -> Any:
        """
        Draw from the table of this phase.

        :param parameters: the tables
        :param state: state and clock
        :param action: the number of the action
        :param generator: to draw from
        :return: the state afterwards, the reward, and whether the episode terminated
        """
        row, action, clock = np.uint64(int(state[0])), np.uint64(action), state[1]  # unsigned: see `TabularDynamics`
        # Quotients of whole numbers below 2**53, rounded down: exact as floats, and faster than as integers
        changes = min(int(clock / parameters.period), parameters.n_changes)
        table = np.uint64(changes - int(changes / parameters.cumulative.shape[0]) * parameters.cumulative.shape[0])
        number = random_float(generator)
        outcome = 0
        for i in range(parameters.cumulative.shape[3] - 1):
            outcome += 1 if parameters.cumulative[table, row, action, i] <= number else 0
        reward = parameters.rewards[table, row, action, outcome]
        terminated = parameters.terminated[table, row, action, outcome]
        return (float(parameters.next_states[table, row, action, outcome]), clock + 1.0), reward, terminated


def moving_goal(period: int = 40_000, render_mode: str | None = None) -> SwitchingTablesEnv:
    """
    Make a slippery grid whose goal jumps between the three far corners: bottom right, top right, bottom left, and again.

    :param period: how many steps the goal stays
    :param render_mode: ``None``
    :return: the environment
    """
    return SwitchingTablesEnv(moving_goals(), period, render_mode=render_mode)


def blocking_maze(period: int = 1000, render_mode: str | None = None) -> SwitchingTablesEnv:
    """
    Make a maze whose short way closes once while a long one opens (Sutton and Barto, 2018, example 8.2).

    :param period: after how many steps
    :param render_mode: ``None``
    :return: the environment
    """
    return SwitchingTablesEnv(blocking_mazes(), period, n_changes=1, render_mode=render_mode)


def shortcut_maze(period: int = 3000, render_mode: str | None = None) -> SwitchingTablesEnv:
    """
    Make a maze in which a shorter way opens once (Sutton and Barto, 2018, example 8.3).

    :param period: after how many steps
    :param render_mode: ``None``
    :return: the environment
    """
    return SwitchingTablesEnv(shortcut_mazes(), period, n_changes=1, render_mode=render_mode)


def switching_ring_walk(n_states: int = 21, period: int = 5000, render_mode: str | None = None) -> SwitchingTablesEnv:
    """
    Make the walk of Hutter and Legg (2007), whose reward of -1 becomes 0.5 and back.

    :param n_states: an odd number
    :param period: after how many steps
    :param render_mode: ``None``
    :return: the environment
    """
    return SwitchingTablesEnv([ring_walk(n_states, reward) for reward in (-1.0, 0.5)], period, render_mode=render_mode)
