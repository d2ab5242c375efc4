"""The n-step algorithms: SARSA, Expected SARSA, tree backup, and Q-learning without a correction."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from sb3_adaptive_q.algorithms.td_update import (
    Transition,
    best_for_rule,
    is_sound,
    keep_row,
    kept_value,
    td_update,
)
from sb3_adaptive_q.base import TabularAlgorithm
from sb3_adaptive_q.checks import Check, check_range, one_of, whole_number
from sb3_adaptive_q.policies import check_memory
from sb3_adaptive_q.step_sizes.cells import scalar_size
from sb3_adaptive_q.step_sizes.step import Step


def value_of_next_action(tables, agent, expect, best, t, action):
    """
    :param tables: Q first
    :param agent: the numbers of the moment
    :param expect: unused
    :param best: unused
    :param t: the last transition, which did not terminate
    :param action: a', the action that is taken in s'
    :return: Q(s', a')
    """
    return tables[0][t.next_state, action]


def expected_value(tables, agent, expect, best, t, action):
    """
    :param tables: Q first
    :param agent: the numbers of the moment
    :param expect: the expectation of the behaviour policy
    :param best: unused
    :param t: the last transition, which did not terminate
    :param action: unused
    :return: what the behaviour policy expects in s'
    """
    return expect(tables, tables[0], t.next_state, agent.epsilon)


def greedy_value(tables, agent, expect, best, t, action):
    """
    :param tables: Q first
    :param agent: the numbers of the moment
    :param expect: unused
    :param best: the best action in a state, and its value
    :param t: the last transition, which did not terminate
    :param action: unused
    :return: max_a Q(s', a)
    """
    return best(tables, tables[0], t.next_state)[1]


def in_circle(place, taken):
    """
    :param place: less than a turn away
    :param taken: what stands in a circle
    :return: the place in the circle; without a division, which takes as long as the rest of a step
    """
    if place < 0:
        return place + len(taken)
    return place - len(taken) if place >= len(taken) else place


def n_step_return(tables, agent, best, taken, rewards, oldest, n_taken, value):
    """
    :param tables: unused
    :param agent: the numbers of the moment
    :param best: unused
    :param taken: states and actions of the episode that are kept, in a circle
    :param rewards: their rewards
    :param oldest: the place of the oldest
    :param n_taken: how many there are
    :param value: the value of the state that was reached last
    :return: r_1 + γ r_2 + ... + γ^n value
    """
    place = in_circle(oldest + n_taken - 1, taken)
    for _ in range(n_taken):
        value = rewards[place] + agent.gamma * value
        place = in_circle(place - 1, taken)
    return value


def tree_backup_return(tables, agent, best, taken, rewards, oldest, n_taken, value):
    """
    The return of tree backup with a greedy target policy (Precup, Sutton and Singh, 2000).

    :param tables: Q first
    :param agent: the numbers of the moment
    :param best: the best action in a state, and its value
    :param taken: states and actions of the episode that are kept, in a circle
    :param rewards: their rewards
    :param oldest: the place of the oldest
    :param n_taken: how many there are
    :param value: the value of the state that was reached last
    :return: r_1 + γ G, where G is the return that follows if the next action is the first of the best ones, and else the value
        of the next state
    """
    place = in_circle(oldest + n_taken - 1, taken)
    value = rewards[place] + agent.gamma * value
    for _ in range(n_taken - 1):
        greedy_action, best_value = best(tables, tables[0], taken[place, 0])
        if taken[place, 1] != greedy_action:
            value = best_value
        place = in_circle(place - 1, taken)
        value = rewards[place] + agent.gamma * value
    return value


def make_n_step(
    value_of: Callable[..., float], return_of: Callable[..., float], chooses_before_update: bool
) -> Callable[..., Any]:
    """
    :param value_of: the value of the state that was reached last
    :param return_of: the n-step return
    :param chooses_before_update: whether the next action is drawn from the table before the update
    :return: the update. The oldest pair of n moves towards its return; at the end of an episode all that are left do, the
        oldest first, each on the table that the one before it left. Its tables are Q; the states and actions that are
        kept, of shape (n_envs, n, 2), and their rewards, of shape (n_envs, n); the place of the oldest and their number, of
        shape (n_envs, 2); and the values of the next state before the update, of shape (n_actions,)
    """

    def n_step(tables, agent, size, choose, expect, best, memory, draws, t):
        env = agent.env
        table, taken, rewards, ends, kept = tables[0], tables[1][env], tables[2][env], tables[3], tables[4]
        action, next_value, value = 0, 0.0, table[t.state, t.action]
        if not t.terminated:
            if chooses_before_update:
                action = choose(tables, t.next_state, agent.epsilon, draws)
            next_value = value_of(tables, agent, expect, best, t, action)
        best_value = best_for_rule(tables, table, agent, best, t)
        keep_row(kept, table, t)
        # A rule sees every transition as the one-step algorithm would
        td_error = t.reward + agent.gamma * next_value - value
        step = scalar_size(memory, agent, t, value, next_value, td_error)
        oldest, n_taken = ends[env, 0], ends[env, 1]
        newest = in_circle(oldest + n_taken, taken)
        taken[newest, 0], taken[newest, 1], rewards[newest] = t.state, t.action, t.reward
        n_taken += 1
        while n_taken == len(taken) or (t.done and n_taken > 0):
            if not t.terminated:
                next_value = value_of(tables, agent, expect, best, t, action)
            target = return_of(tables, agent, best, taken, rewards, oldest, n_taken, next_value)
            visited = Transition(
                taken[oldest, 0], taken[oldest, 1], rewards[oldest], t.next_state, t.terminated, t.done, t.start_state
            )  # fmt: skip
            update = td_update(table, agent, size, memory, visited, target, next_value)
            step = Step(
                t.state, t.action, update.row, update.column, update.count, value, step.next_value, td_error,
                agent.progress, agent.gamma, update.size,
            )  # fmt: skip
            if not is_sound(update):
                break
            oldest = in_circle(oldest + 1, taken)
            n_taken -= 1
        ends[env, 0], ends[env, 1] = oldest, n_taken
        if not chooses_before_update and not t.terminated:
            action = choose(tables, t.next_state, agent.epsilon, draws)
        return action, step, kept_value(kept, agent, t, action, best_value)

    return n_step


class Target(NamedTuple):
    """What a target is made of; see :func:`make_n_step`."""

    value_of: Callable[..., float]
    return_of: Callable[..., float]
    chooses_before_update: bool


#: By the name of the constructor's argument ``target``
TARGETS = {
    "sarsa": Target(value_of_next_action, n_step_return, True),
    "expected": Target(expected_value, n_step_return, False),
    "tree_backup": Target(greedy_value, tree_backup_return, False),
    "q": Target(greedy_value, n_step_return, False),
}


class NStep(TabularAlgorithm):
    """
    n-step SARSA, Expected SARSA, tree backup (Precup, Sutton and Singh, 2000) and Q-learning (Sutton and Barto, 2018, chapter
    7). With n = 1 they are SARSA, Expected SARSA and, twice, Q-learning.

    A pair is updated n - 1 transitions after it was visited, or at the end of the episode; the step size sees the error of its
    n-step return. A rule, which forms the scalar μ, sees every transition as the one-step algorithm would. With
    ``target="sarsa"`` the agent draws, before each update, what its next action takes, at a truncation without taking it; with
    the others after each update. At the end of an episode it draws, after the update, what the first action of the next one
    takes.

    :param policy: as in :class:`sb3_adaptive_q.TabularAlgorithm`, which also has the further parameters
    :param env: as there
    :param n: the transitions of a return, at least 1
    :param target: ``"sarsa"``; ``"expected"``; ``"tree_backup"``, with the greedy policy as its target; or ``"q"``, which ends
        with the largest value and, as in DQN with n-step returns, does not correct for exploratory actions on the way
    :raises ValueError: if an argument lies outside its range
    """

    updates_one_entry = False

    def __init__(self, policy: Any, env: Any, *args: Any, n: int = 4, target: str = "sarsa", **kwargs: Any) -> None:
        self.n = n
        self.target = target
        super().__init__(policy, env, *args, **kwargs)

    @property
    def chooses_before_update(self) -> bool:  # type: ignore[override]
        return TARGETS[self.target].chooses_before_update

    def argument_checks(self) -> dict[str, Check]:
        return super().argument_checks() | {"n": whole_number(1), "target": one_of(TARGETS)}

    def update_function(self) -> Callable[..., Any]:
        return make_n_step(*TARGETS[self.target])

    def working_arrays(self, n_envs: int, n_states: int, n_actions: int) -> dict[str, np.ndarray]:
        check_memory({"taken, with rewards": (n_envs, self.n, 3)}, "use a smaller `n`")
        return {
            "taken": np.zeros((n_envs, self.n, 2), np.int64),
            "rewards": np.zeros((n_envs, self.n)),
            "ends": np.zeros((n_envs, 2), np.int64),
            "next_values": np.zeros(n_actions),
        }

    def check_working_arrays(self, arrays: dict[str, np.ndarray]) -> None:
        super().check_working_arrays(arrays)
        check_range("ends", arrays["ends"], self.n)
        for column, n_rows in enumerate(self.q_table.shape):
            check_range("taken", arrays["taken"][..., column], n_rows)
