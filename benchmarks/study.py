"""The default study on two processes, against the bare loops that it cannot do without."""

import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import psutil

from benchmarks.bare_loops import make_lake_loop, make_pole_loop
from benchmarks.measure import Row, print_rows
from sb3_adaptive_q.experiments.paper.settings import CART_POLE, FROZEN_LAKE, PAPER_METHODS

WORKERS = 2
#: Steps of each bare loop that are timed
BARE_STEPS = 10_000_000


class Usage(NamedTuple):
    """
    What a study has used.

    :param cells: seconds by the clock until the last cell was stored
    :param cells_cpu: seconds of processor time until then
    :param outputs: seconds by the clock for tables, figures and report
    :param peak: memory of all its processes in bytes, shared pages counted once
    """

    cells: float
    cells_cpu: float
    outputs: float
    peak: int


def run_study(output: Path, *options: str) -> Usage:
    """
    :param output: an empty folder
    :param options: of the study's command line
    :return: what it has used
    """
    command = [sys.executable, "-m", "sb3_adaptive_q", "study", "--workers", str(WORKERS), "--output", str(output), *options]
    start, peak, samples = time.time(), 0, [(0.0, 0.0)]
    process = psutil.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    while process.poll() is None:
        peak = max(peak, _sum(process, _memory))
        samples.append((time.time(), _sum(process, lambda each: sum(each.cpu_times()[:4]))))
        time.sleep(0.2)
    end = time.time()
    if process.returncode:
        raise SystemExit(f"The study failed: {process.stderr.read()[-500:]}")
    last_cell = max(path.stat().st_mtime for path in output.rglob("*.parquet"))
    cpu = max(seconds for moment, seconds in samples if moment <= last_cell)
    return Usage(last_cell - start, cpu, end - last_cell, peak)


def _sum(process: psutil.Popen, quantity: Callable[[psutil.Process], float]) -> float:
    total = 0.0
    for each in [process, *process.children(recursive=True)]:
        try:
            total += quantity(each)
        except psutil.Error:
            continue  # it has just ended
    return total


def _memory(process: psutil.Process) -> float:
    # Where the proportional share is not known, pages that are shared count for every process
    return getattr(process.memory_full_info(), "pss", None) or process.memory_info().rss


def time_bare_loops(steps: dict[tuple[str, int], int]) -> tuple[float, float]:
    """
    :param steps: of the whole study by system and method; a constant rate stands for Methods 1 to 4, the rule of Method 7
        for the others
    :return: seconds that the bare loops take for them on one core, by the clock and of processor time
    """
    wall = cpu = 0.0
    for system, make_loop in ((FROZEN_LAKE, make_lake_loop), (CART_POLE, make_pole_loop)):
        for rule, methods in ((1, range(1, 5)), (7, range(5, 9))):
            loop = make_loop(rule)
            loop(0, 1000)
            start, cpu_start = time.perf_counter(), time.process_time()
            loop(0, BARE_STEPS)
            share = sum(steps[system, method] for method in methods) / BARE_STEPS
            wall += share * (time.perf_counter() - start)
            cpu += share * (time.process_time() - cpu_start)
    return wall, cpu


def main() -> None:
    """Print the ratios."""
    with tempfile.TemporaryDirectory() as folder:
        run_study(Path(folder, "warm"), "--runs", "1", "--episodes", "20")
        usage = run_study(Path(folder, "study"))
        cells = pd.read_csv(Path(folder, "study", "results.csv"))
    steps = {
        (str(system), PAPER_METHODS.index(str(method)) + 1): int(n)
        for (system, method), n in cells.groupby(["system", "method"])["steps"].sum().items()
    }
    wall, cpu = time_bare_loops(steps)
    rows = [
        Row(
            "cells / their bare loops on two cores",
            *_ratios(usage.cells_cpu / cpu, usage.cells / (wall / WORKERS)),
            "at most 1.6",
        ),
        Row("tables, figures and report / 20 s", None, np.array([usage.outputs / 20.0]), "at most 1"),
        Row("peak memory / 1 GiB", None, np.array([usage.peak / 2**30]), "at most 1"),
    ]
    print_rows(f"The default study on {WORKERS} processes: {usage.cells:.1f} s and {usage.outputs:.1f} s", rows)


def _ratios(cpu: float, wall: float) -> tuple[np.ndarray, np.ndarray]:
    return np.array([cpu]), np.array([wall])


if __name__ == "__main__":
    main()
