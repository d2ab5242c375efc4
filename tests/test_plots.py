"""Pictures of tables say what the table says: read back from what was drawn."""

import sys
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import matplotlib as mpl
import numpy as np
import pytest
from hypothesis import given, strategies as st

mpl.use("Agg")

import matplotlib.pyplot as plt
from matplotlib.collections import PolyCollection, QuadMesh
from matplotlib.quiver import Quiver

from helpers.both_paths import CELLS, make_model
from sb3_adaptive_q import DoubleQ, TabularQ
from sb3_adaptive_q.plots import plot_policy
from sb3_adaptive_q.plots.grid_maps import find_map
from sb3_adaptive_q.plots.numbers import number_texts
from sb3_adaptive_q.plots.style import INK, SEQUENTIAL
from wrappers import DiscretizeObservation


@pytest.fixture(autouse=True)
def close_figures():
    yield
    plt.close("all")


def find(ax: Any, kind: type) -> Any:
    """The only artist of a kind among the collections of an axis."""
    found = [artist for artist in ax.collections if isinstance(artist, kind)]
    assert len(found) == 1
    return found[0]


def arrows(ax: Any) -> dict[tuple[int, int], tuple[int, int]]:
    """(row change, column change) of each arrow, by the (row, column) of its cell."""
    quiver = find(ax, Quiver)
    columns = zip(quiver.X, quiver.Y, quiver.U, quiver.V, strict=True)
    return {(round(y), round(x)): (int(np.sign(v)), int(np.sign(u))) for x, y, u, v in columns}


def texts(ax: Any) -> dict[tuple[int, int], list[str]]:
    """What is written into each cell, by its (row, column)."""
    written: dict[tuple[int, int], list[str]] = {}
    for text in ax.texts:
        x, y = text.get_position()
        written.setdefault((round(y), round(x)), []).append(text.get_text())
    return written


def numbers(ax: Any) -> dict[tuple[int, int], float]:
    """The number in each cell that has one."""
    found = {}
    for cell, words in texts(ax).items():
        for word in words:
            try:
                found[cell] = float(word.replace("−", "-"))
            except ValueError:
                continue
    return found


def shapes(ax: Any, name: str) -> set[tuple[int, int]]:
    """The cells with a shape of that name, by (row, column)."""
    centers = [patch.get_path().transformed(patch.get_patch_transform()).get_extents() for patch in ax.patches
               if patch.get_gid() == name]  # fmt: skip
    return {(round((box.y0 + box.y1) / 2), round((box.x0 + box.x1) / 2)) for box in centers}


def random_table(n_states: int, n_actions: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(n_states, n_actions))


class TestArrows:
    """Where they point, checked with the transitions of gymnasium's own tables."""

    @pytest.mark.parametrize(
        "env_id, arguments, shape",
        [
            ("FrozenLake-v1", {"is_slippery": False}, (4, 4)),
            ("FrozenLake8x8-v1", {"is_slippery": False}, (8, 8)),
            ("CliffWalking-v1", {}, (4, 12)),
        ],
    )
    def test_they_point_where_the_greedy_action_leads(self, env_id, arguments, shape):
        env = gym.make(env_id, **arguments)
        table = random_table(np.prod(shape), 4)
        seen = 0
        for (row, column), (down, right) in arrows(plot_policy(table, env)).items():
            state = row * shape[1] + column
            ((_, next_state, reward, _),) = env.unwrapped.P[state][int(table[state].argmax())]
            at_the_edge = next_state == state
            if not at_the_edge and reward != -100:  # who falls off the cliff is taken to the start
                assert (row + down, column + right) == divmod(int(next_state), shape[1])
                seen += 1
        assert seen > 4

    @pytest.mark.parametrize("passenger, destination", [("R", "G"), ("taxi", "B"), ("B", "Y")])
    def test_taxi(self, passenger, destination):
        env = gym.make("Taxi-v4")
        table = random_table(500, 6)
        ax = plot_policy(table, env, passenger=passenger, destination=destination)
        places = {"R": 0, "G": 1, "Y": 2, "B": 3, "taxi": 4}
        drawn = arrows(ax)
        assert 10 < len(drawn) < 25
        words = texts(ax)
        for row, column in np.ndindex(5, 5):
            state = env.unwrapped.encode(row, column, places[passenger], places[destination])
            action = int(table[state].argmax())
            ((_, next_state, _, _),) = env.unwrapped.P[state][action]
            next_row, next_column, *_ = env.unwrapped.decode(next_state)
            if action >= 4:
                assert ("pick\nup", "drop\noff")[action - 4] in words[row, column] and (row, column) not in drawn
            elif next_state != state:
                assert (row + drawn[row, column][0], column + drawn[row, column][1]) == (next_row, next_column)

    def test_taxis_walls_are_where_no_move_leads_through(self):
        env = gym.make("Taxi-v4")
        ax = plot_policy(random_table(500, 6), env)
        fences = {(line.get_xdata()[0], round(np.mean(line.get_ydata()))) for line in ax.lines}
        for row, column in np.ndindex(5, 4):
            state = env.unwrapped.encode(row, column, 0, 1)
            is_blocked = env.unwrapped.P[state][2][0][1] == state  # east
            assert ((column + 0.5, row) in fences) == is_blocked

    def test_a_state_without_a_best_action_gets_a_dot_and_no_colour(self):
        table = random_table(16, 4)
        table[6] = 0.25
        ax = plot_policy(table, "FrozenLake-v1")
        assert (1, 2) not in arrows(ax)
        assert texts(ax)[1, 2] == ["0.25", "·"]
        assert "all actions are equal" in ax.get_xlabel()
        colored = ~np.ma.getmaskarray(find(ax, QuadMesh).get_array().reshape(4, 4))
        assert not colored[1, 2] and colored.sum() == 10


