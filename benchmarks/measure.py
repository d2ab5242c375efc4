"""Measuring by turns, and the table that is printed of it."""

import gc
import os
import platform
import time
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

#: What the figures depend on, besides the machine
PACKAGES = ("numpy", "numba", "torch", "stable-baselines3", "gymnasium")


class Contestant(NamedTuple):
    """
    One of the things that are compared.

    :param n_steps: the environment steps of one run
    :param prepare: makes a run, which is a function without arguments; not measured
    """

    n_steps: int
    prepare: Callable[[], Callable[[], Any]]


class Times(NamedTuple):
    """
    Seconds per environment step, one for each round.

    :param cpu: processor time of the whole process, which other programs on the machine disturb least
    :param wall: time by the clock
    """

    cpu: np.ndarray
    wall: np.ndarray

    def steps_per_second(self) -> str:
        """
        :return: the steps in a second of processor time, in the median
        """
        return f"{_engineering(1.0 / np.median(self.cpu))} steps/s"


class Row(NamedTuple):
    """
    A line of a table.

    :param what: what is compared
    :param cpu: a ratio of processor times for each round; ``None`` where they say nothing
    :param wall: the same by the clock
    :param asked: what the ratio shall be, in words; empty where nothing is asked
    """

    what: str
    cpu: np.ndarray | None
    wall: np.ndarray | None
    asked: str = ""


def measure(contestants: dict[str, Contestant], n_rounds: int) -> dict[str, Times]:
    """
    Run all contestants in turn, again and again, after a round that is not measured: whatever disturbs the machine for
    longer than a run disturbs neighbours alike.

    :param contestants: what to run, by name
    :param n_rounds: how often
    :return: their times
    """
    seconds: dict[str, list[tuple[float, float]]] = {name: [] for name in contestants}
    for _ in range(n_rounds + 1):
        for name, (n_steps, prepare) in contestants.items():
            cpu, wall = _time(prepare())
            seconds[name].append((cpu / n_steps, wall / n_steps))
    return {name: Times(*np.array(pairs[1:]).T) for name, pairs in seconds.items()}


def speed_ratio(what: str, times: Times, reference: Times, asked: str = "") -> Row:
    """
    :param what: what is compared
    :param times: of the one
    :param reference: of the other
    :param asked: what the ratio shall be
    :return: a row: how many times the reference's speed the first one has
    """
    return Row(what, reference.cpu / times.cpu, reference.wall / times.wall, asked)


def print_machine() -> None:
    """Print what the figures depend on."""
    load = f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown"
    print(f"{_processor()}, {os.cpu_count()} cores, load before the start {load}")
    print(f"{platform.platform()}, Python {platform.python_version()}")
    print(", ".join(f"{name} {version(name)}" for name in PACKAGES))


def print_rows(title: str, rows: Sequence[Row]) -> None:
    """
    Print a table: the median of each ratio, with its least and largest value.

    :param title: the heading
    :param rows: the lines
    """
    width = max(len(row.what) for row in rows)
    print(f"\n{title}\n{'':{width}}  {'by CPU time':22}  {'by the clock':22}  asked")
    for row in rows:
        print(f"{row.what:{width}}  {_spread(row.cpu):22}  {_spread(row.wall):22}  {row.asked}".rstrip(), flush=True)


def _time(run: Callable[[], Any]) -> tuple[float, float]:
    gc.collect()  # or the garbage of one contestant would be another's work
    cpu, wall = time.process_time(), time.perf_counter()
    run()
    return time.process_time() - cpu, time.perf_counter() - wall


def _spread(ratios: np.ndarray | None) -> str:
    if ratios is None:
        return ""
    return f"{_short(np.median(ratios))} ({_short(ratios.min())} - {_short(ratios.max())})"


def _short(ratio: float) -> str:
    return f"{ratio:.0f}" if abs(ratio) >= 100.0 else f"{ratio:.3g}"


def _engineering(value: float) -> str:
    for unit, name in ((1e6, "M"), (1e3, "k")):
        if value >= unit:
            return f"{value / unit:.3g} {name}"
    return f"{value:.3g}"


def _processor() -> str:
    """The model of the processor, which Python's own ``platform`` does not know on Linux."""
    information = Path("/proc/cpuinfo")
    lines = information.read_text().splitlines() if information.exists() else []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()
