"""A method as the model keeps it: its plain data and its functions."""

import inspect
from collections.abc import Callable
from functools import cached_property
from numbers import Real
from typing import Any, NamedTuple

import numpy as np

from sb3_adaptive_q.checks import FINITE, check
from sb3_adaptive_q.compiled.jit import CannotCompile, type_returned
from sb3_adaptive_q.step_sizes.cells import (
    COUNTS,
    MOST_ARRAYS,
    keep_mu,
    last_size,
    make_clipped,
    make_size,
    scalar_size,
)
from sb3_adaptive_q.step_sizes.step import Step, clip_size


#: The bounds of a step size that is not clipped: one outside [0, 1] is refused where it was computed
NO_BOUNDS = (float("-inf"), float("inf"))
_STEP_OF_ZEROS = Step(0, 0, 0, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


class MethodData(NamedTuple):
    """
    The part of a method that a saved file holds.

    :param owner: the name of a step size in ``STEP_SIZES``, or the callback class that has the functions, as
        ``module:qualified name``
    :param label: the name of the method in names of runs
    :param parameters: the functions' further arguments by name
    :param memory: the number that every cell of an array starts from, by the array's name
    :param counts: whether the step size uses ``step.count``
    :param scope: which updates share a cell of the memory, a key of ``SCOPES``
    :param bounds: the least and the largest step size
    :param mu_0: the scalar step size to start from; ``None`` for what the functions give for a Step
        whose numbers are all 0
    :param next_action: which action's value in the next state the rule sees
    :param reset_each_episode: whether μ starts again from ``mu_0`` with every episode
    """

    owner: str
    label: str
    parameters: dict[str, float]
    memory: dict[str, float] = {}  # noqa: RUF012  # never changed
    counts: bool = False
    scope: str = "pair"
    bounds: tuple[float, float] = NO_BOUNDS
    mu_0: float | None = None
    next_action: str = "next"
    reset_each_episode: bool = False


class InstalledMethod:
    """
    A method that is ready to be used: its data, checked against its functions.

    :param data: the method as data
    :param functions: (step_size, rule), each of them may be ``None``
    :raises ValueError: if the data do not fit the functions
    """

    def __init__(self, data: MethodData, functions: tuple[Any, Any]) -> None:
        self.step_size, self.rule = functions
        data = _check_data(data)
        self.data = data._replace(parameters=self._in_order(data))

    def __getstate__(self) -> dict[str, Any]:
        # A function that is made here cannot be pickled, and is made again where it is missing
        return {name: value for name, value in vars(self).items() if name != "size_function"}

    def _in_order(self, data: MethodData) -> dict[str, float]:
        """Check the functions' arguments, and put the parameters in the same order."""
        arrays = list(data.memory)
        for name, function, names in (("step_size", self.step_size, arrays), ("rule", self.rule, [])):
            if function is not None:
                expected = _further_arguments(data.owner, name, function)
                takes = expected[: len(expected) - len(names)]
                if sorted(takes) != sorted(data.parameters) or expected[len(takes) :] != names:
                    raise ValueError(
                        f"`{name}` of {data.owner} takes ({', '.join(expected)}) after `mu` and `step`, but the parameters "
                        f"are ({', '.join(data.parameters)}) and the arrays of its memory ({', '.join(names)}): please make "
                        "them agree, parameters first."
                    )
                data = data._replace(parameters={name: data.parameters[name] for name in takes})
        return {name: FINITE.apply(name, value) for name, value in data.parameters.items()}

    @property
    def arguments(self) -> tuple[float, ...]:
        """The values of the parameters, in the functions' order."""
        return tuple(self.data.parameters.values())

    @property
    def has_memory(self) -> bool:
        """Whether each update has a step size of its own, from ``step_size``, besides the scalar μ."""
        return self.step_size is not None

    @property
    def array_starts(self) -> dict[str, float]:
        """The number that every cell of each array starts from, the counts first."""
        return ({COUNTS: 0.0} if self.data.counts else {}) | self.data.memory

    @cached_property
    def size_function(self) -> Callable[..., Any]:
        """The function that computes the step size of an update."""
        if self.step_size is None:
            return scalar_size
        return make_size(self.step_size, self.data.scope, self.data.counts, len(self.array_starts))

    @property
    def rule_function(self) -> Callable[..., float]:
        """The function that computes the next scalar μ."""
        if self.rule is not None:
            return self.rule if self.data.bounds == NO_BOUNDS else make_clipped(self.rule, *self.data.bounds)
        return last_size if self.step_size is not None else keep_mu

    def check_functions(self) -> None:
        """
        Compile the user's functions separately, so that a message can name the one at fault.

        :raises CannotCompile: if Numba cannot compile one
        :raises ValueError: if one returns something else than a number
        """
        arrays = [np.zeros((1, 1)) for _ in self.data.memory]
        for name, function, further in (("step_size", self.step_size, arrays), ("rule", self.rule, [])):
            if function is None or is_own(function):
                continue
            try:
                other = type_returned(function, (0.0, _STEP_OF_ZEROS, *self.arguments, *further))
            except CannotCompile as error:
                raise CannotCompile(f"`{name}` does not compile, because {error}") from error
            if other is not None:
                raise ValueError(
                    f"`{name}` of {self.data.owner} must return a number in every case, but returns {other}: please check it."
                )

    def start(self) -> float:
        """
        :return: the scalar step size of the first update
        :raises ValueError: if the functions give no number from 0 to 1
        """
        if self.data.mu_0 is not None:
            return float(self.data.mu_0)
        step = _STEP_OF_ZEROS._replace(count=1.0 if self.data.counts else 0.0)
        try:
            if self.step_size is not None:
                arrays = [np.full((1, 1), start) for start in self.data.memory.values()]
                mu: Any = self.step_size(0.0, step, *self.arguments, *arrays)
            else:
                mu = self.rule(0.0, step, *self.arguments)
        except ZeroDivisionError as error:
            raise ValueError(
                f"{self.data.owner} must give step sizes from 0 to 1, but before the first update, where all numbers of "
                "the Step are 0, it divides by zero: please check it, pass `mu_0`, or set the class attribute `counts = True` "
                "if it divides by `step.count`."
            ) from error
        clipped = clip_size(float(mu), *self.data.bounds) if isinstance(mu, Real) else mu
        if not (isinstance(mu, Real) and 0.0 <= clipped <= 1.0):
            raise ValueError(
                f"{self.data.owner} must give step sizes from 0 to 1, but before the first update, where all numbers of "
                f"the Step are 0, it gave {mu!r}: please check it, or pass `mu_0`."
            )
        return float(clipped)


def is_own(function: Callable[..., Any]) -> bool:
    """
    :param function: a function of a method, a schedule or an algorithm
    :return: whether it is one of this package
    """
    return (getattr(function, "__module__", None) or "").partition(".")[0] == __package__


def _check_data(data: MethodData) -> MethodData:
    checked = {name: check(name, getattr(data, name)) for name in ("scope", "mu_0", "next_action", "reset_each_episode")}
    if len(data.memory) + data.counts > MOST_ARRAYS:
        raise ValueError(f"A step size may have {MOST_ARRAYS} arrays, the counts included, but {data.owner} has more.")
    return data._replace(**checked)


def _further_arguments(owner: str, name: str, function: Callable[..., Any]) -> list[str]:
    names = list(inspect.signature(function).parameters)
    if names[:1] == ["self"]:
        raise ValueError(f"`{name}` of {owner} must be a function without `self`: please make it a `@staticmethod`.")
    if len(names) < 2:
        raise ValueError(f"`{name}` of {owner} must take `mu` and `step` first, but takes ({', '.join(names)}).")
    return names[2:]
