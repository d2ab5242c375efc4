"""Compiled dynamics of gymnasium's Cart Pole and of the paper's."""

import math
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.envs.classic_control.cartpole import CartPoleEnv

from sb3_adaptive_q.compiled.loops import check_nothing
from sb3_adaptive_q.envs.cartpole_friction import CartPoleFrictionEnv, friction_dynamics, is_within_limits
from sb3_adaptive_q.random_numbers import random_float
from sb3_adaptive_q.vec_env.dynamics import Dynamics, Grid, as_float32, grid_index, register_dynamics


class _CartPoleDynamics(Dynamics):
    """The base class of both Cart Poles: the start of an episode, and the cells."""

    check = staticmethod(check_nothing)  # the grid covers every observation, the rewards are constants
    draws_from_words = True

    def __init__(self, env: gym.Env, grid: Grid | None) -> None:
        super().__init__(env, grid)
        if grid is None:
            raise ValueError(
                f"{type(env).__name__} compiles only inside `sb3_adaptive_q.wrappers.DiscretizeObservation` or gymnasium's "
                "wrapper of that name: please wrap it."
            )

    def table_shape(self) -> tuple[int, int]:
        return int(np.prod(self.parameters.counts + 1)), 2

    def write_state(self, state: Any) -> None:
        super().write_state(state)
        self.env.steps_beyond_terminated = None  # type: ignore[attr-defined]

    @staticmethod
    def reset(parameters, generator):
        """Draw all four variables uniformly from ±0.05, as ``Generator.uniform`` does."""
        low, width = -0.05, 0.05 - -0.05
        return (
            low + width * random_float(generator),
            low + width * random_float(generator),
            low + width * random_float(generator),
            low + width * random_float(generator),
        )

    @staticmethod
    def index(parameters, state):
        """Give the cell of the float32 observation. The float64 state decides whether the episode ends."""
        x, x_dot, theta, theta_dot = state
        observation = (as_float32(x), as_float32(x_dot), as_float32(theta), as_float32(theta_dot))
        return grid_index(parameters.edges, parameters.counts, parameters.scales, observation)


class CartPoleAttributes(NamedTuple):
    """The attributes of gymnasium's class, under the same names, and the grid."""

    gravity: float
    masspole: float
    total_mass: float
    length: float
    polemass_length: float
    force_mag: float
    tau: float
    theta_threshold_radians: float
    x_threshold: float
    reward_inside: float
    reward_outside: float
    edges: np.ndarray
    counts: np.ndarray
    scales: np.ndarray


@register_dynamics(CartPoleEnv)
class CartPoleDynamics(_CartPoleDynamics):
    """
    gymnasium's CartPoleEnv with the Euler integrator. The operations come in the same order as there.

    :param env: the environment
    :param grid: the edges of its observation
    :raises ValueError: without a grid, or with the semi-implicit integrator
    """

    def __init__(self, env: gym.Env, grid: Grid | None) -> None:
        super().__init__(env, grid)
        cart_pole: Any = env
        if cart_pole.kinematics_integrator != "euler":
            raise ValueError(
                f"CartPoleEnv compiles with the 'euler' integrator, but has {cart_pole.kinematics_integrator!r}: "
                "use LeanVecEnv, which works with everything."
            )
        assert grid is not None
        constants = [float(getattr(cart_pole, name)) for name in CartPoleAttributes._fields[:9]]
        rewards = (0.0, -1.0) if cart_pole._sutton_barto_reward else (1.0, 1.0)
        self.parameters = CartPoleAttributes._make([*constants, *rewards, *grid])

    @staticmethod
    def step(parameters, state, action, generator):
        """Euler's method on the frictionless equations of Barto, Sutton and Anderson (1983)."""
        x, x_dot, theta, theta_dot = state
        force = parameters.force_mag if action == 1 else -parameters.force_mag
        cos_theta = math.cos(theta)
        sin_theta = math.sin(theta)
        drive = (force + parameters.polemass_length * (theta_dot * theta_dot) * sin_theta) / parameters.total_mass
        theta_acceleration = (parameters.gravity * sin_theta - cos_theta * drive) / (
            parameters.length * (4.0 / 3.0 - parameters.masspole * (cos_theta * cos_theta) / parameters.total_mass)
        )
        x_acceleration = drive - parameters.polemass_length * theta_acceleration * cos_theta / parameters.total_mass
        x = x + parameters.tau * x_dot
        x_dot = x_dot + parameters.tau * x_acceleration
        theta = theta + parameters.tau * theta_dot
        theta_dot = theta_dot + parameters.tau * theta_acceleration
        inside = (
            -parameters.x_threshold <= x <= parameters.x_threshold
            and -parameters.theta_threshold_radians <= theta <= parameters.theta_threshold_radians
        )
        reward = parameters.reward_inside if inside else parameters.reward_outside
        return (x, x_dot, theta, theta_dot), reward, not inside


class FrictionParameters(NamedTuple):
    """:class:`sb3_adaptive_q.envs.cartpole_friction.CartPoleParameters` and the grid, in one flat tuple."""

    gravity: float
    cart_mass: float
    pole_mass: float
    half_length: float
    force: float
    time_step: float
    cart_friction: float
    pole_friction: float
    x_limit: float
    theta_limit: float
    edges: np.ndarray
    counts: np.ndarray
    scales: np.ndarray


@register_dynamics(CartPoleFrictionEnv)
class CartPoleFrictionDynamics(_CartPoleDynamics):
    """
    The paper's Cart Pole (Eqs. 12-14). It calls the same functions as the environment itself.

    :param env: the environment
    :param grid: the edges of its observation
    :raises ValueError: without a grid
    """

    def __init__(self, env: gym.Env, grid: Grid | None) -> None:
        super().__init__(env, grid)
        assert grid is not None
        self.parameters = FrictionParameters._make([*env.parameters, *grid])  # type: ignore[attr-defined]

    @staticmethod
    def step(parameters, state, action, generator):
        """Eqs. 12, 13 and 14."""
        x, x_dot, theta, theta_dot = state
        force = parameters.force if action == 1 else -parameters.force
        state = friction_dynamics(x, x_dot, theta, theta_dot, force, parameters)
        inside = is_within_limits(state[0], state[2], parameters)
        return state, 1.0 if inside else 0.0, not inside
