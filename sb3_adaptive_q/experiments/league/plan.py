"""The cells of a league, and the choice of a setting for each rule: from the tuning runs alone."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from sb3_adaptive_q.experiments.cells import Cell
from sb3_adaptive_q.experiments.league.settings import Contestant, LeagueSettings, Task, Track, league_data
from sb3_adaptive_q.experiments.learners import Learner
from sb3_adaptive_q.experiments.names import source_digests
from sb3_adaptive_q.experiments.storage import ResultFolder

#: How a setting is chosen for a rule in an environment
CHOICES = ("one for all", "default", "per environment")
#: Scores are clipped to this range where they are averaged over environments: disasters have no bound
CLIP = (-0.5, 1.0)
#: Scores of prediction, the error of the best constant step size over that of the rule, may exceed 1
CLIP_PREDICTION = (0.0, 2.0)


class Runs(NamedTuple):
    """
    The runs of a rule with one setting in one environment.

    :param scores: at the checkpoints, of shape (runs, checkpoints)
    :param online: what was collected while learning, of shape (runs,)
    :param failures: why the runs failed that did
    """

    scores: np.ndarray
    online: np.ndarray
    failures: list[str]


def cells_of(settings: LeagueSettings, track: Track, place: tuple[int, int, int], phase: str) -> list[Cell]:
    """
    :param settings: of the league
    :param track: one of its tracks
    :param place: the index of a contestant, of one of its settings, and of a task
    :param phase: ``"tuning"`` or ``"evaluation"``
    :return: the cells that run it
    """
    rule, setting, task = track.contestants[place[0]], place[1], track.tasks[place[2]]
    learner = _learner(track, rule, rule.settings[setting], task)
    return [_cell(settings, track, (rule, task), learner, seeds) for seeds in settings.seeds(phase)]


def _learner(track: Track, rule: Contestant, parameters: dict[str, Any], task: Task) -> Learner:
    behaviour = {**track.behaviour, "gamma": task.gamma, "initial_q": task.initial_q}
    return Learner(task.environment, rule.algorithm, rule.method, parameters, behaviour)


def _cell(settings: LeagueSettings, track: Track, who: tuple[Contestant, Task], learner: Learner, seeds: list[int]) -> Cell:
    rule, task = who
    recipe = {
        "league": league_data()["version"],
        "learner": learner._asdict(),
        "arguments": dict(task.arguments),
        "instances": task.instances,
        "scale": task.scale,
        "steps": task.steps,
        "checkpoints": settings.checkpoints,
        "seeds": seeds,
        "sources": source_digests(learner.names()),
    }
    labels = {"environment": task.name, "rule": rule.label, "setting": _setting_text(learner.parameters)}
    return Cell(track.measure, recipe, learner.names(), labels, cost=task.steps * len(seeds))


def _setting_text(parameters: dict[str, Any]) -> str:
    return ", ".join(f"{name} = {value:g}" for name, value in parameters.items())


def setting_text(rule: Contestant, setting: int) -> str:
    """
    :param rule: a contestant
    :param setting: the index of one of its settings
    :return: its parameters in words, those that are the same in all settings left out
    """
    free = {
        name: value
        for name, value in rule.settings[setting].items()
        if len({str(other.get(name)) for other in rule.settings}) > 1
    }
    return _setting_text(free) or "as published"


def all_places(track: Track) -> Iterator[tuple[int, int, int]]:
    """
    :param track: a track
    :return: contestant, setting and task of everything that is tuned
    """
    for i, rule in enumerate(track.contestants):
        for j in range(len(rule.settings)):
            for k in range(len(track.tasks)):
                yield i, j, k


def read_runs(folder: ResultFolder, cells: Sequence[Cell], failures: dict[str, str]) -> Runs:
    """
    :param folder: of the league
    :param cells: the cells of one rule with one setting in one environment
    :param failures: why cells could not be run at all, by their keys
    :return: their runs; those of a cell that could not be run count as failed from the start
    """
    parts = []
    for cell in cells:
        if cell.key in failures:
            runs, nothing = len(cell.recipe["seeds"]), np.inf if cell.measure.endswith("prediction") else 0.0
            scores = np.full((runs, cell.recipe["checkpoints"]), nothing)
            parts.append(Runs(scores, np.zeros(runs), [failures[cell.key]] * runs))
            continue
        data = folder.read(cell, ("scores", "online", "failure"))
        reasons = [reason for reason in data["failure"] if reason]
        parts.append(Runs(np.stack(data["scores"]), np.array(data["online"], float), reasons))
    return Runs(
        np.concatenate([part.scores for part in parts]),
        np.concatenate([part.online for part in parts]),
        [reason for part in parts for reason in part.failures],
    )


def tuning_scores(track: Track, runs: Mapping[tuple[int, int, int], Runs]) -> list[np.ndarray]:
    """
    :param track: a track
    :param runs: of the tuning, by contestant, setting and task
    :return: for each contestant the mean anytime score of each setting in each task, of shape (settings, tasks)
    """
    scale = prediction_scale(track, runs) if track.name == "C" else None
    means = [np.zeros((len(rule.settings), len(track.tasks))) for rule in track.contestants]
    for i, j, k in all_places(track):
        means[i][j, k] = anytime(track, runs[i, j, k], scale[k] if scale is not None else 1.0).mean()
    return means


def anytime(track: Track, runs: Runs, scale: float) -> np.ndarray:
    """
    :param track: a track
    :param runs: of it
    :param scale: in prediction, the error of the best constant step size
    :return: the mean score over the checkpoints, clipped, of shape (runs,)
    """
    if track.name == "C":
        return np.clip(scale / np.maximum(runs.scores.mean(axis=1), 1e-300), *CLIP_PREDICTION)
    return np.clip(runs.scores.mean(axis=1), *CLIP)


def prediction_scale(track: Track, runs: Mapping[tuple[int, int, int], Runs]) -> list[float]:
    """
    :param track: of predictions
    :param runs: by contestant, setting and task; those of the constant step size with every setting
    :return: for each task the least mean error of a constant step size
    """
    errors = [np.inf] * len(track.tasks)
    for (i, _, k), each in runs.items():
        if track.contestants[i].method == "constant":
            errors[k] = min(errors[k], float(each.scores.mean()))
    return errors


def choose(means: np.ndarray, task: int, choice: str) -> int:
    """
    Choose a setting of a rule for an environment.

    :param means: tuning scores of the rule, of shape (settings, tasks)
    :param task: the index of the environment
    :param choice: one of ``CHOICES``; one setting for all environments is chosen on all but this one
    :return: the index of the setting
    """
    if choice == "default":
        return 0
    if choice == "per environment" or means.shape[1] == 1:
        return int(means[:, task].argmax())
    return int(np.delete(means, task, axis=1).mean(axis=1).argmax())
