"""``python -m sb3_adaptive_q league``: every step size against every other, in one command."""

import signal
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import tyro

from sb3_adaptive_q.experiments.league.league import run_league
from sb3_adaptive_q.experiments.league.settings import LeagueSettings
from sb3_adaptive_q.experiments.options import parse, report_errors
from sb3_adaptive_q.experiments.runner import Execution


@dataclass(frozen=True)
class LeagueOptions:
    """
    Compare step sizes: which one learns fastest in which environment, and how certain that is. The result is report.html.

    Tuning and evaluation use different seeds. An interrupted league continues when it is started again with the same output
    folder. --config FILE reads options from a YAML file, such as the design.yml that a league writes; options of the command
    line override it.
    """

    design: tyro.conf.OmitArgPrefixes[LeagueSettings] = field(default_factory=LeagueSettings)
    execution: tyro.conf.OmitArgPrefixes[Execution] = field(default_factory=lambda: Execution(output=Path("league-results")))


def main(arguments: Sequence[str] | None = None) -> int:
    """
    :param arguments: of the command line; ``None`` for those of this process
    :return: the exit status: 0, 2 where no such league can be made, 1 where it could not be finished
    """
    # Cluster managers end a job this way: it deserves the care of an interrupt from the keyboard
    signal.signal(signal.SIGTERM, signal.default_int_handler)

    def league() -> None:
        options = parse(LeagueOptions, "python -m sb3_adaptive_q league", sys.argv[1:] if arguments is None else arguments)
        print(run_league(options.design, options.execution))
        print(f"\nThe report, the tables and the runs are in {options.execution.output}: open report.html first.")

    return report_errors(league)
