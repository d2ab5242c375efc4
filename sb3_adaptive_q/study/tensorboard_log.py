"""The cells of a study as runs in TensorBoard, for its HParams page to compare."""

import os
import shutil
from pathlib import Path

from stable_baselines3.common.logger import HParam, Logger, TensorBoardOutputFormat

from sb3_adaptive_q.study.cells import Cell, cells_of, digest_of, recipe_of
from sb3_adaptive_q.study.errors import StudyError
from sb3_adaptive_q.study.results import trailing_mean
from sb3_adaptive_q.study.storage import StudyFolder
from sb3_adaptive_q.study.systems import file_name

#: Points of a curve
POINTS = 100
#: What the HParams page shows of a run beside its parameters
METRICS = ("rollout/ep_rew_mean", "train/learning_rate")


def write_tensorboard(folder: StudyFolder, directory: Path) -> None:
    """
    Write every cell as a run; those that are there already are left alone.

    :param folder: a study whose cells are all there
    :param directory: where TensorBoard is to look
    :raises StudyError: if it cannot be written
    """
    for cell in cells_of(folder.settings):
        recipe = recipe_of(folder.settings, cell)
        target = directory / file_name(cell.system) / f"method-{cell.method}" / f"run-{cell.run:05d}-{digest_of(recipe)[:8]}"
        if target.exists():
            continue
        temporary = target.with_name(f".{target.name}.{os.getpid()}.tmp")
        try:
            _write_run(folder, cell, temporary)
            os.replace(temporary, target)
        except OSError as error:
            raise StudyError(f"Cannot write {target}: {error.strerror or error}.") from error
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


def _write_run(folder: StudyFolder, cell: Cell, directory: Path) -> None:
    data = folder.read(cell, ("returns", "lengths", "mu", "epsilon"))
    means = trailing_mean(data["returns"])
    steps = data["lengths"].cumsum()
    logger = Logger(str(directory), [TensorBoardOutputFormat(str(directory))])
    logger.record("hparams", HParam(_parameters(folder, cell), dict.fromkeys(METRICS, 0.0)))
    episodes = len(means)
    stride = max(1, episodes // POINTS)
    for episode in range((episodes - 1) % stride, episodes, stride):
        logger.record("rollout/ep_rew_mean", means[episode])
        logger.record("rollout/exploration_rate", data["epsilon"][episode])
        logger.record("train/learning_rate", data["mu"][episode])
        logger.dump(int(steps[episode]))
    logger.close()


def _parameters(folder: StudyFolder, cell: Cell) -> dict[str, bool | str | float | None]:
    recipe = recipe_of(folder.settings, cell)
    names = ("system", "method", "seed", "gamma", "episodes")
    return {**{name: recipe[name] for name in names}, **recipe["method_kwargs"], "preset": folder.settings.preset}
