"""Saved models: what is in the file, what comes back, and what is refused."""

import importlib
import io
import json
import os
import resource
import subprocess
import sys
import warnings
import zipfile
from collections import deque
from functools import partial
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from helpers.environments import Episode, RenumberAction, RenumberObservation, SampledEnv, ScriptedEnv, Step
from helpers.paper_learner import learn_by_the_paper, paper_rates
from helpers.recording import Recorder
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.utils import ConstantSchedule, FloatSchedule, LinearSchedule
from stable_baselines3.common.vec_env import DummyVecEnv

from sb3_adaptive_q import (
    METHODS,
    DoubleQ,
    LearningRateCallback,
    LinearDecayCallback,
    SARSALambda,
    TabularQ,
    TabularQPolicy,
    method,
)
from sb3_adaptive_q.saved_values import decode, decode_schedule, encode, encode_schedule

LAKE = "FrozenLake-v1"
SCRIPT = [
    Episode(0, [Step(8.0, 1), Step(0.0, 0), Step(-4.0, 2), Step(0.0, 3, "terminated")]),
    Episode(2, [Step(16.0, 0), Step(0.0, 1, "truncated")]),
]


def greedy_on_script(**arguments):
    env = DummyVecEnv([lambda: ScriptedEnv(SCRIPT)])
    return TabularQ("MlpPolicy", env, exploration_initial_eps=0.0, exploration_final_eps=0.0, ties="first", **arguments)


def make_lake():
    return gym.make(LAKE)


DATA = Path(__file__).parent / "data"


def data_of(path):
    with zipfile.ZipFile(path) as file:
        return json.loads(file.read("data"))


def arrays_of(path):
    with zipfile.ZipFile(path) as file:
        return dict(np.load(io.BytesIO(file.read("arrays.npz")), allow_pickle=False))


def halve(left):
    return 0.5 * left


#: Parameters of the right names and shapes, but of other kinds of numbers
COMPLEX = {"q_table": th.ones(16, 4) * 1j, "mu": th.ones(1), "memory_visits": th.ones(1, 16, 4)}
FLAGS = {"q_table": th.ones(16, 4) > 0.0, "mu": th.ones(1), "memory_visits": th.ones(1, 16, 4)}


class TestFile:
    def test_the_table_is_in_the_file_once(self, tmp_path):
        env = SampledEnv(spaces.Discrete(3000), spaces.Discrete(5))
        model = TabularQ("MlpPolicy", env, method=7, seed=0).learn(500)
        model.q_table[:] = np.random.default_rng(0).random(model.q_table.shape)
        model.save(tmp_path / "model.zip")
        content = (tmp_path / "model.zip").read_bytes()
        assert [content.count(model.q_table[row].tobytes()) for row in (0, 1234, 2999)] == [1, 1, 1]
        assert len(content) < 1.2 * model.q_table.nbytes

    def test_arrays_are_float64_and_hold_no_objects(self, tmp_path):
        model = TabularQ("MlpPolicy", LAKE, seed=0, initial_q=1.0, method="polynomial").learn(500)
        model.save(tmp_path / "model.zip")
        arrays = {name[7:]: array for name, array in arrays_of(tmp_path / "model.zip").items() if name.startswith("policy.")}
        assert {name: array.dtype for name, array in arrays.items()} == dict.fromkeys(
            ["q_table", "mu", "memory_visits"], np.float64
        )
        np.testing.assert_array_equal(arrays["q_table"], model.q_table)
        np.testing.assert_array_equal(arrays["memory_visits"][0], model.memory["visits"])
        assert arrays["memory_visits"].sum() == 500
        assert arrays["mu"] == model.mu

    def test_plain_data_has_the_format_version_and_the_method(self, tmp_path):
        TabularQ("MlpPolicy", LAKE, method=5, method_kwargs={"gain": -0.125}).save(tmp_path / "model.zip")
        data = data_of(tmp_path / "model.zip")
        assert (data["format_version"], data["algorithm"]) == (2, "TabularQ")
        assert (data["attributes"]["method"], data["attributes"]["method_kwargs"]) == (5, {"gain": -0.125})
        assert data["attributes"]["gamma"] == 0.99
        assert data["method"]["parameters"] == {"gain": -0.125, "lower": 0.001, "upper": 0.01}

    def test_a_buffer_will_do_for_a_file(self):
        model = TabularQ("MlpPolicy", LAKE, seed=0, initial_q=1.0).learn(500)
        buffer = io.BytesIO()
        model.save(buffer)
        buffer.seek(0)
        np.testing.assert_array_equal(TabularQ.load(buffer).q_table, model.q_table)

    def test_paths_are_completed_as_stable_baselines_does(self, tmp_path):
        model = TabularQ("MlpPolicy", LAKE)
        (tmp_path / "folder.a").mkdir()
        with pytest.warns(UserWarning, match=r"folder\.a' is a folder. Will save instead to"):
            model.save(tmp_path / "folder.a")
        with pytest.warns(UserWarning, match=r"deeper' does not exist. Will create it"):
            model.save(str(tmp_path / "new" / "deeper" / "model"))
        assert (tmp_path / "folder.a_2").is_file() and (tmp_path / "new" / "deeper" / "model.zip").is_file()

    def test_what_is_no_data_is_left_out_with_one_warning(self, tmp_path):
        model = TabularQ("MlpPolicy", LAKE)
        model.plan, model.notes, model.shape = (
            object(),
            {"a": (1, 2.5), 3: deque([None], maxlen=2)},
            np.arange(6).reshape(2, 3),
        )
        with pytest.warns(UserWarning, match=r"Not saved.*plan \(a object\)\.") as caught:
            model.save(tmp_path / "model")
        assert len(caught) == 1
        loaded = TabularQ.load(tmp_path / "model")
        assert not hasattr(loaded, "plan") and loaded.notes == model.notes and loaded.notes[3].maxlen == 2
        np.testing.assert_array_equal(loaded.shape, model.shape)

    def test_exclude_and_include(self, tmp_path):
        model = TabularQ("MlpPolicy", LAKE, gamma=0.5, verbose=0, stats_window_size=7)
        model.save(tmp_path / "model", exclude=["gamma", "_stats_window_size"], include=["_stats_window_size"])
        loaded = TabularQ.load(tmp_path / "model")
        assert (loaded.gamma, loaded._stats_window_size) == (0.99, 7)

    def test_system_info_is_printed(self, tmp_path, capsys):
        TabularQ("MlpPolicy", LAKE).save(tmp_path / "model")
        capsys.readouterr()
        TabularQ.load(tmp_path / "model", print_system_info=True)
        current, _, saved = capsys.readouterr().out.partition("== SAVED MODEL SYSTEM INFO ==\n")
        assert current.startswith("== CURRENT SYSTEM INFO ==\n")
        assert saved.strip() and saved.strip() in current


