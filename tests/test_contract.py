"""What Stable-Baselines3 and its tools expect of an algorithm."""

import copy
import inspect
import json

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from helpers.environments import Episode, RenumberAction, RenumberObservation, SampledEnv, ScriptedEnv, Step
from helpers.recording import Recorder
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import LogEveryNTimesteps
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.logger import configure
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.utils import get_latest_run_id
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnvWrapper, VecMonitor
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from sb3_adaptive_q import LeanVecEnv, TabularQ, TabularQPolicy

LAKE = "FrozenLake-v1"
# Five steps of return 1.5, then one step of return 3
SCRIPT = [
    Episode(0, [Step(1.0, 1), Step(0.5, 2), Step(0.0, 2), Step(0.0, 0), Step(0.0, 3, "terminated")]),
    Episode(2, [Step(3.0, 0, "truncated")]),
]


def lake(env=LAKE, **arguments):
    """With an initial value above 0, which every update changes, rewarded or not."""
    return TabularQ("MlpPolicy", env, **{"seed": 0, "initial_q": 1.0, **arguments})


def greedy_on_script(n_envs=1, **arguments):
    env = DummyVecEnv([lambda: ScriptedEnv(SCRIPT)] * n_envs)
    return TabularQ("MlpPolicy", env, exploration_initial_eps=0.0, exploration_final_eps=0.0, ties="first", **arguments)


class TestConstructor:
    def test_it_is_an_sb3_algorithm_whose_arguments_are_attributes(self):
        model = lake(gamma=0.9, learning_rate=0.2, exploration_final_eps=0.1, method=7, method_kwargs={"lower": 0.002})
        assert isinstance(model, BaseAlgorithm)
        names = set(inspect.signature(TabularQ).parameters) - {"policy", "env", "stats_window_size", "_init_setup_model"}
        assert all(hasattr(model, name) for name in names)
        assert (model.gamma, model.learning_rate, model.exploration_final_eps) == (0.9, 0.2, 0.1)
        assert (model.method, model.method_kwargs) == (7, {"lower": 0.002})

    def test_without_an_environment_nothing_is_built(self):
        model = TabularQ("MlpPolicy", None, _init_setup_model=False)
        assert model.env is None
        assert not hasattr(model, "policy")

    def test_setting_up_twice_changes_no_argument(self):
        model = lake(method=5, method_kwargs={"gain": -0.1}, policy_kwargs={}, exploration_fraction=0.3, total_episodes=9)
        names = [name for name in inspect.signature(TabularQ).parameters if name in model.__dict__ and name != "env"]
        before = {name: copy.deepcopy(model.__dict__[name]) for name in names if name != "policy"}
        model._setup_model()
        assert before == {name: model.__dict__[name] for name in before}

    def test_policy_by_name_and_by_class(self):
        assert isinstance(lake().policy, TabularQPolicy)
        assert isinstance(TabularQ(TabularQPolicy, LAKE).policy, TabularQPolicy)

    def test_table_is_float64_of_states_by_actions_with_the_initial_value(self):
        table = lake(initial_q=0.1).q_table
        assert table.shape == (16, 4)
        assert table.dtype == np.float64
        assert np.all(table == 0.1)

    def test_steps_too_small_for_float32_are_kept(self):
        model = greedy_on_script(learning_rate=1e-9, initial_q=1.0, gamma=0.0)
        model.learn(1)
        # 1 + 1e-9 (1 - 1) is no change; the second step has 1 + 1e-9 (0.5 - 1)
        model.learn(1, reset_num_timesteps=False)
        assert model.q_table[1, 0] == 1.0 - 0.5e-9

    def test_a_plain_environment_gets_a_monitor_and_a_lean_vec_env(self):
        env = lake().get_env()
        assert type(env) is LeanVecEnv
        assert env.env_is_wrapped(Monitor) == [True]

    def test_a_vectorised_environment_is_left_as_it_is(self):
        env = make_vec_env(LAKE, n_envs=2)
        assert TabularQ("MlpPolicy", env).get_env() is env

    @pytest.mark.parametrize("device", ["auto", "cpu", th.device("cpu")])
    def test_device(self, device):
        assert lake(device=device).device == th.device("cpu")

    def test_another_device_is_replaced_with_a_warning(self):
        with pytest.warns(UserWarning, match=r"CPU.*meta"):
            model = lake(device="meta")
        assert model.policy.q_table.device == th.device("cpu")


