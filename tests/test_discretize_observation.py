"""DiscretizeObservation against numpy.digitize, the paper's Table 5 and both env checkers."""

import itertools
import math
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env as check_gymnasium_env
from helpers import mountain_car  # registers its dynamics  # noqa: F401
from hypothesis import assume, given
from hypothesis import strategies as st
from stable_baselines3.common.env_checker import check_env as check_sb3_env
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

import sb3_adaptive_q
import wrappers
from sb3_adaptive_q import CompiledVecEnv, LeanVecEnv
from sb3_adaptive_q.compiled.jit import machine_code
from sb3_adaptive_q.vec_env.dynamics import Grid, grid_index
from sb3_adaptive_q.wrappers import edges_of
from wrappers import DiscretizeObservation

PAPER_HIGH = [2.4, 4.0, 0.2095, 4.0]
PAPER_LOW = [-2.4, -4.0, -0.2095, -4.0]


class BoxEnv(gym.Env[Any, Any]):
    """Observations drawn from a space, in it or anywhere; nothing else happens."""

    def __init__(self, space: spaces.Space[Any]):
        self.observation_space = space
        self.action_space = spaces.Discrete(2)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        if seed is not None:
            self.observation_space.seed(seed)
        return self.observation_space.sample(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        return self.observation_space.sample(), 0.0, False, False, {}


def box(shape: tuple[int, ...] = (4,), dtype: Any = np.float64) -> BoxEnv:
    return BoxEnv(spaces.Box(-np.inf, np.inf, shape, dtype))


def paper_wrapper(**options: Any) -> DiscretizeObservation:
    return DiscretizeObservation(gym.make("CartPole-v1"), 10, PAPER_LOW, PAPER_HIGH, **options)


# The paper's Table 5


@pytest.mark.parametrize(
    "cells, number",
    [
        ((0, 0, 0, 0), 0),
        ((0, 0, 0, 1), 1),
        ((1, 3, 4, 4), 1742),
        ((1, 3, 4, 5), 1743),
        # The paper prints 14641 for the last one: there are 14641 cells, counted from 0.
        ((10, 10, 10, 10), 14640),
    ],
)
def test_paper_numbers_of_cells(cells: tuple[int, ...], number: int) -> None:
    wrapper = paper_wrapper()
    assert wrapper.index(cells) == number
    assert wrapper.cells(number) == cells
    assert wrapper.observation_space == spaces.Discrete(14641)
    assert wrapper.n_cells == (11, 11, 11, 11)


def test_paper_edges() -> None:
    edges = paper_wrapper().edges
    assert [len(one) for one in edges] == [10, 10, 10, 10]
    assert all(one.dtype == np.float64 for one in edges)
    # Ten edges leave nine gaps of 8/9 between -4 and 4.
    np.testing.assert_allclose(edges[1], [-4 + k * 8 / 9 for k in range(10)], rtol=0, atol=1e-15)
    assert edges[2][0] == -0.2095 and edges[2][-1] == 0.2095


def test_edges_cannot_be_changed_behind_the_wrapper() -> None:
    with pytest.raises(ValueError, match="read-only"):
        paper_wrapper().edges[0][0] = 0.0


# The same cells as numpy.digitize


@st.composite
def grids(draw: st.DrawFn) -> tuple[list[float], list[float], list[int]]:
    size = draw(st.integers(1, 4))
    lows = draw(st.lists(st.floats(-100, 99), min_size=size, max_size=size))
    widths = draw(st.lists(st.floats(0.01, 100), min_size=size, max_size=size))
    counts = draw(st.lists(st.integers(2, 12), min_size=size, max_size=size))
    return lows, [low + width for low, width in zip(lows, widths, strict=True)], counts


def values_on_and_off_edges(edges: np.ndarray[Any, Any]) -> st.SearchStrategy[float]:
    # The edges, their neighbours in float64, the infinities, and anything else but NaN.
    return st.one_of(
        st.sampled_from(edges.tolist()),
        st.sampled_from(edges.tolist()).map(lambda edge: math.nextafter(edge, math.inf)),
        st.sampled_from(edges.tolist()).map(lambda edge: math.nextafter(edge, -math.inf)),
        st.floats(-250, 250),
        st.floats(allow_nan=False),
    )


@given(grid=grids(), dtype=st.sampled_from([np.float64, np.float32]), data=st.data())
def test_cells_are_those_of_numpy_digitize(grid: Any, dtype: Any, data: st.DataObject) -> None:
    lows, highs, counts = grid
    expected_edges = [np.linspace(low, high, count) for low, high, count in zip(lows, highs, counts, strict=True)]
    values = [data.draw(values_on_and_off_edges(edges)) for edges in expected_edges]
    with np.errstate(over="ignore"):
        observation = np.array(values).astype(dtype)
    expected = [int(np.digitize(value, edges)) for value, edges in zip(observation, expected_edges, strict=True)]

    wrapper = DiscretizeObservation(box((len(counts),), dtype), counts, lows, highs)
    number = wrapper.observation(observation)
    assert number == np.ravel_multi_index(expected, [count + 1 for count in counts])
    assert wrapper.observation_space.contains(number)

    vector = DiscretizeObservation(box((len(counts),), dtype), counts, lows, highs, multi_discrete=True)
    cells = vector.observation(observation)
    np.testing.assert_array_equal(cells, expected)
    assert vector.observation_space.contains(cells)

    low, high = wrapper.bounds(number)
    in_double = observation.astype(np.float64)
    # Each cell holds its low end and not its high end; plus infinity belongs to the last cell.
    assert np.all(low <= in_double) and np.all((in_double < high) | (in_double == np.inf))


def test_float32_is_compared_with_float64_edges() -> None:
    # float32(0.1) lies above 0.1, float32(0.7) below 0.7: rounding the edges to float32 would put both on an edge.
    wrapper = DiscretizeObservation(box((1,), np.float32), 2, 0.1, 0.7)
    assert float(np.float32(0.1)) > 0.1 and float(np.float32(0.7)) < 0.7
    assert wrapper.observation(np.array([0.1], dtype=np.float32)) == 1
    assert wrapper.observation(np.array([0.7], dtype=np.float32)) == 1
    assert DiscretizeObservation(box((1,)), 2, 0.1, 0.7).observation(np.array([0.7])) == 2


def test_infinities_fall_in_the_outer_cells() -> None:
    wrapper = paper_wrapper(multi_discrete=True)
    cells = wrapper.observation(np.array([-np.inf, np.inf, np.inf, -np.inf], dtype=np.float32))
    np.testing.assert_array_equal(cells, [0, 10, 10, 0])


# Numbers, cells and bounds


@given(counts=st.lists(st.integers(2, 30), min_size=1, max_size=5), data=st.data())
def test_index_and_cells_are_inverse(counts: list[int], data: st.DataObject) -> None:
    wrapper = DiscretizeObservation(box((len(counts),)), counts, -1.0, 1.0)
    cells = tuple(data.draw(st.integers(0, count)) for count in counts)
    number = wrapper.index(cells)
    assert number == np.ravel_multi_index(cells, wrapper.n_cells)
    assert wrapper.cells(number) == cells
    assert wrapper.index(np.array(cells)) == number


def test_numbers_follow_the_order_of_the_cells() -> None:
    wrapper = DiscretizeObservation(box((3,)), (2, 4, 3), -1.0, 1.0)
    in_order = list(itertools.product(range(3), range(5), range(4)))
    assert [wrapper.index(cells) for cells in in_order] == list(range(60))
    assert [wrapper.cells(number) for number in range(60)] == in_order


def test_bounds_of_inner_and_outer_cells() -> None:
    wrapper = DiscretizeObservation(box((2,)), (3, 2), (0.0, 10.0), (1.0, 20.0))
    low, high = wrapper.bounds(wrapper.index((0, 1)))
    assert low.tolist() == [-np.inf, 10.0] and high.tolist() == [0.0, 20.0]
    low, high = wrapper.bounds(wrapper.index((2, 2)))
    assert low.tolist() == [0.5, 20.0] and high.tolist() == [1.0, np.inf]


def test_observation_of_several_axes_is_flattened_row_by_row() -> None:
    wrapper = DiscretizeObservation(box((2, 2)), 2, [[0.0, 1.0], [2.0, 3.0]], [1.0, 2.0, 3.0, 4.0], multi_discrete=True)
    assert [edges[0] for edges in wrapper.edges] == [0.0, 1.0, 2.0, 3.0]
    observation = np.array([[-1.0, 1.5], [9.0, 3.0]])
    for array in (observation, np.asfortranarray(observation)):
        np.testing.assert_array_equal(wrapper.observation(array), [0, 1, 2, 1])
    low, high = wrapper.bounds(wrapper.index((0, 1, 2, 1)))
    assert low.tolist() == [[-np.inf, 1.0], [3.0, 3.0]] and high.tolist() == [[0.0, 2.0], [np.inf, 4.0]]


def test_bounds_of_the_space_are_the_default() -> None:
    space = spaces.Box(np.array([0, -5], dtype=np.float32), np.array([1, 5], dtype=np.float32))
    wrapper = DiscretizeObservation(BoxEnv(space), 3)
    assert [edges.tolist() for edges in wrapper.edges] == [[0.0, 0.5, 1.0], [-5.0, 0.0, 5.0]]
    assert [edges[-1] for edges in DiscretizeObservation(BoxEnv(space), 3, high=0.5, low=-6).edges] == [0.5, 0.5]


def test_integer_box() -> None:
    wrapper = DiscretizeObservation(BoxEnv(spaces.Box(0, 255, (2,), np.uint8)), 3, multi_discrete=True)
    np.testing.assert_array_equal(wrapper.observation(np.array([127, 255], dtype=np.uint8)), [1, 3])


# As a gymnasium wrapper


@pytest.mark.parametrize("multi_discrete", [False, True])
@pytest.mark.parametrize("env_id", ["CartPole-v1", "MountainCar-v0"])
@pytest.mark.filterwarnings("error")
def test_env_checkers(env_id: str, multi_discrete: bool) -> None:
    bounds: dict[str, Any] = {"low": PAPER_LOW, "high": PAPER_HIGH} if env_id == "CartPole-v1" else {}
    wrapper = DiscretizeObservation(gym.make(env_id).unwrapped, multi_discrete=multi_discrete, **bounds)
    # gymnasium's checker itself says that it would rather see an unwrapped environment.
    with pytest.warns(UserWarning, match="different from the unwrapped version"):
        check_gymnasium_env(wrapper, skip_render_check=True)
    check_sb3_env(wrapper)


@pytest.mark.filterwarnings("error")
def test_passive_checker_accepts_every_step() -> None:
    env = gym.wrappers.PassiveEnvChecker(paper_wrapper())
    env.reset(seed=0)
    for _ in range(200):
        if any(env.step(env.action_space.sample())[2:4]):
            env.reset()


def test_env_can_be_made_again_from_its_spec() -> None:
    wrapper = DiscretizeObservation(gym.make("CartPole-v1"), 7, PAPER_LOW, PAPER_HIGH, multi_discrete=True)
    assert wrapper.spec is not None
    again = gym.make(gym.envs.registration.EnvSpec.from_json(wrapper.spec.to_json()))
    assert isinstance(again, DiscretizeObservation)
    assert again.observation_space == wrapper.observation_space
    np.testing.assert_array_equal(again.edges, wrapper.edges)


# Dimensions left out, and edges of one's own


@pytest.mark.parametrize("name", ["low", "high", "n_edges"])
@pytest.mark.parametrize("value", ["ten", [1, 2, "a", 4], {"x": 1}, [[1], [2, 3], 4, 5]])
def test_what_is_no_number(name: str, value: Any) -> None:
    with pytest.raises(ValueError, match=f"{name} must be a number or a list of numbers, got"):
        DiscretizeObservation(gym.make("CartPole-v1"), **{"n_edges": 10, "low": -1.0, "high": 1.0, name: value})


def test_dimensions_without_edges_are_left_out() -> None:
    """The bounds of Cart Pole's space are infinite in the second dimension, which is one that is left out."""
    wrapper = DiscretizeObservation(gym.make("CartPole-v1"), [0, 0, 5, 11], [None, None, -0.4, -0.9], [9.0, -9.0, 0.4, 0.9])
    assert wrapper.n_cells == (1, 1, 6, 12)
    assert wrapper.observation_space == spaces.Discrete(72)
    assert [len(edges) for edges in wrapper.edges] == [0, 0, 5, 11]
    for x in (-1e9, 0.0, np.inf):
        assert wrapper.observation(np.array([x, -x, -0.5, 0.95])) == 11
    assert wrapper.observation(np.array([0.0, 0.0, 0.4, 0.0])) == 5 * 12 + 6
    low, high = wrapper.bounds(71)
    assert low.tolist() == [-np.inf, -np.inf, 0.4, 0.9] and high.tolist() == [np.inf] * 4


def test_bounds_of_the_space_do_not_matter_where_a_dimension_is_left_out() -> None:
    wrapper = DiscretizeObservation(gym.make("CartPole-v1"), [3, 0, 3, 0], multi_discrete=True)
    assert wrapper.observation_space == spaces.MultiDiscrete([4, 1, 4, 1])
    assert DiscretizeObservation(gym.make("CartPole-v1"), 0).observation_space == spaces.Discrete(1)


@given(values=st.lists(st.floats(-2, 2), min_size=4, max_size=4))
def test_buckets_of_the_tutorials(values: list[float]) -> None:
    """The share of the way from low to high decides on the bucket, cut off at both ends."""
    buckets, bounds = (1, 1, 6, 12), (2.4, 0.5, 0.4, 0.9)
    expected = []
    for value, bucket, bound in zip(values, buckets, bounds, strict=True):
        share = (value + bound) / (2 * bound)
        assume(abs(share * bucket - round(share * bucket)) > 1e-9)
        expected.append(min(max(math.floor(share * bucket), 0), bucket - 1))
    edges = [np.linspace(-bound, bound, bucket + 1)[1:-1] for bucket, bound in zip(buckets, bounds, strict=True)]
    wrapper = DiscretizeObservation(box((4,)), edges=edges, multi_discrete=True)
    assert wrapper.observation(np.array(values)).tolist() == expected  # type: ignore[union-attr]


uneven_edges = st.lists(
    st.lists(st.floats(-100, 100), unique=True, max_size=6).map(sorted).map(np.array), min_size=1, max_size=4
)


def draw_observation(data: st.DataObject, edges: list[np.ndarray[Any, Any]]) -> np.ndarray[Any, Any]:
    return np.array([data.draw(values_on_and_off_edges(one) if len(one) else st.floats(allow_nan=False)) for one in edges])


@given(edges=uneven_edges, data=st.data())
def test_given_edges_are_those_of_numpy_digitize(edges: list[np.ndarray[Any, Any]], data: st.DataObject) -> None:
    values = draw_observation(data, edges)
    expected = tuple(int(np.digitize(value, one)) for value, one in zip(values, edges, strict=True))
    wrapper = DiscretizeObservation(box((len(edges),)), edges=edges)
    number = wrapper.observation(values)
    assert wrapper.cells(number) == expected
    low, high = wrapper.bounds(number)
    assert np.all(low <= values) and np.all((values < high) | (values == np.inf))


@given(edges=uneven_edges, data=st.data())
def test_compiled_code_finds_the_same_cells(edges: list[np.ndarray[Any, Any]], data: st.DataObject) -> None:
    """As plain Python: what compiles are numbers and loops."""
    values = draw_observation(data, edges)
    wrapper = DiscretizeObservation(box((len(edges),)), edges=edges)
    assert grid_index(*Grid.of(wrapper), tuple(values.tolist())) == wrapper.observation(values)


@pytest.mark.parametrize("values", itertools.product([math.nan, math.inf, -math.inf, 0.0], repeat=2))
def test_machine_code_finds_a_cell_for_what_is_no_number(values: tuple[float, float]) -> None:
    """Cart Pole reaches such a state if its numbers overflow, and its cells are not checked."""
    grid = Grid.of(DiscretizeObservation(box((2,)), edges=[np.array([-1.0, 0.0, 1.0]), np.array([-1.0, 1.0])]))
    found = machine_code(grid_index, (*grid, values))(*grid, values)
    numbers = [-math.inf if math.isnan(value) else value for value in values]
    assert found == grid_index(*grid, tuple(numbers))


@pytest.mark.parametrize(
    "bad", [[1.0, 1.0], [2.0, 1.0], [0.0, np.nan], [-np.inf, 0.0], [[1.0, 2.0]], 3.0, "ab", ["a"], None, [[1.0], [1.0, 2.0]]]
)
def test_given_edges_must_increase(bad: Any) -> None:
    with pytest.raises(ValueError, match=r"finite numbers in strictly increasing order .*got .* for dimension 1"):
        DiscretizeObservation(box((2,)), edges=[[0.0], bad])


@pytest.mark.parametrize("bad", [[], [[0.0]], [[0.0]] * 3, 7, {0.0, 1.0, 2.0}])
def test_one_array_of_edges_for_each_dimension(bad: Any) -> None:
    with pytest.raises(ValueError, match=r"one array for each of the 2 dimensions .*shape \(2,\)"):
        DiscretizeObservation(box((2,)), edges=bad)


@pytest.mark.parametrize("other", [{"n_edges": 3}, {"low": 0.0}, {"high": [1.0, 1.0]}, {"n_edges": 10, "low": 0.0}])
def test_edges_are_given_in_one_way(other: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=f"alone sets the cells, but got {', '.join(other)} too: give one or the other"):
        DiscretizeObservation(box((2,)), edges=[[0.0], [0.0]], **other)


def test_given_edges_of_another_do_not_change_with_it() -> None:
    edges = [np.array([0.0, 1.0])]
    wrapper = DiscretizeObservation(box((1,)), edges=edges)
    edges[0][0] = 5.0
    assert wrapper.edges[0].tolist() == [0.0, 1.0]
    with pytest.raises(ValueError, match="read-only"):
        wrapper.edges[0][0] = 5.0


# What it says of itself


def test_it_says_what_it_does() -> None:
    wrapper = DiscretizeObservation(gym.make("CartPole-v1"), edges=[[], [0.5], [-1, 0, 2.5], [-1, 0, 2.5]])
    cells = "32 cells; edges: left out, 0.5, 3 from -1 to 2.5 (2 times)"
    assert repr(wrapper) == f"<DiscretizeObservation({cells}){wrapper.env}>"
    outer = gym.wrappers.OrderEnforcing(wrapper)
    assert repr(outer) == f"<OrderEnforcing{wrapper!r}>"


def test_it_says_so_shortly_of_many_dimensions() -> None:
    n_edges = [2, 3] * 50
    assert "3 from -1 to 1, 2 from -1 to 1, ...)<" in repr(DiscretizeObservation(box((100,)), n_edges, -1, 1, True))
    assert "edges: 5 from 0 to 255 (300 times))<" in repr(
        DiscretizeObservation(BoxEnv(spaces.Box(0, 255, (10, 10, 3), np.uint8)), 5, multi_discrete=True)
    )


ARGUMENTS: list[dict[str, Any]] = [
    {"n_edges": np.array([3, 4, 5, 6]), "low": np.array(PAPER_LOW), "high": np.array(PAPER_HIGH)},
    {"n_edges": np.int64(4), "low": np.float32(-1), "high": np.array(2.0), "multi_discrete": np.True_},
    {"n_edges": [0, 0, 5, 11], "low": [None, None, -0.4, -0.9], "high": [np.nan, None, 0.4, 0.9]},
    {"edges": [np.array([]), np.array([1.5]), (1, 2), np.linspace(-1, 1, 7)]},
]


@pytest.mark.parametrize("arguments", ARGUMENTS)
def test_specs_with_numpys_numbers(arguments: dict[str, Any]) -> None:
    wrapper = DiscretizeObservation(gym.make("CartPole-v1"), **arguments)
    spec = wrapper.spec
    assert spec is not None
    assert spec == DiscretizeObservation(gym.make("CartPole-v1"), **arguments).spec
    again = gym.make(gym.envs.registration.EnvSpec.from_json(spec.to_json()))
    assert isinstance(again, DiscretizeObservation)
    assert again.observation_space == wrapper.observation_space
    for ours, theirs in zip(again.edges, wrapper.edges, strict=True):
        np.testing.assert_array_equal(ours, theirs)


# gymnasium's wrapper of the same name

SPACES = {
    "float32": spaces.Box(np.array([-1.2, -0.07], np.float32), np.array([0.6, 0.07], np.float32)),
    "float64": spaces.Box(-1.0, 3.0, (2,), np.float64),
    "bytes": spaces.Box(0, 255, (2,), np.uint8),
}


@pytest.mark.parametrize("name", SPACES)
@given(bins=st.lists(st.integers(1, 12), min_size=2, max_size=2).map(tuple), data=st.data())
def test_gymnasiums_wrapper_bins_by_its_edges(name: str, bins: tuple[int, ...], data: st.DataObject) -> None:
    """On the edges and beside them, on the bounds and beyond them."""
    space = SPACES[name]
    theirs = gym.wrappers.DiscretizeObservation(BoxEnv(space), bins)
    edges = edges_of(theirs)
    assert [len(one) + 1 for one in edges] == list(bins)
    with_bounds = [np.array([*one, low, high]) for one, low, high in zip(edges, space.low, space.high, strict=True)]
    values = [data.draw(values_on_and_off_edges(one)) for one in with_bounds]
    with np.errstate(over="ignore"):
        observation = np.clip(values, 0, 255).astype(np.uint8) if name == "bytes" else np.array(values).astype(space.dtype)
    number = theirs.observation(observation)
    assert number == DiscretizeObservation(BoxEnv(space), edges=edges).observation(observation)
    assert number == grid_index(*Grid.of(theirs), tuple(observation.astype(np.float64).tolist()))


def test_gymnasiums_wrapper_with_cells_that_it_cannot_reach() -> None:
    """It cuts observations off 1e-8 below the bound, here far below the last edge."""
    with pytest.raises(ValueError, match=r"gymnasium\.wrappers\.Disc.* dimension 0 .*sb3_adaptive_q\.wrappers\.Disc"):
        edges_of(gym.wrappers.DiscretizeObservation(BoxEnv(spaces.Box(0.0, 1e-8, (1,), np.float64)), 4))


@pytest.mark.parametrize("vec_env_class", [LeanVecEnv, CompiledVecEnv])
def test_gymnasiums_wrapper_around_mountain_car(vec_env_class: Any) -> None:
    """CompiledVecEnv steps its functions beside the environment before it takes them."""

    def make() -> gym.Env[Any, Any]:
        return Monitor(gym.wrappers.DiscretizeObservation(gym.make("MountainCar-v0"), (7, 9)))

    ours, theirs = vec_env_class([make]), DummyVecEnv([make])
    assert ours.seed(5) == theirs.seed(5)
    np.testing.assert_array_equal(ours.reset(), theirs.reset())
    for step in range(300):
        for our, their in zip(ours.step(np.array([step % 3]))[:3], theirs.step(np.array([step % 3]))[:3], strict=True):
            np.testing.assert_array_equal(our, their)


# A module of a user's that has the same name


def test_modules_of_the_package_import_the_packages_own() -> None:
    package = Path(sb3_adaptive_q.__file__).parent
    imports = r"^\s*(from wrappers\b|import wrappers\b)|^\s*- wrappers\."
    sources = [path for path in package.rglob("*") if path.suffix in (".py", ".yml")]
    assert len(sources) > 30
    assert [path.name for path in sources if re.search(imports, path.read_text("utf-8"), re.MULTILINE)] == []


def test_a_users_wrappers_module_in_the_working_folder(tmp_path: Path) -> None:
    (tmp_path / "wrappers.py").write_text("raise RuntimeError('not this one')\n")
    program = (
        "import gymnasium as gym, sb3_adaptive_q; from sb3_adaptive_q.wrappers import DiscretizeObservation\n"
        "wrapper = DiscretizeObservation(gym.make('MountainCar-v0'), 3)\n"
        "print(type(gym.make(gym.envs.registration.EnvSpec.from_json(wrapper.spec.to_json()))).__module__)\n"
    )
    environment = {**os.environ, "PYTHONPATH": str(Path(sb3_adaptive_q.__file__).parent.parent)}
    command = [sys.executable, "-c", program]
    ran = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120)
    assert (ran.returncode, ran.stdout.strip()) == (0, "sb3_adaptive_q.wrappers.discretize"), ran.stderr


