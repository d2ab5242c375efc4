"""The Cart Pole of the paper: Eq. 12 with friction, Eqs. 13 and 14 for reward and end."""

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from gymnasium import logger, spaces
from gymnasium.envs.classic_control.cartpole import CartPoleEnv
from gymnasium.error import ResetNeeded


class CartPoleParameters(NamedTuple):
    """
    Constants of the Cart Pole (paper, Table 2 and section 3.3), all floats.

    :param gravity: acceleration of gravity, m/s²
    :param cart_mass: mass of the cart, kg
    :param pole_mass: mass of the pole, kg
    :param half_length: half the length of the pole, m
    :param force: size of the force that an action applies to the cart, N
    :param time_step: time between two states, s
    :param cart_friction: μ_c, coefficient of friction of the cart on its track; Eq. 12 uses it as a force, N
    :param pole_friction: μ_p, coefficient of friction of the pole on the cart, N m s
    :param x_limit: the episode goes on while |x| is below it, m
    :param theta_limit: the episode goes on while |θ| is below it, rad
    """

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


# The two functions below are also compiled with Numba. They keep to scalar arithmetic, and to the order of
# operations of gymnasium's CartPoleEnv, so that every path gives the same bits and no friction gives its states.


def friction_dynamics(
    x: float, x_dot: float, theta: float, theta_dot: float, force: float, parameters: CartPoleParameters
) -> tuple[float, float, float, float]:
    """
    Advance the Cart Pole by one Euler step (paper, Eq. 12).

    :param x: position of the cart, m
    :param x_dot: velocity of the cart, m/s
    :param theta: angle of the pole from the vertical, rad
    :param theta_dot: angular velocity of the pole, rad/s
    :param force: force on the cart with its sign, N
    :param parameters: constants of the system
    :return: x, x_dot, theta and theta_dot one time step later
    """
    total_mass = parameters.pole_mass + parameters.cart_mass
    pole_moment = parameters.pole_mass * parameters.half_length
    cos_theta = math.cos(theta)
    sin_theta = math.sin(theta)
    sign = 1.0 if x_dot > 0.0 else (-1.0 if x_dot < 0.0 else 0.0)
    drive = (force + pole_moment * (theta_dot * theta_dot) * sin_theta - parameters.cart_friction * sign) / total_mass
    theta_acceleration = (
        parameters.gravity * sin_theta - cos_theta * drive - parameters.pole_friction * theta_dot / pole_moment
    ) / (parameters.half_length * (4.0 / 3.0 - parameters.pole_mass * (cos_theta * cos_theta) / total_mass))
    x_acceleration = drive - pole_moment * theta_acceleration * cos_theta / total_mass
    time_step = parameters.time_step
    return (
        x + time_step * x_dot,
        x_dot + time_step * x_acceleration,
        theta + time_step * theta_dot,
        theta_dot + time_step * theta_acceleration,
    )


def is_within_limits(x: float, theta: float, parameters: CartPoleParameters) -> bool:
    """
    Test Eqs. 13 and 14 of the paper: the reward is 1 while this holds, else 0, and the episode ends.

    Eq. 14 prints "or" between the two conditions; an episode that goes on until both are broken would contradict
    Eq. 13, whose "and" is taken for both.

    :param x: position of the cart, m
    :param theta: angle of the pole, rad
    :param parameters: constants of the system
    :return: whether cart and pole are both strictly inside their limits; NaN is outside
    """
    return -parameters.x_limit < x < parameters.x_limit and -parameters.theta_limit < theta < parameters.theta_limit


class CartPoleFrictionEnv(CartPoleEnv):
    """
    Cart Pole with friction, as in the paper (Eqs. 12 to 14, Table 2).

    Spaces, start (uniform in ±0.05) and rendering are gymnasium's; observation is the float32 of
    (x, x_dot, theta, theta_dot). The differences: friction, the limit of the angle (0.2095 rad instead of 12°), and
    no reward for the step that leaves the limits. The physical constants remain attributes, as in gymnasium's class.
    The limit of 200 steps comes with the registered id ``CartPoleFriction-v0``.

    :param cart_friction: μ_c, which Eq. 12 uses as a force, in N; finite and not negative
    :param pole_friction: μ_p of Eq. 12, in N m s; finite and not negative
    :param render_mode: ``None``, ``"human"`` or ``"rgb_array"``
    :raises ValueError: if a friction coefficient is negative or not finite
    """

    # gymnasium's class sets it to None, counts in it, and leaves mypy with the type None.
    steps_beyond_terminated: int | None  # type: ignore[assignment]

    def __init__(self, cart_friction: float = 0.0005, pole_friction: float = 0.000002, render_mode: str | None = None):
        for name, value in (("cart_friction", cart_friction), ("pole_friction", pole_friction)):
            if not (math.isfinite(value) and value >= 0.0):
                raise ValueError(f"{name} must be a finite number of at least 0 (0: no friction), got {value!r}.")
        super().__init__(render_mode=render_mode)
        self.cart_friction = float(cart_friction)
        self.pole_friction = float(pole_friction)
        self.theta_threshold_radians = 0.2095
        # Twice the limits, as in gymnasium, so that the observation that ends an episode lies in the space.
        high = np.array([2 * self.x_threshold, np.inf, 2 * self.theta_threshold_radians, np.inf], dtype=np.float32)
        self.observation_space = spaces.Box(-high, high, dtype=np.float32)

    @property
    def parameters(self) -> CartPoleParameters:
        """
        Collect the constants in force.

        :return: the attributes of this environment as one named tuple
        """
        return CartPoleParameters(
            self.gravity,
            self.masscart,
            self.masspole,
            self.length,
            self.force_mag,
            self.tau,
            self.cart_friction,
            self.pole_friction,
            self.x_threshold,
            self.theta_threshold_radians,
        )

    def step(self, action: Any) -> tuple[npt.NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """
        Push the cart for one time step.

        :param action: 0 pushes to the left, 1 to the right
        :return: observation, reward (1 inside the limits, else 0), whether the limits were left, False, empty dict
        :raises ValueError: if the action is neither 0 nor 1
        :raises ResetNeeded: if the environment was never reset
        """
        if self.state is None:
            raise ResetNeeded("Call reset() before step().")
        if action != 0 and action != 1:
            raise ValueError(f"Expected action 0 (push left) or 1 (push right), got {action!r}.")
        parameters = self.parameters
        x, x_dot, theta, theta_dot = self.state.tolist()
        force = parameters.force if action == 1 else -parameters.force
        state = friction_dynamics(x, x_dot, theta, theta_dot, force, parameters)
        self.state = np.array(state)
        inside = is_within_limits(state[0], state[2], parameters)
        self._watch_end(inside)
        if self.render_mode == "human":
            self.render()
        return self.state.astype(np.float32), 1.0 if inside else 0.0, not inside, False, {}

    def _watch_end(self, inside: bool) -> None:
        if self.steps_beyond_terminated is not None:
            if self.steps_beyond_terminated == 0:
                logger.warn("step() was called after the episode had terminated; call reset() first.")
            self.steps_beyond_terminated += 1
        elif not inside:
            self.steps_beyond_terminated = 0
