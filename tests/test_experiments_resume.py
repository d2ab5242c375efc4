"""A study that is killed, interrupted or starved goes on where it stood, and ends with the same tables."""

import errno
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path

import psutil
import pytest
import yaml

from sb3_adaptive_q.study import StudyError, StudySettings, atomic, figures, run_study
from sb3_adaptive_q.study.atomic import write_atomically
from sb3_adaptive_q.study.command_line import main

PROJECT = Path(__file__).resolve().parent.parent
#: 24 cells of some 100 ms each: time enough to be hit in the middle
SETTINGS = StudySettings(systems=("FrozenLake-v1",), methods=(1, 6, 7), runs=8, episodes=60_000)
OPTIONS = "--systems FrozenLake-v1 --methods 1 6 7 --runs 8 --episodes 60000 --workers 2".split()
SMALL = StudySettings(systems=("FrozenLake-v1",), methods=(1, 7), runs=2, episodes=50)
SMALL_OPTIONS = "--systems FrozenLake-v1 --methods 1 7 --runs 2 --episodes 50 --workers 1".split()


def cell_files(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*.parquet"))


def outcome(folder: Path) -> dict[str, bytes]:
    """Every table, the report and every cell of a study, by name."""
    found = [path for pattern in ("*.csv", "*.md", "*.parquet") for path in folder.rglob(pattern)]
    return {str(path.relative_to(folder)): path.read_bytes() for path in found}


def leftovers(folder: Path) -> list[Path]:
    return list(folder.rglob("*.tmp"))


def run_to_the_end(settings: StudySettings, folder: Path) -> dict[str, bytes]:
    run_study(settings, folder, workers=1, progress_bar=False)
    return outcome(folder)


@pytest.fixture(scope="module", autouse=True)
def no_figures() -> Iterator[None]:
    """They take most of the time of so small a study, and are tested elsewhere."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(figures, "make_figures", lambda *arguments: iter(()))
        yield


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    return run_to_the_end(SETTINGS, tmp_path_factory.mktemp("uninterrupted") / "study")


@pytest.fixture
def started(tmp_path: Path) -> Iterator[tuple[subprocess.Popen[str], Path]]:
    """A study in processes of its own, with some cells stored and some to come."""
    folder = tmp_path / "study"
    process = subprocess.Popen(
        [sys.executable, "-m", "sb3_adaptive_q.study", *OPTIONS, "--output", str(folder)],
        cwd=PROJECT,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    wait_for(lambda: len(cell_files(folder)) >= 4 or process.poll() is not None)
    yield process, folder
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.communicate()


def wait_for(condition: Callable[[], bool], seconds: float = 120.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "waited in vain"
        time.sleep(0.002)


def test_killed_study_goes_on_with_the_missing_cells_only(
    started: tuple[subprocess.Popen[str], Path], uninterrupted: dict[str, bytes]
) -> None:
    process, folder = started
    workers = psutil.Process(process.pid).children(recursive=True)
    process.kill()
    process.wait()
    stored = {path: path.stat().st_mtime_ns for path in cell_files(folder)}
    assert 4 <= len(stored) < 24
    wait_for(lambda: not any(worker.is_running() and worker.status() != "zombie" for worker in workers), 20.0)
    # As a kill in the middle of a write would have left it
    leftover = folder / "cells" / f".run-00000.parquet.{process.pid}.tmp"
    leftover.write_bytes(b"half")

    assert run_to_the_end(SETTINGS, folder) == uninterrupted
    assert {path: path.stat().st_mtime_ns for path in stored} == stored
    assert leftovers(folder) == []


def test_interrupt_stores_what_is_done_and_says_how_to_go_on(
    started: tuple[subprocess.Popen[str], Path], uninterrupted: dict[str, bytes]
) -> None:
    process, folder = started
    os.killpg(process.pid, signal.SIGINT)  # as the keyboard does: all processes get it
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "Interrupted" in errors and "start again to go on" in errors and "Traceback" not in errors
    assert 4 <= len(cell_files(folder)) < 24
    assert leftovers(folder) == []
    assert run_to_the_end(SETTINGS, folder) == uninterrupted


def test_dead_worker_is_reported_and_costs_nothing(tmp_path: Path) -> None:
    folder = tmp_path / "study"

    def kill_a_worker() -> None:
        wait_for(lambda: len(cell_files(folder)) >= 2)
        (worker,) = (child for child in psutil.Process().children() if child.pid not in before)
        worker.kill()

    before = {child.pid for child in psutil.Process().children()}
    killer = threading.Thread(target=kill_a_worker)
    killer.start()
    with pytest.raises(StudyError, match="A worker process died"):
        run_study(SETTINGS, folder, workers=1, progress_bar=False)
    killer.join()
    assert 2 <= len(cell_files(folder)) < 24 and leftovers(folder) == []


def test_corrupt_cell_is_named_set_aside_and_run_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "study"
    expected = run_to_the_end(SMALL, folder)
    victim = cell_files(folder)[0]
    content = bytearray(victim.read_bytes())
    content[len(content) // 2] ^= 0xFF
    victim.write_bytes(content)
    assert main([*SMALL_OPTIONS, "--output", str(folder)]) == 0
    assert f"{victim} is damaged" in capsys.readouterr().err
    assert victim.with_suffix(".corrupt").read_bytes() == content
    assert outcome(folder) == expected


def test_more_runs_extend_a_study(tmp_path: Path) -> None:
    folder = tmp_path / "study"
    run_to_the_end(SMALL, folder)
    stored = {path: path.stat().st_mtime_ns for path in cell_files(folder)}
    larger = StudySettings.from_data({**SMALL.as_data(), "runs": 3, "methods": [1, 7, 8]})
    assert run_to_the_end(larger, folder) == run_to_the_end(larger, tmp_path / "at once")
    assert {path: path.stat().st_mtime_ns for path in stored} == stored


def test_folder_of_another_study_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "study"
    expected = run_to_the_end(SMALL, folder)
    assert main([*SMALL_OPTIONS, "--gamma", "0.9", "--output", str(folder)]) == 2
    assert "gamma is 0.99 there, 0.9 here" in capsys.readouterr().err
    assert outcome(folder) == expected


@pytest.mark.parametrize("content", [None, "gamma: [", "colour: blue", "- 1"])
def test_folder_of_something_else_is_refused(content: str | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name = "notes.txt" if content is None else "study.yml"
    (tmp_path / name).write_text(content or "mine")
    assert main([*SMALL_OPTIONS, "--output", str(tmp_path)]) == 2
    assert str(tmp_path) in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_settings_and_versions_are_saved_and_make_the_same_study(tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    expected = run_to_the_end(SMALL, first)
    saved = yaml.safe_load((first / "study.yml").read_text())
    assert saved["versions"]["numpy"] and saved["versions"]["sb3-adaptive-q"]
    assert main(["--config", str(first / "study.yml"), "--workers", "1", "--output", str(second)]) == 0
    assert outcome(second) == expected


def test_other_versions_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run_to_the_end(SMALL, tmp_path / "study")
    design = tmp_path / "study" / "study.yml"
    data = yaml.safe_load(design.read_text())
    data["versions"]["numba"] = "0.1"
    design.write_text(yaml.safe_dump(data))
    run_to_the_end(SMALL, tmp_path / "study")
    assert "other versions of numba" in capsys.readouterr().err


def test_workers_make_no_difference(tmp_path: Path) -> None:
    run_study(SMALL, tmp_path / "two", workers=2, progress_bar=False)
    assert outcome(tmp_path / "two") == run_to_the_end(SMALL, tmp_path / "one")


def test_full_disk_ends_the_study_with_whole_files_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "study"
    fsync, calls = os.fsync, []

    def fail_from_the_sixth_on(descriptor: int) -> None:
        calls.append(descriptor)
        if len(calls) >= 6:  # the design and the first cell, each with its folder, and the second cell
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        fsync(descriptor)

    with monkeypatch.context() as patch:
        patch.setattr(atomic.os, "fsync", fail_from_the_sixth_on)
        assert main([*SMALL_OPTIONS, "--output", str(folder)]) == 1
    assert "No space left on device" in capsys.readouterr().err
    assert len(cell_files(folder)) in (1, 2) and leftovers(folder) == []
    assert run_to_the_end(SMALL, folder) == run_to_the_end(SMALL, tmp_path / "with room")


def test_file_too_large_for_the_system_leaves_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "file"
    write_atomically(path, b"old")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, limits[1]))
    try:
        with pytest.raises(StudyError, match="File too large"):
            write_atomically(path, b"x" * 100_000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert path.read_bytes() == b"old" and leftovers(tmp_path) == []


def test_temporary_file_of_a_running_process_is_left_alone(tmp_path: Path) -> None:
    folder = tmp_path / "study"
    run_to_the_end(SMALL, folder)
    other = folder / "cells" / f".run-00009.parquet.{os.getppid()}.tmp"
    other.write_bytes(b"being written")
    run_to_the_end(SMALL, folder)
    assert leftovers(folder) == [other]
