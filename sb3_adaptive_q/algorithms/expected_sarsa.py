"""Expected SARSA (van Seijen, van Hasselt, Whiteson and Wiering, 2009)."""

from sb3_adaptive_q.algorithms.td_update import best_for_rule, choose_after, td_update
from sb3_adaptive_q.base import TabularAlgorithm


def expected_sarsa(tables, agent, size, choose, expect, best, memory, draws, t):
    """
    Van Seijen et al. (2009). The next action is drawn from the table after the update.

    :param tables: Q
    :param agent: the numbers of the moment
    :param size: forms the step size
    :param choose: the behaviour policy
    :param expect: its expectation of a state
    :param best: the best action in a state, and its value
    :param memory: of the step size
    :param draws: the agent's counter
    :param t: the transition
    :return: the next action, the update, and Q_t(s', a) for the rule
    """
    value = 0.0 if t.terminated else expect(tables, tables[0], t.next_state, agent.epsilon)
    best_value = best_for_rule(tables, tables[0], agent, best, t)
    step = td_update(tables[0], agent, size, memory, t, t.reward + agent.gamma * value, value)
    return choose_after(tables, tables[0], agent, choose, draws, t, step, best_value)


class ExpectedSARSA(TabularAlgorithm):
    """
    Expected SARSA with a table (van Seijen, van Hasselt, Whiteson and Wiering, 2009): Q(s, a) is moved towards
    r + γ Σ_a π(a|s') Q(s', a), with the behaviour policy π of the moment.

    After each update the agent draws the random numbers of its next action; at the end of an episode it also draws those of
    the first action of the next episode. Without exploration it is Q-learning. For the parameters see
    :class:`sb3_adaptive_q.TabularAlgorithm`.
    """

    update = staticmethod(expected_sarsa)
