"""Output of the commands: what a terminal cannot show, and which run and what picture RL Zoo's programs are asked for."""

import io
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from sb3_adaptive_q import output, zoo

pytest.importorskip("rl_zoo3")
from sb3_adaptive_q.zoo_runs import with_latest_model


@pytest.mark.parametrize(
    ("encoding", "expected"), [("cp1252", "mu = 1 ± 2 ?"), ("utf-8", "μ = 1 ± 2 ♞"), ("ascii", "mu = 1 ? 2 ?")]
)
def test_signs_that_a_redirected_output_cannot_take(encoding: str, expected: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Windows writes cp1252 into a file, which has no μ."""
    written = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(written, encoding=encoding))
    output.spell_out_what_cannot_be_written()
    print("μ = 1 ± 2 ♞", end="", flush=True)
    assert written.getvalue().decode(encoding) == expected


def test_a_stream_that_takes_no_orders(monkeypatch: pytest.MonkeyPatch) -> None:
    """Such as that of a notebook."""
    monkeypatch.setattr(sys, "stdout", io.StringIO())
    output.spell_out_what_cannot_be_written()


class TestRuns:
    def ask(self, folder: Path, *more: str) -> list[str]:
        return with_latest_model(["--algo", "sarsa", "--env", "FrozenLake-v1", "-f", str(folder), *more])

    def test_the_latest_with_a_model(self, tmp_path: Path) -> None:
        """A search with ``--optimize`` leaves a run without one."""
        for name in ("FrozenLake-v1_2/FrozenLake-v1.zip", "FrozenLake-v1_10/best_model.zip", "Taxi-v4_12/Taxi-v4.zip"):
            (tmp_path / "sarsa" / name).parent.mkdir(parents=True)
            (tmp_path / "sarsa" / name).touch()
        (tmp_path / "sarsa" / "FrozenLake-v1_11").mkdir()
        assert self.ask(tmp_path)[-2:] == ["--exp-id", "10"]
        assert self.ask(tmp_path, "--exp-id", "2")[-2:] == ["--exp-id", "2"]
        assert self.ask(tmp_path, "--env", "Taxi-v4")[-2:] == ["--exp-id", "12"]

    def test_none(self, tmp_path: Path) -> None:
        assert "--exp-id" not in self.ask(tmp_path)


class TestPlot:
    @pytest.fixture(autouse=True)
    def headless(self, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
        import matplotlib.pyplot as plt

        monkeypatch.setattr(sys, "argv", ["train.py"])
        plt.switch_backend("agg")
        yield
        monkeypatch.undo()
        plt.close("all")

    def run(self, folder: Path, returns: list[float]) -> None:
        """A training as a Monitor writes it down."""
        path = folder / "tabular_q" / "FrozenLake-v1_1"
        path.mkdir(parents=True)
        rows = "".join(f"{value},2,{second}\n" for second, value in enumerate(returns))
        (path / "0.monitor.csv").write_text('#{"t_start": 0.0, "env_id": "FrozenLake-v1"}\nr,l,t\n' + rows)

    def test_it_is_the_moving_mean_of_the_returns(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        import matplotlib.pyplot as plt

        drawn = []
        monkeypatch.setattr(plt, "close", lambda: drawn.extend(line.get_ydata() for line in plt.gca().lines))
        self.run(tmp_path, [0.0, 2.0, 4.0, 0.0])
        zoo.main(["plot", "-f", str(tmp_path), "-w", "2", "-o", str(tmp_path / "p.png")])
        np.testing.assert_allclose(drawn, [[1.0, 3.0, 2.0]])
        assert (tmp_path / "p.png").read_bytes().startswith(b"\x89PNG")

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ([], "no window can be opened here: name a picture file with -o"),
            (["-o", "p.png"], "as many episodes as a point is the mean of"),
            (["-o", "p.png", "--algo", "sarsa"], "No such file"),
            (["-o", "p.png", "-w", "0"], "nothing can be plotted with these options and monitor files: ValueError"),
        ],
    )
    @pytest.mark.filterwarnings("ignore:invalid value encountered", "ignore:Mean of empty slice")
    def test_nothing_to_show(
        self, arguments: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.chdir(tmp_path)
        self.run(tmp_path, [0.0, 2.0])
        with pytest.raises(SystemExit, match=message):
            zoo.main(["plot", "-f", str(tmp_path), *arguments])

    def test_a_damaged_monitor_file(self, tmp_path: Path) -> None:
        self.run(tmp_path, [0.0, 2.0])
        (tmp_path / "tabular_q" / "FrozenLake-v1_1" / "0.monitor.csv").write_text("no monitor file\n")
        with pytest.raises(SystemExit, match=r"nothing can be plotted .*monitor\.py"):
            zoo.main(["plot", "-f", str(tmp_path), "-o", str(tmp_path / "p.png")])
