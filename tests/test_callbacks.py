"""Callbacks: SB3's own, plain ones that look or set the rate, and the learning-rate methods among them."""

import numpy as np
import pytest
import torch as th
from helpers.environments import Episode, ScriptedEnv, Step
from helpers.recording import Recorder
from stable_baselines3.common.callbacks import (
    BaseCallback,
    CallbackList,
    CheckpointCallback,
    EvalCallback,
    EveryNTimesteps,
    ProgressBarCallback,
    StopTrainingOnMaxEpisodes,
    StopTrainingOnRewardThreshold,
)
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import DummyVecEnv

from sb3_adaptive_q import (
    METHODS,
    ConstantRateCallback,
    EpisodeSeriesCallback,
    LearningRateCallback,
    SignRateCallback,
    TabularQ,
    method,
)

LAKE = "FrozenLake-v1"
SCRIPT = [
    Episode(0, [Step(8.0, 1), Step(0.0, 0), Step(-4.0, 2), Step(0.0, 3, "terminated")]),
    Episode(2, [Step(16.0, 0), Step(0.0, 1, "truncated")]),
]


def greedy_on_script(n_envs=1, **arguments):
    env = DummyVecEnv([lambda: ScriptedEnv(SCRIPT)] * n_envs)
    return TabularQ("MlpPolicy", env, exploration_initial_eps=0.0, exploration_final_eps=0.0, ties="first", **arguments)


def lake(env=LAKE, **arguments):
    """With an initial value above 0, which every update changes, rewarded or not."""
    return TabularQ("MlpPolicy", env, **{"seed": 0, "method": 7, "initial_q": 1.0, **arguments})


class StopAt(BaseCallback):
    """Answers no at one step."""

    def __init__(self, step, answer=False):
        super().__init__()
        self.step = step
        self.answer = answer

    def _on_step(self):
        return self.answer if self.n_calls == self.step else True


class Events(BaseCallback):
    """Writes the events down, and what was learned by then."""

    def __init__(self):
        super().__init__()
        self.events = []

    def note(self, name):
        self.events.append((name, self.num_timesteps, self.model._n_updates))

    def _on_training_start(self):
        self.note("training start")

    def _on_rollout_start(self):
        self.note("rollout start")

    def _on_step(self):
        self.note("step")
        return True

    def _on_rollout_end(self):
        self.note("rollout end")

    def _on_training_end(self):
        self.note("training end")


class TestEvents:
    def test_order(self):
        events = Events()
        greedy_on_script().learn(2, callback=events)
        assert [name for name, *_ in events.events] == [
            "training start",
            *["rollout start", "step", "rollout end"] * 2,
            "training end",
        ]

    def test_a_step_is_counted_and_not_yet_learned_from(self):
        events = Events()
        greedy_on_script(n_envs=2).learn(4, callback=events)
        assert [entry for entry in events.events if entry[0] == "step"] == [("step", 2, 0), ("step", 4, 2)]

    def test_locals_are_sb3s(self):
        class Looking(BaseCallback):
            def _on_training_start(self):
                assert self.locals["total_timesteps"] == 6
                assert self.locals["reset_num_timesteps"] is True
                assert self.locals["tb_log_name"] == "name"

            def _on_step(self):
                for name in ("actions", "new_obs", "rewards", "dones"):
                    assert self.locals[name].shape == (2,)
                assert len(self.locals["infos"]) == 2
                assert self.locals["self"] is self.model
                assert self.locals["dones"].dtype == bool
                assert self.training_env is self.model.get_env()
                return True

        greedy_on_script(n_envs=2).learn(6, callback=Looking(), tb_log_name="name")

    def test_functions_lists_and_nested_lists(self):
        calls = []

        def function(local_variables, global_variables):
            calls.append(local_variables["self"].num_timesteps)
            return True

        inner, outer = Recorder(), Recorder()
        greedy_on_script().learn(3, callback=function)
        assert calls == [1, 2, 3]
        greedy_on_script().learn(3, callback=CallbackList([CallbackList([inner]), outer]))
        greedy_on_script().learn(3, callback=[inner, outer])
        assert len(inner.actions) == len(outer.actions) == 3

    def test_every_n_timesteps(self):
        inner = Recorder()
        greedy_on_script().learn(12, callback=EveryNTimesteps(5, inner))
        assert inner.n_calls == 2


