"""The part of a tabular algorithm that predicts."""

from math import inf
from typing import Any

import numpy as np

from sb3_adaptive_q.policies import TabularQPolicy, greedy


class Prediction:
    """Mixin of :class:`sb3_adaptive_q.TabularAlgorithm`: greedy actions, and those of the behaviour policy."""

    policy: TabularQPolicy
    exploration: str
    ties: str
    exploration_rate: float
    _predict_generator: np.random.Generator

    def predict(
        self,
        observation: Any,
        state: tuple[np.ndarray, ...] | None = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = False,
        action_masks: np.ndarray | None = None,
    ) -> tuple[np.ndarray, tuple[np.ndarray, ...] | None]:
        """
        The greedy action; with ``deterministic=False`` what the behaviour policy does, at the exploration rate in force.

        The action of one observation is a number of NumPy's, ``np.int64``, where other algorithms of SB3 return an array
        without axes: gymnasium's toy-text environments look the action up in a dict, and an array cannot be a key.

        :param observation: one observation, or several: a batch as a VecEnv gives it, or a list of observations
        :param state: handed back as it is
        :param episode_start: unused
        :param deterministic: whether to leave exploration out
        :param action_masks: 1 for every action that is allowed, 0 for the others, of shape (n_actions,) or (batch, n_actions);
            ``None`` for those that were seen with ``use_masking``, and else for all
        :return: the action, or the array of actions; and ``state``
        :raises ValueError: if an observation lies outside the observation space, or a mask does not fit or forbids all actions
        """
        choose = greedy if deterministic else self._explore
        return self.policy.predict(observation, state, episode_start, deterministic, action_masks, choose)

    def _explore(self, rows: np.ndarray) -> np.ndarray:
        """The behaviour policy's actions by the values of each state, which are minus infinity for forbidden actions."""
        generator = self._predict_generator
        if self.exploration == "boltzmann" and self.exploration_rate > 0.0:
            # With Gumbel noise, the largest one is a draw from the Boltzmann policy
            return (rows / self.exploration_rate + generator.gumbel(size=rows.shape)).argmax(axis=1)
        random_actions = np.where(rows == -inf, -1.0, generator.random(rows.shape)).argmax(axis=1)
        explores = generator.random(len(rows)) < self.exploration_rate
        if self.ties == "random":
            is_best = rows == rows.max(axis=1, keepdims=True)
            best = np.where(is_best, generator.random(rows.shape), -1.0).argmax(axis=1)
        else:
            best = greedy(rows)
        return np.where(explores, random_actions, best)
