"""What the paper's study holds fixed and what it compares: the paper's settings, and those that a user changes."""

import inspect
import itertools
import json
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple

import tyro
from stable_baselines3.common.base_class import BaseAlgorithm

from sb3_adaptive_q import METHODS
from sb3_adaptive_q.checks import STUDY
from sb3_adaptive_q.experiments.design import Choice, Design, check_options, check_selection, grid, parse_sweep
from sb3_adaptive_q.experiments.errors import DesignError, unknown_name
from sb3_adaptive_q.experiments.names import algorithm_class, method_label, method_parameters

#: The paper's systems, by the ids of the environments
FROZEN_LAKE, CART_POLE = "FrozenLake-v1", "CartPoleFriction-v0"


class PaperSystem(NamedTuple):
    """
    What the paper has on a system.

    :param title: its name there
    :param results_table: the number of the table of its results
    :param q_table: the number of the table of its Q values
    :param first_figure: the number of the first of its four figures
    :param limit: the largest return of an episode
    :param best_method: the method that it calls the best
    """

    title: str
    results_table: int
    q_table: int
    first_figure: int
    limit: float
    best_method: str


PAPER_SYSTEMS = {
    FROZEN_LAKE: PaperSystem("Frozen Lake", 7, 1, 6, 1.0, "Method 1"),
    CART_POLE: PaperSystem("Cart Pole", 8, 6, 10, 200.0, "Method 7"),
}
#: Labels of the paper's methods
PAPER_METHODS = [method_label(str(number)) for number in METHODS]

#: Readings of Eqs. 7-11. ``literal`` is what the equations say. ``table8`` was fitted: of several hundred readings it
#: comes closest to the paper's Table 8, and it contradicts Table 7.
PRESETS = MappingProxyType(
    {
        "literal": "Equations 7 to 11 as they stand: μ starts from β1 and is never reset",
        "table8": "the reading that comes closest to the paper's Table 8, chosen by fitting, so not evidence for it: Methods "
        "5 to 8 see max Q(s', ·), and μ starts every episode from β7",
    }
)
#: What only selects among the runs, and may grow from one start of a study to the next
SELECTION = ("systems", "algorithms", "methods", "runs", "sweep")
#: Arguments of the algorithms that are not compared: what they mean here is set in other ways, or decides nothing
NOT_SWEPT = frozenset(
    "policy env seed device verbose tensorboard_log stats_window_size policy_kwargs method method_kwargs learning_rate "
    "total_episodes callback_interval _init_setup_model args kwargs".split()
)
#: Settings that are arguments of the algorithm, and those that shape the paper's methods
OF_ALGORITHM = ("gamma", "exploration_fraction", "exploration_initial_eps", "exploration_final_eps")
OF_METHODS = ("beta_1", "beta_2", "beta_3", "beta_5", "beta_6", "beta_7", "beta_8", "preset", "next_action")


