"""Checks of the constructor arguments of algorithms."""

from collections.abc import Collection
from math import isfinite
from numbers import Real
from typing import Any

import numpy as np


def check_choice(name: str, value: Any, choices: Collection[str]) -> None:
    """
    :param name: what the argument is called
    :param value: what was given for it
    :param choices: what it may be
    :raises ValueError: if it is none of these
    """
    if not isinstance(value, str) or value not in choices:
        raise ValueError(f"`{name}` must be one of {', '.join(choices)}, but got {value!r}.")


def check_count(name: str, value: Any) -> None:
    """
    :param name: what the argument is called
    :param value: what was given for it
    :raises ValueError: if it is not a whole number of at least 1
    """
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
        raise ValueError(f"`{name}` must be a whole number of at least 1, but got {value!r}.")


def check_range(name: str, values: np.ndarray, stop: int) -> None:
    """
    :param name: what the array is called
    :param values: whole numbers
    :param stop: the first number that is too large
    :raises ValueError: if one of them is not from 0 to below that
    """
    if ((values < 0) | (values >= stop)).any():
        raise ValueError(f"`{name}` must hold numbers from 0 to {stop - 1}, but has others.")


def check_not_negative(name: str, value: Any) -> None:
    """
    :param name: what the argument is called
    :param value: what was given for it
    :raises ValueError: if it is not a finite number of at least 0
    """
    if isinstance(value, bool) or not isinstance(value, Real) or not isfinite(value) or value < 0:
        raise ValueError(f"`{name}` must be a number of at least 0, but got {value!r}.")
