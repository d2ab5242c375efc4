"""How estimates converge and track, against closed forms and known optima."""

import math
from typing import NamedTuple

import numpy as np
import pytest
from helpers.one_cell import Cell, estimate, sizes_of

#: A mean of N correlated squares is compared with its expectation by the t statistic of so many batch means
N_BATCHES = 50
#: Its bound: Student's t with 49 degrees of freedom exceeds 5 with a probability of 8e-6
T_BOUND = 5.0


def assert_mean(samples: np.ndarray, expected: float) -> None:
    """Fail where the mean of a stationary sequence is not the expected one; a true expectation fails with 8e-6."""
    batches = samples[: len(samples) // N_BATCHES * N_BATCHES].reshape(N_BATCHES, -1).mean(axis=1)
    error = batches.std(ddof=1) / math.sqrt(N_BATCHES)
    assert abs(batches.mean() - expected) < T_BOUND * error
    assert error < 0.05 * expected, "too few samples to say anything"


class TestOneState:
    """One state, reward 0, a first value of 1: the lower bound of Even-Dar and Mansour (2003). The value is the error."""

    def values(self, name: str, updates: int, gamma: float, **parameters: float) -> np.ndarray:
        cell, value, values = Cell(name, gamma, **parameters), 1.0, []
        for _ in range(updates):
            error = gamma * value - value
            value += cell.form(error) * error
            values.append(value)
        return np.array(values)

    @pytest.mark.parametrize("gamma", [0.5, 0.9, 0.99])
    def test_one_over_n(self, gamma: float) -> None:
        """Γ(n + γ) / (Γ(γ) n!), which is near n^-(1 - γ) / Γ(γ): polynomially slow."""
        values = self.values("harmonic", 20_000, gamma)
        for n in (1, 2, 10, 1000, 20_000):
            closed = math.exp(math.lgamma(n + gamma) - math.lgamma(gamma) - math.lgamma(n + 1.0))
            assert values[n - 1] == pytest.approx(closed, rel=1e-9)
        assert values[-1] == pytest.approx(20_000 ** (gamma - 1.0) / math.gamma(gamma), rel=1e-4)

    @pytest.mark.parametrize("gamma", [0.5, 0.9, 0.99])
    def test_rescaled_linear(self, gamma: float) -> None:
        """The product of 1 - (1 - γ) μ telescopes to γ / (1 + (1 - γ) (n - 1))."""
        n = np.arange(1, 2001)
        assert self.values("rescaled_linear", 2000, gamma) == pytest.approx(gamma / (1.0 + (1.0 - gamma) * (n - 1)))

    @pytest.mark.parametrize("alpha", [0.1, 0.5, 1.0])
    def test_constant(self, alpha: float) -> None:
        n = np.arange(1, 201)
        assert self.values("constant", 200, 0.9, alpha=alpha) == pytest.approx((1.0 - alpha * 0.1) ** n)


class TestStationaryNoise:
    @pytest.mark.parametrize(("alpha", "gamma"), [(0.1, 0.0), (0.5, 0.0), (0.3, 0.8)])
    def test_the_variance_that_a_constant_step_size_leaves(self, alpha: float, gamma: float) -> None:
        """Q-learning in one state: α σ² / (u (2 - α u)), with u = 1 - γ; without a next state α σ² / (2 - α)."""
        noise, sigma = np.random.default_rng(3).normal(size=60_000), 2.0
        cell, value, values = Cell("constant", gamma, alpha=alpha), 0.0, []
        for reward in sigma * noise:
            error = reward + gamma * value - value
            value += cell.form(error) * error
            values.append(value)
        rest = 1.0 - gamma
        assert_mean(np.square(values[1000:]), alpha * sigma**2 / (rest * (2.0 - alpha * rest)))

    @pytest.mark.parametrize("name", ["harmonic", "polynomial", "kesten", "search_then_converge", "horizon"])
    def test_what_falls_converges_to_the_mean(self, name: str) -> None:
        """
        Of these Kesten's is the largest in the long run: 20/n, as every second error changes its sign. With a step size of
        c/n the estimate has a variance of c² / ((2 c - 1) n), here a deviation of 0.023. Five of them are allowed.
        """
        targets = 1.0 + np.random.default_rng(4).normal(size=20_000)
        values, sizes = estimate(name, targets, start=-5.0)
        assert abs(values[-1] - 1.0) < 5.0 * 0.023
        assert sizes[-1] < 0.02


#: The variance of what a drifting mean moves by; its targets have a variance of 1
DRIFT = 0.1
#: Muth's (1960) best constant step size, and the mean squared error that it leaves
BEST = 0.5 * (math.sqrt(DRIFT**2 + 4.0 * DRIFT) - DRIFT)
LEAST_ERROR = (BEST**2 + DRIFT) / (BEST * (2.0 - BEST))


class Drift(NamedTuple):
    """A drifting mean, of which a target each is seen."""

    means: np.ndarray
    targets: np.ndarray

    def squared_errors(self, name: str, **parameters: float) -> np.ndarray:
        """Of the estimate before each update, without the first quarter."""
        values, _ = estimate(name, self.targets, **parameters)
        return np.square(self.means[1:] - values[:-1])[len(values) // 4 :]


@pytest.fixture(scope="module")
def drift() -> Drift:
    generator = np.random.default_rng(5)
    means = np.cumsum(math.sqrt(DRIFT) * generator.normal(size=30_000))
    return Drift(means, means + generator.normal(size=30_000))


class TestDriftingMean:
    """
    Targets m + N(0, 1), where the mean m moves by N(0, q) before each. A constant step size a leaves a mean squared error
    of (a² + q) / (a (2 - a)), least at a* = (√(q² + 4 q) - q) / 2.
    """

    @pytest.mark.parametrize("factor", [0.3, 0.6, 1.0, 1.6, 3.0])
    def test_constant(self, drift: Drift, factor: float) -> None:
        a = factor * BEST
        errors = drift.squared_errors("constant", alpha=a)
        expected = (a**2 + DRIFT) / (a * (2.0 - a))
        assert_mean(errors, expected)
        assert expected >= LEAST_ERROR

    @pytest.mark.parametrize("name", ["autostep", "idbd", "k1", "benveniste", "swift_td"])
    def test_a_gradient_finds_the_best_step_size(self, drift: Drift, name: str) -> None:
        """From 0.1: the median within 10 % of a*, and the error within 3 % of that of a* on the same targets."""
        _, sizes = estimate(name, drift.targets, alpha_0=0.1)
        assert np.median(sizes[len(sizes) // 4 :]) == pytest.approx(BEST, rel=0.1)
        errors = drift.squared_errors(name, alpha_0=0.1)
        assert errors.mean() < 1.03 * drift.squared_errors("constant", alpha=BEST).mean()

    @pytest.mark.parametrize(("name", "bound"), [("bakf", 1.6), ("trigg", 1.4), ("delta_bar_delta", 1.4)])
    def test_what_looks_at_errors_tracks(self, drift: Drift, name: str, bound: float) -> None:
        assert drift.squared_errors(name).mean() < bound * LEAST_ERROR

    @pytest.mark.parametrize("name", ["harmonic", "polynomial", "kesten"])
    def test_what_falls_to_zero_does_not(self, drift: Drift, name: str) -> None:
        assert drift.squared_errors(name).mean() > 10.0 * LEAST_ERROR


class TestOneJump:
    @pytest.mark.parametrize("name", ["bakf", "trigg", "delta_bar_delta", "autostep"])
    def test_the_step_size_rises_after_it(self, name: str) -> None:
        """What looks at the sign of errors takes larger steps once the target has moved away by ten deviations."""
        targets = np.random.default_rng(6).normal(size=600)
        targets[500:] += 10.0
        _, sizes = estimate(name, targets)
        assert sizes[505:515].mean() >= sizes[480:500].mean() * 1.02

    def test_counts_do_not_notice(self) -> None:
        assert np.array_equal(sizes_of("polynomial", np.zeros(9)), sizes_of("polynomial", np.full(9, 1e6)))