def test_the_public_name_is_the_same_class() -> None:
    assert wrappers.DiscretizeObservation is sb3_adaptive_q.wrappers.DiscretizeObservation is DiscretizeObservation


# Bad input


def test_infinite_bounds_name_the_dimensions_and_what_to_pass() -> None:
    with pytest.raises(ValueError, match=r"low bound of dimension\(s\) 1, 3 .*observation space.*low=.*list of 4"):
        DiscretizeObservation(gym.make("CartPole-v1"))
    with pytest.raises(ValueError, match=r"high bound of dimension\(s\) 1, 3 .*observation space.*high="):
        DiscretizeObservation(gym.make("CartPole-v1"), low=PAPER_LOW)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_given_bounds_must_be_finite(bad: float) -> None:
    with pytest.raises(ValueError, match=r"high bound of dimension\(s\) 2 is not finite in the argument high"):
        DiscretizeObservation(box((3,)), 10, -1.0, [1.0, 1.0, bad])


@pytest.mark.parametrize("high", [[1.0, -1.0], [1.0, -2.0]])
def test_low_must_be_below_high(high: list[float]) -> None:
    with pytest.raises(ValueError, match=r"low must be below high.*low=-1\.0.*dimension 1"):
        DiscretizeObservation(box((2,)), 10, -1.0, high)


