"""What a cell of the league does: train once for every seed, and judge the table at equally spaced checkpoints."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

from sb3_adaptive_q import EpisodeSeriesCallback
from sb3_adaptive_q.experiments.environments import reused_vec_env
from sb3_adaptive_q.experiments.league.judges import Judge, control_judge, estimation_judge, prediction_judge
from sb3_adaptive_q.experiments.learners import Learner

#: How many times the largest possible value a table may hold before the run counts as diverged
DIVERGED = 1000.0


class Checkpoints(BaseCallback):
    """
    Judges the table at equally spaced checkpoints, and ends a run that has diverged.

    :param judge: gives a table's score
    :param interval: steps between two checkpoints
    """

    knows_rollouts = True

    def __init__(self, judge: Judge, interval: int) -> None:
        super().__init__()
        self.judge = judge
        self.interval = interval
        self.scores: list[float] = []
        self.failure = ""

    def _on_step(self) -> bool:
        if self.num_timesteps % self.interval:
            return True
        table = self.model.q_table  # type: ignore[attr-defined]
        if not np.abs(table).max() <= self.judge.largest_value * DIVERGED:  # which no NaN is
            self.failure = f"the table diverged: its largest entry is {np.abs(table).max():g}"
            return False
        self.scores.append(self.judge.score(table, self.num_timesteps))
        return True


class Row(NamedTuple):
    """
    One run.

    :param seed: of the agent and the environment
    :param scores: at the checkpoints; a failed run has the score of one that learned nothing from then on
    :param online: what was collected while learning, on the same scale; NaN where there is no such measure
    :param failure: why the run failed; empty if it did not
    """

    seed: int
    scores: np.ndarray
    online: float
    failure: str


def measure_control(recipe: Mapping[str, Any]) -> dict[str, list[Any]]:
    """
    Track B: the exact return of the greedy policy, 0 being that of the uniform policy and 1 the optimum.

    :param recipe: ``learner``, ``arguments`` of the environment, ``instances``, ``scale``, ``steps``, ``checkpoints``,
        ``seeds``
    :return: a row for each seed, see :class:`Row`
    """
    return _measure(recipe, control_judge)


def measure_estimation(recipe: Mapping[str, Any]) -> dict[str, list[Any]]:
    """
    Track A: 1 less the error of the values, in units of the error of the first table.

    :param recipe: as of :func:`measure_control`
    :return: a row for each seed
    """
    return _measure(recipe, estimation_judge)


def measure_prediction(recipe: Mapping[str, Any]) -> dict[str, list[Any]]:
    """
    Track C: the squared error of the values, mean over the states.

    :param recipe: as of :func:`measure_control`
    :return: a row for each seed
    """
    return _measure(recipe, prediction_judge)


MakeJudge = Callable[[Mapping[str, Any], dict[str, Any], VecEnv], Judge]


def _measure(recipe: Mapping[str, Any], make_judge: MakeJudge) -> dict[str, list[Any]]:
    learner = Learner(**recipe["learner"])
    rows = [_run(learner, recipe, seed, make_judge) for seed in recipe["seeds"]]
    return {name: [getattr(row, name) for row in rows] for name in Row._fields}


def _run(learner: Learner, recipe: Mapping[str, Any], seed: int, make_judge: MakeJudge) -> Row:
    arguments = dict(recipe["arguments"])
    if recipe["instances"]:
        arguments["instance"] = seed % recipe["instances"]
    env = reused_vec_env(learner.environment, **arguments)
    judge = make_judge(recipe, arguments, env)
    interval = recipe["steps"] // recipe["checkpoints"]
    checkpoints, episodes = Checkpoints(judge, interval), EpisodeSeriesCallback()
    # Nobody reads the window of the last episodes, which is filled at every checkpoint
    settings = {**learner.settings, "callback_interval": interval, "stats_window_size": 1}
    model, method = learner._replace(settings=settings).make(seed, env)
    failure = _learn(model, interval * recipe["checkpoints"], [method, checkpoints, episodes]) or checkpoints.failure
    scores = np.full(recipe["checkpoints"], judge.nothing_learned)
    scores[: len(checkpoints.scores)] = checkpoints.scores
    online = judge.online(episodes.returns) if len(episodes.returns) else np.nan
    share = len(checkpoints.scores) / recipe["checkpoints"]
    # What a failed run collects after its failure is what the uniform policy does: 0 on this scale
    return Row(seed, scores, online * share if failure else online, failure)


def _learn(model: BaseAlgorithm, steps: int, callbacks: list[BaseCallback]) -> str:
    """Learn, and return why that failed, if it did: a rule of the user's may raise, or give what is no number."""
    try:
        model.learn(steps, callback=callbacks, log_interval=None)  # type: ignore[arg-type]
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    finally:
        for callback in callbacks:
            callback.locals.clear()  # which hold the model, and would keep it until the garbage collector comes by
    return ""
