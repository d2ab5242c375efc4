"""What a transition table is made of."""

from collections.abc import Sequence
from typing import TypeAlias

#: (probability, next state, reward, terminated)
Outcome: TypeAlias = tuple[float, int, float, bool]
#: ``table[state][action]`` is a list of outcomes
Table: TypeAlias = dict[int, dict[int, list[Outcome]]]
#: A row and a column, or a change of both
Cell: TypeAlias = tuple[int, int]
#: The probability of every state to be the first of an episode
Start: TypeAlias = list[float]


class GridTable(dict[int, dict[int, list[Outcome]]]):
    """
    A table whose states are the cells of a map, row by row, so that :func:`sb3_adaptive_q.plots.plot_policy` can draw it.

    :param table: the table
    :param desc: the letters of the map, a string for each row: S start, G goal, # wall, anything else an ordinary cell
    :param moves: for each action the change of row and column, without what wind or ice add
    """

    def __init__(self, table: Table, desc: Sequence[str], moves: Sequence[Cell]) -> None:
        super().__init__(table)
        self.desc = list(desc)
        self.moves = tuple(moves)


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
