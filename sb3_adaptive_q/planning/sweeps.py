"""
The loops of dynamic programming, compiled.

A table is handed over as arrays: ``first[row]`` to ``first[row + 1]`` are the places of a row's successors in
``next_states`` and ``probabilities``; what their probabilities lack to 1 ends the episode; ``rewards`` has the mean reward
of each row. ``limits`` are two numbers: how many sweeps to make, and at which change from one sweep to the next to stop
earlier, in units of the largest value or of 1, if that is more.
"""

from typing import Any

import numpy as np
from numba import njit

#: After how many sweeps to see whether the values still change, which takes a third of a sweep
_CHECKED_EVERY = 16

_compiled = njit(cache=True, nogil=True, error_model="numpy")


@_compiled
def sweep(
    values: Any,
    rows: Any,
    first: Any,
    next_states: Any,
    probabilities: Any,
    rewards: Any,
    gamma: float,
    epsilon: float,
    limits: Any,
) -> float:
    """
    Replace the values of all states by what one step and the values after it are worth, again and again.

    :param values: of shape (n_states,); changed in place
    :param rows: the rows of the table to choose from in each state, of shape (n_states, n_choices)
    :param first: of the table
    :param next_states: of the table
    :param probabilities: of the table
    :param rewards: of the table
    :param gamma: the discount factor
    :param epsilon: the probability of a random choice instead of the best
    :param limits: when to stop
    :return: the change in the last sweep
    """
    n_states, n_choices = rows.shape
    old = values.copy()
    change = np.inf
    for _ in range(int(limits[0])):
        difference, largest = 0.0, 1.0
        for state in range(n_states):
            best, total = -np.inf, 0.0
            for choice in range(n_choices):
                row = rows[state, choice]
                value = 0.0
                for i in range(first[row], first[row + 1]):
                    value += probabilities[i] * old[next_states[i]]
                value = rewards[row] + gamma * value
                best = max(best, value)
                total += value
            value = best if epsilon == 0.0 else (1.0 - epsilon) * best + epsilon * (total / n_choices)
            difference = max(difference, abs(value - old[state]))
            largest = max(largest, abs(value))
            values[state] = value
        old[:] = values
        change = difference / largest
        if change <= limits[1]:
            break
    return change


@_compiled
def mean_return(
    start: Any, rows: Any, first: Any, next_states: Any, probabilities: Any, rewards: Any, gamma: float, limits: Any
) -> tuple[float, float]:
    """
    Evaluate a policy backward, in the states alone that it comes to from the start.

    :param start: the start distribution, of shape (n_states,)
    :param rows: the row of the table that the policy takes in each state, of shape (n_states,)
    :param first: of the table
    :param next_states: of the table
    :param probabilities: of the table
    :param rewards: of the table
    :param gamma: the discount factor
    :param limits: when to stop
    :return: the mean value over the start distribution, and the change in the last sweeps; 0 if there was no need to know
    """
    states, numbers = _reachable(start, rows, first, next_states, probabilities)
    # Unsigned indices spare the check for negative ones, and with it nearly half of the time
    ends = np.zeros(len(states) + 1, np.uint64)
    for i, state in enumerate(states):
        ends[i + 1] = ends[i] + np.uint64(first[rows[state] + 1] - first[rows[state]])
    successors, weights = np.empty(int(ends[-1]), np.uint64), np.empty(int(ends[-1]))
    gains = np.empty(len(states))
    for i, state in enumerate(states):
        row = rows[state]
        gains[i] = rewards[row]
        for j in range(first[row + 1] - first[row]):
            successors[int(ends[i]) + j] = numbers[next_states[first[row] + j]]
            weights[int(ends[i]) + j] = gamma * probabilities[first[row] + j]

    old, values = np.zeros(len(states)), np.zeros(len(states))
    change = 0.0
    for sweep_number in range(1, int(limits[0]) + 1):
        for i in range(len(states)):
            value = gains[i]
            for j in range(ends[i], ends[i + 1]):
                value += weights[j] * old[successors[j]]
            values[i] = value
        old, values = values, old
        if sweep_number % _CHECKED_EVERY == 0:
            change = np.abs(old - values).max() / max(1.0, np.abs(old).max())
            if change <= limits[1]:
                break
    total = 0.0
    for i, state in enumerate(states):
        total += start[state] * old[i]
    return total, change


@_compiled
def _reachable(start: Any, rows: Any, first: Any, next_states: Any, probabilities: Any) -> tuple[Any, Any]:
    """The states that a policy comes to, and the place of each state among them, -1 where it is not."""
    numbers = np.full(len(rows), -1)
    states = np.empty(len(rows), np.int64)
    found = 0
    for state in range(len(rows)):
        if start[state] > 0.0:
            numbers[state], states[found] = found, state
            found += 1
    looked_at = 0
    while looked_at < found:
        row = rows[states[looked_at]]
        for i in range(first[row], first[row + 1]):
            state = next_states[i]
            if numbers[state] < 0 and probabilities[i] > 0.0:
                numbers[state], states[found] = found, state
                found += 1
        looked_at += 1
    return states[:found], numbers
