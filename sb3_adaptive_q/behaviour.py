"""
Behaviour policies: how an action is chosen, what the policy expects of a state, and which action is best. Plain functions,
compiled into the learning loop.

A policy looks at the first of the algorithm's tables. Every ``choose(tables, state, epsilon, draws)`` draws from the agent's
counter in a stated order. Every ``expect(tables, values, state, epsilon)`` gives Σ_a π(a|s) values[s, a], for the policy π
that ``choose`` follows. ``best(tables, values, state)`` gives argmax_a values[s, a] and its value.
``show(tables, state, row)`` writes what the policy looks at into a row. Where actions are masked,
:mod:`sb3_adaptive_q.action_masks` makes the same functions of the allowed actions.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

from sb3_adaptive_q.random_numbers import uniform


def first_greedy(table, state):
    """
    :param table: action values, of shape (n_states, n_actions)
    :param state: the row
    :return: the action of the largest value, the first of them in a tie
    """
    return first_best((), table, state)[0]


def largest(table, state):
    """
    :param table: action values, of shape (n_states, n_actions)
    :param state: the row
    :return: max_a table[state, a]
    """
    best_value = table[state, 0]
    for action in range(1, table.shape[1]):
        if table[state, action] > best_value:
            best_value = table[state, action]
    return best_value


def random_greedy(table, state, draws):
    """
    :param table: action values, of shape (n_states, n_actions)
    :param state: the row
    :param draws: the agent's counter; one number is drawn where several actions are best, none elsewhere
    :return: one of the actions of the largest value
    """
    best_action, best_value, n_best = 0, table[state, 0], 1
    for action in range(1, table.shape[1]):
        value = table[state, action]
        if value > best_value:
            best_action, best_value, n_best = action, value, 1
        elif value == best_value:
            n_best += 1
    if n_best == 1:
        return best_action
    place = int(uniform(draws) * n_best)
    for action in range(table.shape[1]):
        if table[state, action] == best_value:
            if place == 0:
                return action
            place -= 1
    return best_action


def first_best(tables, values, state):
    """
    :param tables: unused
    :param values: of shape (n_states, n_actions)
    :param state: the row
    :return: the action of the largest value, the first of them in a tie; and that value
    """
    best_action, best_value = 0, values[state, 0]
    for action in range(1, values.shape[1]):
        if values[state, action] > best_value:
            best_action, best_value = action, values[state, action]
    return best_action, best_value


def show_all(tables, state, row):
    """
    :param tables: of action values first, of shape (n_states, n_actions)
    :param state: the state to act in
    :param row: of shape (n_actions,); set to the values of the actions
    """
    for action in range(row.shape[0]):
        row[action] = tables[0][state, action]


def epsilon_greedy_first(tables, state, epsilon, draws):
    """
    The ε-greedy policy that takes the first of the best actions. It draws once, and again where it explores.

    :param tables: of action values first, of shape (n_states, n_actions)
    :param state: the state to act in
    :param epsilon: the probability of a uniformly random action
    :param draws: the agent's counter
    :return: the action
    """
    if uniform(draws) < epsilon:
        return int(uniform(draws) * tables[0].shape[1])
    return first_greedy(tables[0], state)


def epsilon_greedy_random(tables, state, epsilon, draws):
    """
    The ε-greedy policy that takes any of the best actions. It draws once, and again where it explores or finds a tie.

    :param tables: of action values first, of shape (n_states, n_actions)
    :param state: the state to act in
    :param epsilon: the probability of a uniformly random action
    :param draws: the agent's counter
    :return: the action
    """
    if uniform(draws) < epsilon:
        return int(uniform(draws) * tables[0].shape[1])
    return random_greedy(tables[0], state, draws)


def value_of_first(table, values, state, best_value):
    """
    :param table: what the policy looks at, of shape (n_states, n_actions)
    :param values: what is averaged, of the same shape
    :param state: the row
    :param best_value: unused
    :return: the value of the first of the best actions
    """
    return values[state, first_greedy(table, state)]


def mean_of_best(table, values, state, best_value):
    """
    :param table: what the policy looks at, of shape (n_states, n_actions)
    :param values: what is averaged, of the same shape
    :param state: the row
    :param best_value: max_a table[state, a]
    :return: the mean value of the best actions
    """
    total, n_best = 0.0, 0
    for action in range(table.shape[1]):
        if table[state, action] == best_value:
            total, n_best = total + values[state, action], n_best + 1
    return total if n_best == 1 else total / n_best


def make_expect_epsilon_greedy(greedy_value: Callable[..., float]) -> Callable[..., float]:
    """
    :param greedy_value: the value of the greedy part of the policy, where it is not the largest value itself
    :return: the expectation of an ε-greedy policy
    """

    def expect_epsilon_greedy(tables, values, state, epsilon):
        table, total, best_value = tables[0], values[state, 0], tables[0][state, 0]
        for action in range(1, table.shape[1]):
            total += values[state, action]
            if table[state, action] > best_value:
                best_value = table[state, action]
        greedy_part = best_value if values is table else greedy_value(table, values, state, best_value)
        return epsilon * (total * (1.0 / table.shape[1])) + (1.0 - epsilon) * greedy_part

    return expect_epsilon_greedy


def boltzmann(tables, state, temperature, draws):
    """
    The Boltzmann policy, π(a|s) in proportion to exp(Q(s, a) / temperature). It draws once.

    :param tables: of action values first, of shape (n_states, n_actions)
    :param state: the state to act in
    :param temperature: above 0, in the unit of the values
    :param draws: the agent's counter
    :return: the action
    """
    table = tables[0]
    best_value, total = largest(table, state), 0.0
    for action in range(table.shape[1]):
        total += math.exp((table[state, action] - best_value) / temperature)
    rest = uniform(draws) * total
    for action in range(table.shape[1] - 1):
        rest -= math.exp((table[state, action] - best_value) / temperature)
        if rest < 0.0:
            return action
    return table.shape[1] - 1


def expect_boltzmann(tables, values, state, temperature):
    """
    :param tables: what the policy looks at first, of shape (n_states, n_actions)
    :param values: what is averaged, of the same shape
    :param state: the row
    :param temperature: above 0, in the unit of the values
    :return: the expectation of ``values`` under the Boltzmann policy
    """
    table = tables[0]
    best_value, total, weighted = largest(table, state), 0.0, 0.0
    for action in range(table.shape[1]):
        weight = math.exp((table[state, action] - best_value) / temperature)
        total += weight
        weighted += weight * values[state, action]
    return weighted / total


class Behaviour(NamedTuple):
    """A behaviour policy; see the top of this module for the arguments of its functions."""

    choose: Callable[..., int]
    expect: Callable[..., float]
    best: Callable[..., tuple[int, float]]
    show: Callable[..., None]


#: By the names of the constructor's arguments ``exploration`` and ``ties``
BEHAVIOURS = {
    ("epsilon_greedy", "first"): Behaviour(
        epsilon_greedy_first, make_expect_epsilon_greedy(value_of_first), first_best, show_all
    ),
    ("epsilon_greedy", "random"): Behaviour(
        epsilon_greedy_random, make_expect_epsilon_greedy(mean_of_best), first_best, show_all
    ),
    ("boltzmann", "first"): Behaviour(boltzmann, expect_boltzmann, first_best, show_all),
    ("boltzmann", "random"): Behaviour(boltzmann, expect_boltzmann, first_best, show_all),
}
EXPLORATIONS = ("epsilon_greedy", "boltzmann")
TIES = ("random", "first")


def linear(progress, initial, final, fraction):
    """
    :param progress: the part of the training that is done, from 0 to 1
    :param initial: the exploration rate at the start
    :param final: the exploration rate at the end of the decay
    :param fraction: the part of the training over which it decays
    :return: the exploration rate, linear in the progress
    """
    if progress >= fraction:
        return final
    # The division is the same at every step, so the compiler takes it out of the loop
    return initial + (final - initial) / fraction * progress


def exponential(progress, initial, final, fraction):
    """
    :param progress: the part of the training that is done, from 0 to 1
    :param initial: the exploration rate at the start, above 0
    :param final: the exploration rate at the end of the decay, above 0
    :param fraction: the part of the training over which it decays
    :return: the exploration rate, which falls by equal factors in equal times
    """
    if progress >= fraction:
        return final
    return initial * (final / initial) ** (progress / fraction)


def constant(progress, initial, final, fraction):
    """
    :param progress: unused, as are ``final`` and ``fraction``
    :param initial: the exploration rate
    :param final: unused
    :param fraction: unused
    :return: the exploration rate
    """
    return initial


#: By the names that ``exploration_schedule`` may have
SCHEDULES = {"linear": linear, "exponential": exponential, "constant": constant}
