"""An environment's state, a number or a tuple of floats, in a row of an array: machine code needs a function for each size."""

from collections.abc import Callable
from typing import Any

import numpy as np


def _load_number(states, i):
    return int(states[i, 0])


def _store_number(states, i, state):
    states[i, 0] = state


def _load_tuple(size: int) -> Callable[..., Any]:
    last = size - 1
    if size == 1:
        return lambda states, i: (states[i, 0],)
    others = _load_tuple(size - 1)
    return lambda states, i: others(states, i) + (states[i, last],)  # noqa: RUF005


def _store_tuple(states, i, state):
    for j in range(len(state)):
        states[i, j] = state[j]


#: The longest state
MOST_FLOATS = 8


def place_functions(example_state: Any) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """
    :param example_state: a state of the environment
    :return: (load, store): ``load(states, i)`` reads the state from row i, ``store(states, i, state)`` writes it
    :raises ValueError: if the state is a tuple of more than eight numbers
    """
    if not isinstance(example_state, tuple):
        return _load_number, _store_number
    if not 1 <= len(example_state) <= MOST_FLOATS:
        raise ValueError(
            f"The state of compiled dynamics must be a number or a tuple of 1 to {MOST_FLOATS} floats, but has "
            f"{len(example_state)} entries: keep what does not change in the parameters."
        )
    return _load_tuple(len(example_state)), _store_tuple


def empty_places(n_envs: int, example_state: Any) -> np.ndarray:
    """
    :param n_envs: the number of environments
    :param example_state: a state of one
    :return: the array for their states, of shape (n_envs, size of a state)
    """
    return np.zeros((n_envs, np.size(example_state)))
