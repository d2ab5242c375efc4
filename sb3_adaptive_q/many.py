"""Independent learners side by side."""

import os
import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import ClassVar

from stable_baselines3.common.callbacks import BaseCallback

from sb3_adaptive_q.base import TabularAlgorithm
from sb3_adaptive_q.checks import check
from sb3_adaptive_q.vec_env import CompiledVecEnv


def learn_many(
    models: Sequence[TabularAlgorithm],
    total_timesteps: int,
    workers: int | None = None,
    log_interval: int | None = 300,
    reset_num_timesteps: bool = True,
) -> list[TabularAlgorithm]:
    """
    Let models learn at the same time, one thread each: compiled rollouts leave the interpreter lock to the others.
    Every model ends as it would alone.

    :param models: models on a :class:`sb3_adaptive_q.CompiledVecEnv`, each with an environment of its own
    :param total_timesteps: as in ``learn``
    :param workers: how many learn at a time; ``None`` for the number of cores
    :param log_interval: as in ``learn``
    :param reset_num_timesteps: as in ``learn``
    :return: the models
    :raises ValueError: if a model is there twice, its environment is not compiled, or two share an environment
    """
    _check_independence(models)
    workers = check("workers", workers)
    for name, value in (
        ("total_timesteps", total_timesteps), ("log_interval", log_interval), ("reset_num_timesteps", reset_num_timesteps)
    ):  # fmt: skip
        check(name, value)  # here, so that no model begins where all would refuse

    stop = threading.Event()

    def learn(model: TabularAlgorithm) -> TabularAlgorithm:
        return model.learn(
            total_timesteps,
            callback=_StopOnRequest(stop),
            log_interval=log_interval,
            reset_num_timesteps=reset_num_timesteps,
        )

    executor = ThreadPoolExecutor(workers or _count_cores())
    try:
        return list(executor.map(learn, models))
    except BaseException:
        stop.set()  # an interrupt, or an error in one model, ends the others with their rollout
        raise
    finally:
        executor.shutdown(cancel_futures=True)


class _StopOnRequest(BaseCallback):
    """Ends a training between two rollouts, once asked to."""

    knows_rollouts: ClassVar[bool] = True

    def __init__(self, stop: threading.Event) -> None:
        super().__init__()
        self.stop = stop

    def _on_step(self) -> bool:
        return not self.stop.is_set()


def _check_independence(models: Sequence[TabularAlgorithm]) -> None:
    if not isinstance(models, list | tuple) or not all(isinstance(model, TabularAlgorithm) for model in models):
        raise ValueError(f"`models` must be a list of models of this package, but got {models!r}.")
    if len({id(model) for model in models}) < len(models):
        raise ValueError("Each model can learn once at a time, but one is there twice: make a model for each run.")
    for i, model in enumerate(models):
        if not isinstance(model.env, CompiledVecEnv):
            raise ValueError(
                f"learn_many needs models on a CompiledVecEnv, but model {i} has a {type(model.env).__name__}: other "
                "environments hold the interpreter lock, so let those models learn one after the other."
            )
    for what, owned in (
        ("environments", [id(env.unwrapped) for model in models for env in model.env.envs]),
        ("tables", [model.policy.q_table.data_ptr() for model in models]),
    ):
        if len(set(owned)) < len(owned):
            raise ValueError(f"Models that learn at the same time need {what} of their own, but two share one.")


def _count_cores() -> int:
    if hasattr(os, "sched_getaffinity"):  # what this process may use, where the system tells
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
