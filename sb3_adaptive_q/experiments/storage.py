"""The folder of an experiment: its design, and one Parquet file for each cell, written whole or not at all."""

import json
import os
import sys
from collections.abc import Callable, Collection, Iterable, Mapping
from pathlib import Path
from typing import Any

import psutil
import pyarrow as pa
import pyarrow.parquet as pq
import yaml
from tqdm import tqdm

from sb3_adaptive_q.atomic import written_whole
from sb3_adaptive_q.experiments.cells import COLUMNS, RECIPE, Cell, columns_digest
from sb3_adaptive_q.experiments.design import read_yaml
from sb3_adaptive_q.experiments.errors import DesignError, ExperimentError
from sb3_adaptive_q.experiments.versions import versions

DESIGN_FILE = "design.yml"
#: Versions that a folder's cells must share; of the others a change is only told
STRICT = ("sb3_adaptive_q", "source")


def write_atomically(path: Path, content: bytes) -> None:
    """
    Write a file so that at every moment it is there whole or as it was before.

    :param path: where; missing folders are made
    :param content: what
    :raises ExperimentError: if it cannot be written; nothing of it is left then
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with written_whole(path) as file:
            file.write(content)
    except OSError as error:
        raise ExperimentError(
            f"Cannot write to {path.parent}: {error.strerror or error}. What was stored before is whole: make room or choose "
            "another output folder, and start the command again to continue."
        ) from error


def warn_user(text: str) -> None:
    """
    :param text: a sentence, printed above the progress bar
    """
    tqdm.write(f"Warning: {text}", file=sys.stderr)


class ResultFolder:
    """
    :param path: the folder
    :param warn: called with a sentence about what was found and repaired
    """

    def __init__(self, path: Path, warn: Callable[[str], None] = warn_user) -> None:
        self.path = path
        self.warn = warn

    def open(self, design: Mapping[str, Any], selection: Collection[str] = ()) -> None:
        """
        Make the folder this experiment's, or check that it is.

        :param design: of the experiment, as plain data
        :param selection: the names in it that only select among the cells, and may differ from one start to the next
        :raises DesignError: if the folder holds an experiment of another design or version, or something else
        """
        file = self.path / DESIGN_FILE
        if file.exists():
            self._check(file, design, selection)
        elif self.path.exists() and (not self.path.is_dir() or any(self.path.iterdir())):
            raise DesignError(
                f"{self.path} is neither empty nor the output folder of an experiment: choose another output folder."
            )
        self._remove_leftovers()
        text = yaml.safe_dump({**design, "versions": versions()}, sort_keys=False, allow_unicode=True)
        write_atomically(file, text.encode())

    def path_of(self, cell: Cell) -> Path:
        """
        :param cell: a cell
        :return: its file
        """
        return self.path / "cells" / f"{cell.key}.parquet"

    def has(self, cell: Cell) -> bool:
        """
        Look for a cell, and read all of it. A damaged file is set aside, so that the cell counts as missing.

        :param cell: a cell
        :return: whether it is there
        """
        path = self.path_of(cell)
        if not path.exists():
            return False
        try:
            table = _read(path)
            if json.loads(table.schema.metadata[RECIPE]) != json.loads(json.dumps([cell.measure, cell.recipe])):
                raise ValueError("its recipe is not that of its name")
            if table.schema.metadata[COLUMNS] != columns_digest(table):
                raise ValueError("its columns are not those that were written")
        except (pa.ArrowException, OSError, KeyError, TypeError, ValueError) as error:
            self._set_aside(path, error)
            return False
        return True

    def read(self, cell: Cell, columns: Iterable[str] | None = None) -> dict[str, list[Any]]:
        """
        :param cell: a cell that is there
        :param columns: the names of columns; ``None`` for all
        :return: for each a list of a value a run: numbers, texts, or arrays
        :raises ExperimentError: if the file cannot be read
        """
        path = self.path_of(cell)
        try:
            table = _read(path, columns)
        except (pa.ArrowException, OSError) as error:
            raise ExperimentError(
                f"Cannot read {path} ({error}): start again, and it will be set aside and run again."
            ) from error
        return {name: _values(table.column(name)) for name in table.column_names}

    def write(self, name: str, content: bytes | str) -> None:
        """
        :param name: of a file beside the cells
        :param content: what to write
        :raises ExperimentError: if it cannot be written
        """
        write_atomically(self.path / name, content.encode() if isinstance(content, str) else content)

    def _check(self, file: Path, design: Mapping[str, Any], selection: Collection[str]) -> None:
        try:
            stored = read_yaml(file)
            there = dict(stored.pop("versions"))
        except (DesignError, KeyError, TypeError, ValueError) as error:
            raise DesignError(f"{file} does not describe an experiment ({error}): choose another output folder.") from error
        wanted = yaml.safe_load(yaml.safe_dump(dict(design)))
        names = [name for name in {**wanted, **stored} if name not in selection]
        differences = _differences({name: stored.get(name) for name in names}, {name: wanted.get(name) for name in names})
        if differences:
            raise DesignError(
                f"{self.path} holds an experiment of another design: {'; '.join(differences)}. Choose another output folder, "
                "or the settings of that experiment."
            )
        changed = {name: number for name, number in versions().items() if there.get(name) != number}
        if any(name in changed for name in STRICT):
            raise DesignError(
                f"{self.path} was started with other versions: {'; '.join(_differences(there, versions()))}. Choose another "
                "output folder, or install those versions."
            )
        if changed:
            self.warn(f"{self.path} was begun with other versions of {', '.join(changed)}.")

    def _set_aside(self, path: Path, error: Exception) -> None:
        aside = path.with_suffix(".corrupt")
        number = 1
        while aside.exists():
            number += 1
            aside = path.with_suffix(f".corrupt-{number}")
        os.replace(path, aside)
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        self.warn(f"{path} is damaged ({reason}): it is kept as {aside.name}, and its cell is run again.")

    def _remove_leftovers(self) -> None:
        """Remove what was being written when an experiment in this folder was killed."""
        for path in self.path.rglob(".*.tmp"):
            owner = path.name.split(".")[-3]
            if owner.isdecimal() and (int(owner) == os.getpid() or not psutil.pid_exists(int(owner))):
                path.unlink(missing_ok=True)


def _differences(there: Mapping[str, Any], here: Mapping[str, Any]) -> list[str]:
    names = dict.fromkeys([*here, *there])
    return [f"{name} is {there.get(name)} there, {here.get(name)} here" for name in names if there.get(name) != here.get(name)]


def _read(path: Path, columns: Iterable[str] | None = None) -> pa.Table:
    with pq.ParquetFile(path, page_checksum_verification=True) as file:
        return file.read(columns=None if columns is None else list(columns), use_threads=False)


def _values(column: pa.ChunkedArray) -> list[Any]:
    if pa.types.is_list(column.type):
        return [value.values.to_numpy(zero_copy_only=False) for chunk in column.chunks for value in chunk]
    return list(column.to_pylist())
