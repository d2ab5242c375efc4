"""A small league from end to end: killed and gone on with, its tables, and the page in a real browser."""

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

import sb3_adaptive_q
from sb3_adaptive_q.experiments import Execution
from sb3_adaptive_q.experiments.drawing import paint
from sb3_adaptive_q.experiments.league.command import main
from sb3_adaptive_q.experiments.league.figures import number_points, wins_figure
from sb3_adaptive_q.experiments.league.league import run_league
from sb3_adaptive_q.experiments.league.settings import LeagueSettings
from sb3_adaptive_q.experiments.page import html_page
from sb3_adaptive_q.experiments.statistics import Estimate

PROJECT = Path(sb3_adaptive_q.__file__).resolve().parent.parent
OWN = "tests.helpers.own_rules:"
SETTINGS = LeagueSettings(
    tracks=("A", "B"),
    methods=("constant", "7", f"{OWN}Broken"),
    environments=("chain", "moving_goal"),
    quick=True,
    resamples=200,
)
OPTIONS = "--tracks A B --env chain moving_goal --quick --resamples 200 --workers 1".split()
BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")


def tables(folder: Path) -> dict[str, bytes]:
    found = [*(folder / "tables").iterdir(), folder / "runs.parquet", *(folder / "cells").glob("*.parquet")]
    return {path.name: path.read_bytes() for path in found}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("league") / "league"
    run_league(SETTINGS, Execution(output=path, workers=1, progress=False))
    return path


