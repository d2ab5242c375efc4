"""What the formulas of the step sizes imply, whatever the errors and the parameters are."""

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from helpers.one_cell import Cell, estimate, make_step, sizes_of
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from sb3_adaptive_q.step_sizes import STEP_SIZES, clip_size
from sb3_adaptive_q.step_sizes.gradient import LEAST_SIZE

shares = st.floats(0.01, 1.0)
inner_shares = st.floats(0.01, 0.99)
discounts = st.floats(0.0, 0.999)
ordinary_errors = st.one_of(st.just(0.0), st.floats(1e-3, 1e3), st.floats(-1e3, -1e-3))
error_lists = st.lists(ordinary_errors, min_size=1, max_size=30)
#: Far beyond what any rewards give
extreme_errors = st.lists(st.floats(-1e100, 1e100), min_size=1, max_size=20)

NAMES = list(STEP_SIZES)
#: These two are in units of the table, and exceed 1 where the errors are small
UNBOUNDED = ("rmsprop", "adagrad")
SCALE_FREE = ("constant", "polynomial", "harmonic", "unbiased_constant", "bakf", "autostep", "delta_bar_delta", "trigg")
SCALE_FREE += ("mcclain", "kesten", "horizon", "rescaled_linear", "search_then_converge")
#: With this parameter at 0 the step size stays at alpha_0
CONSTANT_WITHOUT = (
    ("autostep", {"meta_step_size": 0.0}),
    ("benveniste", {"nu": 0.0, "lower": 0.0}),
    ("delta_bar_delta", {"kappa": 0.0, "phi": 0.0}),
    ("idbd", {"theta": 0.0}),
    ("k1", {"theta": 0.0}),
    ("swift_td", {"theta": 0.0}),
)


