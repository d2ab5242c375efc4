"""Policies that dynamic programming names: uniform, greedy, optimal, and the best that still explores."""

from typing import Any, NamedTuple

import numpy as np

from sb3_adaptive_q.planning.evaluation import solve, value_iteration
from sb3_adaptive_q.envs.tabular_model import Array, TabularModel

#: Action values that differ by less, in units of the largest or of 1, are ties that rounding has broken
_TIE = 1e-9


def uniform_policy(source: Any) -> Array:
    """
    Choose every action equally often.

    :param source: an environment with a table, (table, start distribution) or a :class:`TabularModel`
    :return: probabilities, of shape (n_states, n_actions)
    :raises ValueError: if there is no table
    """
    model = TabularModel.of(source)
    return np.full((model.n_states, model.n_actions), 1.0 / model.n_actions)


def action_values(source: Any, values: Array, gamma: float) -> Array:
    """
    Look one step ahead.

    :param source: an environment with a table, (table, start distribution) or a :class:`TabularModel`
    :param values: of the states after that step, of shape (n_states,)
    :param gamma: the discount factor
    :return: action values, of shape (n_states, n_actions): Q* from the values of :func:`value_iteration`
    :raises ValueError: if there is no table
    """
    model = TabularModel.of(source)
    terms = model.probabilities * np.asarray(values, np.float64)[model.next_states]
    # Each row's part of the running sums would lose digits; adding by row does not
    sums = np.bincount(np.repeat(np.arange(len(model.rewards)), np.diff(model.first)), terms, len(model.rewards))
    return (model.rewards + gamma * sums).reshape(model.n_states, model.n_actions)


def greedy_policy(action_values: Array, tolerance: float = 0.0) -> Array:
    """
    Choose the best action of every state; of several, the first.

    :param action_values: of shape (n_states, n_actions), a learned table for instance
    :param tolerance: up to which distance from the best an action counts as equally good
    :return: actions, of shape (n_states,)
    """
    action_values = np.asarray(action_values, np.float64)
    return np.argmax(action_values >= action_values.max(axis=1, keepdims=True) - tolerance, axis=1)


def optimal_policy(source: Any, gamma: float) -> Array:
    """
    Find the best policy without a horizon.

    :param source: an environment with a table, (table, start distribution) or a :class:`TabularModel`
    :param gamma: the discount factor
    :return: actions, of shape (n_states,); of several that are equally good but for rounding, the first
    :raises ValueError: as :func:`value_iteration`
    """
    model = TabularModel.of(source)
    return _first_best(action_values(model, value_iteration(model, gamma), gamma))


def epsilon_greedy_policy(actions: Any, epsilon: float, n_actions: int) -> Array:
    """
    Choose as epsilon-greedy behaviour does: with probability epsilon any action, each equally often.

    :param actions: the greedy action of every state, of shape (n_states,)
    :param epsilon: the probability of a random action, 0 to 1
    :param n_actions: number of actions
    :return: probabilities, of shape (n_states, n_actions)
    :raises ValueError: if epsilon is out of range
    """
    _check_epsilon(epsilon)
    return epsilon / n_actions + (1.0 - epsilon) * np.eye(n_actions)[np.asarray(actions)]


class SoftOptimum(NamedTuple):
    """
    The best of the policies that explore.

    :param values: of the states, of shape (n_states,)
    :param actions: the greedy action of every state, of shape (n_states,)
    :param policy: probabilities, of shape (n_states, n_actions)
    :param start_value: the mean of the values over the start distribution
    """

    values: Array
    actions: Array
    policy: Array
    start_value: float


def epsilon_greedy_optimum(source: Any, epsilon: float, gamma: float = 1.0) -> SoftOptimum:
    """
    Find the best epsilon-greedy policy, the limit of SARSA and Expected SARSA with this exploration.

    It is the fixed point of value iteration whose maximum is replaced by (1 - epsilon) max + epsilon mean (Sutton and
    Barto, 2018, section 5.4, treat it as an environment that chooses at random itself).

    :param source: an environment with a table, (table, start distribution) or a :class:`TabularModel`
    :param epsilon: the probability of a random action, 0 to 1
    :param gamma: the discount factor
    :return: its values, actions and probabilities
    :raises ValueError: if there is no table, an argument is out of range, or the values are infinite
    """
    _check_epsilon(epsilon)
    model = TabularModel.of(source)
    values = solve(model, model.rows, gamma, None, epsilon)
    actions = _first_best(action_values(model, values, gamma))
    return SoftOptimum(values, actions, epsilon_greedy_policy(actions, epsilon, model.n_actions), float(model.start @ values))


def _first_best(action_values: Array) -> Array:
    return greedy_policy(action_values, _TIE * max(1.0, float(np.abs(action_values).max())))


def _check_epsilon(epsilon: float) -> None:
    if not 0.0 <= epsilon <= 1.0:
        raise ValueError(f"epsilon must be between 0 and 1, but is {epsilon!r}.")
