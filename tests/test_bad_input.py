"""Bad input is refused with what was expected, what came and what to do, before anything has changed."""

import math
import re
import tracemalloc
from types import SimpleNamespace

import gymnasium as gym
import numpy as np
import psutil
import pytest
from gymnasium import spaces
from helpers.environments import Episode, SampledEnv, ScriptedEnv, Step
from helpers.recording import Recorder
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import DummyVecEnv

from sb3_adaptive_q import policies
from sb3_adaptive_q import (
    ConstantRateCallback,
    LearningRateCallback,
    LinearDecayCallback,
    LinearGrowthCallback,
    ProportionalRateCallback,
    SignRateCallback,
    TabularQ,
    method,
)

LAKE = "FrozenLake-v1"


def lake(**arguments):
    return TabularQ("MlpPolicy", LAKE, **arguments)


def with_spaces(observation_space, action_space=None):
    return SampledEnv(observation_space, action_space or spaces.Discrete(2))


def refused(*parts, error=ValueError):
    """Expect an error whose message holds the parts in this order."""
    return pytest.raises(error, match="(?s)" + ".*".join(map(re.escape, parts)))


class TestSpaces:
    @pytest.mark.parametrize("env", [lambda: "CartPole-v1", lambda: with_spaces(spaces.Box(-1.0, 1.0, (2,)))])
    def test_box_observations_need_the_wrapper(self, env):
        expected = "Discrete, MultiDiscrete or MultiBinary observation space"
        with refused(expected, "but got Box(", "wrappers.DiscretizeObservation"):
            TabularQ("MlpPolicy", env())

    @pytest.mark.parametrize(
        "space", [spaces.Box(-1.0, 1.0, (1,)), spaces.MultiDiscrete([2, 3]), spaces.MultiBinary(2)], ids=str
    )
    def test_actions_must_be_discrete(self, space):
        with refused("Discrete action space", f"but got {space}", "gymnasium.ActionWrapper"):
            TabularQ("MlpPolicy", with_spaces(spaces.Discrete(3), space))

    @pytest.mark.parametrize(
        "space",
        [
            spaces.Text(3),
            spaces.Sequence(spaces.Discrete(2)),
            spaces.OneOf((spaces.Discrete(2), spaces.Discrete(3))),
            spaces.Tuple((spaces.Discrete(2), spaces.Text(2))),
        ],
        ids=lambda space: type(space).__name__,
    )
    def test_spaces_that_no_vectorised_environment_takes(self, space):
        with refused("Discrete, MultiDiscrete or MultiBinary observation space", "gymnasium.ObservationWrapper"):
            TabularQ("MlpPolicy", with_spaces(space))

    def test_the_policy_alone_refuses_them_too(self):
        policy = lake().policy_class
        with refused("observation space", "but got Box("):
            policy(spaces.Box(-1.0, 1.0, (2,)), spaces.Discrete(2), lambda _: 0.1)
        with refused("action space", "but got MultiBinary(2)"):
            policy(spaces.Discrete(2), spaces.MultiBinary(2), lambda _: 0.1)

    @pytest.mark.parametrize("name", ["CnnPolicy", "mlp"])
    def test_unknown_policy(self, name):
        with refused(f"Policy {name} unknown", "MlpPolicy"):
            TabularQ(name, LAKE)


class TestTableThatDoesNotFit:
    @pytest.mark.parametrize(
        ("space", "n_states", "gigabytes"),
        [
            (spaces.Discrete(10**15), "1000000000000000 states", "14901161.2 GiB"),
            (spaces.MultiDiscrete([100_000] * 3), "1000000000000000 states", "14901161.2 GiB"),
            (spaces.MultiBinary(50), "1125899906842624 states", "16777216.0 GiB"),
        ],
        ids=["Discrete", "MultiDiscrete", "MultiBinary"],
    )
    def test_it_is_refused_with_its_size_before_it_is_made(self, space, n_states, gigabytes):
        tracemalloc.start()
        try:
            with refused(n_states, "2 actions", gigabytes, "are free", "use fewer", error=MemoryError):
                TabularQ("MlpPolicy", with_spaces(space))
            assert tracemalloc.get_traced_memory()[1] < 50e6
        finally:
            tracemalloc.stop()

    def test_the_memory_that_is_free_decides(self, monkeypatch):
        """16 states and 4 actions of 8 bytes take 512."""
        monkeypatch.setattr(policies, "SURELY_FREE", 0)
        monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=511))
        with refused("16 states", "4 actions", error=MemoryError):
            lake()
        monkeypatch.setattr(psutil, "virtual_memory", lambda: SimpleNamespace(available=512))
        assert lake().q_table.nbytes == 512

    def test_a_number_of_states_beyond_any_float(self):
        """2^1100 states: their bytes are more than a float can say."""
        with refused("states", "use fewer", error=MemoryError):
            TabularQ("MlpPolicy", with_spaces(spaces.MultiBinary(1100)))


