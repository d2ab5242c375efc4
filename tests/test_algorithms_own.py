"""An algorithm of a user's own: Q-learning with a clipped target, as the README has it, and with parameters."""

from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from stable_baselines3.common.env_util import make_vec_env

from sb3_adaptive_q import CompiledVecEnv, LeanVecEnv, LearningRateCallback, TabularAlgorithm, TabularQ
from sb3_adaptive_q.algorithms.td_update import choose_after, td_update
from sb3_adaptive_q.rollouts import step_rollout


def clipped_update(tables, agent, size, choose, expect, best, memory, draws, t):  # type: ignore[no-untyped-def]
    low, high = agent.parameters
    best_value = 0.0 if t.terminated else best(tables, tables[0], t.next_state)[1]
    target = min(max(t.reward + agent.gamma * best_value, low), high)
    step = td_update(tables[0], agent, size, memory, t, target, best_value)
    return choose_after(tables, tables[0], agent, choose, draws, t, step, best_value)


class ClippedQ(TabularAlgorithm):
    """Q-learning with targets that are clipped to [low, high]."""

    update = staticmethod(clipped_update)

    def __init__(self, policy: Any, env: Any, low: float = -1.0, high: float = 1.0, **kwargs: Any) -> None:
        self.low, self.high = low, high
        super().__init__(policy, env, **kwargs)

    def update_parameters(self) -> tuple[float, ...]:
        return self.low, self.high


def learn(kind: type[Any], n_envs: int, algorithm: type[TabularAlgorithm] = ClippedQ, **arguments: Any) -> TabularAlgorithm:
    env = make_vec_env("Taxi-v4", n_envs, vec_env_cls=kind)
    return algorithm("MlpPolicy", env, seed=0, learning_rate=0.5, **arguments).learn(3000, log_interval=None)


@pytest.mark.parametrize("n_envs", [1, 3])
def test_both_paths_give_the_same(n_envs: int) -> None:
    tables = [learn(kind, n_envs).q_table for kind in (CompiledVecEnv, LeanVecEnv)]
    assert tables[0].tobytes() == tables[1].tobytes()


def test_its_targets_are_clipped() -> None:
    """Illegal actions cost 10, which shows without the clip."""
    assert learn(CompiledVecEnv, 1, TabularQ).q_table.min() < -5.0
    assert learn(CompiledVecEnv, 1, low=-2.0).q_table.min() == pytest.approx(-2.0, abs=0.1)
    np.testing.assert_array_equal(
        learn(CompiledVecEnv, 1, low=-1e9, high=1e9).q_table, learn(CompiledVecEnv, 1, TabularQ).q_table
    )


def returns_a_wrong_action(tables, agent, size, choose, expect, best, memory, draws, t):  # type: ignore[no-untyped-def]
    step = td_update(tables[0], agent, size, memory, t, t.reward, 0.0)
    return int(agent.parameters[0]), step, 0.0


class WrongAction(ClippedQ):
    """Its first update returns ``low`` as the next action."""

    update = staticmethod(returns_a_wrong_action)


@pytest.mark.parametrize("kind", [CompiledVecEnv, LeanVecEnv])
@pytest.mark.parametrize("action", [-1, 6])
def test_an_action_out_of_range_is_refused(kind: type[Any], action: int) -> None:
    """Before memory is touched with it."""
    with pytest.raises(ValueError, match=f"The update of WrongAction must give actions from 0 to 5, .* gave {action}: please"):
        learn(kind, 1, WrongAction, low=action)


class Distance(LearningRateCallback):
    """A step size that computes with the row and the column of its cell, below 0 too."""

    memory: ClassVar = {"seen": 0.0}

    @staticmethod
    def step_size(mu: float, step: Any, seen: Any) -> float:
        seen[step.row, step.column] += 1.0
        return 0.5 / (seen[step.row, step.column] + abs(step.row - 200) / 100.0 + abs(step.column - 3))


def test_a_step_size_may_compute_with_its_cell(monkeypatch: pytest.MonkeyPatch) -> None:
    """It gives the same on both paths, and without the compiler."""

    def table(kind: type[Any]) -> bytes:
        model = TabularQ("MlpPolicy", make_vec_env("Taxi-v4", 1, vec_env_cls=kind), seed=0)
        return model.learn(3000, callback=Distance()).q_table.tobytes()

    compiled, ordinary = table(CompiledVecEnv), table(LeanVecEnv)
    monkeypatch.setattr(step_rollout, "is_disabled", lambda: True)
    assert compiled == ordinary == table(LeanVecEnv)


class TestReadme:
    """The block of the README that defines an algorithm."""

    def block(self) -> str:
        text = (Path(__file__).parent.parent / "README.md").read_text(encoding="utf-8")
        (found,) = [block for block in text.split("```python\n")[1:] if "(TabularAlgorithm)" in block]
        return found.partition("```")[0]

    def test_it_takes_few_lines(self) -> None:
        assert len(self.block().splitlines()) <= 20

    def test_it_is_the_one_with_parameters(self) -> None:
        """Compiled, and bit for bit."""
        found: dict[str, Any] = {}
        exec(self.block(), found)
        ours, theirs = learn(CompiledVecEnv, 1, found["ClippedQ"]), learn(CompiledVecEnv, 1, ClippedQ)
        assert ours.q_table.any() and ours.q_table.tobytes() == theirs.q_table.tobytes()
