"""Greedy actions, and numbers as they are written into cells."""

import numpy as np

#: From here on thousands are written with a k, millions with an M
_LONG = 10_000


def greedy_actions(table: np.ndarray) -> np.ndarray:
    """
    :param table: of shape (n_states, n_actions)
    :return: the action that the policy takes in each state, counted from 0: the first of the best ones
    """
    return table.argmax(axis=1)


def is_undecided(table: np.ndarray) -> np.ndarray:
    """
    :param table: of shape (n_states, n_actions)
    :return: for each state whether all its actions are worth the same, as before anything was learned there
    """
    return np.asarray((table == table[:, :1]).all(axis=1) & (table.shape[1] > 1))


def number_texts(values: np.ndarray) -> list[str]:
    """
    :param values: numbers, of shape (n,)
    :return: them in letters, all with the same number of decimals: two where the largest is below 10, one where it is below
        1000, none for whole numbers. Where it is 10 000 or more, thousands are written as k and millions as M
    """
    largest = np.abs(values).max(initial=0.0)
    if largest >= _LONG:
        return [_short(value) for value in values]
    decimals = 0 if np.array_equal(values, np.rint(values)) or largest >= 1000 else 1 if largest >= 10 else 2
    return [_rounded(value, decimals) for value in values]


def _short(value: float) -> str:
    for size, name in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if abs(value) >= size:
            return _rounded(value / size, 1 if abs(value) < 10 * size else 0) + name
    return _rounded(value, 0)


def _rounded(value: float, decimals: int) -> str:
    # Adding 0 turns a minus zero into zero
    return f"{np.round(value, decimals) + 0.0:.{decimals}f}".replace("-", "−")
