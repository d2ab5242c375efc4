"""
One transition of Q-learning, as functions of scalars and a table.

They are ordinary Python. :mod:`sb3_adaptive_q.update` compiles them for one transition at a time,
:mod:`sb3_adaptive_q.fused` together with an environment.
"""

from typing import NamedTuple

from sb3_adaptive_q.rules import Transition

SAME_ACTION, NEXT_ACTION, MAXIMUM = range(3)
#: What ``next_action`` may be, and the code by which the functions below know it
NEXT_ACTIONS = {"same": SAME_ACTION, "next": NEXT_ACTION, "max": MAXIMUM}


class Learner(NamedTuple):
    """
    What stays as it is during one call of ``learn``.

    :param n_actions: how many actions there are
    :param gamma: the discount factor γ
    :param exploration_initial_eps: ε at the start
    :param exploration_final_eps: ε at the end of the decay
    :param exploration_fraction: the fraction of the training over which ε decays
    :param exploration_slope: the change of ε per unit of progress
    :param total_timesteps: the environment steps after which progress is 1
    :param total_episodes: the episodes after which progress is 1; 0 where steps count instead
    :param next_action: the action a of Q_t(s_{t+1}, a) that the rule sees, a code of ``NEXT_ACTIONS``
    :param reset_each_episode: whether μ starts again from ``mu_0`` at every episode's start
    :param mu_0: the step size to start from
    """

    n_actions: int
    gamma: float
    exploration_initial_eps: float
    exploration_final_eps: float
    exploration_fraction: float
    exploration_slope: float
    total_timesteps: int
    total_episodes: int
    next_action: int
    reset_each_episode: bool
    mu_0: float


def progress_made(learner, num_timesteps, n_episodes):
    """
    :param learner: the constants of this training
    :param num_timesteps: environment steps taken
    :param n_episodes: episodes finished
    :return: the part of the training that is done, from 0 to 1
    """
    if learner.total_episodes > 0:
        return min(n_episodes / learner.total_episodes, 1.0)
    return min(num_timesteps / max(learner.total_timesteps, 1), 1.0)


def exploration_rate(learner, progress):
    """
    :param learner: the constants of this training
    :param progress: the part of the training that is done
    :return: ε, linear in the progress until ``exploration_fraction`` of the training is done
    """
    if progress >= learner.exploration_fraction:
        return learner.exploration_final_eps
    return learner.exploration_initial_eps + learner.exploration_slope * progress


def greedy_action(table, state, n_actions):
    """
    :param table: Q, of shape (n_states, n_actions)
    :param state: the row
    :param n_actions: its length
    :return: the action of the largest value, the first of them in a tie
    """
    best_action = 0
    best_value = table[state, 0]
    for action in range(1, n_actions):
        value = table[state, action]
        if value > best_value:
            best_action, best_value = action, value
    return best_action


def maximum_value(table, state, n_actions):
    """
    :param table: Q, of shape (n_states, n_actions)
    :param state: the row
    :param n_actions: its length
    :return: max_a Q(s, a)
    """
    best_value = table[state, 0]
    for action in range(1, n_actions):
        value = table[state, action]
        if value > best_value:
            best_value = value
    return best_value


def choose_action(table, state, n_actions, epsilon, generator):
    """
    The ε-greedy behaviour policy. A second number is drawn only where the first one asks for exploration.

    :param table: Q, of shape (n_states, n_actions)
    :param state: the state to act in
    :param n_actions: how many actions there are
    :param epsilon: the probability of a uniformly random action
    :param generator: the agent's own NumPy generator
    :return: the action
    """
    if generator.random() < epsilon:
        return int(generator.random() * n_actions)
    return greedy_action(table, state, n_actions)


