"""Trainings that are broken off and go on as if nothing had happened."""

import json
import os
import random
import signal
import time
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.wrappers import TimeLimit, TransformReward
from helpers.algorithms import algorithms
from helpers.both_paths import make_vec
from helpers.environments import MarkovEnv, SampledEnv, Step
from helpers.interrupted import (
    Memory,
    Training,
    assert_goes_on,
    checkpoints,
    kill_at_random,
    outcome_in,
    run_in_process,
    train,
    was_killed,
)
from stable_baselines3.common.callbacks import BaseCallback, CheckpointCallback, EvalCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecMonitor

from sb3_adaptive_q import CompiledVecEnv, EpisodeSeriesCallback, LeanVecEnv, TabularQ, method
from sb3_adaptive_q.environment_state import CannotRead, check_environments, read_environments, write_environments
from sb3_adaptive_q.saved_values import decode, encode
from wrappers import DiscretizeObservation

LAKE = "FrozenLake-v1"
PATHS = pytest.mark.parametrize("compiled", [False, True], ids=["ordinary", "compiled"])
LINE = LinearSchedule(0.5, 0.0625, 0.75)


def falling(progress):
    return 1.0 - 0.75 * progress


class TestBitForBit:
    """From every checkpoint of a training, one of them at its last step."""

    @PATHS
    @pytest.mark.parametrize("n_envs", [1, 3])
    @pytest.mark.parametrize(
        "arguments",
        [
            {"method": 3},
            {"method": 7},
            {"method": "autostep"},
            {"learning_rate": LINE},
            {"method": 6, "total_episodes": 130},
            {"exploration": "boltzmann", "exploration_schedule": falling, "ties": "first", "learning_rate": 0.5},
        ],
        ids=["3", "7", "autostep", "schedule", "episodes", "boltzmann"],
    )
    def test_methods(self, tmp_path, compiled, n_envs, arguments):
        training = Training("slippery lake", compiled, n_envs, 1200, 1200 // n_envs // 4, {"seed": 1, **arguments})
        whole = train(training, tmp_path)
        assert len(whole.logged) >= 3 and len(checkpoints(tmp_path)) >= 2
        for step, checkpoint in checkpoints(tmp_path):
            assert_goes_on(train(training, tmp_path / "again", checkpoint), whole, step)

    @PATHS
    @pytest.mark.parametrize("name", ["Taxi", "CliffWalking", "CartPole", "CartPoleFriction"])
    def test_environments(self, tmp_path, compiled, name):
        training = Training(name, compiled, 2, 1000, 200, {"seed": 3, "method": 7})
        whole = train(training, tmp_path)
        for step, checkpoint in checkpoints(tmp_path):
            assert_goes_on(train(training, tmp_path / "again", checkpoint), whole, step)

    @PATHS
    def test_on_the_other_path(self, tmp_path, compiled):
        training = Training("CartPole", compiled, 2, 2000, 400, {"seed": 5, "method": "autostep"})
        whole = train(training, tmp_path)
        for _, checkpoint in checkpoints(tmp_path):
            rest = train(training, tmp_path / "again", checkpoint, compiled=not compiled)
            assert (rest.arrays, rest.next_actions) == (whole.arrays, whole.next_actions)
            assert rest.episodes.tobytes() == whole.episodes[len(whole.episodes) - len(rest.episodes) :].tobytes()

    @PATHS
    @pytest.mark.parametrize("kind", algorithms(), ids=lambda kind: kind.__name__)
    def test_algorithms(self, tmp_path, compiled, kind):
        """Traces and buffers of the last steps are part of it."""
        training = Training("slippery lake", compiled, 2, 600, 75, {"seed": 1, "method": 7}, kind)
        whole = train(training, tmp_path)
        for step, checkpoint in checkpoints(tmp_path):
            assert_goes_on(train(training, tmp_path / "again", checkpoint), whole, step)

    def test_action_masks(self, tmp_path):
        training = Training("Taxi", False, 1, 600, 150, {"seed": 1, "method": 7, "use_masking": True})
        whole = train(training, tmp_path)
        for step, checkpoint in checkpoints(tmp_path):
            assert_goes_on(train(training, tmp_path / "again", checkpoint), whole, step)

    def test_a_resumed_training_can_be_resumed(self, tmp_path):
        training = Training("slippery lake", False, 1, 1000, 150, {"seed": 1, "method": 7})
        whole = train(training, tmp_path)
        _, checkpoint = checkpoints(tmp_path)[0]
        train(training, tmp_path / "again", checkpoint)
        assert [step for step, _ in checkpoints(tmp_path / "again")] == [300, 450, 600, 750, 900]
        for step, checkpoint in checkpoints(tmp_path / "again"):
            assert_goes_on(train(training, tmp_path / "third", checkpoint), whole, step)

    @PATHS
    def test_what_callbacks_have_set(self, tmp_path, compiled):
        class Set(BaseCallback):
            knows_rollouts = True

            def _on_training_start(self):
                if self.locals["reset_num_timesteps"]:
                    self.model.mu, self.model.exploration_rate = 0.25, 0.75

            def _on_step(self):
                return True

        def learn(model, folder):
            callbacks = [CheckpointCallback(100, str(folder), "x"), Set()]
            begins = model.num_timesteps == 0
            model.learn(400, callback=callbacks) if begins else model.finish(callbacks)
            return model.q_table.tobytes(), model.training.as_data()

        def make():
            return make_vec_env(LAKE, vec_env_cls=CompiledVecEnv if compiled else LeanVecEnv)

        whole = learn(TabularQ("MlpPolicy", make(), seed=0, initial_q=1.0), tmp_path)
        assert (whole[1]["mu"], whole[1]["epsilon"]) == (0.25, 0.75)
        assert learn(TabularQ.resume(tmp_path / "x_200_steps", make()), tmp_path / "again") == whole

    @PATHS
    @pytest.mark.parametrize("limit", [7, None])
    def test_episodes_that_no_monitor_counts(self, tmp_path, compiled, limit):
        """Their returns so far are in the file."""

        def make():
            env = gym.make("CliffWalking-v1").unwrapped
            wrapped = env if limit is None else TimeLimit(env, limit)
            return (CompiledVecEnv if compiled else LeanVecEnv)([lambda: wrapped])

        whole, rest = EpisodeSeriesCallback(), EpisodeSeriesCallback()
        arguments = {"seed": 0, "initial_q": 1.0, "learning_rate": 0.5, "exploration_initial_eps": 0.5}
        model = TabularQ("MlpPolicy", make(), **arguments)
        model.learn(20_000, callback=[whole, CheckpointCallback(6_003, str(tmp_path), "x")])
        TabularQ.resume(tmp_path / "x_6003_steps", make()).finish(rest)
        assert 3 < len(rest.returns) < len(whole.returns)
        np.testing.assert_array_equal(rest.returns, whole.returns[-len(rest.returns) :])
        np.testing.assert_array_equal(rest.lengths, whole.lengths[-len(rest.returns) :])


class TestBetweenTrainings:
    @PATHS
    def test_a_training_that_is_over_is_followed_by_another(self, tmp_path, compiled):
        def make():
            return make_vec_env(LAKE, 2, vec_env_cls=CompiledVecEnv if compiled else LeanVecEnv)

        for arguments in ({"method": 4}, {"learning_rate": LINE}, {"total_episodes": 30}):
            model = TabularQ("MlpPolicy", make(), seed=0, **arguments).learn(500)
            model.save(tmp_path / "model")
            resumed = TabularQ.resume(tmp_path / "model", make())
            for each in (model, resumed):
                each.learn(300, reset_num_timesteps=False)
            np.testing.assert_array_equal(resumed.q_table, model.q_table)
            assert resumed.training.as_data() == model.training.as_data()

    def test_fifty_chunks_learn_as_much_as_one_training(self, tmp_path):
        """No chunk draws the random numbers of another: about as many pairs are learned, and not as few as in one chunk."""
        arguments = {"seed": 0, "exploration_final_eps": 1.0, "learning_rate": 0.5}
        whole = TabularQ("MlpPolicy", "Taxi-v4", **arguments).learn(10_000)
        model = TabularQ("MlpPolicy", "Taxi-v4", **arguments).learn(200)
        for _ in range(49):
            model.save(tmp_path / "model")
            model = TabularQ.load(tmp_path / "model", env="Taxi-v4").learn(200, reset_num_timesteps=False)
        assert model.num_timesteps == 10_000
        assert np.count_nonzero(model.q_table) > 0.8 * np.count_nonzero(whole.q_table)

    @PATHS
    def test_counters_beyond_32_and_64_bits(self, tmp_path, compiled):
        model = TabularQ("MlpPolicy", make_vec("slippery lake", compiled), seed=0, method="polynomial")
        for name in ("num_timesteps", "n_updates", "n_episodes"):
            model.training.record[name] = 2**31 - 100
        model.training.record["counter"] = 2**64 - 1
        model.training.forget_updates()
        model.memory["visits"][:] = 2**31 - 2
        log = Memory()
        model.set_logger(Logger(None, [log]))
        model.learn(2000, reset_num_timesteps=False)
        assert model.num_timesteps == model._n_updates == 2**31 + 1900
        assert model._episode_num > 2**31
        assert model.memory["visits"].max() > 2**31 and model.memory["visits"].sum() == 64 * (2**31 - 2) + 2000
        draws = (int(model.training.record["counter"][0]) + 1) * pow(0x9E3779B97F4A7C15, -1, 2**64) % 2**64
        assert 2000 < draws < 8000  # one to three for an action, once more where an episode begins
        step, entry = log.entries[-1]
        assert step == entry["train/n_updates"] == 2**31 + 1900 and 0.0 < entry["train/mu_mean"] < 1e-6
        model.save(tmp_path / "model")
        loaded = TabularQ.load(tmp_path / "model")
        for name in ("num_timesteps", "n_updates", "n_episodes", "counter"):
            assert loaded.training.record[name] == model.training.record[name]
        np.testing.assert_array_equal(loaded.memory["visits"], model.memory["visits"])

    def test_a_training_that_has_not_begun(self, tmp_path):
        model = TabularQ("MlpPolicy", LAKE, seed=0, initial_q=1.0)
        model.save(tmp_path / "model")
        resumed = TabularQ.resume(tmp_path / "model", LAKE)
        assert resumed.remaining_timesteps == 0
        np.testing.assert_array_equal(resumed.learn(300).q_table, model.learn(300).q_table)

    def test_a_training_that_a_callback_ended(self, tmp_path):
        model = TabularQ("MlpPolicy", LAKE, seed=0, initial_q=1.0, method=3)
        model.learn(500, callback=lambda found, _: found["self"].num_timesteps < 200)
        model.save(tmp_path / "model")
        resumed = TabularQ.resume(tmp_path / "model", LAKE)
        for each in (model, resumed):
            assert each.remaining_timesteps == 300
            each.finish()
        np.testing.assert_array_equal(resumed.q_table, model.q_table)
        assert resumed.training.as_data() == model.training.as_data()
        assert (model.num_timesteps, model.mu) == (500, 0.01)


class TestFinish:
    @pytest.fixture
    def checkpoint(self, tmp_path):
        TabularQ("MlpPolicy", LAKE, seed=0, method=3, initial_q=1.0).learn(400, CheckpointCallback(100, str(tmp_path), "x"))
        return tmp_path / "x_200_steps.zip"

    def test_the_remaining_steps_by_learn(self, checkpoint):
        """SB3's own way to go on: the total is then that of the training, and so are its schedules."""
        first, second = TabularQ.resume(checkpoint, LAKE), TabularQ.resume(checkpoint, LAKE)
        assert first.remaining_timesteps == 200
        first.finish()
        second.learn(first.remaining_timesteps or 200, log_interval=300, reset_num_timesteps=False)
        np.testing.assert_array_equal(first.q_table, second.q_table)
        assert first.training.as_data() == second.training.as_data()
        assert (first.num_timesteps, first.remaining_timesteps, first.mu) == (400, 0, 0.01)

    def test_more_steps_than_remain(self, checkpoint):
        """As in SB3, the total is then another one: Method 3 is at 200 + 600 of 800 steps, not at the end."""
        model = TabularQ.resume(checkpoint, LAKE)
        rates = []
        model.learn(600, callback=lambda found, _: rates.append(found["self"].mu) or True, reset_num_timesteps=False)
        assert model.num_timesteps == 800
        np.testing.assert_allclose(rates[-1], 0.01 + 0.04 * (1 - 799 / 800), rtol=1e-12)

    def test_a_new_training_gives_the_old_one_up_with_a_word(self, checkpoint):
        model = TabularQ.resume(checkpoint, LAKE)
        with pytest.warns(UserWarning, match=r"A new training begins here.*call `finish\(\)`"):
            model.learn(50)
        assert model.num_timesteps == 50

    @pytest.mark.parametrize(
        "argument", [{"method": 3}, {"learning_rate": 0.5}, {"seed": 3}, {"method_kwargs": None}], ids=str
    )
    def test_another_training_is_not_resumed(self, checkpoint, argument):
        with pytest.raises(ValueError, match=f"so `{next(iter(argument))}` must stay as it was: use `load`"):
            TabularQ.resume(checkpoint, LAKE, **argument)

    def test_what_does_not_change_it_may_be_changed(self, checkpoint, tmp_path):
        model = TabularQ.resume(checkpoint, LAKE, tensorboard_log=str(tmp_path / "log"), verbose=0, stats_window_size=7)
        model.finish(tb_log_name="again")
        assert (tmp_path / "log" / "again_0").is_dir() or any((tmp_path / "log").iterdir())

    def test_other_environments_are_refused(self, checkpoint):
        with pytest.raises(ValueError, match="Observation spaces do not match"):
            TabularQ.resume(checkpoint, gym.make(LAKE, map_name="8x8"))
        with pytest.raises(ValueError, match=r"x_200_steps\.zip.*the training had 1 environments, but got 2"):
            TabularQ.resume(checkpoint, make_vec_env(LAKE, 2))
        with pytest.raises(
            ValueError, match=r"environment was Monitor around TimeLimit around FrozenLakeEnv, but got FrozenLakeEnv"
        ):
            TabularQ.resume(checkpoint, DummyVecEnv([lambda: gym.make(LAKE).unwrapped]))

    @PATHS
    def test_after_an_interrupt_in_the_same_process(self, compiled):
        """The episode is lost, as the environment may have moved on; progress, and so Method 3, ends where it would."""

        def interrupt(found, _):
            if found["self"].num_timesteps == 500:
                raise KeyboardInterrupt
            return True

        env = make_vec_env(LAKE, vec_env_cls=CompiledVecEnv if compiled else LeanVecEnv)
        for arguments in ({}, {"total_episodes": 100}):
            model = TabularQ("MlpPolicy", env, seed=0, method=3, callback_interval=100, **arguments)
            with pytest.raises(KeyboardInterrupt):
                model.learn(2000, callback=interrupt)
            model.finish()
            assert model.mu == 0.01
            assert (model._episode_num == 100) if arguments else (model.num_timesteps == 2000)

    def test_load_goes_on_with_the_count(self, checkpoint):
        """Plain ``load``: SB3's way, from a new episode on."""
        model = TabularQ.load(checkpoint, env=LAKE).learn(200, reset_num_timesteps=False)
        assert (model.num_timesteps, model.mu) == (400, 0.01)


class Counter(gym.Env):
    """An environment of a user's, which counts."""

    observation_space, action_space = spaces.Discrete(7), spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.count = 0
        return 0, {}

    def step(self, action):
        self.count += 1 + int(action)
        reward = float(self.np_random.random())
        return self.count % 7, reward, self.count > 40, False, {"is_success": reward > 0.5}


class ReadableCounter(Counter):
    def get_state(self):
        return {"count": self.count, "more": np.arange(3)}

    def set_state(self, state):
        assert state["more"].tolist() == [0, 1, 2]
        self.count = state["count"]


class Broken(ReadableCounter):
    def get_state(self):
        raise ZeroDivisionError("no such number")


class TestOtherEnvironments:
    def learn(self, env, tmp_path, kind=LeanVecEnv):
        model = TabularQ("MlpPolicy", kind([lambda: Monitor(env)]), seed=0, method=7, initial_q=1.0)
        return model.learn(500, callback=CheckpointCallback(150, str(tmp_path), "x"))

    @pytest.mark.filterwarnings("error")
    @pytest.mark.parametrize("kind", [LeanVecEnv, DummyVecEnv])
    def test_an_environment_that_can_be_read(self, tmp_path, kind):
        whole = self.learn(ReadableCounter(), tmp_path, kind)
        for step in (150, 300, 450):
            rest = TabularQ.resume(tmp_path / f"x_{step}_steps", kind([lambda: Monitor(ReadableCounter())])).finish()
            np.testing.assert_array_equal(rest.q_table, whole.q_table)
            assert rest.training.as_data() == whole.training.as_data()
            assert list(rest.ep_success_buffer) == list(whole.ep_success_buffer)

    @pytest.mark.parametrize(
        ("make", "reason"),
        [
            (Counter, r"the state of Counter cannot be read: give it the methods `get_state\(\)`"),
            (lambda: gym.wrappers.RecordEpisodeStatistics(ReadableCounter()), "the state of RecordEpisodeStatistics cannot"),
            (Broken, "no such number"),
        ],
        ids=["environment", "wrapper", "error"],
    )
    def test_others_go_on_from_a_new_episode(self, tmp_path, make, reason):
        self.learn(make(), tmp_path)
        with pytest.warns(UserWarning, match=f"The training continues with a new episode, because {reason}"):
            model = TabularQ.resume(tmp_path / "x_300_steps", make())
        assert model.remaining_timesteps == 200
        counter = int(model.training.record["counter"][0])
        model.finish()
        assert model.num_timesteps == 500 and model.training.record["counter"][0] != counter

    @pytest.mark.parametrize(
        "kind", [SubprocVecEnv, lambda functions: VecMonitor(LeanVecEnv(functions))], ids=["processes", "wrapper"]
    )
    def test_environments_out_of_reach(self, tmp_path, kind):
        env = kind([ReadableCounter])
        model = TabularQ("MlpPolicy", env, seed=0)
        model.learn(60, callback=CheckpointCallback(50, str(tmp_path), "x"))
        env.close()
        with pytest.warns(UserWarning, match="cannot be read: use LeanVecEnv without a wrapper"):
            TabularQ.resume(tmp_path / "x_50_steps", ReadableCounter()).finish()

    def test_new_episodes_are_other_ones_after_every_checkpoint(self, tmp_path):
        """The environment is seeded anew, from the seed and the agent's counter."""
        self.learn(SampledEnv(spaces.Discrete(10**6), spaces.Discrete(2)), tmp_path)
        states = []
        for step in (150, 300, 450, 450):
            with pytest.warns(UserWarning, match="new episode"):
                model = TabularQ.resume(tmp_path / f"x_{step}_steps", SampledEnv(spaces.Discrete(10**6), spaces.Discrete(2)))
            states.append(int(model.get_env().reset()[0]))
        assert len(set(states)) == 3 and states[2] == states[3]


class TestEnvironmentState:
    """An environment that is put where another was does what that does from then on."""

    @pytest.mark.parametrize(
        "make",
        [
            lambda: gym.make(LAKE),
            lambda: gym.make("Taxi-v4", fickle_passenger=True, is_rainy=True),
            lambda: gym.make("CliffWalking-v1", is_slippery=True, max_episode_steps=50),
            lambda: gym.make("Blackjack-v1"),
            lambda: gym.make("CartPole-v1"),
            lambda: gym.make("CartPoleFriction-v0"),
            lambda: gym.make("BlockingMaze-v0", max_episode_steps=50),
            lambda: gym.make("DriftingMean-v0", max_episode_steps=50),
            lambda: gym.make("MountainCar-v0", max_episode_steps=60),
            lambda: gym.make("Acrobot-v1", max_episode_steps=60),
            lambda: gym.make("Pendulum-v1", max_episode_steps=60),
            lambda: gym.make("MountainCarContinuous-v0", max_episode_steps=60),
            lambda: DiscretizeObservation(gym.make("CartPole-v1"), 4, [-1] * 4, [1] * 4),
            lambda: TransformReward(gym.make(LAKE), float),
            ReadableCounter,
            lambda: TimeLimit(MarkovTable(), 9),
        ],
    )
    def test_it_goes_on_alike(self, make):
        ours, theirs = (DummyVecEnv([lambda: Monitor(make()), lambda: Monitor(make())]) for _ in range(2))
        ours.seed(7)
        ours.reset()
        space = ours.action_space
        space.seed(0)
        for moment in range(300):
            if moment % 37 == 0:
                arrays = {}
                data = json.loads(json.dumps(encode(read_environments(ours), arrays), allow_nan=False))
                write_environments(theirs, decode(data, arrays))
            chosen = [space.sample() for _ in range(2)]
            for our, their in zip(ours.step(chosen)[:3], theirs.step(chosen)[:3], strict=True):
                for one, other in zip(*(part if isinstance(part, tuple) else (part,) for part in (our, their)), strict=True):
                    np.testing.assert_array_equal(one, other)
        assert all(env.get_episode_rewards() for env in ours.envs)

    def test_what_has_functions_of_its_own_is_not_read(self):
        env = gym.make(LAKE)
        env.unwrapped.step = lambda action: (0, 0.0, False, False, {})
        with pytest.raises(CannotRead, match="the state of FrozenLakeEnv cannot be read"):
            read_environments(DummyVecEnv([lambda: env]))

    def test_a_class_that_steps_otherwise_is_not_read(self):
        class Other(type(gym.make(LAKE).unwrapped)):
            def step(self, action):
                return super().step(action)

        with pytest.raises(CannotRead, match="the state of Other cannot be read"):
            read_environments(DummyVecEnv([Other]))

    def test_generators_of_another_kind_are_refused(self):
        ours, theirs = (DummyVecEnv([ReadableCounter]) for _ in range(2))
        ours.reset()
        theirs.envs[0].unwrapped.np_random = np.random.Generator(np.random.MT19937(0))
        with pytest.raises(ValueError, match="drew from a PCG64, but got one that draws from a MT19937"):
            check_environments(theirs, read_environments(ours))


class MarkovTable(MarkovEnv):
    """An environment with a table, which says that it does nothing else."""

    compile_by_table = True

    def __init__(self):
        super().__init__(
            [[Step(1.0, 1), Step(0.0, 2)], [Step(0.0, 2), Step(-1.0, 0)], [Step(0.5, 0), Step(0.0, 1, "terminated")]]
        )

    @property
    def s(self):
        return self.state

    @s.setter
    def s(self, state):
        self.state = state


KILLED = [
    Training("slippery lake", False, 1, 60_000, 1_000, {"seed": 0, "method": 3}),
    Training("CartPole", False, 3, 60_000, 700, {"seed": 1, "method": 7}),
    Training("slippery lake", False, 1, 60_000, 1_000, {"seed": 2, "method": "autostep"}),
    Training("Taxi", True, 3, 6_000_000, 40_000, {"seed": 3, "method": 3}),
    Training("slippery lake", True, 1, 6_000_000, 100_000, {"seed": 4, "method": 7}),
    Training("CartPole", True, 3, 3_000_000, 20_000, {"seed": 5, "method": "autostep"}),
]


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="there is no SIGKILL here")
class TestKilled:
    @pytest.mark.parametrize("training", KILLED, ids=lambda each: f"{each.env}-{each.compiled}-{each.arguments['method']}")
    def test_a_killed_training_goes_on_in_another_process(self, tmp_path, training):
        process = run_in_process(training, tmp_path)
        kill_at_random(process, tmp_path, training, random.Random(training.total + training.n_envs))
        assert was_killed(process)
        step, checkpoint = checkpoints(tmp_path)[-1]
        process = run_in_process(training, tmp_path, checkpoint)
        whole = train(training, tmp_path / "whole")
        process.join()
        assert_goes_on(outcome_in(tmp_path), whole, step)

    def test_a_kill_in_the_middle_of_a_save_leaves_the_old_file(self, tmp_path):
        """A large model is saved again and again under one name; whenever it is killed, the file is one of those saved."""
        env = SampledEnv(spaces.Discrete(100_000), spaces.Discrete(4))
        model = TabularQ("MlpPolicy", env)
        model.save(tmp_path / "model")
        moments = random.Random(0)
        for _ in range(60 if os.environ.get("EXHAUSTIVE") else 8):
            pid = os.fork()
            if pid == 0:
                try:
                    for value in range(1, 1000):
                        model.q_table[:] = value
                        model.save(tmp_path / "model")
                finally:
                    os._exit(1)
            time.sleep(moments.uniform(0.02, 0.2))
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
            table = TabularQ.load(tmp_path / "model").q_table
            assert (table == table[0, 0]).all()


class TestCallbacksOfStableBaselines:
    def test_an_evaluation_saves_whole_files_too(self, tmp_path):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            evaluation = EvalCallback(Monitor(gym.make(LAKE)), eval_freq=100, best_model_save_path=str(tmp_path), verbose=0)
        model = TabularQ("MlpPolicy", LAKE, seed=0, initial_q=1.0).learn(500, callback=[evaluation, method(7)])
        assert os.listdir(tmp_path) == ["best_model.zip"]
        assert TabularQ.load(tmp_path / "best_model").num_timesteps <= model.num_timesteps