class TestWholeOrNotAtAll:
    """That a file that is there survives a kill in the middle of a write is seen in test_resume.py."""

    @pytest.fixture
    def models(self):
        env = SampledEnv(spaces.Discrete(5000), spaces.Discrete(4))
        return [TabularQ("MlpPolicy", env, initial_q=value) for value in (1.0, 2.0)]

    def test_a_full_disk_leaves_the_old_file(self, tmp_path, models):
        """The limit on the size of a file stands for the disk: the write breaks off in the middle."""
        models[0].save(tmp_path / "model")
        limits = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, limits[1]))
        try:
            with pytest.raises(OSError, match=r"File too large; a file that was there before is as it was.*model\.zip"):
                models[1].save(tmp_path / "model")
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        assert (TabularQ.load(tmp_path / "model").q_table == 1.0).all()
        assert os.listdir(tmp_path) == ["model.zip"]

    def test_a_small_disk_leaves_the_old_file(self, tmp_path, models):
        """A disk of its own in memory, where the system lets us have one."""
        (disk := tmp_path / "disk").mkdir()
        if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=300k", "tmpfs", str(disk)], capture_output=True).returncode:
            pytest.skip("no file system may be mounted here")
        try:
            models[0].save(disk / "model")
            with pytest.raises(OSError, match=r"No space left on device; a file that was there before is as it was"):
                models[1].save(disk / "model")
            assert (TabularQ.load(disk / "model").q_table == 1.0).all()
            assert os.listdir(disk) == ["model.zip"]
        finally:
            subprocess.run(["umount", str(disk)], check=True)

    def test_an_interrupt_leaves_the_old_file(self, tmp_path, models, monkeypatch):
        models[0].save(tmp_path / "model")

        def interrupt(descriptor):
            raise KeyboardInterrupt

        monkeypatch.setattr(os, "fsync", interrupt)
        with pytest.raises(KeyboardInterrupt):
            models[1].save(tmp_path / "model")
        assert (TabularQ.load(tmp_path / "model").q_table == 1.0).all()
        assert os.listdir(tmp_path) == ["model.zip"]

    def test_mode_and_link_of_an_old_file_are_kept(self, tmp_path, models):
        models[0].save(tmp_path / "model")
        (tmp_path / "model.zip").chmod(0o640)
        (tmp_path / "newest.zip").symlink_to("model.zip")
        models[1].save(tmp_path / "newest")
        assert (tmp_path / "newest.zip").is_symlink()
        assert (tmp_path / "model.zip").stat().st_mode & 0o777 == 0o640
        assert (TabularQ.load(tmp_path / "model").q_table == 2.0).all()


class TestValues:
    """What goes into a file comes out of it."""

    @pytest.mark.parametrize(
        "value",
        [
            None, True, -7, 2**70, 0.1, float("inf"), -float("inf"), "text", [1, [2.0]], (1, (None,)), {}, {"a": {"b": []}},
            {1: "one", (2, 3): "two"}, {":kind:": "mine"}, deque([1, 2], maxlen=2),
        ],
        ids=repr,
    )  # fmt: skip
    def test_plain_values(self, value):
        arrays = {}
        loaded = decode(json.loads(json.dumps(encode(value, arrays), allow_nan=False)), arrays)
        assert (loaded, type(loaded)) == (value, type(value)) and arrays == {}

    def test_numbers_of_numpy_become_those_of_python(self):
        values = [np.int64(3), np.float32(0.1), np.bool_(True), np.float64("nan")]
        loaded = decode(json.loads(json.dumps(encode(values, {}))), {})
        assert [type(value) for value in loaded] == [int, float, bool, float]
        np.testing.assert_array_equal(loaded, [3, float(np.float32(0.1)), True, np.nan])

    @pytest.mark.parametrize(
        "space",
        [
            spaces.Discrete(5, start=-2),
            spaces.MultiDiscrete([[2, 3], [4, 5]], start=[[0, 1], [2, 3]]),
            spaces.MultiBinary(3),
            spaces.MultiBinary([2, 2]),
            spaces.Tuple([spaces.Discrete(2), spaces.Tuple([spaces.MultiBinary(2)])]),
            spaces.Dict({"b": spaces.Discrete(2), "a": spaces.MultiDiscrete([2, 2])}),
            spaces.Box(np.array([0.0, -np.inf], np.float32), np.array([1.0, np.inf], np.float32)),
            spaces.Box(-1, 1, shape=(2, 2), dtype=np.float64),
        ],
        ids=str,
    )
    def test_spaces(self, space):
        arrays = {}
        assert decode(json.loads(json.dumps(encode(space, arrays))), arrays) == space

    @pytest.mark.parametrize(
        "schedule",
        [0.5, 1, "linear", ConstantSchedule(0.25), LinearSchedule(0.5, 0.1, 0.75), FloatSchedule(0.125), halve],
        ids=lambda schedule: getattr(schedule, "__name__", repr(schedule)),
    )
    def test_schedules(self, schedule):
        loaded = decode_schedule(json.loads(json.dumps(encode_schedule(schedule))))
        assert type(loaded) is type(schedule)
        if callable(schedule):
            assert [loaded(left) for left in (1.0, 0.6, 0.0)] == [schedule(left) for left in (1.0, 0.6, 0.0)]
        else:
            assert loaded == schedule