class TestLearn:
    def test_counters(self):
        model = lake()
        assert model.learn(500) is model
        assert model.num_timesteps == 500
        assert model._n_updates == 500
        assert model._episode_num > 10

    def test_learning_twice_starts_the_count_again_and_keeps_the_table(self):
        model = greedy_on_script(learning_rate=0.5)
        model.learn(7)
        table = model.q_table.copy()
        recorder = Recorder()
        model.learn(6, callback=recorder)
        assert model.num_timesteps == 6
        assert model._episode_num == 2
        np.testing.assert_array_equal(recorder.tables[0], table)

    @pytest.mark.parametrize("arguments", [{"learning_rate": 0.5}, {"method": 5}, {"method": 8}])
    def test_going_on_is_the_same_as_not_having_stopped(self, arguments):
        whole = greedy_on_script(**arguments).learn(17)
        parts = greedy_on_script(**arguments).learn(4)
        for steps in (1, 7, 5):
            parts.learn(steps, reset_num_timesteps=False)
        assert parts.num_timesteps == 17
        assert parts._episode_num == whole._episode_num
        np.testing.assert_array_equal(parts.q_table, whole.q_table)
        assert parts.mu == whole.mu

    def test_going_on_with_exploration_is_the_same_too(self):
        """Where ε is constant nothing tells the parts from the whole, the agent's random numbers included."""
        arguments = {"exploration_initial_eps": 0.5, "exploration_final_eps": 0.5}
        whole = lake(**arguments).learn(600)
        parts = lake(**arguments).learn(250).learn(350, reset_num_timesteps=False)
        np.testing.assert_array_equal(parts.q_table, whole.q_table)

    def test_progress_never_leaves_its_range(self):
        remaining = []

        def schedule(left):
            remaining.append(left)
            return 0.1

        model = lake(learning_rate=schedule)
        model.learn(50)
        assert model._current_progress_remaining == 0.0
        model.learn(50, reset_num_timesteps=False)
        assert model._current_progress_remaining == 0.0
        model.learn(20)
        assert min(remaining) == 0.0
        assert max(remaining) == 1.0
        # Going on from step 50 to 100 starts half way
        assert remaining.count(0.5) >= 1

    def test_no_steps_to_learn_leave_the_table_alone(self):
        model = lake(initial_q=0.5)
        model.learn(0)
        assert model.num_timesteps == 0
        assert np.all(model.q_table == 0.5)

    def test_steps_are_a_multiple_of_the_environments(self):
        model = greedy_on_script(n_envs=3)
        model.learn(10)
        assert model.num_timesteps == 12

    def test_total_episodes_end_the_training(self):
        model = greedy_on_script(total_episodes=3)
        recorder = Recorder()
        model.learn(1000, callback=recorder)
        assert model.num_timesteps == 5 + 1 + 5
        assert sum(dones[0] for dones in recorder.dones) == 3
        assert model._current_progress_remaining == 0.0
        model.learn(1000, reset_num_timesteps=False)
        assert model._episode_num == 6
        assert model.num_timesteps == 18

    def test_the_steps_end_the_training_where_they_are_fewer(self):
        model = greedy_on_script(total_episodes=3)
        model.learn(7)
        assert model.num_timesteps == 7
        assert model._current_progress_remaining == pytest.approx(1 / 3)

    def test_total_episodes_of_several_environments_together(self):
        model = greedy_on_script(n_envs=2, total_episodes=4)
        model.learn(1000)
        assert model.num_timesteps == 2 * 6
        assert model._episode_num == 4

    def test_a_schedule_sees_episodes_where_their_number_is_given(self):
        recorder = Recorder()
        greedy_on_script(total_episodes=4, learning_rate=lambda left: left).learn(1000, callback=recorder)
        assert recorder.rates == [1.0] * 5 + [0.75] + [0.5] * 5 + [0.25] + [0.0]

    def test_reset_info_and_options_of_the_environment_are_sb3s(self):
        model = lake()
        model.learn(10)
        assert len(model.get_env().reset_infos) == 1


