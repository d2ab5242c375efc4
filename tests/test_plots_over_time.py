"""Learning curves, films, frames and pictures in TensorBoard: read back from what was drawn or written."""

from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import matplotlib as mpl
import numpy as np
import pytest

mpl.use("Agg")

import matplotlib.pyplot as plt
from PIL import Image
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import DummyVecEnv
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from helpers.both_paths import make_model
from sb3_adaptive_q import DoubleQ, EpisodeSeriesCallback, TableImageCallback, TabularQ
from sb3_adaptive_q.plots import animate, plot_learning_curves, to_frame


@pytest.fixture(autouse=True)
def close_figures():
    yield
    plt.close("all")


def curve(ax: Any, i: int = 0) -> tuple[list[float], list[float]]:
    return ax.lines[i].get_xdata().tolist(), ax.lines[i].get_ydata().tolist()


class TestCurves:
    def test_means_over_episodes_and_runs(self):
        """By hand: means of two successive returns are 1, 2, 3 and 2, 1; the shorter run ends after three episodes."""
        x, y = curve(plot_learning_curves({"a": [[0, 2, 2, 4], [2, 2, 0]]}, window=2))
        assert x == [2, 3] and y == [1.5, 1.5]

    def test_against_timesteps(self):
        """Episodes end after steps 2, 4, 8 and 4, 5, 8. From step 4 on, both have one or more; the last counts."""
        runs = [
            SimpleNamespace(returns=np.array([1.0, 2.0, 3.0]), lengths=np.array([2, 2, 4])),
            SimpleNamespace(returns=np.array([5.0, 6.0, 7.0]), lengths=np.array([4, 1, 3])),
        ]
        x, y = curve(plot_learning_curves({"a": runs}, window=1, against="timesteps"))
        assert x == [4, 5, 6, 7, 8] and y == [3.5, 4.0, 4.0, 4.0, 5.0]

    def test_interquartile_mean(self):
        """Of 0, 1, 2, 3, 4, 5, 6, 100 the middle half is 2, 3, 4, 5."""
        _, y = curve(plot_learning_curves({"a": [[value] for value in (0, 1, 2, 3, 4, 5, 6, 100)]}, window=1, center="iqm"))
        assert y == [3.5]

    def test_the_band_is_a_bootstrap_interval(self):
        """Of runs that are 0 or 1, half each, the mean of n has the standard error 0.5 / sqrt(n), 0.05 for 100 runs."""
        ax = plot_learning_curves({"a": [[value] * 3 for value in [0.0, 1.0] * 50]}, window=1)
        low, high = ax.collections[0].get_paths()[0].get_extents().intervaly
        assert low == pytest.approx(0.5 - 1.96 * 0.05, abs=0.02) and high == pytest.approx(0.5 + 1.96 * 0.05, abs=0.02)
        assert ax.get_title(loc="left") == "mean of 100 runs, shaded: 95 % bootstrap interval"
        narrow = plot_learning_curves({"a": [[value] * 3 for value in [0.0, 1.0] * 50]}, window=1, confidence=0.5)
        low, high = narrow.collections[0].get_paths()[0].get_extents().intervaly
        assert low == pytest.approx(0.5 - 0.674 * 0.05, abs=0.02) and high == pytest.approx(0.5 + 0.674 * 0.05, abs=0.02)

    def test_one_run_has_no_band(self):
        ax = plot_learning_curves({"a": [np.arange(9.0)]}, window=3)
        assert not ax.collections and ax.get_title(loc="left") == "one run"
        assert ax.get_ylabel() == "return (mean of the last 3 episodes)" and ax.get_xlabel() == "episode"

    def test_lines_can_be_told_apart_without_colour(self):
        ax = plot_learning_curves({str(i): [[0.0, 1.0]] for i in range(5)}, window=1)
        styles = [(line.get_linestyle(), line._unscaled_dash_pattern) for line in ax.lines]
        assert len({str(style) for style in styles}) == 5

    def test_a_model_and_a_callback_give_the_same_curve(self):
        episodes = EpisodeSeriesCallback()
        model = make_model("slippery lake", False).learn(3000, callback=episodes)
        ax = plot_learning_curves({"model": [model], "callback": [episodes], "returns": [episodes.returns]}, window=20)
        assert curve(ax, 0) == curve(ax, 1) == curve(ax, 2)

    @pytest.mark.parametrize(
        "runs, arguments, message",
        [
            ({}, {}, "a dict from labels to lists of runs, but got {}"),
            ([[1.0]], {}, "a dict from labels to lists of runs"),
            ({"a": []}, {"window": 1}, "no runs of 'a'"),
            ({"a": [[1.0, 2.0]]}, {"window": 3}, "'a' has 2 episodes, too few for a mean over `window`=3"),
            ({"a": [[1.0]]}, {"window": 0}, "at least 1 episode, but got 0"),
            ({"a": [[1.0]]}, {"window": 1.5}, "at least 1 episode, but got 1.5"),
            ({"a": EpisodeSeriesCallback()}, {}, "must have a list of runs for 'a', .* please put it into a list"),
            ({"a": [[1.0]]}, {"window": 1, "against": "hours"}, '"episodes" or "timesteps", but got \'hours\''),
            ({"a": [[1.0]]}, {"window": 1, "against": "timesteps"}, "needs the lengths of the episodes"),
            ({"a": [[1.0]]}, {"window": 1, "center": "median"}, '"mean" or "iqm"'),
            ({"a": [[1.0]]}, {"window": 1, "confidence": 1.0}, "between 0 and 1, but got 1.0"),
            ({"a": ["lake"]}, {}, "of 'a' must be an EpisodeSeriesCallback"),
            ({"a": [[[1.0]]]}, {}, "of 'a' must be an EpisodeSeriesCallback"),
        ],
    )
    def test_bad_input(self, runs, arguments, message):
        with pytest.raises(ValueError, match=message):
            plot_learning_curves(runs, **arguments)

    def test_a_model_on_a_compiled_environment_has_no_episodes(self):
        with pytest.raises(ValueError, match="hand an EpisodeSeriesCallback to `learn`"):
            plot_learning_curves({"a": [make_model("slippery lake", True).learn(1000)]})


