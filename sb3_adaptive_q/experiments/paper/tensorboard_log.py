"""The runs of a study in TensorBoard, for its HPARAMS page to compare."""

import os
import shutil
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from stable_baselines3.common.logger import Logger, TensorBoardOutputFormat

from sb3_adaptive_q.experiments.cells import Cell
from sb3_adaptive_q.experiments.errors import ExperimentError
from sb3_adaptive_q.experiments.learners import Learner
from sb3_adaptive_q.experiments.paper.results import trailing_mean
from sb3_adaptive_q.experiments.storage import ResultFolder
from sb3_adaptive_q.experiments.text import file_name
from sb3_adaptive_q.hyperparameters import hyperparameters, write_hyperparameters

#: Points of a curve
POINTS = 100


class Curves(NamedTuple):
    """
    What is drawn of a run, or of the mean of several, episode by episode. All are of shape (episodes,).

    :param steps: environment steps taken so far
    :param returns: mean return of the last 100 episodes
    :param mu: μ at the episode's end
    :param epsilon: the exploration rate at the episode's end
    """

    steps: np.ndarray
    returns: np.ndarray
    mu: np.ndarray
    epsilon: np.ndarray


def write_tensorboard(folder: ResultFolder, cells: Sequence[Cell], directory: Path, every_run: bool = False) -> None:
    """
    Write one run for each method: the mean over its runs, episode by episode. Or write every run by itself; those that are
    there already are then left alone.

    :param folder: where the cells are
    :param cells: those to write
    :param directory: where TensorBoard is to look
    :param every_run: whether to write every run
    :raises ExperimentError: if it cannot be written
    """
    groups: dict[Path, list[Cell]] = {}
    for cell in cells:
        system, method, run = (file_name(str(cell.labels[name])) for name in ("system", "method", "run"))
        name = f"run-{int(run):05d}-{cell.key[:8]}" if every_run else "mean"
        groups.setdefault(directory / system / method / name, []).append(cell)
    for target, group in groups.items():
        if not (every_run and target.exists()):
            _write(folder, group, target)


def _write(folder: ResultFolder, cells: Sequence[Cell], target: Path) -> None:
    temporary = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    try:
        _write_run(_mean([_curves(folder, cell) for cell in cells]), _hyperparameters(cells), temporary)
        shutil.rmtree(target, ignore_errors=True)
        os.replace(temporary, target)
    except OSError as error:
        raise ExperimentError(f"Cannot write {target}: {error.strerror or error}.") from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _hyperparameters(cells: Sequence[Cell]) -> dict[str, Any]:
    """Of the learner of these cells, under the names that ``learn`` gives them in its own log."""
    recipe = cells[0].recipe
    model, method = Learner(**recipe["learner"]).make(recipe["seed"])
    model.install_method(method.method, restart=True)  # type: ignore[attr-defined]  # of a tabular algorithm
    values: dict[str, Any] = {**hyperparameters(model), "total_episodes": model.total_episodes}  # type: ignore[attr-defined]
    if len(cells) > 1:
        del values["seed"]
        values["runs"] = len(cells)
    return values


def _curves(folder: ResultFolder, cell: Cell) -> Curves:
    data = {name: values[0] for name, values in folder.read(cell, ("returns", "lengths", "mu", "epsilon")).items()}
    return Curves(data["lengths"].cumsum(), trailing_mean(data["returns"]), data["mu"], data["epsilon"])


def _mean(runs: Sequence[Curves]) -> Curves:
    episodes = min(len(run.steps) for run in runs)
    return Curves(*(np.mean([column[:episodes] for column in columns], axis=0) for columns in zip(*runs, strict=True)))


def _write_run(curves: Curves, values: dict[str, Any], directory: Path) -> None:
    output = TensorBoardOutputFormat(str(directory))
    write_hyperparameters(output, values)
    logger = Logger(str(directory), [output])
    for episode in _points(len(curves.steps)):
        logger.record("rollout/ep_rew_mean", curves.returns[episode])
        logger.record("rollout/exploration_rate", curves.epsilon[episode])
        logger.record("train/learning_rate", curves.mu[episode])
        logger.dump(round(curves.steps[episode]))
    logger.close()


def _points(episodes: int) -> Iterable[int]:
    """Equally spaced episodes, the last one among them."""
    stride = max(1, episodes // POINTS)
    return range((episodes - 1) % stride, episodes, stride)
