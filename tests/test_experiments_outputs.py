"""What a study leaves for the eye: figures, the report, TensorBoard; and other environments than the paper's."""

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
import pandas as pd
import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.hparams import plugin_data_pb2

from sb3_adaptive_q.experiments import Execution, ExperimentError, ResultFolder, run_missing
from sb3_adaptive_q.experiments.paper import figures, study
from sb3_adaptive_q.experiments.paper.command import main
from sb3_adaptive_q.experiments.paper.figures import all_methods_figure, pair_figure
from sb3_adaptive_q.experiments.paper.report import best_method
from sb3_adaptive_q.experiments.paper.results import read_results
from sb3_adaptive_q.experiments.paper.settings import StudySettings
from sb3_adaptive_q.experiments.paper.study import run_study
from sb3_adaptive_q.experiments.paper.tensorboard_log import write_tensorboard

LAKE = "FrozenLake-v1"
OWN = "tests.helpers.own_rules:"
SETTINGS = StudySettings(methods=("1", "2", "7"), runs=2, episodes=150)


def run(settings: StudySettings, path: Path) -> str:
    return run_study(settings, Execution(output=path, workers=1, progress=False))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> ResultFolder:
    path = tmp_path_factory.mktemp("outputs") / "study"
    run(SETTINGS, path)
    return ResultFolder(path)


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """They take most of the time of so small a study."""
    monkeypatch.setattr(figures, "make_figures", lambda *arguments: iter(()))
    yield


def test_figures_have_the_papers_numbers_and_both_formats(folder: ResultFolder) -> None:
    names = {"figure_06", "figure_09", "figure_10", "figure_13", "policies_FrozenLake-v1"}
    names |= {"all_methods_FrozenLake-v1", "all_methods_CartPoleFriction-v0"}
    files = sorted((folder.path / "figures").iterdir())
    assert {path.stem for path in files} == names and len(files) == 2 * len(names)
    for path in files:
        if path.suffix == ".png":
            pixels = matplotlib.image.imread(path)
            assert min(pixels.shape[:2]) >= 400 and pixels.std() > 0.01
        else:
            content = path.read_bytes()
            assert content.startswith(b"%PDF") and b"/Type3" not in content  # journals refuse such fonts


def test_figure_shows_the_mean_over_the_runs_and_its_100_episode_mean(folder: ResultFolder) -> None:
    cells = SETTINGS.design().cells()
    chosen = [cell for cell in cells if (cell.labels["system"], cell.labels["method"]) == (LAKE, "Method 7")]
    returns, mu = (np.stack([folder.read(cell, (name,))[name][0] for cell in chosen]) for name in ("returns", "mu"))
    left, right = pair_figure(read_results(folder, cells), LAKE, ["Method 7"]).axes
    mean, smooth = (line.get_ydata() for line in left.lines)
    assert np.asarray(mean) == pytest.approx(returns.mean(axis=0))
    assert np.asarray(smooth)[-1] == pytest.approx(returns[:, -100:].mean())
    assert np.asarray(right.lines[0].get_ydata()) == pytest.approx(mu.mean(axis=0))


def test_all_methods_are_on_one_axis_with_bands(folder: ResultFolder) -> None:
    left, right = all_methods_figure(read_results(folder, SETTINGS.design().cells()), LAKE).axes
    assert [line.get_label() for line in left.lines] == ["Method 1", "Method 2", "Method 7"]
    assert len(left.collections) == 3
    assert left.get_title(loc="left") == "Frozen Lake: mean of 2 runs, shaded: 95 % bootstrap interval"
    assert right.get_xlabel() == "mean return of the last 100 episodes\n(after training)"


def test_summary_is_printed_and_begins_the_report(
    tmp_path: Path, no_figures: None, capsys: pytest.CaptureFixture[str]
) -> None:
    options = ["--systems", LAKE, "--methods", "1", "--runs", "2", "--episodes", "50", "--workers", "1"]
    assert main([*options, "--output", str(tmp_path / "study")]) == 0
    printed = capsys.readouterr().out
    assert printed.endswith(f"The report, the tables and the figures are in {tmp_path / 'study'}: open report.html first.\n")
    assert (tmp_path / "study" / "report.md").read_text().startswith(printed.partition("\n\nThe report, the tables")[0])