class TestCells:
    def test_numbers_are_the_values(self):
        table = random_table(16, 4)
        drawn = numbers(plot_policy(table, "FrozenLake-v1"))
        assert set(drawn) == {divmod(state, 4) for state in set(range(16)) - {5, 7, 11, 12, 15}}
        for (row, column), number in drawn.items():
            assert number == pytest.approx(table[4 * row + column].max(), abs=0.005)

    def test_terminal_cells_have_letters_and_shapes_of_their_own(self):
        ax = plot_policy(random_table(16, 4), "FrozenLake-v1")
        holes = {(1, 1), (1, 3), (2, 3), (3, 0)}  # gymnasium's map: SFFF FHFH FFFH HFFG
        assert shapes(ax, "hole") == holes and shapes(ax, "goal") == {(3, 3)}
        words = texts(ax)
        assert {cell for cell, letters in words.items() if "H" in letters} == holes
        assert words[3, 3] == ["G"] and "S" in words[0, 0]
        assert ax.get_xlabel().split("    ") == ["S start", "G goal", "H hole"]

    def test_the_cliff(self):
        ax = plot_policy(random_table(48, 4), "CliffWalking-v1")
        assert shapes(ax, "cliff") == {(3, column) for column in range(1, 11)}
        assert shapes(ax, "goal") == {(3, 11)}
        assert all(patch.get_hatch() for patch in ax.patches if patch.get_gid() == "cliff")

    def test_the_numbers_of_all_actions(self):
        env = gym.make("FrozenLake-v1", is_slippery=False)
        table = random_table(16, 4)
        ax = plot_policy(table, env, what="q")
        assert len(find(ax, PolyCollection).get_paths()) == 4 * 11
        for text in ax.texts:
            x, y = text.get_position()
            state, offset = 4 * round(y) + round(x), np.array([y - round(y), x - round(x)])
            if text.get_text() in "SHG":
                continue
            # The action that leads the way in which the number is shifted
            moves = {0: (0, -1), 1: (1, 0), 2: (0, 1), 3: (-1, 0)}
            (action,) = [each for each, move in moves.items() if np.dot(move, offset) > 0.1]
            assert float(text.get_text().replace("−", "-")) == pytest.approx(table[state, action], abs=0.005)
            assert (text.get_weight() == "bold") == (action == table[state].argmax())

    def test_colours_are_in_the_order_of_the_values(self):
        table = random_table(16, 4)
        mesh = find(plot_policy(table, "FrozenLake-v1"), QuadMesh)
        drawn = mesh.get_array().compressed()
        assert np.array_equal(drawn, np.delete(table.max(axis=1), [5, 7, 11, 12, 15]))
        shared = find(plot_policy(table, "FrozenLake-v1", limits=(-1.0, 4.0)), QuadMesh)
        assert (shared.norm.vmin, shared.norm.vmax) == (-1.0, 4.0)


