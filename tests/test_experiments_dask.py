"""An experiment on a Dask cluster: a real scheduler and two worker processes on this machine."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from sb3_adaptive_q.experiments import Design, Execution, ExperimentError, ResultFolder, run_missing, runner
from sb3_adaptive_q.experiments.cells import Cell
from sb3_adaptive_q.experiments.paper.command import main

distributed = pytest.importorskip("distributed")

DESIGN = Design(environments=["FrozenLake-v1"], methods=[1, 5, 7], settings={"total_episodes": 20_000}, runs=12)
SOURCE = """
from sb3_adaptive_q import LearningRateCallback

class Own(LearningRateCallback):
    @staticmethod
    def rule(mu, step):
        return {rate}
"""


@pytest.fixture(scope="module")
def cluster() -> Iterator["distributed.LocalCluster"]:
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address=None, silence_logs=50
    ) as cluster:
        yield cluster


def run(cells: list[Cell], path: Path, **execution: object) -> dict[str, bytes]:
    folder = ResultFolder(path)
    assert run_missing(cells, folder, Execution(output=path, progress=False, **execution), in_threads=True) == []  # type: ignore[arg-type]
    return {file.name: file.read_bytes() for file in path.rglob("*.parquet")}


def test_experiment_survives_the_death_of_a_worker(cluster: "distributed.LocalCluster", tmp_path: Path) -> None:
    with distributed.Client(cluster) as client:
        victim, *others = client.run(os.getpid).values()
        assert len(others) == 1
    stored_at_death: list[int] = []

    def kill_in_the_middle() -> None:
        while len(stored := list((tmp_path / "dask").rglob("*.parquet"))) < 4:
            time.sleep(0.002)
        os.kill(victim, signal.SIGKILL)
        stored_at_death.append(len(stored))

    killer = threading.Thread(target=kill_in_the_middle, daemon=True)
    killer.start()
    on_cluster = run(DESIGN.cells(), tmp_path / "dask", dask=cluster.scheduler_address)
    killer.join(timeout=5)
    assert stored_at_death and stored_at_death[0] < 36
    assert on_cluster == run(DESIGN.cells(), tmp_path / "local", workers=2)


def test_worker_with_another_version_of_a_rule_is_refused(
    cluster: "distributed.LocalCluster", tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same module, found here in one folder and by the workers in another."""
    for folder, rate in (("here", 0.1), ("there", 0.2)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "rule_of_two_places.py").write_text(SOURCE.format(rate=rate))
    monkeypatch.syspath_prepend(tmp_path / "here")
    with distributed.Client(cluster) as client:
        client.run(lambda path: sys.path.insert(0, path), str(tmp_path / "there"))
    design = Design(environments=["FrozenLake-v1"], methods=["rule_of_two_places:Own"], steps=100, runs=1)
    with pytest.raises(ExperimentError, match="has other versions: source of rule_of_two_places is"):
        run(design.cells(), tmp_path / "results", dask=cluster.scheduler_address)


def test_worker_with_another_version_of_the_package_is_refused(
    cluster: "distributed.LocalCluster", tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    versions = {**runner.everything_of(()), "sb3_adaptive_q": "0.0.1"}
    monkeypatch.setattr(runner, "everything_of", lambda names: versions)
    with pytest.raises(ExperimentError, match=r"other versions: sb3_adaptive_q is .* there, 0\.0\.1 here"):
        run(DESIGN.cells()[:1], tmp_path, dask=cluster.scheduler_address)


def test_scheduler_that_is_lost(tmp_path: Path) -> None:
    """It runs in a process of its own, with one worker, and is killed in the middle of cells of a second or more."""
    design = Design(environments=["FrozenLake-v1"], methods=[1], settings={"total_episodes": 2_000_000}, runs=30)
    command = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
    scheduler = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    address = next(line.split()[-1] for line in scheduler.stderr if "Scheduler at:" in line)  # type: ignore[union-attr]
    command = [sys.executable, "-m", "distributed.cli.dask_worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard"]
    worker = subprocess.Popen(command, stderr=subprocess.DEVNULL, cwd=Path.cwd())

    def kill_in_the_middle() -> None:
        while not list(tmp_path.rglob("*.parquet")):
            time.sleep(0.01)
        scheduler.kill()

    try:
        threading.Thread(target=kill_in_the_middle, daemon=True).start()
        with pytest.raises(ExperimentError, match="scheduler was lost"):
            run(design.cells(), tmp_path, dask=address)
        assert 1 <= len(list(tmp_path.rglob("*.parquet"))) < 30
    finally:
        for process in (worker, scheduler):
            process.kill()
            process.communicate()


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nonsense://x", "127.0.0.1:notaport"])
def test_scheduler_that_does_not_answer(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(runner, "CONNECTION_TIMEOUT", 0.5)
    assert main(["--dask", address, "--output", str(tmp_path / "study")]) == 1
    errors = capsys.readouterr().err
    assert f"No Dask scheduler answers at {address}" in errors and "Traceback" not in errors


def test_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ExperimentError, match=r"pip install 'sb3-adaptive-q\[dask\]'"):
        run(DESIGN.cells(), tmp_path, dask="tcp://127.0.0.1:9")
