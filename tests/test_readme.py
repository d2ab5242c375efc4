"""The README and the pages of docs/: every Python block runs when it is copied alone."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sb3_adaptive_q import METHODS

ROOT = Path(__file__).parent.parent
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks_of(path: Path) -> list[str]:
    return re.findall(r"^```python\n(.*?)^```", path.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE)


BLOCKS = [
    (path.name, i, block)
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    if path.parent.name != "generated"
    for i, block in enumerate(blocks_of(path))
]
#: What the README says that a block prints
OUTPUTS = dict(re.findall(r"^```python\n(.*?)^```[^`]*^```text\n(.*?)^```", README, flags=re.DOTALL | re.MULTILINE))


@pytest.mark.parametrize("name, block", [pytest.param(name, block, id=f"{name}-{i}") for name, i, block in BLOCKS])
def test_a_block_runs_alone(
    name: str, block: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, Any] = {"__name__": "readme"}
    exec(compile(block, name, "exec"), namespace)
    printed = OUTPUTS.get(block)
    assert printed is None or capsys.readouterr().out == printed
    model = namespace.get("model")
    assert model is None or (np.isfinite(model.q_table).all() and model.q_table.any())


def test_the_readme_is_short() -> None:
    assert len(README.splitlines()) <= 150
    assert len(OUTPUTS) == 1
    assert len(blocks_of(ROOT / "README.md")) >= 4


def test_every_method_of_the_table_is_there() -> None:
    catalogue = (ROOT / "docs" / "step_sizes.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\d) \| ([\d, ]+) \|", catalogue, flags=re.MULTILINE)
    assert [(int(number), equation) for number, equation in rows] == [(n, each.equation) for n, each in METHODS.items()]
