"""A design: algorithms x methods x settings x environments x runs."""

import hashlib
import itertools
import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from sb3_adaptive_q.checks import STUDY, Check
from sb3_adaptive_q.experiments.cells import Cell
from sb3_adaptive_q.experiments.environments import reused_vec_env
from sb3_adaptive_q.experiments.errors import DesignError, unknown_name
from sb3_adaptive_q.experiments.learners import Learner
from sb3_adaptive_q.experiments.names import method_label, source_digests

EPISODES = "sb3_adaptive_q.experiments.episodes:measure_episodes"


class Choice(NamedTuple):
    """
    A method with its parameters.

    :param name: a number or a name, or the ``module:name`` of a class
    :param parameters: by name; one that is a list is tried with each of its values
    :param label: what to call it; empty for its name
    """

    name: str
    parameters: Mapping[str, Any] = {}
    label: str = ""


class Variant(NamedTuple):
    """
    :param label: what to call it within its environment
    :param learner: who learns where
    """

    label: str
    learner: Learner


@dataclass(frozen=True, kw_only=True)
class Design:
    """
    Every method of every algorithm, with every setting, in every environment, many times.

    :param environments: ids, or the ``module:name`` of functions that make an environment
    :param methods: what sets the learning rate; a number or a name stands for a method with its own parameters
    :param algorithms: names, or the ``module:name`` of classes
    :param settings: arguments of the algorithm by name; one that is a list is tried with each of its values
    :param runs: independent runs of each
    :param seed: of the whole experiment; every run's own seed is derived from it
    :param steps: of a run; ``None`` where ``total_episodes`` among the settings ends it
    :raises DesignError: if a name is unknown, a value out of range, or a run would be there twice
    """

    environments: Sequence[str]
    methods: Sequence[Choice | str | int]
    algorithms: Sequence[str] = ("tabular_q",)
    settings: Mapping[str, Any] = field(default_factory=dict)
    runs: int = 20
    seed: int = 0
    steps: int | None = None

    def __post_init__(self) -> None:
        for name in ("environments", "methods", "algorithms"):
            check_selection(name, getattr(self, name))
        check_options(self, STUDY)
        if self.steps is None and "total_episodes" not in self.settings:
            raise DesignError("The length of a run is missing: give `steps`, or `total_episodes` among the settings.")
        _check_no_run_twice(self.variants())
        for variant in self.variants():
            variant.learner.make(seed=0)

    @classmethod
    def from_yaml(cls, path: Path) -> "Design":
        """
        :param path: a YAML file of the arguments by name; a method with parameters is a mapping of its ``name`` and these
        :return: the design
        :raises DesignError: if it cannot be read, or holds something else
        """
        data = read_yaml(path)
        unknown = [name for name in data if name not in cls.__dataclass_fields__]
        if unknown:
            raise unknown_name("entry", unknown[0], cls.__dataclass_fields__)
        data["methods"] = [_choice(each) for each in data.get("methods", [])]
        try:
            return cls(**data)
        except TypeError as error:
            raise DesignError(f"{path} does not describe a design: {error}") from error

    def variants(self) -> list[Variant]:
        """
        :return: all that is compared, environment by environment
        """
        learners = itertools.product(
            self.environments, self.algorithms, (_choice(each) for each in self.methods), grid(self.settings)
        )
        return [
            Variant(
                self._label(algorithm, choice, parameters, settings),
                Learner(place, algorithm, choice.name, parameters, settings),
            )
            for place, algorithm, choice, settings in learners
            for parameters in grid(choice.parameters)
        ]

    def _label(self, algorithm: str, choice: Choice, parameters: dict[str, Any], settings: dict[str, Any]) -> str:
        swept = [(parameters, name) for name, value in choice.parameters.items() if isinstance(value, list)]
        swept += [(settings, name) for name, value in self.settings.items() if isinstance(value, list)]
        parts = [choice.label or method_label(choice.name), *(f"{name} = {values[name]}" for values, name in swept)]
        return ", ".join([*parts, algorithm] if len(self.algorithms) > 1 else parts)

    def cells(self) -> list[Cell]:
        """
        :return: a cell for every run
        """
        return [self._cell(variant, run) for variant in self.variants() for run in range(self.runs)]

    def _cell(self, variant: Variant, run: int) -> Cell:
        learner = variant.learner
        recipe: dict[str, Any] = {"learner": learner._asdict(), "steps": self.steps, "run": run}
        recipe["seed"] = derived_seed(self.seed, recipe)
        recipe["sources"] = source_digests(learner.names())
        labels = {"system": learner.environment, "method": variant.label, "run": run}
        return Cell(EPISODES, recipe, learner.names(), labels)


