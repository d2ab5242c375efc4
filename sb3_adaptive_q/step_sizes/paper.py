"""
The paper's Eqs. 3-11, each once: rules for a single step size μ of the whole table.

A *rule* is a plain function ``rule(mu, step, *parameters) -> float``. It takes μ_t, the step size of the update that was
made last, and returns μ_{t+1}, that of the next one. ``step`` is a :class:`~sb3_adaptive_q.step_sizes.step.Step`.
"""

from sb3_adaptive_q.step_sizes.step import Step, clip_size

#: Eq. 11 with β7 and β8 as bounds. The paper prints ``β7 < μ`` in its first case, which would hold μ at β7 for ever
clip_rate = clip_size


def constant_rate(mu: float, step: Step, beta: float) -> float:
    """
    Method 1 (Eq. 3, β1) and Method 2 (Eq. 4, β2): μ is a constant.

    :param mu: unused
    :param step: unused
    :param beta: the step size
    :return: μ_{t+1} = β
    """
    return beta


def linear_decay_rate(mu: float, step: Step, beta_1: float, beta_3: float) -> float:
    """
    Method 3 (Eq. 5): μ falls from β1 + β3 to β1 in the course of the training.

    :param mu: unused
    :param step: its ``progress`` is t / t_max
    :param beta_1: the step size at the end
    :param beta_3: how much larger the step size is at the start
    :return: μ_{t+1} = β1 + β3 (1 - t / t_max)
    """
    return beta_1 + beta_3 * (1.0 - step.progress)


def linear_growth_rate(mu: float, step: Step, beta_1: float, beta_3: float) -> float:
    """
    Method 4 (Eq. 6): μ grows from β1 to β1 + β3 in the course of the training.

    :param mu: unused
    :param step: its ``progress`` is t / t_max
    :param beta_1: the step size at the start
    :param beta_3: how much larger the step size is at the end
    :return: μ_{t+1} = β1 + β3 t / t_max
    """
    return beta_1 + beta_3 * step.progress


def proportional_rate(mu: float, step: Step, gain: float, lower: float, upper: float) -> float:
    """
    Method 5 (Eq. 7, gain -β5) and Method 6 (Eq. 8, gain +β5): μ moves in proportion to the change of value along the
    transition, and stays within the bounds of Eq. 11.

    :param mu: μ_t
    :param step: its ``value`` is Q_t(s_t, a_t), its ``next_value`` Q_t(s_{t+1}, a)
    :param gain: the factor of the change of value
    :param lower: β7
    :param upper: β8
    :return: μ_{t+1} = clip(μ_t + gain (Q_t(s_{t+1}, a) - Q_t(s_t, a_t)))
    """
    return clip_rate(mu + gain * (step.next_value - step.value), lower, upper)


def sign_rate(mu: float, step: Step, change: float, lower: float, upper: float) -> float:
    """
    Method 7 (Eq. 9, change +β6) and Method 8 (Eq. 10, change -β6): μ moves by a fixed amount, up or down with the change
    of value along the transition, and stays within the bounds of Eq. 11.

    :param mu: μ_t
    :param step: its ``value`` is Q_t(s_t, a_t), its ``next_value`` Q_t(s_{t+1}, a_{t+1})
    :param change: what is added to μ where the next value is not below the value, and subtracted elsewhere
    :param lower: β7
    :param upper: β8
    :return: μ_{t+1} = clip(μ_t + change) if Q_t(s_{t+1}, a_{t+1}) >= Q_t(s_t, a_t), else clip(μ_t - change)
    """
    signed = change if step.next_value >= step.value else -change
    return clip_rate(mu + signed, lower, upper)