class TestLoad:
    def test_everything_comes_back(self, tmp_path):
        arguments = {
            "gamma": 0.75,
            "learning_rate": 0.125,
            "exploration_fraction": 0.5,
            "exploration_initial_eps": 0.875,
            "exploration_final_eps": 0.25,
            "initial_q": 0.0625,
            "total_episodes": 1000,
            "callback_interval": 77,
            "seed": 4,
        }
        model = TabularQ("MlpPolicy", LAKE, **arguments).learn(700)
        model.save(tmp_path / "model")
        loaded = TabularQ.load(tmp_path / "model", env=make_lake())
        assert {name: getattr(loaded, name) for name in arguments} == arguments
        np.testing.assert_array_equal(loaded.q_table, model.q_table)
        names = ("mu", "num_timesteps", "exploration_rate", "_episode_num", "_n_updates")
        assert [getattr(loaded, name) for name in names] == [getattr(model, name) for name in names]
        observations = np.arange(16)
        np.testing.assert_array_equal(
            loaded.predict(observations, deterministic=True)[0], model.predict(observations, deterministic=True)[0]
        )

    def test_without_an_environment_a_model_predicts(self, tmp_path):
        model = TabularQ("MlpPolicy", LAKE, seed=0, initial_q=1.0, method=7).learn(3000)
        model.save(tmp_path / "model")
        loaded = TabularQ.load(tmp_path / "model")
        assert loaded.env is None
        np.testing.assert_array_equal(loaded.predict(np.arange(16), deterministic=True)[0], model.q_table.argmax(axis=1))
        assert 0 <= loaded.predict(3)[0] < 4
        loaded.set_env(make_lake())
        loaded.learn(100)

    def test_exploration_of_predict_comes_back(self, tmp_path):
        """At ε = 1 one thousand predictions in one state are not all the same, but with a probability of 4^-999."""
        TabularQ("MlpPolicy", LAKE, exploration_final_eps=1.0).learn(10).save(tmp_path / "model")
        assert len(set(TabularQ.load(tmp_path / "model").predict(np.zeros(1000, int))[0])) > 1

    @pytest.mark.parametrize("number", sorted(METHODS))
    @pytest.mark.parametrize("installed_by", ["constructor", "callback"])
    def test_method_and_rate_come_back_and_go_on(self, tmp_path, number, installed_by):
        """After loading, the reference continues from the table and the rate of the file."""
        if installed_by == "constructor":
            model = greedy_on_script(method=number, gamma=0.5).learn(7)
        else:
            model = greedy_on_script(gamma=0.5).learn(7, callback=method(number))
        model.save(tmp_path / "model")
        table, rate = model.q_table.tolist(), model.mu

        loaded = TabularQ.load(tmp_path / "model", env=DummyVecEnv([lambda: ScriptedEnv(SCRIPT)]))
        assert loaded.mu == rate
        recorder = Recorder()
        loaded.learn(13, callback=recorder, reset_num_timesteps=False)
        reading = "same" if number in (5, 6) else "next"

        def rule(mu, here, there, progress):  # the progress is that of the whole, 8 to 20 of 20 steps
            return paper_rates(float)[number](mu, here, there, (7 + 13 * progress) / 20)

        moments = learn_by_the_paper([ScriptedEnv(SCRIPT)], 13, table, 0.5, rate, rule, reading)
        np.testing.assert_allclose(recorder.rates, [moment.mu for moment in moments], rtol=1e-12)
        np.testing.assert_allclose(recorder.tables, [moment.table for moment in moments], rtol=1e-12)

    def test_starting_again_starts_from_the_methods_first_rate(self, tmp_path):
        model = greedy_on_script(method=8, method_kwargs={"mu_0": 0.0075}).learn(2)
        assert model.mu != 0.0075
        model.save(tmp_path / "model")
        loaded = TabularQ.load(tmp_path / "model", env=ScriptedEnv(SCRIPT))
        recorder = Recorder()
        loaded.learn(3, callback=recorder)
        assert recorder.rates[0] == 0.0075

    def test_the_callbacks_method_is_kept_over_the_constructors(self, tmp_path):
        model = greedy_on_script(method=1).learn(5, callback=LinearDecayCallback(0.25, 0.5))
        model.save(tmp_path / "model")
        recorder = Recorder()
        TabularQ.load(tmp_path / "model", env=ScriptedEnv(SCRIPT)).learn(4, callback=recorder)
        assert recorder.rates == [0.75, 0.625, 0.5, 0.375, 0.25]

    @pytest.mark.parametrize("saved_with", [None, 1])
    def test_a_method_asked_for_on_loading_replaces_the_saved_one(self, tmp_path, saved_with):
        """As the RL Zoo does when it continues a model with other hyperparameters."""
        greedy_on_script(method=saved_with).learn(5).save(tmp_path / "model")
        env = ScriptedEnv(SCRIPT)
        loaded = TabularQ.load(tmp_path / "model", env=env, method=3, method_kwargs={"beta_1": 0.25, "beta_3": 0.5})
        recorder = Recorder()
        loaded.learn(4, callback=recorder)
        assert recorder.rates == [0.75, 0.625, 0.5, 0.375, 0.25]

    @pytest.mark.parametrize(("asked_for", "rate"), [({"method": 2}, 0.05), ({"method": None}, 0.25)], ids=str)
    def test_parameters_of_the_saved_method_do_not_outlive_it(self, tmp_path, asked_for, rate):
        """They would not be the other method's; without any method, the learning rate is in force."""
        model = greedy_on_script(method=7, method_kwargs={"step": 0.001}, learning_rate=0.25)
        model.learn(5).save(tmp_path / "model")
        recorder = Recorder()
        TabularQ.load(tmp_path / "model", env=ScriptedEnv(SCRIPT), **asked_for).learn(3, callback=recorder)
        assert recorder.rates == [rate] * 4

    def test_the_view_is_live_after_loading(self, tmp_path):
        model = greedy_on_script(learning_rate=0.5, gamma=0.0).learn(2)
        model.save(tmp_path / "model")
        loaded = TabularQ.load(tmp_path / "model", env=ScriptedEnv(SCRIPT))
        view = loaded.q_table
        loaded.learn(1)
        assert view[0, 0] == 6.0  # 4, then halfway to 8
        assert loaded.policy.q_table[0, 0].item() == 6.0
        view[3] = [1.0, 2.0]
        assert loaded.predict(3, deterministic=True)[0] == 1

    def test_a_model_saved_again_after_loading_is_the_same(self, tmp_path):
        greedy_on_script(method=6).learn(9).save(tmp_path / "first")
        TabularQ.load(tmp_path / "first", env=ScriptedEnv(SCRIPT)).learn(5, reset_num_timesteps=False).save(
            tmp_path / "second"
        )
        once = TabularQ.load(tmp_path / "first", env=ScriptedEnv(SCRIPT)).learn(5, reset_num_timesteps=False)
        twice = TabularQ.load(tmp_path / "second")
        np.testing.assert_array_equal(once.q_table, twice.q_table)
        assert (once.mu, once.num_timesteps) == (twice.mu, twice.num_timesteps)

    @pytest.mark.parametrize("schedule", [halve, LinearSchedule(0.5, 0.0, 1.0)], ids=["function", "line"])
    def test_a_schedule_comes_back(self, tmp_path, schedule):
        greedy_on_script(learning_rate=schedule).learn(5).save(tmp_path / "model")
        recorder = Recorder()
        TabularQ.load(tmp_path / "model", env=ScriptedEnv(SCRIPT)).learn(4, callback=recorder)
        assert recorder.rates == [0.5, 0.375, 0.25, 0.125, 0.0]

    @pytest.mark.parametrize(("given", "rates"), [(0.25, [0.25] * 5), (halve, [0.5, 0.375, 0.25, 0.125, 0.0])])
    def test_a_learning_rate_that_was_assigned_since_counts(self, tmp_path, given, rates):
        model = greedy_on_script(learning_rate=0.125).learn(5)
        model.learning_rate = given
        model.save(tmp_path / "model")
        recorder = Recorder()
        TabularQ.load(tmp_path / "model", env=ScriptedEnv(SCRIPT)).learn(4, callback=recorder)
        assert recorder.rates == rates

    def test_a_schedule_set_on_the_model_comes_back(self, tmp_path):
        model = greedy_on_script(learning_rate=0.125).learn(5)
        model.lr_schedule = FloatSchedule(halve)
        model.save(tmp_path / "model")
        recorder = Recorder()
        TabularQ.load(tmp_path / "model", env=ScriptedEnv(SCRIPT)).learn(4, callback=recorder)
        assert recorder.rates == [0.5, 0.375, 0.25, 0.125, 0.0]

    def test_random_numbers_go_on(self, tmp_path):
        """What 50 files learn, each from the one before, is about what one training of that length learns."""
        arguments = {"seed": 0, "exploration_final_eps": 1.0, "learning_rate": 0.5}
        whole = TabularQ("MlpPolicy", "Taxi-v4", **arguments).learn(2_500)
        model = TabularQ("MlpPolicy", "Taxi-v4", **arguments).learn(50)
        for _ in range(49):
            model.save(tmp_path / "model")
            model = TabularQ.load(tmp_path / "model", env="Taxi-v4").learn(50, reset_num_timesteps=False)
        assert model.num_timesteps == 2_500
        assert np.count_nonzero(model.q_table) > 0.7 * np.count_nonzero(whole.q_table) > 500

    def test_a_seed_asked_for_on_loading_begins_anew(self, tmp_path):
        TabularQ("MlpPolicy", LAKE, seed=0).learn(100).save(tmp_path / "model")
        first, second = (
            TabularQ.load(tmp_path / "model", env=make_lake(), seed=3, learning_rate=0.5).learn(300) for _ in range(2)
        )
        np.testing.assert_array_equal(first.q_table, second.q_table)
        fresh = TabularQ("MlpPolicy", make_lake(), seed=3)
        assert TabularQ.load(tmp_path / "model", seed=3).training.draws == fresh.training.draws

    def test_an_untrained_model_learns_as_if_it_had_not_been_saved(self, tmp_path):
        model = TabularQ("MlpPolicy", LAKE, seed=0, initial_q=1.0)
        model.save(tmp_path / "model")
        loaded = TabularQ.load(tmp_path / "model", env=make_lake())
        np.testing.assert_array_equal(loaded.learn(500).q_table, model.learn(500).q_table)

    def test_without_a_reset_the_episode_goes_on(self, tmp_path):
        """SB3's way to go on in the same process, where the environment itself is still there."""
        env = DummyVecEnv([make_lake])
        whole = TabularQ("MlpPolicy", make_lake(), seed=0, initial_q=1.0).learn(200).learn(200, reset_num_timesteps=False)
        TabularQ("MlpPolicy", env, seed=0, initial_q=1.0).learn(200).save(tmp_path / "model")
        loaded = TabularQ.load(tmp_path / "model", env=env, force_reset=False).learn(200, reset_num_timesteps=False)
        np.testing.assert_array_equal(loaded.q_table, whole.q_table)
        assert loaded.num_timesteps == 400

    def test_what_the_zoo_puts_in_on_loading(self, tmp_path):
        TabularQ("MlpPolicy", LAKE, seed=0, initial_q=1.0).learn(500).save(tmp_path / "model")
        replaced = {"learning_rate": 0.0, "lr_schedule": lambda _: 0.0, "clip_range": lambda _: 0.0}
        loaded = TabularQ.load(tmp_path / "model", env=make_lake(), custom_objects=replaced)
        assert loaded.learning_rate == 0.0 and not hasattr(loaded, "clip_range")
        table = loaded.q_table.copy()
        np.testing.assert_array_equal(loaded.learn(200).q_table, table)

    @pytest.mark.filterwarnings("error")
    def test_what_the_zoo_puts_in_is_ignored_where_a_method_is_in_force(self, tmp_path):
        greedy_on_script(method=2, learning_rate=0.25).learn(5).save(tmp_path / "model")
        replaced = {"learning_rate": 0.0, "lr_schedule": lambda _: 0.0}
        loaded = TabularQ.load(tmp_path / "model", env=ScriptedEnv(SCRIPT), custom_objects=replaced)
        recorder = Recorder()
        loaded.learn(3, callback=recorder)
        assert recorder.rates == [0.05] * 4 and loaded.learning_rate == 0.25

    @pytest.mark.parametrize(("name", "value"), [("exploration_rate", 0.5), ("mu", 0.125), ("num_timesteps", 7)])
    def test_numbers_that_are_no_arguments_can_be_asked_for_too(self, tmp_path, name, value):
        TabularQ("MlpPolicy", LAKE).learn(20).save(tmp_path / "model")
        assert getattr(TabularQ.load(tmp_path / "model", **{name: value}), name) == value

    def test_arrays_of_another_size_begin_anew(self, tmp_path):
        """How many pairs have traces depends on γ."""
        SARSALambda("MlpPolicy", LAKE, seed=0).learn(50).save(tmp_path / "model")
        for env in (None, make_lake()):
            model = SARSALambda.load(tmp_path / "model", env=env, gamma=0.25)
            model.predict(0)
        model.learn(50, reset_num_timesteps=False)

    def test_policy_arguments_must_be_those_of_the_file(self, tmp_path):
        TabularQ("MlpPolicy", LAKE).save(tmp_path / "model")
        TabularQ.load(tmp_path / "model", policy_kwargs={})
        with pytest.raises(ValueError, match=r"policy_kwargs.*as in the file"):
            TabularQ.load(tmp_path / "model", policy_kwargs={"net_arch": [16]})

    def test_more_environments_than_were_saved(self, tmp_path):
        TabularQ("MlpPolicy", LAKE, seed=0, initial_q=1.0, method=7).learn(100).save(tmp_path / "model")
        loaded = TabularQ.load(tmp_path / "model", env=make_vec_env(LAKE, n_envs=3))
        loaded.learn(30)
        assert loaded.n_envs == 3
        assert loaded.num_timesteps == 30

    @pytest.mark.parametrize(
        "space", [spaces.Discrete(16, start=3), spaces.MultiDiscrete([4, 4]), spaces.MultiBinary(4)], ids=str
    )
    def test_every_kind_of_space_comes_back(self, tmp_path, space):
        def env():
            return RenumberAction(RenumberObservation(gym.make(LAKE), space), 1)

        model = TabularQ("MlpPolicy", env(), seed=0, initial_q=1.0).learn(1500)
        model.save(tmp_path / "model")
        loaded = TabularQ.load(tmp_path / "model", env=env())
        np.testing.assert_array_equal(loaded.q_table, model.q_table)
        observations = np.stack([space.sample() for _ in range(5)])
        np.testing.assert_array_equal(
            loaded.predict(observations, deterministic=True)[0], model.predict(observations, deterministic=True)[0]
        )