class TestOwnMap:
    class Maze(gym.Env):
        """Two rows, three columns, a wall in the middle of the first row; nothing else about it matters here."""

        grid_shape = (2, 3)
        walls = ((0, 1),)
        moves = ((-1, 0), (0, 1), (1, 1))
        observation_space = gym.spaces.Discrete(6)
        action_space = gym.spaces.Discrete(3)

    def test_walls_and_moves_are_read_from_it(self):
        table = np.zeros((6, 3))
        table[[0, 3, 4], [1, 0, 2]] = 1.0
        ax = plot_policy(table, self.Maze())
        assert shapes(ax, "wall") == {(0, 1)}
        assert arrows(ax) == {(0, 0): (0, 1), (1, 0): (-1, 0), (1, 1): (1, 1)}

    def test_a_description_in_letters(self):
        env = self.Maze()
        env.desc = ["S#.", "..G"]
        ax = plot_policy(random_table(6, 3), env)
        assert shapes(ax, "wall") == {(0, 1)} and shapes(ax, "goal") == {(1, 2)}
        assert ax.get_xlabel() == "S start    G goal"

    def test_terminal_states_of_a_transition_table_are_marked(self):
        env = self.Maze()
        env.P = {state: {action: [(1.0, (state + 1) % 6, 0.0, state == 4)] for action in range(3)} for state in range(6)}
        env.initial_state_distrib = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
        ax = plot_policy(random_table(6, 3), env)
        assert shapes(ax, "terminal") == {(1, 2)}  # state 5
        assert ax.get_xlabel() == "S start    T end of the episode" and "S" in texts(ax)[0, 2]

    @pytest.mark.parametrize("env_id", ["WindyGrid-v0", "WindyKing-v0", "DynaMaze-v0", "HasseltGrid-v0", "MovingGoal-v0"])
    def test_the_packages_own_grids(self, env_id):
        """The map against the transition table: who enters a wall, where episodes end, where moves lead without wind."""
        env = gym.make(env_id)
        n_states, n_actions = env.observation_space.n, env.action_space.n
        ax = plot_policy(random_table(n_states, n_actions), env)
        grid = find_map(env, n_states)
        table = env.unwrapped.table_at(0)[0] if env_id == "MovingGoal-v0" else env.unwrapped.P
        outcomes = [(state, action, *outcome) for state in range(n_states) for action in range(n_actions)
                    for outcome in table[state][action]]  # fmt: skip
        walls = [row * grid.letters.shape[1] + column for row, column in shapes(ax, "wall")]
        assert not any(next_state in walls and state not in walls for state, _, _, next_state, _, _ in outcomes)
        assert len(walls) == (7 if env_id == "DynaMaze-v0" else 0)  # Sutton and Barto (2018), figure 8.2
        goals = {next_state for _, _, _, next_state, _, terminated in outcomes if terminated}
        assert {grid.cell_of(state) for state in goals} == shapes(ax, "goal")
        if env_id in ("DynaMaze-v0", "HasseltGrid-v0"):
            moves = {
                (action, *np.subtract(grid.cell_of(next_state), grid.cell_of(state)))
                for state, action, _, next_state, _, _ in outcomes
                if next_state != state
            }
            assert moves == {(action, *move) for action, move in enumerate(grid.moves)}

    def test_a_maze_that_changes_is_drawn_as_it_is_now(self):
        env = gym.make("ShortcutMaze-v0", period=5)
        assert shapes(plot_policy(random_table(54, 4), env), "wall") == {(3, column) for column in range(1, 9)}
        env.unwrapped.clock = 5
        assert shapes(plot_policy(random_table(54, 4), env), "wall") == {(3, column) for column in range(1, 8)}

    def test_moves_that_are_missing_are_asked_for(self):
        env = self.Maze()
        env.moves = ((0, 1),)
        with pytest.raises(ValueError, match=r"Maze has a map .* `moves`.* 3 actions"):
            plot_policy(random_table(6, 3), env)