class TestStopping:
    @pytest.mark.parametrize("answer", [False, np.False_, th.tensor(False)], ids=["bool", "numpy", "torch"])
    @pytest.mark.parametrize("as_list", [False, True])
    def test_a_no_ends_the_training_before_the_update(self, answer, as_list):
        model, recorder = greedy_on_script(learning_rate=0.5), Recorder()
        stop = StopAt(3, answer)
        model.learn(100, callback=[stop, recorder] if as_list else stop)
        assert model.num_timesteps == 3
        assert model._n_updates == 2
        assert model.q_table[0].tolist() == [4.0, 0.0]  # the third step would have made it (4 - 4)/2

    @pytest.mark.parametrize("answer", [True, np.True_, th.tensor(True)], ids=["bool", "numpy", "torch"])
    def test_a_yes_goes_on(self, answer):
        assert greedy_on_script().learn(5, callback=StopAt(3, answer)).num_timesteps == 5

    def test_training_ends_properly_and_can_go_on(self):
        events = Events()
        model = greedy_on_script(learning_rate=0.5).learn(100, callback=[StopAt(3), events])
        assert events.events[-1][0] == "training end"
        model.learn(1, reset_num_timesteps=False)
        # The environment is in state 2 by then, and goes on to a terminal one
        assert model.num_timesteps == 4
        assert model._n_updates == 3
        assert model._episode_num == 1

    def test_the_first_action_afterwards_fits_the_state_that_was_reached(self):
        """Not the one that was chosen in the state before."""
        model, recorder = greedy_on_script(learning_rate=0.0), Recorder()
        model.q_table[:] = [[0, 1], [1, 0], [0, 1], [0, 1]]
        model.learn(100, callback=StopAt(1))
        model.learn(2, callback=recorder, reset_num_timesteps=False)
        assert [int(action[0]) for action in recorder.actions] == [0, 1]

    def test_an_episode_that_ends_with_the_stop_counts(self):
        model = TabularQ("MlpPolicy", ScriptedEnv(SCRIPT))
        model.learn(100, callback=StopAt(4))
        assert model._episode_num == 1
        assert [episode["r"] for episode in model.ep_info_buffer] == [4.0]

    @pytest.mark.parametrize("n_envs", [1, 2])
    def test_stop_after_episodes(self, n_envs):
        model = greedy_on_script(n_envs).learn(1000, callback=StopTrainingOnMaxEpisodes(3))
        assert model.num_timesteps == n_envs * (4 + 2 + 4)
        assert model._episode_num == n_envs * 3

    def test_stop_on_reward(self):
        stop = StopTrainingOnRewardThreshold(reward_threshold=-1.0)
        evaluation = EvalCallback(make_vec_env(LAKE), callback_on_new_best=stop, eval_freq=10, verbose=0, n_eval_episodes=1)
        assert lake().learn(1000, callback=evaluation).num_timesteps == 10

    def test_stop_in_the_first_step(self):
        model = greedy_on_script().learn(10, callback=StopAt(1))
        assert model.num_timesteps == 1
        assert not model.q_table.any()


