"""The runs of a study in TensorBoard, for its HPARAMS page to compare."""

import os
import shutil
from collections.abc import Sequence
from pathlib import Path

from stable_baselines3.common.logger import HParam, Logger, TensorBoardOutputFormat

from sb3_adaptive_q.experiments.cells import Cell
from sb3_adaptive_q.experiments.errors import ExperimentError
from sb3_adaptive_q.experiments.paper.results import trailing_mean
from sb3_adaptive_q.experiments.storage import ResultFolder
from sb3_adaptive_q.experiments.text import file_name

#: Points of a curve
POINTS = 100
#: What the HPARAMS page shows of a run beside its parameters
METRICS = ("rollout/ep_rew_mean", "train/learning_rate")


def write_tensorboard(folder: ResultFolder, cells: Sequence[Cell], directory: Path) -> None:
    """
    Write every run; those that are there already are left alone.

    :param folder: where the cells are
    :param cells: those to write
    :param directory: where TensorBoard is to look
    :raises ExperimentError: if it cannot be written
    """
    for cell in cells:
        system, method, run = (file_name(str(cell.labels[name])) for name in ("system", "method", "run"))
        target = directory / system / method / f"run-{int(run):05d}-{cell.key[:8]}"
        if target.exists():
            continue
        temporary = target.with_name(f".{target.name}.{os.getpid()}.tmp")
        try:
            _write_run(folder, cell, temporary)
            os.replace(temporary, target)
        except OSError as error:
            raise ExperimentError(f"Cannot write {target}: {error.strerror or error}.") from error
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


def _write_run(folder: ResultFolder, cell: Cell, directory: Path) -> None:
    data = {name: values[0] for name, values in folder.read(cell, ("returns", "lengths", "mu", "epsilon")).items()}
    means, steps = trailing_mean(data["returns"]), data["lengths"].cumsum()
    logger = Logger(str(directory), [TensorBoardOutputFormat(str(directory))])
    learner = cell.recipe["learner"]
    parameters = {**cell.labels, "seed": cell.recipe["seed"], **learner["settings"], **learner["parameters"]}
    logger.record("hparams", HParam(parameters, dict.fromkeys(METRICS, 0.0)))
    episodes = len(means)
    stride = max(1, episodes // POINTS)
    for episode in range((episodes - 1) % stride, episodes, stride):
        logger.record("rollout/ep_rew_mean", means[episode])
        logger.record("rollout/exploration_rate", data["epsilon"][episode])
        logger.record("train/learning_rate", data["mu"][episode])
        logger.dump(int(steps[episode]))
    logger.close()