def law(**strategies: st.SearchStrategy[Any]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Check a property on a few dozen examples."""

    def decorate(test: Callable[..., None]) -> Callable[..., None]:
        return settings(max_examples=25)(given(**strategies)(test))

    return decorate


def weights_of(sizes: np.ndarray) -> np.ndarray:
    """How much of each target is in the last estimate: its step size, times one minus every later one."""
    return np.array([size * np.prod(1.0 - sizes[place + 1 :]) for place, size in enumerate(sizes)])


def sizes_against_the_trace(name: str, error: float, updates: int, **parameters: float) -> np.ndarray:
    """The step sizes of updates whose errors are all of one size, and of the sign that the trace does not have."""
    cell = Cell(name, **parameters)
    return np.array([cell.form(-math.copysign(error, cell.memory["trace"][0, 0])) for _ in range(updates)])


class TestAll:
    @pytest.mark.parametrize("name", NAMES)
    @law(errors=extreme_errors)
    def test_it_is_a_share_whatever_the_errors(self, name: str, errors: list[float]) -> None:
        with np.errstate(over="ignore", invalid="ignore"):
            sizes = sizes_of(name, errors)
        assert (sizes >= 0.0).all()
        if name not in UNBOUNDED:
            assert (sizes <= 1.0).all()
        step_size = STEP_SIZES[name]
        clipped = [clip_size(size, step_size.lower, step_size.upper) for size in sizes]
        assert all(0.0 <= size <= 1.0 for size in clipped)

    @pytest.mark.parametrize("name", NAMES)
    def test_errors_of_zero_make_a_number(self, name: str) -> None:
        assert np.isfinite(sizes_of(name, [0.0] * 5 + [1.0, 0.0])).all()

    @pytest.mark.parametrize("name", SCALE_FREE)
    @law(errors=error_lists, exponent=st.integers(-60, 60))
    def test_the_unit_of_the_rewards_does_not_matter(self, name: str, errors: list[float], exponent: int) -> None:
        """A power of 2 is the unit, which rounds nothing: the bits are the same."""
        scaled = [2.0**exponent * error for error in errors]
        assert np.array_equal(sizes_of(name, errors), sizes_of(name, scaled))

    @pytest.mark.parametrize("name", ["bakf", "autostep", "trigg"])
    @law(errors=error_lists, unit=st.floats(1e-3, 1e3))
    def test_nor_does_a_unit_that_rounds(self, name: str, errors: list[float], unit: float) -> None:
        scaled = [unit * error for error in errors]
        np.testing.assert_allclose(sizes_of(name, scaled), sizes_of(name, errors), rtol=1e-6, atol=1e-6)

    @pytest.mark.parametrize(("name", "parameters"), CONSTANT_WITHOUT)
    @law(errors=error_lists, alpha_0=inner_shares)
    def test_it_is_constant_without_its_meta_step_size(
        self, name: str, parameters: dict[str, float], errors: list[float], alpha_0: float
    ) -> None:
        np.testing.assert_allclose(sizes_of(name, errors, alpha_0=alpha_0, **parameters), alpha_0, rtol=1e-13)

    @pytest.mark.parametrize("name", NAMES)
    def test_a_cell_is_changed_alone(self, name: str) -> None:
        """Of arrays with several cells, a step size changes the one that ``row`` and ``column`` name."""
        step_size = STEP_SIZES[name]
        cell = Cell(name)
        arrays = [np.full((3, 2), start) for start in step_size.start_values(cell.parameters).values()]
        before = [array.copy() for array in arrays]
        for count, error in enumerate([1.0, -2.0, 3.0], start=1):
            step = make_step(error, float(count), row=2, column=1)
            assert step_size.step_size(0.0, step, *cell.parameters.values(), *arrays) == cell.form(error)
        for array, old, single in zip(arrays, before, cell.memory.values(), strict=True):
            assert array[2, 1] == single[0, 0]
            array[2, 1] = old[2, 1]
            assert np.array_equal(array, old)


class TestClip:
    @law(size=st.floats(allow_nan=False), bounds=st.tuples(shares, shares).map(sorted))
    def test_it_stays_within_the_bounds(self, size: float, bounds: list[float]) -> None:
        assert clip_size(size, *bounds) == sorted([size, *bounds])[1]

    def test_what_is_not_a_number_stays_so(self) -> None:
        assert math.isnan(clip_size(math.nan, 0.0, 1.0))


class TestHarmonic:
    @law(alpha_0=shares, a=st.floats(0.5, 1e4))
    def test_it_starts_at_its_first_value_and_is_half_of_it_after_a_updates(self, alpha_0: float, a: float) -> None:
        assert sizes_of("harmonic", [0.0], alpha_0=alpha_0, a=a)[0] == pytest.approx(alpha_0, rel=1e-14)
        function = STEP_SIZES["harmonic"].step_size
        assert function(0.0, make_step(count=a + 1.0), alpha_0, a) == pytest.approx(alpha_0 / 2.0)

    @law(targets=error_lists, start=ordinary_errors)
    def test_one_over_n_is_the_sample_mean(self, targets: list[float], start: float) -> None:
        values, sizes = estimate("harmonic", targets, start)
        assert sizes == pytest.approx(1.0 / np.arange(1, len(targets) + 1))
        assert values[-1] == pytest.approx(np.mean(targets), abs=1e-9)

    @law(alpha_0=shares)
    def test_a_large_a_makes_it_constant(self, alpha_0: float) -> None:
        assert sizes_of("harmonic", [0.0] * 50, alpha_0=alpha_0, a=1e12) == pytest.approx(alpha_0)

    @law(alpha_0=shares, a=st.floats(1.0, 50.0))
    def test_its_sum_grows_without_end_and_that_of_its_squares_does_not(self, alpha_0: float, a: float) -> None:
        """From n to 2n the sum grows by about alpha_0 a ln 2; the squares stay below an integral."""
        sizes = sizes_of("harmonic", [0.0] * 400, alpha_0=alpha_0, a=a)
        assert sizes[200:].sum() >= alpha_0 * a * math.log((a + 400.0) / (a + 200.0))
        assert (sizes**2).sum() <= alpha_0**2 * (1.0 + a)


class TestPolynomial:
    @law(omega=st.floats(0.05, 1.0))
    def test_it_falls_from_1_between_1_over_n_and_1(self, omega: float) -> None:
        sizes = sizes_of("polynomial", [0.0] * 50, omega=omega)
        assert sizes[0] == 1.0
        assert (np.diff(sizes) < 0.0).all()
        assert (sizes >= 1.0 / np.arange(1, 51) * (1.0 - 1e-14)).all()
        assert np.log(sizes[1:]) / np.log(np.arange(2, 51)) == pytest.approx(-omega)

    def test_omega_1_is_one_over_n(self) -> None:
        assert sizes_of("polynomial", [0.0] * 50, omega=1.0) == pytest.approx(1.0 / np.arange(1, 51))


class TestSearchThenConverge:
    parameters = st.fixed_dictionaries({"alpha_0": st.floats(0.1, 1.0), "c": st.floats(0.5, 5.0)})

    @law(parameters=parameters, tau=st.floats(10.0, 1e3))
    def test_its_two_ends(self, parameters: dict[str, float], tau: float) -> None:
        assert sizes_of("search_then_converge", [0.0], tau=tau, **parameters)[0] == parameters["alpha_0"]
        early = sizes_of("search_then_converge", [0.0] * 20, tau=1e9, **parameters)
        assert early == pytest.approx(parameters["alpha_0"], rel=1e-4)
        function = STEP_SIZES["search_then_converge"].step_size
        late = function(0.0, make_step(count=1e9), parameters["alpha_0"], parameters["c"], tau)
        assert late == pytest.approx(parameters["c"] / 1e9, rel=1e-3)


class TestUnbiasedConstant:
    @law(alpha=inner_shares)
    def test_its_closed_form(self, alpha: float) -> None:
        n = np.arange(1, 61)
        sizes = sizes_of("unbiased_constant", [0.0] * 60, alpha=alpha)
        assert sizes == pytest.approx(alpha / (1.0 - (1.0 - alpha) ** n), rel=1e-10)
        assert sizes[0] == 1.0

    @law(targets=error_lists, start=ordinary_errors, alpha=inner_shares)
    def test_the_estimate_is_the_normalised_exponential_mean(self, targets: list[float], start: float, alpha: float) -> None:
        """Whatever the table started from."""
        weights = (1.0 - alpha) ** np.arange(len(targets))[::-1]
        values, _ = estimate("unbiased_constant", targets, start, alpha=alpha)
        assert values[-1] == pytest.approx(np.average(targets, weights=weights), abs=1e-8)


class TestHorizon:
    @law(horizon=st.floats(0.0, 200.0), gamma=discounts)
    def test_the_first_is_1_and_a_horizon_of_0_is_one_over_n(self, horizon: float, gamma: float) -> None:
        assert sizes_of("horizon", [0.0], gamma, horizon=horizon)[0] == 1.0
        assert sizes_of("horizon", [0.0] * 9, gamma, horizon=0.0) == pytest.approx(1.0 / np.arange(1, 10))

    @law(horizon=st.integers(1, 30), n=st.integers(1, 120))
    def test_the_weights_of_the_targets(self, horizon: int, n: int) -> None:
        """Lemma of Jin et al. (2018): what the step sizes make of n targets."""
        weights = weights_of(sizes_of("horizon", [0.0] * n, horizon=float(horizon)))
        assert weights.sum() == pytest.approx(1.0)
        assert weights.max() <= 2.0 * horizon / n * (1.0 + 1e-12)
        assert (weights**2).sum() <= 2.0 * horizon / n * (1.0 + 1e-12)
        mean = (weights / np.sqrt(np.arange(1, n + 1))).sum()
        assert 1.0 / math.sqrt(n) * (1.0 - 1e-12) <= mean <= 2.0 / math.sqrt(n) * (1.0 + 1e-12)

    @law(horizon=st.integers(2, 10), place=st.integers(1, 5))
    def test_a_target_counts_1_plus_1_over_h_in_all(self, horizon: int, place: int) -> None:
        """The weight of one target, summed over all estimates from its own on: the rest after 2000 is below 1e-4."""
        sizes = sizes_of("horizon", [0.0] * 2000, horizon=float(horizon))[place - 1 :]
        weights = sizes[0] * np.cumprod(np.append(1.0, 1.0 - sizes[1:]))
        assert weights.sum() == pytest.approx(1.0 + 1.0 / horizon, abs=1e-4)

    @law(multiple=st.floats(0.01, 20.0), gamma=discounts)
    def test_a_negative_horizon_is_a_multiple_of_the_discounts(self, multiple: float, gamma: float) -> None:
        of_the_discount = sizes_of("horizon", [0.0] * 9, gamma, horizon=-multiple)
        assert of_the_discount == pytest.approx(sizes_of("horizon", [0.0] * 9, horizon=multiple / (1.0 - gamma)))

    @law(gamma=discounts)
    def test_its_default_is_the_discounts_horizon(self, gamma: float) -> None:
        n = np.arange(1, 30)
        expected = (1.0 + (1.0 - gamma)) / (1.0 + (1.0 - gamma) * n)
        assert sizes_of("horizon", [0.0] * 29, gamma) == pytest.approx(expected)

    @pytest.mark.parametrize("parameters", [{}, {"horizon": -0.03}])
    def test_without_discounting_it_stays_1(self, parameters: dict[str, float]) -> None:
        assert (sizes_of("horizon", [0.0] * 20, gamma=1.0, **parameters) == 1.0).all()


class TestRescaledLinear:
    @law(gamma=discounts)
    def test_it_is_of_the_horizons_family(self, gamma: float) -> None:
        """With H = γ / (1 - γ)."""
        sizes = sizes_of("rescaled_linear", [0.0] * 30, gamma)
        assert sizes[0] == 1.0
        assert sizes == pytest.approx(sizes_of("horizon", [0.0] * 30, gamma, horizon=gamma / (1.0 - gamma)))

    def test_its_two_ends(self) -> None:
        assert sizes_of("rescaled_linear", [0.0] * 9, gamma=0.0) == pytest.approx(1.0 / np.arange(1, 10))
        assert (sizes_of("rescaled_linear", [0.0] * 9, gamma=1.0) == 1.0).all()


class TestMcClain:
    def test_a_target_of_0_is_one_over_n(self) -> None:
        assert sizes_of("mcclain", [0.0] * 100, target=0.0) == pytest.approx(1.0 / np.arange(1, 101), rel=1e-13)

    @law(alpha_0=shares, target=st.floats(0.05, 1.0))
    def test_it_tends_to_the_target_from_either_side(self, alpha_0: float, target: float) -> None:
        assume(abs(alpha_0 - target) > 1e-3)
        sizes = sizes_of("mcclain", [0.0] * 400, alpha_0=alpha_0, target=target)
        assert sizes[0] == alpha_0
        far = sizes[np.abs(sizes - target) > 1e-9]
        assert (np.diff(far) * (target - alpha_0) > 0.0).all()
        assert ((far - target) * (alpha_0 - target) > 0.0).all()
        assert sizes[-1] == pytest.approx(target, rel=1e-6)

    @law(target=shares)
    def test_the_target_is_a_fixed_point(self, target: float) -> None:
        assert sizes_of("mcclain", [0.0] * 20, alpha_0=target, target=target) == pytest.approx(target, rel=1e-14)


class TestKesten:
    @law(errors=error_lists, a=st.floats(0.5, 20.0))
    def test_it_never_falls_faster_than_harmonic(self, errors: list[float], a: float) -> None:
        assert (sizes_of("kesten", errors, a=a) >= sizes_of("harmonic", errors, a=a)).all()

    @law(sizes=st.lists(st.floats(1e-200, 1e3), min_size=2, max_size=30), sign=st.sampled_from([-1.0, 1.0]))
    def test_signs(self, sizes: list[float], sign: float) -> None:
        """Errors of one sign, and zeros among them, hold it after the second; alternating ones make it harmonic."""
        steady = [sign * size for size in sizes]
        held = sizes_of("kesten", [*steady, 0.0, *steady])
        assert (held[1:] == held[1]).all()
        alternating = [size * (-1.0) ** i for i, size in enumerate(steady)]
        assert np.array_equal(sizes_of("kesten", alternating), sizes_of("harmonic", sizes, a=10.0))


class TestTrigg:
    @law(sizes=st.lists(st.floats(1e-3, 1e3), min_size=1, max_size=30), sign=st.sampled_from([-1.0, 1.0]), phi=shares)
    def test_it_is_1_until_the_sign_changes(self, sizes: list[float], sign: float, phi: float) -> None:
        formed = sizes_of("trigg", [0.0, *(sign * size for size in sizes), -sign * 1e-3], phi=phi)
        assert (formed[:-1] == 1.0).all()
        assert formed[-1] < 1.0 or phi == 1.0


class TestBakf:
    @law(errors=error_lists, nu_target=st.floats(0.0, 0.5))
    def test_it_is_at_least_what_the_variance_alone_gives(self, errors: list[float], nu_target: float) -> None:
        """λ / (1 + λ), of the λ before the update."""
        cell = Cell("bakf", nu_target=nu_target)
        for error in errors:
            factor = cell.memory["variance_factor"][0, 0]
            size = cell.form(error)
            assert size >= factor / (1.0 + factor) - 1e-12
            assert cell.memory["variance_factor"][0, 0] == pytest.approx((1.0 - size) ** 2 * factor + size**2)

    @law(error=st.floats(1e-3, 1e3), nu_target=st.floats(0.0, 0.5))
    def test_without_bias_it_is_one_over_n(self, error: float, nu_target: float) -> None:
        """The second error cancels the first one in the smoothed error, and no others follow."""
        nu = 1.0 / (2.0 - nu_target)
        sizes = sizes_of("bakf", [error, -error * (1.0 - nu) / nu] + [0.0] * 40, nu_target=nu_target)
        assert sizes == pytest.approx(1.0 / np.arange(1, 43), rel=1e-6)

    @law(error=st.floats(1e-3, 1e3))
    def test_without_variance_it_is_1(self, error: float) -> None:
        sizes = sizes_of("bakf", [error] * 30)
        assert sizes[:2] == pytest.approx([1.0, 0.5])
        assert sizes[2:] == pytest.approx(1.0)

    @law(errors=error_lists)
    def test_its_other_print(self, errors: list[float]) -> None:
        """1 - σ² / ((1 + λ) σ² + b²), as George and Powell (2006) also write it."""
        cell = Cell("bakf")
        for n, error in enumerate(errors, start=1):
            factor = float(cell.memory["variance_factor"][0, 0])
            size = cell.form(error)
            bias, mean_square = (float(cell.memory[name][0, 0]) for name in ("bias", "mean_square"))
            variance = max(mean_square - bias**2, 0.0) / (1.0 + factor)
            if n > 2 and mean_square > 0.0:
                assert size == pytest.approx(1.0 - variance / ((1.0 + factor) * variance + bias**2), rel=1e-6, abs=1e-9)


class TestDeltaBarDelta:
    @law(kappa=inner_shares, phi=inner_shares, theta=inner_shares, alpha_0=shares)
    def test_up_by_an_amount_down_by_a_share(self, kappa: float, phi: float, theta: float, alpha_0: float) -> None:
        parameters = {"kappa": kappa, "phi": phi, "theta": theta, "alpha_0": alpha_0}
        sizes = sizes_of("delta_bar_delta", [2.0, 3.0, 0.0, -1e6, 1e12], **parameters)
        raised = min(alpha_0 + kappa, 1.0)
        expected = [alpha_0, raised, raised, raised * (1.0 - phi), raised * (1.0 - phi) * (1.0 - phi)]
        assert sizes == pytest.approx(expected)


class TestBenveniste:
    @law(targets=error_lists, alpha_0=st.floats(0.05, 0.9))
    def test_its_trace_is_the_derivative_of_the_estimate(self, targets: list[float], alpha_0: float) -> None:
        """Against a central difference of the estimates that two constant step sizes give."""
        cell, value = Cell("benveniste", alpha_0=alpha_0, nu=0.0), 0.0
        for target in targets:
            error = target - value
            value += cell.form(error) * error
        low, high = (estimate("constant", targets, alpha=alpha_0 + move)[0][-1] for move in (-1e-6, 1e-6))
        scale = 1.0 + max(map(abs, targets))
        assert cell.memory["derivative"][0, 0] == pytest.approx((high - low) / 2e-6, rel=1e-4, abs=1e-4 * scale)

    @law(errors=error_lists, bounds=st.tuples(shares, shares).map(sorted), nu=st.floats(1e-6, 1e3))
    def test_it_stays_within_its_bounds(self, errors: list[float], bounds: list[float], nu: float) -> None:
        sizes = sizes_of("benveniste", errors, nu=nu, lower=bounds[0], upper=bounds[1])
        assert (sizes >= bounds[0]).all()
        assert (sizes <= bounds[1]).all()


class TestObgd:
    @law(error=st.floats(-1e6, 1e6), alpha=shares, kappa=st.floats(0.1, 500.0))
    def test_no_update_changes_the_table_by_more_than_one_over_kappa(self, error: float, alpha: float, kappa: float) -> None:
        size = sizes_of("obgd", [error], alpha=alpha, kappa=kappa)[0]
        assert abs(size * error) <= 1.0 / kappa * (1.0 + 1e-12)
        assert size <= alpha
        if abs(error) <= 1.0:
            assert size == pytest.approx(min(alpha, 1.0 / kappa))


class TestIdbd:
    @law(errors=error_lists, theta=st.floats(1e-6, 1e6))
    def test_its_guards(self, errors: list[float], theta: float) -> None:
        cell = Cell("idbd", theta=theta)
        for error in errors:
            before = cell.memory["log_size"][0, 0]
            size = cell.form(error)
            after = cell.memory["log_size"][0, 0]
            assert abs(after - before) <= 2.0 * (1.0 + 1e-15)
            assert -10.0 <= after <= 0.0
            assert math.exp(-10.0) <= size <= 1.0

    def test_every_guard_binds(self) -> None:
        """Errors of one sign drive it up to 1, those against the trace down to e^-10; two units of the logarithm at a time."""
        up = sizes_of("idbd", [1e3] * 6, theta=1.0, alpha_0=math.exp(-9.0))
        assert np.log(up) == pytest.approx([-9.0, -7.0, -5.0, -3.0, -1.0, 0.0])
        down = sizes_against_the_trace("idbd", 1e6, 7, theta=1.0, alpha_0=0.4)
        assert np.log(down) == pytest.approx([max(math.log(0.4) - 2.0 * n, -10.0) for n in range(7)])

    @law(errors=error_lists, exponent=st.integers(-20, 20))
    def test_theta_is_in_units_of_one_over_the_squared_error(self, errors: list[float], exponent: int) -> None:
        unit = 2.0**exponent
        scaled = sizes_of("idbd", [unit * error for error in errors], theta=0.01 / unit**2)
        assert np.array_equal(scaled, sizes_of("idbd", errors, theta=0.01))

    def test_it_is_not_scale_free(self) -> None:
        assert sizes_of("idbd", [1.0, 1.0])[1] != sizes_of("idbd", [2.0, 2.0])[1]


class TestK1:
    @law(errors=error_lists, theta=st.floats(0.0, 1.0), alpha_0=inner_shares)
    def test_it_is_idbd_through_a_logistic_function(self, errors: list[float], theta: float, alpha_0: float) -> None:
        """Between 0 and 1, which it reaches by rounding alone; the first is alpha_0."""
        cell = Cell("k1", theta=theta, alpha_0=alpha_0)
        for n, error in enumerate(errors):
            before, trace = (float(cell.memory[name][0, 0]) for name in ("log_gain", "trace"))
            size = cell.form(error)
            log_gain = float(cell.memory["log_gain"][0, 0])
            assert log_gain == pytest.approx(before + theta * error * trace)
            assert 0.0 < size < 1.0 or abs(log_gain) > 36.0
            if abs(log_gain) < 30.0:
                assert math.log(size / (1.0 - size)) == pytest.approx(log_gain, rel=1e-3, abs=1e-9)
            if n == 0:
                assert size == pytest.approx(alpha_0)


class TestAutostep:
    @law(errors=error_lists, meta=st.floats(0.0, 1.0), tau=st.floats(1.0, 1e5), alpha_0=shares)
    def test_one_update_moves_its_logarithm_by_at_most_the_meta_step_size(
        self, errors: list[float], meta: float, tau: float, alpha_0: float
    ) -> None:
        sizes = sizes_of("autostep", errors, meta_step_size=meta, tau=tau, alpha_0=alpha_0)
        assert (np.abs(np.diff(np.log([alpha_0, *sizes]))) <= meta + 1e-12).all()

    def test_the_normaliser_follows_the_largest_change(self) -> None:
        """By hand, with a meta step size of 0: h is 1, then 1.5; |δ h| is 0, 2, 0.75."""
        cell = Cell("autostep", alpha_0=0.5, meta_step_size=0.0, tau=1.0)
        normalizers = []
        for error in (2.0, 2.0, 0.5):
            cell.form(error)
            normalizers.append(cell.memory["normalizer"][0, 0])
        assert normalizers == [0.0, 2.0, 2.0 + 0.5 * (0.75 - 2.0)]


class TestSwiftTd:
    @law(errors=error_lists, theta=st.floats(1e-6, 1e3), eta=shares, alpha_0=shares)
    def test_its_bounds(self, errors: list[float], theta: float, eta: float, alpha_0: float) -> None:
        cell = Cell("swift_td", theta=theta, eta=eta, alpha_0=alpha_0)
        for error in errors:
            assert LEAST_SIZE * (1.0 - 1e-12) <= cell.form(error) <= eta
            assert math.log(LEAST_SIZE) <= cell.memory["log_size"][0, 0] <= math.log(eta)

    def test_its_cap_and_floor_bind(self) -> None:
        """Where e^(ln η) lies above η, by rounding, the cap is η itself."""
        eta = next(n / 100.0 for n in range(1, 100) if math.exp(math.log(n / 100.0)) > n / 100.0)
        assert sizes_of("swift_td", [1.0] * 10, theta=1.0, eta=eta, alpha_0=eta / 2.0)[-1] == eta
        down = sizes_against_the_trace("swift_td", 1.0, 4, theta=1e3, alpha_0=0.1)
        assert down == pytest.approx([0.1, 0.1, LEAST_SIZE, LEAST_SIZE])
        assert sizes_of("swift_td", [1.0], alpha_0=0.8, eta=0.5)[0] == pytest.approx(0.5)

    @law(
        moves=st.lists(st.integers(1, 3), min_size=1, max_size=40),
        rewards=st.lists(st.floats(-3.0, 3.0), min_size=40, max_size=40),
        theta=st.floats(1e-4, 0.1),
        eta=st.floats(0.1, 1.0),
    )
    def test_it_is_the_trace_form_with_one_hot_features(
        self, moves: list[int], rewards: list[float], theta: float, eta: float
    ) -> None:
        """On walks without self-transitions, where the publication's trace h is not one update old."""
        states = np.cumsum([0, *moves]) % 4
        parameters = {"alpha_0": 0.1, "theta": theta, "eta": eta}
        cells, values = [Cell("swift_td", **parameters) for _ in range(4)], np.zeros(4)
        for state, next_state, reward in zip(states, states[1:], rewards, strict=False):
            error = reward + 0.9 * values[next_state] - values[state]
            values[state] += cells[state].form(error) * error
        weights, log_sizes = swift_td_with_traces(states, rewards, **parameters)
        assert values == pytest.approx(weights, abs=1e-9)
        assert [cell.memory["log_size"][0, 0] for cell in cells] == pytest.approx(log_sizes, abs=1e-9)


def swift_td_with_traces(
    states: np.ndarray, rewards: Sequence[float], alpha_0: float, theta: float, eta: float
) -> tuple[np.ndarray, np.ndarray]:
    """
    SwiftTD with traces, for one-hot features of four states, γ = 0.9, λ = 0, and no decay of step sizes, which needs
    features that overlap. Returns the weights and the logarithms of the step sizes.
    """
    gamma, trace_decay = 0.9, 0.0
    weights, log_sizes = np.zeros(4), np.full(4, math.log(min(alpha_0, eta)))
    trace, newest, trace_of_h, trace_of_step = np.zeros((4, 4))
    h = h_before = h_ahead = np.zeros(4)
    value_before = overlap = 0.0
    for time, state in enumerate(states):
        features = np.eye(4)[state]
        value = weights @ features
        change = np.zeros(4)
        if time > 0:
            error = rewards[time - 1] + gamma * value - value_before
            change = error * trace - newest * overlap
            weights = weights + change
            log_sizes = log_sizes + theta / np.exp(log_sizes) * (error - overlap) * trace_of_h
            log_sizes = np.minimum(log_sizes, math.log(eta))
            h_before, h = h, h_ahead + error * trace_of_step - newest * overlap
            trace, trace_of_h, trace_of_step = (gamma * trace_decay * each for each in (trace, trace_of_h, trace_of_step))
        overlap = change @ features
        marked = trace @ features
        newest = np.exp(log_sizes) * features
        trace = trace + newest * (1.0 - marked)
        trace_of_h = trace_of_h + h_before * features
        trace_of_step = trace_of_step + newest * (1.0 - marked - trace_of_step * features)
        h_ahead = h - h_before * features * (trace - newest) - h * newest * features
        value_before = value
    return weights, log_sizes


class TestBaselines:
    @law(errors=error_lists, exponent=st.integers(-8, 8))
    @pytest.mark.parametrize("name", UNBOUNDED)
    def test_the_parameter_alpha_has_the_unit_of_the_table(self, name: str, errors: list[float], exponent: int) -> None:
        assume(errors[0] != 0.0)
        unit = 2.0**exponent
        scaled = sizes_of(name, [unit * error for error in errors], alpha=0.1 * unit, epsilon=1e-30)
        assert scaled == pytest.approx(sizes_of(name, errors, alpha=0.1, epsilon=1e-30))

    @pytest.mark.parametrize(("name", "first"), [("rmsprop", 0.1 / math.sqrt(1e-8)), ("adagrad", 0.1 / 1e-8)])
    def test_an_error_of_zero_exceeds_1(self, name: str, first: float) -> None:
        assert sizes_of(name, [0.0])[0] == pytest.approx(first)
