"""Copies of models and of vectorised environments learn on their own, and as the original would."""

import copy
import pickle

import cloudpickle
import numpy as np
import pytest
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env

from sb3_adaptive_q import CompiledVecEnv, EpisodeSeriesCallback, LeanVecEnv, TabularQ

LAKE = "FrozenLake-v1"


@pytest.mark.parametrize("vec_env_cls", [LeanVecEnv, CompiledVecEnv])
def test_a_copied_vec_env_steps_its_own_environments(vec_env_cls):
    env = make_vec_env(LAKE, env_kwargs={"is_slippery": False}, vec_env_cls=vec_env_cls)
    env.reset()
    twin = copy.deepcopy(env)
    twin.reset()
    for _ in range(2):
        twin.step(np.array([2]))
    assert twin.envs[0].unwrapped.s == 2
    assert env.envs[0].unwrapped.s == 0


@pytest.mark.parametrize("vec_env_cls", [LeanVecEnv, CompiledVecEnv])
@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda model: cloudpickle.loads(cloudpickle.dumps(model))])
def test_a_copied_model_learns_on_as_the_original(vec_env_cls, duplicate):
    model = TabularQ("MlpPolicy", make_vec_env(LAKE, vec_env_cls=vec_env_cls), method=7, seed=0).learn(2000)
    twin = duplicate(model)
    assert twin.mu == model.mu
    before = model.q_table.copy()
    twin.learn(2000, reset_num_timesteps=False)
    np.testing.assert_array_equal(model.q_table, before)
    model.learn(2000, reset_num_timesteps=False)
    np.testing.assert_array_equal(twin.q_table, model.q_table)
    assert twin.mu == model.mu


def test_a_model_from_read_only_memory_learns_on():
    """Programs that share memory between processes hand pickle such buffers."""
    model = TabularQ("MlpPolicy", LAKE, seed=0, initial_q=1.0).learn(300)
    buffers: list[pickle.PickleBuffer] = []
    data = pickle.dumps(model.training, protocol=5, buffer_callback=buffers.append)
    training = pickle.loads(data, buffers=[bytes(each.raw()) for each in buffers])
    assert buffers and training.as_data() == model.training.as_data()
    training.fields.num_timesteps += 1
    assert training.record["num_timesteps"] == 301 and model.num_timesteps == 300


def test_a_lean_vec_env_can_be_pickled():
    env = LeanVecEnv([lambda: __import__("gymnasium").make(LAKE)])
    assert pickle.loads(pickle.dumps(env)).reset().shape == (1,)


class ResetOnTheWay(BaseCallback):
    """Moves the environment behind the agent's back."""

    def _on_step(self):
        if self.num_timesteps == 1000:
            self.training_env.env_method("reset", seed=5)
        return True


def test_a_callback_that_moves_the_environment_moves_the_compiled_one():
    tables = []
    for vec_env_cls in (LeanVecEnv, CompiledVecEnv):
        env = make_vec_env(LAKE, vec_env_cls=vec_env_cls)
        model = TabularQ("MlpPolicy", env, method=7, seed=0, callback_interval=100).learn(5000, callback=ResetOnTheWay())
        tables.append(model.q_table)
    np.testing.assert_array_equal(*tables)


def test_a_replaced_method_starts_from_its_own_rate(tmp_path):
    TabularQ("MlpPolicy", LAKE, method=2).save(tmp_path / "model")
    assert TabularQ.load(tmp_path / "model").mu == 0.05
    for arguments in ({"method": 7}, {"custom_objects": {"method": 7}}):
        loaded = TabularQ.load(tmp_path / "model", env=LAKE, **arguments)
        assert (loaded.mu, loaded.method, loaded.learn(10)._method.data.label) == (0.01, 7, "method7")
    assert TabularQ.load(tmp_path / "model", learning_rate=0.5).mu == 0.5


def test_counts_and_rates_can_be_replaced_by_custom_objects(tmp_path):
    TabularQ("MlpPolicy", LAKE, seed=0).learn(100).save(tmp_path / "model")
    loaded = TabularQ.load(tmp_path / "model", custom_objects={"num_timesteps": 0, "exploration_rate": 0.5})
    assert (loaded.num_timesteps, loaded.exploration_rate) == (0, 0.5)
    assert TabularQ.load(tmp_path / "model", custom_objects={"logger": None, "memory": {}}).num_timesteps == 100


def test_a_method_that_is_assigned_is_in_force_from_the_next_training(tmp_path):
    model = TabularQ("MlpPolicy", LAKE, method=1, seed=0).learn(100)
    model.method = 2
    assert model.learn(100, reset_num_timesteps=False).mu == 0.05
    model.method, model.method_kwargs = "polynomial", {"omega": 0.5}
    assert model.learn(100, reset_num_timesteps=False).memory["visits"].sum() == 100
    assert model.learn(100, reset_num_timesteps=False).memory["visits"].sum() == 200  # the same method goes on
    model.method, model.method_kwargs = 7, None
    model.save(tmp_path / "model")
    assert TabularQ.load(tmp_path / "model", env=LAKE).learn(10, reset_num_timesteps=False)._method.data.label == "method7"
    model.method = model.method_kwargs = None
    assert (model.learn(100, reset_num_timesteps=False).mu, model.memory) == (model.learning_rate, {})


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda each: pickle.loads(pickle.dumps(each))])
def test_a_series_of_episodes_can_be_copied_and_comes_back_from_another_process(copied):
    series = EpisodeSeriesCallback()
    TabularQ("MlpPolicy", LAKE, seed=0).learn(1000, callback=[series, series])
    series.title = "lake"
    theirs = copied(series)
    assert theirs.title == "lake" and theirs.num_timesteps == 1000
    assert len(theirs.returns) > 10 and theirs.lengths.sum() <= 1000  # though it was handed over twice
    np.testing.assert_array_equal(theirs.returns, series.returns)
    assert TabularQ("MlpPolicy", LAKE, seed=0).learn(1000, callback=theirs).num_timesteps == 1000


def test_any_callback_can_be_copied_after_a_training():
    callback = ResetOnTheWay()
    model = TabularQ("MlpPolicy", LAKE, seed=0).learn(2000, callback=callback)
    theirs = cloudpickle.loads(cloudpickle.dumps(callback))
    assert theirs.locals["rollout"] is None
    np.testing.assert_array_equal(theirs.model.q_table, model.q_table)