@dataclass(frozen=True, kw_only=True)
class StudySettings:
    """
    What is run, and what is compared.

    :param systems: environments: ids, or module:name of a function that makes one
    :param methods: methods that set the learning rate: 1 to 8, names, or module:name of a class
    :param algorithms: algorithms: names, or module:name of a class
    :param runs: independent runs of each method
    :param episodes: episodes of a run
    :param seed: seed of the whole study; the seed of every run follows from it
    :param sweep: name=value,value,... runs the study once for every value. The name is one of these settings, an argument of
        the algorithm or a parameter of a method. Can be given several times
    :param gamma: discount factor γ
    :param exploration_fraction: fraction of the episodes in which ε falls
    :param exploration_initial_eps: ε at the start
    :param exploration_final_eps: ε at the end
    :param beta_1: μ of Method 1, smallest μ of Methods 3 and 4, and first μ of Methods 5 to 8
    :param beta_2: μ of Method 2
    :param beta_3: the difference between the largest and the smallest μ of Methods 3 and 4
    :param beta_5: factor of the change of value in Methods 5 and 6
    :param beta_6: change of μ at every update in Methods 7 and 8
    :param beta_7: smallest μ of Methods 5 to 8
    :param beta_8: largest μ of Methods 5 to 8
    :param preset: literal reads Equations 7 to 11 as they stand; table8 is the reading that comes closest to the paper's Table
        8, chosen by fitting, so not evidence for it
    :param next_action: the action whose value in the next state Methods 5 to 8 look at: same (the action just taken),
        next (the one taken next) or max (the best one); default: the preset's
    :raises DesignError: if one of these is out of range
    """

    systems: Annotated[tuple[str, ...], tyro.conf.arg(aliases=["--env"])] = (FROZEN_LAKE, CART_POLE)
    methods: Annotated[tuple[str, ...], tyro.conf.arg(aliases=["--method"])] = tuple(map(str, METHODS))
    algorithms: Annotated[tuple[str, ...], tyro.conf.arg(aliases=["--algorithm"])] = ("tabular_q",)
    runs: int = 20
    episodes: int = 30_000
    seed: int = 0
    sweep: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
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
        for name in ("systems", "methods", "algorithms"):
            check_selection(name, getattr(self, name))
        check_options(self, STUDY)
        if self.preset not in PRESETS:
            raise unknown_name("preset", self.preset, PRESETS)
        if self.beta_7 > self.beta_8:
            raise DesignError(f"beta_7 must not be above beta_8, but they are {self.beta_7} and {self.beta_8}.")

    def as_data(self) -> dict[str, Any]:
        """
        :return: the settings as plain data, for YAML
        """
        return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}

    def design(self) -> Design:
        """
        :return: the design of the runs
        :raises DesignError: if it names something unknown, or something is out of range
        """
        swept = dict(map(parse_sweep, self.sweep))
        if len(swept) < len(self.sweep):
            raise DesignError("--sweep names a setting twice: give all its values in one --sweep.")
        settings = {name: swept.pop(name, getattr(self, name)) for name in OF_ALGORITHM}
        settings["total_episodes"] = swept.pop("episodes", self.episodes)
        settings["ties"] = swept.pop("ties", "first")
        of_methods = {name: swept.pop(name) for name in OF_METHODS if name in swept}
        taken, parameters = self._parameters(swept)
        settings |= {name: values for name, values in swept.items() if name not in taken}
        choices = [
            choice._replace(parameters={**choice.parameters, **parameters[method]})
            for method in self.methods
            for choice in self._choices(method, of_methods)
        ]
        return Design(
            environments=self.systems,
            methods=choices,
            algorithms=self.algorithms,
            settings=settings,
            runs=self.runs,
            seed=self.seed,
        )

    def _parameters(self, swept: Mapping[str, list[Any]]) -> tuple[set[str], dict[str, dict[str, list[Any]]]]:
        """Which of the swept names are parameters of methods, and of which methods; the others must be the algorithms'."""
        parameters: dict[str, dict[str, list[Any]]] = {method: {} for method in self.methods}
        known = {name for name in (*OF_ALGORITHM, *OF_METHODS, "episodes")}
        for method in self.methods:
            of_method = method_parameters(method)
            known |= of_method
            parameters[method] = {name: values for name, values in swept.items() if name in of_method}
        taken = {name for of_method in parameters.values() for name in of_method}
        of_algorithms = {name for each in self.algorithms for name in _arguments(algorithm_class(each))} - NOT_SWEPT
        for name in swept:
            if name not in taken | of_algorithms:
                raise unknown_name("sweep", name, sorted(known | of_algorithms))
        return taken, parameters

    def _choices(self, method: str, swept: dict[str, list[Any]]) -> Iterator[Choice]:
        """A method with each of its values among those that are swept; the same parameters only once."""
        matters = {name for name in swept if len({self._kwargs_text(method, {name: value}) for value in swept[name]}) > 1}
        seen = set()
        for values in grid(swept):
            text = self._kwargs_text(method, values)
            if text not in seen:
                seen.add(text)
                parts = [method_label(method), *(f"{name} = {value}" for name, value in values.items() if name in matters)]
                yield Choice(method, json.loads(text), ", ".join(parts))

    def _kwargs_text(self, method: str, values: dict[str, Any]) -> str:
        of_kind: dict[str, Any] = {name: float(value) if isinstance(value, int) else value for name, value in values.items()}
        return json.dumps(replace(self, sweep=(), **of_kind).method_kwargs(method))

    def method_kwargs(self, method: str) -> dict[str, Any]:
        """
        :param method: a method
        :return: its parameters, as far as these settings decide them
        """
        linear, adaptive = {"beta_1": self.beta_1, "beta_3": self.beta_3}, self._adaptive_kwargs()
        kwargs: dict[str, dict[str, Any]] = {
            "1": {"beta": self.beta_1},
            "2": {"beta": self.beta_2},
            "3": linear,
            "4": linear,
            "5": {"gain": -self.beta_5, **adaptive},
            "6": {"gain": self.beta_5, **adaptive},
            "7": {"step": self.beta_6, **adaptive},
            "8": {"step": -self.beta_6, **adaptive},
        }
        return kwargs.get(method, {})

    def _adaptive_kwargs(self) -> dict[str, Any]:
        kwargs: dict[str, Any] = {"mu_0": self.beta_1, "lower": self.beta_7, "upper": self.beta_8}
        next_action = self.next_action
        if self.preset == "table8":
            kwargs |= {"mu_0": self.beta_7, "reset_each_episode": True}
            next_action = next_action or "max"
        return kwargs | ({"next_action": next_action} if next_action else {})


def _arguments(algorithm: type[Any]) -> list[str]:
    """The names of the constructor's arguments, those that it hands on to the classes above it too."""
    own = itertools.takewhile(lambda each: each is not BaseAlgorithm, algorithm.__mro__)
    return [name for each in own if "__init__" in vars(each) for name in inspect.signature(each).parameters]


def title_of(system: str) -> str:
    """
    :param system: the name of an environment
    :return: what to call it in a heading
    """
    return PAPER_SYSTEMS[system].title if system in PAPER_SYSTEMS else system
