"""
The loops of dynamic programming, as plain functions that become machine code.

A table is handed over as four arrays: ``first[row]`` to ``first[row + 1]`` are the places of a row's successors in
``next_states`` and ``probabilities``; what their probabilities lack to 1 ends the episode; ``rewards`` has the mean reward
of each row. ``limits`` are two numbers: how many sweeps to make, and at which change from one sweep to the next to stop
earlier, in units of the largest value or of 1, if that is more.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from sb3_adaptive_q.compiled.jit import as_python, is_disabled, machine_code
from sb3_adaptive_q.envs.tabular_model import Array, TabularModel

#: After how many sweeps to see whether the values of reached states still change, which takes half of a sweep
_CHECKED_EVERY = 16

_code: dict[Callable[..., Any], Callable[..., Any]] = {}


def sweep_all(
    model: TabularModel, rows: Array, values: Array, gamma: float, epsilon: float, limits: tuple[int, float]
) -> float:
    """
    Replace the values of all states by what one step and the values after it are worth, again and again.

    :param model: the table
    :param rows: the rows of the table to choose from in each state, of shape (n_states, n_choices)
    :param values: of shape (n_states,), float64; changed in place
    :param gamma: the discount factor
    :param epsilon: the probability of a random choice instead of the best
    :param limits: when to stop
    :return: the change in the last sweep
    """
    rows = np.ascontiguousarray(rows)
    return _run(_sweep, values, values.copy(), rows, _arrays(model), float(gamma), float(epsilon), np.array(limits, float))


def sweep_reached(model: TabularModel, rows: Array, values: Array, gamma: float, limits: tuple[int, float]) -> float:
    """
    Do the same for a policy, in the states alone that it comes to from the start.

    :param model: the table
    :param rows: the row of the table that the policy takes in each state, of shape (n_states,)
    :param values: of shape (n_states,), float64; those of reached states are set
    :param gamma: the discount factor
    :param limits: when to stop
    :return: the change in the last sweep that was looked at; 0 if none was
    """
    n_states, n_successors = model.n_states, len(model.next_states)
    # Unsigned indices spare the check for negative ones, and with it nearly half of the time
    places = (np.empty(n_states, np.int64), np.full(n_states, -1), np.zeros(n_states + 1, np.uint64))
    successors, weights = np.empty(n_successors, np.uint64), np.empty(n_successors)
    chain = (successors, weights, np.empty(n_states), np.zeros(n_states), np.zeros(n_states))
    rows = np.ascontiguousarray(rows)
    return _run(
        _sweep_reached, values, model.start, rows, _arrays(model), float(gamma), np.array(limits, float), places, chain
    )


def _arrays(model: TabularModel) -> tuple[Array, ...]:
    return model.first, model.next_states, model.probabilities, model.rewards


def _run(function: Callable[..., float], *arguments: Any) -> float:
    """Run machine code; the arguments have the same types in every call."""
    if function not in _code:
        _code[function] = as_python(function) if is_disabled() else machine_code(function, arguments)
    return float(_code[function](*arguments))


def _sweep(values: Any, old: Any, rows: Any, table: tuple[Any, ...], gamma: float, epsilon: float, limits: Any) -> float:
    first, next_states, probabilities, rewards = table
    n_states, n_choices = rows.shape
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
        for state in range(n_states):
            old[state] = values[state]
        change = difference / largest
        if change <= limits[1]:
            break
    return change


def _sweep_reached(
    values: Any, start: Any, rows: Any, table: tuple[Any, ...], gamma: float, limits: Any, places: Any, chain: Any
) -> float:
    states, _, ends = places
    successors, weights, gains, old, new = chain
    n_reached = _number_reached_states(start, rows, table, places)
    _gather(rows, table, gamma, places, chain, n_reached)
    change = 0.0
    for sweep in range(1, int(limits[0]) + 1):
        for i in range(n_reached):
            value = gains[i]
            for j in range(ends[i], ends[i + 1]):
                value += weights[j] * old[successors[j]]
            new[i] = value
        old, new = new, old
        if sweep % _CHECKED_EVERY == 0:
            difference, largest = 0.0, 1.0
            for i in range(n_reached):
                difference = max(difference, abs(old[i] - new[i]))
                largest = max(largest, abs(old[i]))
            change = difference / largest
            if change <= limits[1]:
                break
    for i in range(n_reached):
        values[states[i]] = old[i]
    return change


def _number_reached_states(start: Any, rows: Any, table: Any, places: Any) -> int:
    """Collect the states that a policy comes to, and the place of each state among them; -1 means nowhere."""
    states, numbers, _ = places
    first, next_states, probabilities, _ = table
    n_found = 0
    for state in range(len(rows)):
        if start[state] > 0.0:
            numbers[state], states[n_found] = n_found, state
            n_found += 1
    looked_at = 0
    while looked_at < n_found:
        row = rows[states[looked_at]]
        for i in range(first[row], first[row + 1]):
            state = next_states[i]
            if numbers[state] < 0 and probabilities[i] > 0.0:
                numbers[state], states[n_found] = n_found, state
                n_found += 1
        looked_at += 1
    return n_found


def _gather(rows: Any, table: Any, gamma: float, places: Any, chain: Any, n_reached: int) -> None:
    """Copy what the policy meets, one reached state after another."""
    states, numbers, ends = places
    successors, weights, gains, _, _ = chain
    first, next_states, probabilities, rewards = table
    end = 0
    for place in range(n_reached):
        row = rows[states[place]]
        gains[place] = rewards[row]
        for i in range(first[row], first[row + 1]):
            if probabilities[i] > 0.0:  # else it may lead to where the policy never comes
                successors[end], weights[end] = numbers[next_states[i]], gamma * probabilities[i]
                end += 1
        ends[place + 1] = end
