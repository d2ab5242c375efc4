"""The report of a league, in Markdown and as a page, with its figures and tables."""

import platform
import shlex
from collections.abc import Sequence
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import pandas as pd
from joblib import cpu_count

from sb3_adaptive_q.experiments.drawing import Picture, render_all
from sb3_adaptive_q.experiments.league.analysis import (
    Played,
    Scores,
    Sensitivity,
    Standing,
    collect,
    estimates,
    sensitivities,
    standings,
)
from sb3_adaptive_q.experiments.league.figures import (
    curves_figure,
    environments_figure,
    free_parameters,
    plane_figure,
    profiles_figure,
    sensitivity_figure,
    wins_figure,
)
from sb3_adaptive_q.experiments.league.findings import findings, paper_finding
from sb3_adaptive_q.experiments.league.plan import CHOICES, prediction_scale
from sb3_adaptive_q.experiments.league.remarks import design_remark, scale_remark
from sb3_adaptive_q.experiments.league.settings import LeagueSettings, Track, league_data
from sb3_adaptive_q.experiments.options import options_of
from sb3_adaptive_q.experiments.page import html_page
from sb3_adaptive_q.experiments.statistics import (
    Comparison,
    Estimate,
    improvement_matrix,
    tolerance_interval,
)
from sb3_adaptive_q.experiments.storage import ResultFolder
from sb3_adaptive_q.experiments.text import file_name, format_estimate, markdown_table, p_value
from sb3_adaptive_q.experiments.versions import commit, versions

TITLES = {
    "B": "Control (track B)",
    "A": "Estimation (track A)",
    "C": "Prediction (track C)",
    "algorithms": "Other algorithms (track B repeated)",
}
WHAT = {
    "B": "Score: the exact return of the greedy policy, 0 for the uniform policy and 1 for the optimum, averaged over all "
    "checkpoints: it is high where a good policy is learned early and kept.",
    "A": "Score: 1 minus the error of the values in units of the first table's error, averaged over all checkpoints. "
    "Behaviour is uniform, and with one seed all rules see the same transitions.",
    "C": "Score: the squared error of the best constant step size in that environment divided by the rule's, both averaged "
    "over all checkpoints; 1 is as good as the best constant step size, more is better.",
    "algorithms": "Score as in track B, for other algorithms than Q-learning with four of the rules.",
}
NOTE = (
    "The score is the interquartile mean over runs and environments with one setting for all environments; the setting for an "
    "environment is chosen on the tuning runs of the others (the table names the one chosen most often). Brackets hold 95 % "
    "bootstrap intervals, stratified by environment. Differences are paired by seed; their p values are corrected after Holm. "
    "Sensitivity is what one setting for all costs against the best in each environment, in units of the spread of all "
    "settings of all rules; tuned parameters is how many have to be chosen in each environment to keep 95 % of the best; a "
    "random setting's worth is the mean over the grid on that scale. A run that fails counts as the uniform policy from then "
    "on."
)
#: What every heading of a quick look ends with, and what it means
QUICK = " (quick look)"
QUICK_NOTE = "**A quick look, no league result:** few settings, few runs and a tenth of the steps (`--quick`)."


class Analysed(NamedTuple):
    """
    :param played: a track
    :param scores: by way of choosing
    :param rows: the standings with one setting for all environments
    :param sensitivities: of the rules
    """

    played: Played
    scores: dict[str, Scores]
    rows: list[Standing]
    sensitivities: list[Sensitivity]

    @property
    def track(self) -> Track:
        """The track."""
        return self.played.track


def write_outputs(
    settings: LeagueSettings, folder: ResultFolder, played: Sequence[Played], seconds: float, workers: int | None = None
) -> str:
    """
    Write the report, its figures and its tables.

    :param settings: of the league
    :param folder: of the league
    :param played: its tracks
    :param seconds: how long this start took to run what was missing
    :param workers: the processes that draw; ``None``: one for each core
    :return: the summary of the report
    """
    order = list(TITLES)
    analysed = [analyse(each, settings.bootstrap_samples) for each in played]
    analysed.sort(key=lambda each: order.index(each.track.name))
    sections = [_section(settings, folder, each, workers) for each in analysed]
    summary = _summary(settings, analysed[0])
    report = "\n\n".join([summary, *sections, _how_to_repeat(settings, seconds)]) + "\n"
    folder.write("league.yml", (files("sb3_adaptive_q.experiments.league") / "league.yml").read_bytes())
    folder.write("report.md", report)
    folder.write("report.html", html_page(report, lambda name: (folder.path / name).read_bytes()))
    return summary


