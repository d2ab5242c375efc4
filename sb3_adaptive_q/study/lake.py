"""Frozen Lake as its transition table tells it: the optimal values, and the map."""

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.toy_text.frozen_lake import FrozenLakeEnv


def lake_map(system: str) -> np.ndarray | None:
    """
    :param system: the id of an environment
    :return: the letters of its map, of shape (rows, columns), if it is a Frozen Lake
    """
    env: Any = gym.make(system).unwrapped
    return np.array(env.desc).astype(str) if isinstance(env, FrozenLakeEnv) else None


def optimal_values(system: str, gamma: float, tolerance: float = 1e-12) -> np.ndarray:
    """
    Value iteration.

    :param system: the id of an environment with a transition table ``P``
    :param gamma: the discount factor
    :param tolerance: the change below which it ends
    :return: Q*, of shape (n_states, n_actions)
    """
    env: Any = gym.make(system).unwrapped
    n_states, n_actions = env.observation_space.n, env.action_space.n
    rewards = np.zeros((n_states, n_actions))
    transitions = np.zeros((n_states, n_actions, n_states))
    for state, action in np.ndindex(n_states, n_actions):
        for probability, next_state, reward, terminated in env.P[state][action]:
            rewards[state, action] += probability * reward
            transitions[state, action, next_state] += 0.0 if terminated else probability
    values, change = np.zeros((n_states, n_actions)), np.inf
    while change > tolerance:
        improved = rewards + gamma * transitions @ values.max(axis=1)
        change, values = float(np.abs(improved - values).max()), improved
    return values
