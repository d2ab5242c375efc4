"""What the runs of a track add up to: scores of every rule, compared with intervals."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from sb3_adaptive_q.experiments.league.plan import (
    CHOICES,
    CLIP,
    Runs,
    anytime,
    choose,
    prediction_scale,
    setting_text,
    tuning_scores,
)
from sb3_adaptive_q.experiments.league.settings import Track, league_data
from sb3_adaptive_q.experiments.statistics import (
    Comparison,
    Estimate,
    aggregates,
    area_over_grid,
    bootstrap_aggregates,
    compare_with,
    effective_dimension,
    interquartile_mean,
    interval,
    rank_intervals,
    rescaled,
    sensitivity,
    share_near_best,
)

#: The share of the checkpoints whose mean is the final score: 3 of 25
FINAL = 0.12
#: The kind of environments whose rules change: they have no end to be judged at
MOVING = "moving"

Places = Mapping[tuple[int, int, int], Runs]


class Played(NamedTuple):
    """
    A track that was played.

    :param track: the track
    :param tuning: its tuning runs
    :param chosen: by way of choosing, the setting of each rule in each task, of shape (rules, tasks)
    :param evaluation: its evaluation runs
    """

    track: Track
    tuning: Places
    chosen: Mapping[str, np.ndarray]
    evaluation: Places


class Scores(NamedTuple):
    """
    The evaluated runs of a track with one way of choosing settings.

    :param anytime: mean over the checkpoints, of shape (rules, runs, tasks)
    :param final: mean of the last checkpoints, of shape (rules, runs, tasks that have an end)
    :param online: what was collected while learning, of shape (rules, runs, tasks that have such a measure)
    :param curves: of shape (checkpoints, rules, runs, tasks)
    :param failures: how many runs failed, of shape (rules, tasks)
    :param settings: the index of the chosen setting, of shape (rules, tasks)
    """

    anytime: np.ndarray
    final: np.ndarray
    online: np.ndarray
    curves: np.ndarray
    failures: np.ndarray
    settings: np.ndarray


class Sensitivity(NamedTuple):
    """
    How much depends on the choice of a rule's setting, from the tuning runs.

    :param gamma: rescaled scores, of shape (settings, tasks)
    :param loss: what one setting for all costs against the best in each environment
    :param dimension: how many parameters have to be tuned in each environment
    :param area: what a setting chosen at random is worth
    :param near_best: the share of settings near the best, mean over the tasks
    """

    gamma: np.ndarray
    loss: float
    dimension: int
    area: float
    near_best: float


class Standing(NamedTuple):
    """
    A rule in the table.

    :param label: of the rule
    :param setting: the one chosen most often
    :param score: interquartile mean of the anytime scores
    :param mean: of the anytime scores
    :param gap: the optimality gap
    :param final: interquartile mean of the final scores
    :param online: interquartile mean of what was collected while learning
    :param rank: by the anytime score, and the ends of its interval
    :param comparisons: with each reference, by its label; a reference has none with itself
    :param with_best: the comparison with the best rule; ``None`` for that rule itself
    :param failures: how many runs failed
    """

    label: str
    setting: str
    score: Estimate
    mean: Estimate
    gap: Estimate
    final: Estimate
    online: Estimate
    rank: tuple[int, int, int]
    comparisons: dict[str, Comparison]
    with_best: Comparison | None
    failures: int


NOTHING = Estimate(np.nan, np.nan, np.nan)


def chosen_places(track: Track, tuning: Places) -> dict[str, np.ndarray]:
    """
    :param track: a track
    :param tuning: its tuning runs
    :return: by way of choosing, the index of the setting of each rule in each task, of shape (rules, tasks)
    """
    means = tuning_scores(track, tuning)
    shape = range(len(track.contestants)), range(len(track.tasks))
    return {choice: np.array([[choose(means[i], k, choice) for k in shape[1]] for i in shape[0]]) for choice in CHOICES}


def collect(track: Track, chosen: np.ndarray, runs: Places) -> Scores:
    """
    :param track: a track
    :param chosen: settings, of shape (rules, tasks)
    :param runs: evaluated runs
    :return: their scores
    """
    scale = prediction_scale(track, runs) if track.name == "C" else [1.0] * len(track.tasks)
    picked = [[runs[i, int(chosen[i, k]), k] for k in range(len(track.tasks))] for i in range(len(track.contestants))]

    def stack(part: Any, tasks: Sequence[int]) -> np.ndarray:
        return np.stack([np.stack([part(row[k], k) for k in tasks], axis=-1) for row in picked])

    every = range(len(track.tasks))
    has_end = [k for k in every if track.tasks[k].kind != MOVING]
    online = stack(lambda each, k: each.online, every)
    curves = stack(lambda each, k: _checkpoint_scores(track, each, scale[k]), every)
    return Scores(
        anytime=stack(lambda each, k: anytime(track, each, scale[k]), every),
        final=stack(lambda each, k: anytime(track, each._replace(scores=_last(each.scores)), scale[k]), has_end),
        online=np.clip(online[..., np.isfinite(online).all(axis=(0, 1))], *CLIP),
        curves=np.moveaxis(curves, 2, 0),
        failures=np.array([[len(each.failures) for each in row] for row in picked]),
        settings=chosen,
    )


def _last(scores: np.ndarray) -> np.ndarray:
    return scores[:, -max(round(FINAL * scores.shape[1]), 1) :]


def _checkpoint_scores(track: Track, runs: Runs, scale: float) -> np.ndarray:
    """Scores at each checkpoint, of shape (runs, checkpoints)."""
    columns = (runs._replace(scores=runs.scores[:, [i]]) for i in range(runs.scores.shape[1]))
    return np.stack([anytime(track, each, scale) for each in columns], axis=1)


def standings(track: Track, scores: Scores, resamples: int) -> list[Standing]:
    """
    :param track: a track
    :param scores: of its runs
    :param resamples: of the bootstrap
    :return: every rule, the best first
    """
    values, samples = aggregates(scores.anytime), bootstrap_aggregates(scores.anytime, resamples)
    ranks = rank_intervals(values[:, 0], samples[..., 0])
    final, online = (estimates(part, resamples) for part in (scores.final, scores.online))
    comparisons = _comparisons(track, values[:, 0], samples[..., 0])
    best = min(range(len(ranks)), key=lambda i: (ranks[i][0], track.contestants[i].label))
    with_best = compare_with(best, values[:, 0], samples[..., 0])
    rows = []
    for i, rule in enumerate(track.contestants):
        setting = int(np.bincount(scores.settings[i]).argmax())
        score, mean, gap = (interval(values[i, j], samples[:, i, j]) for j in range(3))
        rows.append(
            Standing(
                label=rule.label,
                setting=setting_text(rule, setting),
                score=score,
                mean=mean,
                gap=gap,
                final=final[i],
                online=online[i],
                rank=ranks[i],
                comparisons={label: compared[i] for label, compared in comparisons.items() if i in compared},
                with_best=with_best.get(i),
                failures=int(scores.failures[i].sum()),
            )
        )
    return sorted(rows, key=lambda row: (row.rank[0], row.label))


def _comparisons(track: Track, values: np.ndarray, samples: np.ndarray) -> dict[str, dict[int, Comparison]]:
    references = {rule.label: i for i, rule in enumerate(track.contestants) if rule.method in league_data()["references"]}
    return {label: compare_with(i, values, samples) for label, i in references.items() if len(values) > 1}


def estimates(scores: np.ndarray, resamples: int) -> list[Estimate]:
    """
    :param scores: of shape (rules, runs, tasks)
    :param resamples: of the bootstrap
    :return: the interquartile mean of each rule, of NaN where there are no tasks
    """
    if not scores.shape[-1]:
        return [NOTHING] * len(scores)
    values, samples = interquartile_mean(scores), bootstrap_aggregates(scores, resamples)[..., 0]
    return [interval(float(value), samples[:, i]) for i, value in enumerate(values)]


def sensitivities(track: Track, tuning: Places) -> list[Sensitivity]:
    """
    :param track: a track
    :param tuning: its tuning runs
    :return: for each rule, how much depends on its setting
    """
    means = tuning_scores(track, tuning)
    gammas = [rescaled(each, np.concatenate(means)) for each in means]
    return [
        Sensitivity(
            gamma,
            sensitivity(gamma),
            effective_dimension(gamma, rule.settings),
            area_over_grid(gamma),
            float(np.mean([share_near_best(column) for column in each.T])),
        )
        for gamma, each, rule in zip(gammas, means, track.contestants, strict=True)
    ]


def of_tasks(scores: Scores, tasks: Sequence[int]) -> Scores:
    """
    :param scores: of a track
    :param tasks: the indices of some of its tasks
    :return: the scores in these; without the final and the online ones
    """
    chosen = list(tasks)
    return scores._replace(
        anytime=scores.anytime[..., chosen],
        final=scores.anytime[..., :0],
        online=scores.anytime[..., :0],
        curves=scores.curves[..., chosen],
        failures=scores.failures[:, chosen],
        settings=scores.settings[:, chosen],
    )


def runs_frame(track: Track, runs: Places, seeds: Sequence[int], phase: str) -> pd.DataFrame:
    """
    :param track: a track
    :param runs: of one phase
    :param seeds: of each run
    :param phase: ``"tuning"`` or ``"evaluation"``
    :return: a row for each run, its scores at the checkpoints as they are, unclipped
    """
    rows = [
        {
            "track": track.name,
            "phase": phase,
            "environment": track.tasks[k].name,
            "kind": track.tasks[k].kind,
            "rule": track.contestants[i].label,
            "setting": setting_text(track.contestants[i], j),
            "seed": seed,
            "online": each.online[run],
            "scores": each.scores[run],
        }
        for (i, j, k), each in runs.items()
        for run, seed in enumerate(seeds)
    ]
    return pd.DataFrame(rows)
