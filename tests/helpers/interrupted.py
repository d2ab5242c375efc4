"""Trainings that write checkpoints, may be killed, and go on; and all that they leave behind."""

import pickle
import random
import signal
import time
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from helpers.both_paths import make_vec
from stable_baselines3.common.callbacks import CheckpointCallback
from stable_baselines3.common.logger import KVWriter, Logger

from sb3_adaptive_q import EpisodeSeriesCallback, TabularQ

#: Processes that begin as copies of one that has imported what takes long
PROCESSES = get_context("forkserver")
PROCESSES.set_forkserver_preload(["stable_baselines3", "numba", "gymnasium.envs.toy_text"])


class Training(NamedTuple):
    """
    How to train.

    :param env: a key of ``helpers.both_paths.ENVIRONMENTS``
    :param compiled: whether on a CompiledVecEnv
    :param n_envs: the number of environments
    :param total: environment steps
    :param every: steps of each environment between two checkpoints
    :param arguments: of the model
    :param kind: the class of the model
    """

    env: str
    compiled: bool
    n_envs: int
    total: int
    every: int
    arguments: dict[str, Any]
    kind: type[Any] = TabularQ


class Outcome(NamedTuple):
    """
    What a training leaves behind.

    :param arrays: tables, μ and memory, and the arrays that the algorithm works with, as bytes
    :param state: the scalars
    :param episodes: returns, lengths, rates and exploration rates of the episodes that ended, a row each
    :param logged: for every entry of the log its step and its values, but for those of the time
    :param next_actions: what was chosen last
    """

    arrays: dict[str, bytes]
    state: dict[str, Any]
    episodes: np.ndarray
    logged: list[tuple[int, dict[str, Any]]]
    next_actions: list[int]


class Memory(KVWriter):
    """A log that is kept."""

    def __init__(self) -> None:
        self.entries: list[tuple[int, dict[str, Any]]] = []

    def write(self, key_values: dict[str, Any], key_excluded: Any, step: int = 0) -> None:
        self.entries.append((step, {key: value for key, value in key_values.items() if not key.startswith("time/")}))

    def close(self) -> None:
        pass


def train(training: Training, folder: Path, checkpoint: Path | None = None, **how: Any) -> Outcome:
    """
    :param training: how to train
    :param folder: of the checkpoints
    :param checkpoint: what to go on from; ``None`` to begin
    :param how: ``compiled`` to go on otherwise than the training began
    :return: what it leaves behind
    """
    env = make_vec(training.env, how.get("compiled", training.compiled), training.n_envs)
    series, memory = EpisodeSeriesCallback(), Memory()
    callbacks = [CheckpointCallback(training.every, str(folder), "x"), series]
    if checkpoint is None:
        model = training.kind("MlpPolicy", env, **training.arguments)
        model.set_logger(Logger(None, [memory]))
        model.learn(training.total, callback=callbacks, log_interval=20)
    else:
        model = training.kind.resume(checkpoint, env)
        model.set_logger(Logger(None, [memory]))
        model.finish(callback=callbacks)
    return outcome_of(model, series, memory)


def outcome_of(model: Any, series: EpisodeSeriesCallback, memory: Memory) -> Outcome:
    """
    :param model: a model that has learned
    :param series: the callback that was there
    :param memory: the log
    :return: what the training left behind
    """
    arrays = {name: buffer.numpy().tobytes() for name, buffer in model.policy.state_dict().items()}
    arrays.update({f"working {name}": array.tobytes() for name, array in model._working.items()})
    episodes = np.stack([series.returns, series.lengths, series.rates, series.epsilons], axis=1)
    chosen = [] if model._next_actions is None else model._next_actions.tolist()
    return Outcome(arrays, model.training.as_data(), episodes, memory.entries, chosen)


def assert_goes_on(rest: Outcome, whole: Outcome, step: int) -> None:
    """
    :param rest: what a training left behind that went on from a checkpoint
    :param whole: what it left behind without an interruption
    :param step: the environment steps at the checkpoint
    :raises AssertionError: unless they are equal in every bit
    """
    assert rest.arrays == whole.arrays
    assert rest.state == whole.state
    assert rest.next_actions == whole.next_actions
    n_earlier = len(whole.episodes) - len(rest.episodes)
    assert rest.episodes.tobytes() == whole.episodes[n_earlier:].tobytes()
    assert rest.logged == [entry for entry in whole.logged if entry[0] >= step]


def checkpoints(folder: Path) -> list[tuple[int, Path]]:
    """
    :param folder: of the checkpoints
    :return: their steps and paths, the earliest first
    """
    return sorted((int(path.stem.split("_")[1]), path) for path in folder.glob("x_*_steps.zip"))


def run_in_process(training: Training, folder: Path, checkpoint: Path | None = None) -> Any:
    """
    :param training: how to train
    :param folder: of the checkpoints, where the outcome will be too
    :param checkpoint: what to go on from
    :return: the process, which has been started
    """
    process = PROCESSES.Process(target=_train_and_tell, args=(training, folder, checkpoint))
    process.start()
    return process


def outcome_in(folder: Path) -> Outcome:
    """
    :param folder: where a process has left its outcome
    :return: the outcome
    """
    return pickle.loads((folder / "outcome.pkl").read_bytes())  # type: ignore[no-any-return]


def kill_at_random(process: Any, folder: Path, training: Training, moment: random.Random) -> None:
    """
    Kill a process, which may not notice, in the first third of the training, as far as it has not been done before.

    :param process: the process
    :param folder: of its checkpoints
    :param training: what it does
    :param moment: decides when
    """
    n_before, n_more = len(checkpoints(folder)), training.total // (training.every * training.n_envs)
    wanted = n_before + moment.randint(1, max(n_more // 3, 1))
    try:
        while len(checkpoints(folder)) < wanted and process.is_alive():
            time.sleep(0.0005)
        time.sleep(moment.uniform(0.0, 0.02))
    finally:  # pytest's own limit of time may end the wait
        process.kill()
        process.join()


def was_killed(process: Any) -> bool:
    """
    :param process: a process that has ended
    :return: whether a kill ended it
    """
    return bool(process.exitcode == -signal.SIGKILL)


def _train_and_tell(training: Training, folder: Path, checkpoint: Path | None) -> None:
    outcome = train(training, folder, checkpoint)
    (folder / "outcome.pkl").write_bytes(pickle.dumps(outcome))
