"""
The file of a saved model, format 2: a zip whose members are stored as they are.

- ``data``: plain data, as JSON
- ``arrays.npz``: the arrays, without Python objects; ``data`` says of each its type and its shape
- ``_stable_baselines3_version`` and ``system_info.txt``, as Stable-Baselines3 writes them
- ``checksums.json``: the SHA-256 of each of the others

What is read is checked against all of this before it is used, and nothing in it is executed.
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
#: More JSON than any model has: a million episodes in the log's window are half of it
MOST_DATA = 2**27

DATA, ARRAYS, SB3_VERSION, SYSTEM_INFO, CHECKSUMS = (
    "data", "arrays.npz", "_stable_baselines3_version", "system_info.txt", "checksums.json"
)  # fmt: skip
#: What Python raises where data are not as expected
UNEXPECTED = (ArithmeticError, AssertionError, AttributeError, LookupError, RuntimeError, TypeError, ValueError)
MEMBERS = frozenset((DATA, ARRAYS, SB3_VERSION, SYSTEM_INFO, CHECKSUMS))


class HoldsPickles(ValueError):
    """A file of Stable-Baselines3's own format, which format 1 was: to read it may execute what is in it."""


class Archive(NamedTuple):
    """
    What a file holds.

    :param name: what the file is called in messages
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

    :param path: where, as SB3's ``save`` takes it: a path, to which ``.zip`` is added where it has no suffix, or a binary file
    :param data: plain data
    :param arrays: the arrays by name
    :raises OSError: if the file cannot be written; what was there before is as it was
    """
    arrays = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    shapes = {name: [array.dtype.str, list(array.shape)] for name, array in arrays.items()}
    text = json.dumps({"format_version": FORMAT_VERSION, **data, "arrays": shapes}, allow_nan=False).encode()
    if len(text) > MOST_DATA:
        raise ValueError(f"The model has {len(text)} bytes of plain data, and a file may have {MOST_DATA}: `exclude` some.")
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
    """Asked for once: SB3 looks for gym every time, which takes longer than a small model takes to be written."""
    return get_system_info(print_info=False)[1].encode()


def _destination(path: Path) -> Path:
    """Where SB3's ``save`` would write, with its warnings."""
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
    :return: what to call it in messages
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
        with refusing(name, "is damaged, or no file of a model", (Exception,)):  # what zipfile may raise is not documented
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
    with refusing(name, "is no file of a model of this package"):
        data = json.loads(contents[DATA])
        _check_version(data)
        arrays = _read_arrays(contents[ARRAYS], data["arrays"])
    return Archive(name, data, arrays, contents[SYSTEM_INFO].decode(errors="replace"))


@contextmanager
def refusing(name: str, what: str, kinds: tuple[type[Exception], ...] = UNEXPECTED) -> Iterator[None]:
    """
    Let errors name a file.

    :param name: the file
    :param what: what is wrong with it
    :param kinds: the errors
    :return: a context, which raises them as a ValueError
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
    """Before anything is read: that the file has these members and no others, and that they do not unfold into more."""
    names = [member.filename for member in members]
    if any(each.endswith(".pth") for each in names):
        raise HoldsPickles(
            f"The file {name} holds pickled objects, as files of Stable-Baselines3 and of this package's first version do: to "
            "read it may execute what is in it. If you trust its origin, pass `allow_pickle=True` to `load`."
        )
    if len(names) != len(MEMBERS) or set(names) != MEMBERS:
        listed = ", ".join(map(repr, names[:10])) + (", ..." if len(names) > 10 else "")
        expected = ", ".join(sorted(MEMBERS))
        raise ValueError(f"The file {name} is damaged, or no file of a model: its members are {listed}, not {expected}.")
    if not _hold_no_more_than(members, size):
        raise ValueError(f"The file {name} is damaged or hostile: its members unfold into more than the file holds.")
    if 2 * size > psutil.virtual_memory().available:
        raise MemoryError(f"The file {name} takes {2 * size / 2**30:.1f} GiB to read, which are not free.")
    if next(member.file_size for member in members if member.filename == DATA) > MOST_DATA:
        raise ValueError(f"The file {name} is no file of a model: it has more than {MOST_DATA} bytes of plain data.")


def _hold_no_more_than(members: list[zipfile.ZipInfo], size: int) -> bool:
    as_they_are = all(each.compress_type == zipfile.ZIP_STORED and each.file_size == each.compress_size for each in members)
    return as_they_are and sum(each.file_size for each in members) <= size


def _check_sums(name: str, contents: dict[str, bytes]) -> None:
    with refusing(name, "is damaged"):
        sums = json.loads(contents[CHECKSUMS])
        for member in sorted(MEMBERS - {CHECKSUMS}):
            if hashlib.sha256(contents[member]).hexdigest() != sums[member]:
                raise ValueError(f"the checksum of {member!r} is not that of its contents")


def _check_version(data: Any) -> None:
    version = data["format_version"]
    if not isinstance(version, int) or isinstance(version, bool) or version < 1:
        raise ValueError(f"its format version is {version!r}, which is none")
    if version > FORMAT_VERSION:
        raise ValueError(
            f"it has format version {version}, and this version reads {FORMAT_VERSION}: please update the package"
        )
    if version < FORMAT_VERSION:
        raise ValueError(f"it has format version {version}, but the members of version {FORMAT_VERSION}")


def _read_arrays(content: bytes, shapes: dict[str, Any]) -> dict[str, np.ndarray]:
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = archive.infolist()
        if not _hold_no_more_than(members, len(content)):
            raise ValueError("its arrays unfold into more than the file holds")
        if sorted(each.filename for each in members) != sorted(f"{name}.npy" for name in shapes):
            raise ValueError("its arrays are not those that `data` announces")
        return {name: _read_array(archive, name, np.dtype(kind), tuple(shape)) for name, (kind, shape) in shapes.items()}


def _read_array(archive: zipfile.ZipFile, name: str, dtype: np.dtype[Any], shape: tuple[int, ...]) -> np.ndarray:
    """An array, once what is announced, its header and its length agree: so none asks for more memory than the file has."""
    member = archive.getinfo(f"{name}.npy")
    with archive.open(member) as file:
        version = np.lib.format.read_magic(file)
        header = np.lib.format.read_array_header_1_0(file) if version == (1, 0) else None
        size = member.file_size - file.tell()
    if dtype.kind not in ARRAY_KINDS or header != (shape, False, dtype) or size != prod(shape) * dtype.itemsize:
        raise ValueError(f"the array {name!r} is not of {dtype} and the shape {shape}, as it should be")
    with archive.open(member) as file:
        return np.lib.format.read_array(file, allow_pickle=False)