@pytest.mark.parametrize("n_edges", [1, -3, 2.0, 2.5, True, False, [5, 1], [0, -1]])
def test_number_of_edges(n_edges: Any) -> None:
    with pytest.raises(ValueError, match=r"n_edges must be an integer of at least 2 .*or 0 .*for one bucket pass n_edges=0"):
        DiscretizeObservation(box((2,)), n_edges, -1.0, 1.0)


@pytest.mark.parametrize(
    "arguments",
    [{"n_edges": [5, 5]}, {"low": [-1.0, -1.0]}, {"high": [1.0] * 7}, {"low": -np.ones((3, 2))}, {"n_edges": [[5, 5, 5]]}],
)
def test_lengths_must_fit_the_observation(arguments: dict[str, Any]) -> None:
    name = next(iter(arguments))
    with pytest.raises(ValueError, match=rf"{name} must be one number, or one for each of the 6 dimensions.*\(2, 3\)"):
        DiscretizeObservation(box((2, 3)), **{"low": -1.0, "high": 1.0, **arguments})


@pytest.mark.parametrize("low, high", [(1.0, 1.000000000000001), (-1.7e308, 1.7e308)])
@pytest.mark.filterwarnings("error")
def test_edges_must_be_distinct_finite_numbers(low: float, high: float) -> None:
    with pytest.raises(ValueError, match="dimension 0 are not distinct finite numbers"):
        DiscretizeObservation(box((1,)), 10, low, high)


