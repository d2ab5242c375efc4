"""Pictures and frames say what the table says: read back from what was drawn."""

import gymnasium as gym
import matplotlib as mpl
import numpy as np
import pytest

mpl.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.quiver import Quiver

from helpers.both_paths import make_model
from sb3_adaptive_q import EpisodeSeriesCallback, TabularQ, TableImageCallback
from sb3_adaptive_q.plots import animate, plot_learning_curves, plot_policy, to_frame

#: Left, down, right and up of Frozen Lake, as directions of an arrow on a map whose rows go down
DIRECTIONS = {0: (-1, 0), 1: (0, 1), 2: (1, 0), 3: (0, -1)}
HOLES_AND_GOAL = (5, 7, 11, 12, 15)


@pytest.fixture(autouse=True)
def close_figures():
    yield
    plt.close("all")


@pytest.fixture(scope="module")
def lake():
    return make_model("slippery lake", True, method="autostep").learn(100_000)


class TestMap:
    def test_arrows_point_where_the_greedy_action_does(self, lake):
        ax = plot_policy(lake)
        arrows = [artist for artist in ax.collections if isinstance(artist, Quiver)]
        assert len(arrows) == 1
        seen = set()
        for x, y, u, v in zip(arrows[0].X, arrows[0].Y, arrows[0].U, arrows[0].V, strict=True):
            state = 4 * round(y) + round(x)
            seen.add(state)
            assert (np.sign(u), np.sign(v)) == DIRECTIONS[int(lake.q_table[state].argmax())]
        assert seen == set(range(16)) - set(HOLES_AND_GOAL)

    def test_numbers_are_the_values_and_terminal_cells_have_letters(self, lake):
        texts = [text.get_text() for text in plot_policy(lake).texts]
        for state in set(range(16)) - set(HOLES_AND_GOAL):
            assert f"{lake.q_table[state].max():.2f}" in texts
        assert texts.count("H") == 4 and texts.count("G") == 1

    def test_fonts_are_those_that_journals_take(self, lake, tmp_path):
        plot_policy(lake).figure.savefig(tmp_path / "policy.pdf")
        contents = (tmp_path / "policy.pdf").read_bytes()
        assert b"/FontFile2" in contents and b"/Type3" not in contents

    @pytest.mark.parametrize("env_id", ["Taxi-v4", "CliffWalking-v1"])
    def test_other_maps(self, env_id):
        assert plot_policy(TabularQ("MlpPolicy", env_id, seed=0).learn(2000)).texts

    def test_an_unknown_quantity_is_refused(self, lake):
        with pytest.raises(ValueError, match="what"):
            plot_policy(lake, what="heights")


class TestFrame:
    def test_it_holds_the_table(self, lake):
        frame = to_frame(lake)
        np.testing.assert_array_equal(frame[["q_0", "q_1", "q_2", "q_3"]], lake.q_table)
        np.testing.assert_array_equal(frame["greedy_action"], lake.q_table.argmax(axis=1))
        np.testing.assert_array_equal(frame["value"], lake.q_table.max(axis=1))
        assert frame.equals(lake.to_frame())

    def test_it_holds_the_memory_and_the_cells(self):
        frame = to_frame(make_model("CartPole", True, method="harmonic").learn(5000))
        assert len(frame) == 14_641
        assert frame.loc[1742, ["cell_0", "cell_1", "cell_2", "cell_3"]].tolist() == [1, 3, 4, 4]
        visits = frame[[name for name in frame if name.startswith("visits")]]
        assert visits.to_numpy().sum() == 5000


class TestCurvesAndFilms:
    def test_curves_of_several_runs(self):
        runs = []
        for seed in range(3):
            series = EpisodeSeriesCallback()
            make_model("slippery lake", True, method=2, seed=seed).learn(20_000, callback=series)
            runs.append(series)
        ax = plot_learning_curves({"Method 2": runs})
        curve = ax.lines[0].get_ydata()
        assert 0.0 <= np.nanmin(curve) and np.nanmax(curve) <= 1.0
        assert ax.collections  # the band

    def test_a_film_of_an_episode(self, lake, tmp_path):
        animate(lake, gym.make("FrozenLake-v1", render_mode="rgb_array", max_episode_steps=5), tmp_path / "lake.gif", seed=1)
        assert (tmp_path / "lake.gif").read_bytes()[:4] == b"GIF8"


def test_pictures_in_tensorboard(tmp_path):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    model = make_model("slippery lake", True, tensorboard_log=str(tmp_path))
    model.learn(30_000, callback=TableImageCallback(every=10_000))
    events = EventAccumulator(model.logger.get_dir())
    events.Reload()
    assert [event.step for event in events.Images("table/value")] == [0, 10_000, 20_000, 30_000]
    assert events.Tags()["histograms"]
    with pytest.raises(ValueError, match="tensorboard_log"):
        make_model("slippery lake", True).learn(100, callback=TableImageCallback(every=10))
