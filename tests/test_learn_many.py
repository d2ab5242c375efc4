"""Independent learners side by side: each ends as it would alone."""

import re
import time

import gymnasium as gym
import numpy as np
import pytest
from helpers.both_paths import make_model, make_vec
from stable_baselines3.common.utils import get_latest_run_id

from sb3_adaptive_q import CompiledVecEnv, TabularQ, learn_many

LAKE = "slippery lake"


def models(compiled=True):
    """Of different environments, methods and seeds, one on three environments at once."""
    return [
        make_model(LAKE, compiled, method=1, seed=1, initial_q=0.5),
        make_model(LAKE, compiled, method=7, seed=2, initial_q=0.5),
        make_model("CartPole", compiled, method=7, seed=3),
        make_model("CartPoleFriction", compiled, 3, method=5, seed=4),
        make_model("Taxi", compiled, method=None, learning_rate=0.2, seed=5, total_episodes=60),
    ]


def assert_equal(ours, theirs):
    for our, their in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(our.q_table, their.q_table)
        for name in ("mu", "num_timesteps", "_episode_num", "_n_updates", "exploration_rate"):
            assert getattr(our, name) == getattr(their, name), name
        assert our.training.record.tobytes() == their.training.record.tobytes()
        episodes = [[(info["r"], info["l"]) for info in model.ep_info_buffer] for model in (our, their)]
        assert episodes[0] == episodes[1]


class TestSameAsOneByOne:
    @pytest.mark.parametrize("workers", [None, 1, 2, 20])
    def test_on_the_compiled_path(self, workers):
        together = models()
        assert learn_many(together, 30_000, workers=workers, log_interval=None) == together
        assert_equal(together, [model.learn(30_000, log_interval=None) for model in models()])

    def test_and_as_on_the_ordinary_path(self):
        together = learn_many(models(), 6_000, workers=2, log_interval=None)
        assert_equal(together, [model.learn(6_000, log_interval=None) for model in models(compiled=False)])

    def test_going_on(self):
        together, alone = models(), models()
        for _ in range(2):
            learn_many(together, 3_000, workers=2, log_interval=None, reset_num_timesteps=False)
            for model in alone:
                model.learn(3_000, log_interval=None, reset_num_timesteps=False)
        assert_equal(together, alone)

    def test_none_at_all(self):
        assert learn_many([], 100) == []


class TestWhatIsRefused:
    def refused(self, *parts):
        return pytest.raises(ValueError, match="(?s)" + ".*".join(re.escape(part) for part in parts))

    def test_an_environment_that_is_not_compiled(self):
        with self.refused("CompiledVecEnv", "model 1", "LeanVecEnv"):
            learn_many([make_model(LAKE, True), make_model(LAKE, False)], 100)

    def test_no_environment(self):
        with self.refused("CompiledVecEnv", "model 0"):
            learn_many([TabularQ("MlpPolicy", None, _init_setup_model=False)], 100)

    def test_one_model_twice(self):
        model = make_model(LAKE, True)
        with self.refused("once", "twice"):
            learn_many([model, model], 100)

    def test_one_environment_for_two(self):
        env = make_vec(LAKE, True)
        with self.refused("environments of their own", "share"):
            learn_many([TabularQ("MlpPolicy", env), TabularQ("MlpPolicy", env)], 100)

    def test_one_environment_inside_two(self):
        inner = gym.make("FrozenLake-v1")
        pair = [TabularQ("MlpPolicy", CompiledVecEnv([lambda: inner])) for _ in range(2)]
        with self.refused("environments of their own", "share"):
            learn_many(pair, 100)

    @pytest.mark.parametrize("workers", [0, -1])
    def test_workers(self, workers):
        with self.refused("workers", "from 1 to 1024", str(workers)):
            learn_many([make_model(LAKE, True)], 100, workers=workers)

    def test_nothing_has_changed_then(self):
        first = make_model(LAKE, True, initial_q=0.5)
        with self.refused("CompiledVecEnv"):
            learn_many([first, make_model(LAKE, False)], 100)
        assert first.num_timesteps == 0 and (first.q_table == 0.5).all()

    def test_an_error_of_one_is_heard(self):
        rates = [0.1]  # machine code cannot hold a list
        wrong = make_model(LAKE, True, learning_rate=lambda remaining: rates[0] * remaining)
        with self.refused("learning_rate", "`rates`", "list"):
            learn_many([make_model(LAKE, True), wrong], 100)


def test_logs_are_kept_apart(tmp_path, monkeypatch):
    def take_a_while(*arguments):
        number = get_latest_run_id(*arguments)
        time.sleep(0.02)  # for another thread to find the same
        return number

    monkeypatch.setattr("stable_baselines3.common.utils.get_latest_run_id", take_a_while)
    many = [make_model(LAKE, True, seed=seed, tensorboard_log=str(tmp_path)) for seed in range(4)]
    learn_many(many, 500, workers=4)
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"TabularQ_{i}" for i in (1, 2, 3, 4)]
