"""Files that are written whole or not at all."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from sb3_adaptive_q.study.errors import StudyError


def write_atomically(path: Path, content: bytes) -> None:
    """
    Write a file so that at every moment, a power cut included, it is there whole or as it was before.

    :param path: where; missing folders are made
    :param content: what
    :raises StudyError: if it cannot be written; nothing of it is left then
    """
    temporary = temporary_of(path)
    write_temporary(temporary, content)
    commit(temporary, path)


def temporary_of(path: Path) -> Path:
    """
    :param path: of a file that is to be written
    :return: where to write it before it is whole; the name tells the process that wants it
    """
    return path.with_name(f".{path.name}.{os.getpid()}.tmp")


def write_temporary(temporary: Path, content: bytes) -> None:
    """
    The first half of :func:`write_atomically`.

    :param temporary: where to write
    :param content: what
    :raises StudyError: if it cannot be written; nothing of it is left then
    """
    with _nothing_left(temporary):
        temporary.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_bytes(content)


def commit(temporary: Path, path: Path) -> None:
    """
    The second half of :func:`write_atomically`.

    :param temporary: a file that was written
    :param path: the name that it is to have from now on
    :raises StudyError: if it cannot be secured on the disk; nothing of it is left then
    """
    with _nothing_left(temporary):
        with temporary.open("rb+") as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
        _sync_folder(path.parent)


@contextmanager
def _nothing_left(temporary: Path) -> Iterator[None]:
    try:
        yield
    except BaseException as error:
        with suppress(OSError):
            temporary.unlink()
        if isinstance(error, OSError):
            raise StudyError(
                f"Cannot write to {temporary.parent}: {error.strerror or error}. What was stored before is whole: make room "
                "or choose another output folder, and start again to go on."
            ) from error
        raise


def _sync_folder(folder: Path) -> None:
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