class TestEvaluation:
    @pytest.mark.parametrize("deterministic", [True, False])
    @pytest.mark.parametrize("n_envs", [1, 2])
    def test_training_is_bit_for_bit_what_it_is_without(self, deterministic, n_envs):
        tables = []
        for evaluate in (False, True):
            callback = Recorder()
            evaluation = EvalCallback(
                make_vec_env(LAKE, seed=0), eval_freq=100, n_eval_episodes=3, deterministic=deterministic, verbose=0
            )
            model = lake(make_vec_env(LAKE, n_envs=n_envs))
            model.learn(2000, callback=[callback, evaluation] if evaluate else callback)
            tables.append((model.q_table, model.mu, np.array(callback.actions)))
        for without, with_evaluation in zip(*tables, strict=True):
            np.testing.assert_array_equal(without, with_evaluation)
        assert evaluation.n_calls == 2000 // n_envs
        assert np.isfinite(evaluation.last_mean_reward)

    def test_predictions_in_between_change_nothing_either(self):
        class Predicting(BaseCallback):
            def _on_step(self):
                self.model.predict(np.arange(16), deterministic=False)
                return True

        np.testing.assert_array_equal(lake().learn(800).q_table, lake().learn(800, callback=Predicting()).q_table)

    def test_evaluation_sees_the_live_table(self):
        """One episode is one step from state 0, with action 0 or 1, and the greedy one changes with the first update."""

        class TwoArms(ScriptedEnv):
            def step(self, action):
                state, _, terminated, truncated, info = super().step(action)
                return state, float(action), terminated, truncated, info

        def env():
            return TwoArms([Episode(0, [Step(0.0, 0, "terminated")])])

        evaluation = EvalCallback(DummyVecEnv([env]), eval_freq=1, n_eval_episodes=1, verbose=0, warn=False)
        rewards = []

        class Watching(BaseCallback):
            def _on_step(self):
                rewards.append(evaluation.last_mean_reward)
                return True

        model = TabularQ("MlpPolicy", DummyVecEnv([env]), learning_rate=1.0, exploration_initial_eps=0.0)
        model.exploration_final_eps = 0.0
        model.q_table[0] = [0.5, 0.25]
        model.learn(3, callback=[evaluation, Watching()])
        # The first update takes Q(0, 0) from 0.5 to the reward of 0, so that action 1 is the best from then on
        assert rewards == [0.0, 1.0, 1.0]


class TestCheckpoints:
    def test_they_hold_the_live_table(self, tmp_path):
        recorder = Recorder()
        checkpoint = CheckpointCallback(save_freq=200, save_path=str(tmp_path), name_prefix="lake")
        lake().learn(600, callback=[recorder, checkpoint])
        for step in (200, 400, 600):
            loaded = TabularQ.load(tmp_path / f"lake_{step}_steps.zip")
            # A callback comes before the update of its step
            np.testing.assert_array_equal(loaded.q_table, recorder.tables[step - 1])
            assert loaded.mu == recorder.rates[step - 1]
            assert loaded.num_timesteps == step
        assert np.any(recorder.tables[199] != recorder.tables[599])


class TestProgressBar:
    def test_it_counts_all_steps(self, monkeypatch):
        totals, updates = [], []
        on_start, on_step = ProgressBarCallback._on_training_start, ProgressBarCallback._on_step

        def start(self):
            on_start(self)
            totals.append(self.pbar.total)

        def step(self):
            before = self.pbar.n
            answer = on_step(self)
            updates.append(self.pbar.n - before)
            return answer

        monkeypatch.setattr(ProgressBarCallback, "_on_training_start", start)
        monkeypatch.setattr(ProgressBarCallback, "_on_step", step)
        model = greedy_on_script(n_envs=2)
        model.learn(10, progress_bar=True)
        model.learn(6, progress_bar=True, reset_num_timesteps=False)
        assert totals == [10, 6]
        assert updates == [2] * 8


class SetOnce(BaseCallback):
    """Sets μ at one step, or when training starts (step 0)."""

    def __init__(self, step, value):
        super().__init__()
        self.step = step
        self.value = value

    def _on_training_start(self):
        if self.step == 0:
            self.model.mu = self.value

    def _on_step(self):
        if self.n_calls == self.step:
            self.model.mu = self.value
        return True


