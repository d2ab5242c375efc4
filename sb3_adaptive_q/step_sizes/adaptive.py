"""
Step sizes that look at the errors of their cell, without following a gradient with respect to the step size.

Throughout, δ = ``step.td_error`` is the temporal-difference error and n = ``step.count`` the number of updates of the cell,
this one included.
"""

import math

from sb3_adaptive_q.step_sizes.counts import generalised_harmonic
from sb3_adaptive_q.step_sizes.step import Memory, Parameter, Step, StepSize, cell_of, first_step_size, starts_at_alpha_0


def mcclain_size(size: float, target: float) -> float:
    """
    McClain's recursion, from one step size to the next.

    :param size: a step size above 0
    :param target: the step size that the recursion tends to, from 0 to 1
    :return: μ / (1 + μ - target), in an order of operations that cannot make the denominator 0
    """
    return size / (size + (1.0 - target))


def mcclain(mu: float, step: Step, alpha_0: float, target: float, size: Memory) -> float:
    """
    McClain's step size (1974): it falls as 1/n at first, and levels off at a target.

    :param mu: unused
    :param step: names the cell; its ``count`` is n
    :param alpha_0: the first step size
    :param target: the step size in the long run
    :param size: the step size of the cell's last update
    :return: α₀ at n = 1, then μ / (1 + μ - target)
    """
    cell = cell_of(step)
    size[cell] = mcclain_size(size[cell], target) if step.count > 1.0 else alpha_0
    return size[cell]


MCCLAIN = StepSize(
    name="mcclain",
    step_size=mcclain,
    parameters={"alpha_0": first_step_size(1.0), "target": Parameter(0.1, 0.0, 1.0, "the step size in the long run")},
    memory={"size": 0.0},
    counts=True,
    formula="μ ← μ / (1 + μ - target), μ = α₀ at n = 1",
    source="McClain 1974",
)


def have_opposite_signs(first: float, second: float) -> bool:
    """
    :param first: a number
    :param second: another one
    :return: whether one is above 0 and the other below; their product would not tell where it is too small for a float
    """
    return first < 0.0 < second or second < 0.0 < first


def kesten(mu: float, step: Step, alpha_0: float, a: float, changes: Memory, last_error: Memory) -> float:
    """
    Kesten's step size (1958) in Powell's form (2011): harmonic, but it falls only when the error changes its sign.

    :param mu: unused
    :param step: names the cell; its ``td_error`` is δ, its ``count`` n
    :param alpha_0: the first step size
    :param a: how slowly it falls
    :param changes: K, which is n for the first two updates, and then grows by one with every change of sign
    :param last_error: δ of the cell's last update
    :return: α₀ a / (a + K - 1)
    """
    cell = cell_of(step)
    if step.count <= 2.0:
        changes[cell] = step.count
    elif have_opposite_signs(step.td_error, last_error[cell]):
        changes[cell] += 1.0
    last_error[cell] = step.td_error
    return generalised_harmonic(changes[cell], alpha_0, a)


KESTEN = StepSize(
    name="kesten",
    step_size=kesten,
    parameters={
        "alpha_0": first_step_size(1.0),
        "a": Parameter(10.0, 0.0, float("inf"), "half the first step size is reached at K = a + 1", open_lower=True),
    },
    memory={"changes": 0.0, "last_error": 0.0},
    counts=True,
    formula="μ = α₀ a / (a + K - 1), K = n for n ≤ 2, then K ← K + 1 where δ changes its sign",
    source="Kesten 1958; Powell 2011",
)


def trigg(mu: float, step: Step, phi: float, mean_error: Memory, mean_absolute_error: Memory) -> float:
    """
    Trigg and Leach's tracking signal (1967): large while the errors have one sign, small while they cancel out.

    :param mu: unused
    :param step: names the cell; its ``td_error`` is δ
    :param phi: the weight φ of the newest error
    :param mean_error: E, the smoothed δ
    :param mean_absolute_error: M, the smoothed |δ|
    :return: |E| / M, or 1 while all errors were 0
    """
    cell = cell_of(step)
    mean_error[cell] = (1.0 - phi) * mean_error[cell] + phi * step.td_error
    mean_absolute_error[cell] = (1.0 - phi) * mean_absolute_error[cell] + phi * abs(step.td_error)
    if mean_absolute_error[cell] == 0.0:
        return 1.0
    return min(abs(mean_error[cell]) / mean_absolute_error[cell], 1.0)  # rounding may bring it above 1


