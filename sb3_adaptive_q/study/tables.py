"""The paper's tables of results, ours beside the printed ones, and the files of all tables."""

from collections.abc import Iterable

import numpy as np
import pandas as pd

from sb3_adaptive_q.study.markdown import format_estimate, format_number, markdown_table
from sb3_adaptive_q.study.paper_data import paper_table
from sb3_adaptive_q.study.q_tables import q_value_tables
from sb3_adaptive_q.study.results import Results
from sb3_adaptive_q.study.statistics import Estimate, estimate, mean, population_std
from sb3_adaptive_q.study.systems import PAPER_SYSTEMS, file_name, title_of

STATISTICS = ("min", "max", "avg", "avg_100", "std")

NOTE = (
    "min, max, avg and std are over the return of the last episode of every run (std with divisor n), avg_100 is the mean "
    "over the runs of the mean return of the last 100 episodes. Brackets hold 95% percentile bootstrap intervals; the "
    "least and the largest of a sample have none that would be valid."
)


def results_table(results: Results, system: str) -> pd.DataFrame:
    """
    Table 7 for Frozen Lake, Table 8 for Cart Pole, the like for other systems.

    :param results: of the study
    :param system: one of its systems
    :return: a row for each method and statistic: value, ends of the interval, the paper's value, the difference to it
    """
    printed = paper_table(PAPER_SYSTEMS[system].results_table).set_index("method") if system in PAPER_SYSTEMS else None
    last, mean_last = results.samples(system, "last_return"), results.samples(system, "mean_last_100")
    rows = []
    for number in last:
        for name, value in _estimates(last[number], mean_last[number]).items():
            paper = float(printed.loc[number, name]) if printed is not None else np.nan  # type: ignore[arg-type]
            rows.append((number, name, *value, paper, value.value - paper))
    return pd.DataFrame(rows, columns=["method", "statistic", "value", "low", "high", "paper", "difference"])


def _estimates(last: np.ndarray, mean_last: np.ndarray) -> dict[str, Estimate]:
    values = (
        Estimate(float(last.min()), np.nan, np.nan),
        Estimate(float(last.max()), np.nan, np.nan),
        estimate(mean, last),
        estimate(mean, mean_last),
        estimate(population_std, last),
    )
    return dict(zip(STATISTICS, values, strict=True))


def results_markdown(table: pd.DataFrame) -> str:
    """
    :param table: what :func:`results_table` returned
    :return: it in Markdown: for each method our row, the paper's row and the difference
    """
    rows = []
    for number, group in table.groupby("method"):
        by_name = group.set_index("statistic").loc[list(STATISTICS)]
        rows.append([f"Method {number}", "here", *(format_estimate(*each) for each in _triples(by_name))])
        if by_name["paper"].notna().all():
            rows.append(["", "paper", *(format_number(value) for value in by_name["paper"])])
            rows.append(["", "difference", *(f"{value:+.2f}" for value in by_name["difference"])])
    return markdown_table(["", "", *STATISTICS], rows)


def _triples(frame: pd.DataFrame) -> Iterable[tuple[float, float, float]]:
    return zip(frame["value"], frame["low"], frame["high"], strict=True)


def table_files(results: Results, gamma: float) -> dict[str, str]:
    """
    :param results: of the study
    :param gamma: the discount factor
    :return: the content of every table's files by their names
    """
    files = {"results.csv": results.cells.to_csv(index=False)}
    for system in results.systems:
        table = results_table(results, system)
        files |= _files(table_name(system), table, f"{title_of(system)}\n\n{results_markdown(table)}\n\n{NOTE}\n")
    for number, (caption, table, text) in q_value_tables(results, gamma).items():
        files |= _files(f"table_{number}", table, f"{caption}\n\n{text}\n")
    return files


def table_name(system: str) -> str:
    """
    :param system: a system of the study
    :return: the name of the files of its table of results, without the ending
    """
    return f"table_{PAPER_SYSTEMS[system].results_table}" if system in PAPER_SYSTEMS else f"table_{file_name(system)}"


def _files(name: str, table: pd.DataFrame, text: str) -> dict[str, str]:
    return {f"{name}.csv": table.to_csv(index=False), f"{name}.md": text}
