"""A study on a Dask cluster: a real scheduler and two worker processes on this machine."""

import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from sb3_adaptive_q.study import StudyError, StudySettings, executors, figures, run_study
from sb3_adaptive_q.study.command_line import main

distributed = pytest.importorskip("distributed")

SETTINGS = StudySettings(systems=("FrozenLake-v1",), methods=(1, 5, 7), runs=12, episodes=20_000)


@pytest.fixture(scope="module", autouse=True)
def no_figures() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(figures, "make_figures", lambda *arguments: iter(()))
        yield


@pytest.fixture
def cluster() -> Iterator["distributed.LocalCluster"]:
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None, silence_logs=50
    ) as cluster:
        yield cluster


def outcome(folder: Path) -> dict[str, bytes]:
    found = [path for pattern in ("*.csv", "*.md", "*.parquet") for path in folder.rglob(pattern)]
    return {str(path.relative_to(folder)): path.read_bytes() for path in found}


def test_study_survives_the_death_of_a_worker(cluster: "distributed.LocalCluster", tmp_path: Path) -> None:
    folder = tmp_path / "study"
    with distributed.Client(cluster) as client:
        victim, *others = client.run(os.getpid).values()
        assert len(others) == 1
    stored_at_death: list[int] = []

    def kill_in_the_middle() -> None:
        while len(stored := list(folder.rglob("*.parquet"))) < 4:
            time.sleep(0.002)
        os.kill(victim, signal.SIGKILL)
        stored_at_death.append(len(stored))

    killer = threading.Thread(target=kill_in_the_middle, daemon=True)
    killer.start()
    run_study(SETTINGS, folder, dask=cluster.scheduler_address, progress_bar=False)
    killer.join(timeout=5)
    assert stored_at_death and stored_at_death[0] < 36
    run_study(SETTINGS, tmp_path / "local", workers=2, progress_bar=False)
    assert outcome(folder) == outcome(tmp_path / "local")


def test_scheduler_that_does_not_answer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(executors, "CONNECTION_TIMEOUT", 0.5)
    assert main(["--dask", "tcp://127.0.0.1:9", "--output", str(tmp_path / "study")]) == 1
    errors = capsys.readouterr().err
    assert "No Dask scheduler answers at tcp://127.0.0.1:9" in errors and "Traceback" not in errors


@pytest.mark.parametrize("address", ["nonsense://x", "127.0.0.1:notaport"])
def test_address_that_is_none(address: str, tmp_path: Path) -> None:
    with pytest.raises(StudyError, match="No Dask scheduler answers"):
        run_study(SETTINGS, tmp_path / "study", dask=address, progress_bar=False)


def test_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(StudyError, match=r"pip install 'sb3-adaptive-q\[dask\]'"):
        run_study(SETTINGS, tmp_path / "study", dask="tcp://127.0.0.1:9", progress_bar=False)