class TestSeeds:
    @pytest.mark.parametrize("arguments", [{}, {"method": 7}, {"method": 4, "total_episodes": 60}])
    @pytest.mark.parametrize("n_envs", [1, 3])
    def test_same_seed_same_table_bit_for_bit(self, arguments, n_envs):
        tables = []
        for seed in (5, 5, 6):
            model = TabularQ("MlpPolicy", make_vec_env("Taxi-v4", n_envs=n_envs), seed=seed, **arguments)
            tables.append(model.learn(2000).q_table)
        np.testing.assert_array_equal(tables[0], tables[1])
        assert not np.array_equal(tables[0], tables[2])

    def test_no_seed_is_another_table_every_time(self):
        tables = [TabularQ("MlpPolicy", "Taxi-v4").learn(500).q_table for _ in range(2)]
        assert not np.array_equal(*tables)

    def test_seeding_again_repeats(self):
        model = lake(learning_rate=0.0, exploration_final_eps=1.0)
        actions = []
        for _ in range(2):
            recorder = Recorder()
            model.set_random_seed(3)
            model.learn(200, callback=recorder)
            actions.append(np.array(recorder.actions))
        np.testing.assert_array_equal(*actions)

    def test_the_global_generators_play_no_part(self):
        tables = []
        for seed in (0, 1):
            model = lake()
            np.random.seed(seed)
            th.manual_seed(seed)
            model.action_space.seed(seed)
            tables.append(model.learn(500).q_table)
        np.testing.assert_array_equal(*tables)

    @pytest.mark.parametrize("seed", [0, 1, 42])
    def test_the_agent_does_not_draw_what_the_environment_draws(self, seed):
        """
        Both are seeded with the same number. If both drew from the same stream, one of these lags and strides would let
        the environment's numbers tell all of the agent's actions; else they tell a tenth of 3000, with a standard deviation
        of 16, and 600 is 18 of these away.
        """
        recorder = Recorder()
        env = SampledEnv(spaces.Discrete(1), spaces.Discrete(10), time_limit=10**6)
        model = TabularQ("MlpPolicy", env, exploration_final_eps=1.0, seed=seed)
        model.learn(3000, callback=recorder)
        actions = np.array(recorder.actions)[:, 0]
        stream = np.floor(10 * np.random.default_rng(seed).random(10_000))
        for stride in (1, 2, 3):
            for lag in range(10):
                assert np.sum(actions == stream[lag::stride][:3000]) < 600

    def test_exploration_is_uniform(self):
        """Chi-squared over ten actions: 40 has a probability of 8e-6 with 9 degrees of freedom."""
        recorder = Recorder()
        env = SampledEnv(spaces.Discrete(1), spaces.Discrete(10))
        TabularQ("MlpPolicy", env, exploration_final_eps=1.0, seed=0).learn(5000, callback=recorder)
        counts = np.bincount(np.array(recorder.actions)[:, 0], minlength=10)
        assert np.sum((counts - 500) ** 2 / 500) < 40


