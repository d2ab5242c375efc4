"""What a league compares: the rules, environments and tracks of ``league.yml``, and those that a user chooses or adds."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from importlib.resources import files
from typing import Annotated, Any, NamedTuple

import gymnasium as gym
import tyro
import yaml

from sb3_adaptive_q import ALGORITHMS
from sb3_adaptive_q.checks import LEAGUE
from sb3_adaptive_q.envs.catalogue import PROBLEMS
from sb3_adaptive_q.envs.tabular_model import changing_wrapper
from sb3_adaptive_q.experiments.design import check_options, check_selection, grid, parse_sweep
from sb3_adaptive_q.experiments.environments import make_env
from sb3_adaptive_q.experiments.errors import DesignError, unknown_name
from sb3_adaptive_q.experiments.names import (
    algorithm_class,
    is_import_path,
    make_method,
    method_label,
    method_names,
    method_parameters,
)

MEASURES = "sb3_adaptive_q.experiments.league.measures:measure_"
TRACKS = ("A", "B", "C", "algorithms")
#: Bootstrap samples of an interval
RESAMPLES = 50_000
#: What only selects among the cells, and may differ from one start of a league to the next
SELECTION = ("tracks", "methods", "environments", "algorithm", "runs", "tuning_runs", "sweep", "scale", "resamples")
GYMNASIUM_ID = "An id that gymnasium knows or `module:name` will do too."
#: The kind of an environment that the league does not know
OWN_KIND = "your own"


class Task(NamedTuple):
    """
    An environment, and how it is learned.

    :param name: what it is called
    :param environment: its id or name, or ``module:name``
    :param kind: what is difficult in it
    :param steps: of a run
    :param gamma: the discount factor
    :param initial_q: of all entries of the table
    :param arguments: for the environment
    :param instances: how many there are, each a task of its own; 0 for one without a number
    :param scale: the returns of the uniform and of the best policy, where there is no transition table
    """

    name: str
    environment: str
    kind: str
    steps: int
    gamma: float
    initial_q: float = 0.0
    arguments: Mapping[str, Any] = {}
    instances: int = 0
    scale: tuple[float, float] | None = None


class Contestant(NamedTuple):
    """
    A rule, with the settings that it may be tuned over.

    :param label: what it is called
    :param algorithm: the algorithm whose step size it sets
    :param method: a number, a name or ``module:name``
    :param settings: its parameters by name, the publication's first
    """

    label: str
    algorithm: str
    method: str
    settings: tuple[dict[str, Any], ...]


class Track(NamedTuple):
    """
    :param name: ``A``, ``B``, ``C`` or ``algorithms``
    :param measure: the ``module:name`` of the function that runs a cell
    :param behaviour: settings of the algorithm that decide what is done
    :param tasks: the environments
    :param contestants: the rules
    """

    name: str
    measure: str
    behaviour: Mapping[str, Any]
    tasks: tuple[Task, ...]
    contestants: tuple[Contestant, ...]


@cache
def league_data() -> dict[str, Any]:
    """
    :return: what ``league.yml`` holds
    """
    text = (files("sb3_adaptive_q.experiments.league") / "league.yml").read_text(encoding="utf-8")
    return dict(yaml.safe_load(text))


@dataclass(frozen=True, kw_only=True)
class LeagueSettings:
    """
    What is compared. Without options: every rule (a method that sets the step size) in every environment, on all tracks.

    :param tracks: A is estimation, B control, C prediction; algorithms repeats B for other algorithms with four rules;
        default: all of them, or B alone with --quick
    :param methods: rules to compare: numbers, names, or module:name of a class; constant and polynomial always take part
    :param environments: environments of tracks A and B: names, ids, or module:name of a function that makes one
    :param algorithm: algorithm of tracks A, B and C: a name, or module:name of a class
    :param runs: evaluation runs of every rule in every environment
    :param tuning_runs: tuning runs of every setting of a rule, from which its best setting is chosen
    :param quick: a first look: four settings of each rule, 5 tuning runs, 20 evaluation runs, a tenth of the steps and 5
        checkpoints; too little for pictures of scores against parameters
    :param sweep: name=value,value,... sets the values to tune over for a parameter of a rule of your own; can be given several
        times
    :param scale: environment=low,high sets the mean returns of the uniform policy and of a good policy. An environment without
        a transition table needs them, because its policies are judged by rollouts; can be given several times
    :param steps: steps of a run in an environment that the league does not know
    :param gamma: discount factor in an environment that the league does not know
    :param resamples: bootstrap samples for every interval
    :raises DesignError: if one of these is out of range
    """

    tracks: tuple[str, ...] | None = None
    methods: Annotated[tuple[str, ...], tyro.conf.arg(aliases=["--method"])] = tuple(league_data()["grids"])
    environments: Annotated[tuple[str, ...], tyro.conf.arg(aliases=["--env"])] = tuple(league_data()["environments"])
    algorithm: str = "tabular_q"
    runs: int = league_data()["evaluation"]["runs"]
    tuning_runs: int = league_data()["tuning"]["runs"]
    quick: bool = False
    sweep: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    scale: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    steps: int = 200_000
    gamma: float = 0.99
    resamples: int = RESAMPLES

    def __post_init__(self) -> None:
        for name, values in (("tracks", self.names_of_tracks), ("methods", self.methods), ("environments", self.environments)):
            check_selection(name, values)
        check_options(self, LEAGUE)
        for name in self.names_of_tracks:
            if name not in TRACKS:
                raise unknown_name("track", name, TRACKS)
        for name in self._scales():
            if name not in self.environments:
                raise unknown_name("environment of a scale", name, self.environments)
        for text in self.sweep:
            parse_sweep(text)

    @property
    def names_of_tracks(self) -> Sequence[str]:
        """The tracks that are played."""
        if self.tracks is not None:
            return self.tracks
        return tuple(league_data()["quick"]["tracks"]) if self.quick else TRACKS

    @property
    def checkpoints(self) -> int:
        """How often a table is judged in the course of a run, at equal distances."""
        data = league_data()
        return int(data["quick"]["checkpoints"] if self.quick else data["checkpoints"])

    def as_data(self) -> dict[str, Any]:
        """
        :return: the settings as plain data, for YAML
        """
        return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}

    @property
    def bootstrap_samples(self) -> int:
        """The bootstrap samples of every interval: few in a quick look."""
        return min(self.resamples, league_data()["quick"]["resamples"]) if self.quick else self.resamples

    def seeds(self, phase: str) -> list[list[int]]:
        """
        :param phase: ``"tuning"`` or ``"evaluation"``
        :return: the seeds, in groups that are run and stored together
        """
        data = league_data()
        runs = self.tuning_runs if phase == "tuning" else self.runs
        if self.quick:
            runs = min(runs, data["quick"]["tuning_runs" if phase == "tuning" else "runs"])
        seeds = range(data[phase]["first"], data[phase]["first"] + runs)
        together = data["runs_together"]
        return [list(seeds[i : i + together]) for i in range(0, runs, together)]

    def chosen_tracks(self) -> list[Track]:
        """
        :return: the tracks with their tasks and contestants
        :raises DesignError: if a name is unknown, or an environment cannot be judged
        """
        data = league_data()
        self._check_sweeps()
        tasks = [self._task(name) for name in self.environments]
        rules = tuple(self._contestant(name) for name in dict.fromkeys((*data["references"], *self.methods)))
        still = tuple(task for task in tasks if self._check_judged(task))
        predictions = tuple(self._known_task(name, each) for name, each in data["predictions"].items())
        tracks = {
            "A": Track("A", f"{MEASURES}estimation", data["uniform"], still, rules),
            "B": Track("B", f"{MEASURES}control", data["control"], tuple(tasks), rules),
            "C": Track("C", f"{MEASURES}prediction", data["uniform"], predictions, rules),
            "algorithms": Track("algorithms", f"{MEASURES}control", data["control"], tuple(tasks), self._of_algorithms()),
        }
        return [tracks[name] for name in TRACKS if name in self.names_of_tracks and tracks[name].tasks]

    def _task(self, name: str) -> Task:
        data = league_data()
        known = data["environments"].get(name) or data["more_environments"].get(name)
        if known:
            return self._known_task(name, known)
        if not is_import_path(name) and name not in gym.registry:
            raise unknown_name("environment", name, [*data["environments"], *data["more_environments"]], GYMNASIUM_ID)
        return Task(name, name, OWN_KIND, self._budget(self.steps), self.gamma, scale=self._scales().get(name))

    def _known_task(self, name: str, known: Mapping[str, Any]) -> Task:
        problem = PROBLEMS.get(name)
        return Task(
            name,
            known.get("id", name),
            known["kind"],
            self._budget(known["steps"]),
            problem.gamma if problem else 0.99,
            problem.initial_q if problem else 0.0,
            known.get("arguments", {}),
            known.get("instances", 0),
            known.get("scale"),
        )

    def _budget(self, steps: int) -> int:
        return steps // league_data()["quick"]["steps_divided_by"] if self.quick else steps

    def _check_sweeps(self) -> None:
        own = [method for method in self.methods if method not in league_data()["grids"]]
        taken = sorted(set().union(*map(method_parameters, own)))
        _check_once("sweep", [name for name, _ in map(parse_sweep, self.sweep)])
        for name, _ in map(parse_sweep, self.sweep):
            if name not in taken:
                raise DesignError(
                    f"The sweep of {name} would change nothing: the rules of the league have grids of their own, and "
                    f"{'your rules take ' + ', '.join(taken) if taken else 'no other rule is among the methods'}."
                )

    def _scales(self) -> dict[str, tuple[float, float]]:
        scales: dict[str, tuple[float, float]] = {}
        for text in self.scale:
            name, _, ends = text.rpartition("=")
            try:
                low, high = map(float, ends.split(","))
            except ValueError as error:
                raise DesignError(f"A scale is environment=low,high such as taxi=-770,8, but got {text!r}.") from error
            if not (name and low < high):
                raise DesignError(f"A scale is environment=low,high with low below high, but got {text!r}.")
            _check_once("scale", [*scales, name])
            scales[name] = (low, high)
        return scales

    def _check_judged(self, task: Task) -> bool:
        """Whether the values of a task are known for all time; an error if even its policies cannot be judged."""
        wrapped = make_env(task.environment, **task.arguments)
        if task.steps < self.checkpoints:
            raise DesignError(
                f"A run of {task.steps} steps is too short for {self.checkpoints} checkpoints: please give more --steps"
                f"{', of which --quick takes a tenth' if self.quick else ''}."
            )
        env: Any = wrapped.unwrapped
        wrapper = changing_wrapper(wrapped)
        has_table = hasattr(env, "P") and hasattr(env, "initial_state_distrib") and wrapper is None
        if wrapper is not None and (hasattr(env, "P") or hasattr(env, "table_at")) and not task.scale:
            raise DesignError(
                f"The best policy of {task.name} is not known: {type(wrapper).__name__} may change actions, rewards or "
                "observations, so its transition table may not be what an agent learns from. Leave the wrapper out, or let "
                f"policies be judged by rollouts: --scale {task.name}=LOW,HIGH, the mean returns of the uniform and of a good "
                "one."
            )
        if not (has_table or hasattr(env, "table_at") or task.scale):
            raise DesignError(
                f"The best policy of {task.name} is not known: it has no transition table, which would be `P[state][action]`, "
                "a list of (probability, next state, reward, terminated), and `initial_state_distrib`. Policies can be judged "
                f"by rollouts instead: give --scale {task.name}=LOW,HIGH, the mean returns of the uniform and of a good one."
            )
        return has_table

    def _contestant(self, method: str, algorithm: str | None = None) -> Contestant:
        algorithm = algorithm or self.algorithm
        algorithm_class(algorithm)
        settings = list(grid(self._grid(method)))
        if self.quick:
            settings = settings[: league_data()["quick"]["settings"]]
        for each in settings:
            make_method(method, each)
        label = method_label(method)
        if algorithm != "tabular_q":
            label += f" ({algorithm.rpartition(':')[2]})"
        return Contestant(label, algorithm, method, tuple(settings))

    def _grid(self, method: str) -> Mapping[str, Any]:
        known = league_data()["grids"].get(method)
        if known is None and not is_import_path(method) and method not in method_names():
            raise unknown_name("method", method, method_names(), "One of your own is given as `module:name`.")
        takes = method_parameters(method)
        swept = dict(map(parse_sweep, self.sweep))
        if known is not None:
            return dict(known)
        return {name: values for name, values in swept.items() if name in takes}

    def _of_algorithms(self) -> tuple[Contestant, ...]:
        names: Sequence[str] = league_data()["algorithms"]["names"]
        methods: Sequence[str] = league_data()["algorithms"]["methods"]
        return tuple(self._contestant(method, name) for name in names if name in ALGORITHMS for method in methods)


def _check_once(option: str, names: Sequence[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise DesignError(f"--{option} {name}=... is given more than once: please give it once, with all values.")