class TestNumbers:
    @pytest.mark.parametrize("value", [-0.1, 1.1, np.nan, np.inf, 7])
    @pytest.mark.parametrize(
        "name", ["learning_rate", "gamma", "exploration_fraction", "exploration_initial_eps", "exploration_final_eps"]
    )
    def test_from_0_to_1(self, name, value):
        with refused(f"`{name}` must be a number from 0 to 1", f"but got {value}"):
            lake(**{name: value})

    @pytest.mark.parametrize("value", [0, 1, 0.0, 1.0])
    @pytest.mark.parametrize(
        "name", ["learning_rate", "gamma", "exploration_fraction", "exploration_initial_eps", "exploration_final_eps"]
    )
    def test_both_ends_are_allowed(self, name, value):
        assert getattr(lake(**{name: value}).learn(20), name) == value

    @pytest.mark.parametrize("name", ["total_episodes", "callback_interval"])
    @pytest.mark.parametrize("value", [0, -3])
    def test_at_least_1(self, name, value):
        with refused(f"`{name}` must be a whole number from 1 to ", "or None", f"but got {value}"):
            lake(**{name: value})

    @pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
    def test_a_finite_initial_value(self, value):
        with refused("`initial_q` must be a finite number", f"but got {value}"):
            lake(initial_q=value)

    def test_a_schedule_that_begins_out_of_range(self):
        """A learning rate such as "lin_7" in a YAML file becomes a schedule that begins at 7."""
        with refused("`learning_rate` must be a number from 0 to 1", "but got 7"):
            lake(learning_rate=lambda left: 7.0 * left)

    def test_a_schedule_that_leaves_its_range_on_the_way(self):
        model = lake(learning_rate=lambda left: 0.5 if left > 0.5 else 1.5, initial_q=1.0)
        with refused("`learning_rate` must give step sizes from 0 to 1", "gave 1.5"):
            model.learn(100)
        assert np.isfinite(model.q_table).all()
        assert 0.0 <= model.mu <= 1.0

    @pytest.mark.parametrize("value", ["0.1", None, [0.1]])
    def test_what_is_no_number(self, value):
        """Of any kind of error, but one that names the argument."""
        with pytest.raises((TypeError, ValueError), match=r"learning_rate"):
            lake(learning_rate=value)

    @pytest.mark.parametrize("log_interval", [0, -1])
    def test_log_interval(self, log_interval):
        model = lake()
        with refused("`log_interval` must be a whole number of at least 1, or None", f"but got {log_interval}"):
            model.learn(10, log_interval=log_interval)
        assert model.num_timesteps == 0


