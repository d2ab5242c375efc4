"""Observations of finite spaces as rows of a table, and back."""

from math import prod
from typing import Any

import numpy as np
from gymnasium import spaces


class StateIndex:
    """
    Mixed radix: the first component of an observation is the most significant digit.

    :param space: a Discrete, MultiDiscrete or MultiBinary space
    :raises ValueError: for any other space
    """

    def __init__(self, space: spaces.Space[Any]) -> None:
        self.space = space
        self.sizes, self.starts = _components(space)
        self.n_states = prod(self.sizes)
        if isinstance(space, spaces.Discrete):
            self._numbers = range(self.starts[0], self.starts[0] + self.n_states)
            self.of = self._of_number  # type: ignore[method-assign]

    def _of_number(self, observation: int) -> int:
        """The row of a Discrete observation; :meth:`of` for these."""
        try:
            return self._numbers.index(observation)
        except ValueError:
            raise ValueError(self._outside(observation)) from None

    def of(self, observation: Any) -> int:
        """
        :param observation: one observation as plain Python numbers, which is what ``ndarray.tolist`` gives
        :return: its row
        :raises ValueError: if it lies outside the space
        """
        index = 0
        for value, size, start in zip(_flat(observation), self.sizes, self.starts, strict=True):
            if not 0 <= value - start < size:
                raise ValueError(self._outside(observation))
            index = index * size + (value - start)
        if not isinstance(index, int):
            raise ValueError(self._outside(observation))
        return index

    def of_batch(self, observations: np.ndarray) -> np.ndarray:
        """
        :param observations: of shape (n, *the space's shape)
        :return: their rows, of shape (n,)
        :raises ValueError: if one lies outside the space
        """
        values = observations.reshape(len(observations), -1)
        with np.errstate(invalid="ignore"):  # a NaN becomes a number, from which it differs
            digits = values.astype(np.int64)
        is_fraction = digits != values
        digits -= np.array(self.starts)
        outside = ((digits < 0) | (digits >= np.array(self.sizes)) | is_fraction).any(axis=1)
        if outside.any():
            raise ValueError(self._outside(observations[outside][0]))
        return np.ravel_multi_index(tuple(digits.T), self.sizes)

    def observations(self, indices: np.ndarray) -> np.ndarray:
        """
        :param indices: rows, of shape (n,)
        :return: the observations they stand for, of shape (n, *the space's shape)
        """
        digits = np.stack(np.unravel_index(indices, self.sizes), axis=1) + np.array(self.starts)
        return digits.reshape(len(indices), *self.space.shape).astype(self.space.dtype)  # type: ignore[misc]

    def _outside(self, observation: Any) -> str:
        return f"The observation {observation} lies outside the observation space {self.space}: please check the environment."


def _components(space: spaces.Space[Any]) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """The number of values of each component of a space, and its least value."""
    if isinstance(space, spaces.Discrete):
        return (int(space.n),), (int(space.start),)
    if isinstance(space, spaces.MultiDiscrete):
        return tuple(space.nvec.ravel().tolist()), tuple(space.start.ravel().tolist())
    if isinstance(space, spaces.MultiBinary):
        size = prod(space.shape)
        return (2,) * size, (0,) * size
    hint = (
        "wrap the environment in `wrappers.DiscretizeObservation`"
        if isinstance(space, spaces.Box)
        else "wrap the environment in a `gymnasium.ObservationWrapper` that turns its observations into one of these"
    )
    raise ValueError(f"TabularQ needs a Discrete, MultiDiscrete or MultiBinary observation space, but got {space}: {hint}.")


def _flat(observation: Any) -> list[int]:
    """The components of a nested list, in C order."""
    if observation and isinstance(observation[0], list):
        return [value for part in observation for value in _flat(part)]
    return observation
