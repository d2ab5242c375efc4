"""What a step size is: what it may look at, its parameters, and the data that describe it."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

#: One array of a step size's memory: (n_states, n_actions), (n_states, 1) or (1, 1), after the scope of the step size
Memory: TypeAlias = NDArray[np.float64]


class Step(NamedTuple):
    """
    What a step size or a rule may look at.

    :param state: s_t, counted from 0
    :param action: a_t, counted from 0
    :param row: the row of the cell that belongs to this update in the arrays of the memory
    :param column: the column of that cell
    :param count: updates of that cell, this one included; 0 where the step size does not ask for counts
    :param value: Q_t(s_t, a_t), before the update
    :param next_value: in a ``step_size``, the value of s_{t+1} inside the target; in a ``rule``, Q_t(s_{t+1}, a) for the
        action a that ``next_action`` names. Both are 0 where s_{t+1} is terminal
    :param td_error: the temporal-difference error: target minus ``value``
    :param progress: the share of the training that is over, from 0 to 1
    :param gamma: the discount factor γ
    :param size: the step size of this update; 0 while it is being formed
    """

    state: int
    action: int
    row: int
    column: int
    count: float  # type: ignore[assignment]  # hides a method of tuples, which nobody needs here
    value: float
    next_value: float
    td_error: float
    progress: float
    gamma: float
    size: float


class Parameter(NamedTuple):
    """
    A number that a step size can be given.

    :param default: its value where none is given
    :param lower: the least value
    :param upper: the largest value; infinity stands for "any finite number"
    :param meaning: what it does, in a few words
    :param open_lower: whether ``lower`` itself is excluded
    :param open_upper: whether ``upper`` itself is excluded
    """

    default: float
    lower: float
    upper: float
    meaning: str
    open_lower: bool = False
    open_upper: bool = False

    @property
    def range(self) -> str:
        """The values it may have, in the notation of intervals: ``(0, 1]``."""
        left = "(" if self.open_lower or math.isinf(self.lower) else "["
        right = ")" if self.open_upper or math.isinf(self.upper) else "]"
        return f"{left}{self.lower:.3g}, {self.upper:.3g}{right}"

    def check(self, name: str, value: Any) -> float:
        """
        :param name: what the parameter is called, for the message
        :param value: what was given for it
        :return: the value as a float
        :raises ValueError: if it is not a finite number of the range
        """
        is_number = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
        if is_number and self._contains(float(value)):
            return float(value)
        raise ValueError(f"`{name}` must be a number in {self.range}, but got {value!r}.")

    def _contains(self, value: float) -> bool:
        above = self.lower < value if self.open_lower else self.lower <= value
        below = value < self.upper if self.open_upper else value <= self.upper
        return above and below and math.isfinite(value)


@dataclass(frozen=True)
class StepSize:
    """
    A step size of the literature, as data.

    The function forms the step size of the very update that it is called for, before the table is written, and changes
    its arrays in place at ``[step.row, step.column]``. It is plain Python of scalars, which Numba compiles as it stands
    and which gives the same bits either way: it divides by nothing that can be zero, and raises to no constant power.

    :param name: what it is called by
    :param step_size: ``step_size(mu, step, *parameters, *arrays) -> float``, with ``step`` a :class:`Step`
    :param parameters: its parameters by name, in the function's order
    :param memory: for every array, in the function's order, the number that it starts from: a float, or a function that
        makes it of the dict of parameters
    :param counts: whether it needs ``step.count``
    :param formula: what it computes, in one line
    :param source: author and year
    :param lower: the least step size: what the caller raises a smaller one to
    :param upper: the largest step size: what the caller lowers a larger one to. The memory keeps what the function left
    """

    name: str
    step_size: Callable[..., float]
    parameters: dict[str, Parameter]
    memory: dict[str, float | Callable[[dict[str, float]], float]]
    counts: bool
    formula: str
    source: str
    lower: float = 0.0
    upper: float = 1.0

    def start_values(self, parameters: dict[str, float]) -> dict[str, float]:
        """
        :param parameters: the value of every parameter, by name
        :return: the number that every cell of each array starts from, by the array's name
        """
        return {name: float(start(parameters) if callable(start) else start) for name, start in self.memory.items()}


def cell_of(step: Step) -> tuple[np.uint64, np.uint64]:
    """
    The cell that belongs to an update. Its place is unsigned, so that Numba does not check for negative indices, which makes
    a training about 4 % faster.

    :param step: the update
    :return: its row and column in the arrays of the memory
    """
    return np.uint64(step.row), np.uint64(step.column)


def clip_size(size: float, lower: float, upper: float) -> float:
    """
    Keep a step size within bounds. What is not a number stays so, for the caller to find.

    :param size: the step size
    :param lower: the least step size
    :param upper: the largest step size
    :return: the step size within the bounds
    """
    return min(max(size, lower), upper)


def first_step_size(default: float) -> Parameter:
    """
    The parameter that many step sizes begin with.

    :param default: its default
    :return: the parameter, above 0 and up to 1
    """
    return Parameter(default, 0.0, 1.0, "the first step size", open_lower=True)


def starts_at_alpha_0(parameters: dict[str, float]) -> float:
    """
    The start value of a memory that holds the step size itself.

    :param parameters: the value of every parameter, by name
    :return: α₀
    """
    return parameters["alpha_0"]


def starts_at_log_alpha_0(parameters: dict[str, float]) -> float:
    """
    The start value of a memory that holds the logarithm of the step size.

    :param parameters: the value of every parameter, by name
    :return: ln α₀
    """
    return math.log(parameters["alpha_0"])
