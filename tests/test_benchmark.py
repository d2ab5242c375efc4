"""The page docs/benchmark.md: what it says is what comes out, on a part of it, and the best that it names is the best."""

from pathlib import Path

import numpy as np
import pytest

from sb3_adaptive_q import TabularQ
from sb3_adaptive_q.algorithms.registry import ALGORITHMS
from sb3_adaptive_q.experiments import benchmark
from sb3_adaptive_q.experiments.benchmark import CONTESTANTS, ENVIRONMENTS, Task

PAGE = (Path(__file__).parent.parent / "docs" / "benchmark.md").read_text(encoding="utf-8")
ROWS = {cells[0].strip(" *"): [cell.strip() for cell in cells[1:]] for cells in
        (line.strip("|").split("|") for line in PAGE.splitlines() if line.startswith("|"))}  # fmt: skip


def test_the_page_has_everything() -> None:
    assert ROWS[""] == list(ENVIRONMENTS)
    assert {contestant.title for contestant in CONTESTANTS} < set(ROWS)
    assert {contestant.algorithm for contestant in CONTESTANTS} == set(ALGORITHMS)
    assert benchmark.COMMAND in PAGE


def test_the_bounds() -> None:
    """Of the deterministic ones by hand: 13 steps along the cliff, 7.93 for the taxi, and the limit of Cart Pole."""
    optimum, optimal, exploring = (ROWS[name] for name in ("Optimum", "Optimal for γ = 0.99", "Best with ε = 0.05"))
    assert optimum[2:] == ["7.93", "-13.00", "500"] and optimal[2:4] == ["7.93", "-13.00"]
    assert float(exploring[3]) < -13.0
    for env_id, *found in zip(ENVIRONMENTS[:1], optimum, optimal, exploring, strict=False):
        assert tuple(found) == benchmark.bounds(Task.of(env_id))
    # FrozenLake: no policy is better than the optimum, with the rounding of the page
    for row in CONTESTANTS:
        for i, cell in enumerate(ROWS[row.title]):
            assert float(cell.split()[0]) <= float(optimum[i]) + 0.001


@pytest.mark.parametrize("contestant", [each for each in CONTESTANTS if each.algorithm in ("tabular_q", "sarsa_lambda")])
def test_a_cell_comes_out_again(contestant: benchmark.Contestant) -> None:
    """The cliff, with all seeds, to the last digit."""
    task = Task.of("CliffWalkingLimited-v1")
    assert benchmark.in_words(benchmark.run(contestant, task, 10)) == ROWS[contestant.title][3]


def test_the_interval_holds_the_mean() -> None:
    text = benchmark.in_words(np.array([1.0, 2.0, 3.0, 6.0]))
    value, low, high = (float(part.strip("[],")) for part in text.split())
    assert value == 3.0 and 1.0 <= low < 3.0 < high <= 6.0
    assert benchmark.in_words(np.full(10, 0.5)) == "0.500 [0.500, 0.500]"


def test_play_leaves_the_model_alone() -> None:
    """A table of zeros always pushes to the left, and the pole has fallen within a dozen steps."""
    task = Task.of("CartPole-v1")
    model = TabularQ("MlpPolicy", task.make_vec_env(), seed=0)
    assert 8.0 < benchmark.play(model, task) < 12.0
    assert not model.q_table.any() and model.num_timesteps == 0
