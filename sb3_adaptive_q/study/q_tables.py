"""The paper's tables of Q values, ours beside the printed ones."""

import numpy as np
import pandas as pd

from sb3_adaptive_q.study.lake import optimal_values
from sb3_adaptive_q.study.markdown import markdown_table
from sb3_adaptive_q.study.paper_data import paper_table
from sb3_adaptive_q.study.results import Results
from sb3_adaptive_q.study.settings import CART_POLE, FROZEN_LAKE
from sb3_adaptive_q.study.systems import PAPER_SYSTEMS


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
