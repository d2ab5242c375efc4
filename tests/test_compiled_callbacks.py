"""Callbacks, log and Monitor files on a compiled environment, beside those of the ordinary path."""

import csv
import warnings

import gymnasium as gym
import numpy as np
import pytest
from helpers.both_paths import assert_same, learn, make_model, make_vec, step_alike
from rl_zoo3.callbacks import RawStatisticsCallback
from stable_baselines3.common.callbacks import (
    BaseCallback,
    CallbackList,
    CheckpointCallback,
    ConvertCallback,
    EvalCallback,
    EveryNTimesteps,
    LogEveryNTimesteps,
    ProgressBarCallback,
    StopTrainingOnMaxEpisodes,
    StopTrainingOnNoModelImprovement,
    StopTrainingOnRewardThreshold,
)
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.logger import KVWriter, Logger
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from sb3_adaptive_q import CompiledVecEnv, EpisodeSeriesCallback, TabularQ, method

LAKE = "slippery lake"
MODEL = {"method": 7, "initial_q": 0.5, "seed": 4}
N_ENVS = pytest.mark.parametrize("n_envs", [1, 3])


class Note(BaseCallback):
    """Writes down when it was called, and what it saw."""

    def __init__(self):
        super().__init__()
        self.steps = []
        self.tables = []
        self.rates = []

    def _on_step(self):
        self.steps.append(self.num_timesteps)
        self.tables.append(self.model.q_table.copy())
        self.rates.append(self.model.mu)
        return True


def on_both_paths(make_callback, total_timesteps, n_envs=1, **arguments):
    """
    Learn on the ordinary and on the compiled path, each with callbacks of its own.

    :return: for each path the outcome and the callbacks
    """
    results = []
    for compiled in (False, True):
        callback = make_callback("compiled" if compiled else "ordinary")
        outcome = learn(make_model(LAKE, compiled, n_envs, **{**MODEL, **arguments}), total_timesteps, callback)
        results.append((outcome, callback))
    assert_same(results[1][0], results[0][0])
    return results


def evaluation(folder=None, **arguments):
    env = DummyVecEnv([lambda: Monitor(gym.make("FrozenLake-v1"))])
    env.seed(0)
    with warnings.catch_warnings():
        return EvalCallback(env, **{"log_path": folder, "n_eval_episodes": 4, "verbose": 0, "warn": False, **arguments})


def same_notes(ordinary, compiled):
    assert compiled.steps == ordinary.steps
    assert compiled.rates == ordinary.rates
    np.testing.assert_array_equal(compiled.tables, ordinary.tables)


@pytest.mark.filterwarnings("ignore:Training and eval env are not of the same type")
class TestEvaluation:
    @N_ENVS
    @pytest.mark.parametrize("deterministic", [True, False])
    @pytest.mark.parametrize("interval", [None, 300])
    def test_the_same_evaluations_at_the_same_steps(self, tmp_path, n_envs, deterministic, interval):
        on_both_paths(
            lambda path: evaluation(str(tmp_path / path), eval_freq=700, deterministic=deterministic),
            3_000 * n_envs,
            n_envs,
            callback_interval=interval,
        )
        ordinary, compiled = (np.load(tmp_path / path / "evaluations.npz") for path in ("ordinary", "compiled"))
        assert ordinary["timesteps"].tolist() == [700 * n_envs * i for i in (1, 2, 3, 4)]
        for key in ordinary:
            np.testing.assert_array_equal(compiled[key], ordinary[key])

    def test_the_best_model_is_the_same(self, tmp_path):
        on_both_paths(lambda path: evaluation(eval_freq=500, best_model_save_path=str(tmp_path / path)), 6_000)
        ordinary, compiled = (TabularQ.load(tmp_path / path / "best_model") for path in ("ordinary", "compiled"))
        assert compiled.num_timesteps == ordinary.num_timesteps
        np.testing.assert_array_equal(compiled.q_table, ordinary.q_table)

    @N_ENVS
    def test_stop_on_reward(self, n_envs):
        results = on_both_paths(
            lambda path: evaluation(
                eval_freq=400, n_eval_episodes=20, callback_on_new_best=StopTrainingOnRewardThreshold(0.2)
            ),
            60_000 * n_envs,
            n_envs,
        )
        assert 400 * n_envs <= results[0][0].num_timesteps < 60_000 * n_envs
        assert results[1][1].best_mean_reward == results[0][1].best_mean_reward >= 0.2

    @N_ENVS
    def test_stop_without_improvement(self, n_envs):
        results = on_both_paths(
            lambda path: evaluation(eval_freq=250, callback_after_eval=StopTrainingOnNoModelImprovement(2, min_evals=3)),
            30_000 * n_envs,
            n_envs,
        )
        assert 250 * n_envs * 5 < results[0][0].num_timesteps < 30_000 * n_envs

    def test_what_the_zoo_gives_to_a_trial(self):
        callbacks = pytest.importorskip("rl_zoo3.callbacks")

        class Trial:
            """Prunes at its third report."""

            def __init__(self):
                self.reports = []

            def report(self, value, index):
                self.reports.append((value, index))

            def should_prune(self):
                return len(self.reports) == 3

        def make(path):
            env = DummyVecEnv([lambda: Monitor(gym.make("FrozenLake-v1"))])
            env.seed(0)
            return callbacks.TrialEvalCallback(env, Trial(), n_eval_episodes=4, eval_freq=333)

        (ordinary, ours), (_, theirs) = on_both_paths(make, 5_000)
        assert ordinary.num_timesteps == 999
        assert ours.is_pruned and theirs.is_pruned
        assert theirs.trial.reports == ours.trial.reports and len(ours.trial.reports) == 3