class TestSpaces:
    @pytest.mark.parametrize(
        "space",
        [
            spaces.Discrete(16, start=5),
            spaces.Discrete(16, start=-7),
            spaces.MultiDiscrete([4, 4]),
            spaces.MultiDiscrete([2, 4, 2]),
            spaces.MultiDiscrete([4, 4], start=[3, -2]),
            spaces.MultiBinary(4),
            spaces.MultiBinary([2, 2]),
        ],
        ids=str,
    )
    def test_any_numbering_of_the_states_learns_the_same_table(self, space):
        plain = lake().learn(1500)
        shown = lake(RenumberObservation(gym.make(LAKE), space)).learn(1500)
        np.testing.assert_array_equal(shown.q_table, plain.q_table)
        assert np.sum(plain.q_table != 1.0) > 20

    @pytest.mark.parametrize("start", [3, -2])
    def test_actions_with_another_first_number_learn_the_same_table(self, start):
        plain = lake().learn(1500)
        recorder = Recorder()
        shown = lake(RenumberAction(gym.make(LAKE), start)).learn(1500, callback=recorder)
        np.testing.assert_array_equal(shown.q_table, plain.q_table)
        assert set(np.ravel(recorder.actions)) == {start, start + 1, start + 2, start + 3}
        for deterministic in (True, False):
            actions, _ = shown.predict(np.arange(16), deterministic=deterministic)
            assert actions.min() >= start
            assert actions.max() < start + 4
        np.testing.assert_array_equal(
            shown.predict(np.arange(16), deterministic=True)[0], start + plain.q_table.argmax(axis=1)
        )

    @pytest.mark.parametrize("n_envs", [1, 2])
    @pytest.mark.parametrize(
        "space", [spaces.MultiDiscrete([3, 4, 2]), spaces.MultiBinary(5), spaces.Discrete(7, start=2)], ids=str
    )
    def test_truncation_in_every_space(self, space, n_envs):
        """A terminal observation of each kind is read, with any number of environments."""
        env = DummyVecEnv([lambda: SampledEnv(space, spaces.Discrete(3), time_limit=4)] * n_envs)
        model = TabularQ("MlpPolicy", env, seed=0).learn(200)
        assert model._episode_num == 200 // 4
        assert np.all(model.q_table.sum(axis=1) > 0.0)


class TestParameters:
    def test_get_parameters_names_table_and_rate(self):
        parameters = lake().get_parameters()
        assert set(parameters) == {"policy"}
        assert {name: (tuple(value.shape), value.dtype) for name, value in parameters["policy"].items()} == {
            "q_table": ((16, 4), th.float64),
            "mu": ((1,), th.float64),
        }

    def test_set_parameters_moves_what_was_learned(self):
        teacher, pupil = lake(method=7).learn(3000), lake(method=7)
        view = pupil.q_table
        pupil.set_parameters(copy.deepcopy(teacher.get_parameters()))
        np.testing.assert_array_equal(pupil.q_table, teacher.q_table)
        np.testing.assert_array_equal(view, teacher.q_table)
        assert pupil.mu == teacher.mu

    def test_learning_goes_on_from_the_parameters_set(self):
        model = greedy_on_script(learning_rate=0.5, gamma=0.0)
        parameters = copy.deepcopy(model.get_parameters())
        parameters["policy"]["q_table"][0, 1] = 8.0
        model.set_parameters(parameters)
        model.learn(1)
        assert model.q_table[0, 1] == 4.5  # action 1 now, halfway from 8 to the reward of 1

    def test_parts_need_exact_match_off(self):
        model = lake()
        table_only = {"policy": {"q_table": th.ones((16, 4), dtype=th.float64)}}
        with pytest.raises(RuntimeError, match="mu"):
            model.set_parameters(table_only)
        model.set_parameters(table_only, exact_match=False)
        assert np.all(model.q_table == 1.0)

    def test_the_table_is_live_and_may_be_written(self):
        model = greedy_on_script(learning_rate=0.5, gamma=0.0)
        view = model.q_table
        view[0] = [2.0, 4.0]
        model.learn(1)
        assert view[0].tolist() == [2.0, 2.5]