class TestMethods:
    @pytest.mark.parametrize("number", [0, 9, -1, 1.5, True, None, [7]], ids=repr)
    def test_there_are_eight(self, number):
        with refused("a number from 1 to 8", f"but got {number!r}"):
            method(number)
        if number is not None:
            with refused("a number from 1 to 8", f"but got {number!r}"):
                lake(method=number)

    @pytest.mark.parametrize(
        ("number", "known", "unknown"),
        [
            (1, "beta", "beta_1"),
            (3, "beta_1, beta_3", "gain"),
            (5, "gain, mu_0, lower, upper", "step"),
            (8, "step, mu_0", "gain"),
        ],
    )
    def test_unknown_parameter(self, number, known, unknown):
        with refused(f"Method {number} has the parameters {known}", f"but got {unknown}"):
            method(number, **{unknown: 0.1})
        with refused(f"Method {number} has the parameters {known}", f"but got {unknown}"):
            lake(method=number, method_kwargs={unknown: 0.1})

    @pytest.mark.parametrize(("name", "offered"), [("polynomal", "polynomial"), ("auto_step", "autostep")])
    def test_a_name_that_is_none(self, name, offered):
        with refused("no step size", name, offered):
            method(name)
        with refused("no step size", name, offered):
            lake(method=name)

    def test_a_number_as_a_text(self):
        """As in a YAML file: `method: "7"`."""
        assert lake(method="7").learn(10)._method.data.label == method("7").method.data.label == "method7"
        with refused("A method is a number from 1 to 8", "but got 9"):
            method("9")

    def test_parameters_without_a_method(self):
        """They would be of no effect, which is hardly what was meant."""
        with refused("method_kwargs", "method"):
            lake(method_kwargs={"gain": 0.1})

    @pytest.mark.parametrize("value", [-0.001, 1.001, np.nan])
    @pytest.mark.parametrize(
        ("make", "name"),
        [
            (lambda value: ConstantRateCallback(value), "beta"),
            (lambda value: LinearDecayCallback(beta_1=value), "beta_1"),
            (lambda value: LinearDecayCallback(0.0, beta_3=value), "beta_1 + beta_3"),
            (lambda value: LinearGrowthCallback(beta_1=value), "beta_1"),
            (lambda value: LinearGrowthCallback(0.0, beta_3=value), "beta_1 + beta_3"),
            (lambda value: ProportionalRateCallback(mu_0=value), "mu_0"),
            (lambda value: ProportionalRateCallback(lower=value), "lower"),
            (lambda value: ProportionalRateCallback(upper=value), "upper"),
            (lambda value: SignRateCallback(mu_0=value), "mu_0"),
            (lambda value: SignRateCallback(lower=value), "lower"),
            (lambda value: SignRateCallback(upper=value), "upper"),
        ],
    )
    def test_step_sizes_from_0_to_1(self, make, name, value):
        if np.isnan(value):
            name = name.rpartition(" ")[2]  # a sum of what is no number is not formed
        with refused(f"`{name}` must be a", "number", f"but got {value}"):
            make(value)

    @pytest.mark.parametrize("make", [ProportionalRateCallback, SignRateCallback])
    def test_bounds_the_wrong_way_round(self, make):
        with refused("`lower` must not be above `upper`", "lower=0.5", "upper=0.25"):
            make(lower=0.5, upper=0.25)

    @pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
    @pytest.mark.parametrize(("number", "name"), [(5, "gain"), (6, "gain"), (7, "step"), (8, "step")])
    def test_what_is_multiplied_or_added_must_be_finite(self, number, name, value):
        """NaN in the rate would soon be NaN in the table."""
        with refused(f"`{name}` must be a finite number", f"but got {value}"):
            method(number, **{name: value})

    @pytest.mark.parametrize("value", ["Same", "mean", None])
    @pytest.mark.parametrize("make", [ProportionalRateCallback, SignRateCallback])
    def test_next_action(self, make, value):
        with refused("`next_action` must be one of same, next, max", f"but got {value!r}"):
            make(next_action=value)

    def test_two_at_once_change_nothing(self):
        model = lake(method=2).learn(50)
        table, rate, steps = model.q_table.copy(), model.mu, model.num_timesteps
        with refused("One learning-rate method", "ConstantRateCallback, SignRateCallback", "pass one"):
            model.learn(50, callback=[method(1), method(7)])
        np.testing.assert_array_equal(model.q_table, table)
        assert (model.mu, model.num_timesteps, model._method.data.parameters) == (rate, steps, {"beta": 0.05})

    def test_reset_each_episode_with_several_environments(self, tmp_path):
        chosen = {"method": 7, "method_kwargs": {"reset_each_episode": True}}
        two = make_vec_env(LAKE, n_envs=2)
        with refused("`reset_each_episode` needs a single environment", "but got 2"):
            TabularQ("MlpPolicy", two, **chosen)
        lake(**chosen).save(tmp_path / "model")
        with refused("`reset_each_episode` needs a single environment", "but got 2"):
            TabularQ.load(tmp_path / "model", env=two)

    @pytest.mark.parametrize("value", [np.nan, -0.5, 1.5])
    def test_a_rule_of_a_user_that_leaves_the_range(self, value):
        class Broken(LearningRateCallback):
            rule = staticmethod(lambda mu, transition: value if transition.progress > 0.5 else 0.5)

        model = lake(initial_q=1.0)
        with refused("Broken", "from 0 to 1", f"{value}"):
            model.learn(100, callback=Broken())
        assert np.isfinite(model.q_table).all()

    def test_initial_value_of_the_policy(self):
        with refused("`initial_q` is an argument of TabularQ"):
            TabularQ("MlpPolicy", LAKE, policy_kwargs={"initial_q": 1.0})

    def test_callback_without_a_rule(self):
        class Empty(LearningRateCallback):
            pass

        with refused("Empty needs the class attribute `step_size`", "`rule(mu, step, *parameters)`"):
            Empty(mu_0=0.1)


