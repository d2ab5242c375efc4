"""What the cells of a study add up to, read once, a cell at a time: memory does not grow with the runs."""

from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import stats

from sb3_adaptive_q.study.cells import NUMBERS, WINDOW, Cell, cells_of
from sb3_adaptive_q.study.storage import StudyFolder

#: Points of a curve over the episodes, where every run is kept apart
CURVE_POINTS = 300


class MethodSeries(NamedTuple):
    """
    What a method's runs did episode by episode.

    :param returns: mean over the runs, of shape (episodes,)
    :param mu: μ at the episode's end, mean over the runs, of shape (episodes,)
    :param curve_episodes: the episodes at which the curve has points, counted from 1
    :param curve: mean over the runs of the mean return of the last 100 episodes there
    :param curve_margin: half the width of its 95% confidence interval (Student's t); NaN for a single run
    """

    returns: np.ndarray
    mu: np.ndarray
    curve_episodes: np.ndarray
    curve: np.ndarray
    curve_margin: np.ndarray


class Results(NamedTuple):
    """
    :param cells: a row for each cell, with the columns ``cells.NUMBERS``
    :param series: by system and method
    :param q_tables: the table of the first run, of shape (n_states, n_actions), by system and method
    """

    cells: pd.DataFrame
    series: dict[tuple[str, int], MethodSeries]
    q_tables: dict[tuple[str, int], np.ndarray]

    @property
    def systems(self) -> list[str]:
        """The systems of the study."""
        return list(dict.fromkeys(system for system, _ in self.series))

    def methods(self, system: str) -> list[int]:
        """
        :param system: a system of the study
        :return: the methods that ran in it
        """
        return [number for name, number in self.series if name == system]

    def samples(self, system: str, column: str) -> dict[int, np.ndarray]:
        """
        :param system: a system of the study
        :param column: a column of ``cells``
        :return: its values by method, in the order of the runs
        """
        of_system = self.cells[self.cells["system"] == system]
        return {int(str(number)): group[column].to_numpy() for number, group in of_system.groupby("method", sort=True)}


def read_results(folder: StudyFolder) -> Results:
    """
    :param folder: a study whose cells are all there
    :return: its results
    """
    settings = folder.settings
    sums = {(s, m): _Sums(settings.episodes) for s in settings.systems for m in settings.methods}
    q_tables, rows = {}, []
    for cell in cells_of(settings):
        data = folder.read(cell, (*NUMBERS, "returns", "mu"))
        sums[cell.system, cell.method].add(data["returns"], data["mu"])
        rows.append({name: data[name] for name in NUMBERS})
        if cell.run == 0:
            q_tables[cell.system, cell.method] = _read_q_table(folder, cell)
    frame = pd.DataFrame(rows).sort_values(["system", "method", "run"], ignore_index=True)
    return Results(frame, {key: each.series() for key, each in sums.items()}, q_tables)


def _read_q_table(folder: StudyFolder, cell: Cell) -> np.ndarray:
    data = folder.read(cell, ("q_table", "n_actions"))
    return data["q_table"].reshape(-1, data["n_actions"])


def trailing_mean(values: np.ndarray) -> np.ndarray:
    """
    :param values: of shape (episodes,)
    :return: the mean of the last 100 values at each, of fewer where there are fewer
    """
    sums = np.concatenate([[0.0], np.cumsum(values)])
    ends = np.arange(1, len(values) + 1)
    starts = np.maximum(ends - WINDOW, 0)
    return (sums[ends] - sums[starts]) / (ends - starts)


class _Sums:
    """Running sums over the runs of a method."""

    def __init__(self, episodes: int) -> None:
        self.n = 0
        self.returns = np.zeros(episodes)
        self.mu = np.zeros(episodes)
        self.points = np.unique(np.linspace(min(WINDOW, episodes), episodes, CURVE_POINTS).astype(int)) - 1
        self.curve = np.zeros(len(self.points))
        self.curve_deviations = np.zeros(len(self.points))

    def add(self, returns: np.ndarray, mu: np.ndarray) -> None:
        self.n += 1
        self.returns += returns
        self.mu += mu
        # Welford's update: sums of squares would cancel where the runs agree
        values = trailing_mean(returns)[self.points]
        change = values - self.curve
        self.curve += change / self.n
        self.curve_deviations += change * (values - self.curve)

    def series(self) -> MethodSeries:
        margin = np.full(len(self.points), np.nan)
        if self.n > 1:
            standard_error = np.sqrt(self.curve_deviations / (self.n - 1) / self.n)
            margin = stats.t.ppf(0.975, self.n - 1) * standard_error
        return MethodSeries(self.returns / self.n, self.mu / self.n, self.points + 1, self.curve, margin)