class TestOtherSizes:
    @pytest.mark.parametrize(
        ("env", "message"),
        [
            (lambda: gym.make(LAKE, map_name="8x8"), r"Observation spaces do not match.*16.*64"),
            (lambda: RenumberObservation(gym.make(LAKE), spaces.Discrete(16, start=1)), "Observation spaces do not match"),
            (lambda: RenumberAction(gym.make(LAKE), 1), "Action spaces do not match"),
        ],
        ids=["more states", "other first state", "other first action"],
    )
    def test_a_model_is_not_loaded_into_another_environment(self, tmp_path, env, message):
        TabularQ("MlpPolicy", LAKE).save(tmp_path / "model")
        with pytest.raises(ValueError, match=message):
            TabularQ.load(tmp_path / "model", env=env())

    def test_parameters_of_another_size_are_refused_and_change_nothing(self):
        small = TabularQ("MlpPolicy", LAKE, seed=0, initial_q=1.0).learn(500)
        large = TabularQ("MlpPolicy", gym.make(LAKE, map_name="8x8"))
        before = small.q_table.copy()
        with pytest.raises(RuntimeError, match=r"size mismatch.*q_table"):
            small.set_parameters(large.get_parameters())
        np.testing.assert_array_equal(small.q_table, before)

    @pytest.mark.parametrize("from_file", [True, False])
    @pytest.mark.parametrize(
        ("change", "message"),
        [
            (lambda policy: policy.mu.fill_(1.5), r"`mu` must be a number from 0 to 1, but got 1\.5"),
            (lambda policy: policy.q_table[3].fill_(np.nan), r"`q_table` must hold finite numbers.*4 of them"),
            (lambda policy: policy.q_table[3, 0].fill_(np.inf), "`q_table` must hold finite numbers"),
            (lambda policy: policy.memory_visits[0, 2, 1].fill_(np.nan), r"`memory_visits`.*NaN"),
        ],
        ids=["step size", "NaN", "infinity", "memory"],
    )
    def test_numbers_out_of_range_are_refused_and_change_nothing(self, tmp_path, from_file, change, message):
        teacher, pupil = (TabularQ("MlpPolicy", LAKE, initial_q=q, method="polynomial") for q in (1.0, 0.5))
        mu = pupil.mu
        change(teacher.policy)
        with pytest.warns(UserWarning, match=f"`load` will refuse the file .*: {message}.*Did the training diverge"):
            teacher.save(tmp_path / "model")
        with pytest.raises(ValueError, match=message) as caught:
            pupil.set_parameters(tmp_path / "model" if from_file else teacher.get_parameters())
        assert ("model.zip" in str(caught.value)) == from_file
        assert (pupil.q_table == 0.5).all() and pupil.mu == mu and (pupil.memory["visits"] == 0.0).all()
        with pytest.raises(ValueError, match=r"model\.zip cannot be loaded: " + message):
            TabularQ.load(tmp_path / "model")

    @pytest.mark.parametrize(
        ("parameters", "error"),
        [
            ({"policy": {"q_table": th.ones(16, 4)}}, RuntimeError),
            ({"policy": {"q_table": th.ones(16, 4), "mu": th.ones(1), "memory_visits": th.ones(16, 4)}}, RuntimeError),
            ({"policy": {"q_table": th.ones(16, 4), "mu": th.ones(1), "memory_other": th.ones(1)}}, RuntimeError),
            ({"policy": {}, "optimizer": {}}, ValueError),
            ({}, ValueError),
            ({"policy": None}, ValueError),
            ({"policy": COMPLEX}, ValueError),
            ({"policy": FLAGS}, ValueError),
        ],
        ids=["missing", "wrong shape", "unknown", "other object", "nothing", "no dict", "complex", "flags"],
    )
    def test_parameters_of_another_model_change_nothing(self, parameters, error):
        model = TabularQ("MlpPolicy", LAKE, initial_q=0.5, method="polynomial")
        with pytest.raises(error):
            model.set_parameters(parameters)
        assert (model.q_table == 0.5).all() and (model.memory["visits"] == 0.0).all()

    def test_masks_may_be_truth_values(self):
        model = TabularQ("MlpPolicy", make_vec_env("Taxi-v4"), use_masking=True)
        masks = th.ones((500, 6), dtype=th.bool)
        masks[3, 2] = False
        model.set_parameters({"policy": {"allowed": masks}}, exact_match=False)
        assert (model.policy.allowed.numpy() == masks.numpy()).all()

    def test_some_parameters_can_be_set(self):
        model = TabularQ("MlpPolicy", LAKE, method="polynomial")
        model.set_parameters({"policy": {"q_table": th.ones(16, 4)}}, exact_match=False)
        assert (model.q_table == 1.0).all() and (model.memory["visits"] == 0.0).all()

    def test_arguments_out_of_range_are_refused_on_loading(self, tmp_path):
        TabularQ("MlpPolicy", LAKE).save(tmp_path / "model")
        with pytest.raises(ValueError, match=r"gamma.*0 to 1.*2"):
            TabularQ.load(tmp_path / "model", gamma=2.0)