def analyse(played: Played, resamples: int) -> Analysed:
    """
    :param played: a track
    :param resamples: of the bootstrap
    :return: what it adds up to
    """
    track = played.track
    scores = {choice: collect(track, played.chosen[choice], played.evaluation) for choice in CHOICES}
    return Analysed(played, scores, standings(track, scores[CHOICES[0]], resamples), sensitivities(track, played.tuning))


def _summary(settings: LeagueSettings, first: Analysed) -> str:
    track = first.track
    heading = f"# Step sizes of tabular learning, compared{QUICK if settings.quick else ''}"
    heading += f"\n\n{QUICK_NOTE}" if settings.quick else ""
    sentences = findings(track, first.scores[CHOICES[0]], first.rows, settings.bootstrap_samples)
    sentences += [paper_finding(first.rows)]
    runs = sum(len(group) for group in settings.seeds("evaluation"))
    what = f"{len(track.contestants)} rules in {len(track.tasks)} environments, {runs} runs each. {WHAT[track.name]}"
    parts = [heading, what, design_remark(settings), "\n".join(f"- {sentence}" for sentence in sentences if sentence)]
    return "\n\n".join(part for part in parts if part)


def _section(settings: LeagueSettings, folder: ResultFolder, analysed: Analysed, workers: int | None) -> str:
    track, mark, resamples = analysed.track, QUICK if settings.quick else "", settings.bootstrap_samples
    wins = improvement_matrix(analysed.scores[CHOICES[0]].anytime, min(resamples, 1000))
    tables = {
        "standings": ("Standings", standings_table(analysed)),
        "choices": ("Other ways of choosing the setting (interquartile means)", _choices_table(analysed, resamples)),
        "environments": (
            "Mean score in each environment, with the interval that holds nine of ten runs with 95 % confidence",
            _environments_table(analysed),
        ),
    }
    parts = [f"## {TITLES[track.name]}{mark}\n\n{WHAT[track.name]}"]
    for name, (caption, frame) in tables.items():
        folder.write(f"tables/{track.name}_{name}.csv", frame.to_csv(index=False))
        parts.append(f"### {caption}{mark}\n\n{markdown_table(frame.columns.tolist(), frame.to_numpy().tolist())}")
        if name == "standings":
            parts += [NOTE, scale_remark(track) if track.name == "B" else "", _failures(analysed)]
    labels = [rule.label for rule in track.contestants]
    matrix = pd.DataFrame([[each.value for each in row] for row in wins], index=labels, columns=labels)
    folder.write(f"tables/{track.name}_wins.csv", matrix.to_csv())
    pictures = _pictures(analysed, wins, settings.quick)
    contents = render_all(pictures, workers, "quick look" if settings.quick else "")
    for picture, content in zip(pictures, contents, strict=True):
        path = f"figures/{track.name}_{picture.name}.png"
        folder.write(path, content)
        parts.append(f"![{picture.caption}{mark}]({path})")
    return "\n\n".join(part for part in parts if part)


def _pictures(analysed: Analysed, wins: list[list[Estimate]], is_quick: bool) -> list[Picture]:
    track, rows, scores, tuning = analysed.track, analysed.rows, analysed.scores[CHOICES[0]], analysed.played.tuning
    labels = [rule.label for rule in track.contestants]
    pictures = [
        Picture("plane", "Performance against sensitivity", partial(plane_figure, track, rows, analysed.sensitivities)),
        Picture("curves", "Learning over all environments", partial(curves_figure, track, scores, rows)),
        Picture("environments", "Learning in each environment", partial(environments_figure, track, scores, rows)),
        Picture("wins", "Matrix of wins", partial(wins_figure, rows, labels, wins)),
        Picture("profiles", "Performance profiles", partial(profiles_figure, track, scores, rows)),
    ]
    if is_quick or track.name == "algorithms":  # which tune over few settings: too few for a curve
        return pictures
    scale = prediction_scale(track, tuning) if track.name == "C" else [1.0] * len(track.tasks)
    for i, label in enumerate(labels):
        if free_parameters(track.contestants[i]):
            name, caption = file_name(f"sensitivity_{label}"), f"Score of {label} against its parameter"
            own = {place: runs for place, runs in tuning.items() if place[0] == i}
            pictures.append(Picture(name, caption, partial(sensitivity_figure, track, i, own, scale)))
    return pictures