class TestHeatMaps:
    def test_a_table_without_a_map(self):
        table = random_table(5, 3)
        ax = plot_policy(table)
        np.testing.assert_array_equal(ax.images[0].get_array(), table.T)
        np.testing.assert_array_equal(ax.lines[0].get_xdata(), range(5))
        np.testing.assert_array_equal(np.floor(ax.lines[0].get_ydata()), table.argmax(axis=1))

    def test_states_and_actions_have_the_numbers_of_the_environment(self):
        model = SimpleNamespace(
            q_table=random_table(3, 2),
            observation_space=gym.spaces.Discrete(3, start=10),
            action_space=gym.spaces.Discrete(2, start=5),
        )
        ax = plot_policy(model, what="q")
        ax.figure.canvas.draw()
        assert {"10", "11", "12"} <= {label.get_text() for label in ax.get_xticklabels()}
        assert {"5", "6"} <= {label.get_text() for label in ax.get_yticklabels()}
        model.q_table, model.observation_space = random_table(6, 2), gym.spaces.MultiDiscrete([2, 3])
        digits = {text.get_text() for text in plot_policy(model).texts}
        assert digits and digits <= {"5", "6"}

    def test_two_components_of_three(self):
        """Values worked out by hand: the mean over the first component, and the first component held."""
        model = SimpleNamespace(q_table=np.zeros((12, 2)), observation_space=gym.spaces.MultiDiscrete([2, 3, 2]))
        model.q_table[:, 0] = np.arange(12)  # state = 6 a + 2 b + c
        model.q_table[:, 1] = 5.0
        ax = plot_policy(model, dimensions=(1, 2))
        drawn = find(ax, QuadMesh).get_array().reshape(2, 3)  # c along y, b along x
        # Action 0: 3 + 2 b + c, the mean of 2 b + c and 6 + 2 b + c; action 1: 5. In state 5 both are equal, as where nothing
        # was learned, so that (b, c) = (2, 1) is state 11 only
        np.testing.assert_allclose(drawn, [[5.0, 5.0, 7.0], [5.0, 6.0, 11.0]])
        assert [text.get_text() for text in ax.texts] == ["1", "0", "0", "1", "0", "0"]
        held = find(plot_policy(model, dimensions=(1, 2), at={0: 0}), QuadMesh).get_array().reshape(2, 3)
        np.testing.assert_array_equal(np.ma.filled(held, np.nan), [[5.0, 5.0, 5.0], [5.0, 5.0, np.nan]])

    def test_the_bounds_of_cells_are_on_the_axes(self):
        env = DiscretizeObservation(gym.make("CartPole-v1"), **CELLS)
        ax = plot_policy(random_table(11**4, 2), env, dimensions=(2, 3))
        labels = {float(label.get_text().replace("−", "-")): place for label, place in
                  zip(ax.get_xticklabels(), ax.get_xticks(), strict=True)}  # fmt: skip
        for value, place in labels.items():
            assert value == pytest.approx(env.edges[2][int(place) - 1], rel=0.01, abs=0.001)
        assert ax.get_xlabel() == "dimension 2 of the observation"

    @pytest.mark.parametrize(
        "arguments, message",
        [
            ({"dimensions": (0, 0)}, "two different numbers from 0 to 3"),
            ({"dimensions": (0, 4)}, "two different numbers from 0 to 3"),
            ({"at": {0: 1}}, r"not drawn, \[2, 3\], but got dimension 0"),
            ({"at": {2: 11}}, "cells 0 to 10 of dimension 2, but got 11"),
        ],
    )
    def test_components_that_are_not_there(self, arguments, message):
        env = DiscretizeObservation(gym.make("CartPole-v1"), **CELLS)
        with pytest.raises(ValueError, match=message):
            plot_policy(np.zeros((11**4, 2)), env, **arguments)


class TestMemory:
    def test_visits_of_every_action(self):
        model = make_model("slippery lake", True, method="polynomial").learn(3000)
        ax = plot_policy(model, what="memory:visits")
        total = sum(float(text.get_text()) for text in ax.texts if text.get_text() not in "SHG")
        assert total == 3000  # one count for every update

    def test_one_number_a_state(self):
        model = make_model("slippery lake", True, method="polynomial", method_kwargs={"scope": "state"}).learn(3000)
        assert sum(numbers(plot_policy(model, what="memory:visits")).values()) == 3000

    def test_several_tables_are_averaged(self):
        model = DoubleQ("MlpPolicy", "FrozenLake-v1", method="polynomial", seed=0).learn(3000)
        colors = find(plot_policy(model, what="memory:visits"), PolyCollection).get_array()
        assert model.memory["visits"].shape == (2, 16, 4)
        assert colors.sum() == 1500

    def test_what_is_not_there(self):
        model = make_model("slippery lake", True, method="polynomial", method_kwargs={"scope": "shared"})
        with pytest.raises(ValueError, match=r"'value', 'q', 'memory:visits' for this model, but got 'heights'"):
            plot_policy(model, what="heights")
        with pytest.raises(ValueError, match=r"one number that all states share"):
            plot_policy(model, what="memory:visits")