class TestSettingTheRate:
    def test_it_is_the_rate_of_the_update_that_follows(self):
        model = greedy_on_script(learning_rate=0.5, gamma=0.0)
        model.learn(1, callback=SetOnce(1, 0.25))
        assert model.q_table[0, 0] == 0.25 * 8.0

    def test_without_a_method_it_holds_until_learning_ends(self):
        model, recorder = greedy_on_script(learning_rate=0.5), Recorder()
        model.learn(6, callback=[SetOnce(3, 0.25), recorder])
        assert recorder.rates == [0.5, 0.5, 0.25, 0.25, 0.25, 0.25, 0.25]
        model.learn(2, callback=recorder)
        assert recorder.rates == [0.5, 0.5, 0.5]

    def test_without_a_method_it_overrides_a_schedule(self):
        model, recorder = greedy_on_script(learning_rate=lambda left: left), Recorder()
        model.learn(4, callback=[SetOnce(2, 0.125), recorder])
        assert recorder.rates == [1.0, 0.125, 0.125, 0.125, 0.125]

    def test_a_method_computes_on_from_it(self):
        """Method 7: three steps of +0.005 or -0.005 from what was set."""
        model, recorder = greedy_on_script(method=7, method_kwargs={"upper": 1.0}), Recorder()
        model.learn(6, callback=[SetOnce(3, 0.5), recorder])
        assert recorder.rates[2] == 0.5
        assert np.abs(np.diff(recorder.rates[2:])) == pytest.approx([0.005] * 4)

    def test_a_method_of_its_own_rate_takes_it_back(self):
        model, recorder = greedy_on_script(method=1), Recorder()
        model.learn(4, callback=[SetOnce(2, 0.5), recorder])
        assert recorder.rates == [0.01, 0.5, 0.01, 0.01, 0.01]

    @pytest.mark.parametrize("order", [1, -1])
    def test_when_training_starts(self, order):
        """Without a method it holds; with one in force already, the method computes on."""
        recorder = Recorder()
        model = greedy_on_script(learning_rate=0.5)
        model.learn(3, callback=[SetOnce(0, 0.25), recorder][::order])
        assert recorder.rates == [0.25] * 4
        model = greedy_on_script(method=7, method_kwargs={"upper": 1.0})
        model.learn(3, callback=[SetOnce(0, 0.25), recorder][::order])
        assert recorder.rates[0] == 0.25
        assert recorder.rates[1] == pytest.approx(0.255)

    def test_a_schedule_of_a_user_by_callback(self):
        class Harmonic(BaseCallback):
            def _on_step(self):
                self.model.mu = 1.0 / self.n_calls
                return True

        recorder = Recorder()
        greedy_on_script().learn(4, callback=[Harmonic(), recorder])
        assert recorder.rates == [1.0, 1 / 2, 1 / 3, 1 / 4, 1 / 4]

    @pytest.mark.parametrize("value", [-0.1, 1.5, np.nan, np.inf])
    def test_a_rate_out_of_range_is_refused(self, value):
        model = greedy_on_script(learning_rate=0.5)
        with pytest.raises(ValueError, match=r"`mu` must be a number from 0 to 1, but got"):
            model.mu = value
        assert model.mu == 0.5


