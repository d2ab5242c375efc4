"""
Step sizes that follow a gradient of the squared error with respect to themselves.

Throughout, δ = ``step.td_error`` is the temporal-difference error. Each of them keeps a trace: about the derivative of the
table's entry with respect to its step size, or to the logarithm of it.
"""

import math

from sb3_adaptive_q.step_sizes.step import (
    Memory,
    Parameter,
    Step,
    StepSize,
    cell_of,
    clip_size,
    first_step_size,
    starts_at_alpha_0,
    starts_at_log_alpha_0,
)


def benveniste(
    mu: float,
    step: Step,
    alpha_0: float,
    nu: float,
    lower: float,
    upper: float,
    size: Memory,
    derivative: Memory,
) -> float:
    """
    The stochastic gradient step size of Benveniste, Métivier and Priouret (1990), also in Kushner and Yang (1995). What ν
    should be depends on the scale of the rewards: its unit is that of 1/δ².

    :param mu: unused
    :param step: names the cell; its ``td_error`` is δ
    :param alpha_0: the first step size; ``size`` starts from it
    :param nu: the step size ν of the step size
    :param lower: the least step size
    :param upper: the largest step size
    :param size: the step size
    :param derivative: ψ, the derivative of the table's entry with respect to the step size
    :return: clip(μ + ν ψ δ, lower, upper), after which ψ ← (1 - μ) ψ + δ with the new μ
    """
    cell = cell_of(step)
    size[cell] = clip_size(size[cell] + nu * derivative[cell] * step.td_error, lower, upper)
    derivative[cell] = (1.0 - size[cell]) * derivative[cell] + step.td_error
    return size[cell]


BENVENISTE = StepSize(
    name="benveniste",
    step_size=benveniste,
    parameters={
        "alpha_0": first_step_size(0.1),
        "nu": Parameter(1e-3, 0.0, float("inf"), "the step size ν of the step size, in units of 1 / δ²"),
        "lower": Parameter(1e-3, 0.0, 1.0, "the least step size"),
        "upper": Parameter(1.0, 0.0, 1.0, "the largest step size"),
    },
    memory={"size": starts_at_alpha_0, "derivative": 0.0},
    counts=False,
    formula="μ ← clip(μ + ν ψ δ, lower, upper), ψ ← (1 - μ) ψ + δ",
    source="Benveniste, Métivier, Priouret 1990",
)

#: The guards of IDBD's publication: the logarithm of a step size stays above the first, and moves by at most the second
LEAST_LOG_SIZE = -10.0
LARGEST_CHANGE = 2.0


def idbd(mu: float, step: Step, alpha_0: float, theta: float, log_size: Memory, trace: Memory) -> float:
    """
    IDBD (Sutton 1992) with the features of a table, which makes it TIDBD(0) (Kearney et al. 2018). What θ should be depends
    on the scale of the rewards: its unit is that of 1/δ².

    :param mu: unused
    :param step: names the cell; its ``td_error`` is δ
    :param alpha_0: the first step size; ``log_size`` starts from its logarithm
    :param theta: the step size θ of the logarithm
    :param log_size: β, the logarithm of the step size, kept from -10 to 0. One update moves it by at most 2
    :param trace: h
    :return: e^β, after β ← β + θ δ h; then h ← h (1 - e^β) + e^β δ, where 1 - e^β is never negative
    """
    cell = cell_of(step)
    change = clip_size(theta * step.td_error * trace[cell], -LARGEST_CHANGE, LARGEST_CHANGE)
    log_size[cell] = clip_size(log_size[cell] + change, LEAST_LOG_SIZE, 0.0)
    size = math.exp(log_size[cell])
    trace[cell] = trace[cell] * (1.0 - size) + size * step.td_error
    return size


IDBD = StepSize(
    name="idbd",
    step_size=idbd,
    parameters={
        "alpha_0": Parameter(0.05, math.exp(LEAST_LOG_SIZE), 1.0, "the first step size"),
        "theta": Parameter(0.01, 0.0, float("inf"), "the step size θ of the logarithm, in units of 1 / δ²"),
    },
    memory={"log_size": starts_at_log_alpha_0, "trace": 0.0},
    counts=False,
    formula="β ← β + θ δ h, μ = e^β, h ← h (1 - μ) + μ δ",
    source="Sutton 1992, Adapting bias by gradient descent; Kearney et al. 2018",
)


def logistic(x: float) -> float:
    """
    :param x: any number
    :return: 1 / (1 + e^-x), computed without an exponential that could overflow
    """
    small = math.exp(-abs(x))
    return 1.0 / (1.0 + small) if x >= 0.0 else small / (1.0 + small)


def k1(mu: float, step: Step, alpha_0: float, theta: float, log_gain: Memory, trace: Memory) -> float:
    """
    K1 (Sutton 1992) with the features of a table: IDBD through a logistic function, which keeps the step size below 1.

    :param mu: unused
    :param step: names the cell; its ``td_error`` is δ
    :param alpha_0: the first step size
    :param theta: the step size θ of the logarithm
    :param log_gain: β; it starts from ln(α₀ / (1 - α₀))
    :param trace: h
    :return: e^β / (1 + e^β), after β ← β + θ δ h; then h ← (h + μ δ) (1 - μ)
    """
    cell = cell_of(step)
    log_gain[cell] += theta * step.td_error * trace[cell]
    size = logistic(log_gain[cell])
    trace[cell] = (trace[cell] + size * step.td_error) * (1.0 - size)
    return size


