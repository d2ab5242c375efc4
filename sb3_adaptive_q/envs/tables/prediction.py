"""Processes with one action, in which there is nothing to choose and everything to predict."""

from sb3_adaptive_q.envs.tables.types import Start, Table, ended, start_in


def one_state(mean: float = 1.0, deviation: float = 1.0) -> tuple[Table, Start]:
    """
    Build one state that leads to itself; its value is mean / (1 - gamma).

    :param mean: of the reward
    :param deviation: what the reward is above or below it, each half of the time
    :return: table and start distribution
    """
    return {0: {0: [(0.5, 0, mean + deviation, False), (0.5, 0, mean - deviation, False)]}}, [1.0]


def random_walk(n_states: int = 19) -> tuple[Table, Start]:
    """
    Build the random walk of Sutton and Barto (2018), example 7.1: left or right, -1 beyond one end and 1 beyond the other.

    The values are (s - 10) / 10 for the states s = 1 to 19 if gamma is 1; states 0 and 20 are beyond the ends.

    :param n_states: an odd number; the walk begins in the middle one
    :return: table and start distribution
    """
    last = n_states + 1
    rewards = {0: -1.0, last: 1.0}
    table = {
        state: {0: [(0.5, to, rewards.get(to, 0.0), to in rewards) for to in (state - 1, state + 1)]}
        for state in range(1, last)
    }
    return {0: ended(0, 1), **table, last: ended(last, 1)}, start_in(n_states + 2, last // 2)


def ring_walk(n_states: int = 21, last_reward: float = -1.0) -> tuple[Table, Start]:
    """
    Build the walk of Hutter and Legg (2007): left or right, and from either end back to the middle.

    :param n_states: an odd number; the walk begins in the middle one
    :param last_reward: on the way from the last state to the middle; from the first it is 1
    :return: table and start distribution
    """
    middle = n_states // 2
    table: Table = {state: {0: [(0.5, state - 1, 0.0, False), (0.5, state + 1, 0.0, False)]} for state in range(n_states)}
    table[0] = {0: [(1.0, middle, 1.0, False)]}
    table[n_states - 1] = {0: [(1.0, middle, last_reward, False)]}
    return table, start_in(n_states, middle)


def boyan_chain() -> tuple[Table, Start]:
    """
    Build the chain of Boyan (1999) as a table: from state 12 one or two states down, with -3, and from 1 to 0 with -2.

    The value of state s is -2 s if gamma is 1.

    :return: table and start distribution
    """
    table: Table = {s: {0: [(0.5, to, -3.0, to == 0) for to in (s - 1, s - 2)]} for s in range(2, 13)}
    return {0: ended(0, 1), 1: {0: [(1.0, 0, -2.0, True)]}, **table}, start_in(13, 12)
