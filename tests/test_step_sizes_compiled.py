"""Every step size and rule as machine code: the bits are those of plain Python, and nothing raises."""

import warnings
from collections.abc import Callable
from functools import cache
from types import FunctionType
from typing import Any

import numpy as np
import pytest
from numba import njit
from numba.extending import register_jitable

from sb3_adaptive_q.step_sizes import STEP_SIZES, Step, clip_size, find_step_size, paper, resolve_parameters

ROWS, COLUMNS = 3, 2
#: One more setting for each step size whose defaults leave a branch or a bound untouched
OTHER_PARAMETERS: dict[str, dict[str, float]] = {
    "autostep": {"meta_step_size": 1.0, "tau": 1.0, "alpha_0": 1.0},
    "bakf": {"nu_target": 0.3},
    "benveniste": {"nu": 10.0, "lower": 0.2, "upper": 0.3},
    "delta_bar_delta": {"kappa": 0.5, "phi": 0.5},
    "horizon": {"horizon": 5.0},
    "idbd": {"theta": 10.0},
    "k1": {"theta": 10.0},
    "mcclain": {"alpha_0": 0.001, "target": 1.0},
    "polynomial": {"omega": 0.5},
    "swift_td": {"theta": 10.0, "eta": 0.5},
}
PAPER_RULES: dict[Callable[..., float], tuple[float, ...]] = {
    paper.constant_rate: (0.05,),
    paper.linear_decay_rate: (0.01, 0.04),
    paper.linear_growth_rate: (0.01, 0.04),
    paper.proportional_rate: (-0.05, 0.001, 0.01),
    paper.sign_rate: (0.005, 0.001, 0.01),
}


#: A function is made known to the compiler once
make_known = cache(register_jitable)


def helpers_of(function: FunctionType) -> list[FunctionType]:
    """The plain functions that a function calls."""
    called = [function.__globals__.get(name) for name in function.__code__.co_names]
    return [item for item in called if isinstance(item, FunctionType)]


def make_loop(form: Callable[..., float]) -> Callable[..., None]:
    """A plain loop over updates of random cells. ``inputs`` has the columns error, value, next value, progress."""

    def loop(cells: Any, inputs: Any, gamma: float, counts: Any, sizes: Any, arguments: Any) -> None:
        mu = 0.01
        for i in range(len(inputs)):
            row, column = cells[i]
            counts[row, column] += 1.0
            error, value, next_value, progress = inputs[i]
            step = Step(row, column, row, column, counts[row, column], value, next_value, error, progress, gamma, 0.0)
            mu = form(mu, step, *arguments)
            sizes[i] = mu

    return loop


def compile_loop(form: Any) -> Callable[..., None]:
    """The same loop as machine code, in which a division by zero gives infinity."""
    for helper in helpers_of(form):
        make_known(helper)
    return njit(make_loop(make_known(form)), error_model="numpy")


def random_inputs(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """
    Cells, and what their updates see: errors of ordinary size, then with zeros among them, of one sign, and beyond all
    measure, up to the square root of the largest float and more.
    """
    generator = np.random.default_rng(seed)
    ordinary = generator.normal(size=1200)
    ordinary[400:600] *= generator.integers(0, 2, size=200)
    ordinary[600:800] = np.abs(ordinary[600:800])
    extreme = generator.normal(size=300) * 10.0 ** generator.integers(-200, 200, size=300)
    errors = np.concatenate([np.zeros(20), ordinary, extreme])
    others = generator.normal(size=(len(errors), 2))
    inputs = np.column_stack([errors, others, np.linspace(0.0, 1.0, len(errors))])
    return np.column_stack([generator.integers(ROWS, size=len(errors)), generator.integers(COLUMNS, size=len(errors))]), inputs


def run(loop: Callable[..., None], gamma: float, parameters: tuple[float, ...], starts: dict[str, float]) -> list[np.ndarray]:
    """The step sizes, then the arrays of the memory."""
    cells, inputs = random_inputs(seed=1)
    arrays = [np.full((ROWS, COLUMNS), start) for start in starts.values()]
    sizes = np.empty(len(inputs))
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("error")
        loop(cells, inputs, gamma, np.zeros((ROWS, COLUMNS)), sizes, (*parameters, *arrays))
    return [sizes, *arrays]


def assert_same_bits(first: list[np.ndarray], second: list[np.ndarray]) -> None:
    """All NaN count as one."""
    for left, right in zip(first, second, strict=True):
        numbers = ~np.isnan(left)
        assert np.array_equal(numbers, ~np.isnan(right))
        assert left[numbers].tobytes() == right[numbers].tobytes()


@pytest.mark.parametrize("name", STEP_SIZES)
def test_step_size(name: str) -> None:
    step_size = find_step_size(name)
    as_python, as_machine_code = make_loop(step_size.step_size), compile_loop(step_size.step_size)
    for given, gamma in (({}, 0.9), (OTHER_PARAMETERS.get(name, {}), 1.0)):
        parameters = resolve_parameters(name, given)
        starts = step_size.start_values(parameters)
        results = [run(loop, gamma, tuple(parameters.values()), starts) for loop in (as_python, as_machine_code)]
        assert_same_bits(*results)
        assert np.isfinite(results[0][0][:1220]).all()


@pytest.mark.parametrize("rule", PAPER_RULES, ids=lambda rule: rule.__name__)
def test_rule_of_the_paper(rule: Callable[..., float]) -> None:
    results = [run(loop, 0.9, PAPER_RULES[rule], {}) for loop in (make_loop(rule), compile_loop(rule))]
    assert_same_bits(*results)


def test_the_last_clip() -> None:
    compiled = njit(clip_size)
    for size in (-1.0, -0.0, 0.0, 0.3, 1.0, 2.0, np.inf, -np.inf, np.nan):
        assert np.array_equal(compiled(size, 0.0, 1.0), clip_size(size, 0.0, 1.0), equal_nan=True)