class TestSetEnv:
    def test_learning_goes_on_in_the_new_environment(self):
        model = greedy_on_script(learning_rate=0.5, gamma=0.0).learn(3)
        other = ScriptedEnv([Episode(3, [Step(-4.0, 0)] * 5)])
        model.set_env(other)
        recorder = Recorder()
        model.learn(1, callback=recorder, reset_num_timesteps=False)
        assert model.num_timesteps == 4
        assert model.q_table[3, 0] == -2.0
        assert model.get_env().envs[0].unwrapped is other

    def test_the_first_action_fits_the_new_state(self):
        """Not the one that was chosen for the old environment's state."""
        model = greedy_on_script(learning_rate=0.0)
        model.q_table[:] = [[1, 0], [1, 0], [1, 0], [0, 1]]
        model.learn(3)
        model.set_env(ScriptedEnv([Episode(3, [Step(0.0, 0)] * 5)]))
        recorder = Recorder()
        model.learn(1, callback=recorder, reset_num_timesteps=False)
        assert recorder.actions[0].tolist() == [1]

    def test_other_spaces_are_refused(self):
        with pytest.raises(ValueError, match="Observation spaces do not match"):
            lake().set_env(gym.make("FrozenLake-v1", map_name="8x8"))
        with pytest.raises(ValueError, match="Action spaces do not match"):
            lake().set_env(RenumberAction(gym.make(LAKE), 1))

    def test_another_number_of_environments_is_refused(self):
        with pytest.raises(AssertionError, match="number of environments"):
            lake().set_env(make_vec_env(LAKE, n_envs=2))