class TestCheckpoints:
    @N_ENVS
    @pytest.mark.parametrize("interval", [None, 300])
    def test_the_same_files_hold_the_same_tables(self, tmp_path, n_envs, interval):
        on_both_paths(
            lambda path: CheckpointCallback(700, str(tmp_path / path)), 3_000 * n_envs, n_envs, callback_interval=interval
        )
        names = sorted(path.name for path in (tmp_path / "ordinary").iterdir())
        assert names == sorted(f"rl_model_{700 * n_envs * i}_steps.zip" for i in (1, 2, 3, 4))
        assert sorted(path.name for path in (tmp_path / "compiled").iterdir()) == names
        for name in names:
            ordinary, compiled = (TabularQ.load(tmp_path / path / name) for path in ("ordinary", "compiled"))
            np.testing.assert_array_equal(compiled.q_table, ordinary.q_table)
            for attribute in ("mu", "num_timesteps", "_episode_num", "_n_updates", "exploration_rate"):
                assert getattr(compiled, attribute) == getattr(ordinary, attribute), attribute


class TestEveryNTimesteps:
    @N_ENVS
    @pytest.mark.parametrize("n_steps", [1, 2, 100, 1001])
    def test_it_fires_at_the_same_steps(self, n_envs, n_steps):
        total_timesteps = 30 if n_steps < 3 else 4_000
        (_, ordinary), (_, compiled) = on_both_paths(
            lambda path: EveryNTimesteps(n_steps, callback=Note()), total_timesteps, n_envs
        )
        assert len(ordinary.callback.steps) > 2
        same_notes(ordinary.callback, compiled.callback)

    @N_ENVS
    def test_nested_in_one_another(self, n_envs):
        (_, ordinary), (_, compiled) = on_both_paths(
            lambda path: CallbackList([EveryNTimesteps(90, EveryNTimesteps(200, CallbackList([Note()])))]), 3_000, n_envs
        )
        notes = [each.callbacks[0].callback.callback.callbacks[0] for each in (ordinary, compiled)]
        assert len(notes[0].steps) > 5
        same_notes(*notes)

    @N_ENVS
    def test_evaluations_in_it_count_events(self, n_envs):
        (_, ordinary), (_, compiled) = on_both_paths(
            lambda path: EveryNTimesteps(300, evaluation(eval_freq=2, callback_after_eval=Note())), 3_000, n_envs
        )
        assert ordinary.callback.callback.steps == [600, 1200, 1800, 2400, 3000]
        same_notes(ordinary.callback.callback, compiled.callback.callback)

    @N_ENVS
    def test_many_of_different_lengths(self, n_envs):
        (_, ordinary), (_, compiled) = on_both_paths(
            lambda path: [
                EveryNTimesteps(70, Note()),
                EveryNTimesteps(110, Note()),
                EveryNTimesteps(999, Note()),
                StopTrainingOnMaxEpisodes(100),
            ],
            10_000,
            n_envs,
        )
        for ours, theirs in zip(ordinary[:3], compiled[:3], strict=True):
            same_notes(ours.callback, theirs.callback)

    def test_it_goes_on_counting(self):
        notes = []
        for compiled in (False, True):
            model = make_model(LAKE, compiled, **MODEL)
            callback = EveryNTimesteps(400, Note())
            for steps in (1_000, 1_100, 50):
                model.learn(steps, callback=callback, reset_num_timesteps=False)
            notes.append(callback.callback)
        assert notes[0].steps == [400, 800, 1200, 1600, 2000]
        same_notes(*notes)


