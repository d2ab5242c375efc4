"""
Step sizes that follow from the number of updates alone, whatever the errors are.

Throughout, n = ``step.count`` is the number of updates of the cell, this one included.
"""

from sb3_adaptive_q.step_sizes.step import Memory, Parameter, Step, StepSize, cell_of, first_step_size


def constant(mu: float, step: Step, alpha: float) -> float:
    """
    A constant. It follows a moving target, and never settles where the targets are random.

    :param mu: unused
    :param step: unused
    :param alpha: the step size
    :return: α
    """
    return alpha


CONSTANT = StepSize(
    name="constant",
    step_size=constant,
    parameters={"alpha": Parameter(0.1, 0.0, 1.0, "the step size")},
    memory={},
    counts=False,
    formula="μ = α",
    source="Sutton, Barto 2018",
)


def generalised_harmonic(n: float, alpha_0: float, a: float) -> float:
    """
    The harmonic sequence that falls to half its first value at n = a + 1.

    :param n: the place in the sequence, from 1
    :param alpha_0: the first value
    :param a: how slowly it falls, above 0
    :return: α₀ a / (a + n - 1)
    """
    return alpha_0 * a / (a + n - 1.0)


def harmonic(mu: float, step: Step, alpha_0: float, a: float) -> float:
    """
    The generalised harmonic step size (Powell 2011). With α₀ = a = 1 it is 1/n, which makes the table the sample mean.

    :param mu: unused
    :param step: its ``count`` is n
    :param alpha_0: the first step size
    :param a: how slowly it falls
    :return: α₀ a / (a + n - 1)
    """
    return generalised_harmonic(step.count, alpha_0, a)


HARMONIC = StepSize(
    name="harmonic",
    step_size=harmonic,
    parameters={
        "alpha_0": first_step_size(1.0),
        "a": Parameter(1.0, 0.0, float("inf"), "half the first step size is reached at n = a + 1", open_lower=True),
    },
    memory={},
    counts=True,
    formula="μ = α₀ a / (a + n - 1)",
    source="Powell 2011",
)


def polynomial(mu: float, step: Step, omega: float) -> float:
    """
    The polynomial step size of Even-Dar and Mansour (2003), who prove convergence for 1/2 < ω <= 1.

    :param mu: unused
    :param step: its ``count`` is n
    :param omega: the exponent ω
    :return: 1 / n^ω
    """
    return 1.0 / step.count**omega


POLYNOMIAL = StepSize(
    name="polynomial",
    step_size=polynomial,
    parameters={
        "omega": Parameter(0.8, 0.0, 1.0, "the exponent ω; convergence is proved above 1/2 only", open_lower=True),
    },
    memory={},
    counts=True,
    formula="μ = 1 / n^ω",
    source="Even-Dar, Mansour 2003",
)


def search_then_converge(mu: float, step: Step, alpha_0: float, c: float, tau: float) -> float:
    """
    Search, then converge (Darken, Chang and Moody 1992): near α₀ while n is far below τ, near c/n far above it.

    :param mu: unused
    :param step: its ``count`` is n
    :param alpha_0: the first step size
    :param c: the numerator of the step size in the long run
    :param tau: the number of updates about which the search ends
    :return: α₀ (1 + x) / (1 + x + τ u²), with u = (n - 1) / τ and x = c u / α₀
    """
    time = (step.count - 1.0) / tau
    rise = c / alpha_0 * time
    return alpha_0 * (1.0 + rise) / (1.0 + rise + tau * time * time)


SEARCH_THEN_CONVERGE = StepSize(
    name="search_then_converge",
    step_size=search_then_converge,
    parameters={
        "alpha_0": first_step_size(0.5),
        "c": Parameter(1.0, 0.0, float("inf"), "the step size tends to c / n"),
        "tau": Parameter(100.0, 0.0, float("inf"), "the number of updates about which the search ends", open_lower=True),
    },
    memory={},
    counts=True,
    formula="μ = α₀ (1 + x) / (1 + x + τ u²), u = (n - 1) / τ, x = c u / α₀",
    source="Darken, Chang, Moody 1992",
)


def unbiased_constant(mu: float, step: Step, alpha: float, weight: Memory) -> float:
    """
    A constant without the bias of the start (Sutton and Barto 2018): the table becomes the exponentially weighted mean of
    the targets alone. The first step size is 1, and they fall to α.

    :param mu: unused
    :param step: names the cell
    :param alpha: the step size in the long run
    :param weight: the sum o of the weights of all targets so far
    :return: α / o, after o ← o + α (1 - o)
    """
    cell = cell_of(step)
    weight[cell] += alpha * (1.0 - weight[cell])
    return alpha / weight[cell]


UNBIASED_CONSTANT = StepSize(
    name="unbiased_constant",
    step_size=unbiased_constant,
    parameters={"alpha": Parameter(0.1, 0.0, 1.0, "the step size in the long run", open_lower=True)},
    memory={"weight": 0.0},
    counts=False,
    formula="o ← o + α (1 - o), μ = α / o",
    source="Sutton, Barto 2018",
)


def horizon(mu: float, step: Step, horizon: float) -> float:
    """
    The step size of Q-learning with a horizon of H steps (Jin, Allen-Zhu, Bubeck and Jordan 2018). With discounting, the
    horizon is 1 / (1 - γ).

    :param mu: unused
    :param step: its ``count`` is n, its ``gamma`` γ
    :param horizon: H, where it is not negative; -k stands for H = k / (1 - γ), which is infinite at γ = 1
    :return: (H + 1) / (H + n)
    """
    if horizon >= 0.0:
        return (horizon + 1.0) / (horizon + step.count)
    # Both terms of the fraction times 1 - γ, so that an infinite horizon gives its limit, 1
    unit = 1.0 - step.gamma
    return (unit - horizon) / (unit * step.count - horizon)


HORIZON = StepSize(
    name="horizon",
    step_size=horizon,
    parameters={
        "horizon": Parameter(-1.0, -float("inf"), float("inf"), "H, in steps; -k stands for k / (1 - γ)"),
    },
    memory={},
    counts=True,
    formula="μ = (H + 1) / (H + n)",
    source="Jin, Allen-Zhu, Bubeck, Jordan 2018",
)


def rescaled_linear(mu: float, step: Step) -> float:
    """
    The rescaled linear step size (Wainwright 2019). The publication's index begins one later than n: here the first step
    size is 1, so that the initial table is forgotten.

    :param mu: unused
    :param step: its ``count`` is n, its ``gamma`` γ
    :return: 1 / (1 + (1 - γ) (n - 1))
    """
    return 1.0 / (1.0 + (1.0 - step.gamma) * (step.count - 1.0))


RESCALED_LINEAR = StepSize(
    name="rescaled_linear",
    step_size=rescaled_linear,
    parameters={},
    memory={},
    counts=True,
    formula="μ = 1 / (1 + (1 - γ) (n - 1))",
    source="Wainwright 2019",
)