class TestPredict:
    @pytest.fixture
    def model(self):
        model = lake()
        model.q_table[:] = np.random.default_rng(0).random((16, 4))
        return model

    @pytest.mark.parametrize("deterministic", [True, False])
    @pytest.mark.parametrize("observation", [3, np.int64(3), np.array(3)], ids=["int", "scalar", "array"])
    def test_a_single_observation(self, model, observation, deterministic):
        action, state = model.predict(observation, deterministic=deterministic)
        assert np.shape(action) == ()
        assert action == model.q_table[3].argmax()
        assert state is None

    @pytest.mark.parametrize("deterministic", [True, False])
    def test_a_batch(self, model, deterministic):
        observations = np.array([3, 0, 15, 3])
        actions, _ = model.predict(observations, deterministic=deterministic)
        np.testing.assert_array_equal(actions, model.q_table[observations].argmax(axis=1))
        assert np.issubdtype(actions.dtype, np.integer)

    @pytest.mark.parametrize("deterministic", [True, False])
    def test_an_action_can_be_given_to_an_environment_as_it_is(self, model, deterministic):
        """Toy-text environments look the action up in a dict, so that it must be hashable."""
        env = gym.make(LAKE)
        observation, _ = env.reset(seed=0)
        action, _ = model.predict(observation, deterministic=deterministic)
        env.step(action)

    @pytest.mark.parametrize(
        ("space", "single"),
        [(spaces.MultiDiscrete([3, 4], start=[1, 0]), [2, 3]), (spaces.MultiBinary(3), [1, 0, 1])],
        ids=["MultiDiscrete", "MultiBinary"],
    )
    def test_composite_observations(self, space, single):
        model = TabularQ("MlpPolicy", SampledEnv(space, spaces.Discrete(6)))
        model.q_table[:] = np.random.default_rng(0).random(model.q_table.shape)
        row = {2: 1 * 4 + 3, 3: 5}[len(single)]
        best = model.q_table[row].argmax()
        assert model.predict(np.array(single), deterministic=True)[0] == best
        batch, _ = model.predict(np.array([single, single]), deterministic=True)
        assert batch.tolist() == [best, best]

    def test_ties_go_to_the_first_action(self):
        assert lake().predict(np.arange(16), deterministic=True)[0].tolist() == [0] * 16

    def test_the_policy_predicts_alone(self, model):
        actions, _ = model.policy.predict(np.arange(16))
        np.testing.assert_array_equal(actions, model.q_table.argmax(axis=1))
        assert model.policy.predict(2)[0] == model.q_table[2].argmax()
        np.testing.assert_array_equal(model.policy(th.arange(16)).numpy(), model.q_table.argmax(axis=1))

    @pytest.mark.parametrize("epsilon", [0.0, 0.3, 1.0])
    def test_frequencies_are_epsilon_greedy(self, model, epsilon):
        """
        Of 20 000 predictions: every action but the greedy one has probability ε/4, counted to within 5 standard
        deviations, which fails by chance once in 580 000.
        """
        model.exploration_rate = epsilon
        state, n = 6, 20_000
        actions, _ = model.predict(np.full(n, state), deterministic=False)
        singly = [int(model.predict(state)[0]) for _ in range(2000)]
        for sample in (actions, np.array(singly)):
            counts = np.bincount(sample, minlength=4)
            expected = np.full(4, epsilon / 4)
            expected[model.q_table[state].argmax()] += 1 - epsilon
            deviation = np.sqrt(len(sample) * expected * (1 - expected))
            assert np.all(np.abs(counts - len(sample) * expected) <= 5 * deviation)
        assert set(model.predict(np.full(1000, state), deterministic=True)[0]) == {model.q_table[state].argmax()}

    @pytest.mark.parametrize(("ties", "n_taken"), [("random", 2), ("first", 1)])
    def test_ties_are_broken_as_while_learning(self, ties, n_taken):
        """Of 1000 predictions: each of the two best actions is taken half of the time, to within 5 standard deviations."""
        model = lake(ties=ties)
        model.exploration_rate, model.q_table[6] = 0.0, [0.0, 1.0, 1.0, 0.0]
        counts = np.bincount(model.predict(np.full(1000, 6))[0], minlength=4)
        assert (counts > 0).sum() == n_taken and counts[[0, 3]].sum() == 0
        assert abs(counts[1] - 1000 / n_taken) <= 5 * 16
        assert set(model.predict(np.full(1000, 6), deterministic=True)[0]) == {1}

    def test_the_exploration_rate_of_training_is_the_one_in_force(self):
        model = lake(exploration_final_eps=0.25).learn(100)
        assert model.exploration_rate == 0.25

    def test_evaluate_policy(self):
        """Down, down, right, right, down, right is the way over the lake that does not slip."""
        env = gym.make(LAKE, is_slippery=False)
        model = TabularQ("MlpPolicy", env)
        for state, action in [(0, 1), (4, 1), (8, 2), (9, 2), (10, 1), (14, 2)]:
            model.q_table[state, action] = 1.0
        returns, lengths = evaluate_policy(model, model.get_env(), n_eval_episodes=3, return_episode_rewards=True)
        assert returns == [1.0, 1.0, 1.0]
        assert lengths == [6, 6, 6]
        mean, deviation = evaluate_policy(model, make_vec_env(lambda: Monitor(gym.make(LAKE, is_slippery=False)), n_envs=2))
        assert (mean, deviation) == (1.0, 0.0)


class _AddHalf(VecEnvWrapper):
    """Adds a half to every reward."""

    def reset(self):
        return self.venv.reset()

    def step_wait(self):
        observations, rewards, dones, infos = self.venv.step_wait()
        return observations, rewards + 0.5, dones, infos


@pytest.fixture(scope="module")
def lake_table():
    """Of two environments in LeanVecEnv."""
    return lake(make_vec_env(LAKE, n_envs=2, vec_env_cls=LeanVecEnv)).learn(1200).q_table


