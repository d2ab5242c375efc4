"""Q-learning (Watkins, 1989)."""

from sb3_adaptive_q.algorithms.td_update import choose_after, td_update
from sb3_adaptive_q.base import TabularAlgorithm


def q_learning(tables, agent, size, choose, expect, best, memory, draws, t):
    """
    Watkins (1989); Eq. 2 of the paper. The next action is drawn from the table after the update.

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
    best_value = 0.0 if t.terminated else best(tables, tables[0], t.next_state)[1]
    step = td_update(tables[0], agent, size, memory, t, t.reward + agent.gamma * best_value, best_value)
    return choose_after(tables, tables[0], agent, choose, draws, t, step, best_value)


class TabularQ(TabularAlgorithm):
    """
    Q-learning with a table (Watkins, 1989; Eq. 2 of the paper).

    After each update the agent draws the random numbers of its next action; at the end of an episode it also draws those of
    the first action of the next episode. For the parameters see :class:`sb3_adaptive_q.TabularAlgorithm`.
    """

    update = staticmethod(q_learning)
