"""
The file of a saved model, format 2: a zip whose members are stored without compression.

- ``data``: plain data, as JSON
- ``arrays.npz``: the arrays, without Python objects; ``data`` has the type and the shape of each
- ``_stable_baselines3_version`` and ``system_info.txt``, as Stable-Baselines3 writes them
- ``checksums.json``: the SHA-256 of each of the others

A file is checked against all of this before it is used, and nothing in it is executed.
"""

import hashlib
import io
import json
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import psutil
import stable_baselines3
from stable_baselines3.common.save_util import open_path
from stable_baselines3.common.utils import get_system_info

from sb3_adaptive_q.atomic import written_whole
from sb3_adaptive_q.saved_values import ARRAY_KINDS

FORMAT_VERSION = 2
#: The largest size of ``data``, in bytes. A million episodes in the log's window take half of it
MOST_DATA = 2**27

DATA, ARRAYS, SB3_VERSION, SYSTEM_INFO, CHECKSUMS = (
    "data", "arrays.npz", "_stable_baselines3_version", "system_info.txt", "checksums.json"
)  # fmt: skip
#: Errors that Python raises if data are not as expected
UNEXPECTED = (ArithmeticError, AssertionError, AttributeError, LookupError, RuntimeError, TypeError, ValueError)
MEMBERS = frozenset((DATA, ARRAYS, SB3_VERSION, SYSTEM_INFO, CHECKSUMS))


class HoldsPickles(ValueError):
    """The file has Stable-Baselines3's own format, as in format 1. Reading it may execute code that it contains."""


class Archive(NamedTuple):
    """
    The contents of a file.

    :param name: the name of the file in messages
    :param data: plain data; see :mod:`sb3_adaptive_q.model_files`
    :param arrays: the arrays by name
    :param system_info: the system that wrote it, as a text
    """

    name: str
    data: dict[str, Any]
    arrays: dict[str, np.ndarray]
    system_info: str