class TestParametersFromFile:
    def test_set_parameters_takes_a_file(self, tmp_path):
        teacher = TabularQ("MlpPolicy", LAKE, seed=0, initial_q=1.0, method=8).learn(3000)
        teacher.save(tmp_path / "model")
        pupil = TabularQ("MlpPolicy", LAKE, seed=1, method=8)
        view = pupil.q_table
        pupil.set_parameters(str(tmp_path / "model.zip"), exact_match=True)
        np.testing.assert_array_equal(view, teacher.q_table)
        assert pupil.mu == teacher.mu


class TestPolicyAlone:
    def test_save_and_load(self, tmp_path):
        model = TabularQ("MlpPolicy", LAKE, seed=0, initial_q=1.0, method=7).learn(3000)
        model.policy.save(tmp_path / "policy.pth")
        policy = TabularQPolicy.load(tmp_path / "policy.pth")
        np.testing.assert_array_equal(policy.q_table.numpy(), model.q_table)
        assert policy.q_table.dtype == th.float64
        assert policy.mu.item() == model.mu
        np.testing.assert_array_equal(policy.predict(np.arange(16))[0], model.q_table.argmax(axis=1))

    @pytest.mark.parametrize("kind", [partial(TabularQ, method="polynomial"), DoubleQ])
    def test_with_further_buffers(self, tmp_path, kind):
        model = kind("MlpPolicy", LAKE, seed=0, initial_q=1.0).learn(300)
        model.policy.save(tmp_path / "policy.pth")
        theirs, ours = TabularQPolicy.load(tmp_path / "policy.pth").state_dict(), model.policy.state_dict()
        assert theirs.keys() == ours.keys() > {"q_table", "mu"}
        assert all(th.equal(theirs[name], ours[name]) for name in ours)

    def test_with_layers_of_its_own(self, tmp_path):
        class Layered(TabularQPolicy):
            def __init__(self, *args, **kwargs):
                super().__init__(*args, **kwargs)
                self.layer = th.nn.Linear(2, 2)

        model = TabularQ(Layered, LAKE, method="polynomial", seed=0).learn(300)
        model.policy.save(tmp_path / "policy.pth")
        theirs, ours = Layered.load(tmp_path / "policy.pth").state_dict(), model.policy.state_dict()
        assert theirs.keys() == ours.keys() > {"layer.weight", "memory_visits"}
        with pytest.raises(RuntimeError, match=r"Unexpected key.*layer\.weight"):
            TabularQPolicy.load(tmp_path / "policy.pth")
        assert all(th.equal(theirs[name], ours[name]) for name in ours)

    def test_with_other_spaces(self, tmp_path):
        env = SampledEnv(spaces.MultiDiscrete([3, 2], start=[1, 0]), spaces.Discrete(4, start=2))
        model = TabularQ("MlpPolicy", env, seed=0, initial_q=0.5).learn(300)
        model.policy.save(tmp_path / "policy.pth")
        policy = TabularQPolicy.load(tmp_path / "policy.pth")
        np.testing.assert_array_equal(policy.q_table.numpy(), model.q_table)
        assert policy.initial_q == 0.5
        assert policy.predict(np.array([3, 1]))[0] == 2 + model.q_table[5].argmax()


