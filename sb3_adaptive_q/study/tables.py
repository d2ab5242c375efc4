"""The paper's tables of results and of Q values, ours beside the printed ones."""

from collections.abc import Iterable

import numpy as np
import pandas as pd

from sb3_adaptive_q.study.lake import optimal_values
from sb3_adaptive_q.study.paper_data import paper_table
from sb3_adaptive_q.study.results import Results
from sb3_adaptive_q.study.settings import CART_POLE, FROZEN_LAKE
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


def q_table_of(results: Results, system: str) -> tuple[int, np.ndarray]:
    """
    :param results: of the study
    :param system: one of its systems
    :return: the method that the paper calls the best there, or else the study's first, and the table its first run learned
    """
    methods = results.methods(system)
    best = PAPER_SYSTEMS[system].best_method if system in PAPER_SYSTEMS else methods[0]
    number = best if best in methods else methods[0]
    return number, results.q_tables[system, number]


def lake_table(q_table: np.ndarray, gamma: float) -> pd.DataFrame:
    """
    Table 1: the Q values of Frozen Lake.

    :param q_table: the learned table
    :param gamma: the discount factor
    :return: a row for each state and action: learned, optimal (value iteration), the paper's where it prints one
    """
    optimal = optimal_values(FROZEN_LAKE, gamma)
    printed = paper_table(1).set_index("state")
    states, actions = np.divmod(np.arange(q_table.size), q_table.shape[1])
    paper = [
        printed.loc[state, f"action_{action}"] if state in printed.index else np.nan
        for state, action in np.ndindex(q_table.shape)
    ]
    columns = {"state": states, "action": actions, "learned": q_table.ravel(), "optimal": optimal.ravel(), "paper": paper}
    return pd.DataFrame(columns)


def lake_markdown(table: pd.DataFrame) -> str:
    """
    :param table: what :func:`lake_table` returned
    :return: it in Markdown, each entry as learned / optimal / the paper's
    """
    rows = []
    for state, group in table.groupby("state"):
        entries = group[["learned", "optimal", "paper"]].to_numpy()
        rows.append([str(state), *(" / ".join("–" if np.isnan(x) else f"{x:.3f}" for x in entry) for entry in entries)])
    return markdown_table(["State", "← 0", "↓ 1", "→ 2", "↑ 3"], rows)


def cart_pole_table(q_table: np.ndarray) -> pd.DataFrame:
    """
    Table 6: the Q values of Cart Pole, in the rows that the paper prints.

    :param q_table: the learned table
    :return: a row for each: state, our values of the two actions (NaN where there is no such state), the paper's columns
    """
    table = paper_table(6)
    exists = table["state"] < len(q_table)
    learned = q_table[table["state"].where(exists, 0)]
    learned[~exists] = np.nan
    return table.assign(learned_0=learned[:, 0], learned_1=learned[:, 1])[
        ["state", "learned_0", "learned_1", "column_2", "column_3"]
    ]


def cart_pole_markdown(table: pd.DataFrame) -> str:
    """
    :param table: what :func:`cart_pole_table` returned
    :return: it in Markdown
    """
    header = ["State", "Q(s, 0) here", "Q(s, 1) here", "paper, 2nd column", "paper, 3rd column"]
    rows = [
        [str(int(state)), *("no such state" if np.isnan(x) else f"{x:.2f}" for x in values)]
        for state, *values in table.itertuples(index=False)
    ]
    return markdown_table(header, rows)


def q_value_tables(results: Results, gamma: float) -> dict[int, tuple[str, pd.DataFrame, str]]:
    """
    :param results: of the study
    :param gamma: the discount factor
    :return: Tables 1 and 6, as far as the study has their systems: caption, table, and the table in Markdown
    """
    tables: dict[int, tuple[str, pd.DataFrame, str]] = {}
    if FROZEN_LAKE in results.systems:
        number, q_table = q_table_of(results, FROZEN_LAKE)
        caption = f"Frozen Lake: Q learned by Method {number} in run 0 / Q* by value iteration / the paper's"
        table = lake_table(q_table, gamma)
        tables[1] = (caption, table, lake_markdown(table))
    if CART_POLE in results.systems:
        number, q_table = q_table_of(results, CART_POLE)
        table = cart_pole_table(q_table)
        tables[6] = (f"Cart Pole: Q learned by Method {number} in run 0", table, cart_pole_markdown(table))
    return tables


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


def markdown_table(header: list[str], rows: list[list[str]]) -> str:
    """
    :param header: the titles of the columns
    :param rows: the cells
    :return: a table in Markdown, its columns padded so that it reads well as plain text too
    """
    lines = [header, *rows]
    widths = [max(3, *(len(line[i]) for line in lines)) for i in range(len(header))]
    padded = ["| " + " | ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) + " |" for line in lines]
    rule = "|" + "|".join("-" * (width + 2) for width in widths) + "|"
    return "\n".join([padded[0], rule, *padded[1:]])


def format_number(value: float) -> str:
    """
    :param value: a number
    :return: it with as many decimals as it needs, at most two
    """
    return f"{value:.2f}".rstrip("0").rstrip(".") if np.isfinite(value) else "–"


def format_estimate(value: float, low: float, high: float) -> str:
    """
    :param value: of a statistic
    :param low: the lower end of its interval, or NaN for none
    :param high: the upper end
    :return: the value with its interval in brackets
    """
    if np.isnan(low):
        return format_number(value)
    return f"{value:.2f} [{low:.2f}, {high:.2f}]"
