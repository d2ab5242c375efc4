"""An experiment that is killed, interrupted or starved goes on where it stood, and ends with the same tables."""

import ast
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
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from helpers import dying_worker

import sb3_adaptive_q
from sb3_adaptive_q import atomic, experiments
from sb3_adaptive_q.experiments import Execution, ExperimentError, runner, versions
from sb3_adaptive_q.experiments.paper import figures, study
from sb3_adaptive_q.experiments.paper.command import main
from sb3_adaptive_q.experiments.paper.settings import StudySettings
from sb3_adaptive_q.experiments.paper.study import run_study
from sb3_adaptive_q.experiments.storage import write_atomically

PROJECT = Path(sb3_adaptive_q.__file__).resolve().parent.parent
#: 24 cells of some 100 ms each: time enough to be hit in the middle
SETTINGS = StudySettings(systems=("FrozenLake-v1",), methods=("1", "6", "7"), runs=8, episodes=80_000)
OPTIONS = "--systems FrozenLake-v1 --methods 1 6 7 --runs 8 --episodes 80000 --workers 2".split()
SMALL = StudySettings(systems=("FrozenLake-v1",), methods=("1", "7"), runs=2, episodes=50)
SMALL_OPTIONS = "--systems FrozenLake-v1 --methods 1 7 --runs 2 --episodes 50 --workers 1".split()


def cell_files(folder: Path) -> list[Path]:
    return sorted((folder / "cells").glob("*.parquet"))


def outcome(folder: Path) -> dict[str, bytes]:
    """Every table, the report and every cell of a study, by name."""
    found = [path for pattern in ("*.csv", "*.md", "*.html", "*.parquet") for path in folder.rglob(pattern)]
    return {str(path.relative_to(folder)): path.read_bytes() for path in found}


def leftovers(folder: Path) -> list[Path]:
    return list(folder.rglob("*.tmp"))


def run_to_the_end(settings: StudySettings, folder: Path) -> dict[str, bytes]:
    run_study(settings, Execution(output=folder, workers=2, progress=False))
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
        [sys.executable, "-m", "sb3_adaptive_q.experiments.paper", *OPTIONS, "--output", str(folder)],
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
    process.kill()
    process.wait()
    stored = {path: path.stat().st_mtime_ns for path in cell_files(folder)}
    assert 4 <= len(stored) < 24
    # As a kill in the middle of a write would have left it
    (folder / "cells" / f".0.parquet.{process.pid}.1.tmp").write_bytes(b"half")

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
    assert "Interrupted" in errors and "start the command again to continue" in errors and "Traceback" not in errors
    assert 4 <= len(cell_files(folder)) < 24
    assert leftovers(folder) == []
    assert run_to_the_end(SETTINGS, folder) == uninterrupted


