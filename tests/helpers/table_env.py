"""An environment of a user with a transition table, drawn from as gymnasium's toy-text environments draw."""

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
from gymnasium import spaces
from gymnasium.envs.toy_text.utils import categorical_sample

#: (probability, next state, reward, terminated)
Outcomes = Sequence[tuple[float, int, float, bool]]


class TableEnv(gym.Env):
    """
    Gymnasium's way with ``P`` and ``initial_state_distrib``.

    :param table: ``table[state][action]`` is a list of outcomes
    :param initial: the probabilities of the first state
    """

    metadata = {"render_modes": []}  # noqa: RUF012, as in gymnasium
    compile_by_table = True

    def __init__(self, table: Sequence[Sequence[Outcomes]], initial: Sequence[float]) -> None:
        self.P = {state: dict(enumerate(row)) for state, row in enumerate(table)}
        self.initial_state_distrib = initial
        self.observation_space = spaces.Discrete(len(table))
        self.action_space = spaces.Discrete(len(table[0]))

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[int, dict[str, Any]]:
        super().reset(seed=seed)
        self.s = int(categorical_sample(self.initial_state_distrib, self.np_random))
        return self.s, {}

    def step(self, action: Any) -> tuple[int, float, bool, bool, dict[str, Any]]:
        outcomes = self.P[self.s][action]
        chosen = categorical_sample([outcome[0] for outcome in outcomes], self.np_random)
        probability, self.s, reward, terminated = outcomes[chosen]
        return self.s, reward, terminated, False, {"prob": probability}