TRIGG = StepSize(
    name="trigg",
    step_size=trigg,
    parameters={"phi": Parameter(0.1, 0.0, 1.0, "the weight φ of the newest error", open_lower=True)},
    memory={"mean_error": 0.0, "mean_absolute_error": 0.0},
    counts=False,
    formula="E ← (1 - φ) E + φ δ, M ← (1 - φ) M + φ |δ|, μ = |E| / M",
    source="Trigg, Leach 1967",
)


def bakf(
    mu: float,
    step: Step,
    nu_target: float,
    smoothing: Memory,
    bias: Memory,
    mean_square: Memory,
    variance_factor: Memory,
) -> float:
    """
    The bias-adjusted Kalman filter of George and Powell (2006): the step size that is best for the estimated bias and
    variance of the targets. The first two step sizes are 1 and 1/2, so that the initial table is forgotten.

    :param mu: unused
    :param step: names the cell; its ``td_error`` is δ, its ``count`` n
    :param nu_target: the weight of the newest error in the estimates, in the long run
    :param smoothing: ν, that weight: McClain's step size with a first value of 1
    :param bias: b, the smoothed δ
    :param mean_square: q, the smoothed δ²
    :param variance_factor: λ, the variance of the estimate in the table over that of a single target
    :return: 1 - σ² / q, with the variance σ² = (q - b²) / (1 + λ)
    """
    cell = cell_of(step)
    nu = mcclain_size(smoothing[cell], nu_target) if step.count > 1.0 else 1.0
    smoothing[cell] = nu
    bias[cell] = (1.0 - nu) * bias[cell] + nu * step.td_error
    mean_square[cell] = (1.0 - nu) * mean_square[cell] + nu * step.td_error * step.td_error
    factor = variance_factor[cell]
    if step.count <= 2.0:
        size = 1.0 / step.count
    elif mean_square[cell] == 0.0:  # all errors were 0, of which no bias can be seen
        size = factor / (1.0 + factor)
    else:
        variance = max(mean_square[cell] - bias[cell] * bias[cell], 0.0) / (1.0 + factor)  # rounding may bring it below 0
        size = 1.0 - variance / mean_square[cell]
    variance_factor[cell] = (1.0 - size) * (1.0 - size) * factor + size * size
    return size


BAKF = StepSize(
    name="bakf",
    step_size=bakf,
    parameters={
        "nu_target": Parameter(0.05, 0.0, 1.0, "the weight of the newest error in the estimates, in the long run"),
    },
    memory={"smoothing": 0.0, "bias": 0.0, "mean_square": 0.0, "variance_factor": 0.0},
    counts=True,
    formula="μ = 1 - σ² / q, σ² = (q - b²) / (1 + λ), λ ← (1 - μ)² λ + μ²; b, q: smoothed δ, δ²",
    source="George, Powell 2006",
)


def delta_bar_delta(
    mu: float,
    step: Step,
    alpha_0: float,
    kappa: float,
    phi: float,
    theta: float,
    size: Memory,
    mean_error: Memory,
) -> float:
    """
    Delta-bar-delta (Jacobs 1988): up by a fixed amount where the error has the sign of the earlier ones, down by a fixed
    share where it has the other sign.

    :param mu: unused
    :param step: names the cell; its ``td_error`` is δ
    :param alpha_0: the first step size; ``size`` starts from it
    :param kappa: what is added, κ
    :param phi: the share that is taken off, φ
    :param theta: the weight θ of the past in the smoothed error
    :param size: the step size, up to 1
    :param mean_error: the smoothed δ of the updates before this one
    :return: the step size
    """
    cell = cell_of(step)
    if have_opposite_signs(mean_error[cell], step.td_error):
        size[cell] *= 1.0 - phi
    elif mean_error[cell] != 0.0 and step.td_error != 0.0:
        size[cell] = min(size[cell] + kappa, 1.0)
    mean_error[cell] = (1.0 - theta) * step.td_error + theta * mean_error[cell]
    return size[cell]


