"""A whole study: its cells, then what they add up to."""

import gc
import sys
from pathlib import Path

from tqdm import tqdm

from sb3_adaptive_q.study.atomic import write_atomically
from sb3_adaptive_q.study.runner import run_missing_cells
from sb3_adaptive_q.study.settings import StudySettings
from sb3_adaptive_q.study.storage import StudyFolder
from sb3_adaptive_q.study.systems import check_system


def run_study(
    settings: StudySettings,
    output: Path,
    workers: int | None = None,
    dask: str | None = None,
    tensorboard: Path | None = None,
    progress_bar: bool = True,
) -> str:
    """
    Run what is missing of a study, and write its tables, figures and report.

    :param settings: the design
    :param output: the folder of the study, which may hold a part of it already
    :param workers: processes of this machine; ``None`` for one for each core
    :param dask: the address of a Dask scheduler, whose cluster is used instead; ``None`` for this machine
    :param tensorboard: the folder for TensorBoard's files; ``None`` for none
    :param progress_bar: whether to show one, with the time left
    :return: the report
    :raises DesignError: if a system is unknown or does not compile, or the folder belongs to something else
    :raises StudyError: if a cell fails, or something cannot be stored
    """
    for system in settings.systems:
        check_system(system)
    folder = StudyFolder(output, settings, warn=lambda text: tqdm.write(f"Warning: {text}", file=sys.stderr))
    folder.open()
    run_missing_cells(folder, workers, dask, progress_bar)
    if progress_bar:
        print("Drawing figures, comparing methods ...", file=sys.stderr)
    report = write_outputs(folder)
    if tensorboard is not None:
        from sb3_adaptive_q.study.tensorboard_log import write_tensorboard

        write_tensorboard(folder, tensorboard)
    return report


def write_outputs(folder: StudyFolder) -> str:
    """
    Write the tables, figures and report of a study.

    :param folder: a study whose cells are all there
    :return: the report
    """
    # Here, because the workers, which run at full memory before, and a start that goes wrong need none of these
    from sb3_adaptive_q.study.figures import make_figures, render
    from sb3_adaptive_q.study.report import write_report
    from sb3_adaptive_q.study.results import read_results
    from sb3_adaptive_q.study.tables import table_files

    results = read_results(folder)
    for name, text in table_files(results, folder.settings.gamma).items():
        write_atomically(folder.path / name, text.encode())
    for name, figure in make_figures(results, folder.settings.gamma):
        for kind in ("png", "pdf"):
            write_atomically(folder.path / "figures" / f"{name}.{kind}", render(figure, kind))
        gc.collect()  # figures are full of reference cycles, and would pile up to a GiB
    report = write_report(results, folder.settings)
    write_atomically(folder.path / "report.md", report.encode())
    return report
