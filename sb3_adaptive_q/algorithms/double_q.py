"""Double Q-learning (van Hasselt, 2010), and the same with the expectation of the behaviour policy."""

from collections.abc import Callable
from typing import Any

import numpy as np

from sb3_adaptive_q.algorithms.td_update import best_for_rule, choose_after, of_table, td_update
from sb3_adaptive_q.base import TabularAlgorithm
from sb3_adaptive_q.checks import Check, one_of
from sb3_adaptive_q.random_numbers import uniform


def best_by_own(tables, own, other, agent, expect, best, state):
    """
    :param tables: the mean of both tables first
    :param own: the table that is updated, of shape (n_states, n_actions)
    :param other: the other one
    :param agent: the numbers of the moment
    :param expect: unused
    :param best: the best action in a state, and its value
    :param state: the row
    :return: the other table's value of the action that is best by the own one
    """
    return other[state, best(tables, own, state)[0]]


def expected_by_behaviour(tables, own, other, agent, expect, best, state):
    """
    :param tables: the mean of both tables first, which the behaviour looks at
    :param own: unused
    :param other: the table that is not updated, of shape (n_states, n_actions)
    :param agent: the numbers of the moment
    :param expect: the expectation of the behaviour policy
    :param best: unused
    :param state: the row
    :return: what the behaviour policy expects of the other table
    """
    return expect(tables, other, state, agent.epsilon)


def make_double_q(value_of: Callable[..., float]) -> Callable[..., Any]:
    """
    :param value_of: the value of s' inside the target
    :return: the update of double Q-learning (van Hasselt, 2010, algorithm 1). Its tables are the mean and, of shape
        (2, n_states, n_actions), the two that are learned. A fair coin is drawn, one of the two is updated, and the next
        action is drawn from the new mean
    """

    def double_q(tables, agent, size, choose, expect, best, memory, draws, t):
        coin = 0 if uniform(draws) < 0.5 else 1
        own, other = tables[1][coin], tables[1][1 - coin]
        value = 0.0 if t.terminated else value_of(tables, own, other, agent, expect, best, t.next_state)
        best_value = best_for_rule(tables, own, agent, best, t)
        step = td_update(own, agent, size, of_table(memory, coin), t, t.reward + agent.gamma * value, value)
        tables[0][t.state, t.action] = 0.5 * (own[t.state, t.action] + other[t.state, t.action])
        return choose_after(tables, own, agent, choose, draws, t, step, best_value)

    return double_q


#: The update by the name of the constructor's argument ``target``
UPDATES = {"max": make_double_q(best_by_own), "expected": make_double_q(expected_by_behaviour)}


class DoubleQ(TabularAlgorithm):
    """
    Double Q-learning with two tables (van Hasselt, 2010, algorithm 1): a coin decides which of them is updated. The updated
    table chooses the best next action, and the other table gives its value.

    ``q_tables``, of shape (2, n_states, n_actions), are the two; ``q_table`` is their mean, which the behaviour looks at.
    Assigning ``q_table`` sets both. The memory of a step size has a leading axis of two, and a rule sees the values of the
    table that is updated. For each transition the agent draws first the coin (below 0.5 stands for the first table) and, after
    the update, the random numbers of its next action; at the end of an episode also those of the first action of the next
    episode.

    :param policy: as in :class:`sb3_adaptive_q.TabularAlgorithm`, which also has the further parameters
    :param env: as there
    :param target: ``"max"`` for the action that is best by the table which is updated; ``"expected"`` for the expectation of
        the behaviour policy on the mean of both: double expected SARSA
    :raises ValueError: if an argument lies outside its range
    """

    n_tables = 2
    updates_one_entry = False

    def __init__(self, policy: Any, env: Any, *args: Any, target: str = "max", **kwargs: Any) -> None:
        self.target = target
        super().__init__(policy, env, *args, **kwargs)

    def argument_checks(self) -> dict[str, Check]:
        return super().argument_checks() | {"target": one_of(UPDATES)}

    def update_function(self) -> Callable[..., Any]:
        return UPDATES[self.target]

    def extra_tables(self, n_states: int, n_actions: int) -> dict[str, tuple[int, ...]]:
        return {"q_tables": (2, n_states, n_actions)}

    @property
    def q_tables(self) -> np.ndarray:
        """The two live tables, of shape (2, n_states, n_actions). Their mean, ``q_table``, follows with every update."""
        tables: Any = self.policy.q_tables
        return tables.numpy()