class TestVecEnvs:
    @pytest.mark.parametrize("vec_env_cls", [DummyVecEnv, SubprocVecEnv])
    def test_any_vec_env_gives_the_same_table(self, vec_env_cls, lake_table):
        env = make_vec_env(LAKE, n_envs=2, vec_env_cls=vec_env_cls)
        model = lake(env).learn(1200)
        env.close()
        np.testing.assert_array_equal(model.q_table, lake_table)
        assert np.sum(lake_table != 1.0) > 20

    def test_a_wrapper_around_a_vec_env(self, lake_table):
        env = VecMonitor(LeanVecEnv([lambda: gym.make(LAKE) for _ in range(2)]))
        model = lake(env).learn(1200)
        np.testing.assert_array_equal(model.q_table, lake_table)
        assert len(model.ep_info_buffer) == 100

    def test_a_wrapper_that_changes_rewards(self):
        env = _AddHalf(DummyVecEnv([lambda: ScriptedEnv(SCRIPT)]))
        model = TabularQ("MlpPolicy", env, learning_rate=1.0, gamma=0.0, exploration_initial_eps=0.0)
        model.learn(1)
        assert model.q_table.max() == 1.5


class TestLogging:
    def last_log(self, folder):
        lines = (folder / "progress.json").read_text().splitlines()
        return [json.loads(line) for line in lines]

    def model_with_log(self, folder, env=None, **arguments):
        model = TabularQ(
            "MlpPolicy", env or ScriptedEnv(SCRIPT), exploration_initial_eps=0.0, exploration_final_eps=0.0, **arguments
        )
        model.set_logger(configure(str(folder), ["json"]))
        return model

    def test_keys_and_values(self, tmp_path):
        model = self.model_with_log(tmp_path, learning_rate=0.5, gamma=0.0)
        model.learn(6, log_interval=1)
        first, second = self.last_log(tmp_path)
        assert set(first) == {
            "rollout/ep_rew_mean", "rollout/ep_len_mean", "rollout/exploration_rate",
            "time/episodes", "time/fps", "time/time_elapsed", "time/total_timesteps",
            "train/learning_rate", "train/mu_mean", "train/mu_min", "train/mu_max", "train/td_error", "train/n_updates",
        }  # fmt: skip
        assert (first["rollout/ep_rew_mean"], first["rollout/ep_len_mean"]) == (1.5, 5.0)
        assert (second["rollout/ep_rew_mean"], second["rollout/ep_len_mean"]) == (2.25, 3.0)
        assert [log["time/episodes"] for log in (first, second)] == [1, 2]
        assert [log["time/total_timesteps"] for log in (first, second)] == [5, 6]
        assert [log["train/n_updates"] for log in (first, second)] == [5, 6]
        # The fifth step is from state 0 again, where Q(0, 0) = 0.5 by then, to a terminal state
        assert first["train/td_error"] == pytest.approx((1.0 + 0.5 + 0.0 + 0.0 + 0.5) / 5)
        assert second["train/td_error"] == pytest.approx(3.0)  # action 0 of state 2, still worth 0
        assert first["rollout/exploration_rate"] == 0.0

    def test_rates_over_the_interval(self, tmp_path):
        """Method 3 over six steps: 0.05, 0.05 - 0.04/6, ...; an entry covers the updates since the one before."""
        model = self.model_with_log(tmp_path, method=3)
        model.learn(6, log_interval=1)
        first, second = self.last_log(tmp_path)
        rates = [0.05 - 0.04 * step / 6 for step in range(7)]
        assert first["train/mu_mean"] == pytest.approx(np.mean(rates[:5]), rel=1e-6)
        assert first["train/mu_min"] == pytest.approx(rates[4], rel=1e-6)
        assert first["train/mu_max"] == pytest.approx(rates[0], rel=1e-6)
        assert first["train/learning_rate"] == pytest.approx(rates[5], rel=1e-6)
        assert [second[f"train/mu_{name}"] for name in ("mean", "min", "max")] == pytest.approx([rates[5]] * 3, rel=1e-6)
        assert second["train/learning_rate"] == pytest.approx(rates[6], rel=1e-6)

    def test_success_rate_where_the_environment_tells(self, tmp_path):
        class Success(gym.Wrapper):
            def step(self, action):
                observation, reward, terminated, truncated, info = self.env.step(action)
                return observation, reward, terminated, truncated, {**info, "is_success": terminated}

        model = self.model_with_log(tmp_path, Success(ScriptedEnv(SCRIPT)))
        model.learn(11, log_interval=3)
        (log,) = self.last_log(tmp_path)
        assert log["rollout/success_rate"] == pytest.approx(2 / 3)

    @pytest.mark.parametrize(("log_interval", "entries"), [(1, 6), (2, 3), (4, 2), (None, 0)])
    def test_interval(self, tmp_path, log_interval, entries):
        """Of the six episodes; the end of the training has an entry too."""
        model = self.model_with_log(tmp_path)
        model.learn(18, log_interval=log_interval)
        assert len(self.last_log(tmp_path)) == entries

    def test_the_interval_is_kept_when_several_episodes_end_at_once(self, tmp_path):
        model = self.model_with_log(tmp_path, DummyVecEnv([lambda: ScriptedEnv(SCRIPT)] * 3))
        model.learn(3 * 12, log_interval=4)
        assert [log["time/episodes"] for log in self.last_log(tmp_path)] == [6, 12]

    def test_log_every_n_timesteps(self, tmp_path):
        model = self.model_with_log(tmp_path)
        model.learn(18, log_interval=None, callback=LogEveryNTimesteps(6))
        assert [log["time/total_timesteps"] for log in self.last_log(tmp_path)] == [6, 12, 18]

    def test_dump_logs_at_any_time(self, tmp_path):
        model = self.model_with_log(tmp_path)
        model.learn(1, log_interval=None)
        model.dump_logs()
        model.dump_logs()
        assert len(self.last_log(tmp_path)) == 2

    def test_the_window_is_the_last_episodes(self, tmp_path):
        model = self.model_with_log(tmp_path, stats_window_size=1)
        model.learn(6, log_interval=1)
        assert [log["rollout/ep_rew_mean"] for log in self.last_log(tmp_path)] == [1.5, 3.0]

    def test_tensorboard(self, tmp_path):
        model = TabularQ("MlpPolicy", ScriptedEnv(SCRIPT), method=7, tensorboard_log=str(tmp_path), seed=0)
        model.learn(12, log_interval=1, tb_log_name="script")
        model.learn(6, log_interval=1, tb_log_name="script", reset_num_timesteps=False)
        assert get_latest_run_id(str(tmp_path), "script") == 1
        events = EventAccumulator(str(tmp_path / "script_1"))
        events.Reload()
        tags = events.Tags()["scalars"]
        assert set(tags) == {
            "rollout/ep_rew_mean", "rollout/ep_len_mean", "rollout/exploration_rate", "time/fps",
            "train/learning_rate", "train/mu_mean", "train/mu_min", "train/mu_max", "train/td_error",
        }  # fmt: skip
        assert [event.step for event in events.Scalars("rollout/ep_rew_mean")] == [5, 6, 11, 12, 17, 18]
        assert [event.value for event in events.Scalars("rollout/ep_rew_mean")] == pytest.approx(
            [1.5, 2.25, 2.0, 2.25, 2.1, 2.25]
        )
        assert all(0.001 <= event.value <= 0.0100001 for event in events.Scalars("train/learning_rate"))

    def test_the_name_of_a_run(self, tmp_path):
        TabularQ("MlpPolicy", LAKE, tensorboard_log=str(tmp_path)).learn(10)
        assert (tmp_path / "TabularQ_1").is_dir()