class TestPrint:
    @pytest.mark.parametrize("has_own_axis", [False, True])
    def test_fonts_are_those_that_journals_take(self, tmp_path, has_own_axis):
        from sb3_adaptive_q.plots import STYLE

        before = dict(mpl.rcParams)
        ax = plot_policy(random_table(48, 4), "CliffWalking-v1", ax=plt.subplots()[1] if has_own_axis else None)
        with mpl.rc_context(STYLE if has_own_axis else {}):
            ax.figure.savefig(tmp_path / "policy.pdf")
        contents = (tmp_path / "policy.pdf").read_bytes()
        assert b"/Type0" in contents and b"/FontFile2" in contents and b"/Type3" not in contents
        assert dict(mpl.rcParams) == before

    def test_grey_print_keeps_the_order_and_the_letters(self):
        """Luminance by sRGB's definition; a contrast of 4.5 is what the Web Content Accessibility Guidelines ask for."""

        def luminance(color: Any) -> Any:
            linear = np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)
            return linear @ [0.2126, 0.7152, 0.0722]

        ground = luminance(SEQUENTIAL(np.linspace(0, 1, 256))[:, :3])
        ink = luminance(np.array(mpl.colors.to_rgb(INK)))
        assert (np.diff(ground) <= 0).all() and (np.diff(ground[::4]) < 0).all()
        assert ((ground + 0.05) / (ink + 0.05)).min() > 4.5

    @given(st.lists(st.floats(-1e8, 1e8), min_size=1, max_size=20))
    def test_numbers_are_rounded_and_not_changed(self, values):
        sizes = {"k": 1e3, "M": 1e6, "G": 1e9}
        for value, text in zip(values, number_texts(np.array(values)), strict=True):
            plain = text.replace("−", "-")
            size = sizes.get(plain[-1], 1.0)
            assert float(plain.rstrip("kMG")) * size == pytest.approx(
                value, rel=0.051, abs=0.5 * (max(map(abs, values)) >= 1000) + 0.051
            )
            assert len(text) <= 6 and not text.startswith("−0.00")


class TestBadInput:
    @pytest.mark.parametrize(
        "arguments, message",
        [
            ({"passenger": "X"}, "`passenger` must be one of R, G, Y, B, taxi"),
            ({"passenger": "R", "destination": "R"}, "`destination` another one"),
            ({"limits": (1.0, 1.0)}, "`limits` must be a smaller and a larger number"),
        ],
    )
    def test_taxis_places_and_limits(self, arguments, message):
        with pytest.raises(ValueError, match=message):
            plot_policy(np.zeros((500, 6)), "Taxi-v4", **arguments)

    def test_places_elsewhere(self):
        with pytest.raises(ValueError, match="are Taxi's"):
            plot_policy(np.zeros((16, 4)), "FrozenLake-v1", passenger="R")

    @pytest.mark.parametrize("model", [np.zeros(5), "lake", object()])
    def test_no_table(self, model):
        with pytest.raises(ValueError, match="Expected a model with a `q_table`, or a table of shape"):
            plot_policy(model)

    @pytest.mark.parametrize("missing", ["matplotlib", "pandas", "scipy"])
    def test_a_missing_package_is_named_with_the_extra_that_has_it(self, missing, monkeypatch):
        for name in [name for name in sys.modules if name.startswith("sb3_adaptive_q.plots")]:
            monkeypatch.delitem(sys.modules, name)
        monkeypatch.setitem(sys.modules, missing, None)
        with pytest.raises(ModuleNotFoundError, match=rf"needs {missing}: .* 'sb3-adaptive-q\[plots\]'"):
            import sb3_adaptive_q.plots  # noqa: F401


def test_a_fresh_model_can_be_drawn():
    ax = plot_policy(TabularQ("MlpPolicy", "FrozenLake-v1"))
    assert set(numbers(ax).values()) == {0.0}
