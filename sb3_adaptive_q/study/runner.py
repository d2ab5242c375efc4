"""Runs the cells that are missing, and stores each as soon as it is there."""

from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from contextlib import AbstractContextManager
from itertools import islice
from pathlib import Path
from typing import Any

from tqdm import tqdm

from sb3_adaptive_q.study.atomic import commit, temporary_of, write_atomically, write_temporary
from sb3_adaptive_q.study.cells import Cell, cells_of, recipe_of, run_cell
from sb3_adaptive_q.study.errors import StudyError
from sb3_adaptive_q.study.executors import Workers, dask_workers, local_workers
from sb3_adaptive_q.study.storage import StudyFolder

#: Cells handed out for each worker: one that runs and some to go on with, while their results stay few
CELLS_PER_WORKER = 3


def run_missing_cells(folder: StudyFolder, workers: int | None, dask: str | None, progress_bar: bool) -> None:
    """
    Run every cell of the study that its folder does not hold yet.

    :param folder: the folder of the study
    :param workers: processes of this machine; ``None`` for one for each core
    :param dask: the address of a Dask scheduler, whose cluster is used instead; ``None`` for this machine
    :param progress_bar: whether to show one, with the time left
    :raises StudyError: if a cell fails or cannot be stored; the cells that are done by then are stored
    """
    cells = cells_of(folder.settings)
    missing = [cell for cell in cells if not folder.has(cell)]
    if not missing:
        return
    with (
        _workers(workers, dask) as pool,
        tqdm(total=len(cells), initial=len(cells) - len(missing), unit="cell", disable=not progress_bar) as bar,
    ):
        _Run(folder, pool, bar).run(missing)


def _workers(workers: int | None, dask: str | None) -> AbstractContextManager[Workers]:
    return dask_workers(dask) if dask else local_workers(workers)


class _Run:
    """The cells that are on their way, few at a time: memory does not grow with their number."""

    def __init__(self, folder: StudyFolder, pool: Workers, bar: "tqdm[Any]") -> None:
        self.folder = folder
        self.pool = pool
        self.bar = bar
        self.pending: dict[Future[Any], Cell] = {}

    def run(self, cells: list[Cell]) -> None:
        queue = iter(cells)
        try:
            self._submit(queue)
            while self.pending:
                done, _ = wait(self.pending, return_when=FIRST_COMPLETED)
                for future in done:
                    self._store(future)
                self._submit(queue)
        except BaseException:
            self._give_up()
            raise

    def _submit(self, queue: Iterator[Cell]) -> None:
        room = CELLS_PER_WORKER * self.pool.count() - len(self.pending)
        for cell in islice(queue, max(room, 0)):
            try:
                self.pending[self._begin(cell)] = cell
            except (BrokenExecutor, RuntimeError) as error:
                raise _worker_died(error) from error

    def _begin(self, cell: Cell) -> "Future[Any]":
        recipe = recipe_of(self.folder.settings, cell)
        if self.pool.are_local:
            return self.pool.executor.submit(run_cell_to_file, recipe, temporary_of(self.folder.path_of(cell)))
        return self.pool.executor.submit(run_cell, recipe)

    def _store(self, future: "Future[Any]") -> None:
        cell = self.pending.pop(future)
        try:
            content = future.result()
        except BrokenExecutor as error:
            raise _worker_died(error) from error
        except StudyError:
            raise
        except CancelledError as error:
            raise StudyError(f"The cluster dropped {cell}: is its scheduler still running? Start again to go on.") from error
        except Exception as error:
            raise StudyError(f"{cell} failed: {type(error).__name__}: {error}") from error
        path = self.folder.path_of(cell)
        if self.pool.are_local:
            commit(temporary_of(path), path)
        else:
            write_atomically(path, content)
        self.bar.update()

    def _give_up(self) -> None:
        """Call back the cells that have not begun, wait for the others, and keep them."""
        running = {future: cell for future, cell in self.pending.items() if not future.cancel()}
        wait(running)
        try:
            for future in running:
                if future.exception() is None:
                    self._store(future)
        finally:
            self.folder.remove_leftovers()


def run_cell_to_file(recipe: dict[str, Any], temporary: Path) -> None:
    """
    What a worker of this machine does. It hands the cell over in a file: one that is killed while it sends a long result
    would leave the pool waiting for the rest for ever.

    :param recipe: what decides a cell
    :param temporary: where to write it
    """
    write_temporary(temporary, run_cell(recipe))


def _worker_died(error: Exception) -> StudyError:
    return StudyError(
        f"A worker process died ({error}), perhaps for want of memory. Start again to go on; --workers 1 needs least."
    )