class TestMethodsAsCallbacks:
    @pytest.mark.parametrize("number", sorted(METHODS))
    @pytest.mark.parametrize("form", ["alone", "list", "CallbackList", "nested"])
    def test_constructor_and_callback_are_the_same(self, number, form):
        arrangement = {
            "alone": lambda callback: callback,
            "list": lambda callback: [Recorder(), callback],
            "CallbackList": lambda callback: CallbackList([callback, Recorder()]),
            "nested": lambda callback: [CallbackList([EveryNTimesteps(1000, callback)])],
        }[form]
        by_constructor = lake(method=number).learn(300)
        by_callback = lake(method=None).learn(300, callback=arrangement(method(number)))
        np.testing.assert_array_equal(by_callback.q_table, by_constructor.q_table)
        assert by_callback.mu == by_constructor.mu

    def test_next_to_an_evaluation(self):
        evaluation = EvalCallback(make_vec_env(LAKE), eval_freq=50, verbose=0)
        model = lake(method=None).learn(300, callback=[evaluation, method(7)])
        np.testing.assert_array_equal(model.q_table, lake(method=7).learn(300).q_table)

    @pytest.mark.parametrize(
        "callback",
        [
            [method(5), method(7)],
            CallbackList([method(1), CallbackList([method(1)])]),
            [method(3), EveryNTimesteps(10, method(4))],
            [method(2)] * 2,
        ],
        ids=["list", "nested", "within an event", "the same twice"],
    )
    def test_two_at_once_are_refused(self, callback):
        model = lake(method=None).learn(100)
        table, steps = model.q_table.copy(), model.num_timesteps
        with pytest.raises(ValueError, match=r"One learning-rate method.*but got.*Callback, .*Callback"):
            model.learn(100, callback=callback)
        np.testing.assert_array_equal(model.q_table, table)
        assert model.num_timesteps == steps

    def test_a_callback_replaces_the_constructors_method(self):
        model = lake(method=1).learn(10, callback=method(2))
        assert model.mu == 0.05

    def test_a_method_is_kept_for_later_calls(self):
        model, recorder = greedy_on_script(), Recorder()
        model.learn(5, callback=SignRateCallback(step=-0.001, mu_0=0.008))
        last = model.mu
        model.learn(3, callback=recorder, reset_num_timesteps=False)
        assert recorder.rates[0] == last
        assert np.abs(np.diff(recorder.rates)) == pytest.approx([0.001] * 3)
        model.learn(3, callback=recorder)
        assert recorder.rates[0] == 0.008

    def test_the_same_method_again_goes_on_and_another_one_starts(self):
        model, recorder = greedy_on_script(), Recorder()
        model.learn(5, callback=method(8))
        last = model.mu
        assert last != 0.01
        model.learn(2, callback=[method(8), recorder], reset_num_timesteps=False)
        assert recorder.rates[0] == last
        model.learn(2, callback=[method(8, mu_0=0.0075), recorder], reset_num_timesteps=False)
        assert recorder.rates[0] == 0.0075
        model.learn(2, callback=[method(8, mu_0=0.0075), recorder])
        assert recorder.rates[0] == 0.0075

    def test_one_callback_object_serves_two_models(self):
        callback = method(7)
        tables = [lake(method=None).learn(300, callback=callback).q_table for _ in range(2)]
        np.testing.assert_array_equal(*tables)

    def test_a_second_end_of_training_does_no_harm(self):
        """The RL Zoo ends the first callback twice."""
        callback = method(8)
        model = greedy_on_script().learn(5, callback=callback)
        table, rate = model.q_table.copy(), model.mu
        callback.on_training_end()
        assert model.mu == rate
        np.testing.assert_array_equal(model.q_table, table)

    def test_callbacks_take_the_names_that_a_yaml_file_would_give(self):
        """The RL Zoo builds callbacks from keyword arguments, without model or environment."""
        callback = ConstantRateCallback(**{"beta": 0.25})
        assert greedy_on_script().learn(1, callback=callback).mu == 0.25

    def test_reset_each_episode_needs_one_environment(self):
        model = greedy_on_script(n_envs=2)
        with pytest.raises(ValueError, match=r"reset_each_episode.*single environment.*2"):
            model.learn(10, callback=method(7, reset_each_episode=True))
        assert not model.q_table.any()

    def test_no_rule_is_asked_where_an_episode_resets_mu(self):
        """It may divide by the next value, which is 0 at the end of an episode."""
        asked = []

        class Asked(LearningRateCallback):
            @staticmethod
            def rule(mu, step):
                asked.append(step.next_value)
                return 0.25

        model, series = TabularQ("MlpPolicy", "FrozenLake-v1", seed=0), EpisodeSeriesCallback()
        with pytest.warns(UserWarning, match="runs as Python"):
            model.learn(300, callback=[Asked(mu_0=0.5, reset_each_episode=True), series])
        assert len(series.returns) > 10 and len(asked) == 300 - len(series.returns)


