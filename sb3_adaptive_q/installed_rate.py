"""A learning-rate method as the model keeps it: plain data, and the rule it stands for."""

import importlib
import inspect
from collections.abc import Callable
from functools import cached_property
from math import isfinite
from numbers import Real
from typing import Any

from sb3_adaptive_q.compilation import FunctionSet
from sb3_adaptive_q.kernels import NEXT_ACTIONS
from sb3_adaptive_q.rules import Transition


class InstalledRate:
    """
    :param owner: the callback class that has the rule, as ``module:qualified name``
    :param mu_0: the step size to start from; ``None`` for what the rule says with no progress made
    :param next_action: which action's value in the next state the rule sees
    :param reset_each_episode: whether μ starts again from ``mu_0`` with every episode
    :param parameters: the rule's further arguments by name
    """

    def __init__(
        self, owner: str, mu_0: float | None, next_action: str, reset_each_episode: bool, parameters: dict[str, float]
    ) -> None:
        self.owner = owner
        self.next_action = next_action
        self.reset_each_episode = reset_each_episode
        self.parameters = parameters
        self.mu_0 = mu_0

    @classmethod
    def of(
        cls, owner: type, mu_0: float | None, next_action: str, reset_each_episode: bool, parameters: dict[str, float]
    ) -> "InstalledRate":
        """
        The method of a callback class; for the arguments see the class.

        :raises ValueError: if one of them is not what the rule or the paper allows
        """
        if next_action not in NEXT_ACTIONS:
            raise ValueError(f"`next_action` must be one of {', '.join(NEXT_ACTIONS)}, but got {next_action!r}.")
        if not callable(getattr(owner, "rule", None)):
            raise ValueError(
                f"{owner.__qualname__} needs the class attribute `rule`, a function `rule(mu, transition, *parameters)` that "
                "returns the next step size."
            )
        rate = cls(f"{owner.__module__}:{owner.__qualname__}", mu_0, next_action, reset_each_episode, dict(parameters))
        rate.__dict__["function"] = owner.rule  # type: ignore[attr-defined]
        rate._put_parameters_in_order()
        start = rate.start()
        if mu_0 is None and not is_rate(start):
            raise ValueError(
                f"The rule of {rate.owner} must give step sizes from 0 to 1, but for a transition of zeros, where training "
                f"starts, it gave {start!r}: please check it, or say `mu_0`."
            )
        check_rate("mu_0", start)
        return rate

    @cached_property
    def function(self) -> Callable[..., float]:
        """The rule, imported from the class that has it."""
        module, _, name = self.owner.partition(":")
        owner: Any = importlib.import_module(module)
        for part in name.split("."):
            owner = getattr(owner, part)
        return owner.rule

    @cached_property
    def rule(self) -> FunctionSet:
        """The rule as the update and the compiled loop take it."""
        return FunctionSet(self.owner, function=self.function)

    @property
    def arguments(self) -> tuple[float, ...]:
        """The values of the parameters, in the rule's order."""
        return tuple(self.parameters.values())

    def start(self) -> float:
        """
        :return: the step size of the first update
        """
        if self.mu_0 is not None:
            return self.mu_0
        return self.function(0.0, Transition(0.0, 0.0, 0.0, 0.0), *self.arguments)

    def as_data(self) -> dict[str, Any]:
        """
        :return: the method as plain data, for the saved file; ``InstalledRate(**data)`` is the way back
        """
        names = ("owner", "mu_0", "next_action", "reset_each_episode", "parameters")
        return {name: getattr(self, name) for name in names}

    def _put_parameters_in_order(self) -> None:
        names = list(inspect.signature(self.function).parameters)
        if names[:1] == ["self"]:
            raise ValueError(f"The rule of {self.owner} must be a function without `self`: please make it a `@staticmethod`.")
        expected = names[2:]
        if set(expected) != set(self.parameters):
            raise ValueError(
                f"The rule of {self.owner} takes the parameters ({', '.join(expected)}) after `mu` and `transition`, "
                f"but got ({', '.join(self.parameters)})."
            )
        given: dict[str, Any] = {**self.parameters}
        for name, value in given.items():
            if not isinstance(value, Real) or not isfinite(value):
                raise ValueError(f"`{name}` must be finite and a number, for the rule of {self.owner}, but got {value!r}.")
        self.parameters = {name: float(self.parameters[name]) for name in expected}


def is_rate(value: Any) -> bool:
    """
    :param value: anything
    :return: whether it is a number from 0 to 1
    """
    return isinstance(value, Real) and 0.0 <= float(value) <= 1.0


def check_rate(name: str, value: Any) -> None:
    """
    :param name: what the value is called
    :param value: a step size
    :raises ValueError: if it is not from 0 to 1
    """
    if not is_rate(value):
        raise ValueError(f"`{name}` must be from 0 to 1, but got {value}.")