def value_before_update(table, learner, state, action, value, next_state, next_action, best_next_value):
    """
    Q_t(s_{t+1}, a) for the rules, read after the update without seeing it: the update changed one entry, whose old
    value is at hand.

    :param table: Q_{t+1}, of shape (n_states, n_actions)
    :param learner: the constants of this training; its ``next_action`` says which a is meant
    :param state: s_t
    :param action: a_t
    :param value: Q_t(s_t, a_t)
    :param next_state: s_{t+1}, not terminal
    :param next_action: a_{t+1}
    :param best_next_value: max_a Q_t(s_{t+1}, a)
    :return: Q_t(s_{t+1}, a)
    """
    if learner.next_action == MAXIMUM:
        return best_next_value
    meant = action if learner.next_action == SAME_ACTION else next_action
    if next_state == state and meant == action:
        return value
    return table[next_state, meant]


def record_update(statistics, mu, td_error):
    """
    Add an update to what the logger will show.

    :param statistics: (sum of μ, least μ, largest μ, sum of absolute temporal-difference errors)
    :param mu: the step size of the update
    :param td_error: its temporal-difference error
    :return: the statistics with the update
    """
    mu_sum, mu_min, mu_max, td_error_sum = statistics
    return mu_sum + mu, min(mu_min, mu), max(mu_max, mu), td_error_sum + abs(td_error)


def next_rate(rule, parameters, learner, mu, transition, done):
    """
    :param rule: the rule in force
    :param parameters: its parameters
    :param learner: the constants of this training
    :param mu: μ_t
    :param transition: what happened
    :param done: whether the episode ended
    :return: μ_{t+1}
    """
    if done and learner.reset_each_episode:
        return learner.mu_0
    return rule.function(mu, transition, *parameters)


def learn_transition(
    table, generator, learner, mu, epsilon, progress, n_episodes, num_timesteps,
    state, action, reward, next_state, terminated, done, reset_state,
):  # fmt: skip
    """
    Learn from one transition and choose what to do next: update Q with μ_t (Eq. 2) and choose a_{t+1}. With what is
    returned, :func:`next_rate` then forms μ_{t+1}, as in the paper.

    A terminal state is worth 0. At a truncation the behaviour policy picks an action there, for the rules to see,
    though it is never executed. An episode counts as finished before μ_{t+1} and the next episode's ε are formed.

    :param table: Q, of shape (n_states, n_actions); changed in place
    :param generator: the agent's own NumPy generator
    :param learner: the constants of this training
    :param mu: μ_t
    :param epsilon: ε of the last action
    :param progress: the part of the training that was done then, t / t_max
    :param n_episodes: episodes finished before this transition
    :param num_timesteps: environment steps taken, this one and those of the other environments included
    :param state: s_t
    :param action: a_t
    :param reward: r_t
    :param next_state: s_{t+1}, the state that was reached, not the one after a reset
    :param terminated: whether s_{t+1} is terminal
    :param done: whether the episode ended, by termination or by truncation
    :param reset_state: the next episode's first state, where the episode ended
    :return: (action to take next, ε, progress, finished episodes, the transition as rules see it)
    """
    if learner.total_episodes == 0:
        progress = progress_made(learner, num_timesteps, 0)
        epsilon = exploration_rate(learner, progress)
    value = table[state, action]
    best_next_value = 0.0
    if not terminated:
        best_next_value = maximum_value(table, next_state, learner.n_actions)
    td_error = reward + learner.gamma * best_next_value - value
    table[state, action] = value + mu * td_error  # Eq. 2

    next_action = 0
    next_value = 0.0
    if not terminated:
        next_action = choose_action(table, next_state, learner.n_actions, epsilon, generator)
        next_value = value_before_update(table, learner, state, action, value, next_state, next_action, best_next_value)
    if done:
        n_episodes += 1
        if learner.total_episodes > 0:
            progress = progress_made(learner, 0, n_episodes)
            epsilon = exploration_rate(learner, progress)
        next_action = choose_action(table, reset_state, learner.n_actions, epsilon, generator)
    return next_action, epsilon, progress, n_episodes, Transition(value, next_value, td_error, progress)