def _starts_at_log_odds(parameters: dict[str, float]) -> float:
    return math.log(parameters["alpha_0"] / (1.0 - parameters["alpha_0"]))


K1 = StepSize(
    name="k1",
    step_size=k1,
    parameters={
        "alpha_0": Parameter(0.05, 0.0, 1.0, "the first step size", open_lower=True, open_upper=True),
        "theta": Parameter(0.01, 0.0, float("inf"), "the step size θ of the logarithm, in units of 1 / δ²"),
    },
    memory={"log_gain": _starts_at_log_odds, "trace": 0.0},
    counts=False,
    formula="β ← β + θ δ h, μ = e^β / (1 + e^β), h ← (h + μ δ) (1 - μ)",
    source="Sutton 1992, Gain adaptation beats least squares?",
)


def autostep(
    mu: float,
    step: Step,
    alpha_0: float,
    meta_step_size: float,
    tau: float,
    size: Memory,
    trace: Memory,
    normalizer: Memory,
) -> float:
    """
    Autostep (Mahmood, Sutton, Degris and Pilarski 2012) with the features of a table: IDBD with a normalised change, which
    makes it independent of the scale of the rewards.

    :param mu: unused
    :param step: names the cell; its ``td_error`` is δ
    :param alpha_0: the first step size; ``size`` starts from it
    :param meta_step_size: how much one update can change the logarithm of the step size; the publication calls it μ
    :param tau: the number of updates over which the normaliser is forgotten at a step size of 1
    :param size: the step size, up to 1
    :param trace: h
    :param normalizer: v, a decaying maximum of |δ h|
    :return: the step size
    """
    cell = cell_of(step)
    change = step.td_error * trace[cell]
    largest = normalizer[cell]
    largest = max(abs(change), largest + size[cell] / tau * (abs(change) - largest))
    normalizer[cell] = largest
    new_size = size[cell]
    if largest != 0.0:
        new_size *= math.exp(meta_step_size * (change / largest))
    new_size = min(new_size, 1.0)  # the same as the publication's division by max(μ, 1)
    size[cell] = new_size
    trace[cell] = trace[cell] * (1.0 - new_size) + new_size * step.td_error
    return new_size


AUTOSTEP = StepSize(
    name="autostep",
    step_size=autostep,
    parameters={
        "alpha_0": first_step_size(0.1),
        "meta_step_size": Parameter(0.01, 0.0, 1.0, "the largest change of ln μ in one update"),
        "tau": Parameter(1e4, 1.0, float("inf"), "over how many updates v is forgotten, τ"),
    },
    memory={"size": starts_at_alpha_0, "trace": 0.0, "normalizer": 0.0},
    counts=False,
    formula="v ← max(|δ h|, v + μ / τ (|δ h| - v)), μ ← min(μ exp(meta_step_size δ h / v), 1), h ← h (1 - μ) + μ δ",
    source="Mahmood, Sutton, Degris, Pilarski 2012",
)

#: The default of SwiftTD's authors for the least step size
LEAST_SIZE = 1e-10
LOG_OF_LEAST_SIZE = math.log(LEAST_SIZE)


def swift_td(
    mu: float,
    step: Step,
    alpha_0: float,
    theta: float,
    eta: float,
    log_size: Memory,
    trace: Memory,
) -> float:
    """
    SwiftTD (Javed, Sharifnassab and Sutton 2024) without traces of eligibility, with the features of a table. Unlike IDBD,
    an update uses the step size that the updates before it have left.

    :param mu: unused
    :param step: names the cell; its ``td_error`` is δ
    :param alpha_0: the first step size; ``log_size`` starts from its logarithm, but not above ln η
    :param theta: the step size θ of the step size
    :param eta: the largest step size, η
    :param log_size: β, the logarithm of the next step size, from ln 1e-10 to ln η
    :param trace: h
    :return: e^β; then β ← min(β + θ δ h / e^β, ln η) and h ← (1 - e^β) h + e^β δ
    """
    cell = cell_of(step)
    size = min(math.exp(log_size[cell]), eta)  # e^(ln η) may be above η, by rounding
    log_size[cell] = clip_size(log_size[cell] + theta / size * step.td_error * trace[cell], LOG_OF_LEAST_SIZE, math.log(eta))
    trace[cell] = (1.0 - size) * trace[cell] + size * step.td_error
    return size


def _starts_at_log_below_eta(parameters: dict[str, float]) -> float:
    return math.log(min(parameters["alpha_0"], parameters["eta"]))


SWIFT_TD = StepSize(
    name="swift_td",
    step_size=swift_td,
    parameters={
        "alpha_0": Parameter(0.1, LEAST_SIZE, 1.0, "the first step size"),
        "theta": Parameter(1e-3, 0.0, float("inf"), "the step size θ of the step size, in units of 1 / δ²"),
        "eta": Parameter(1.0, LEAST_SIZE, 1.0, "the largest step size, η"),
    },
    memory={"log_size": _starts_at_log_below_eta, "trace": 0.0},
    counts=False,
    formula="μ = e^β, β ← min(β + θ δ h / μ, ln η), h ← (1 - μ) h + μ δ",
    source="Javed, Sharifnassab, Sutton 2024",
)
