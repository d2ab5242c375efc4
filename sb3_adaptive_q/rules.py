"""
How the step size μ moves from one update to the next: the paper's Eqs. 3-11, each written once.

A *rule* is a plain function ``rule(mu, transition, *parameters) -> float`` of scalars. The update of a single transition
and the fused loop compile the very same function, so an equation cannot differ between the two.
"""

from typing import NamedTuple


class Transition(NamedTuple):
    """
    What a rule may look at after the update with μ_t.

    :param value: Q_t(s_t, a_t), before the update
    :param next_value: Q_t(s_{t+1}, a) in the table before the update, with the action a that ``next_action`` asks for;
        0 where s_{t+1} is terminal
    :param td_error: r_t + γ max_a Q_t(s_{t+1}, a) - Q_t(s_t, a_t), the temporal-difference error of the update
    :param progress: t / t_max, from 0 to 1: finished episodes over ``total_episodes`` where that is given,
        otherwise environment steps over ``total_timesteps``
    """

    value: float
    next_value: float
    td_error: float
    progress: float


def clip_rate(mu, lower, upper):
    """
    Keep μ within [β7, β8] (Eq. 11; the paper prints its first case as ``β7 < μ``, which would pin μ to β7).

    :param mu: the unconstrained step size
    :param lower: β7
    :param upper: β8
    :return: the constrained step size
    """
    return min(max(mu, lower), upper)


def hold_rate(mu, transition):
    """
    Leave μ as it is: the rule in force where no method is installed.

    :param mu: μ_t
    :param transition: unused
    :return: μ_t
    """
    return mu


def constant_rate(mu, transition, beta):
    """
    Method 1 (Eq. 3, β1) and Method 2 (Eq. 4, β2).

    :param mu: unused
    :param transition: unused
    :param beta: the step size
    :return: μ_{t+1} = β
    """
    return beta


def linear_decay_rate(mu, transition, beta_1, beta_3):
    """
    Method 3 (Eq. 5): from β1 + β3 down to β1.

    :param mu: unused
    :param transition: its ``progress`` is t / t_max
    :param beta_1: the step size at the end
    :param beta_3: what is added to it at the start
    :return: μ_{t+1} = β1 + β3 (1 - t / t_max)
    """
    return beta_1 + beta_3 * (1.0 - transition.progress)


def linear_growth_rate(mu, transition, beta_1, beta_3):
    """
    Method 4 (Eq. 6): from β1 up to β1 + β3.

    :param mu: unused
    :param transition: its ``progress`` is t / t_max
    :param beta_1: the step size at the start
    :param beta_3: what is added to it at the end
    :return: μ_{t+1} = β1 + β3 t / t_max
    """
    return beta_1 + beta_3 * transition.progress


def proportional_rate(mu, transition, gain, lower, upper):
    """
    Method 5 (Eq. 7, gain -β5) and Method 6 (Eq. 8, gain +β5), constrained by Eq. 11.

    :param mu: μ_t
    :param transition: its ``value`` is Q_t(s_t, a_t), its ``next_value`` Q_t(s_{t+1}, a)
    :param gain: what the difference of the two values is multiplied with
    :param lower: β7
    :param upper: β8
    :return: μ_{t+1} = clip(μ_t + gain (Q_t(s_{t+1}, a) - Q_t(s_t, a_t)))
    """
    return clip_rate(mu + gain * (transition.next_value - transition.value), lower, upper)


def sign_rate(mu, transition, step, lower, upper):
    """
    Method 7 (Eq. 9, step +β6) and Method 8 (Eq. 10, step -β6), constrained by Eq. 11.

    :param mu: μ_t
    :param transition: its ``value`` is Q_t(s_t, a_t), its ``next_value`` Q_t(s_{t+1}, a_{t+1})
    :param step: what μ moves by where the next value is not below the value, and moves back by elsewhere
    :param lower: β7
    :param upper: β8
    :return: μ_{t+1} = clip(μ_t + step) if Q_t(s_{t+1}, a_{t+1}) >= Q_t(s_t, a_t), else clip(μ_t - step)
    """
    change = step if transition.next_value >= transition.value else -step
    return clip_rate(mu + change, lower, upper)