class Counted:
    calls = 0


def counted(left):
    Counted.calls += 1
    return 0.5 * left


def test_loading_does_not_call_the_functions_that_a_file_names(tmp_path):
    TabularQ("MlpPolicy", LAKE, learning_rate=counted, exploration_schedule=counted, seed=0).save(tmp_path / "model")
    before = Counted.calls
    loaded = TabularQ.load(tmp_path / "model", env=LAKE)
    assert Counted.calls == before and loaded.learning_rate is counted
    with pytest.warns(UserWarning, match="`learning_rate` or `exploration_schedule` runs as Python"):
        loaded.learn(10)
    assert Counted.calls > before


def test_tables_that_belong_together_are_replaced_together():
    model = DoubleQ("MlpPolicy", LAKE, seed=0)
    tables = {"q_tables": th.ones(2, 16, 4)}
    with pytest.raises(ValueError, match="q_table, q_tables belong together: please give all of them"):
        model.set_parameters({"policy": tables}, exact_match=False)
    assert not model.q_tables.any()
    model.set_parameters({"policy": {**tables, "q_table": th.ones(16, 4)}}, exact_match=False)
    assert model.q_tables.all() and model.q_table.all()


class TestFunctionsThatAreGone:
    """A lambda has no name to find it by: the model predicts, and asks for the function when it is to learn."""

    @pytest.fixture
    def path(self, tmp_path):
        greedy_on_script(learning_rate=lambda left: 0.25 * left).learn(3).save(tmp_path / "model")
        return tmp_path / "model.zip"

    def test_the_model_predicts_and_asks_when_it_learns(self, path):
        loaded = TabularQ.load(path, env=ScriptedEnv(SCRIPT))
        mu = loaded.mu
        loaded.predict(1)
        with pytest.raises(ValueError, match=r"function test_.*<lambda> as its `learning_rate`, which no .*set `model"):
            loaded.learn(4)
        assert loaded.mu == mu and loaded.num_timesteps == 3

    def test_the_model_learns_with_what_it_is_given(self, path):
        for give in (lambda model: setattr(model, "learning_rate", halve), lambda model: setattr(model, "lr_schedule", halve)):
            recorder, loaded = Recorder(), TabularQ.load(path, env=ScriptedEnv(SCRIPT))
            give(loaded)
            loaded.learn(4, callback=recorder)
            assert recorder.rates == [0.5, 0.375, 0.25, 0.125, 0.0]

    def test_a_method_needs_no_schedule(self, path):
        assert TabularQ.load(path, env=ScriptedEnv(SCRIPT)).learn(4, callback=method(2)).mu == 0.05

    def test_the_function_can_be_handed_over_on_loading(self, path):
        for arguments in ({"custom_objects": {"learning_rate": halve}}, {"learning_rate": halve}):
            recorder = Recorder()
            TabularQ.load(path, env=ScriptedEnv(SCRIPT), **arguments).learn(4, callback=recorder)
            assert recorder.rates == [0.5, 0.375, 0.25, 0.125, 0.0]

    def test_a_model_saved_again_still_asks(self, path):
        TabularQ.load(path).save(path)
        with pytest.raises(ValueError, match=r"the function test_save_load:.*<lambda> as its `learning_rate`"):
            TabularQ.load(path, env=ScriptedEnv(SCRIPT)).learn(4)

    def test_an_exploration_schedule_is_asked_for_too(self, tmp_path):
        TabularQ("MlpPolicy", LAKE, exploration_schedule=lambda progress: 1.0 - progress).save(tmp_path / "model")
        loaded = TabularQ.load(tmp_path / "model", env=LAKE)
        with pytest.raises(ValueError, match=r"the function .*<lambda> as its `exploration_schedule`"):
            loaded.learn(10)
        loaded.exploration_schedule = halve
        assert loaded.learn(10).exploration_rate == 0.5

    def test_an_exploration_schedule_with_a_name_comes_back(self, tmp_path):
        TabularQ("MlpPolicy", LAKE, exploration_schedule=halve).save(tmp_path / "model")
        assert TabularQ.load(tmp_path / "model").exploration_schedule is halve