def write_archive(path: Any, data: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
    """
    Write a file, whole or not at all.

    :param path: a path or a binary file, as in SB3's ``save``: a path without a suffix gets ``.zip``
    :param data: plain data
    :param arrays: the arrays by name
    :raises OSError: if the file cannot be written; an older file of that name is unchanged
    :raises ValueError: if there are too many plain data
    """
    arrays = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    shapes = {name: [array.dtype.str, list(array.shape)] for name, array in arrays.items()}
    text = json.dumps({"format_version": FORMAT_VERSION, **data, "arrays": shapes}, allow_nan=False).encode()
    if len(text) > MOST_DATA:
        raise ValueError(f"A file may have {MOST_DATA} bytes of plain data, but the model has {len(text)}: `exclude` some.")
    packed = io.BytesIO()
    np.savez(packed, **arrays)  # type: ignore[arg-type]
    members = {
        DATA: text,
        ARRAYS: packed.getbuffer(),
        SB3_VERSION: stable_baselines3.__version__.encode(),
        SYSTEM_INFO: _system_info(),
    }
    if isinstance(path, str | Path):
        with written_whole(_destination(Path(path))) as file:
            _write_members(file, members)
    else:
        _write_members(open_path(path, "w"), members)


@cache
def _system_info() -> bytes:
    """The system as a text. It is cached, because SB3 searches for gym every time, which is slower than writing a model."""
    return get_system_info(print_info=False)[1].encode()


def _destination(path: Path) -> Path:
    """The path to which SB3's ``save`` would write, with the same warnings."""
    if path.suffix == "":
        path = Path(f"{path}.zip")
    if path.is_dir():
        warnings.warn(f"Path '{path}' is a folder. Will save instead to {path}_2", stacklevel=5)
        path = Path(f"{path}_2")
    if not path.parent.exists():
        warnings.warn(f"Path '{path.parent}' does not exist. Will create it.", stacklevel=5)
        path.parent.mkdir(exist_ok=True, parents=True)
    return path


def _write_members(file: Any, members: dict[str, Any]) -> None:
    sums = {name: hashlib.sha256(content).hexdigest() for name, content in members.items()}
    with zipfile.ZipFile(file, "w") as archive:
        for name, content in {**members, CHECKSUMS: json.dumps(sums).encode()}.items():
            with archive.open(name, "w", force_zip64=True) as member:
                member.write(content)


def name_of(file: Any) -> str:
    """
    :param file: a path, or a file
    :return: its name in messages
    """
    return str(file) if isinstance(file, str | Path) else str(getattr(file, "name", "that was given"))


def read_archive(path: Any) -> Archive:
    """
    Read a file, and check it.

    :param path: a path, with or without ``.zip``, or a binary file
    :return: what it holds
    :raises HoldsPickles: if it is a file of SB3's own format
    :raises ValueError: if it is damaged, cut off or of another kind. The message names the file and what is wrong
    """
    file = open_path(path, "r", suffix="zip")
    name = name_of(file)
    try:
        with refusing(name, "is damaged, or is not a saved model", (Exception,)):  # what zipfile may raise is not documented
            archive = zipfile.ZipFile(file)
            members = archive.infolist()
        with archive:
            _check_members(name, members, _size_of(file))
            with refusing(name, "is damaged", (Exception,)):
                contents = {member.filename: archive.read(member) for member in members}
            _check_sums(name, contents)
    finally:
        if isinstance(path, str | Path):
            file.close()
    with refusing(name, "is not a saved model of this package"):
        data = json.loads(contents[DATA])
        _check_version(data)
        arrays = _read_arrays(contents[ARRAYS], data["arrays"])
    return Archive(name, data, arrays, contents[SYSTEM_INFO].decode(errors="replace"))


@contextmanager
def refusing(name: str, what: str, kinds: tuple[type[Exception], ...] = UNEXPECTED) -> Iterator[None]:
    """
    Turn errors into a ValueError that names the file.

    :param name: the name of the file
    :param what: what is wrong with the file
    :param kinds: the errors to turn
    :return: a context manager
    """
    try:
        yield
    except kinds as error:
        reason = f"it has no {error}" if isinstance(error, KeyError) else str(error) or type(error).__name__
        raise ValueError(f"The file {name} {what}: {reason.rstrip('.')}.") from error


def _size_of(file: Any) -> int:
    file.seek(0, io.SEEK_END)
    return int(file.tell())


def _check_members(name: str, members: list[zipfile.ZipInfo], size: int) -> None:
    """Check, before anything is read, that the file has exactly these members, and that they are no larger than it is."""
    names = [member.filename for member in members]
    if any(each.endswith(".pth") for each in names):
        raise HoldsPickles(
            f"The file {name} holds pickled objects, as files of Stable-Baselines3 and of this package's first version do. "
            "Reading them may execute code in the file. If you trust its origin, pass `allow_pickle=True` to `load`."
        )
    if len(names) != len(MEMBERS) or set(names) != MEMBERS:
        listed = ", ".join(map(repr, names[:10])) + (", ..." if len(names) > 10 else "")
        expected = ", ".join(sorted(MEMBERS))
        raise ValueError(f"The file {name} is damaged, or is not a saved model: its members are {listed}, not {expected}.")
    if not _hold_no_more_than(members, size):
        raise ValueError(f"The file {name} is damaged or hostile: its members are larger than the file itself.")
    if 2 * size > psutil.virtual_memory().available:
        raise MemoryError(f"Reading the file {name} takes {2 * size / 2**30:.1f} GiB of memory, but less is free.")
    if next(member.file_size for member in members if member.filename == DATA) > MOST_DATA:
        raise ValueError(f"The file {name} is not a saved model: it has more than {MOST_DATA} bytes of plain data.")


def _hold_no_more_than(members: list[zipfile.ZipInfo], size: int) -> bool:
    as_they_are = all(each.compress_type == zipfile.ZIP_STORED and each.file_size == each.compress_size for each in members)
    return as_they_are and sum(each.file_size for each in members) <= size


def _check_sums(name: str, contents: dict[str, bytes]) -> None:
    with refusing(name, "is damaged"):
        sums = json.loads(contents[CHECKSUMS])
        for member in sorted(MEMBERS - {CHECKSUMS}):
            if hashlib.sha256(contents[member]).hexdigest() != sums[member]:
                raise ValueError(f"the checksum of {member!r} does not match its contents")


def _check_version(data: Any) -> None:
    version = data["format_version"]
    if not isinstance(version, int) or isinstance(version, bool) or version < 1:
        raise ValueError(f"its format version must be a whole number of at least 1, but is {version!r}")
    if version > FORMAT_VERSION:
        raise ValueError(
            f"it has format version {version}, but this package reads versions up to {FORMAT_VERSION}: please update it"
        )
    if version < FORMAT_VERSION:
        raise ValueError(f"it has format version {version}, but the members of version {FORMAT_VERSION}")


def _read_arrays(content: bytes, shapes: dict[str, Any]) -> dict[str, np.ndarray]:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = archive.infolist()
        if not _hold_no_more_than(members, len(content)):
            raise ValueError("its arrays are larger than the file itself")
        if sorted(each.filename for each in members) != sorted(f"{name}.npy" for name in shapes):
            raise ValueError("its arrays are not those that `data` lists")
        return {name: _read_array(archive, name, np.dtype(kind), tuple(shape)) for name, (kind, shape) in shapes.items()}


def _read_array(archive: zipfile.ZipFile, name: str, dtype: np.dtype[Any], shape: tuple[int, ...]) -> np.ndarray:
    """Read an array, if `data`, header and length agree. So no array takes more memory than the file has bytes."""
    member = archive.getinfo(f"{name}.npy")
    with archive.open(member) as file:
        version = np.lib.format.read_magic(file)
        header = np.lib.format.read_array_header_1_0(file) if version == (1, 0) else None
        size = member.file_size - file.tell()
    if dtype.kind not in ARRAY_KINDS or header != (shape, False, dtype) or size != prod(shape) * dtype.itemsize:
        raise ValueError(f"the array {name!r} is not of {dtype} and the shape {shape}, as `data` lists it")
    with archive.open(member) as file:
        return np.lib.format.read_array(file, allow_pickle=False)
