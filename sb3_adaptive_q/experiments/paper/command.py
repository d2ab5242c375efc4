"""``python -m sb3_adaptive_q study``: the paper's experiment, or another of its kind, in one command."""

import signal
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import tyro

from sb3_adaptive_q.experiments.options import parse, report_errors
from sb3_adaptive_q.experiments.paper.settings import StudySettings
from sb3_adaptive_q.experiments.paper.study import run_study
from sb3_adaptive_q.experiments.runner import Execution


@dataclass(frozen=True)
class StudyOptions:
    """
    Repeat the paper's experiment, compare its tables and figures with the paper's, and judge the paper's claims.

    An interrupted study continues when it is started again with the same output folder. --config FILE reads options from a
    YAML file, such as the design.yml that a study writes; options of the command line override it.

    :param tensorboard: also write TensorBoard logs to this folder; TensorBoard's HPARAMS page compares them
    :param tensorboard_runs: mean writes one log for each method, its mean over the runs; all writes one log for each run
    """

    design: tyro.conf.OmitArgPrefixes[StudySettings] = field(default_factory=StudySettings)
    execution: tyro.conf.OmitArgPrefixes[Execution] = field(default_factory=lambda: Execution(output=Path("study-results")))
    tensorboard: Path | None = None
    tensorboard_runs: Literal["mean", "all"] = "mean"


def main(arguments: Sequence[str] | None = None) -> int:
    """
    :param arguments: of the command line; ``None`` for those of this process
    :return: the exit status: 0, 2 where no such study can be made, 1 where it could not be finished
    """
    # Cluster managers end a job this way: it deserves the care of an interrupt from the keyboard
    signal.signal(signal.SIGTERM, signal.default_int_handler)

    def study() -> None:
        options = parse(StudyOptions, "python -m sb3_adaptive_q study", sys.argv[1:] if arguments is None else arguments)
        print(run_study(options.design, options.execution, options.tensorboard, options.tensorboard_runs == "all"))
        print(f"\nThe report, the tables and the figures are in {options.execution.output}: open report.html first.")

    return report_errors(study)