def test_dead_worker_process_is_reported_and_costs_nothing(
    tmp_path: Path, uninterrupted: dict[str, bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "study"
    monkeypatch.setattr(study, "is_compiled", lambda system: False)  # so that the runs are given to processes

    monkeypatch.setattr(runner, "_run_in_process", dying_worker.run_or_die)
    monkeypatch.setenv(dying_worker.FLAG, str(tmp_path / "flag"))

    def let_a_worker_die() -> None:
        wait_for(lambda: len(cell_files(folder)) >= 2)
        (tmp_path / "flag").touch()

    killer = threading.Thread(target=let_a_worker_die)
    killer.start()
    execution = Execution(output=folder, workers=2, progress=False)
    with pytest.raises(ExperimentError, match="A worker died"):
        run_study(SETTINGS, execution)
    killer.join()
    assert 2 <= len(cell_files(folder)) < 24 and leftovers(folder) == []
    assert run_to_the_end(SETTINGS, folder) == uninterrupted


def test_corrupt_cell_is_named_set_aside_and_run_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "study"
    expected = run_to_the_end(SMALL, folder)
    victim = cell_files(folder)[0]
    content = bytearray(victim.read_bytes())
    content[300:400] = bytes(100)
    victim.write_bytes(content)
    assert main([*SMALL_OPTIONS, "--output", str(folder)]) == 0
    assert f"{victim} is damaged" in capsys.readouterr().err
    assert victim.with_suffix(".corrupt").read_bytes() == content
    assert outcome(folder) == expected


def test_more_runs_extend_a_study(tmp_path: Path) -> None:
    folder = tmp_path / "study"
    run_to_the_end(SMALL, folder)
    stored = {path: path.stat().st_mtime_ns for path in cell_files(folder)}
    larger = replace(SMALL, runs=3, methods=("1", "7", "8"))
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
    name = "notes.txt" if content is None else "design.yml"
    (tmp_path / name).write_text(content or "mine")
    assert main([*SMALL_OPTIONS, "--output", str(tmp_path)]) == 2
    assert str(tmp_path) in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_settings_and_versions_are_saved_and_make_the_same_study(tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    expected = run_to_the_end(SMALL, first)
    saved = yaml.safe_load((first / "design.yml").read_text())
    assert saved["versions"]["numpy"] and saved["versions"]["sb3_adaptive_q"] and saved["versions"]["source"]
    assert main(["--config", str(first / "design.yml"), "--workers", "1", "--output", str(second)]) == 0
    assert outcome(second) == expected


def test_other_versions_are_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run_to_the_end(SMALL, tmp_path / "study")
    design = tmp_path / "study" / "design.yml"
    data = yaml.safe_load(design.read_text())
    data["versions"]["numba"] = "0.1"
    design.write_text(yaml.safe_dump(data))
    run_to_the_end(SMALL, tmp_path / "study")
    assert "other versions of numba" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["sb3_adaptive_q", "source"])
def test_folder_of_another_version_is_refused(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run_to_the_end(SMALL, tmp_path / "study")
    design = tmp_path / "study" / "design.yml"
    data = yaml.safe_load(design.read_text())
    data["versions"][name] = "0.0.1"
    design.write_text(yaml.safe_dump(data))
    assert main([*SMALL_OPTIONS, "--output", str(tmp_path / "study")]) == 2
    assert f"started with other versions: {name} is 0.0.1 there" in capsys.readouterr().err


def test_digest_is_of_the_modules_that_a_run_goes_through() -> None:
    """Whatever the modules of a run import of the experiments is one of them, or decides no number."""
    folder = Path(experiments.__file__).parent
    for path in (path for path in folder.rglob("*.py") if path.stem in versions.OF_A_RUN):
        imports = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.ImportFrom)]
        names = {node.module.rpartition(".")[2] for node in imports if (node.module or "").startswith(experiments.__name__)}
        assert names <= {*versions.OF_A_RUN, "errors", "versions"}, path


def test_digest_looks_at_what_is_executed() -> None:
    """Other words about a module's functions change no number; another number does."""
    source = 'def half(x):\n    """Halve."""\n    return x / 2.0  # exact\n'
    assert versions.code_of(source) == versions.code_of(source.replace("exact", "so it is").replace("Halve.", "Take half."))
    assert versions.code_of(source) != versions.code_of(source.replace("2.0", "3.0"))


def test_full_disk_ends_the_study_with_whole_files_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "study"
    move, calls = os.replace, []

    def fail_from_the_third_on(source: Path, target: Path) -> None:
        calls.append(target)
        if len(calls) >= 3:  # after the design and the first cell
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        move(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(atomic.os, "replace", fail_from_the_third_on)
        assert main([*SMALL_OPTIONS, "--output", str(folder)]) == 1
    assert "No space left on device" in capsys.readouterr().err
    assert len(cell_files(folder)) == 1 and leftovers(folder) == []
    assert run_to_the_end(SMALL, folder) == run_to_the_end(SMALL, tmp_path / "with room")


def test_file_too_large_for_the_system_leaves_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "file"
    write_atomically(path, b"old")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, limits[1]))
    try:
        with pytest.raises(ExperimentError, match="File too large"):
            write_atomically(path, b"x" * 100_000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert path.read_bytes() == b"old" and leftovers(tmp_path) == []


def test_temporary_file_of_a_running_process_is_left_alone(tmp_path: Path) -> None:
    folder = tmp_path / "study"
    run_to_the_end(SMALL, folder)
    other = folder / "cells" / f".0.parquet.{os.getppid()}.1.tmp"
    other.write_bytes(b"being written")
    run_to_the_end(SMALL, folder)
    assert leftovers(folder) == [other]
