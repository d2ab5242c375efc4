"""The rows of a table for observations of finite spaces, and the observations for rows."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from math import prod
from typing import Any

import numpy as np
from gymnasium import spaces


class StateIndex(ABC):
    """
    Numbers the observations of a space: the number of an observation is its row in the table. It is a mixed-radix number, in
    which the first component of the observation is the most significant digit.

    One observation has the form that an environment returns. Several have the form that a VecEnv returns: an array with one
    more axis in front or, if the space is a Tuple or a Dict, a tuple or a dict of such arrays.

    :param space: the space of the observations
    :param part: which part of a larger space this is, such as ``['deck'][0]``; empty for none
    """

    #: How many rows there are
    n_states: int
    #: How many values each component of an observation can take
    sizes: tuple[int, ...]
    #: The least value of each component
    starts: tuple[int, ...]

    def __init__(self, space: Any, part: str = "") -> None:
        self.space = space
        self.part = part

    @abstractmethod
    def of(self, observation: Any) -> int:
        """
        :param observation: one observation
        :return: its row
        :raises ValueError: if it lies outside the space
        """

    @abstractmethod
    def of_vec(self, observations: Any) -> list[int]:
        """
        Find the rows as a list of Python integers. For few observations this is faster than :meth:`of_batch`.

        :param observations: observations as ``VecEnv.step`` returns them
        :return: their rows
        :raises ValueError: if one lies outside the space
        """

    @abstractmethod
    def of_batch(self, observations: Any) -> np.ndarray:
        """
        :param observations: n observations
        :return: their rows, of shape (n,)
        :raises ValueError: if one lies outside the space
        """

    @abstractmethod
    def observation(self, index: int) -> Any:
        """
        :param index: a row
        :return: its observation
        """

    @abstractmethod
    def observations(self, indices: np.ndarray) -> Any:
        """
        :param indices: rows, of shape (n,)
        :return: their observations, as a VecEnv gives them
        """

    @abstractmethod
    def is_single(self, observation: Any) -> bool:
        """
        :param observation: anything
        :return: whether it has the form of one observation
        """

    def of_several(self, observations: Any) -> np.ndarray:
        """
        :param observations: n observations as a VecEnv gives them, or a list of n
        :return: their rows, of shape (n,)
        :raises ValueError: if one lies outside the space
        """
        if isinstance(observations, tuple) and len(observations) == 2 and isinstance(observations[1], dict):
            if self.is_single(observations[0]):
                raise ValueError(
                    f"Expected an observation, but got a tuple of an observation and a dict, {observations!r}: this is what "
                    "`env.reset()` of gymnasium returns, `observation, info`. Please pass the observation only."
                )
        return self.of_batch(self.gather(observations))

    def gather(self, observations: Any) -> Any:
        """
        :param observations: several observations as a VecEnv gives them, or a list of them
        :return: the observations as a VecEnv gives them
        """
        return observations

    def refusal(self, observation: Any) -> ValueError:
        """
        :param observation: an observation outside the space
        :return: the error to raise
        """
        what = f"The part {self.part} of the observation, {observation}," if self.part else f"The observation {observation}"
        return ValueError(f"{what} lies outside the observation space {self.space}: please check the environment.")


class DiscreteIndex(StateIndex):
    """The rows of a Discrete space."""

    def __init__(self, space: spaces.Discrete[Any], part: str = "") -> None:
        super().__init__(space, part)
        self.n_states = int(space.n)
        self.start = int(space.start)
        self.sizes, self.starts = (self.n_states,), (self.start,)
        # A look-up in a range takes half the time of two comparisons
        self._numbers = range(self.start, self.start + self.n_states)

    def of(self, observation: Any) -> int:
        number = observation
        if type(number) is not int:  # a range compares other types with its numbers one by one
            number = np.asarray(observation).tolist()
            if not isinstance(number, int | float) or number != number // 1:
                raise self.refusal(observation)
            number = int(number)
        if number not in self._numbers:
            raise self.refusal(observation)
        return number - self.start

    def of_vec(self, observations: Any) -> list[int]:
        values = observations.tolist()
        for value in values:
            if type(value) is not int or value not in self._numbers:
                return self.of_batch(observations).tolist()
        return [value - self.start for value in values] if self.start else values

    def of_batch(self, observations: Any) -> np.ndarray:
        if len(_shape(observations) or ()) != 1:
            raise ValueError(
                f"An observation of {self.space} is a number, and several are an array of one axis, but got {observations!r}."
            )
        values = np.asarray(observations)
        digits, are_whole = _whole_numbers(values)
        digits -= self.start
        inside = are_whole & (digits >= 0) & (digits < self.n_states)
        if not inside.all():
            raise self.refusal(values[~inside][0])
        return digits

    def observation(self, index: int) -> Any:
        return self.space.dtype.type(self.start + index)

    def observations(self, indices: np.ndarray) -> np.ndarray:
        return (np.asarray(indices) + self.start).astype(self.space.dtype)

    def is_single(self, observation: Any) -> bool:
        return type(observation) is int or _shape(observation) == ()


class ArrayIndex(StateIndex):
    """The rows of a MultiDiscrete or MultiBinary space, whose entries are taken in C order."""

    def __init__(self, space: spaces.MultiDiscrete[Any] | spaces.MultiBinary, part: str = "") -> None:
        super().__init__(space, part)
        self.shape = space.shape
        if isinstance(space, spaces.MultiBinary):
            self.sizes, self.starts = (2,) * prod(space.shape), (0,) * prod(space.shape)
        else:
            self.sizes, self.starts = tuple(space.nvec.ravel().tolist()), tuple(space.start.ravel().tolist())
        self.n_states = prod(self.sizes)

    def of(self, observation: Any) -> int:
        if not self.is_single(observation):
            raise self._wrong_shape(observation)
        return self.of_vec(np.asarray(observation)[np.newaxis])[0]

    def of_vec(self, observations: Any) -> list[int]:
        if observations.shape[1:] != self.shape:
            raise self._wrong_shape(observations)
        rows = []
        for values in observations.reshape(len(observations), -1).tolist():
            row = 0
            for i, value in enumerate(values):  # a `zip` with `strict=True` takes longer
                digit = value - self.starts[i]
                if not (0 <= digit < self.sizes[i] and type(digit) is int):
                    return self.of_batch(observations).tolist()
                row = row * self.sizes[i] + digit
            rows.append(row)
        return rows

    def of_batch(self, observations: Any) -> np.ndarray:
        shape = _shape(observations)
        if not shape or shape[1:] != self.shape:
            raise self._wrong_shape(observations)
        observations = np.asarray(observations)
        digits, are_whole = _whole_numbers(observations.reshape(len(observations), -1))
        digits -= np.array(self.starts)
        inside = (are_whole & (digits >= 0) & (digits < np.array(self.sizes))).all(axis=1)
        if not inside.all():
            raise self.refusal(observations[~inside][0])
        return np.ravel_multi_index(tuple(digits.T), self.sizes)

    def observation(self, index: int) -> np.ndarray:
        return self.observations(np.array([index]))[0]

    def observations(self, indices: np.ndarray) -> np.ndarray:
        digits = np.stack(np.unravel_index(indices, self.sizes), axis=1) + np.array(self.starts)
        return digits.reshape(len(indices), *self.shape).astype(self.space.dtype)

    def is_single(self, observation: Any) -> bool:
        return _shape(observation) == self.shape

    def _wrong_shape(self, observations: Any) -> ValueError:
        return ValueError(
            f"An observation of {self.space} has the shape {self.shape}, and several have one more axis in front, but got "
            f"{observations!r}."
        )


class CompositeIndex(StateIndex):
    """The rows of a Tuple or a Dict space; the parts of a Dict come in the order of the space's keys."""

    def __init__(self, space: spaces.Tuple[Any] | spaces.Dict, part: str = "") -> None:
        super().__init__(space, part)
        self.is_dict = isinstance(space, spaces.Dict)
        named = space.spaces.items() if isinstance(space, spaces.Dict) else enumerate(space.spaces)
        self.parts = [(key, make_state_index(inner, f"{part}[{key!r}]")) for key, inner in named]
        self.sizes = sum((index.sizes for _, index in self.parts), ())
        self.starts = sum((index.starts for _, index in self.parts), ())
        self.n_states = prod(self.sizes)

    def of(self, observation: Any) -> int:
        self._check_form(observation)
        row = 0
        for key, index in self.parts:
            row = row * index.n_states + index.of(observation[key])
        return row

    def of_vec(self, observations: Any) -> list[int]:
        (first, index), *others = self.parts
        rows = index.of_vec(observations[first])
        for key, index in others:
            size = index.n_states
            rows = [row * size + digit for row, digit in zip(rows, index.of_vec(observations[key]), strict=True)]
        return rows

    def of_batch(self, observations: Any) -> np.ndarray:
        self._check_form(observations)
        digits = [index.of_batch(observations[key]) for key, index in self.parts]
        lengths = [len(of_part) for of_part in digits]
        if len(set(lengths)) > 1:
            raise ValueError(f"Every part of {self.space} must have as many observations as the others, but got {lengths}.")
        rows = np.zeros_like(digits[0])
        for (_, index), of_part in zip(self.parts, digits, strict=True):
            rows = rows * index.n_states + of_part
        return rows

    def observation(self, index: int) -> Any:
        return self._split(index, lambda part, digit: part.observation(int(digit)))

    def observations(self, indices: np.ndarray) -> Any:
        return self._split(np.asarray(indices), lambda part, digits: part.observations(digits))

    def _split(self, rest: Any, observe: Any) -> Any:
        """Split rows into observations of the parts. The last part is the least significant digit, so it comes first."""
        found = {}
        for key, index in reversed(self.parts):
            rest, digit = divmod(rest, index.n_states)
            found[key] = observe(index, digit)
        in_order = {key: found[key] for key, _ in self.parts}
        return in_order if self.is_dict else tuple(in_order.values())

    def is_single(self, observation: Any) -> bool:
        return self._has_form(observation) and all(index.is_single(observation[key]) for key, index in self.parts)

    def gather(self, observations: Any) -> Any:
        if not isinstance(observations, list | np.ndarray) or not all(map(self.is_single, observations)):
            return observations
        gathered = {key: index.gather([one[key] for one in observations]) for key, index in self.parts}
        return gathered if self.is_dict else tuple(gathered.values())

    def _has_form(self, observation: Any) -> bool:
        if self.is_dict:
            return isinstance(observation, Mapping) and all(key in observation for key, _ in self.parts)
        if not isinstance(observation, Sequence) and np.ndim(observation) == 0:
            return False
        return len(observation) == len(self.parts)

    def _check_form(self, observation: Any) -> None:
        if not self._has_form(observation):
            form = (
                f"dict with the keys {[key for key, _ in self.parts]}" if self.is_dict else f"tuple of {len(self.parts)} parts"
            )
            raise ValueError(f"An observation of {self.space} is a {form}, but got {observation!r}.")


