"""One state, whose mean reward wanders: the tracking problem whose best constant step size is known."""

from typing import Any, ClassVar, NamedTuple

import gymnasium as gym
from gymnasium import spaces

from sb3_adaptive_q.random_numbers import random_float
from sb3_adaptive_q.vec_env import Dynamics, Grid, register_dynamics


class DriftingMeanEnv(gym.Env[Any, Any]):
    """
    A random walk observed with noise (Muth, 1960).

    In each step the mean moves by plus or minus the root of ``variance``, and the reward is the mean plus or minus 1; all
    signs are equally likely. The best constant step size is (-q + sqrt(q² + 4 q)) / 2, where q is the variance; it and the
    error that it leaves depend on the variances alone, not on the distributions. The mean goes on over all episodes, from 0
    when the environment is made or seeded.

    :param variance: of a step of the mean; that of the noise is 1
    :param render_mode: ``None``; there is nothing to see
    :raises ValueError: if the variance is negative
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}  # type: ignore[misc]

    def __init__(self, variance: float = 0.01, render_mode: str | None = None) -> None:
        if not variance >= 0.0:
            raise ValueError(f"The variance must be at least 0, but is {variance}.")
        self.observation_space = spaces.Discrete(1)
        self.action_space = spaces.Discrete(1)
        self.render_mode = render_mode
        self.step_of_mean = variance**0.5
        #: The mean of the last reward, which an estimate should follow
        self.mean = 0.0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[int, dict[str, Any]]:
        """
        Begin an episode.

        :param seed: of the random generator; seeding also sets the mean to 0
        :param options: unused
        :return: the only state, and an empty dict
        """
        super().reset(seed=seed)
        if seed is not None:
            self.mean = 0.0
        return 0, {}

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        """
        Move the mean, then draw a reward.

        :param action: 0
        :return: the only state, reward, False, False, and the mean
        """
        self.mean += self.step_of_mean if self.np_random.random() < 0.5 else -self.step_of_mean
        reward = self.mean + (1.0 if self.np_random.random() < 0.5 else -1.0)
        return 0, reward, False, False, {"mean": self.mean}


class DriftingMean(NamedTuple):
    """How far the mean moves in a step."""

    step_of_mean: float


@register_dynamics(DriftingMeanEnv)
class DriftingMeanDynamics(Dynamics):
    """
    The compiled twin of :class:`DriftingMeanEnv`. Its state is (mean,).

    :param env: the environment
    :param grid: unused
    """

    draws_from_words = True

    def __init__(self, env: gym.Env, grid: Grid | None) -> None:
        super().__init__(env, grid)
        assert isinstance(env, DriftingMeanEnv)
        self.parameters = DriftingMean(env.step_of_mean)

    def read_state(self) -> tuple[float]:
        """
        Read the environment's state.

        :return: the mean
        """
        return (float(self.env.mean),)  # type: ignore[attr-defined]

    def write_state(self, state: Any) -> None:
        """
        Put the environment into a state.

        :param state: the mean
        """
        self.env.mean = float(state[0])  # type: ignore[attr-defined]

    @staticmethod
    def reset(parameters: Any, state: Any, generator: Any) -> Any:
        """
        Begin an episode, in which the mean goes on.

        :param parameters: unused
        :param state: where the last episode ended
        :param generator: unused
        :return: the same
        """
        return state

    @staticmethod
    def step(parameters: Any, state: Any, action: Any, generator: Any) -> Any:
        """
        Move the mean, then draw a reward.

        :param parameters: how far
        :param state: the mean
        :param action: 0
        :param generator: to draw from
        :return: the mean afterwards, the reward, and that the episode goes on
        """
        move = parameters.step_of_mean
        mean = state[0] + (move if random_float(generator) < 0.5 else -move)
        reward = mean + (1.0 if random_float(generator) < 0.5 else -1.0)
        return (mean,), reward, False

    @staticmethod
    def index(parameters: Any, state: Any) -> int:
        """
        Number the state.

        :param parameters: unused
        :param state: unused
        :return: the only row of the Q table
        """
        return 0
