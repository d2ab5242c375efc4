"""An environment that plays any transition table."""

from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.envs.toy_text.utils import categorical_sample

from sb3_adaptive_q.envs.tables import TABLES, Start, Table
from sb3_adaptive_q.envs.tabular_model import TabularModel

Step = tuple[int, float, bool, bool, dict[str, Any]]


class TableEnv(gym.Env[Any, Any]):
    """
    Draws from a table exactly as gymnasium's toy-text environments do.

    The table is in ``P``, the start distribution in ``initial_state_distrib``, the state in ``s``.

    :param table: ``table[state][action]`` is a list of (probability, next state, reward, terminated); states and actions
        count from 0, and every state has the same actions
    :param start: the probability of every state to be the first of an episode
    :param render_mode: ``None``; there is nothing to see
    :raises ValueError: as :class:`sb3_adaptive_q.planning.TabularModel`
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}  # type: ignore[misc]
    #: Nothing happens here but what is in the table, so that compiled code may draw from it instead
    compile_by_table = True

    def __init__(self, table: Table, start: Start, render_mode: str | None = None) -> None:
        TabularModel(table, start)  # which checks both
        self.P = table
        self.initial_state_distrib = np.asarray(start, np.float64)
        self.observation_space = spaces.Discrete(len(table))
        self.action_space = spaces.Discrete(len(table[0]))
        self.render_mode = render_mode

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[int, dict[str, Any]]:
        """
        Begin an episode.

        :param seed: of the random generator, if it is to be seeded
        :param options: unused
        :return: the first state, and ``{"prob": 1}`` as in gymnasium's environments
        """
        super().reset(seed=seed)
        self.s = int(categorical_sample(self.initial_state_distrib, self.np_random))
        return self.s, {"prob": 1}

    def step(self, action: int) -> Step:
        """
        Draw what happens.

        :param action: the number of the action
        :return: next state, reward, whether the episode terminated, False, and the probability of what was drawn
        """
        outcomes = self.P[self.s][int(action)]
        drawn = categorical_sample([outcome[0] for outcome in outcomes], self.np_random)
        probability, self.s, reward, terminated = outcomes[drawn]
        return self.s, reward, terminated, False, {"prob": probability}


def make_table_env(table: str, render_mode: str | None = None, **arguments: Any) -> TableEnv:
    """
    Make one of the package's own tables and an environment of it.

    :param table: the name of a function in :mod:`sb3_adaptive_q.envs.tables`
    :param render_mode: ``None``
    :param arguments: of that function
    :return: the environment
    """
    return TableEnv(*TABLES[table](**arguments), render_mode=render_mode)