def test_best_method_is_told_with_those_that_it_is_significantly_above() -> None:
    good, bad, lucky = np.full(20, 10.0), np.zeros(20), np.repeat([0.0, 100.0], [15, 5])
    assert best_method({"good": good, "bad": bad}).endswith(
        "good has the largest mean return of the last 100 episodes, 10.00, significantly above bad"
    )
    # The largest mean, but worse in three runs of four: the test of ranks is against it
    assert best_method({"good": good, "lucky": lucky}).startswith("lucky has the largest mean")
    assert best_method({"good": good, "lucky": lucky}).endswith("significantly above no other")
    assert best_method({"good": good[:1], "bad": bad[:1]}).endswith("10.00")


def test_page_holds_its_pictures_and_every_table(folder: ResultFolder) -> None:
    page, report = (folder.path / "report.html").read_text(), (folder.path / "report.md").read_text()
    sources = re.findall(r'<img[^>]* src="([^"]{30})', page)
    assert len(sources) == report.count("![") == 7
    assert all(source.startswith("data:image/png;base64,iVBOR") for source in sources)
    assert page.count("<table>") == len(re.findall(r"^\|-", report, re.MULTILINE))
    assert "<script" in page and "http" not in re.sub(r"base64,[^\"]*", "", page)


def test_results_have_a_row_for_each_run(folder: ResultFolder) -> None:
    runs = pd.read_csv(folder.path / "results.csv")
    assert len(runs) == 12 and not runs[["system", "method", "run"]].duplicated().any()
    assert runs.equals(pd.read_parquet(folder.path / "results.parquet"))
    stored = pd.read_parquet(folder.path / "cells")
    assert len(stored) == 12 and set(runs) <= set(stored)


def test_progress_bar_tells_the_time_left(tmp_path: Path, capsys: pytest.CaptureFixture[str], no_figures: None) -> None:
    settings = StudySettings(systems=(LAKE,), methods=("1",), runs=2, episodes=20)
    run_study(settings, Execution(output=tmp_path / "study", workers=1))
    *_, bar, after = capsys.readouterr().err.splitlines()
    assert "2.00/2.00" in bar and "<" in bar and "run/s" in bar
    assert "Drawing figures" in after


def test_other_environments(tmp_path: Path, no_figures: None) -> None:
    """One by the name of a problem, and one that does not compile: both run in processes then, with the same results."""
    settings = StudySettings(systems=("riverswim", f"{OWN}CountingEnv"), methods=("3",), runs=2, episodes=20, beta_3=0.1)
    run_study(settings, Execution(output=tmp_path / "study", workers=2, progress=False))
    report = (tmp_path / "study" / "report.md").read_text()
    assert "## riverswim" in report and f"## {OWN}CountingEnv" in report
    runs = pd.read_parquet(tmp_path / "study" / "cells")
    assert runs["mu"].map(lambda mu: mu[0]).tolist() == pytest.approx([0.11] * 4)
    assert set(runs["system"]) == set(settings.systems)
    in_threads = ResultFolder(tmp_path / "threads")
    cells = replace(settings, systems=("riverswim",)).design().cells()
    execution = Execution(output=in_threads.path, workers=2, progress=False)
    assert run_missing(cells, in_threads, execution, in_threads=True) == []
    for file in in_threads.path.rglob("*.parquet"):
        assert file.read_bytes() == (tmp_path / "study" / "cells" / file.name).read_bytes()


def test_sweep_has_a_row_for_every_value(tmp_path: Path, no_figures: None) -> None:
    settings = StudySettings(systems=(LAKE,), methods=("2",), runs=2, episodes=20, sweep=("beta_2=0.1,0.2",))
    assert "Method 2, beta_2 = 0." in run(settings, tmp_path / "study")
    table = pd.read_csv(tmp_path / "study" / "table_7.csv")
    assert list(dict.fromkeys(table["method"])) == ["Method 2, beta_2 = 0.1", "Method 2, beta_2 = 0.2"]


