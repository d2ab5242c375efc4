"""Runs the cells that are missing, and stores each as it comes; joblib provides threads, processes or a Dask cluster."""

import os
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, CancelledError
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from joblib import Parallel, cpu_count, delayed, parallel_config
from joblib.externals.loky import get_reusable_executor
from joblib.parallel import get_active_backend
from tqdm import tqdm

from sb3_adaptive_q.checks import EXECUTION
from sb3_adaptive_q.experiments.cells import Cell, Outcome, run_cell
from sb3_adaptive_q.experiments.design import check_options
from sb3_adaptive_q.experiments.errors import ExperimentError
from sb3_adaptive_q.experiments.storage import ResultFolder
from sb3_adaptive_q.experiments.versions import everything_of

#: How long to wait for a scheduler, in seconds
CONNECTION_TIMEOUT = 10.0
#: How the progress bar looks
BAR: Any = {"unit_scale": True, "smoothing": 0.05, "mininterval": 0.5}

Run = Callable[[Cell, Mapping[str, str]], Outcome]


@dataclass(frozen=True, kw_only=True)
class Execution:
    """
    How an experiment is carried out. These options do not change its results.

    :param output: folder of the results; an interrupted experiment continues when it is started again with the same folder
    :param workers: number of runs at the same time; default: one for each core
    :param dask: address of the scheduler of a Dask cluster that runs everything, such as tcp://10.0.0.5:8786
    :param progress: show a progress bar with the time left
    """

    output: Path = Path("results")
    workers: int | None = None
    dask: str | None = None
    progress: bool = True

    def __post_init__(self) -> None:
        check_options(self, EXECUTION)


@dataclass(frozen=True)
class Failure:
    """
    :param cell: that failed
    :param reason: why
    """

    cell: Cell
    reason: str


def run_missing(
    cells: Sequence[Cell],
    folder: ResultFolder,
    execution: Execution,
    in_threads: bool = False,
    title: str = "",
    unit: str = "run",
) -> list[Failure]:
    """
    Run every cell that its folder does not hold yet, in an order of no meaning: so the time left can be told early.

    :param cells: the cells of an experiment
    :param folder: its folder
    :param execution: how to carry it out
    :param in_threads: whether threads will do instead of processes: where the cells spend most of their time in machine code
    :param title: what stands before the progress bar
    :param unit: of the cells' costs
    :return: the cells that failed, and why; they are run again the next time
    :raises ExperimentError: if a worker dies, the cluster is lost or refused, or a cell cannot be stored; the cells that are
        done by then are stored
    """
    in_order = sorted({cell.key: cell for cell in cells}.values(), key=lambda cell: cell.key)
    missing = [cell for cell in in_order if not folder.has(cell)]
    if not missing:
        return []
    total = sum(cell.cost for cell in in_order)
    done = total - sum(cell.cost for cell in missing)
    failures = []
    kind = "dask" if execution.dask else "threading" if in_threads or execution.workers == 1 else "loky"
    with (
        _workers(execution, kind) as parallel,
        tqdm(desc=title or None, unit=unit, total=total, initial=done, disable=not execution.progress, **BAR) as bar,
    ):
        for outcome in _outcomes(parallel, missing, _run_in_process if kind == "loky" else run_cell):
            if outcome.failure:
                failures.append(Failure(outcome.cell, outcome.failure))
            else:
                folder.write(f"cells/{outcome.cell.key}.parquet", outcome.content)
            bar.update(outcome.cell.cost)
    return failures


def _outcomes(parallel: Parallel, cells: Sequence[Cell], run: Run) -> Iterator[Outcome]:
    wanted = {names: everything_of(names) for names in {cell.names for cell in cells}}
    try:
        yield from parallel(delayed(run)(cell, wanted[cell.names]) for cell in cells)
    except TimeoutError as error:
        raise ExperimentError(f"The Dask cluster has no worker: please start some with `dask worker`. ({error})") from error
    except BrokenExecutor as error:
        raise _dead_worker(error) from error
    except CancelledError as error:
        raise ExperimentError(
            "The Dask scheduler was lost: check that it is running, and start the command again to continue."
        ) from error


@contextmanager
def _workers(execution: Execution, kind: str) -> Iterator[Parallel]:
    options: dict[str, Any] = {"return_as": "generator_unordered", "batch_size": 1}
    if execution.dask:
        with _dask_client(execution.dask) as client, parallel_config("dask", client=client):
            backend: Any = get_active_backend()[0]
            count = backend.effective_n_jobs
            # Joblib would not use a cluster of one worker, which may grow; and all cells are handed out at once, so that
            # workers that join later have something to do
            backend.effective_n_jobs = lambda n_jobs: max(2, count(n_jobs))
            yield Parallel(n_jobs=-1, pre_dispatch="all", **options)
        return
    with warnings.catch_warnings():
        # Joblib replaces a worker that holds much more memory than at its start, as one that has compiled many loops does
        warnings.filterwarnings("ignore", "A worker stopped while some jobs were given")
        yield Parallel(n_jobs=execution.workers or cpu_count(), backend=kind, pre_dispatch="3*n_jobs", **options)
    if kind == "loky":
        # They would wait five minutes for more work, and hold half a GiB each while the results are compared
        get_reusable_executor().shutdown()


def in_processes(function: Callable[..., Any], arguments: Iterable[tuple[Any, ...]], workers: int | None) -> Iterator[Any]:
    """
    Call a function for other work than cells, such as drawing.

    :param function: it and its arguments must be picklable
    :param arguments: of each call
    :param workers: the number of processes; ``None``: one for each core; with 1 the calls are made in this process
    :return: what the calls return, in order
    :raises ExperimentError: if a worker dies
    """
    try:
        yield from Parallel(n_jobs=workers or cpu_count(), return_as="generator")(
            delayed(_call_in_process)(function, each, os.getpid()) for each in arguments
        )
    except BrokenExecutor as error:
        raise _dead_worker(error) from error


def _call_in_process(function: Callable[..., Any], arguments: tuple[Any, ...], caller: int) -> Any:
    if os.getpid() != caller:
        _end_with_parent()
    return function(*arguments)


def _dead_worker(error: BrokenExecutor) -> ExperimentError:
    return ExperimentError(
        f"A worker died ({error}), perhaps because memory ran out. Start the command again to continue; "
        "--workers 1 needs the least memory."
    )


def _run_in_process(cell: Cell, wanted: Mapping[str, str]) -> Outcome:
    _end_with_parent()
    return run_cell(cell, wanted)


@cache
def _end_with_parent() -> None:
    """A worker process that has lost its parent would wait for work for minutes."""
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _dask_client(address: str) -> Iterator[Any]:
    try:
        from distributed import Client
    except ImportError as error:
        raise ExperimentError("--dask needs the packages of the extra `dask`: pip install 'sb3-adaptive-q[dask]'.") from error
    try:
        client = Client(address, timeout=CONNECTION_TIMEOUT)
    except (OSError, ValueError) as error:
        raise ExperimentError(
            f"No Dask scheduler answers at {address} ({error}): check the address and that `dask scheduler` is running."
        ) from error
    with client:
        yield client