class TestFilm:
    @pytest.fixture
    def guide(self):
        """A model whose table leads over the firm lake in the fewest steps: down, down, right, down, right, right."""
        model = TabularQ("MlpPolicy", gym.make("FrozenLake-v1", is_slippery=False))
        for state, action in ((0, 1), (4, 1), (8, 2), (9, 1), (13, 2), (14, 2)):
            model.q_table[state, action] = 1.0
        return model

    @pytest.mark.parametrize("render_mode", ["rgb_array", None])
    def test_a_picture_for_the_start_and_for_every_step(self, guide, render_mode, tmp_path):
        env = gym.make("FrozenLake-v1", is_slippery=False, render_mode=render_mode)
        path = animate(guide, env, tmp_path / "lake.gif", frames_per_second=5)
        with Image.open(path) as film:
            assert film.n_frames == 7
            durations = []
            for i in range(7):
                film.seek(i)
                durations.append(film.info["duration"])
        assert durations == [200] * 6 + [1700]

    def test_an_episode_is_cut_off(self, guide, tmp_path):
        env = gym.make("FrozenLake-v1", is_slippery=False)
        with Image.open(animate(guide, env, tmp_path / "lake.gif", max_steps=2)) as film:
            assert film.n_frames == 3

    def test_the_taxi_takes_its_passenger_along_on_the_map(self, tmp_path):
        model = make_model("Taxi", True, learning_rate=0.5).learn(1_000_000)
        for env in (gym.make("Taxi-v4"), "Taxi-v4"):
            with Image.open(animate(model, env, tmp_path / "taxi.gif", seed=1)) as film:
                assert 2 < film.n_frames <= 20

    def test_bad_input(self, guide, tmp_path):
        with pytest.raises(ValueError, match=r"must end in \.gif"):
            animate(guide, "FrozenLake-v1", tmp_path / "lake.mp4")
        with pytest.raises(ValueError, match="a single environment"):
            animate(guide, make_vec_env("FrozenLake-v1"), tmp_path / "lake.gif")
        with pytest.raises(ValueError, match=r"`max_steps` must be at least 1, .* but got 0 and 4"):
            animate(guide, "FrozenLake-v1", tmp_path / "lake.gif", max_steps=0)
        with pytest.raises(ValueError, match=r"`frames_per_second` from 0.01 to 100, but got 200 and 0.001"):
            animate(guide, "FrozenLake-v1", tmp_path / "lake.gif", frames_per_second=0.001)
        with pytest.raises(ValueError, match="`path` must lie in a folder that exists"):
            animate(guide, "FrozenLake-v1", tmp_path / "none" / "lake.gif")
        with pytest.raises(
            ValueError, match=r"spaces of the model, Discrete\(16\) .* but has Discrete\(64\) .* wrap it as for"
        ):
            animate(guide, "FrozenLake8x8-v1", tmp_path / "lake.gif")
        with pytest.raises(ValueError, match="TableEnv has no map: please make it with render_mode='rgb_array'"):
            animate(np.zeros((30, 4)), "Garnet-v0", tmp_path / "lake.gif")

    def test_pygame_is_asked_for(self, guide, tmp_path, monkeypatch):
        import sys

        monkeypatch.setitem(sys.modules, "pygame", None)
        with pytest.raises(ModuleNotFoundError, match=r"pygame is missing.*gymnasium\[classic-control,toy-text\]"):
            animate(guide, "FrozenLake-v1", tmp_path / "lake.gif")