def test_run_that_fails_is_reported_and_stops_no_other(tmp_path: Path, no_figures: None) -> None:
    settings = StudySettings(systems=(LAKE,), methods=("1", f"{OWN}Broken"), runs=2, episodes=30)
    run(settings, tmp_path / "study")
    report = (tmp_path / "study" / "report.md").read_text()
    assert "## Runs that failed\n\n2 runs failed" in report
    assert "system FrozenLake-v1, method Broken, run 1: ValueError:" in report and "nan" in report
    assert set(pd.read_csv(tmp_path / "study" / "results.csv")["method"]) == {"Method 1"}


def test_study_in_which_every_run_fails_says_why(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--systems", LAKE, "--methods", f"{OWN}Broken", "--runs", "1", "--episodes", "30", "--workers", "1"]
    assert main([*options, "--output", str(tmp_path / "study")]) == 1
    assert "Every run failed, the first one of them for this reason: ValueError" in capsys.readouterr().err


def scalars(run: Path) -> EventAccumulator:
    return EventAccumulator(str(run)).Reload()


def hparams(events: EventAccumulator) -> dict[str, Any]:
    content = events.SummaryMetadata("_hparams_/session_start_info").plugin_data.content
    values = plugin_data_pb2.HParamsPluginData.FromString(content).session_start_info.hparams
    return {name: getattr(value, value.WhichOneof("kind")) for name, value in values.items()}


def test_tensorboard_has_the_mean_of_each_method(folder: ResultFolder, tmp_path: Path) -> None:
    cells = SETTINGS.design().cells()
    for _ in range(2):
        write_tensorboard(folder, cells, tmp_path)  # the second time in the place of the first
    written = [path.parent.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("events.*")]
    assert sorted(written) == [f"{system}/Method_{n}/mean" for system in sorted(SETTINGS.systems) for n in (1, 2, 7)]
    events = scalars(tmp_path / LAKE / "Method_7" / "mean")
    labels = {"system": LAKE, "method": "Method 7"}
    runs = [folder.read(cell) for cell in cells if cell.labels.items() >= labels.items()]
    returns = np.array([run["returns"][0] for run in runs])
    steps = np.array([run["lengths"][0].sum() for run in runs])
    last = events.Scalars("rollout/ep_rew_mean")[-1]
    assert last.value == pytest.approx(returns[:, -100:].mean()) and last.step == round(steps.mean())
    mus = [run["mu"][0][-1] for run in runs]
    assert events.Scalars("train/learning_rate")[-1].value == pytest.approx(np.mean(mus))
    values = hparams(events)
    assert (values["algorithm"], values["method"], values["runs"]) == ("TabularQ", "method7", 2.0)
    assert (values["gamma"], values["μ/change"], values["total_episodes"]) == (0.99, 0.005, 150.0)
    assert "seed" not in values


def test_tensorboard_has_each_run_where_asked(folder: ResultFolder, tmp_path: Path) -> None:
    cells = SETTINGS.design().cells()
    write_tensorboard(folder, cells, tmp_path, every_run=True)
    runs = sorted(path.parent for path in tmp_path.rglob("events.*"))
    assert len(runs) == 12
    (written,) = (tmp_path / LAKE / "Method_7").glob("run-00001-*")
    events = scalars(written)
    (cell,) = (cell for cell in cells if cell.labels == {"system": LAKE, "method": "Method 7", "run": 1})
    data = {name: values[0] for name, values in folder.read(cell).items()}
    last = events.Scalars("rollout/ep_rew_mean")[-1]
    assert last.value == pytest.approx(data["returns"][-100:].mean()) and last.step == data["lengths"].sum()
    assert events.Scalars("train/learning_rate")[-1].value == pytest.approx(data["mu"][-1])
    assert 100 <= len(events.Scalars("rollout/exploration_rate")) <= 200
    values = hparams(events)
    assert values["method"] == "method7" and values["μ/change"] == 0.005
    assert values["gamma"] == 0.99 and values["seed"] == data["seed"]
    before = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")}
    write_tensorboard(folder, cells, tmp_path, every_run=True)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*")} == before


def test_tensorboard_folder_that_cannot_be_written(folder: ResultFolder, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(ExperimentError, match="Cannot write"):
        write_tensorboard(folder, SETTINGS.design().cells(), tmp_path / "file")


def test_study_imports_neither_figures_nor_statistics_to_start() -> None:
    """Its own module is loaded by every worker process."""
    assert not hasattr(study, "make_figures") and not hasattr(study, "write_report")
