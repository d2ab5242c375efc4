"""
Behaviour policies: how an action is chosen, what the policy expects of a state, and which action is best. Plain functions,
compiled into the learning loop.

A policy looks at the first of the algorithm's tables, of shape (n_states, n_actions).
``choose(tables, state, epsilon, draws)`` gives an action; it draws from the agent's counter in a stated order. ``epsilon`` is
the exploration rate, with Boltzmann exploration the temperature. ``expect(tables, values, state, epsilon)`` gives
Σ_a π(a|s) values[s, a], for the policy π that ``choose`` follows. ``best(tables, values, state)`` gives argmax_a values[s, a],
the first of them in a tie, and its value.
``show(tables, state, row)`` writes what the policy looks at into a row. Where actions are masked,
:mod:`sb3_adaptive_q.action_masks` makes the same functions of the allowed actions.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from sb3_adaptive_q.random_numbers import uniform

#: From this number of actions on, :func:`search_wide` is usually faster
WIDE = 16


def search(table, state):
    """
    :param table: action values, of shape (n_states, n_actions)
    :param state: the row
    :return: the action of the largest value, the first of them in a tie; that value; and how many actions have it
    """
    row = np.uint64(state)  # unsigned: Numba does not check for negative indices
    if table.shape[1] == 4:
        return search_four(table[row, 0], table[row, 1], table[row, 2], table[row, 3])
    best_action, best_value, n_best = 0, table[row, 0], 1
    for action in range(1, table.shape[1]):
        value = table[row, action]
        if value > best_value:
            best_action, best_value, n_best = action, value, 1
        elif value == best_value:
            n_best += 1
    return best_action, best_value, n_best


def search_four(first, second, third, fourth):
    """As :func:`search`, for the values of four actions, as most grids have them: no comparison waits for two others."""
    left, right = larger(second, first), larger(fourth, third)
    best_value = larger(right, left)
    n_best = int(first == best_value) + int(second == best_value) + int(third == best_value) + int(fourth == best_value)
    best_of_left, best_of_right = 1 if second > first else 0, 3 if fourth > third else 2
    return best_of_right if right > left else best_of_left, best_value, n_best


def search_wide(table, state):
    """As :func:`search`. Four maxima do not wait for each other, and the compiler vectorises the loop that counts ties."""
    row, n_actions, n_best, place = np.uint64(state), table.shape[1], 0, 0
    first = second = third = fourth = table[row, 0]
    for action in range(0, n_actions // 4 * 4, 4):
        first = larger(table[row, action], first)
        second = larger(table[row, action + 1], second)
        third = larger(table[row, action + 2], third)
        fourth = larger(table[row, action + 3], fourth)
    for action in range(n_actions // 4 * 4, n_actions):
        first = larger(table[row, action], first)
    best_value = larger(larger(first, second), larger(third, fourth))
    for action in range(n_actions):
        n_best += 1 if table[row, action] == best_value else 0
        place += action if table[row, action] == best_value else 0
    if n_best == 1:
        return place, best_value, 1
    for action in range(n_actions):
        if table[row, action] == best_value:
            return action, best_value, n_best
    return 0, best_value, 1  # not a number


def larger(value, other):
    """The larger of two numbers."""
    return value if value > other else other


def take_first(table, state, search, draws):
    """The first of the best actions."""
    return search(table, state)[0]


def take_any(table, state, search, draws):
    """One of the best actions; a number is drawn where there are several, none elsewhere."""
    best_action, best_value, n_best = search(table, state)
    if n_best == 1:
        return best_action
    place = int(uniform(draws) * n_best)
    for action in range(table.shape[1]):
        if table[state, action] == best_value:
            if place == 0:
                return action
            place -= 1
    return best_action


def make_epsilon_greedy(search, take):
    """
    :param search: finds the best action
    :param take: takes one of the best actions
    :return: the ε-greedy policy's ``choose``. It draws once, and again where it explores or breaks a tie at random
    """

    def epsilon_greedy(tables, state, epsilon, draws):
        if uniform(draws) < epsilon:
            return int(uniform(draws) * tables[0].shape[1])
        return take(tables[0], state, search, draws)

    return epsilon_greedy


def value_of_first(table, values, state, best_action, best_value):
    """The value of the first of the best actions."""
    return values[state, best_action]


def mean_of_best(table, values, state, best_action, best_value):
    """The mean value of the best actions, in ``values`` of those whose value in ``table`` is ``best_value``."""
    total, n_best = 0.0, 0
    for action in range(table.shape[1]):
        if table[state, action] == best_value:
            total, n_best = total + values[state, action], n_best + 1
    return total if n_best == 1 else total / n_best


def make_expect_epsilon_greedy(search, greedy_value):
    """
    :param search: finds the best action
    :param greedy_value: the value of the greedy part of the policy, where it is not the largest value itself
    :return: the ``expect`` of an ε-greedy policy
    """

    def expect_epsilon_greedy(tables, values, state, epsilon):
        table, total = tables[0], 0.0
        for action in range(table.shape[1]):
            total += values[state, action]
        best_action, best_value, _ = search(table, state)
        greedy_part = best_value if values is table else greedy_value(table, values, state, best_action, best_value)
        return epsilon * (total * (1.0 / table.shape[1])) + (1.0 - epsilon) * greedy_part

    return expect_epsilon_greedy


def make_boltzmann(search):
    """
    :param search: finds the best action
    :return: the ``choose`` of the Boltzmann policy, π(a|s) in proportion to exp(Q(s, a) / temperature). It draws once
    """

    def boltzmann(tables, state, temperature, draws):
        table, total = tables[0], 0.0
        best_value = search(table, state)[1]
        for action in range(table.shape[1]):
            total += math.exp((table[state, action] - best_value) / temperature)
        rest = uniform(draws) * total
        for action in range(table.shape[1] - 1):
            rest -= math.exp((table[state, action] - best_value) / temperature)
            if rest < 0.0:
                return action
        return table.shape[1] - 1

    return boltzmann


def make_expect_boltzmann(search):
    """
    :param search: finds the best action
    :return: the ``expect`` of the Boltzmann policy
    """

    def expect_boltzmann(tables, values, state, temperature):
        table, total, weighted = tables[0], 0.0, 0.0
        best_value = search(table, state)[1]
        for action in range(table.shape[1]):
            weight = math.exp((table[state, action] - best_value) / temperature)
            total += weight
            weighted += weight * values[state, action]
        return weighted / total

    return expect_boltzmann


def make_best(search):
    """
    :param search: finds the best action
    :return: the ``best`` of every policy: the first of the best actions, and its value
    """

    def best(tables, values, state):
        action, value, _ = search(values, state)
        return action, value

    return best


def show_all(tables, state, row):
    """
    :param tables: of action values first, of shape (n_states, n_actions)
    :param state: the state to act in
    :param row: of shape (n_actions,); set to the values of the actions
    """
    for action in range(row.shape[0]):
        row[action] = tables[0][state, action]


class Behaviour(NamedTuple):
    """A behaviour policy; see the top of this module for the arguments of its functions."""

    choose: Callable[..., int]
    expect: Callable[..., float]
    best: Callable[..., tuple[int, float]]
    show: Callable[..., None]


EXPLORATIONS = ("epsilon_greedy", "boltzmann")
TIES = ("random", "first")


def make_behaviour(exploration: str, ties: str, search: Callable[..., tuple[int, float, int]]) -> Behaviour:
    """
    :param exploration: one of ``EXPLORATIONS``
    :param ties: one of ``TIES``
    :param search: finds the best action
    :return: the behaviour policy
    """
    if exploration == "boltzmann":
        return Behaviour(make_boltzmann(search), make_expect_boltzmann(search), make_best(search), show_all)
    take, greedy_value = (take_first, value_of_first) if ties == "first" else (take_any, mean_of_best)
    choose, expect = make_epsilon_greedy(search, take), make_expect_epsilon_greedy(search, greedy_value)
    return Behaviour(choose, expect, make_best(search), show_all)


_NAMES = [(exploration, ties) for exploration in EXPLORATIONS for ties in TIES]
#: By the names of the constructor's arguments ``exploration`` and ``ties``
BEHAVIOURS = {name: make_behaviour(*name, search) for name in _NAMES}
#: The same for tables with ``WIDE`` actions and more
WIDE_BEHAVIOURS = {name: make_behaviour(*name, search_wide) for name in _NAMES}


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
