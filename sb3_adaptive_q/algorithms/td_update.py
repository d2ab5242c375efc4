"""What the updates of all algorithms share. Plain functions, compiled into the learning loop."""

from typing import NamedTuple

import numpy as np

SAME_ACTION, NEXT_ACTION, MAXIMUM = range(3)
#: What a method's ``next_action`` may be, and the code by which the functions below know it
NEXT_ACTIONS = {"same": SAME_ACTION, "next": NEXT_ACTION, "max": MAXIMUM}


class Transition(NamedTuple):
    """
    What an environment did.

    :param state: s, as a row of the table
    :param action: a
    :param reward: r
    :param next_state: s', the state that was reached, not the one after a reset
    :param terminated: whether s' is terminal, and so worth 0
    :param done: whether the episode ended, by termination or by truncation
    :param start_state: the first state of the next episode where the episode ended, else s'
    """

    state: int
    action: int
    reward: float
    next_state: int
    terminated: bool
    done: bool
    start_state: int


class Agent(NamedTuple):
    """
    The numbers that an update may look at.

    :param gamma: the discount factor γ
    :param epsilon: the exploration rate in force (with Boltzmann exploration, the temperature)
    :param mu: the scalar step size in force
    :param progress: the part of the training that is done, from 0 to 1
    :param next_action: which action's value in s' the rule sees, a code of ``NEXT_ACTIONS``
    :param env: the number of the environment that the transition is from
    :param parameters: the algorithm's own parameters, such as λ
    """

    gamma: float
    epsilon: float
    mu: float
    progress: float
    next_action: int
    env: int
    parameters: tuple[float, ...]


class Memory(NamedTuple):
    """
    What a step size and an algorithm work with besides the table.

    :param arrays: of the step size, each of shape (n_tables, rows, columns)
    :param parameters: of the step size and of the rule
    :param bounds: the least and the largest step size
    :param algorithm_parameters: of the algorithm
    :param table: which of the algorithm's tables is updated
    """

    arrays: tuple[np.ndarray, ...]
    parameters: tuple[float, ...]
    bounds: tuple[float, float]
    algorithm_parameters: tuple[float, ...]
    table: int


def of_table(memory, table):
    """
    :param memory: the memory of an algorithm with several tables
    :param table: the number of one
    :return: the memory for an update of that table
    """
    return Memory(memory.arrays, memory.parameters, memory.bounds, memory.algorithm_parameters, table)


def is_sound(step):
    """
    :param step: an update, as the step size formed it
    :return: whether its step size is from 0 to 1. With another one nothing may be written, and the update is refused
    """
    return 0.0 <= step.size <= 1.0


def td_update(table, agent, size, memory, t, target, next_value):
    """
    Move one entry of a table towards a target: Q(s, a) += μ (target - Q(s, a)).

    :param table: action values, of shape (n_states, n_actions); left alone where the step size is not from 0 to 1
    :param agent: the numbers of the moment
    :param size: forms the step size, from ``memory`` and a :class:`Step`
    :param memory: of the step size
    :param t: the transition
    :param target: what Q(s, a) is moved towards
    :param next_value: the value inside the target, for the step size to see
    :return: the update, as a :class:`Step`
    """
    row, column = np.uint64(t.state), np.uint64(t.action)  # unsigned: Numba does not check for negative indices
    value = table[row, column]
    step = size(memory, agent, t, value, next_value, target - value)
    if is_sound(step):
        table[row, column] = value + step.size * step.td_error
    return step


def best_for_rule(tables, values, agent, best, t):
    """
    :param tables: as the behaviour policy has them
    :param values: the table to be updated, of shape (n_states, n_actions)
    :param agent: the numbers of the moment
    :param best: the best action in a state, and its value
    :param t: the transition
    :return: max_a Q_t(s', a) before the update where the rule asks for it, else 0
    """
    if agent.next_action != MAXIMUM or t.terminated:
        return 0.0
    return best(tables, values, t.next_state)[1]


def choose_after(tables, values, agent, choose, draws, t, step, best_value):
    """
    Choose the action to take in s' after the update of one entry.

    :param tables: what the behaviour looks at first, after the update
    :param values: the table that was updated, of shape (n_states, n_actions)
    :param agent: the numbers of the moment
    :param choose: the behaviour policy
    :param draws: the agent's counter
    :param t: the transition
    :param step: the update
    :param best_value: max_a Q_t(s', a) before the update, where the rule asks for it
    :return: the action (0 where s' is terminal), the update, and the value of s' for the rule
    """
    if t.terminated:
        return 0, step, 0.0
    action = choose(tables, t.next_state, agent.epsilon, draws)
    if agent.next_action == MAXIMUM:
        return action, step, best_value
    meant = t.action if agent.next_action == SAME_ACTION else action
    is_updated_entry = t.next_state == t.state and meant == t.action
    return action, step, step.value if is_updated_entry else values[np.uint64(t.next_state), np.uint64(meant)]


def keep_row(kept, values, t):
    """
    Copy the values of s', for an update of several entries that is followed by the choice of an action.

    :param kept: of shape (n_actions,); set to the row of s'
    :param values: of shape (n_states, n_actions)
    :param t: the transition
    """
    if not t.terminated:
        for action in range(values.shape[1]):
            kept[action] = values[t.next_state, action]


def kept_value(kept, agent, t, next_action, best_value):
    """
    :param kept: Q_t(s', ·), from :func:`keep_row`
    :param agent: the numbers of the moment; its ``next_action`` says which action is meant
    :param t: the transition
    :param next_action: the action that is taken in s'
    :param best_value: max_a Q_t(s', a), where the rule asks for it
    :return: Q_t(s', a) for the rule, 0 where s' is terminal
    """
    if t.terminated:
        return 0.0
    if agent.next_action == MAXIMUM:
        return best_value
    return kept[t.action if agent.next_action == SAME_ACTION else next_action]


def value_for_rule(tables, agent, best, t, next_action):
    """
    :param tables: action values first, before the update
    :param agent: the numbers of the moment; its ``next_action`` says which action is meant
    :param best: the best action in a state, and its value
    :param t: the transition
    :param next_action: the action that is taken in s'
    :return: Q_t(s', a) for the rule, 0 where s' is terminal
    """
    best_value = best_for_rule(tables, tables[0], agent, best, t)
    return kept_value(tables[0][t.next_state], agent, t, next_action, best_value)