def test_only_box_observations() -> None:
    with pytest.raises(ValueError, match=r"needs a Box observation space, but got Dict\(.*FlattenObservation"):
        DiscretizeObservation(BoxEnv(spaces.Dict({"x": spaces.Box(0, 1, (2,))})))


@pytest.mark.parametrize("space", [spaces.Discrete(5), spaces.Tuple([spaces.Discrete(3), spaces.Discrete(2)])])
def test_finite_observations_need_no_binning(space: spaces.Space[Any]) -> None:
    with pytest.raises(ValueError, match=r"but got .*needs no binning: TabularQ takes it as it is"):
        DiscretizeObservation(BoxEnv(space))


def test_flattened_numbers_need_no_binning() -> None:
    """Flattening Blackjack makes 45 dimensions of three numbers."""
    flattened = gym.wrappers.FlattenObservation(gym.make("Blackjack-v1"))
    with pytest.raises(ValueError, match=r"too many.*remove FlattenObservation.*Tuple\(Discrete\(32\).*as it is"):
        DiscretizeObservation(flattened, 2)


def test_more_cells_than_numbers() -> None:
    with pytest.raises(ValueError, match=r"too many to be numbered in 64 bits.*multi_discrete=True"):
        DiscretizeObservation(box((20,)), 10, -1.0, 1.0)
    assert len(DiscretizeObservation(box((20,)), 10, -1.0, 1.0, multi_discrete=True).n_cells) == 20


