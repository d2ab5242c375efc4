"""One cell of a study: a method, trained once in a system. This is what the workers run."""

import hashlib
import json
import zlib
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import ArrayLike

from sb3_adaptive_q.callbacks import EpisodeSeriesCallback
from sb3_adaptive_q.study.settings import StudySettings
from sb3_adaptive_q.study.systems import reused_system, wrapping_of
from sb3_adaptive_q.tabular_q import TabularQ

#: Beyond any number of steps: the number of episodes ends the training
NO_LIMIT = 2**62

#: Where in a file's metadata the recipe and its digest stand
RECIPE, DIGEST = b"recipe", b"recipe_digest"
#: The columns of a cell: what tells it apart and sums it up, and its series and table
NUMBERS = {
    "system": pa.string(),
    "method": pa.int64(),
    "run": pa.int64(),
    "seed": pa.int64(),
    "episodes": pa.int64(),
    "steps": pa.int64(),
    "last_return": pa.float64(),
    "mean_last_100": pa.float64(),
}
SERIES = {
    "returns": pa.list_(pa.float64()),
    "lengths": pa.list_(pa.int64()),
    "mu": pa.list_(pa.float64()),
    "epsilon": pa.list_(pa.float64()),
    "n_actions": pa.int64(),
    "q_table": pa.list_(pa.float64()),
}
SCHEMA = pa.schema({**NUMBERS, **SERIES})
#: The episodes over which avg_100 is taken
WINDOW = 100


class Cell(NamedTuple):
    """
    :param system: the id of an environment
    :param method: the number of a method
    :param run: the number of the run, from 0
    """

    system: str
    method: int
    run: int

    def __str__(self) -> str:
        return f"{self.system}, Method {self.method}, run {self.run}"


def cells_of(settings: StudySettings) -> list[Cell]:
    """
    :param settings: the design
    :return: its cells, all methods and systems of a run before the next run: so the time left can be told early
    """
    return [
        Cell(system, number, run) for run in range(settings.runs) for system in settings.systems for number in settings.methods
    ]


def seed_of(settings: StudySettings, cell: Cell) -> int:
    """
    :param settings: the design
    :param cell: one of its cells
    :return: the cell's own seed, which depends on nothing but the study's seed and the cell
    """
    entropy = [settings.seed, zlib.crc32(cell.system.encode()), cell.method, cell.run]
    return int(np.random.SeedSequence(entropy).generate_state(1)[0])


def recipe_of(settings: StudySettings, cell: Cell) -> dict[str, Any]:
    """
    :param settings: the design
    :param cell: one of its cells
    :return: everything that decides what the cell gives, as plain data
    """
    names = ("gamma", "exploration_fraction", "exploration_initial_eps", "exploration_final_eps", "episodes")
    return {
        **cell._asdict(),
        "seed": seed_of(settings, cell),
        "wrapping": wrapping_of(cell.system),
        "method_kwargs": settings.method_kwargs(cell.method),
        **{name: getattr(settings, name) for name in names},
    }


def digest_of(recipe: dict[str, Any]) -> str:
    """
    :param recipe: what decides a cell
    :return: a hexadecimal digest of it
    """
    return hashlib.sha256(json.dumps(recipe, sort_keys=True).encode()).hexdigest()


def run_cell(recipe: dict[str, Any]) -> bytes:
    """
    Train a cell.

    :param recipe: what decides it
    :return: the content of its Parquet file, see :func:`encode`
    """
    model = make_model(recipe)
    series = EpisodeSeriesCallback()
    model.learn(NO_LIMIT, callback=series, log_interval=None)
    # They hold the model and the callback itself, and would keep both until the garbage collector comes by
    series.locals.clear()
    return encode(recipe, series, model.q_table)


def make_model(recipe: dict[str, Any]) -> TabularQ:
    """
    :param recipe: what decides a cell
    :return: the model that is to learn
    """
    return TabularQ(
        "MlpPolicy",
        reused_system(recipe["system"], recipe["wrapping"]),
        gamma=recipe["gamma"],
        method=recipe["method"],
        method_kwargs=recipe["method_kwargs"],
        exploration_fraction=recipe["exploration_fraction"],
        exploration_initial_eps=recipe["exploration_initial_eps"],
        exploration_final_eps=recipe["exploration_final_eps"],
        total_episodes=recipe["episodes"],
        seed=recipe["seed"],
    )


def encode(recipe: dict[str, Any], series: EpisodeSeriesCallback, q_table: np.ndarray) -> bytes:
    """
    Lay a cell out as a Parquet file of one row. The columns ``returns``, ``lengths``, ``mu`` and ``epsilon`` hold lists
    of an entry per episode, ``q_table`` the table row by row; every page has a checksum.

    :param recipe: what decides the cell
    :param series: what its episodes were like
    :param q_table: the table that was learned, of shape (n_states, n_actions)
    :return: the content of the file
    """
    columns = [
        _text(recipe["system"]),
        *(_numbers([recipe[name]], np.int64) for name in ("method", "run", "seed", "episodes")),
        _numbers([series.lengths.sum()], np.int64),
        _numbers([series.returns[-1]], np.float64),
        _numbers([series.returns[-WINDOW:].mean()], np.float64),
        _list(series.returns, np.float64),
        _list(series.lengths, np.int64),
        _list(series.rates, np.float64),
        _list(series.epsilons, np.float64),
        _numbers([q_table.shape[1]], np.int64),
        _list(q_table.ravel(), np.float64),
    ]
    metadata = {RECIPE: json.dumps(recipe, sort_keys=True).encode(), DIGEST: digest_of(recipe).encode()}
    sink = pa.BufferOutputStream()
    pq.write_table(
        pa.Table.from_arrays(columns, schema=SCHEMA.with_metadata(metadata)),
        sink,
        compression="zstd",
        # Long lists of ever new numbers: dictionaries would take three times as long and save nothing
        use_dictionary=False,
        use_byte_stream_split=["mu.list.element", "epsilon.list.element"],
        write_page_checksum=True,
    )
    return sink.getvalue().to_pybytes()


# By way of buffers: pa.array() would import pandas, for which every worker would pay 55 MiB


def _numbers(values: ArrayLike, dtype: type) -> pa.Array:
    array: np.ndarray = np.ascontiguousarray(values, dtype)
    return pa.Array.from_buffers(pa.from_numpy_dtype(array.dtype), len(array), [None, pa.py_buffer(array)])


def _list(values: np.ndarray, dtype: type) -> pa.Array:
    return pa.ListArray.from_arrays(_numbers([0, len(values)], np.int32), _numbers(values, dtype))


def _text(value: str) -> pa.Array:
    content = value.encode()
    offsets = np.array([0, len(content)], np.int32)
    return pa.StringArray.from_buffers(1, pa.py_buffer(offsets), pa.py_buffer(content))
