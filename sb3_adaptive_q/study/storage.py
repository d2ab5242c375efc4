"""The folder of a study: one Parquet file for each cell, written whole or not at all."""

import json
import os
import platform
from collections.abc import Callable, Iterable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import psutil
import pyarrow as pa
import pyarrow.parquet as pq
import yaml

from sb3_adaptive_q.study.atomic import write_atomically
from sb3_adaptive_q.study.cells import DIGEST, RECIPE, SCHEMA, Cell, digest_of, recipe_of
from sb3_adaptive_q.study.errors import DesignError, StudyError
from sb3_adaptive_q.study.settings import SELECTION, StudySettings, read_design
from sb3_adaptive_q.study.systems import file_name

DESIGN_FILE = "study.yml"
LIBRARIES = ("sb3-adaptive-q", "stable_baselines3", "gymnasium", "numpy", "numba", "torch", "scipy", "pandas", "pyarrow")


class StudyFolder:
    """
    :param path: the folder
    :param settings: the design of the study that is to live in it
    :param warn: called with a sentence about what was found and repaired
    """

    def __init__(self, path: Path, settings: StudySettings, warn: Callable[[str], None]) -> None:
        self.path = path
        self.settings = settings
        self.warn = warn

    def open(self) -> None:
        """
        Make the folder this study's, or check that it is.

        :raises DesignError: if it holds a study of other settings, or something else
        """
        design = self.path / DESIGN_FILE
        if design.exists():
            self._check_design(design)
        elif self.path.exists() and (not self.path.is_dir() or any(self.path.iterdir())):
            raise DesignError(f"{self.path} is no empty folder and holds no study: choose another output folder.")
        self.remove_leftovers()
        data = {**self.settings.as_data(), "versions": _versions()}
        write_atomically(design, yaml.safe_dump(data, sort_keys=False, allow_unicode=True).encode())

    def path_of(self, cell: Cell) -> Path:
        """
        :param cell: a cell of the study
        :return: its file
        """
        return self.path / "cells" / file_name(cell.system) / f"method-{cell.method}" / f"run-{cell.run:05d}.parquet"

    def has(self, cell: Cell) -> bool:
        """
        Look for a cell, and read all of it. A damaged file is set aside, so that the cell counts as missing.

        :param cell: a cell of the study
        :return: whether it is there
        :raises DesignError: if the file is sound, but its cell was run with other settings
        """
        path = self.path_of(cell)
        if not path.exists():
            return False
        try:
            table = _read(path)
            recipe = json.loads(table.schema.metadata[RECIPE])
            if digest_of(recipe).encode() != table.schema.metadata[DIGEST]:
                raise ValueError("its settings do not have the digest that it states")
            _check_content(table)
        except (pa.ArrowException, OSError, KeyError, TypeError, ValueError) as error:
            self._set_aside(path, error)
            return False
        self._check_recipe(path, recipe, recipe_of(self.settings, cell))
        return True

    def read(self, cell: Cell, columns: Iterable[str]) -> dict[str, Any]:
        """
        :param cell: a cell that is there
        :param columns: the names of columns
        :return: their values: numbers, or arrays
        :raises StudyError: if the file cannot be read
        """
        path = self.path_of(cell)
        try:
            table = _read(path, columns)
        except (pa.ArrowException, OSError) as error:
            raise StudyError(f"Cannot read {path} ({error}): start again, and it will be set aside and recomputed.") from error
        return {name: _value(table.column(name)) for name in columns}

    def _check_design(self, design: Path) -> None:
        try:
            data = read_design(design)
            versions = data.pop("versions", {})
            stored = StudySettings.from_data(data).as_data()
        except DesignError as error:
            raise DesignError(f"{design} does not describe a study ({error}): choose another output folder.") from error
        wanted = self.settings.as_data()
        _reject_other(self.path, {name: (stored[name], wanted[name]) for name in wanted if name not in SELECTION})
        changed = [name for name, number in _versions().items() if versions.get(name) != number]
        if changed:
            self.warn(f"{self.path} was begun with other versions of {', '.join(changed)}.")

    def _check_recipe(self, path: Path, stored: dict[str, Any], wanted: dict[str, Any]) -> None:
        _reject_other(path, {name: (stored.get(name), wanted.get(name)) for name in {**wanted, **stored}})

    def _set_aside(self, path: Path, error: Exception) -> None:
        aside = path.with_suffix(".corrupt")
        number = 1
        while aside.exists():
            number += 1
            aside = path.with_suffix(f".corrupt-{number}")
        os.replace(path, aside)
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        self.warn(f"{path} is damaged ({reason}): it is kept as {aside.name}, and its cell is run again.")

    def remove_leftovers(self) -> None:
        """Remove what was being written when a study in this folder was killed, or one of its workers."""
        for path in self.path.rglob(".*.tmp"):
            owner = path.name.split(".")[-2]
            if owner.isdecimal() and (int(owner) == os.getpid() or not psutil.pid_exists(int(owner))):
                path.unlink(missing_ok=True)


def _reject_other(path: Path, pairs: dict[str, tuple[Any, Any]]) -> None:
    differences = [f"{name} is {there} there, {here} here" for name, (there, here) in pairs.items() if there != here]
    if differences:
        raise DesignError(
            f"{path} belongs to a study of other settings: {'; '.join(differences)}. Choose another output folder, or the "
            "settings of that study."
        )


def _read(path: Path, columns: Iterable[str] = tuple(SCHEMA.names)) -> pa.Table:
    with pq.ParquetFile(path, page_checksum_verification=True) as file:
        if file.metadata.num_rows != 1:
            raise ValueError(f"it has {file.metadata.num_rows} rows instead of 1")
        return file.read(columns=list(columns), use_threads=False)


def _value(column: pa.ChunkedArray) -> Any:
    (chunk,) = column.chunks
    return chunk.values.to_numpy() if pa.types.is_list(chunk.type) else chunk[0].as_py()


def _check_content(table: pa.Table) -> None:
    if not table.schema.equals(SCHEMA):
        raise ValueError("its columns are not those of a cell")
    episodes = table.column("episodes")[0].as_py()
    for name in ("returns", "lengths", "mu", "epsilon"):
        if len(_value(table.column(name))) != episodes:
            raise ValueError(f"its {name} are not {episodes}")


def _versions() -> dict[str, str]:
    return {"python": platform.python_version(), **{name: version(name) for name in LIBRARIES}}
