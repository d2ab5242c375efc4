"""What environments have in common whose rules change at times that the agent cannot see."""

from typing import Any, ClassVar, NamedTuple

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.envs.toy_text.utils import categorical_sample

from sb3_adaptive_q.envs.tables import Start, Table
from sb3_adaptive_q.random_numbers import draw_place
from sb3_adaptive_q.vec_env.dynamics import Dynamics, whole_number_of
from sb3_adaptive_q.vec_env.readings import Readings


class HiddenChangeEnv(gym.Env[Any, Any]):
    """
    An environment with a clock.

    The clock counts the steps since the environment was made or last seeded, over all episodes. It is not observed.

    :param n_states: number of states
    :param n_actions: number of actions
    :param start: the probability of every state to be the first of an episode
    :param render_mode: ``None``; there is nothing to see
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}  # type: ignore[misc]
    #: The state, which is what is observed
    s: int

    def __init__(self, n_states: int, n_actions: int, start: Start, render_mode: str | None = None) -> None:
        self.observation_space = spaces.Discrete(n_states)
        self.action_space = spaces.Discrete(n_actions)
        self.render_mode = render_mode
        self.start = start
        #: Steps so far
        self.clock = 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[int, dict[str, Any]]:
        """
        Draw the first state, as gymnasium's toy-text environments do.

        :param seed: of the random generator; seeding also sets the clock to 0
        :param options: unused
        :return: the first state, and an empty dict
        """
        super().reset(seed=seed)
        if seed is not None:
            self.clock = 0
        self.s = int(categorical_sample(self.start, self.np_random))
        return self.s, {}

    def phase_at(self, step: int) -> int:
        """
        Tell which of the rules hold.

        :param step: the number of steps so far
        :return: a number that is the same where the same rules hold
        """
        raise NotImplementedError

    def table_at(self, step: int) -> tuple[Table, Start]:
        """
        Write down the rules, for :mod:`sb3_adaptive_q.planning`.

        :param step: the number of steps so far
        :return: the table that the next step is drawn from, and the start distribution
        """
        raise NotImplementedError


_readings = Readings(most=20)


class OutcomeArrays(NamedTuple):
    """
    Tables of one shape as arrays, from which plain functions draw the outcomes that gymnasium draws from the tables.

    All have the shape (n_tables, n_states, n_actions, most outcomes + 1). Rows are filled up with their first outcome, which
    gymnasium takes where rounding leaves a drawn number above all cumulative probabilities.

    :param cumulative: cumulative probabilities, then infinity
    :param next_states: next states
    :param rewards: rewards
    :param terminated: whether the episode terminates
    """

    cumulative: npt.NDArray[np.float64]
    next_states: npt.NDArray[np.int64]
    rewards: npt.NDArray[np.float64]
    terminated: npt.NDArray[np.bool_]

    @classmethod
    def of(cls, tables: list[Table]) -> "OutcomeArrays":
        """
        Write tables as arrays.

        :param tables: of one shape
        :return: the arrays; equal tables share them
        """
        return _readings.get(tables, lambda: cls._read(tables))

    @classmethod
    def _read(cls, tables: list[Table]) -> "OutcomeArrays":
        n_states, n_actions = len(tables[0]), len(tables[0][0])
        rows = [table[state][action] for table in tables for state in range(n_states) for action in range(n_actions)]
        width = max(len(row) for row in rows) + 1
        shape = (len(tables), n_states, n_actions, width)
        cumulative = np.full((len(rows), width), np.inf)
        for bounds, row in zip(cumulative, rows, strict=True):
            bounds[: len(row)] = np.cumsum([outcome[0] for outcome in row])
        columns = zip(*(outcome for row in rows for outcome in row + row[:1] * (width - len(row))), strict=True)
        _, next_states, rewards, terminated = columns
        return cls(
            cumulative.reshape(shape),
            np.array(next_states, np.int64).reshape(shape),
            np.array(rewards, np.float64).reshape(shape),
            np.array(terminated, np.bool_).reshape(shape),
        )


class ClockDynamics(Dynamics):
    """
    What the compiled twins of such environments have in common. The state is (state, clock), both whole numbers; the
    parameters have the cumulative start distribution in ``start``.

    :param env: the environment
    :param grid: unused
    """

    draws_from_words = True

    def table_shape(self) -> tuple[int, int]:
        """
        Tell the size of the tables.

        :return: their states and actions
        """
        return self.parameters.next_states.shape[-3:-1]

    def read_state(self) -> tuple[float, float]:
        """
        Read the environment's state.

        :return: state and clock
        :raises ValueError: if one of them is no whole number from 0 to 2**53
        """
        return float(whole_number_of(self.env, "s")), float(whole_number_of(self.env, "clock"))

    def write_state(self, state: Any) -> None:
        """
        Put the environment into a state.

        :param state: state and clock
        """
        self.env.s, self.env.clock = int(state[0]), int(state[1])  # type: ignore[attr-defined]

    @staticmethod
    def reset(parameters: Any, state: Any, generator: Any) -> Any:
        """
        Draw the first state of an episode; the clock goes on.

        :param parameters: with the start distribution
        :param state: where the last episode ended
        :param generator: to draw from
        :return: the state to begin with
        """
        return float(draw_place(parameters.start, generator)), state[1]

    @staticmethod
    def index(parameters: Any, state: Any) -> int:
        """
        Number the state.

        :param parameters: unused
        :param state: state and clock
        :return: the row of the Q table
        """
        return int(state[0])
