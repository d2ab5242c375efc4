"""The paper's tables, ours beside the printed ones."""

import gymnasium as gym
import numpy as np
import pandas as pd

from sb3_adaptive_q.experiments.text import format_estimate, format_number, markdown_table
from sb3_adaptive_q.experiments.paper.comparison import estimate, mean, population_std
from sb3_adaptive_q.experiments.paper.paper_data import paper_table
from sb3_adaptive_q.experiments.paper.results import Results
from sb3_adaptive_q.experiments.paper.settings import CART_POLE, FROZEN_LAKE, PAPER_METHODS, PAPER_SYSTEMS
from sb3_adaptive_q.experiments.statistics import Estimate
from sb3_adaptive_q.planning import action_values, value_iteration

STATISTICS = ("min", "max", "avg", "avg_100", "std")

NOTE = (
    "All numbers are returns, the sum of the rewards of an episode. min, max, avg and std are over the return of the last "
    "episode of every run (std with divisor n); avg_100 is the mean over the runs of the mean return of the last 100 "
    "episodes. Brackets hold 95 % percentile bootstrap intervals; there is no valid one for the smallest and the largest "
    "value of a sample."
)


def results_table(results: Results, system: str) -> pd.DataFrame:
    """
    Table 7 for Frozen Lake, Table 8 for Cart Pole, the like for other systems.

    :param results: of the study
    :param system: one of its systems
    :return: a row for each method and statistic: value, ends of the interval, the paper's value, the difference to it
    """
    printed = {}
    if system in PAPER_SYSTEMS:
        table = paper_table(PAPER_SYSTEMS[system].results_table).set_index("method")
        printed = {(f"Method {number}", name): value for name in STATISTICS for number, value in table[name].items()}
    last, mean_last = results.samples(system, "last_return"), results.samples(system, "mean_last_100")
    rows = []
    for method in last:
        for name, value in zip(STATISTICS, _estimates(last[method], mean_last[method]), strict=True):
            paper = float(printed.get((method, name), np.nan))
            rows.append((method, name, *value, paper, value.value - paper))
    return pd.DataFrame(rows, columns=["method", "statistic", "value", "low", "high", "paper", "difference"])


def _estimates(last: np.ndarray, mean_last: np.ndarray) -> list[Estimate]:
    extremes = [Estimate(float(extreme), np.nan, np.nan) for extreme in (last.min(), last.max())]
    return [*extremes, estimate(mean, last), estimate(mean, mean_last), estimate(population_std, last)]


def results_markdown(table: pd.DataFrame) -> str:
    """
    :param table: what :func:`results_table` returned
    :return: it in Markdown: for each method our row, the paper's row and the difference
    """
    rows = []
    for method, group in table.groupby("method", sort=False):
        triples = group[["value", "low", "high"]].to_numpy()
        rows.append([str(method), "here", *(format_estimate(*triple) for triple in triples)])
        if group["paper"].notna().all():
            rows.append([str(method), "paper", *map(format_number, group["paper"])])
            rows.append([str(method), "difference", *(f"{value:+.2f}" for value in group["difference"])])
    return markdown_table(["method", "source", *STATISTICS], rows)


def optimal_values(system: str, gamma: float) -> np.ndarray:
    """
    :param system: the id of an environment with a transition table
    :param gamma: the discount factor
    :return: Q*, of shape (n_states, n_actions)
    """
    env = gym.make(system)
    return np.asarray(action_values(env, value_iteration(env, gamma), gamma))


def q_value_tables(results: Results, gamma: float) -> dict[int, tuple[str, pd.DataFrame, str]]:
    """
    :param results: of the study
    :param gamma: the discount factor
    :return: Tables 1 and 6, as far as the study has their systems: caption, table, and the table in Markdown
    """
    tables: dict[int, tuple[str, pd.DataFrame, str]] = {}
    for system, make in ((FROZEN_LAKE, _lake_table), (CART_POLE, _cart_pole_table)):
        of_paper = [method for method in results.methods(system) if method in PAPER_METHODS]
        if of_paper:
            best = PAPER_SYSTEMS[system].best_method
            method = best if best in of_paper else of_paper[0]
            caption, table, text = make(results.q_tables[system, method], gamma)
            tables[PAPER_SYSTEMS[system].q_table] = (caption.format(method), table, text)
    return tables


def _lake_table(q_table: np.ndarray, gamma: float) -> tuple[str, pd.DataFrame, str]:
    printed = paper_table(1).set_index("state")
    states, actions = np.divmod(np.arange(q_table.size), q_table.shape[1])
    paper = printed.reindex(range(len(q_table))).to_numpy().ravel()
    optimal = optimal_values(FROZEN_LAKE, gamma)
    columns = {"state": states, "action": actions, "learned": q_table.ravel(), "optimal": optimal.ravel(), "paper": paper}
    table = pd.DataFrame(columns)
    rows = [
        [str(state), *(" / ".join("–" if np.isnan(x) else f"{x:.3f}" for x in entry) for entry in group.to_numpy()[:, 2:])]
        for state, group in table.groupby("state")
    ]
    caption = "Frozen Lake: Q learned by {} in run 0 / optimal Q by value iteration / the paper's"
    return caption, table, markdown_table(["state", "← 0", "↓ 1", "→ 2", "↑ 3"], rows)


def _cart_pole_table(q_table: np.ndarray, gamma: float) -> tuple[str, pd.DataFrame, str]:
    table = paper_table(6)
    exists = table["state"] < len(q_table)
    learned = q_table[table["state"].where(exists, 0)]
    learned[~exists] = np.nan
    table = table.assign(learned_0=learned[:, 0], learned_1=learned[:, 1])
    table = table[["state", "learned_0", "learned_1", "column_2", "column_3"]]
    rows = [
        [str(int(state)), *("no such state" if np.isnan(x) else f"{x:.2f}" for x in values)]
        for state, *values in table.itertuples(index=False)
    ]
    header = ["state", "Q(s, 0) here", "Q(s, 1) here", "paper, 2nd column", "paper, 3rd column"]
    return "Cart Pole: Q learned by {} in run 0, in the rows that the paper prints", table, markdown_table(header, rows)
