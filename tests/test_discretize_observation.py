"""DiscretizeObservation against numpy.digitize, the paper's Table 5 and both env checkers."""

import itertools
import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env as check_gymnasium_env
from hypothesis import given
from hypothesis import strategies as st
from stable_baselines3.common.env_checker import check_env as check_sb3_env

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


@pytest.mark.parametrize("n_edges", [1, 0, -3, 2.0, 2.5, True, [5, 1]])
def test_number_of_edges(n_edges: Any) -> None:
    with pytest.raises(ValueError, match="n_edges must be an integer of at least 2"):
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


@pytest.mark.parametrize("space", [spaces.Discrete(5), spaces.Dict({"x": spaces.Box(0, 1, (2,))})])
def test_only_box_observations(space: spaces.Space[Any]) -> None:
    with pytest.raises(ValueError, match=r"needs a Box observation space, got .*FlattenObservation"):
        DiscretizeObservation(BoxEnv(space))


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
    with pytest.raises(ValueError, match=r"Expected an observation of shape \(4,\), got shape \(2, 2\)"):
        paper_wrapper().observation(np.zeros((2, 2)))


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