def test_killed_league_goes_on_to_the_same_tables(folder: Path, tmp_path: Path) -> None:
    other = tmp_path / "league"
    command = [sys.executable, "-m", "sb3_adaptive_q.experiments.league", *OPTIONS, "--output", str(other)]
    command += ["--methods", "constant", "7", f"{OWN}Broken", "--no-progress"]
    process = subprocess.Popen(command, cwd=PROJECT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        deadline = time.monotonic() + 120
        while len(list((other / "cells").glob("*.parquet"))) < 3 and process.poll() is None:
            assert time.monotonic() < deadline
            time.sleep(0.01)
    finally:
        with suppress(ProcessLookupError):
            os.kill(process.pid, signal.SIGKILL)
        process.wait()
    assert process.returncode == -signal.SIGKILL and not (other / "report.md").exists()
    run_league(SETTINGS, Execution(output=other, workers=2, progress=False))
    assert tables(other) == tables(folder)


def test_more_rules_and_runs_extend_a_league(folder: Path, tmp_path: Path) -> None:
    other = tmp_path / "league"
    shutil.copytree(folder, other)
    before = {path: path.stat().st_mtime_ns for path in (other / "cells").iterdir()}
    run_league(replace(SETTINGS, methods=("8",), tracks=("B",)), Execution(output=other, workers=1, progress=False))
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert "Method 8" in (other / "report.md").read_text()


def test_runs_are_a_row_each(folder: Path) -> None:
    runs = pd.read_parquet(folder / "runs.parquet")
    keys = ["track", "phase", "environment", "rule", "setting", "seed"]
    assert not runs[keys].duplicated().any()
    assert set(runs.loc[runs["phase"] == "tuning", "seed"]) == set(range(5))
    assert set(runs.loc[runs["phase"] == "evaluation", "seed"]) == set(range(1000, 1020))
    assert set(runs["track"]) == {"A", "B"} and (runs["scores"].map(len) == 5).all()
    assert set(runs.loc[runs["track"] == "A", "environment"]) == {"chain"}


def test_report_has_the_findings_first_and_says_that_it_is_a_quick_look(folder: Path) -> None:
    report = (folder / "report.md").read_text()
    title, note, what, sentences, *_ = report.split("\n\n")
    assert title.endswith("(quick look)") and "no league result" in note and "4 rules in 2 environments, 20 runs each" in what
    assert sentences.count("\n- ") == 3 and "take **" in sentences and "Of the paper's methods" in sentences
    captions = re.findall(r"!\[(.*)\]", report)
    assert captions and all(caption.endswith("(quick look)") for caption in captions)
    headings = [line for line in report.splitlines() if line.startswith("### ")]
    assert headings and all(heading.endswith("(quick look)") for heading in headings)
    assert "nan" not in report.replace("gave nan", "")


def test_rule_that_fails_is_reported_with_its_reason(folder: Path) -> None:
    report = (folder / "report.md").read_text()
    assert re.search(r"- Broken in \w+: ValueError: .*nan.* \(\d+ runs\)", report)
    standings = pd.read_csv(folder / "tables" / "B_standings.csv")
    assert standings.loc[standings["rule"] == "Broken", "failed runs"].item() == 40


def test_archive_tells_what_was_run(folder: Path) -> None:
    report = (folder / "report.md").read_text()
    for name in ("seeds of the tuning", "processor", "commit", "numba", "numpy", "sb3_adaptive_q", "time of this start"):
        assert re.search(rf"^\| {name} +\| \S", report, re.MULTILINE), name
    command = f"python -m sb3_adaptive_q league --tracks A B --methods constant 7 {OWN}Broken --environments chain moving_goal"
    assert f"`{command} --quick --resamples 200`" in report
    assert (folder / "league.yml").read_bytes() == (PROJECT / "sb3_adaptive_q/experiments/league/league.yml").read_bytes()


def test_folder_of_another_league_is_refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--tracks", "B", "--env", "chain", "--methods", "constant", "--output", str(folder)]) == 2
    assert "quick is True there, False here" in capsys.readouterr().err


# The page

#: Runs before everything else: what goes wrong is kept
WATCH = (
    "<script>var errors = []; addEventListener('error', event => errors.push(event.message || 'a picture'), true);</script>"
)
#: Runs last: click on every heading twice, and write down what the tables look like
PROBE = """<script>
addEventListener("load", () => {
  const column = (table, i) => Array.from(table.tBodies[0].rows, row => row.cells[i].textContent.trim());
  const result = {errors: errors, pictures: [], tables: []};
  for (const picture of document.images) result.pictures.push(picture.complete && picture.naturalWidth > 100);
  for (const table of document.querySelectorAll("table")) {
    Array.from(table.tHead.rows[0].cells).forEach((heading, i) => {
      const once = [], button = heading.querySelector("button");
      for (let n = 0; n < 2; n++) { button.click(); once.push([heading.getAttribute("aria-sort"), column(table, i)]); }
      result.tables.push(once);
    });
  }
  document.body.innerHTML = "";
  document.body.append(Object.assign(document.createElement("pre"), {id: "result", textContent: JSON.stringify(result)}));
});
</script>"""


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    if BROWSER is None:
        pytest.skip("no Chromium here")
    yield tmp_path_factory.mktemp("browser")


def probe(page: str, folder: Path) -> dict[str, list[object]]:
    """What a headless browser finds in a page."""
    import html
    import json

    path = folder / "page.html"
    path.write_text(page.replace("<head>", f"<head>{WATCH}", 1).replace("</body>", f"{PROBE}</body>"), encoding="utf-8")
    flags = "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-background-networking"
    flags += f" --disable-component-update --disable-sync --user-data-dir={folder / 'profile'} --dump-dom"
    found = subprocess.run([str(BROWSER), *flags.split(), path.as_uri()], capture_output=True, text=True, timeout=120)
    content = re.search(r'<pre id="result">(.*)</pre>', found.stdout, re.DOTALL)
    assert content, found.stdout[-500:] + found.stderr[-500:]
    return dict(json.loads(html.unescape(content[1])))


def number(text: str) -> float | None:
    """The first word of a cell, if it is a number."""
    try:
        return float(text.split()[0])
    except (IndexError, ValueError):
        return None


def test_page_sorts_its_tables_and_shows_its_pictures(folder: Path, browser: Path) -> None:
    found = probe((folder / "report.html").read_text(encoding="utf-8"), browser)
    assert found["errors"] == []
    assert len(found["pictures"]) == (folder / "report.md").read_text().count("![") and all(found["pictures"])
    assert len(found["tables"]) > 20
    for (first, falling), (second, rising) in found["tables"]:  # type: ignore[misc]
        assert (first, second) == ("descending", "ascending") and sorted(falling) == sorted(rising)
        values = [value for value in map(number, rising) if value is not None]
        assert values == sorted(values)


def test_page_sorts_numbers_as_numbers_and_texts_after_them(browser: Path) -> None:
    """A version and the digest of a commit are texts, whatever they begin with."""
    text = "# Title\n\n| a | b |\n|---|---|\n| 10 [1, 2] | 18e4f0b |\n| –  | 3.11.7 |\n| -2.5 | y |\n| 9 | 2e3 |\n"
    (of_a, of_b) = probe(html_page(text, lambda name: b""), browser)["tables"]
    assert of_a == [["descending", ["–", "10 [1, 2]", "9", "-2.5"]], ["ascending", ["-2.5", "9", "10 [1, 2]", "–"]]]
    assert of_b == [["descending", ["y", "3.11.7", "18e4f0b", "2e3"]], ["ascending", ["2e3", "18e4f0b", "3.11.7", "y"]]]


def test_page_escapes_its_title_and_holds_no_other_file() -> None:
    page = html_page("# A < B\n\n![picture](a.png)\n", lambda name: b"\x89PNG" + name.encode())
    assert "<title>A &lt; B</title>" in page and 'src="data:image/png;base64,' in page and "a.png" not in page


def test_points_that_touch_are_numbered_in_one_place() -> None:
    figure = Figure(figsize=(6.0, 4.0), layout="constrained")
    axis = figure.subplots()
    points = [(0.0, 0.0), (1.0, 1.0), (1.001, 1.001), (1.0, 0.0), (0.5, 0.5), (0.501, 0.5), (0.499, 0.5)]
    axis.plot(*zip(*points, strict=True), "o")
    number_points(figure, axis, points)
    assert {(each.get_text(), each.xy) for each in axis.texts} == {
        ("1", (0.0, 0.0)),
        ("2, 3", (1.001, 1.001)),
        ("4", (1.0, 0.0)),
        ("5–7", (0.501, 0.5)),
    }


def test_points_are_numbered_where_they_are_drawn() -> None:
    figure = Figure(figsize=(6.0, 4.0), layout="constrained")
    axis = figure.subplots()
    axis.set_xlim(0.0, 1.0)
    points = [(0.2, 0.5), (0.24, 0.5)]
    axis.plot(*zip(*points, strict=True), "o", label="a label that takes half of the figure")
    figure.legend(loc="outside right center")
    number_points(figure, axis, points)
    assert [each.get_text() for each in axis.texts] == ["1, 2"]


@pytest.mark.parametrize("n_rules", [2, 5, 9, 26])
def test_nothing_of_the_matrix_of_wins_is_cut_off(n_rules: int) -> None:
    labels = (["search_then_converge", "unbiased_constant"] * 13)[:n_rules]
    rows: Any = [SimpleNamespace(label=label) for label in labels]
    picture = np.asarray(paint(wins_figure(rows, labels, [[Estimate(0.5, 0.4, 0.6)] * n_rules] * n_rules)))
    for edge in (picture[0], picture[-1], picture[:, 0], picture[:, -1]):
        assert (edge == 255).all()
