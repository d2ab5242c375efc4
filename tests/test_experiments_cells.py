"""One cell: it is what TabularQ learns by itself, from a seed of its own, and its file holds all of it."""

import itertools
import shutil
import subprocess
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import gymnasium as gym
import numpy as np
import pandas as pd
import pytest

from sb3_adaptive_q import TabularQ
from sb3_adaptive_q.experiments import Design, DesignError, ResultFolder, versions
from sb3_adaptive_q.experiments.cells import Cell, run_cell
from sb3_adaptive_q.experiments.episodes import NUMBERS, SERIES
from sb3_adaptive_q.experiments.paper.settings import StudySettings
from sb3_adaptive_q.experiments.versions import everything_of
from wrappers import DiscretizeObservation

STUDY = StudySettings(runs=2, episodes=30, methods=("1", "7"))


def cell_of(settings: StudySettings, system: str, method: str, run: int) -> Cell:
    (found,) = (cell for cell in settings.design().cells() if cell.labels == {"system": system, "method": method, "run": run})
    return found


LAKE = cell_of(STUDY, "FrozenLake-v1", "Method 7", 1)
POLE = cell_of(replace(STUDY, methods=("5",)), "CartPoleFriction-v0", "Method 5", 0)


def content_of(cell: Cell) -> bytes:
    outcome = run_cell(cell, everything_of(cell.names))
    assert outcome.failure == ""
    return outcome.content


def store(folder: ResultFolder, cell: Cell, content: bytes) -> None:
    folder.write(f"cells/{cell.key}.parquet", content)


@pytest.fixture(scope="module")
def content() -> bytes:
    return content_of(LAKE)


warnings_of_folder: list[str] = []


@pytest.fixture
def folder(tmp_path: Path) -> ResultFolder:
    warnings_of_folder.clear()
    return ResultFolder(tmp_path / "study", warn=warnings_of_folder.append)


def ordinary_environment(system: str) -> gym.Env:
    env = gym.make(system)
    if system == "FrozenLake-v1":
        return env
    return DiscretizeObservation(env, n_edges=10, low=[-2.4, -4, -0.2095, -4], high=[2.4, 4, 0.2095, 4])


@pytest.mark.parametrize("cell", [LAKE, POLE], ids=str)
def test_cell_is_what_tabular_q_learns_from_an_ordinary_environment(cell: Cell, folder: ResultFolder) -> None:
    store(folder, cell, content_of(cell))
    stored = {name: values[0] for name, values in folder.read(cell).items()}
    env = ordinary_environment(stored["system"])
    method = int(stored["method"].removeprefix("Method "))
    model = TabularQ("MlpPolicy", env, method=method, ties="first", total_episodes=30, gamma=0.99, seed=stored["seed"])
    model.learn(10**6)
    assert np.array_equal(stored["q_table"], model.q_table.ravel())
    assert [info["r"] for info in model.ep_info_buffer] == stored["returns"].tolist()
    assert [info["l"] for info in model.ep_info_buffer] == stored["lengths"].tolist()


