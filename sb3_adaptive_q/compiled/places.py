"""An environment's state, a number or a tuple of floats, in a row of an array: machine code needs a function for each size."""

from collections.abc import Callable
from typing import Any

import numpy as np


def _load_number(states, i):
    return int(states[i, 0])


def _store_number(states, i, state):
    states[i, 0] = state


def _load_1(states, i):
    return (states[i, 0],)


def _load_2(states, i):
    return states[i, 0], states[i, 1]


def _load_3(states, i):
    return states[i, 0], states[i, 1], states[i, 2]


def _load_4(states, i):
    return states[i, 0], states[i, 1], states[i, 2], states[i, 3]


def _load_5(states, i):
    return states[i, 0], states[i, 1], states[i, 2], states[i, 3], states[i, 4]


def _load_6(states, i):
    return states[i, 0], states[i, 1], states[i, 2], states[i, 3], states[i, 4], states[i, 5]


def _load_7(states, i):
    return states[i, 0], states[i, 1], states[i, 2], states[i, 3], states[i, 4], states[i, 5], states[i, 6]


def _load_8(states, i):
    return states[i, 0], states[i, 1], states[i, 2], states[i, 3], states[i, 4], states[i, 5], states[i, 6], states[i, 7]


def _store_tuple(states, i, state):
    for j in range(len(state)):
        states[i, j] = state[j]


_LOAD_TUPLE = (_load_1, _load_2, _load_3, _load_4, _load_5, _load_6, _load_7, _load_8)


def place_functions(example_state: Any) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """
    :param example_state: a state of the environment
    :return: (load, store): ``load(states, i)`` reads the state from row i, ``store(states, i, state)`` writes it
    :raises ValueError: if the state is a tuple of more than eight numbers
    """
    if not isinstance(example_state, tuple):
        return _load_number, _store_number
    if not 1 <= len(example_state) <= len(_LOAD_TUPLE):
        raise ValueError(
            f"The state of compiled dynamics must be a number or a tuple of 1 to {len(_LOAD_TUPLE)} floats, but has "
            f"{len(example_state)} entries: keep what does not change in the parameters."
        )
    return _LOAD_TUPLE[len(example_state) - 1], _store_tuple


def empty_places(n_envs: int, example_state: Any) -> np.ndarray:
    """
    :param n_envs: the number of environments
    :param example_state: a state of one
    :return: the array for their states, of shape (n_envs, size of a state)
    """
    return np.zeros((n_envs, np.size(example_state)))
