"""
Behaviour policies: how an action is chosen, and what the policy expects of a state. Plain functions of a table, compiled
into the learning loop.

Every ``choose`` draws from the agent's counter in a stated order. Every ``expect`` gives Σ_a π(a|s) values[s, a], for the
policy π that ``choose`` follows on ``table``.
"""

import math

from sb3_adaptive_q.random_numbers import uniform


def first_greedy(table, state):
    """
    :param table: action values, of shape (n_states, n_actions)
    :param state: the row
    :return: the action of the largest value, the first of them in a tie
    """
    best_action, best_value = 0, table[state, 0]
    for action in range(1, table.shape[1]):
        if table[state, action] > best_value:
            best_action, best_value = action, table[state, action]
    return best_action


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


def epsilon_greedy_first(table, state, epsilon, draws):
    """
    The ε-greedy policy that takes the first of the best actions. It draws once, and again where it explores.

    :param table: action values, of shape (n_states, n_actions)
    :param state: the state to act in
    :param epsilon: the probability of a uniformly random action
    :param draws: the agent's counter
    :return: the action
    """
    if uniform(draws) < epsilon:
        return int(uniform(draws) * table.shape[1])
    return first_greedy(table, state)


def epsilon_greedy_random(table, state, epsilon, draws):
    """
    The ε-greedy policy that takes any of the best actions. It draws once, and again where it explores or finds a tie.

    :param table: action values, of shape (n_states, n_actions)
    :param state: the state to act in
    :param epsilon: the probability of a uniformly random action
    :param draws: the agent's counter
    :return: the action
    """
    if uniform(draws) < epsilon:
        return int(uniform(draws) * table.shape[1])
    return random_greedy(table, state, draws)


def expect_epsilon_greedy_first(table, values, state, epsilon):
    """
    :param table: what the policy looks at, of shape (n_states, n_actions)
    :param values: what is averaged, of the same shape
    :param state: the row
    :param epsilon: the probability of a uniformly random action
    :return: the expectation of ``values`` under the ε-greedy policy that takes the first of the best actions
    """
    return epsilon * mean(values, state) + (1.0 - epsilon) * values[state, first_greedy(table, state)]


def expect_epsilon_greedy_random(table, values, state, epsilon):
    """
    :param table: what the policy looks at, of shape (n_states, n_actions)
    :param values: what is averaged, of the same shape
    :param state: the row
    :param epsilon: the probability of a uniformly random action
    :return: the expectation of ``values`` under the ε-greedy policy that shares its greedy part among the best actions
    """
    best_value, total, n_best = table[state, 0], values[state, 0], 1
    for action in range(1, table.shape[1]):
        if table[state, action] > best_value:
            best_value, total, n_best = table[state, action], values[state, action], 1
        elif table[state, action] == best_value:
            total, n_best = total + values[state, action], n_best + 1
    greedy_part = total if n_best == 1 else total / n_best
    return epsilon * mean(values, state) + (1.0 - epsilon) * greedy_part


def mean(values, state):
    """
    :param values: of shape (n_states, n_actions)
    :param state: the row
    :return: its mean
    """
    total = 0.0
    for action in range(values.shape[1]):
        total += values[state, action]
    return total / values.shape[1]


def boltzmann(table, state, temperature, draws):
    """
    The Boltzmann policy, π(a|s) in proportion to exp(Q(s, a) / temperature). It draws once.

    :param table: action values, of shape (n_states, n_actions)
    :param state: the state to act in
    :param temperature: above 0, in the unit of the values
    :param draws: the agent's counter
    :return: the action
    """
    best_value, total = largest(table, state), 0.0
    for action in range(table.shape[1]):
        total += math.exp((table[state, action] - best_value) / temperature)
    rest = uniform(draws) * total
    for action in range(table.shape[1] - 1):
        rest -= math.exp((table[state, action] - best_value) / temperature)
        if rest < 0.0:
            return action
    return table.shape[1] - 1


def expect_boltzmann(table, values, state, temperature):
    """
    :param table: what the policy looks at, of shape (n_states, n_actions)
    :param values: what is averaged, of the same shape
    :param state: the row
    :param temperature: above 0, in the unit of the values
    :return: the expectation of ``values`` under the Boltzmann policy
    """
    best_value, total, weighted = largest(table, state), 0.0, 0.0
    for action in range(table.shape[1]):
        weight = math.exp((table[state, action] - best_value) / temperature)
        total += weight
        weighted += weight * values[state, action]
    return weighted / total


#: (choose, expect) by the names of the constructor's arguments ``exploration`` and ``ties``
BEHAVIOURS = {
    ("epsilon_greedy", "first"): (epsilon_greedy_first, expect_epsilon_greedy_first),
    ("epsilon_greedy", "random"): (epsilon_greedy_random, expect_epsilon_greedy_random),
    ("boltzmann", "first"): (boltzmann, expect_boltzmann),
    ("boltzmann", "random"): (boltzmann, expect_boltzmann),
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
    return initial + (final - initial) * (progress / fraction)


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
