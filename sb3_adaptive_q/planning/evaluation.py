"""Values and returns by dynamic programming."""

from math import isfinite
from typing import Any

import numpy as np

from sb3_adaptive_q.planning.sweeps import sweep_all, sweep_reached
from sb3_adaptive_q.envs.tabular_model import Array, TabularModel

#: How exact values are that have no horizon, in units of the largest value or of 1
ACCURACY = 1e-12
#: What rounding leaves of a change between two sweeps, in the same units
_ROUNDING = 4e-16
_NUMBERS = (int, float, np.number)
_MOST_SWEEPS = 1_000_000
_MOST_SWEEPS_FOR_GAIN = 100_000


def value_iteration(source: Any, gamma: float, horizon: int | None = None) -> Array:
    """
    Compute the optimal values of all states.

    :param source: an environment with a table, (table, start distribution) or a :class:`TabularModel`
    :param gamma: the discount factor, 0 to 1
    :param horizon: the steps that are left, where the best action may depend on them; ``None``: no end but termination
    :return: the values, of shape (n_states,); without a horizon exact to 1e-12 of the largest, or of 1
    :raises ValueError: if there is no table, an argument is out of range, or the values without a horizon do not converge
    """
    model = TabularModel.of(source)
    return solve(model, model.rows, gamma, horizon)


def policy_evaluation(source: Any, policy: Any, gamma: float, horizon: int | None = None) -> Array:
    """
    Compute the values of all states under a policy.

    :param source: an environment with a table, (table, start distribution) or a :class:`TabularModel`
    :param policy: the action of every state, integers of shape (n_states,), or the probabilities of all actions, of shape
        (n_states, n_actions)
    :param gamma: the discount factor, 0 to 1
    :param horizon: the steps that are left; ``None``: no end but termination
    :return: the values, of shape (n_states,); without a horizon exact to 1e-12 of the largest, or of 1
    :raises ValueError: if there is no table, the policy does not fit it, an argument is out of range, or the values
        without a horizon do not converge
    """
    model, rows = _under(TabularModel.of(source), policy)
    return solve(model, rows.reshape(-1, 1), gamma, horizon)


def expected_return(source: Any, policy: Any, gamma: float = 1.0, horizon: int | None = None) -> float:
    """
    Compute what an episode under a policy returns on average.

    :param source: an environment with a table, (table, start distribution) or a :class:`TabularModel`
    :param policy: the action of every state, or the probabilities of all actions, as for :func:`policy_evaluation`
    :param gamma: the discount factor; 1 is the return as it is counted
    :param horizon: after how many steps an episode is cut off; ``None``: never
    :return: the mean over the start distribution
    :raises ValueError: as :func:`policy_evaluation`; states that the policy never reaches do not matter
    """
    model, rows = _under(TabularModel.of(source), policy)
    limits, values = _limits(gamma, horizon), np.zeros(model.n_states)
    change = sweep_reached(model, rows, values, gamma, limits)
    if horizon is None:
        _check_convergence(change, limits[1], gamma)
    return float(model.start @ values)


def optimal_return(source: Any, gamma: float = 1.0, horizon: int | None = None) -> float:
    """
    Compute the largest mean return of an episode.

    :param source: an environment with a table, (table, start distribution) or a :class:`TabularModel`
    :param gamma: the discount factor; 1 is the return as it is counted
    :param horizon: after how many steps an episode is cut off, and the best policy knows how many are left; ``None``: never
    :return: the mean over the start distribution
    :raises ValueError: as :func:`value_iteration`
    """
    model = TabularModel.of(source)
    return float(model.start @ value_iteration(model, gamma, horizon))


