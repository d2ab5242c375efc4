"""What the runs of a study add up to."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd

from sb3_adaptive_q.experiments.cells import Cell
from sb3_adaptive_q.experiments.episodes import NUMBERS, WINDOW
from sb3_adaptive_q.experiments.statistics import BOOTSTRAP_SEED, band
from sb3_adaptive_q.experiments.storage import ResultFolder

#: Points of a curve over the episodes, where every run is kept apart
CURVE_POINTS = 300
#: Bootstrap samples of a curve
CURVE_RESAMPLES = 1000


class Series(NamedTuple):
    """
    What the runs of a method did episode by episode, as far as all of them came.

    :param returns: mean over the runs, of shape (episodes,)
    :param mu: μ at the episode's end, mean over the runs, of shape (episodes,)
    :param curve_episodes: the episodes at which the curve has points, counted from 1
    :param curve: mean over the runs of the mean return of the last 100 episodes there
    :param low: the lower end of its 95% bootstrap interval; NaN for a single run
    :param high: the upper end
    """

    returns: np.ndarray
    mu: np.ndarray
    curve_episodes: np.ndarray
    curve: np.ndarray
    low: np.ndarray
    high: np.ndarray


class Results(NamedTuple):
    """
    :param runs: a row for each run: system, method, run, and the columns ``episodes.NUMBERS``
    :param series: by system and method
    :param q_tables: the table of the first run, of shape (n_states, n_actions), by system and method
    """

    runs: pd.DataFrame
    series: dict[tuple[str, str], Series]
    q_tables: dict[tuple[str, str], np.ndarray]

    @property
    def systems(self) -> list[str]:
        """The systems of the study."""
        return list(dict.fromkeys(system for system, _ in self.series))

    def methods(self, system: str) -> list[str]:
        """
        :param system: a system of the study
        :return: the methods that ran in it
        """
        return [method for name, method in self.series if name == system]

    def samples(self, system: str, column: str) -> dict[str, np.ndarray]:
        """
        :param system: a system of the study
        :param column: a column of ``runs``
        :return: its values by method, in the order of the runs
        """
        of_system = self.runs[self.runs["system"] == system]
        return {method: of_system.loc[of_system["method"] == method, column].to_numpy() for method in self.methods(system)}


def read_results(folder: ResultFolder, cells: Sequence[Cell]) -> Results:
    """
    :param folder: a folder
    :param cells: those in it that count, by system, method and run
    :return: what they add up to
    """
    groups: dict[tuple[str, str], list[Cell]] = {}
    for cell in cells:
        groups.setdefault((cell.labels["system"], cell.labels["method"]), []).append(cell)
    results = Results(pd.DataFrame(), {}, {})
    rows = []
    for key, group in groups.items():
        runs = [{name: values[0] for name, values in folder.read(cell, (*NUMBERS, "returns", "mu")).items()} for cell in group]
        rows += [{**cell.labels, **{name: run[name] for name in NUMBERS}} for cell, run in zip(group, runs, strict=True)]
        results.series[key] = make_series([run["returns"] for run in runs], [run["mu"] for run in runs])
        first = folder.read(group[0], ("q_table", "n_actions"))
        results.q_tables[key] = first["q_table"][0].reshape(-1, first["n_actions"][0])
    return results._replace(runs=pd.DataFrame(rows))


def make_series(returns: Sequence[np.ndarray], mu: Sequence[np.ndarray]) -> Series:
    """
    :param returns: of every episode, of each run
    :param mu: μ at every episode's end, of each run
    :return: the series of the method
    """
    episodes = min(map(len, returns))
    points = np.unique(np.linspace(min(WINDOW, episodes), episodes, CURVE_POINTS).astype(int)) - 1
    curves = np.stack([trailing_mean(run[:episodes])[points] for run in returns])
    low = high = np.full(len(points), np.nan)
    if len(curves) > 1:
        draws = np.random.default_rng(BOOTSTRAP_SEED).multinomial(
            len(curves), np.full(len(curves), 1.0 / len(curves)), size=CURVE_RESAMPLES
        )
        low, high = band(draws @ curves / len(curves))
    mean_returns, mean_mu = (np.mean([run[:episodes] for run in runs], axis=0) for runs in (returns, mu))
    return Series(mean_returns, mean_mu, points + 1, curves.mean(axis=0), low, high)


def trailing_mean(values: np.ndarray) -> np.ndarray:
    """
    :param values: of shape (episodes,)
    :return: the mean of the last 100 values at each, of fewer where there are fewer
    """
    sums = np.concatenate([[0.0], np.cumsum(values)])
    ends = np.arange(1, len(values) + 1)
    starts = np.maximum(ends - WINDOW, 0)
    return (sums[ends] - sums[starts]) / (ends - starts)
