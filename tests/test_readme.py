"""The README's Python, block after block, as a reader would type it."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

README = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def names(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What the blocks leave behind, executed one after the other in a folder of their own."""
    blocks = re.findall(r"^```python\n(.*?)^```", README, flags=re.DOTALL | re.MULTILINE)
    namespace: dict[str, Any] = {"__name__": "readme"}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("readme"))
        for block in blocks:
            exec(compile(block, "README.md", "exec"), namespace)
    return namespace


def test_the_compiled_example_learns_the_lake(names: dict[str, Any]) -> None:
    """Q* of the first state is 0.542 by value iteration; a table after ten million steps is near it."""
    assert names["fast"].num_timesteps == 10_000_000
    assert np.isclose(names["fast"].q_table[0].max(), 0.542, atol=0.1)


def test_the_saved_model_is_the_one_that_was_trained(names: dict[str, Any]) -> None:
    assert names["model"].num_timesteps == 300_000
    assert names["model"].q_table.shape == (16, 4)


def test_every_method_of_the_table_is_there(names: dict[str, Any]) -> None:
    rows = re.findall(r"^\| (\d) \| ([\d, ]+) \|.*\| `(\w+)\((.*)\)` \|$", README, flags=re.MULTILINE)
    assert [int(number) for number, *_ in rows] == list(range(1, 9))
    for number, equation, callback, arguments in rows:
        made = names["method"](int(number))
        assert type(made).__name__ == callback
        stated = dict(argument.split("=") for argument in arguments.split(", "))
        assert {name: made.method.data.parameters[name] for name in stated} == {
            name: float(value) for name, value in stated.items()
        }
        assert __import__("sb3_adaptive_q").METHODS[int(number)].equation == equation
