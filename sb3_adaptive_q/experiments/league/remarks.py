"""What a reader of a league has to know of its scores: how far it is the whole league, and where a scale has its limits."""

from typing import Any

import numpy as np

from sb3_adaptive_q.experiments.environments import make_env
from sb3_adaptive_q.experiments.league.settings import RESAMPLES, LeagueSettings, Task, Track, league_data
from sb3_adaptive_q.experiments.text import join
from sb3_adaptive_q.planning import Reference, action_values, reference, value_iteration

#: Scores that differ by less are the same in the tables
VISIBLE = 5e-4
#: A table that has learned nothing and scores more leaves little to learn
NEARLY_BEST = 0.9


def design_remark(settings: LeagueSettings) -> str:
    """
    :param settings: of a league
    :return: a sentence on what it has less than the protocol; empty if nothing
    """
    data = league_data()
    whole = {
        "runs to choose a setting on": (settings.tuning_runs, data["tuning"]["runs"]),
        "runs to judge it by": (settings.runs, data["evaluation"]["runs"]),
        "bootstrap samples": (settings.resamples, RESAMPLES),
    }
    less = [f"{here} {name} instead of {there}" for name, (here, there) in whole.items() if here < there]
    return f"**Less than the whole league:** {join(less)}." if less and not settings.quick else ""


def scale_remark(track: Track) -> str:
    """
    :param track: of control
    :return: sentences on environments where the best table scores less than 1, or the first table nearly that
    """
    scales = {task.name: _scale(task) for task in track.tasks if task.scale is None}
    scales = {name: each for name, each in scales.items() if each.optimal_return > each.uniform_return}
    best = {name: float(each.score(each.measure(_best_policy(each)))) for name, each in scales.items()}
    first = {name: float(each.score(each.measure(_first_policy(each)))) for name, each in scales.items()}
    lower = [f"{value:.3f} in {name}" for name, value in best.items() if value < 1.0 - VISIBLE]
    ready = [f"{value:.2f} in {name}" for name, value in first.items() if value > NEARLY_BEST]
    sentences = []
    if lower:
        sentences.append(
            f"The greedy policy of the optimal values themselves scores {join(lower)}: the optimum may count the steps that "
            "are left, which a table cannot."
        )
    if ready:
        sentences.append(f"A table of equal values, where ties give the first action, already scores {join(ready)}.")
    if "moving_goal" in scales:
        sentences.append(
            "In moving_goal nearly every policy that comes to the goal within 200 steps returns 1: the score tells whether "
            "the goal is found, not how fast."
        )
    return " ".join(sentences)


def _scale(task: Task) -> Reference:
    arguments: dict[str, Any] = {**task.arguments, **({"instance": 0} if task.instances else {})}
    return reference(make_env(task.environment, **arguments), gamma=task.gamma)


def _first_policy(scale: Reference) -> np.ndarray:
    return np.zeros(scale.model.n_states, int)


def _best_policy(scale: Reference) -> np.ndarray:
    return action_values(scale.model, value_iteration(scale.model, scale.gamma), scale.gamma).argmax(axis=1)
