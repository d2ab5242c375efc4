"""One cell: it is what TabularQ learns by itself, from a seed of its own, and its file holds all of it."""

import itertools
from collections import Counter
from pathlib import Path

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest

from sb3_adaptive_q import TabularQ
from sb3_adaptive_q.study import DesignError, StudySettings
from sb3_adaptive_q.study.atomic import write_atomically
from sb3_adaptive_q.study.cells import SCHEMA, Cell, cells_of, recipe_of, run_cell, seed_of
from sb3_adaptive_q.study.storage import StudyFolder
from wrappers import DiscretizeObservation

DESIGN = StudySettings(runs=2, episodes=30, methods=(1, 7))
LAKE, POLE = Cell("FrozenLake-v1", 7, 1), Cell("CartPoleFriction-v0", 5, 0)


@pytest.fixture(scope="module")
def content() -> bytes:
    return run_cell(recipe_of(DESIGN, LAKE))


@pytest.fixture
def folder(tmp_path: Path) -> StudyFolder:
    return StudyFolder(tmp_path / "study", DESIGN, warn=lambda text: warnings_of_folder.append(text))


warnings_of_folder: list[str] = []


@pytest.fixture(autouse=True)
def forget_warnings() -> None:
    warnings_of_folder.clear()


def ordinary_environment(system: str) -> gym.Env:
    env = gym.make(system)
    if system == "FrozenLake-v1":
        return env
    return DiscretizeObservation(env, n_edges=10, low=[-2.4, -4, -0.2095, -4], high=[2.4, 4, 0.2095, 4])


@pytest.mark.parametrize("cell", [LAKE, POLE], ids=str)
def test_cell_is_what_tabular_q_learns_from_an_ordinary_environment(cell: Cell, folder: StudyFolder) -> None:
    write_atomically(folder.path_of(cell), run_cell(recipe_of(DESIGN, cell)))
    stored = folder.read(cell, ("q_table", "returns", "lengths", "seed"))
    model = TabularQ(
        "MlpPolicy", ordinary_environment(cell.system), method=cell.method, total_episodes=30, seed=stored["seed"]
    )
    model.learn(10**6)
    assert np.array_equal(stored["q_table"], model.q_table.ravel())
    assert [info["r"] for info in model.ep_info_buffer] == stored["returns"].tolist()
    assert [info["l"] for info in model.ep_info_buffer] == stored["lengths"].tolist()


def test_file_holds_one_row_that_pandas_reads(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "cell.parquet"
    path.write_bytes(content)
    (row,) = pd.read_parquet(path).to_dict("records")
    assert set(row) == set(SCHEMA.names)
    assert (row["system"], row["method"], row["run"], row["episodes"]) == (*LAKE, 30)
    assert [len(row[name]) for name in ("returns", "lengths", "mu", "epsilon", "q_table")] == [30, 30, 30, 30, 64]
    assert row["steps"] == row["lengths"].sum()
    assert row["last_return"] == row["returns"][-1]
    assert row["mean_last_100"] == pytest.approx(row["returns"].mean())
    assert row["epsilon"] == pytest.approx(1.0 - 0.95 * np.arange(30) / 30)


def test_mean_is_over_the_last_hundred_episodes(tmp_path: Path) -> None:
    design = StudySettings(episodes=150)
    (tmp_path / "cell.parquet").write_bytes(run_cell(recipe_of(design, POLE)))
    (row,) = pd.read_parquet(tmp_path / "cell.parquet").to_dict("records")
    assert row["mean_last_100"] == pytest.approx(np.mean(row["returns"][50:]))
    assert row["mean_last_100"] != pytest.approx(np.mean(row["returns"]))


def test_environment_in_use_leaves_no_trace_in_the_next_cell(content: bytes) -> None:
    run_cell(recipe_of(DESIGN, Cell("FrozenLake-v1", 1, 0)))
    assert run_cell(recipe_of(DESIGN, LAKE)) == content


def test_seeds_depend_on_nothing_but_the_study_and_the_cell() -> None:
    few = StudySettings(systems=("FrozenLake-v1",), methods=(7,), runs=2, episodes=5, gamma=0.5)
    assert seed_of(few, LAKE) == seed_of(DESIGN, LAKE)
    assert seed_of(StudySettings(seed=1), LAKE) != seed_of(DESIGN, LAKE)


def test_seeds_are_those_of_earlier_versions() -> None:
    assert [seed_of(DESIGN, cell) for cell in (LAKE, POLE)] == [618357677, 1564697012]


def test_no_two_cells_of_the_default_study_share_a_seed() -> None:
    design = StudySettings()
    assert len({seed_of(design, cell) for cell in cells_of(design)}) == 320


def test_cells_are_all_combinations_run_by_run() -> None:
    cells = cells_of(DESIGN)
    assert set(cells) == set(itertools.starmap(Cell, itertools.product(DESIGN.systems, (1, 7), (0, 1))))
    assert [cell.run for cell in cells] == [0] * 4 + [1] * 4


def test_stored_cell_is_found(folder: StudyFolder, content: bytes) -> None:
    assert not folder.has(LAKE)
    write_atomically(folder.path_of(LAKE), content)
    assert folder.has(LAKE)
    assert warnings_of_folder == []


@pytest.mark.parametrize("change", [{"gamma": 0.9}, {"seed": 1}, {"episodes": 31}, {"beta_6": 0.001}, {"next_action": "max"}])
def test_cell_of_other_settings_is_refused(folder: StudyFolder, content: bytes, change: dict[str, object]) -> None:
    write_atomically(folder.path_of(LAKE), content)
    other = StudyFolder(folder.path, StudySettings.from_data({**DESIGN.as_data(), **change}), warn=warnings_of_folder.append)
    with pytest.raises(DesignError, match="study of other settings"):
        other.has(LAKE)
    assert folder.path_of(LAKE).read_bytes() == content


def test_cell_under_the_name_of_another_is_refused(folder: StudyFolder, content: bytes) -> None:
    write_atomically(folder.path_of(Cell("FrozenLake-v1", 1, 0)), content)
    with pytest.raises(DesignError, match="method is 7 there, 1 here"):
        folder.has(Cell("FrozenLake-v1", 1, 0))


def test_damaged_file_is_named_and_set_aside_every_time(folder: StudyFolder, content: bytes) -> None:
    for name in ("run-00001.corrupt", "run-00001.corrupt-2"):
        write_atomically(folder.path_of(LAKE), content[:-20])
        assert not folder.has(LAKE)
        path = folder.path_of(LAKE)
        assert str(path) in warnings_of_folder[-1] and name in warnings_of_folder[-1]
        assert path.with_name(name).read_bytes() == content[:-20]
        assert not path.exists()


def test_no_changed_bit_goes_unnoticed_into_the_values(folder: StudyFolder, content: bytes) -> None:
    """A bit of every seventh byte, one at a time: the file is set aside, or it gives what it gave before."""
    write_atomically(folder.path_of(LAKE), content)
    expected = folder.read(LAKE, SCHEMA.names)
    outcomes = Counter()
    for position in range(0, len(content), 7):
        damaged = bytearray(content)
        damaged[position] ^= 1 << (position % 8)
        folder.path_of(LAKE).write_bytes(damaged)
        if folder.has(LAKE):
            values = folder.read(LAKE, SCHEMA.names)
            assert all(np.array_equal(values[name], expected[name]) for name in SCHEMA.names), position
        outcomes[folder.path_of(LAKE).exists()] += 1
        folder.path_of(LAKE).with_suffix(".corrupt").unlink(missing_ok=True)
    assert outcomes[False] > outcomes[True] > 0
