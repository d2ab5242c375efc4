"""
Ten thousand million transitions on the compiled path: counters pass 2^31, the log stays right, memory stays flat, and the
table ends at the values of dynamic programming.

``TRANSITIONS=100000000 python -m pytest tests/endurance/long_training.py`` tries fewer; 10^10 take about ten minutes.
"""

import os

import numpy as np
import psutil
import pytest
from helpers.table_env import TableEnv
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import KVWriter, Logger
from stable_baselines3.common.monitor import Monitor

from sb3_adaptive_q import CompiledVecEnv, TabularQ

TRANSITIONS = int(os.environ.get("TRANSITIONS", 10**10))
GAMMA = 0.9
#: Probability, next state, reward, whether it ends; for every action of the three states
TABLE = [
    [[(0.5, 0, 0.0, False), (0.5, 1, 1.0, False)], [(1.0, 2, 0.5, False)]],
    [[(0.75, 2, 0.0, False), (0.25, 0, 2.0, True)], [(1.0, 1, 0.25, True)]],
    [[(0.5, 0, -1.0, False), (0.5, 1, -1.0, True)], [(0.5, 2, 1.0, True), (0.5, 1, -0.5, False)]],
]


class Memory(BaseCallback):
    """Notes the memory of the process, in bytes, after every rollout."""

    knows_rollouts = True

    def _on_step(self) -> bool:
        self.sizes.append(psutil.Process().memory_info().rss)
        return True

    def _init_callback(self) -> None:
        self.sizes: list[int] = []


class Entries(KVWriter):
    """A log that is kept."""

    def __init__(self) -> None:
        self.entries: list[tuple[int, dict]] = []

    def write(self, key_values, key_excluded, step=0) -> None:
        self.entries.append((step, dict(key_values)))

    def close(self) -> None:
        pass


def iterated(best_of, gamma: float, rewards: bool = True) -> np.ndarray:
    """
    :param best_of: ``np.max`` or ``np.min``
    :param gamma: the discount factor
    :param rewards: whether to add up rewards; otherwise 1 for every step
    :return: action values by value iteration, of shape (n_states, n_actions)
    """
    values = np.zeros((3, 2))
    for _ in range(2000):
        best = best_of(values, axis=1)
        values = np.array(
            [
                [sum(p * ((r if rewards else 1.0) + gamma * best[to] * (not end)) for p, to, r, end in row) for row in rows]
                for rows in TABLE
            ]
        )
    return values


@pytest.mark.timeout(0)
@pytest.mark.parametrize("ends", [True, False], ids=["episodes", "one episode without an end"])
def test_a_very_long_training(ends: bool) -> None:
    table = [[[(p, to, r, last and ends) for p, to, r, last in row] for row in rows] for rows in TABLE]
    n_steps = TRANSITIONS if ends else TRANSITIONS // 10
    env = CompiledVecEnv([lambda: Monitor(TableEnv(table, [1.0, 0.0, 0.0]))])
    model = TabularQ("MlpPolicy", env, method="polynomial", gamma=GAMMA, exploration_final_eps=0.5, seed=0)
    entries, memory = Entries(), Memory()
    model.set_logger(Logger(None, [entries]))
    model.learn(n_steps, callback=memory, log_interval=10**8)

    assert model.num_timesteps == model._n_updates == model.memory["visits"].sum() == n_steps
    # After the first tenth nothing grows; what the allocator keeps for itself moves by less than this
    sizes = np.array(memory.sizes)
    assert sizes[-len(sizes) // 10 :].max() - sizes[len(sizes) // 10 :].min() < 2**23
    for step, entry in entries.entries:
        assert entry["time/total_timesteps"] == entry["train/n_updates"] == step <= n_steps
        assert entry["rollout/exploration_rate"] == pytest.approx(1.0 - 0.5 * step / n_steps, abs=1e-9)
        assert 0.0 < entry["train/mu_min"] <= entry["train/mu_mean"] <= entry["train/mu_max"] <= 1.0
        assert np.isfinite(entry["train/td_error"])
    if not ends:
        assert model._episode_num == 0 and len(entries.entries) == 1
        return
    counted = [entry["time/episodes"] for _, entry in entries.entries]
    assert counted == sorted(counted) and counted[-1] == model._episode_num
    shortest, longest = (best(iterated(best, 1.0, rewards=False)[0]) for best in (np.min, np.max))
    assert shortest < n_steps / counted[-1] < longest
    if n_steps >= 10**10:
        assert model._episode_num > 2**31
        assert len(counted) >= 25
    np.testing.assert_allclose(model.q_table, iterated(np.max, GAMMA), atol=0.01)