class TestFrame:
    def test_it_holds_the_table(self):
        model = make_model("slippery lake", True).learn(5000)
        frame = to_frame(model)
        assert frame["state"].tolist() == list(range(16))
        np.testing.assert_array_equal(frame[["q_0", "q_1", "q_2", "q_3"]], model.q_table)
        np.testing.assert_array_equal(frame["greedy_action"], model.q_table.argmax(axis=1))
        np.testing.assert_array_equal(frame["value"], model.q_table.max(axis=1))
        assert frame.equals(model.to_frame())

    def test_it_holds_the_memory_and_the_cells(self):
        frame = to_frame(make_model("CartPole", True, method="harmonic").learn(5000))
        assert len(frame) == 14_641
        assert frame.loc[1742, ["cell_0", "cell_1", "cell_2", "cell_3"]].tolist() == [1, 3, 4, 4]
        assert frame[["visits_0", "visits_1"]].to_numpy().sum() == 5000

    @pytest.mark.parametrize("scope, columns", [("state", ["visits"]), ("shared", ["visits"])])
    def test_memory_of_other_scopes(self, scope, columns):
        model = make_model("slippery lake", True, method="harmonic", method_kwargs={"scope": scope}).learn(1000)
        frame = to_frame(model)
        assert [name for name in frame if name.startswith("visits")] == columns
        assert frame["visits"].sum() == (1000 if scope == "state" else 16 * 1000)

    def test_memory_of_several_tables(self):
        frame = to_frame(DoubleQ("MlpPolicy", "FrozenLake-v1", method="harmonic", seed=0).learn(1000))
        names = [f"visits_table_{table}_{action}" for table in range(2) for action in range(4)]
        assert frame[names].to_numpy().sum() == 1000

    def test_numbers_are_those_of_the_environment(self):
        class Env(gym.Env):
            observation_space = gym.spaces.MultiDiscrete([2, 3], start=[1, 10])
            action_space = gym.spaces.Discrete(2, start=5)

        model = TabularQ("MlpPolicy", DummyVecEnv([Env]))
        model.q_table[4, 1] = 1.0
        frame = to_frame(model)
        assert frame.loc[4, ["observation_0", "observation_1"]].tolist() == [2, 11]
        assert frame.loc[4, ["q_5", "q_6", "greedy_action", "value"]].tolist() == [0.0, 1.0, 6.0, 1.0]


def read_events(model: TabularQ) -> EventAccumulator:
    events = EventAccumulator(model.logger.get_dir(), size_guidance={"images": 0, "histograms": 0})
    events.Reload()
    return events


class TestTensorBoard:
    def test_both_paths_draw_the_same_at_the_same_steps(self, tmp_path):
        drawn = []
        for compiled in (True, False):
            model = make_model("slippery lake", compiled, n_envs=2, tensorboard_log=str(tmp_path / str(compiled)))
            model.learn(5000, callback=TableImageCallback(every=2000, what=("value", "q")))
            drawn.append(read_events(model))
        for tag in ("table/value", "table/q"):
            assert [event.step for event in drawn[0].Images(tag)] == [0, 2000, 4000, 5000]
            pictures = [[event.encoded_image_string for event in events.Images(tag)] for events in drawn]
            assert pictures[0] == pictures[1] and len(set(pictures[0])) == 4
        histograms = [events.Histograms("table/q_distribution") for events in drawn]
        for one, other in zip(*histograms, strict=True):
            assert one.step == other.step and one.histogram_value == other.histogram_value
        last = histograms[0][-1].histogram_value
        assert last.num == 64 and last.max == model.q_table.max() and last.sum == pytest.approx(model.q_table.sum())

    def test_further_training_goes_on_at_the_multiples(self, tmp_path):
        model = make_model("slippery lake", True, method="polynomial", tensorboard_log=str(tmp_path))
        callback = TableImageCallback(every=1000, what=("memory:visits",), histogram=False)
        model.learn(1500, callback=callback)
        model.learn(1500, callback=callback, reset_num_timesteps=False)
        events = read_events(model)
        assert {event.step for event in events.Images("table/visits")} == {0, 1000, 1500, 2000, 3000}
        assert not events.Tags()["histograms"]
        model.learn(1000, callback=callback)  # counts from the start again
        assert [event.step for event in read_events(model).Images("table/visits")] == [0, 1000]

    def test_learning_is_the_same_with_it(self, tmp_path):
        plain = make_model("slippery lake", True).learn(3000)
        watched = make_model("slippery lake", True, tensorboard_log=str(tmp_path))
        watched.learn(3000, callback=TableImageCallback(every=700))
        np.testing.assert_array_equal(plain.q_table, watched.q_table)

    def test_bad_input(self, tmp_path):
        with pytest.raises(ValueError, match="`every` must be a whole number of at least 1, but got 0"):
            TableImageCallback(every=0)
        with pytest.raises(ValueError, match=r"must be a tuple, such as \('q',\), but got 'q'"):
            TableImageCallback(what="q")
        with pytest.raises(ValueError, match="give the model a folder as `tensorboard_log`"):
            make_model("slippery lake", True).learn(100, callback=TableImageCallback())
        with pytest.raises(ValueError, match="for this model, but got 'heights'"):
            model = make_model("slippery lake", True, tensorboard_log=str(tmp_path))
            model.learn(100, callback=TableImageCallback(what=("heights",)))
