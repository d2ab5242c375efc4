"""The scripts of examples/ and the class's notebook run, are short, and say what they are said to say."""

import runpy
from pathlib import Path

import matplotlib as mpl
import pytest

mpl.use("Agg")

import matplotlib.pyplot as plt
import nbformat
from nbclient import NotebookClient

ROOT = Path(__file__).parent.parent
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    """A folder of its own for what a script writes."""
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    plt.close("all")


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_is_short(path: Path) -> None:
    assert len(path.read_text(encoding="utf-8").splitlines()) <= 40


def test_the_lake(elsewhere, capsys):
    names = runpy.run_path(str(ROOT / "examples/lake.py"))
    # By dynamic programming: no policy succeeds more often within 100 steps
    assert names["best"] == pytest.approx(0.74419, abs=1e-5) and 0.6 < names["success"] <= names["best"]
    assert {path.name for path in elsewhere.iterdir()} == {"lake_policy.png", "lake_curve.png", "lake.gif"}
    assert "States: 16" in capsys.readouterr().out


def test_what_mu_does(elsewhere):
    names = runpy.run_path(str(ROOT / "examples/what_mu_does.py"))
    means = [sum(names["values"][i : i + 10]) / 10 for i in range(0, 50, 10)]
    assert means[0] < 0.1 < means[1] < means[2] < means[4]  # too slow, ..., overestimated
    assert means[2] == pytest.approx(names["TRUE_VALUE"], abs=0.05)
    assert (elsewhere / "what_mu_does.png").exists()


def test_an_own_step_size(elsewhere):
    names = runpy.run_path(str(ROOT / "examples/own_step_size.py"))
    assert all(len(group) == 10 for group in names["runs"].values())
    assert (elsewhere / "own_step_size.png").exists()


def test_an_own_environment(elsewhere, capsys):
    names = runpy.run_path(str(ROOT / "examples/own_environment.py"))
    assert names["model"].q_table[30].max() == pytest.approx(-15, abs=0.5)  # the shortest way (Sutton and Barto)
    assert {path.name for path in elsewhere.iterdir()} == {"windy_grid.png", "windy_grid.gif"}


def test_the_cliff(elsewhere):
    names = runpy.run_path(str(ROOT / "examples/cliff.py"))
    means = {name: sum(run.returns[-100:].mean() for run in group) / 30 for name, group in names["runs"].items()}
    # Sutton and Barto (2018, example 6.6): about -25 for SARSA and about -50 for Q-learning
    assert means["SARSA"] > means["Q-learning"] + 10
    assert {path.name for path in elsewhere.iterdir()} == {"cliff_curves.png", "cliff_policies.png"}


def test_the_notebook(elsewhere, monkeypatch):
    monkeypatch.delenv("MPLBACKEND", raising=False)  # a notebook has a backend of its own
    notebook = nbformat.read(ROOT / "docs/tutorial.ipynb", nbformat.NO_CONVERT)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert not any(cell.outputs or cell.execution_count for cell in code), "please clear its outputs before you commit it"
    run = NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(elsewhere)}}).execute()
    outputs = [output for cell in run.cells for output in cell.get("outputs", [])]
    printed = "".join(output.text for output in outputs if output.output_type == "stream")
    assert "after the first success: Q(14, right) = 0.5" in printed
    # By dynamic programming: no policy succeeds more often within 100 steps
    assert "the best policy: 74.4%" in printed
    assert sum("image/png" in output.get("data", {}) for output in outputs) == 6
