"""Saved models: what is in the file, what comes back, and what is refused."""

import base64
import importlib
import io
import json
import sys
import warnings
import zipfile

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from helpers.environments import Episode, RenumberAction, RenumberObservation, SampledEnv, ScriptedEnv, Step
from helpers.paper_learner import learn_by_the_paper, paper_rates
from helpers.recording import Recorder
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import DummyVecEnv

from sb3_adaptive_q import METHODS, LearningRateCallback, LinearDecayCallback, TabularQ, TabularQPolicy, method, tabular_q

LAKE = "FrozenLake-v1"
SCRIPT = [
    Episode(0, [Step(8.0, 1), Step(0.0, 0), Step(-4.0, 2), Step(0.0, 3, "terminated")]),
    Episode(2, [Step(16.0, 0), Step(0.0, 1, "truncated")]),
]


def greedy_on_script(**arguments):
    env = DummyVecEnv([lambda: ScriptedEnv(SCRIPT)])
    return TabularQ("MlpPolicy", env, exploration_initial_eps=0.0, exploration_final_eps=0.0, **arguments)


def make_lake():
    return gym.make(LAKE)


def data_of(path):
    with zipfile.ZipFile(path) as file:
        return json.loads(file.read("data"))


def rewrite_data(path, **changes):
    """Change entries of the plain data in a saved file."""
    with zipfile.ZipFile(path) as file:
        parts = {name: file.read(name) for name in file.namelist()}
    data = {**json.loads(parts["data"]), **changes}
    with zipfile.ZipFile(path, "w") as file:
        for name, content in {**parts, "data": json.dumps(data).encode()}.items():
            file.writestr(name, content)


class TestFile:
    def test_the_table_is_in_the_file_once(self, tmp_path):
        """Whether as it is or within a pickle in base 64."""
        env = SampledEnv(spaces.Discrete(3000), spaces.Discrete(5))
        model = TabularQ("MlpPolicy", env, method=7, seed=0).learn(500)
        model.q_table[:] = np.random.default_rng(0).random(model.q_table.shape)
        model.save(tmp_path / "model.zip")
        marks = [model.q_table[row].tobytes() for row in (0, 1234, 2999)]
        with zipfile.ZipFile(tmp_path / "model.zip") as file:
            contents = [file.read(name) for name in file.namelist()]
            size = sum(part.file_size for part in file.infolist())
        contents += [
            base64.b64decode(entry[":serialized:"])
            for entry in data_of(tmp_path / "model.zip").values()
            if isinstance(entry, dict) and ":serialized:" in entry
        ]
        assert [sum(content.count(mark) for content in contents) for mark in marks] == [1, 1, 1]
        assert size < 1.2 * model.q_table.nbytes

    def test_tensors_are_float64_and_nothing_but_tensors(self, tmp_path):
        model = TabularQ("MlpPolicy", LAKE, seed=0, initial_q=1.0, method=8).learn(500)
        model.save(tmp_path / "model.zip")
        with zipfile.ZipFile(tmp_path / "model.zip") as file:
            state = th.load(io.BytesIO(file.read("policy.pth")), weights_only=True)
        assert {name: value.dtype for name, value in state.items()} == {"q_table": th.float64, "mu": th.float64}
        np.testing.assert_array_equal(state["q_table"].numpy(), model.q_table)
        assert state["mu"].item() == model.mu

    def test_plain_data_has_the_format_version_and_the_method(self, tmp_path):
        TabularQ("MlpPolicy", LAKE, method=5, method_kwargs={"gain": -0.125}).save(tmp_path / "model.zip")
        data = data_of(tmp_path / "model.zip")
        assert data["format_version"] == tabular_q.FORMAT_VERSION == 1
        assert (data["method"], data["method_kwargs"]) == (5, {"gain": -0.125})
        assert data["gamma"] == 0.99

    def test_a_newer_format_is_refused(self, tmp_path):
        path = tmp_path / "model.zip"
        TabularQ("MlpPolicy", LAKE).save(path)
        rewrite_data(path, format_version=2)
        with pytest.raises(ValueError, match=r"format version 2.*up to 1.*update"):
            TabularQ.load(path)

    def test_a_file_is_written_in_the_format_of_the_version_that_writes_it(self, tmp_path, monkeypatch):
        path = tmp_path / "model.zip"
        TabularQ("MlpPolicy", LAKE).save(path)
        monkeypatch.setattr(tabular_q, "FORMAT_VERSION", 2)
        TabularQ.load(path).save(path)
        assert data_of(path)["format_version"] == 2

    def test_a_buffer_will_do_for_a_file(self):
        model = TabularQ("MlpPolicy", LAKE, seed=0, initial_q=1.0).learn(500)
        buffer = io.BytesIO()
        model.save(buffer)
        buffer.seek(0)
        np.testing.assert_array_equal(TabularQ.load(buffer).q_table, model.q_table)


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

    def test_a_schedule_comes_back(self, tmp_path):
        greedy_on_script(learning_rate=lambda left: 0.5 * left).learn(5).save(tmp_path / "model")
        recorder = Recorder()
        TabularQ.load(tmp_path / "model", env=ScriptedEnv(SCRIPT)).learn(4, callback=recorder)
        assert recorder.rates == [0.5, 0.375, 0.25, 0.125, 0.0]

    def test_what_the_zoo_puts_in_on_loading(self, tmp_path):
        TabularQ("MlpPolicy", LAKE, seed=0, initial_q=1.0).learn(500).save(tmp_path / "model")
        replaced = {"learning_rate": 0.0, "lr_schedule": lambda _: 0.0, "clip_range": lambda _: 0.0}
        loaded = TabularQ.load(tmp_path / "model", env=make_lake(), custom_objects=replaced, buffer_size=1)
        table = loaded.q_table.copy()
        np.testing.assert_array_equal(loaded.learn(200).q_table, table)

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
    def test_a_step_size_out_of_range_is_refused_and_changes_nothing(self, tmp_path, from_file):
        teacher, pupil = (TabularQ("MlpPolicy", LAKE, seed=0, initial_q=q) for q in (1.0, 0.5))
        teacher.policy.mu.fill_(1.5)
        teacher.save(tmp_path / "model")
        with pytest.raises(ValueError, match=r"`mu` must be from 0 to 1, but got 1\.5"):
            pupil.set_parameters(tmp_path / "model" if from_file else teacher.get_parameters())
        assert (pupil.q_table == 0.5).all() and pupil.mu == 0.01

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

    def test_with_other_spaces(self, tmp_path):
        env = SampledEnv(spaces.MultiDiscrete([3, 2], start=[1, 0]), spaces.Discrete(4, start=2))
        model = TabularQ("MlpPolicy", env, seed=0, initial_q=0.5).learn(300)
        model.policy.save(tmp_path / "policy.pth")
        policy = TabularQPolicy.load(tmp_path / "policy.pth")
        np.testing.assert_array_equal(policy.q_table.numpy(), model.q_table)
        assert policy.initial_q == 0.5
        assert policy.predict(np.array([3, 1]))[0] == 2 + model.q_table[5].argmax()


RULE_MODULE = """
from sb3_adaptive_q import LearningRateCallback

def halve(mu, transition, least):
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
            rule = staticmethod(lambda mu, transition: 0.5)

        greedy_on_script().learn(3, callback=Local()).save(tmp_path / "model")
        with pytest.warns(UserWarning, match=r"Local.*callback"):
            assert TabularQ.load(tmp_path / "model").mu == 0.5
