"""What a transition table is made of."""

from typing import TypeAlias

#: (probability, next state, reward, terminated)
Outcome: TypeAlias = tuple[float, int, float, bool]
#: ``table[state][action]`` is a list of outcomes
Table: TypeAlias = dict[int, dict[int, list[Outcome]]]
#: The probability of every state to be the first of an episode
Start: TypeAlias = list[float]


def start_in(n_states: int, *states: int) -> Start:
    """
    Begin in one of some states, each equally often.

    :param n_states: number of states
    :param states: where episodes begin
    :return: the start distribution
    """
    return [states.count(state) / len(states) for state in range(n_states)]


def ended(state: int, n_actions: int) -> dict[int, list[Outcome]]:
    """
    Stay where an episode has ended.

    :param state: the state
    :param n_actions: number of actions
    :return: its row of the table
    """
    return {action: [(1.0, state, 0.0, True)] for action in range(n_actions)}
