"""SARSA (Rummery and Niranjan, 1994)."""

from sb3_adaptive_q.algorithms.td_update import td_update, value_for_rule
from sb3_adaptive_q.base import TabularAlgorithm


def sarsa(tables, agent, size, choose, expect, best, memory, draws, t):
    """
    Rummery and Niranjan (1994). The next action is drawn from the table before the update.

    :param tables: Q
    :param agent: the numbers of the moment
    :param size: forms the step size
    :param choose: the behaviour policy
    :param expect: unused
    :param best: the best action in a state, and its value
    :param memory: of the step size
    :param draws: the agent's counter
    :param t: the transition
    :return: the next action, the update, and Q_t(s', a) for the rule
    """
    action, value = 0, 0.0
    if not t.terminated:
        action = choose(tables, t.next_state, agent.epsilon, draws)
        value = tables[0][t.next_state, action]
    seen = value_for_rule(tables, agent, best, t, action)
    step = td_update(tables[0], agent, size, memory, t, t.reward + agent.gamma * value, value)
    return action, step, seen


class SARSA(TabularAlgorithm):
    """
    SARSA with a table (Rummery and Niranjan, 1994): Q(s, a) is moved towards r + γ Q(s', a') with the action a' that is taken
    next.

    Before each update the agent draws its next action; at a truncation it draws one too, but does not take it. At the end of
    an episode it draws the first action of the next episode, after the update. A method that looks at
    the next value with ``next_action="next"`` sees Q(s', a') of the target itself; ``"same"`` and ``"max"`` are read from the
    same table, before the update. For the parameters see :class:`sb3_adaptive_q.TabularAlgorithm`.
    """

    update = staticmethod(sarsa)
    chooses_before_update = True