@pytest.mark.parametrize("multi_discrete", [False, True])
def test_nan_names_its_dimension(multi_discrete: bool) -> None:
    wrapper = paper_wrapper(multi_discrete=multi_discrete)
    with pytest.raises(ValueError, match=r"NaN in dimension\(s\) 1, 3"):
        wrapper.observation(np.array([np.inf, np.nan, -np.inf, np.nan], dtype=np.float32))


def test_observation_of_another_shape() -> None:
    with pytest.raises(
        ValueError, match=r"(?s)expects observations of shape \(4,\), but got .* of shape \(2, 2\) from CartPoleEnv"
    ):
        paper_wrapper().observation(np.zeros((2, 2)))


def test_an_observation_that_is_no_array() -> None:
    assert paper_wrapper().observation([0.0, 0.0, 0.0, 0.0]) == paper_wrapper().observation(np.zeros(4))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match=r"shape \(4,\), but got array\(None, dtype=object\) of shape \(\)"):
        paper_wrapper().observation(None)  # type: ignore[arg-type]


@pytest.mark.parametrize("number", [-1, 14641])
def test_number_without_a_cell(number: int) -> None:
    wrapper = paper_wrapper()
    for method in (wrapper.cells, wrapper.bounds):
        with pytest.raises(ValueError, match=rf"must lie in 0\.\.14640, got {number}"):
            method(number)


@pytest.mark.parametrize(
    "cells, message", [((0, 0, 11, 0), r"dimension 2 must lie in 0\.\.10, got 11"), ((0, 0), "4 dimensions, got 2")]
)
def test_cells_outside_the_grid(cells: tuple[int, ...], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        paper_wrapper().index(cells)