class TestStopping:
    @N_ENVS
    @pytest.mark.parametrize("interval", [None, 7])
    @pytest.mark.parametrize("max_episodes", [1, 50])
    def test_after_episodes(self, n_envs, interval, max_episodes):
        (outcome, ordinary), (_, compiled) = on_both_paths(
            lambda path: StopTrainingOnMaxEpisodes(max_episodes), 100_000, n_envs, callback_interval=interval
        )
        assert outcome.n_episodes >= max_episodes * n_envs
        assert compiled.n_episodes == ordinary.n_episodes == len(outcome.returns) < (max_episodes + 1) * n_envs

    @N_ENVS
    @pytest.mark.parametrize(
        "nests",
        [
            lambda limit: EveryNTimesteps(50, limit),
            lambda limit: EveryNTimesteps(7, CallbackList([Note(), limit])),
            lambda limit: EvalCallback(
                make_vec(LAKE, False), callback_after_eval=limit, eval_freq=10, n_eval_episodes=1, verbose=0
            ),
        ],
    )
    def test_after_episodes_that_an_event_counts(self, n_envs, nests):
        (outcome, _), _ = on_both_paths(lambda path: nests(StopTrainingOnMaxEpisodes(3)), 3000, n_envs)
        assert 0 < outcome.num_timesteps < 3000

    @N_ENVS
    def test_a_limit_that_is_reached_ends_the_next_training_at_once(self, n_envs):
        steps = []
        for compiled in (False, True):
            model, limit = make_model(LAKE, compiled, n_envs, **MODEL), StopTrainingOnMaxEpisodes(3)
            model.learn(5000, callback=limit)
            reached = model.num_timesteps
            model.learn(5000, callback=limit, reset_num_timesteps=False)
            steps.append((reached, model.num_timesteps - reached))
        assert steps[0] == steps[1] and steps[1][1] == n_envs

    @N_ENVS
    def test_the_steps_are_exact(self, n_envs):
        for total_timesteps in (1, 2, 100, 1001):
            (outcome, _), _ = on_both_paths(lambda path: [], total_timesteps, n_envs)
            assert outcome.num_timesteps == -(-total_timesteps // n_envs) * n_envs

    @N_ENVS
    @pytest.mark.parametrize("interval", [None, 50])
    def test_the_episodes_are_exact(self, n_envs, interval):
        (outcome, _), _ = on_both_paths(lambda path: [], 100_000, n_envs, total_episodes=101, callback_interval=interval)
        assert 101 <= outcome.n_episodes < 101 + n_envs
        assert len(outcome.returns) == outcome.n_episodes
        if n_envs == 1:
            assert outcome.lengths.sum() == outcome.num_timesteps

    def test_no_steps_at_all(self):
        on_both_paths(lambda path: [], 0)

    def test_a_callback_of_a_user_says_no(self):
        class Stop(BaseCallback):
            def _on_step(self):
                return self.num_timesteps < 600

        on_both_paths(lambda path: Stop(), 5_000, callback_interval=100)
        (outcome, _), _ = on_both_paths(lambda path: Stop(), 5_000, n_envs=3, callback_interval=100)
        assert outcome.num_timesteps == 600

    def test_a_function_says_no(self):
        def stop(locals_, globals_):
            return locals_["self"].num_timesteps < 600

        on_both_paths(lambda path: ConvertCallback(stop), 5_000, callback_interval=100)

    def test_training_can_go_on_after_a_stop(self):
        models = [make_model(LAKE, compiled, **MODEL) for compiled in (False, True)]
        for model in models:
            model.learn(10_000, callback=StopTrainingOnMaxEpisodes(20))
        assert_same(*(learn(model, 3_000, reset_num_timesteps=False) for model in models))


class Watch(BaseCallback):
    """What a user's own callback sees."""

    def _on_training_start(self):
        self.seen = []

    def _on_step(self):
        names = ("actions", "new_obs", "rewards", "dones", "infos")
        self.seen.append({name: self.locals[name] for name in names} | {"n": self.num_timesteps, "calls": self.n_calls})
        return True


class TestCallbacksOfAUser:
    @N_ENVS
    def test_once_for_each_rollout(self, n_envs):
        watch = Watch()
        outcome = learn(make_model(LAKE, True, n_envs, callback_interval=400, **MODEL), 1_000 * n_envs, watch)
        assert [seen["n"] for seen in watch.seen] == [400 * n_envs, 800 * n_envs, 1000 * n_envs]
        assert [seen["calls"] for seen in watch.seen] == [1, 2, 3]
        assert [seen["dones"].shape for seen in watch.seen] == [(400, n_envs), (400, n_envs), (200, n_envs)]
        assert all(seen["dones"].dtype == bool for seen in watch.seen)
        assert sum(int(seen["dones"].sum()) for seen in watch.seen) == len(outcome.returns) > 50

    @N_ENVS
    def test_locals_are_those_of_the_ordinary_path(self, n_envs):
        """In rollouts of one step all of them; but for the time of day in the infos."""
        (_, ordinary), (_, compiled) = on_both_paths(lambda path: Watch(), 300, n_envs, callback_interval=1)
        ended = 0
        for ours, theirs in zip(ordinary.seen, compiled.seen, strict=True):
            for name in ("actions", "new_obs", "rewards"):
                np.testing.assert_array_equal(theirs[name], ours[name], name)
                assert theirs[name].dtype == ours[name].dtype
            np.testing.assert_array_equal(theirs["dones"], ours["dones"][None])
            for our, their in zip(ours["infos"], theirs["infos"], strict=True):
                assert their["TimeLimit.truncated"] == our["TimeLimit.truncated"]
                assert their.get("terminal_observation") == our.get("terminal_observation")
                assert ("episode" in their) == ("episode" in our)
                if "episode" in our:
                    ended += 1
                    assert (their["episode"]["r"], their["episode"]["l"]) == (our["episode"]["r"], our["episode"]["l"])
                    assert isinstance(their["episode"]["l"], int) and their["episode"]["t"] >= 0.0
        assert ended > 10

    @N_ENVS
    def test_dones_say_where_episodes_ended(self, n_envs):
        (_, ordinary), (_, compiled) = on_both_paths(lambda path: Watch(), 3_000, n_envs, callback_interval=170)
        ours = np.array([seen["dones"] for seen in ordinary.seen])
        np.testing.assert_array_equal(np.concatenate([seen["dones"] for seen in compiled.seen]), ours)

    @N_ENVS
    def test_the_table_is_live(self, n_envs):
        class Overwrite(BaseCallback):
            def _on_step(self):
                if self.num_timesteps % 600 == 0:
                    self.model.q_table[:] += 1.0
                return True

        (ours, _), _ = on_both_paths(lambda path: Overwrite(), 3_000, n_envs, callback_interval=200)
        assert ours.table.max() > 3.0

    @pytest.mark.parametrize("number", [None, 5, 7])
    def test_it_may_set_the_rate(self, number):
        class Alternate(BaseCallback):
            def _on_step(self):
                if self.num_timesteps % 500 == 0:
                    self.model.mu = 0.002 if self.model.mu > 0.004 else 0.009
                return True

        arguments = {"method": number} if number else {"method": None, "learning_rate": 0.25}
        (ours, _), _ = on_both_paths(lambda path: Alternate(), 4_000, callback_interval=500, **arguments)
        assert len(set(ours.rates.tolist())) >= (2 if number == 5 or number is None else 3)

    def test_a_new_seed_in_the_middle(self):
        class Seed(BaseCallback):
            def _on_step(self):
                if self.num_timesteps == 1_000:
                    self.model.set_random_seed(5)
                return True

        (ours, _), _ = on_both_paths(lambda path: Seed(), 3_000, callback_interval=500)
        (undisturbed, _), _ = on_both_paths(lambda path: Watch(), 3_000, callback_interval=500)
        assert ours.counter != undisturbed.counter

    def test_a_method_as_callback(self):
        (ours, _), _ = on_both_paths(lambda path: method(8), 3_000, method=None)
        assert len(set(ours.rates.tolist())) > 1

    @pytest.mark.parametrize("n_envs", [1, 4])
    def test_the_default_rollout_is_long(self, n_envs):
        watch = Watch()
        make_model(LAKE, True, n_envs=n_envs).learn(1_300_000, callback=watch, log_interval=None)
        assert [np.size(seen["dones"]) for seen in watch.seen] == [1_000_000, 300_000]

    @pytest.mark.parametrize(("callback", "name"), [(Watch(), "Watch"), (lambda found, everywhere: True, "ConvertCallback")])
    def test_one_that_may_not_know_is_warned_of(self, callback, name):
        with pytest.warns(UserWarning, match=f"{name} is called once for a block of many steps") as warned:
            make_model(LAKE, True).learn(1_000, callback=callback, log_interval=None)
        assert len(warned) == 1

    @pytest.mark.parametrize("callback", [LogEveryNTimesteps(400), StopTrainingOnMaxEpisodes(10**6)])
    def test_those_of_the_library_are_not_warned_of(self, callback):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            make_model(LAKE, True).learn(1_000, callback=callback, log_interval=None)

    def test_one_of_rl_zoo_that_needs_every_step_is_warned_of(self, tmp_path):
        model = make_model(LAKE, True, tensorboard_log=str(tmp_path))
        with pytest.warns(UserWarning, match="RawStatisticsCallback is called once for a block of many steps"):
            model.learn(1_000, callback=RawStatisticsCallback(), log_interval=None)

    def test_one_that_says_it_knows_is_not_warned_of(self):
        class Knowing(Watch):
            knows_rollouts = True

        with warnings.catch_warnings():
            warnings.simplefilter("error")
            make_model(LAKE, True).learn(1_000, callback=[Knowing(), method(7)], log_interval=None)

    def test_events(self):
        events = []

        class Events(BaseCallback):
            def _on_training_start(self):
                events.append("training start")

            def _on_rollout_start(self):
                events.append("rollout start")

            def _on_step(self):
                events.append(self.num_timesteps)
                return True

            def _on_rollout_end(self):
                events.append("rollout end")

            def _on_training_end(self):
                events.append("training end")

        make_model(LAKE, True, callback_interval=100).learn(200, callback=Events())
        assert events == [
            "training start",
            "rollout start", 100, "rollout end",
            "rollout start", 200, "rollout end",
            "training end",
        ]  # fmt: skip


class TestProgressBar:
    @N_ENVS
    def test_it_ends_full(self, monkeypatch, n_envs):
        class Bar:
            def __init__(self, total):
                self.total, self.updates = total, []
                bars.append(self)

            def update(self, n):
                self.updates.append(n)

            def refresh(self):
                pass

            close = refresh

        bars = []
        monkeypatch.setattr("stable_baselines3.common.callbacks.tqdm", Bar)
        model = make_model(LAKE, True, n_envs, callback_interval=400)
        model.learn(3_000, progress_bar=True)
        model.learn(600, callback=CallbackList([ProgressBarCallback()]), reset_num_timesteps=False)
        assert [(bar.total, sum(bar.updates)) for bar in bars] == [(3_000, 3_000), (600, 600)]
        assert len(bars[0].updates) > 1


class Kept(KVWriter):
    """Keeps what is logged, but for what depends on the time of day."""

    def __init__(self):
        self.entries = []

    def write(self, key_values, key_excluded, step=0):
        timeless = {key: value for key, value in key_values.items() if key not in ("time/fps", "time/time_elapsed")}
        self.entries.append((step, timeless))

    def close(self):
        pass


def logged(compiled, total_timesteps, callback=None, n_envs=1, **arguments):
    model = make_model(LAKE, compiled, n_envs, **{**MODEL, **arguments})
    kept = Kept()
    model.set_logger(Logger(folder=None, output_formats=[kept]))
    model.learn(total_timesteps, callback=callback, log_interval=None)
    return model, kept


class TestLog:
    @N_ENVS
    @pytest.mark.parametrize("n_steps", [1000, 777])
    def test_every_n_timesteps(self, n_envs, n_steps):
        (_, ordinary), (_, compiled) = (logged(path, 9_000, LogEveryNTimesteps(n_steps), n_envs) for path in (False, True))
        assert len(ordinary.entries) >= 8
        assert compiled.entries == ordinary.entries
        values = ordinary.entries[-1][1]
        for key in ("rollout/ep_rew_mean", "rollout/ep_len_mean", "train/td_error", "train/mu_mean", "train/n_updates"):
            assert np.isfinite(values[key])

    @N_ENVS
    def test_at_the_end(self, n_envs):
        results = [logged(path, 20_000, n_envs=n_envs) for path in (False, True)]
        for model, _ in results:
            model.dump_logs()
        (ordinary, our_log), (compiled, their_log) = results
        assert their_log.entries == our_log.entries and len(our_log.entries) == 1
        for name in ("r", "l"):
            ours = [info[name] for info in ordinary.ep_info_buffer]
            assert [info[name] for info in compiled.ep_info_buffer] == ours
            assert len(ours) == 100

    @pytest.mark.parametrize("size", [1, 7, 1000])
    def test_the_window(self, size):
        (ordinary, _), (compiled, _) = (logged(path, 9_000, stats_window_size=size) for path in (False, True))
        ours, theirs = ([(info["r"], info["l"]) for info in model.ep_info_buffer] for model in (ordinary, compiled))
        assert theirs == ours and len(ours) == min(size, ordinary._episode_num)

    def test_the_window_spans_rollouts(self):
        (ordinary, _), (compiled, _) = (logged(path, 9_000, callback_interval=50) for path in (False, True))
        ours, theirs = ([(info["r"], info["l"]) for info in model.ep_info_buffer] for model in (ordinary, compiled))
        assert theirs == ours

    def test_intervals_of_episodes(self):
        """Written after the rollout in which they were due."""
        model, kept = make_model(LAKE, True, callback_interval=500, **MODEL), Kept()
        model.set_logger(Logger(folder=None, output_formats=[kept]))
        model.learn(5_000, log_interval=10)
        assert [step for step, _ in kept.entries] == list(range(500, 5_001, 500))

    def test_without_a_monitor_no_returns_are_logged(self):
        env = make_vec(LAKE, True, monitor_dir=None)
        env.envs[0] = env.envs[0].env
        kept = Kept()
        model = TabularQ("MlpPolicy", env, **MODEL)
        model.set_logger(Logger(folder=None, output_formats=[kept]))
        series = EpisodeSeriesCallback()
        model.learn(5_000, callback=[series, LogEveryNTimesteps(2_500)], log_interval=None)
        assert len(series.returns) > 100
        assert all("rollout/ep_rew_mean" not in values for _, values in kept.entries)


def rows_of(path):
    with open(path) as file:
        assert file.readline().startswith("#")
        return [(float(row["r"]), int(row["l"])) for row in csv.DictReader(file)]


class TestMonitorFiles:
    @N_ENVS
    @pytest.mark.parametrize("interval", [None, 100])
    def test_they_hold_every_episode(self, tmp_path, n_envs, interval):
        outcomes = []
        for compiled in (False, True):
            env = make_vec(LAKE, compiled, n_envs, monitor_dir=str(tmp_path / str(compiled)))
            model = TabularQ("MlpPolicy", env, callback_interval=interval, **MODEL)
            outcomes.append(learn(model, 5_000))
            env.close()
        total = 0
        for i in range(n_envs):
            ordinary, compiled = (rows_of(tmp_path / str(path) / f"{i}.monitor.csv") for path in (False, True))
            assert compiled == ordinary
            total += len(ordinary)
        assert total == outcomes[0].n_episodes > 100

    def test_returns_are_rounded_as_the_monitor_rounds(self, tmp_path):
        from helpers.table_env import TableEnv

        from sb3_adaptive_q import CompiledVecEnv, LeanVecEnv

        rewards = (1 / 3, 1e-7, 0.12345650000000001, -2.5e-6)
        table = [[[(0.25, i, reward, i == 3) for i, reward in enumerate(rewards)]]] * 4
        outcomes = []
        for kind in (LeanVecEnv, CompiledVecEnv):
            env = kind([lambda kind=kind: Monitor(TableEnv(table, [1.0, 0, 0, 0]), str(tmp_path / kind.__name__))])
            outcomes.append(learn(TabularQ("MlpPolicy", env, seed=0), 4_000))
            env.close()
        assert_same(outcomes[1], outcomes[0])
        ordinary, compiled = (rows_of(tmp_path / f"{kind.__name__}.monitor.csv") for kind in (LeanVecEnv, CompiledVecEnv))
        assert compiled == ordinary and len(set(ordinary)) > 100


class TestWhereTheEnvironmentIsAfterwards:
    @N_ENVS
    @pytest.mark.parametrize("name", ["slippery lake", "Taxi", "CliffWalking", "CartPole", "CartPoleFriction"])
    def test_it_steps_on_from_where_learning_ended(self, name, n_envs):
        models = [make_model(name, compiled, n_envs, method=2) for compiled in (False, True)]
        for model in models:
            model.learn(2_003, log_interval=None)
        ordinary, compiled = (model.env for model in models)
        np.testing.assert_array_equal(models[1]._last_obs, models[0]._last_obs)
        ended = 0
        for step in range(450):
            actions = np.array([(step // 3 + i) % 2 for i in range(n_envs)])
            for our_info, info in step_alike(compiled, ordinary, actions):
                for each in (info, our_info):
                    each.get("episode", {}).pop("t", None)
                assert our_info.get("episode") == info.get("episode")
                assert our_info["TimeLimit.truncated"] == info["TimeLimit.truncated"]
                ended += "episode" in info
        assert ended > 0 or name == "CliffWalking"
        for env, our_env in zip(ordinary.envs, compiled.envs, strict=True):
            ours, theirs = (each.get_wrapper_attr("get_total_steps")() for each in (env, our_env))
            assert theirs == ours == -(-2_003 // n_envs) + 450
            assert our_env.unwrapped.np_random.bit_generator.state == env.unwrapped.np_random.bit_generator.state

    def test_after_an_evaluation_on_the_same_environment(self):
        """Which ends the episode in hand, on either path."""
        from stable_baselines3.common.evaluation import evaluate_policy

        outcomes = []
        for compiled in (False, True):
            model = make_model(LAKE, compiled, **MODEL)
            model.learn(1_000)
            rewards, lengths = evaluate_policy(model, model.env, n_eval_episodes=5, return_episode_rewards=True)
            outcomes.append((rewards, lengths))
        assert outcomes[0] == outcomes[1]


def test_tensorboard_files_are_written(tmp_path):
    model = make_model(LAKE, True, tensorboard_log=str(tmp_path), **MODEL)
    model.learn(20_000, callback=LogEveryNTimesteps(5_000))
    assert list(tmp_path.glob("TabularQ_method7_1/events.out.tfevents.*"))


class Adds(BaseCallback):
    """Adds a callback to its own list in the middle of a training."""

    knows_rollouts = True

    def __init__(self, added: BaseCallback) -> None:
        super().__init__()
        self.added = added
        self.together: CallbackList | None = None

    def _on_step(self) -> bool:
        if self.together is not None:
            self.added.init_callback(self.model)
            self.together.callbacks.append(self.added)
            self.together = None
        return True


def test_a_callback_that_is_added_later_is_called_when_it_is_due(tmp_path):
    """It comes after ten steps, sees the last of these and ninety more, and acts at every seventh."""
    adds = Adds(CheckpointCallback(7, str(tmp_path)))
    adds.together = CallbackList([adds])
    env = make_vec_env("FrozenLake-v1", vec_env_cls=CompiledVecEnv)
    TabularQ("MlpPolicy", env, callback_interval=10, seed=0).learn(100, callback=adds.together)
    assert len(list(tmp_path.iterdir())) == (90 + 1) // 7
