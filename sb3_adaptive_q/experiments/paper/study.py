"""A whole study: its runs, then what they add up to."""

import gc
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pandas as pd

from sb3_adaptive_q.experiments.cells import Cell
from sb3_adaptive_q.experiments.environments import is_compiled
from sb3_adaptive_q.experiments.errors import ExperimentError
from sb3_adaptive_q.experiments.paper.settings import PAPER_SYSTEMS, SELECTION, StudySettings, title_of
from sb3_adaptive_q.experiments.runner import Execution, Failure, run_missing
from sb3_adaptive_q.experiments.storage import ResultFolder
from sb3_adaptive_q.experiments.text import file_name


def run_study(settings: StudySettings, execution: Execution, tensorboard: Path | None = None, every_run: bool = False) -> str:
    """
    Run what is missing of a study, and write its tables, figures and report.

    :param settings: the design
    :param execution: how to carry it out
    :param tensorboard: the folder for TensorBoard's files; ``None`` for none
    :param every_run: whether to write every run there, rather than the mean of each method's runs
    :return: the summary of the report
    :raises DesignError: if a name is unknown, a value out of range, or the folder belongs to something else
    :raises ExperimentError: if a worker dies, every run fails, or something cannot be stored
    """
    cells = settings.design().cells()
    folder = ResultFolder(execution.output)
    folder.open(settings.as_data(), SELECTION)
    failures = run_missing(cells, folder, execution, all(map(is_compiled, settings.systems)))
    failed = {failure.cell.key for failure in failures}
    cells = [cell for cell in cells if cell.key not in failed]
    if not cells:
        raise ExperimentError(f"Every run failed, the first one of them for this reason: {failures[0].reason}")
    if execution.progress:
        print("Drawing figures, comparing methods ...", file=sys.stderr)
    report = write_outputs(settings, folder, cells, failures)
    if tensorboard is not None:
        from sb3_adaptive_q.experiments.paper.tensorboard_log import write_tensorboard

        write_tensorboard(folder, cells, tensorboard, every_run)
    return report.partition("\n## ")[0]


def write_outputs(
    settings: StudySettings, folder: ResultFolder, cells: Sequence[Cell], failures: Sequence[Failure] = ()
) -> str:
    """
    Write the tables, figures and report of a study.

    :param settings: its design
    :param folder: where its cells are
    :param cells: those that count
    :param failures: the runs that failed
    :return: the report
    """
    # Here, because the workers and a start that goes wrong need none of these
    from sb3_adaptive_q.experiments.drawing import paint, pdf_of, png_of
    from sb3_adaptive_q.experiments.page import html_page
    from sb3_adaptive_q.experiments.paper.figures import make_figures
    from sb3_adaptive_q.experiments.paper.report import write_report
    from sb3_adaptive_q.experiments.paper.results import read_results
    from sb3_adaptive_q.experiments.paper.tables import q_value_tables, results_markdown, results_table

    results = read_results(folder, cells)
    folder.write("results.csv", results.runs.to_csv(index=False))
    folder.write("results.parquet", results.runs.to_parquet(index=False))
    tables: dict[int | str, tuple[pd.DataFrame, str]] = {
        number: (table, text) for number, (_, table, text) in q_value_tables(results, settings.gamma).items()
    }
    for system in results.systems:
        table = results_table(results, system)
        tables[_table_name(system)] = (table, f"{title_of(system)}\n\n{results_markdown(table)}")
    for number, (table, text) in tables.items():
        folder.write(f"table_{number}.csv", table.to_csv(index=False))
        folder.write(f"table_{number}.md", f"{text}\n")
    gc.freeze()  # what is there already need not be looked through after every figure
    shown: dict[str, list[tuple[str, str]]] = {}
    with ThreadPoolExecutor(1) as background:
        for system, name, caption, figure in make_figures(results, settings.gamma):
            png = background.submit(png_of, paint(figure))  # it is encoded while the PDF file is made
            folder.write(f"figures/{name}.pdf", pdf_of(figure))
            folder.write(f"figures/{name}.png", png.result())
            shown.setdefault(system, []).append((f"figures/{name}", caption))
            gc.collect()  # figures are full of reference cycles, and would pile up to a GiB
    report = write_report(results, settings, shown, failures)
    folder.write("report.md", report)
    folder.write("report.html", html_page(report, lambda name: (folder.path / name).read_bytes()))
    return report


def _table_name(system: str) -> int | str:
    return PAPER_SYSTEMS[system].results_table if system in PAPER_SYSTEMS else file_name(system)
