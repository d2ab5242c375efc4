"""What a study holds fixed and what it compares: the paper's settings, and those that a user changes."""

import math
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from types import MappingProxyType
from typing import Any

import yaml

from sb3_adaptive_q.callbacks import METHODS, method
from sb3_adaptive_q.installed_rate import check_rate
from sb3_adaptive_q.kernels import NEXT_ACTIONS
from sb3_adaptive_q.study.errors import DesignError

#: The paper's systems, by the ids of the environments
FROZEN_LAKE, CART_POLE = "FrozenLake-v1", "CartPoleFriction-v0"

#: Readings of Eqs. 7-11. ``literal`` is what the equations say. ``table8`` was fitted: of several hundred readings it
#: comes closest to the paper's Table 8, and it contradicts Table 7.
PRESETS = MappingProxyType(
    {
        "literal": "Equations 7 to 11 as they stand: μ starts from β1 and is never reset",
        "table8": "fitted to Table 8: Methods 5 to 8 see max Q(s', ·), and μ starts every episode from β7",
    }
)


@dataclass(frozen=True, kw_only=True)
class StudySettings:
    """
    The design of a study. Everything but ``systems``, ``methods`` and ``runs`` decides what a single run gives.

    :param systems: ids of environments that :class:`~sb3_adaptive_q.vec_env.CompiledVecEnv` compiles
    :param methods: numbers of the paper's methods
    :param runs: independent runs of every method in every system
    :param episodes: episodes of a run
    :param seed: of the whole study; every run's own seed is derived from it
    :param gamma: the discount factor γ
    :param exploration_fraction: the fraction of the episodes over which ε falls
    :param exploration_initial_eps: ε at the start
    :param exploration_final_eps: ε at the end
    :param beta_1: μ of Method 1, the lower end of Methods 3 and 4, and where Methods 5 to 8 start from
    :param beta_2: μ of Method 2
    :param beta_3: what Methods 3 and 4 add to β1
    :param beta_5: the gain of Methods 5 and 6
    :param beta_6: the step of Methods 7 and 8
    :param beta_7: the least μ of Methods 5 to 8
    :param beta_8: the largest μ of Methods 5 to 8
    :param preset: one of ``PRESETS``
    :param next_action: whose value in the next state Methods 5 to 8 look at: ``"same"``, ``"next"`` or ``"max"``;
        ``None`` for the preset's
    :raises DesignError: if one of these is out of range
    """

    systems: tuple[str, ...] = (FROZEN_LAKE, CART_POLE)
    methods: tuple[int, ...] = tuple(METHODS)
    runs: int = 20
    episodes: int = 30_000
    seed: int = 0
    gamma: float = 0.99
    exploration_fraction: float = 1.0
    exploration_initial_eps: float = 1.0
    exploration_final_eps: float = 0.05
    beta_1: float = 0.01
    beta_2: float = 0.05
    beta_3: float = 0.04
    beta_5: float = 0.05
    beta_6: float = 0.005
    beta_7: float = 0.001
    beta_8: float = 0.01
    preset: str = "literal"
    next_action: str | None = None

    def __post_init__(self) -> None:
        _check_selection("systems", self.systems)
        _check_selection("methods", self.methods)
        unknown = [number for number in self.methods if number not in METHODS]
        if unknown:
            raise DesignError(f"Unknown method {unknown[0]}: the methods are {', '.join(map(str, METHODS))}.")
        for name, least in (("runs", 1), ("episodes", 1), ("seed", 0)):
            if getattr(self, name) < least:
                raise DesignError(f"{name} must be at least {least}, but is {getattr(self, name)}.")
        _check_choice("preset", self.preset, list(PRESETS))
        if self.next_action is not None:
            _check_choice("next_action", self.next_action, list(NEXT_ACTIONS))
        self._check_numbers()

    def _check_numbers(self) -> None:
        for name in (field.name for field in fields(self) if field.name.startswith("beta_")):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) >= 0.0):
                raise DesignError(f"{name} must be a finite number of at least 0, but is {getattr(self, name)}.")
        if self.beta_7 > self.beta_8:
            raise DesignError(f"beta_7 must not be above beta_8, but they are {self.beta_7} and {self.beta_8}.")
        try:
            for name in _PROBABILITIES:
                check_rate(name, getattr(self, name))
            for number in self.methods:
                method(number, **self.method_kwargs(number))
        except ValueError as error:
            raise DesignError(str(error)) from error

    def method_kwargs(self, number: int) -> dict[str, Any]:
        """
        :param number: a method
        :return: its parameters, as ``TabularQ`` takes them
        """
        signs = {5: {"gain": -self.beta_5}, 6: {"gain": self.beta_5}, 7: {"step": self.beta_6}, 8: {"step": -self.beta_6}}
        if number in signs:
            return {**signs[number], **self._adaptive_kwargs()}
        if number in (1, 2):
            return {"beta": self.beta_1 if number == 1 else self.beta_2}
        return {"beta_1": self.beta_1, "beta_3": self.beta_3}

    def _adaptive_kwargs(self) -> dict[str, Any]:
        kwargs: dict[str, Any] = {"mu_0": self.beta_1, "lower": self.beta_7, "upper": self.beta_8}
        next_action = self.next_action
        if self.preset == "table8":
            kwargs |= {"mu_0": self.beta_7, "reset_each_episode": True}
            next_action = next_action or "max"
        return kwargs | ({"next_action": next_action} if next_action else {})

    def as_data(self) -> dict[str, Any]:
        """
        :return: the settings as plain data, for YAML; ``StudySettings.from_data`` is the way back
        """
        return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}

    @classmethod
    def from_data(cls, data: dict[str, Any]) -> "StudySettings":
        """
        :param data: settings by name; those left out take the paper's values
        :return: the settings
        :raises DesignError: if a name is unknown or a value is of another kind
        """
        defaults: dict[str, Any] = vars(cls())
        unknown = [name for name in data if name not in defaults]
        if unknown:
            raise DesignError(f"Unknown setting {unknown[0]!r}: the settings are {', '.join(defaults)}.")
        return cls(**{name: _convert(name, value, defaults[name]) for name, value in data.items()})