class TestRewards:
    @pytest.mark.parametrize("reward", [np.nan, np.inf, -np.inf])
    def test_the_step_and_the_state_are_named_and_the_table_stays(self, reward):
        script = [Episode(0, [Step(1.0, 1), Step(1.0, 2), Step(reward, 3)])]
        model = TabularQ(
            "MlpPolicy", ScriptedEnv(script), ties="first", learning_rate=0.5, gamma=0.0, exploration_initial_eps=0
        )
        model.exploration_final_eps = 0.0
        with refused("Rewards must be finite", "step 3", f"gave {reward}", "action 0", "state 2", "check"):
            model.learn(10)
        np.testing.assert_array_equal(model.q_table, [[0.5, 0], [0.5, 0], [0, 0], [0, 0]])
        assert model._n_updates == 2

    def test_no_environment_of_the_step_is_learned_from(self):
        good = ScriptedEnv([Episode(0, [Step(1.0, 1), Step(1.0, 2)])])
        bad = ScriptedEnv([Episode(3, [Step(1.0, 1), Step(np.nan, 2)])])
        arguments = {
            "ties": "first",
            "learning_rate": 0.5,
            "gamma": 0.0,
            "exploration_initial_eps": 0.0,
            "exploration_final_eps": 0.0,
        }
        model = TabularQ("MlpPolicy", DummyVecEnv([lambda: good, lambda: bad]), **arguments)
        with refused("step 4", "environment 1", "nan", "state 1"):
            model.learn(10)
        np.testing.assert_array_equal(model.q_table, [[0.5, 0], [0, 0], [0, 0], [0.5, 0]])

    def test_a_bad_reward_at_the_end_of_an_episode(self):
        script = [Episode(0, [Step(1.0, 1), Step(np.nan, 2, "terminated")])]
        model = TabularQ("MlpPolicy", ScriptedEnv(script))
        with refused("step 2", "gave nan", "state 1"):
            model.learn(10)
        assert model._episode_num == 0

    @pytest.mark.filterwarnings("ignore:overflow encountered in cast:RuntimeWarning")
    def test_a_reward_beyond_float32(self):
        """SB3's vectorised environments hand rewards on as float32, where 1e39 is infinite; NumPy warns of the cast."""
        with refused("Rewards must be finite", "gave inf"):
            TabularQ("MlpPolicy", ScriptedEnv([Episode(0, [Step(1e39, 1)] * 5)])).learn(5)


class TestObservations:
    def test_of_an_environment_that_breaks_its_word(self):
        script = [Episode(0, [Step(1.0, 1), Step(1.0, 9)])]
        model = TabularQ(
            "MlpPolicy", ScriptedEnv(script), ties="first", learning_rate=0.5, gamma=0.0, exploration_initial_eps=0
        )
        recorder = Recorder()
        with refused("observation 9", "outside the observation space Discrete(4)", "check"):
            model.learn(10, callback=recorder)
        assert model._n_updates == 1
        np.testing.assert_array_equal(model.q_table, [[0.5, 0], [0, 0], [0, 0], [0, 0]])

    @pytest.mark.parametrize("observation", [16, -1, [3, 16], [-1]])
    def test_to_predict_from(self, observation):
        with refused("outside the observation space Discrete(16)"):
            lake().predict(np.array(observation))

    @pytest.mark.parametrize("observation", [3.7, [0.0, 2.5], [math.nan]])
    def test_to_predict_from_between_two_states(self, observation):
        with refused("outside the observation space Discrete(16)"):
            lake().predict(np.array(observation))

    def test_to_predict_from_below_the_first_number(self):
        model = TabularQ("MlpPolicy", with_spaces(spaces.Discrete(4, start=2)))
        for observation in (1, 6):
            with refused(f"observation {observation}", "outside the observation space Discrete(4, start=2)"):
                model.predict(observation)

    @pytest.mark.parametrize("observation", [[3, 0], [0, 2]])
    def test_to_predict_from_composite(self, observation):
        with refused("outside the observation space MultiDiscrete([3 2])"):
            TabularQ("MlpPolicy", with_spaces(spaces.MultiDiscrete([3, 2]))).predict(np.array(observation))

    def test_what_the_reset_of_gymnasium_returns(self):
        """Observation and info together: a common slip."""
        with pytest.raises(ValueError, match="tuple"):
            lake().predict((0, {}))


class TestEnvironmentMissing:
    def test_learning_without_an_environment(self, tmp_path):
        lake().save(tmp_path / "model")
        model = TabularQ.load(tmp_path / "model")
        with refused("no environment to learn from", "`load` as `env`", "`set_env`"):
            model.learn(10)

    def test_unknown_environment(self):
        with pytest.raises(gym.error.Error, match="NoSuchEnv"):
            TabularQ("MlpPolicy", "NoSuchEnv-v0")