def make_state_index(space: spaces.Space[Any], part: str = "") -> StateIndex:
    """
    :param space: the space of the observations
    :param part: which part of a larger space it is, for messages
    :return: the rows of its observations
    :raises ValueError: if it is not finite
    """
    if isinstance(space, spaces.Discrete):
        return DiscreteIndex(space, part)
    if isinstance(space, spaces.MultiDiscrete | spaces.MultiBinary):
        return ArrayIndex(space, part)
    if isinstance(space, spaces.Tuple | spaces.Dict) and len(space.spaces) > 0:
        return CompositeIndex(space, part)
    raise ValueError(
        "A tabular algorithm needs a Discrete, MultiDiscrete or MultiBinary observation space, or a Tuple or Dict of these, "
        f"but {f'its part {part} is' if part else 'got'} {space}: {_advice(space, part)}."
    )


def is_finite(space: spaces.Space[Any]) -> bool:
    """
    :param space: any space
    :return: whether its observations can be the rows of a table
    """
    try:
        make_state_index(space)
    except ValueError:
        return False
    return True


def _advice(space: spaces.Space[Any], part: str) -> str:
    if not isinstance(space, spaces.Box):
        return "wrap the environment in a `gymnasium.ObservationWrapper` that turns its observations into one of these"
    if not part:
        return "wrap the environment in `sb3_adaptive_q.wrappers.DiscretizeObservation`"
    return (
        "wrap the environment in a `gymnasium.ObservationWrapper` that bins this part; or, where all parts are Box, in "
        "`gymnasium.wrappers.FlattenObservation` and then in `sb3_adaptive_q.wrappers.DiscretizeObservation`"
    )


def _shape(observation: Any) -> tuple[int, ...] | None:
    try:
        return np.shape(observation)
    except ValueError:  # lists of different lengths within a list
        return None


def _whole_numbers(values: np.ndarray) -> tuple[np.ndarray, Any]:
    """The values as 64-bit integers, and which of them are whole numbers at all."""
    if values.dtype.kind in "bui":
        return values.astype(np.int64), True
    if values.dtype.kind != "f":
        return np.zeros(values.shape, dtype=np.int64), np.zeros(values.shape, dtype=bool)
    with np.errstate(invalid="ignore"):  # a NaN becomes some integer, which differs from it
        digits = values.astype(np.int64)
    return digits, digits == values