def read_design(path: Path) -> dict[str, Any]:
    """
    :param path: a YAML file of settings by name, such as the record that a study keeps of its own
    :return: the settings as they stand there, and the versions under ``versions`` if it has them
    :raises DesignError: if it cannot be read or holds something else
    """
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise DesignError(f"Cannot read {path}: {' '.join(str(error).split())}.") from error
    if not isinstance(data, dict) or not isinstance(data.get("versions", {}), dict):
        raise DesignError(f"{path} must hold settings, one `name: value` a line.")
    return data


_PROBABILITIES = ("gamma", "exploration_fraction", "exploration_initial_eps", "exploration_final_eps")
#: What only selects among the runs, and may grow from one start of a study to the next
SELECTION = ("systems", "methods", "runs")


def _convert(name: str, value: Any, default: Any) -> Any:
    if isinstance(default, tuple):
        items = value if isinstance(value, list | tuple) else [value]
        return tuple(_convert(name, item, default[0]) for item in items)
    if name == "next_action" and value is None:
        return None
    if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    kind = type(default) if isinstance(default, int | float) else str
    if isinstance(value, bool) or not isinstance(value, kind):
        expected = {int: "a whole number", float: "a number", str: "a text"}[kind]
        raise DesignError(f"{name} must be {expected}, but is {value!r}.")
    return value


def _check_selection(name: str, values: tuple[Any, ...]) -> None:
    if not values:
        raise DesignError(f"{name} must not be empty.")
    if len(set(values)) < len(values):
        raise DesignError(f"{name} must not repeat an entry, but is {' '.join(map(str, values))}.")


def _check_choice(name: str, value: str, choices: list[str]) -> None:
    if value not in choices:
        raise DesignError(f"{name} must be one of {', '.join(choices)}, but is {value!r}.")
