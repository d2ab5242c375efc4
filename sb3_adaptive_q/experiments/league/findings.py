"""What follows from a league, in words with the numbers behind them."""

from collections.abc import Sequence

from sb3_adaptive_q import METHODS
from sb3_adaptive_q.experiments.league.analysis import Scores, Standing, of_tasks, standings
from sb3_adaptive_q.experiments.league.settings import Track
from sb3_adaptive_q.experiments.names import method_label
from sb3_adaptive_q.experiments.statistics import SIGNIFICANCE
from sb3_adaptive_q.experiments.text import format_estimate, join

#: How a kind of environments is called at the beginning of a sentence
WHERE = {
    "noisy transitions": "Where transitions are noisy",
    "deterministic": "Where everything is deterministic",
    "noisy rewards": "Where rewards are noisy",
    "moving": "Where the goal or the rewards move",
    "aliased states": "Where different states look alike",
    "your own": "In your own environments",
}
PAPER_LABELS = [method_label(str(number)) for number in METHODS]


def findings(track: Track, scores: Scores, rows: Sequence[Standing], resamples: int) -> list[str]:
    """
    :param track: a track
    :param scores: with one setting for all environments
    :param rows: their standings
    :param resamples: of the bootstrap
    :return: a sentence on all environments, and one on each kind of them
    """
    sentences = [_finding("Over all environments together", track, rows)]
    for kind in dict.fromkeys(task.kind for task in track.tasks):
        tasks = [k for k, task in enumerate(track.tasks) if task.kind == kind]
        part = track._replace(tasks=tuple(track.tasks[k] for k in tasks))
        sentences.append(_finding(WHERE[kind], part, standings(part, of_tasks(scores, tasks), resamples)))
    return sentences


def _finding(where: str, track: Track, rows: Sequence[Standing]) -> str:
    best, places = rows[0], ", ".join(task.name for task in track.tasks)
    text = f"**{where}** ({places}), take **{best.label}** ({best.setting}): its score is {_with_comparisons(best)}"
    equals = [row.label for row in rows if row.with_best is not None and not row.with_best.is_significant]
    others = f"Not significantly different: {join(equals)}." if equals else "Every other rule is significantly different."
    return f"{text}. {others}"


def _with_comparisons(row: Standing) -> str:
    parts = [format_estimate(*row.score)]
    for label, (difference, p_value) in row.comparisons.items():
        value, low, high = difference if difference.value >= 0 else (-difference.value, -difference.high, -difference.low)
        doubt = "" if p_value < SIGNIFICANCE else " (not significant)"
        side = "above" if difference.value >= 0 else "below"
        parts.append(f"{format_estimate(value, low, high)} {side} {label}{doubt}")
    return ", ".join(parts)


def paper_finding(rows: Sequence[Standing]) -> str:
    """
    :param rows: the standings, the best first
    :return: a sentence on the paper's methods; empty if none of them took part
    """
    of_paper = [row for row in rows if row.label in PAPER_LABELS]
    if not of_paper:
        return ""
    best = of_paper[0]
    rank, low, high = best.rank
    others = [f"{row.label} {row.score.value:.2f}" for row in of_paper[1:]]
    ends = f". The others: {', '.join(others)}" if others else ""
    return (
        f"**Of the paper's methods** {best.label} does best: rank {rank} [{low}, {high}] of {len(rows)}, score "
        f"{_with_comparisons(best)}{ends}. Methods 5 to 8 keep their rates between 0.001 and 0.01, which is slow where steps "
        "are few."
    )