def average_reward(source: Any, policy: Any = None) -> float:
    """
    Compute the gain: the mean reward of a step in the long run, by relative value iteration (White, 1963).

    :param source: an environment with a table, (table, start distribution) or a :class:`TabularModel`; no episode may
        terminate, and the gain must be the same from every state
    :param policy: as for :func:`policy_evaluation`; ``None``: the best one
    :return: the gain, exact to 1e-12 of the largest mean reward, or of 1
    :raises ValueError: if episodes terminate, or the gain depends on the first state
    """
    model = TabularModel.of(source)
    rows = model.rows
    if policy is not None:
        model, chosen = _under(model, policy)
        rows = chosen.reshape(-1, 1)
    masses = np.zeros(len(model.rewards))
    np.add.at(masses, np.repeat(np.arange(len(masses)), np.diff(model.first)), model.probabilities)
    if (masses < 1.0 - 1e-8).any():
        raise ValueError("The average reward is defined where no episode terminates, but here some do: use expected_return.")
    values = np.zeros(model.n_states)
    accuracy = ACCURACY * max(1.0, float(np.abs(model.rewards).max()))
    for _ in range(_MOST_SWEEPS_FOR_GAIN):
        before = values
        values = before.copy()
        sweep_all(model, rows, values, 1.0, 0.0, (1, 0.0))
        gains = values - before  # the gain lies between the least and the largest (Odoni, 1969)
        low, high = float(gains.min()), float(gains.max())
        if high - low <= 2 * accuracy:
            return (low + high) / 2
        # Half a step, as if every state were kept half of the time: the values of a periodic process would swing for ever
        values = 0.5 * (before + values)
        values -= values[0]
    raise ValueError(
        f"The average reward is not the same from every first state, but between {low:.6g} and {high:.6g}; or it needs more "
        f"than {_MOST_SWEEPS_FOR_GAIN} sweeps to find."
    )


def solve(model: TabularModel, rows: Array, gamma: float, horizon: int | None, epsilon: float = 0.0) -> Array:
    """
    Sweep backward until the horizon, or until the values stand still.

    :param model: the table
    :param rows: the rows to choose from in each state, of shape (n_states, n_choices)
    :param gamma: the discount factor
    :param horizon: how many sweeps to make, or ``None``
    :param epsilon: the probability of a random choice instead of the best
    :return: the values
    :raises ValueError: if an argument is out of range, or the values do not converge
    """
    values = np.zeros(model.n_states)
    limits = _limits(gamma, horizon)
    change = sweep_all(model, rows, values, gamma, epsilon, limits)
    if horizon is None:
        _check_convergence(change, limits[1], gamma)
    return values


def _limits(gamma: Any, horizon: Any) -> tuple[int, float]:
    """How many sweeps to make at most, and the change that is small enough to stop earlier."""
    if not (isinstance(gamma, _NUMBERS) and 0.0 <= gamma <= 1.0):
        raise ValueError(f"gamma must be a number between 0 and 1, but is {gamma!r}.")
    if horizon is None:
        # Of a contraction by gamma, the distance to the fixed point is at most gamma / (1 - gamma) of the last change
        return _MOST_SWEEPS, max(ACCURACY * (1.0 - gamma) / max(gamma, 0.5), _ROUNDING)
    if not (isinstance(horizon, _NUMBERS) and isfinite(horizon) and horizon >= 0 and horizon == int(horizon)):
        raise ValueError(f"The horizon must be a whole number of steps, at least 0, or None, but is {horizon!r}.")
    return int(horizon), 0.0  # where nothing changes, no later sweep will


def _check_convergence(change: float, smallest_change: float, gamma: float) -> None:
    if not change <= smallest_change:  # nor where it is not a number
        raise ValueError(
            f"The values do not converge with gamma = {gamma} within {_MOST_SWEEPS} sweeps, because episodes may never end "
            "or are very long: use a smaller gamma, or a horizon."
        )


def _under(model: TabularModel, policy: Any) -> tuple[TabularModel, Array]:
    """A model and the row of it that a policy takes in each state: where it draws its actions, a model with one action."""
    policy = np.asarray(policy)
    if policy.ndim == 1:
        return model, _rows_of(model, policy)
    mixed = model.under(_checked_probabilities(model, policy))
    return mixed, mixed.rows[:, 0]


def _rows_of(model: TabularModel, actions: Array) -> Array:
    if actions.shape != (model.n_states,) or actions.dtype.kind not in "iu":
        raise ValueError(
            f"A policy must be an integer action for each of the {model.n_states} states, or an array of probabilities of "
            f"shape {(model.n_states, model.n_actions)}, but has shape {actions.shape} and type {actions.dtype}."
        )
    if actions.min() < 0 or actions.max() >= model.n_actions:
        raise ValueError(f"The actions must be 0 to {model.n_actions - 1}, but are {actions.min()} to {actions.max()}.")
    return model.rows[:, 0] + actions.astype(np.int64)


def _checked_probabilities(model: TabularModel, policy: Array) -> Array:
    if policy.shape != (model.n_states, model.n_actions):
        raise ValueError(
            f"The probabilities of a policy must have shape {(model.n_states, model.n_actions)}, but have {policy.shape}."
        )
    if not ((policy >= 0.0).all() and (np.abs(policy.sum(axis=1) - 1.0) <= 1e-8).all()):
        raise ValueError("The probabilities of a policy must sum to 1 in every state, and be at least 0.")
    return policy
