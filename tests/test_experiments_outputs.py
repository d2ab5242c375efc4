"""What a study leaves for the eye: figures, the report, TensorBoard; and other environments than the paper's."""

from pathlib import Path

import matplotlib.image
import numpy as np
import pandas as pd
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.hparams import plugin_data_pb2

from sb3_adaptive_q.study import StudyError, StudySettings, run_study
from sb3_adaptive_q.study.cells import Cell
from sb3_adaptive_q.study.command_line import main
from sb3_adaptive_q.study.figures import all_methods_figure, pair_figure
from sb3_adaptive_q.study.results import read_results
from sb3_adaptive_q.study.storage import StudyFolder
from sb3_adaptive_q.study.tensorboard_log import write_tensorboard

LAKE = "FrozenLake-v1"
SETTINGS = StudySettings(methods=(1, 2, 7), runs=2, episodes=150)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> StudyFolder:
    path = tmp_path_factory.mktemp("outputs") / "study"
    run_study(SETTINGS, path, workers=1, progress_bar=False)
    return StudyFolder(path, SETTINGS, warn=print)


def test_figures_have_the_papers_numbers_and_both_formats(folder: StudyFolder) -> None:
    names = {"figure_06", "figure_09", "figure_10", "figure_13", "policies_FrozenLake-v1"}
    names |= {"all_methods_FrozenLake-v1", "all_methods_CartPoleFriction-v0"}
    files = sorted((folder.path / "figures").iterdir())
    assert {path.stem for path in files} == names and len(files) == 2 * len(names)
    for path in files:
        if path.suffix == ".png":
            pixels = matplotlib.image.imread(path)
            assert min(pixels.shape[:2]) >= 500 and pixels.std() > 0.01
        else:
            assert path.read_bytes().startswith(b"%PDF")


def test_figure_shows_the_mean_over_the_runs_and_its_100_episode_mean(folder: StudyFolder) -> None:
    returns = np.stack([folder.read(Cell(LAKE, 7, run), ("returns",))["returns"] for run in (0, 1)])
    mu = np.stack([folder.read(Cell(LAKE, 7, run), ("mu",))["mu"] for run in (0, 1)])
    left, right = pair_figure(read_results(folder), LAKE, [7]).axes
    mean, smooth = (line.get_ydata() for line in left.lines)
    assert np.asarray(mean) == pytest.approx(returns.mean(axis=0))
    assert np.asarray(smooth)[-1] == pytest.approx(returns[:, -100:].mean())
    assert np.asarray(right.lines[0].get_ydata()) == pytest.approx(mu.mean(axis=0))


def test_all_methods_are_on_one_axis_with_bands(folder: StudyFolder) -> None:
    left, _ = all_methods_figure(read_results(folder), LAKE).axes
    assert [line.get_label() for line in left.lines] == ["Method 1", "Method 2", "Method 7"]
    assert len(left.collections) == 3


def test_report_is_written_and_printed(folder: StudyFolder, capsys: pytest.CaptureFixture[str]) -> None:
    options = "--methods 1 2 7 --runs 2 --episodes 150 --workers 1".split()
    assert main([*options, "--output", str(folder.path)]) == 0
    report = (folder.path / "report.md").read_text()
    assert capsys.readouterr().out == f"{report}\n\nThe tables, figures and this report are in {folder.path}.\n"


def test_results_have_a_row_for_each_cell(folder: StudyFolder) -> None:
    cells = pd.read_csv(folder.path / "results.csv")
    assert len(cells) == 12 and not cells[["system", "method", "run"]].duplicated().any()
    assert cells.equals(cells.sort_values(["system", "method", "run"], ignore_index=True))
    assert len(pd.read_parquet(folder.path / "cells")) == 12


def test_progress_bar_tells_the_time_left(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run_study(StudySettings(systems=(LAKE,), methods=(1,), runs=2, episodes=20), tmp_path / "study", workers=1)
    *_, bar, after = capsys.readouterr().err.splitlines()
    assert "2/2" in bar and "<" in bar and "cell/s" in bar
    assert "Drawing figures" in after


def test_other_environments_that_compile(tmp_path: Path) -> None:
    systems = ("CliffWalkingLimited-v1", "CartPole-v1", "FrozenLake8x8-v1")
    settings = StudySettings(systems=systems, methods=(3,), runs=2, episodes=20, beta_3=0.1)
    report = run_study(settings, tmp_path / "study", workers=1, progress_bar=False)
    assert all(f"## {system}" in report for system in systems)
    assert (tmp_path / "study" / "figures" / "policies_FrozenLake8x8-v1.png").exists()
    folder = StudyFolder(tmp_path / "study", settings, warn=print)
    mu = folder.read(Cell("CartPole-v1", 3, 0), ("mu", "q_table"))
    assert mu["mu"][0] == pytest.approx(0.11) and len(mu["q_table"]) == 2 * 11**4


def scalars(run: Path) -> EventAccumulator:
    return EventAccumulator(str(run)).Reload()


def test_tensorboard_has_each_cell_as_a_run_with_its_parameters(folder: StudyFolder, tmp_path: Path) -> None:
    write_tensorboard(folder, tmp_path)
    runs = sorted(path.parent for path in tmp_path.rglob("events.*"))
    assert len(runs) == 12
    (run,) = (tmp_path / LAKE / "method-7").glob("run-00001-*")
    events = scalars(run)
    cell = folder.read(Cell(LAKE, 7, 1), ("returns", "lengths", "mu", "seed"))
    last = events.Scalars("rollout/ep_rew_mean")[-1]
    assert last.value == pytest.approx(cell["returns"][-100:].mean()) and last.step == cell["lengths"].sum()
    assert events.Scalars("train/learning_rate")[-1].value == pytest.approx(cell["mu"][-1])
    assert 100 <= len(events.Scalars("rollout/exploration_rate")) <= 200
    tag = "_hparams_/session_start_info"
    content = plugin_data_pb2.HParamsPluginData.FromString(events.SummaryMetadata(tag).plugin_data.content)
    hparams = content.session_start_info.hparams
    assert hparams["method"].number_value == 7 and hparams["step"].number_value == 0.005
    assert hparams["gamma"].number_value == 0.99 and hparams["seed"].number_value == cell["seed"]


def test_tensorboard_runs_are_written_once(folder: StudyFolder, tmp_path: Path) -> None:
    write_tensorboard(folder, tmp_path)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    write_tensorboard(folder, tmp_path)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before


def test_tensorboard_folder_that_cannot_be_written(folder: StudyFolder, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(StudyError, match="Cannot write"):
        write_tensorboard(folder, tmp_path / "file")