def derived_seed(seed: int, recipe: Mapping[str, Any]) -> int:
    """
    :param seed: of a whole experiment
    :param recipe: of a run
    :return: a seed of the run's own, which depends on nothing else: runs that differ in anything are independent
    """
    text = json.dumps([seed, recipe], sort_keys=True)
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "little")


def grid(values: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """
    :param values: by name; a list stands for each of its values
    :return: all combinations
    """
    lists = [value if isinstance(value, list) else [value] for value in values.values()]
    for combination in itertools.product(*lists):
        yield dict(zip(values, combination, strict=True))


def parse_sweep(text: str) -> tuple[str, list[Any]]:
    """
    :param text: ``name=value,value,...``
    :return: the name and the values, read as YAML
    :raises DesignError: if it is something else, or repeats a value
    """
    name, equals, values = text.partition("=")
    if not (name and equals and values):
        raise DesignError(f"A sweep is name=value,value,... such as beta_1=0.005,0.01, but got {text!r}.")
    parsed = [_number_or_text(value) for value in values.split(",")]
    check_selection(f"the sweep of {name}", [float(value) if type(value) is int else value for value in parsed])
    return name.replace("-", "_"), parsed


def read_yaml(path: Path) -> dict[str, Any]:
    """
    :param path: a YAML file
    :return: what it holds by name
    :raises DesignError: if it cannot be read, or holds something else
    """
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise DesignError(f"Cannot read {path}: {' '.join(str(error).split())}.") from error
    if not isinstance(data, dict):
        raise DesignError(f"{path} must hold settings, one `name: value` a line.")
    return data


def check_selection(name: str, values: Sequence[Any]) -> None:
    """
    :param name: what the values are
    :param values: what was chosen
    :raises DesignError: if nothing was chosen, or something twice
    """
    if isinstance(values, str) or not values:
        raise DesignError(f"{name} must be a list with at least one entry, but is {values!r}.")
    repeated = [value for value, count in Counter(map(str, values)).items() if count > 1]
    if repeated:
        raise DesignError(f"{name} must not repeat an entry, but has {repeated[0]} twice.")


def check_options(options: Any, checks: Mapping[str, Check]) -> None:
    """
    Check the fields of a dataclass, and make plain types of them.

    :param options: an instance
    :param checks: what a field has to be, by its name
    :raises DesignError: if one is something else
    """
    for name in (each.name for each in fields(options) if each.name in checks):
        try:
            object.__setattr__(options, name, checks[name].apply(name, getattr(options, name)))  # it is frozen for its users
        except ValueError as error:
            raise DesignError(str(error)) from error


def check_environments(names: Sequence[str]) -> None:
    """
    :param names: of environments
    :raises DesignError: if there is no such environment
    """
    for name in names:
        reused_vec_env(name)


def _choice(entry: Any) -> Choice:
    if isinstance(entry, Choice):
        return entry
    if isinstance(entry, Mapping):
        parameters = dict(entry)
        return Choice(str(parameters.pop("name", "")), parameters)
    return Choice(str(entry))


def _check_no_run_twice(variants: list[Variant]) -> None:
    seen: set[str] = set()
    for label, learner in variants:
        text = json.dumps(learner, sort_keys=True)
        if text in seen:
            raise DesignError(f"The design names the same runs twice: {label} in {learner.environment}.")
        seen.add(text)


def _number_or_text(text: str) -> Any:
    try:
        return float(text) if not text.lstrip("+-").isdecimal() else int(text)
    except ValueError:
        return text