class PolicyOfAUser(TabularQPolicy):
    pass


class TestPoliciesOfAUser:
    def test_a_class_that_is_imported_is_found(self, tmp_path):
        TabularQ(PolicyOfAUser, LAKE).save(tmp_path / "model")
        assert type(TabularQ.load(tmp_path / "model").policy) is PolicyOfAUser

    def test_a_class_that_is_not_is_asked_for(self, tmp_path):
        class Local(TabularQPolicy):
            pass

        TabularQ(Local, LAKE).save(tmp_path / "model")
        with pytest.raises(ValueError, match=r"model\.zip.*class 'test_save_load:.*Local', which is not imported here"):
            TabularQ.load(tmp_path / "model")
        assert type(TabularQ.load(tmp_path / "model", custom_objects={"policy_class": Local}).policy) is Local


class TestFormat1:
    """Files of the first version, one with a method of the constructor and one with that of a callback."""

    @pytest.mark.parametrize("name", ["format_1_method_7", "format_1_callback"])
    def test_table_rate_and_method_come_back(self, name):
        path = DATA / f"{name}.zip"
        with zipfile.ZipFile(path) as file:
            saved = th.load(io.BytesIO(file.read("policy.pth")), weights_only=True)
        loaded = TabularQ.load(path, env=LAKE, allow_pickle=True)
        np.testing.assert_array_equal(loaded.q_table, saved["q_table"].numpy())
        assert loaded.mu == saved["mu"].item()
        expected = {"format_1_method_7": (0.005, 0.9, 3000), "format_1_callback": (-0.001, 0.99, 300)}[name]
        assert (loaded._method.data.parameters["change"], loaded.gamma, loaded.num_timesteps) == expected
        assert 0.001 <= loaded.learn(200, reset_num_timesteps=False).mu <= 0.01

    def test_a_callback_goes_on_with_it(self):
        loaded = TabularQ.load(DATA / "format_1_method_7.zip", env=LAKE, allow_pickle=True)
        mu, recorder = loaded.mu, Recorder()
        loaded.learn(1, callback=[method(7), recorder], reset_num_timesteps=False)
        assert recorder.rates[0] == mu == 0.001

    def test_saved_again_it_is_a_file_of_data(self, tmp_path):
        first = TabularQ.load(DATA / "format_1_method_7.zip", allow_pickle=True)
        first.save(tmp_path / "model")
        second = TabularQ.load(tmp_path / "model")
        np.testing.assert_array_equal(second.q_table, first.q_table)
        assert (second.mu, second._method.data) == (first.mu, first._method.data)

    def test_without_a_word_of_trust_it_is_refused(self):
        for take in (TabularQ.load, TabularQ("MlpPolicy", LAKE).set_parameters):
            with pytest.raises(ValueError, match=r"format_1_method_7\.zip holds pickled objects.*`allow_pickle=True`"):
                take(DATA / "format_1_method_7.zip")