def halve(mu, transition, least):
    return max(mu / 2.0, least)


class Halving(LearningRateCallback):
    """A user's rule: half of the rate with every update."""

    rule = staticmethod(halve)


class FromError(LearningRateCallback):
    """A user's rule that looks at everything."""

    @staticmethod
    def rule(mu, transition):
        return min(
            abs(transition.td_error) / 100 + transition.progress / 100 + transition.value * 0 + transition.next_value * 0, 1.0
        )


class TestRulesOfAUser:
    def test_a_short_subclass_is_enough(self):
        recorder = Recorder()
        greedy_on_script().learn(5, callback=[Halving(mu_0=1.0, least=0.125), recorder])
        assert recorder.rates == [1.0, 0.5, 0.25, 0.125, 0.125, 0.125]

    def test_the_transition_it_is_shown(self):
        """μ_0 asks the rule itself; the errors are 8, then γ max Q(0, ·) = 0 as the rate was 0, and so on."""
        recorder = Recorder()
        greedy_on_script(gamma=0.5).learn(4, callback=[FromError(), recorder])
        # Error 8 with rate 0; 0 with 0.0825, so that Q stays 0; -4 with 0.005: Q(0, 0) = -0.02; 0 from state 2
        assert recorder.rates == pytest.approx([0.0, 0.0825, 0.005, 0.0475, 0.01])
        assert recorder.tables[3][0, 0] == pytest.approx(-0.02)

    def test_it_is_kept_and_goes_on(self):
        model = greedy_on_script().learn(2, callback=Halving(mu_0=1.0, least=0.0))
        assert model.learn(1, reset_num_timesteps=False).mu == 0.125

    @pytest.mark.parametrize("parameters", [{}, {"most": 1.0}, {"least": 0.0, "most": 1.0}])
    def test_parameters_must_be_the_rules(self, parameters):
        came = rf"the parameters are \({', '.join(parameters)}\)"
        with pytest.raises(ValueError, match=rf"`rule` of .*Halving takes \(least\) after `mu` and `step`.*{came}.*agree"):
            Halving(mu_0=1.0, **parameters)

    def test_only_one_of_them(self):
        with pytest.raises(ValueError, match="but got Halving, SignRateCallback"):
            greedy_on_script().learn(10, callback=[Halving(mu_0=1.0, least=0.0), method(7)])


class TestInterruption:
    """What an error in the middle of a step leaves behind: the environment has moved, the agent has not learned."""

    def test_learning_goes_on_with_a_reset(self):
        class Interrupt(BaseCallback):
            def _on_step(self):
                if self.n_calls == 3:
                    raise KeyboardInterrupt
                return True

        model = TabularQ("MlpPolicy", "CliffWalkingLimited-v1", seed=0, initial_q=-1000.0, learning_rate=1.0, gamma=0.0)
        with pytest.raises(KeyboardInterrupt):
            model.learn(10, callback=Interrupt())
        seen = []

        class Record(BaseCallback):
            def _on_step(self):
                seen.append(int(self.locals["actions"][0]))
                return True

        before = model.q_table.copy()
        model.learn(1, callback=Record(), reset_num_timesteps=False)
        changed = np.argwhere(model.q_table != before)
        assert [tuple(entry) for entry in changed.tolist()] in ([], [(36, seen[0])])  # 36 is where every episode begins
        assert model.env.envs[0].unwrapped.lastaction == seen[0]
