"""A whole league: the tuning runs, the choice of settings, the evaluation runs, and what they add up to."""

import sys
import time
from collections.abc import Iterable

import pandas as pd

from sb3_adaptive_q.experiments.errors import ExperimentError
from sb3_adaptive_q.experiments.league.analysis import Places, Played, chosen_places, runs_frame
from sb3_adaptive_q.experiments.league.plan import all_places, cells_of, read_runs
from sb3_adaptive_q.experiments.league.settings import SELECTION, LeagueSettings, Track
from sb3_adaptive_q.experiments.runner import Execution, run_missing
from sb3_adaptive_q.experiments.storage import ResultFolder


def run_league(settings: LeagueSettings, execution: Execution) -> str:
    """
    Run what is missing of a league, and write its report.

    :param settings: what is compared
    :param execution: how to carry it out
    :return: the summary of the report
    :raises DesignError: if a name is unknown, an environment cannot be judged, or the folder belongs to something else
    :raises ExperimentError: if a worker dies, or something cannot be stored
    """
    tracks = settings.chosen_tracks()
    folder = ResultFolder(execution.output)
    folder.open(settings.as_data(), SELECTION)
    start = time.monotonic()
    played = [play(settings, track, folder, execution) for track in tracks]
    seconds = time.monotonic() - start
    if execution.progress:
        print("Comparing the rules, drawing figures ...", file=sys.stderr)
    from sb3_adaptive_q.experiments.league.report import write_outputs

    _write_runs(settings, folder, played)
    return write_outputs(settings, folder, played, seconds, execution.workers)


def play(settings: LeagueSettings, track: Track, folder: ResultFolder, execution: Execution) -> Played:
    """
    :param settings: of the league
    :param track: one of its tracks
    :param folder: of the league
    :param execution: how to carry it out
    :return: the track with all its runs
    :raises ExperimentError: if every run failed
    """
    tuning = _run(settings, track, all_places(track), "tuning", folder, execution)
    chosen = chosen_places(track, tuning)
    places = {
        (i, int(setting), k): None
        for settings_of in chosen.values()
        for i, row in enumerate(settings_of)
        for k, setting in enumerate(row)
    }
    evaluation = _run(settings, track, places, "evaluation", folder, execution)
    if all(len(runs.failures) == len(runs.scores) for runs in evaluation.values()):
        reason = next(iter(evaluation.values())).failures[0]
        raise ExperimentError(
            f"Every run of track {track.name} failed, so that nothing can be compared. The first one: {reason}"
        )
    return Played(track, tuning, chosen, evaluation)


def _run(
    settings: LeagueSettings,
    track: Track,
    places: Iterable[tuple[int, int, int]],
    phase: str,
    folder: ResultFolder,
    execution: Execution,
) -> Places:
    cells = {place: cells_of(settings, track, place, phase) for place in places}
    title = f"track {track.name}, {phase}" if len(track.name) == 1 else f"{track.name}, {phase}"
    failures = run_missing([cell for each in cells.values() for cell in each], folder, execution, title=title, unit="step")
    reasons = {failure.cell.key: failure.reason for failure in failures}
    return {place: read_runs(folder, each, reasons) for place, each in cells.items()}


def _write_runs(settings: LeagueSettings, folder: ResultFolder, played: list[Played]) -> None:
    frames = [
        runs_frame(each.track, runs, [seed for group in settings.seeds(phase) for seed in group], phase)
        for each in played
        for phase, runs in (("tuning", each.tuning), ("evaluation", each.evaluation))
    ]
    folder.write("runs.parquet", pd.concat(frames, ignore_index=True).to_parquet(index=False))
