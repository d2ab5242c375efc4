"""A cell: the part of an experiment that is run, stored and looked up as one. This is what the workers run."""

import hashlib
import importlib
import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from sb3_adaptive_q.experiments.versions import check_worker, everything_of

#: Where in a file's metadata the recipe stands, the versions that its cell was run with, and a digest of its columns
RECIPE, VERSIONS, COLUMNS = b"recipe", b"versions", b"columns"


@dataclass(frozen=True)
class Cell:
    """
    :param measure: the ``module:name`` of the function that runs it: from the recipe to columns by name, of one row a run
    :param recipe: everything that decides the result, as plain data
    :param names: the names in the recipe that may come from a module of the user's
    :param labels: what to call the cell in tables; these decide nothing
    :param cost: how long it takes, in any unit that all cells share
    """

    measure: str
    recipe: Mapping[str, Any]
    names: tuple[str, ...] = ()
    labels: Mapping[str, Any] = field(default_factory=dict)
    cost: float = 1.0

    @cached_property
    def key(self) -> str:
        """A digest of all that decides the result, the name of the cell's file."""
        text = json.dumps([self.measure, self.recipe], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:32]

    def __str__(self) -> str:
        return ", ".join(f"{name} {value}" for name, value in self.labels.items()) or self.key


@dataclass(frozen=True)
class Outcome:
    """
    :param cell: that was run
    :param content: of its file; empty if it failed
    :param failure: why it failed; empty if it did not
    """

    cell: Cell
    content: bytes = b""
    failure: str = ""


def run_cell(cell: Cell, wanted: Mapping[str, str]) -> Outcome:
    """
    Run a cell. An error in it is a result: the other cells go on.

    :param cell: the cell
    :param wanted: what :func:`~sb3_adaptive_q.experiments.versions.everything_of` its names gave where the cell comes from
    :return: the content of its file, or the reason why there is none
    :raises ExperimentError: if this worker has other versions of anything
    """
    check_worker(wanted, cell.names)
    try:
        module_name, _, name = cell.measure.partition(":")
        measure: Callable[[Mapping[str, Any]], dict[str, Any]] = getattr(importlib.import_module(module_name), name)
        return Outcome(cell, encode(cell, measure(cell.recipe)))
    except Exception as error:
        return Outcome(cell, failure=f"{type(error).__name__}: {error}")


def encode(cell: Cell, columns: dict[str, Any]) -> bytes:
    """
    :param cell: a cell
    :param columns: its result: for each name a value a run, all of them numbers, texts or arrays
    :return: the content of its Parquet file, its labels in front; every page has a checksum
    """
    runs = len(next(iter(columns.values())))
    labels = {name: [value] * runs for name, value in cell.labels.items()}
    table = pa.table({**labels, **{name: list(values) for name, values in columns.items()}})
    metadata = {
        RECIPE: json.dumps([cell.measure, cell.recipe], sort_keys=True).encode(),
        VERSIONS: json.dumps(everything_of(cell.names), sort_keys=True).encode(),
        COLUMNS: columns_digest(table),
    }
    sink = pa.BufferOutputStream()
    # Dictionaries would take three times as long and save nothing, as the numbers of a long list are ever new
    pq.write_table(
        table.replace_schema_metadata(metadata),
        sink,
        compression="zstd",
        use_dictionary=False,
        use_compliant_nested_type=False,  # the types are read as they were written
        write_page_checksum=True,
    )
    return sink.getvalue().to_pybytes()


def columns_digest(table: pa.Table) -> bytes:
    """
    :param table: the content of a cell
    :return: a digest of what the checksums of the pages do not cover: the names and types of the columns
    """
    return hashlib.sha256(f"{table.schema.remove_metadata()} {table.num_rows}".encode()).hexdigest().encode()