def test_file_holds_one_row_that_pandas_reads(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "cell.parquet"
    path.write_bytes(content)
    (row,) = pd.read_parquet(path).to_dict("records")
    assert set(row) == {"system", "method", "run", *NUMBERS, *SERIES}
    assert (row["system"], row["method"], row["run"], row["episodes"]) == ("FrozenLake-v1", "Method 7", 1, 30)
    assert [len(row[name]) for name in ("returns", "lengths", "mu", "epsilon", "q_table")] == [30, 30, 30, 30, 64]
    assert row["steps"] == row["lengths"].sum()
    assert row["last_return"] == row["returns"][-1]
    assert row["mean_last_100"] == pytest.approx(row["returns"].mean())
    assert row["epsilon"] == pytest.approx(1.0 - 0.95 * np.arange(30) / 30)


def test_mean_is_over_the_last_hundred_episodes(folder: ResultFolder) -> None:
    cell = cell_of(replace(STUDY, episodes=150), "CartPoleFriction-v0", "Method 1", 0)
    store(folder, cell, content_of(cell))
    row = folder.read(cell)
    assert row["mean_last_100"][0] == pytest.approx(np.mean(row["returns"][0][50:]))
    assert row["mean_last_100"][0] != pytest.approx(np.mean(row["returns"][0]))


def test_environment_in_use_leaves_no_trace_in_the_next_cell(content: bytes) -> None:
    content_of(cell_of(STUDY, "FrozenLake-v1", "Method 1", 0))
    assert content_of(LAKE) == content


def test_seeds_depend_on_nothing_but_the_study_and_the_run() -> None:
    more = StudySettings(systems=("Taxi-v4", "FrozenLake-v1"), methods=("8", "7"), runs=5, episodes=30)
    same = cell_of(more, "FrozenLake-v1", "Method 7", 1)
    assert (same.recipe["seed"], same.key) == (LAKE.recipe["seed"], LAKE.key)
    other = cell_of(replace(STUDY, seed=1), "FrozenLake-v1", "Method 7", 1)
    assert other.recipe["seed"] != LAKE.recipe["seed"]


def test_no_two_runs_of_the_default_study_share_a_seed() -> None:
    assert len({cell.recipe["seed"] for cell in StudySettings().design().cells()}) == 320


def test_cells_are_all_combinations() -> None:
    cells = [tuple(cell.labels.values()) for cell in STUDY.design().cells()]
    assert len(cells) == 8
    assert set(cells) == set(itertools.product(STUDY.systems, ("Method 1", "Method 7"), (0, 1)))


CHANGES: list[Callable[[StudySettings], StudySettings]] = [
    lambda study: replace(study, gamma=0.9),
    lambda study: replace(study, seed=1),
    lambda study: replace(study, episodes=31),
    lambda study: replace(study, beta_6=0.001),
    lambda study: replace(study, next_action="max"),
]


@pytest.mark.parametrize("change", CHANGES)
def test_cells_of_other_settings_have_other_names(change: Callable[[StudySettings], StudySettings]) -> None:
    assert cell_of(change(STUDY), "FrozenLake-v1", "Method 7", 1).key != LAKE.key


def test_stored_cell_is_found(folder: ResultFolder, content: bytes) -> None:
    assert not folder.has(LAKE)
    store(folder, LAKE, content)
    assert folder.has(LAKE)
    assert warnings_of_folder == []


def test_cell_under_the_name_of_another_is_set_aside(folder: ResultFolder, content: bytes) -> None:
    store(folder, POLE, content)
    assert not folder.has(POLE)
    assert "its recipe is not that of its name" in warnings_of_folder[0]


def test_damaged_file_is_named_and_set_aside_every_time(folder: ResultFolder, content: bytes) -> None:
    for ending in ("corrupt", "corrupt-2"):
        store(folder, LAKE, content[:-20])
        assert not folder.has(LAKE)
        path = folder.path_of(LAKE)
        assert str(path) in warnings_of_folder[-1] and f"{LAKE.key}.{ending}" in warnings_of_folder[-1]
        assert path.with_suffix(f".{ending}").read_bytes() == content[:-20]
        assert not path.exists()


def test_no_changed_bit_goes_unnoticed_into_the_values(folder: ResultFolder, content: bytes) -> None:
    """A bit of every 23rd byte, one at a time: the file is set aside, or it gives what it gave before."""
    store(folder, LAKE, content)
    expected = folder.read(LAKE)
    outcomes = Counter[bool]()
    for position in range(0, len(content), 23):
        damaged = bytearray(content)
        damaged[position] ^= 1 << (position % 8)
        folder.path_of(LAKE).write_bytes(damaged)
        if folder.has(LAKE):
            values = folder.read(LAKE)
            assert all(np.array_equal(values[name], expected[name]) for name in expected), position
        outcomes[folder.path_of(LAKE).exists()] += 1
        folder.path_of(LAKE).with_suffix(".corrupt").unlink(missing_ok=True)
    assert outcomes[False] > outcomes[True] > 0


def test_design_that_repeats_a_cell_is_refused() -> None:
    with pytest.raises(DesignError, match="names the same runs twice: Method 1 in FrozenLake-v1"):
        Design(environments=["FrozenLake-v1"], methods=["1", {"name": "1"}], steps=10)  # type: ignore[list-item]


@pytest.mark.skipif(shutil.which("git") is None, reason="needs git")
def test_the_commit_tells_of_changes_since(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def git(*arguments: str) -> str:
        command = ["git", "-C", str(tmp_path), "-c", "user.name=A", "-c", "user.email=a@b", *arguments]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    monkeypatch.setattr(versions, "PACKAGE", tmp_path)
    assert versions.commit() == ""
    (tmp_path / "a.py").write_text("A = 1\n")
    git("init")
    git("add", "a.py")
    git("commit", "-m", "Add A", "--no-gpg-sign")
    assert versions.commit() == git("rev-parse", "--short", "HEAD")
    (tmp_path / "a.py").write_text("A = 2\n")
    assert versions.commit() == git("rev-parse", "--short", "HEAD") + "-dirty"
