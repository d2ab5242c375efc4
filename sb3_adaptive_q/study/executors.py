"""Where cells are run: processes of this machine, or the workers of a Dask cluster."""

import gc
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.connection import wait

import torch as th

from sb3_adaptive_q.study.errors import StudyError

#: How long to wait for a scheduler to answer, in seconds
CONNECTION_TIMEOUT = 10.0


@dataclass(frozen=True)
class Workers:
    """
    :param executor: what takes the cells
    :param count: tells how many cells can run at the same time, which changes as a cluster grows or shrinks
    :param are_local: whether they see the files of this machine
    """

    executor: Executor
    count: Callable[[], int]
    are_local: bool


@contextmanager
def local_workers(count: int | None) -> Iterator[Workers]:
    """
    Processes of this machine, made as the platform makes them by default.

    :param count: how many; ``None`` for one for each core that this process may use
    :return: the workers, until the context ends
    """
    number = count or _available_cores()
    # A forked process would else tidy up what this one has left lying about: the sockets of a Dask client, for instance
    gc.freeze()
    try:
        with ProcessPoolExecutor(number, initializer=_begin_worker) as executor:
            yield Workers(executor, lambda: number, are_local=True)
    finally:
        gc.unfreeze()


@contextmanager
def dask_workers(address: str) -> Iterator[Workers]:
    """
    The workers of a Dask cluster that is running.

    :param address: of its scheduler, such as ``tcp://10.0.0.5:8786``
    :return: the workers, until the context ends
    :raises StudyError: if Dask is not installed, or no scheduler answers
    """
    try:
        from distributed import Client
    except ImportError as error:
        raise StudyError("--dask needs the packages of the extra `dask`: pip install 'sb3-adaptive-q[dask]'.") from error
    try:
        client = Client(address, timeout=CONNECTION_TIMEOUT)
    except (OSError, ValueError) as error:
        raise StudyError(
            f"No Dask scheduler answers at {address} ({error}): check the address and that `dask scheduler` is running."
        ) from error
    with client:
        yield Workers(client.get_executor(), lambda: max(1, sum(client.ncores().values())), are_local=False)


def _available_cores() -> int:
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _begin_worker() -> None:
    # An interrupt from the keyboard reaches every process; the parent lets the cells that are running finish
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    # One core each, and no pool of threads that a forked process could inherit half of
    th.set_num_threads(1)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A pool's worker that has lost its parent would wait for work for ever."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    wait([parent.sentinel])
    os._exit(1)