DELTA_BAR_DELTA = StepSize(
    name="delta_bar_delta",
    step_size=delta_bar_delta,
    parameters={
        "alpha_0": first_step_size(0.1),
        "kappa": Parameter(0.01, 0.0, 1.0, "what is added where the sign stays, κ"),
        "phi": Parameter(0.1, 0.0, 1.0, "the share taken off where the sign changes, φ", open_upper=True),
        "theta": Parameter(0.7, 0.0, 1.0, "the weight θ of the past in the smoothed error", open_upper=True),
    },
    memory={"size": starts_at_alpha_0, "mean_error": 0.0},
    counts=False,
    formula="μ ← min(μ + κ, 1) if E δ > 0, (1 - φ) μ if E δ < 0; E ← (1 - θ) δ + θ E",
    source="Jacobs 1988",
)


def obgd(mu: float, step: Step, alpha: float, kappa: float) -> float:
    """
    Overshooting-bounded gradient descent (Elsayed, Vasan and Mahmood 2024) without traces: the smaller of α and
    1 / (κ max(|δ|, 1)), so that no update changes the table by more than 1/κ.

    :param mu: unused
    :param step: its ``td_error`` is δ
    :param alpha: the largest step size
    :param kappa: κ
    :return: α / max(1, α κ max(|δ|, 1))
    """
    return alpha / max(alpha * kappa * max(abs(step.td_error), 1.0), 1.0)


OBGD = StepSize(
    name="obgd",
    step_size=obgd,
    parameters={
        "alpha": Parameter(1.0, 0.0, 1.0, "the largest step size", open_lower=True),
        "kappa": Parameter(2.0, 0.0, float("inf"), "no update changes the table by more than 1 / κ", open_lower=True),
    },
    memory={},
    counts=False,
    formula="μ = α / max(1, α κ max(|δ|, 1))",
    source="Elsayed, Vasan, Mahmood 2024",
)


def rmsprop(mu: float, step: Step, alpha: float, decay: float, epsilon: float, mean_square: Memory) -> float:
    """
    RMSProp (Tieleman and Hinton 2012), as a baseline: the smaller the errors become, the larger the step size.

    :param mu: unused
    :param step: names the cell; its ``td_error`` is δ
    :param alpha: about what an update changes the table by, in units of the table
    :param decay: the weight b of the past
    :param epsilon: ε, which keeps the denominator above 0
    :param mean_square: v, the smoothed δ²
    :return: α / √(v + ε), which can exceed 1
    """
    cell = cell_of(step)
    mean_square[cell] = decay * mean_square[cell] + (1.0 - decay) * step.td_error * step.td_error
    return alpha / math.sqrt(mean_square[cell] + epsilon)


#: The parameters that RMSProp and AdaGrad share
_SCALE = Parameter(0.1, 0.0, float("inf"), "the change of the table, in its units", open_lower=True)
_EPSILON = Parameter(1e-8, 0.0, float("inf"), "keeps the denominator above 0", open_lower=True)

RMSPROP = StepSize(
    name="rmsprop",
    step_size=rmsprop,
    parameters={
        "alpha": _SCALE,
        "decay": Parameter(0.9, 0.0, 1.0, "the weight b of the past", open_upper=True),
        "epsilon": _EPSILON,
    },
    memory={"mean_square": 0.0},
    counts=False,
    formula="v ← b v + (1 - b) δ², μ = α / √(v + ε)",
    source="Tieleman, Hinton 2012",
)


def adagrad(mu: float, step: Step, alpha: float, epsilon: float, sum_of_squares: Memory) -> float:
    """
    AdaGrad (Duchi, Hazan and Singer 2011), as a baseline.

    :param mu: unused
    :param step: names the cell; its ``td_error`` is δ
    :param alpha: about what the first updates change the table by, in units of the table
    :param epsilon: ε, which keeps the denominator above 0
    :param sum_of_squares: g, the sum of all δ²
    :return: α / (√g + ε), which can exceed 1
    """
    cell = cell_of(step)
    sum_of_squares[cell] += step.td_error * step.td_error
    return alpha / (math.sqrt(sum_of_squares[cell]) + epsilon)


ADAGRAD = StepSize(
    name="adagrad",
    step_size=adagrad,
    parameters={"alpha": _SCALE, "epsilon": _EPSILON},
    memory={"sum_of_squares": 0.0},
    counts=False,
    formula="g ← g + δ², μ = α / (√g + ε)",
    source="Duchi, Hazan, Singer 2011",
)