RULE_MODULE = """
from sb3_adaptive_q import LearningRateCallback

def halve(mu, step, least):
    return max(mu / 2.0, least)

class Halving(LearningRateCallback):
    rule = staticmethod(halve)
"""


class TestRulesOfAUser:
    """A rule is saved by the name of its class; without the class the file is still good for what does not need it."""

    @pytest.fixture
    def halving(self, tmp_path, monkeypatch):
        (tmp_path / "rules_of_a_user.py").write_text(RULE_MODULE)
        monkeypatch.syspath_prepend(tmp_path)
        importlib.invalidate_caches()
        yield importlib.import_module("rules_of_a_user").Halving
        sys.modules.pop("rules_of_a_user", None)

    @pytest.fixture
    def path(self, tmp_path, halving):
        greedy_on_script(learning_rate=0.25).learn(3, callback=halving(mu_0=1.0, least=0.0625)).save(tmp_path / "model")
        return tmp_path / "model.zip"

    def forget(self, tmp_path):
        (tmp_path / "rules_of_a_user.py").unlink()
        sys.modules.pop("rules_of_a_user")
        importlib.invalidate_caches()

    def test_a_rule_that_can_be_imported_goes_on(self, path):
        loaded = TabularQ.load(path, env=ScriptedEnv(SCRIPT))
        recorder = Recorder()
        loaded.learn(3, callback=recorder, reset_num_timesteps=False)
        assert recorder.rates == [0.125, 0.0625, 0.0625, 0.0625]

    def test_a_model_whose_rule_is_gone_still_predicts(self, path, tmp_path):
        expected = TabularQ.load(path)
        self.forget(tmp_path)
        with pytest.warns(UserWarning, match=r"rules_of_a_user:Halving.*callback"):
            loaded = TabularQ.load(path)
        np.testing.assert_array_equal(loaded.q_table, expected.q_table)
        assert loaded.mu == expected.mu == 0.125
        assert loaded.predict(1, deterministic=True)[0] == expected.predict(1, deterministic=True)[0]

    def test_a_model_whose_rule_is_gone_learns_on_with_its_learning_rate(self, path, tmp_path):
        self.forget(tmp_path)
        with pytest.warns(UserWarning, match="rules_of_a_user:Halving"):
            loaded = TabularQ.load(path, env=ScriptedEnv(SCRIPT))
        recorder = Recorder()
        loaded.learn(3, callback=recorder)
        assert recorder.rates == [0.25] * 4

    def test_a_model_whose_rule_is_gone_and_that_goes_on_holds_its_rate(self, path, tmp_path):
        self.forget(tmp_path)
        with pytest.warns(UserWarning, match="rules_of_a_user:Halving"):
            loaded = TabularQ.load(path, env=ScriptedEnv(SCRIPT))
        recorder = Recorder()
        loaded.learn(3, callback=recorder, reset_num_timesteps=False)
        assert recorder.rates == [0.125] * 4

    def test_a_model_whose_rule_is_gone_keeps_its_name_when_saved_again(self, path, tmp_path):
        text = (tmp_path / "rules_of_a_user.py").read_text()
        self.forget(tmp_path)
        with pytest.warns(UserWarning, match="rules_of_a_user:Halving"):
            TabularQ.load(path).save(path)
        (tmp_path / "rules_of_a_user.py").write_text(text)
        importlib.invalidate_caches()
        with pytest.warns(UserWarning, match="rules_of_a_user:Halving"):  # a file does not have modules imported
            TabularQ.load(path)
        importlib.import_module("rules_of_a_user")
        recorder = Recorder()
        TabularQ.load(path, env=ScriptedEnv(SCRIPT)).learn(1, callback=recorder, reset_num_timesteps=False)
        assert recorder.rates == [0.125, 0.0625]

    def test_a_model_whose_rule_is_gone_goes_on_with_the_callback(self, path, tmp_path, halving):
        """The class is at hand, though not under its name; then the rate goes on where it was."""
        self.forget(tmp_path)
        with pytest.warns(UserWarning, match="rules_of_a_user:Halving"):
            loaded = TabularQ.load(path, env=ScriptedEnv(SCRIPT))
        recorder = Recorder()
        loaded.learn(3, callback=[halving(mu_0=1.0, least=0.0625), recorder], reset_num_timesteps=False)
        assert recorder.rates == [0.125, 0.0625, 0.0625, 0.0625]

    def test_a_model_whose_rule_is_gone_takes_another_method(self, path, tmp_path):
        self.forget(tmp_path)
        with pytest.warns(UserWarning, match="rules_of_a_user:Halving"):
            loaded = TabularQ.load(path, env=ScriptedEnv(SCRIPT))
        loaded.learn(3, callback=method(2))
        assert loaded.mu == 0.05
        loaded.save(path)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert TabularQ.load(path).mu == 0.05

    def test_a_class_within_a_function_cannot_be_found_again(self, tmp_path):
        class Local(LearningRateCallback):
            rule = staticmethod(lambda mu, step: 0.5)

        greedy_on_script().learn(3, callback=Local()).save(tmp_path / "model")
        with pytest.warns(UserWarning, match=r"Local.*callback"):
            assert TabularQ.load(tmp_path / "model").mu == 0.5
