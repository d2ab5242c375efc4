"""From a step size to the function that an update calls: which cell of the memory belongs to it, counted and clipped."""

from collections.abc import Callable
from typing import Any

import numpy as np

from sb3_adaptive_q.step_sizes.step import Step, clip_size

#: The array of counts of a step size that asks for them
COUNTS = "visits"


def pair_cell(state, action):
    """A cell for each state and action."""
    return state, action


def state_cell(state, action):
    """A cell for each state."""
    return state, 0


def shared_cell(state, action):
    """One cell for all."""
    return 0, 0


#: The cell that belongs to an update, by the name of the scope
SCOPES = {"pair": pair_cell, "state": state_cell, "shared": shared_cell}


def scope_shape(scope: str, n_states: int, n_actions: int) -> tuple[int, int]:
    """
    :param scope: a key of ``SCOPES``
    :param n_states: rows of the table
    :param n_actions: columns of the table
    :return: the shape of the arrays of a step size's memory
    """
    return {"pair": (n_states, n_actions), "state": (n_states, 1), "shared": (1, 1)}[scope]


def _first_arrays(number: int) -> Callable[..., Any]:
    """One table's part of the first arrays: machine code needs a function for each number of them."""
    if number == 0:
        return _nothing
    others, last = _first_arrays(number - 1), number - 1

    def first_arrays(arrays, table):
        return others(arrays, table) + (arrays[last][table],)  # noqa: RUF005

    return first_arrays


def _nothing(arrays, table):
    return ()


#: The largest number of arrays of a step size
MOST_ARRAYS = 6


def _count_update(arrays, row, column):
    row, column = np.uint64(row), np.uint64(column)  # unsigned: see `cell_of`
    arrays[0][row, column] += 1.0
    return arrays[0][row, column]


def _count_nothing(arrays, row, column):
    return 0.0


def _after_counts(arrays):
    return arrays[1:]


def _all(arrays):
    return arrays


def scalar_size(memory, agent, t, value, next_value, td_error):
    """
    The step size of a method that has one for all entries: the μ in force.

    :param memory: unused
    :param agent: the numbers of the moment
    :param t: the transition
    :param value: Q(s, a) before the update
    :param next_value: the value inside the target
    :param td_error: the temporal-difference error
    :return: the update
    """
    return Step(
        t.state, t.action, t.state, t.action, 0.0, value, next_value, td_error, agent.progress, agent.gamma, agent.mu
    )  # fmt: skip


def make_size(step_size: Callable[..., float], scope: str, counts: bool, n_arrays: int) -> Callable[..., Step]:
    """
    :param step_size: a step size's function
    :param scope: a key of ``SCOPES``
    :param counts: whether the first array holds the counts
    :param n_arrays: how many arrays there are, the counts included
    :return: the function that updates call; its arguments are those of :func:`scalar_size`
    """
    cell, of_table = SCOPES[scope], _first_arrays(n_arrays)
    count_update: Callable[..., Any] = _count_update if counts else _count_nothing
    own_arrays = _after_counts if counts else _all

    def size(memory, agent, t, value, next_value, td_error):
        row, column = cell(t.state, t.action)
        arrays = of_table(memory.arrays, memory.table)
        count = count_update(arrays, row, column)
        progress, gamma = agent.progress, agent.gamma
        step = Step(t.state, t.action, row, column, count, value, next_value, td_error, progress, gamma, 0.0)
        chosen = float(clip_size(step_size(agent.mu, step, *memory.parameters, *own_arrays(arrays)), *memory.bounds))
        return Step(t.state, t.action, row, column, count, value, next_value, td_error, progress, gamma, chosen)

    return size


def make_clipped(rule: Callable[..., float], lower: float, upper: float) -> Callable[..., float]:
    """
    :param rule: forms the next scalar step size
    :param lower: the least step size
    :param upper: the largest step size
    :return: the rule, clipped to these bounds
    """

    def clipped(mu, step, *parameters):
        return clip_size(float(rule(mu, step, *parameters)), lower, upper)

    return clipped


def keep_mu(mu, step, *parameters):
    """
    The rule in force where no method changes the scalar step size.

    :param mu: μ_t
    :param step: unused
    :param parameters: unused
    :return: μ_t
    """
    return mu


def last_size(mu, step, *parameters):
    """
    The rule of a method with a step size for each entry: μ shows the one that was used last.

    :param mu: unused
    :param step: the update
    :param parameters: unused
    :return: the step size of this update
    """
    return step.size