def standings_table(analysed: Analysed) -> pd.DataFrame:
    """
    :param analysed: a track
    :return: the headline table, a row for each rule, the best first
    """
    by_label = {rule.label: each for rule, each in zip(analysed.track.contestants, analysed.sensitivities, strict=True)}
    references = list(dict.fromkeys(label for row in analysed.rows for label in row.comparisons))
    return pd.DataFrame(
        [
            {
                "rank [interval]": "{} [{}, {}]".format(*row.rank),
                "rule": row.label,
                "setting": row.setting,
                "score [95 % interval]": format_estimate(*row.score, decimals=3),
                **{f"score minus that of {label}": _difference(row.comparisons.get(label)) for label in references},
                "final score": format_estimate(*row.final, decimals=3),
                "score while learning": format_estimate(*row.online, decimals=3),
                "mean": format_estimate(*row.mean, decimals=3),
                "optimality gap": format_estimate(*row.gap, decimals=3),
                "sensitivity": f"{by_label[row.label].loss:.3f}",
                "tuned parameters": str(by_label[row.label].dimension),
                "a random setting's worth": f"{by_label[row.label].area:.2f}",
                "settings near the best": f"{by_label[row.label].near_best:.2f}",
                "failed runs": str(row.failures),
            }
            for row in analysed.rows
        ]
    )


def _difference(comparison: Comparison | None) -> str:
    if comparison is None:
        return "–"
    return f"{format_estimate(*comparison.difference, decimals=3)}, {p_value(comparison.p_value)}"


def _choices_table(analysed: Analysed, resamples: int) -> pd.DataFrame:
    labels = [rule.label for rule in analysed.track.contestants]
    others = {choice: estimates(analysed.scores[choice].anytime, resamples) for choice in CHOICES[1:]}
    return pd.DataFrame(
        [
            {"rule": row.label, CHOICES[0]: format_estimate(*row.score, decimals=3)}
            | {choice: format_estimate(*of_rules[labels.index(row.label)], decimals=3) for choice, of_rules in others.items()}
            for row in analysed.rows
        ]
    )


def _environments_table(analysed: Analysed) -> pd.DataFrame:
    track, scores = analysed.track, analysed.scores[CHOICES[0]]
    labels = [rule.label for rule in track.contestants]
    rows = []
    for row in analysed.rows:
        runs = scores.anytime[labels.index(row.label)]
        cells = {
            task.name: format_estimate(float(column.mean()), *tolerance_interval(column))
            for task, column in zip(track.tasks, runs.T, strict=True)
        }
        rows.append({"rule": row.label, **cells})
    return pd.DataFrame(rows)


def _failures(analysed: Analysed) -> str:
    """Every reason once, with the rule and the environment where it was met first."""
    track = analysed.track
    reasons: dict[str, tuple[str, str, int]] = {}
    for (i, _, k), runs in analysed.played.evaluation.items():
        for reason in runs.failures:
            rule, place, count = reasons.get(reason, (track.contestants[i].label, track.tasks[k].name, 0))
            reasons[reason] = rule, place, count + 1
    lines = [f"- {rule} in {place}: {reason} ({count} runs)" for reason, (rule, place, count) in reasons.items()]
    return "Runs that failed, by their reasons:\n\n" + "\n".join(lines) if lines else ""


def _how_to_repeat(settings: LeagueSettings, seconds: float) -> str:
    default = LeagueSettings().as_data()
    options = options_of({name: value for name, value in settings.as_data().items() if value != default[name]})
    command = shlex.join(["python", "-m", "sb3_adaptive_q", "league", *options])
    rows = {
        "league": f"version {league_data()['version']}, see league.yml",
        "seeds of the tuning": _span(settings, "tuning"),
        "seeds of the evaluation": _span(settings, "evaluation"),
        "bootstrap samples": str(settings.bootstrap_samples),
        "time of this start": f"{seconds:.0f} s (what was stored before took none)",
        "processor": f"{_processor()}, {cpu_count()} cores",
        "commit": commit() or "unknown",
        **versions(),
    }
    table = markdown_table(["what", "value"], [[name, value] for name, value in rows.items()])
    text = f"`{command}` repeats it: with the same versions every number is the same."
    return f"## What was run, and how to repeat it\n\n{text}\n\n{table}"


def _span(settings: LeagueSettings, phase: str) -> str:
    seeds = [seed for group in settings.seeds(phase) for seed in group]
    return f"{seeds[0]} to {seeds[-1]}"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
