"""A random process whose mean rewards wander."""

from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium.envs.toy_text.utils import categorical_sample

from sb3_adaptive_q.envs.hidden import ClockDynamics, HiddenChangeEnv, OutcomeArrays
from sb3_adaptive_q.envs.tables import Garnet, Start, Table
from sb3_adaptive_q.envs.tables.types import start_in
from sb3_adaptive_q.random_numbers import random_float
from sb3_adaptive_q.vec_env import Grid, register_dynamics

#: The means move every so many steps. A pair of the 120 is met about as seldom, so a finer walk would learn the same
BLOCK = 100


class DriftingGarnetEnv(HiddenChangeEnv):
    """
    A garnet (see :func:`sb3_adaptive_q.envs.tables.garnet`) whose mean rewards do a random walk.

    The walk belongs to the instance: it is drawn when the environment is made, and every run of an instance meets the same
    one, whatever the agent does and however the environment is seeded. Every ``BLOCK`` steps each mean moves by a normal
    number of standard deviation ``drift * sqrt(BLOCK)``, so that after each of these blocks it is distributed as after a
    walk of steps of ``drift``. After ``n_steps`` steps the walk goes back the way it came, and so on.

    :param instance: the seed of process and walk; another instance is another task
    :param drift: standard deviation of the walk of each mean reward, per step
    :param noise: what every reward is above or below its mean, each half of the time
    :param n_steps: how long a walk to draw, in steps
    :param render_mode: ``None``; there is nothing to see
    """

    N_STATES, N_ACTIONS, N_SUCCESSORS = 30, 4, 3

    def __init__(
        self,
        instance: int = 0,
        drift: float = 0.01,
        noise: float = 1.0,
        n_steps: int = 200_000,
        render_mode: str | None = None,
    ) -> None:
        super().__init__(self.N_STATES, self.N_ACTIONS, start_in(self.N_STATES, 0), render_mode)
        self.garnet = Garnet.draw(instance, self.N_STATES, self.N_ACTIONS, self.N_SUCCESSORS)
        self.noise = noise
        #: What is played, with the noise of the rewards and without their means
        self.deviations = self.garnet._replace(mean_rewards=np.zeros_like(self.garnet.mean_rewards)).table(noise)
        # A generator of its own: the same process drifts at any speed and length
        generator = np.random.default_rng([instance, 1])
        walk = generator.normal(0.0, drift * BLOCK**0.5, (max(n_steps // BLOCK, 1), self.N_STATES, self.N_ACTIONS))
        walk[0] = self.garnet.mean_rewards
        #: The mean rewards in each block, of shape (n_blocks, n_states, n_actions)
        self.mean_rewards = np.cumsum(walk, axis=0)

    def phase_at(self, step: int) -> int:
        """
        Tell how far the walk is.

        :param step: the number of steps so far
        :return: the number of the block
        """
        n_blocks = len(self.mean_rewards)
        block = step // BLOCK % (2 * n_blocks)
        return min(block, 2 * n_blocks - 1 - block)

    def table_at(self, step: int) -> tuple[Table, Start]:
        """
        Write down the process as it is.

        :param step: the number of steps so far
        :return: the table, and the start distribution
        """
        means = self.mean_rewards[self.phase_at(step)]
        return self.garnet._replace(mean_rewards=means).table(self.noise), self.start

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        """
        Draw what happens.

        :param action: the number of the action
        :return: next state, reward, False, False, and the probability of what was drawn
        """
        outcomes = self.deviations[self.s][int(action)]
        mean = float(self.mean_rewards[self.phase_at(self.clock), self.s, action])
        drawn = categorical_sample([outcome[0] for outcome in outcomes], self.np_random)
        probability, self.s, deviation, _ = outcomes[drawn]
        self.clock += 1
        return self.s, mean + deviation, False, False, {"prob": probability}


class DriftingGarnet(NamedTuple):
    """The cumulative start distribution, the process as :class:`OutcomeArrays` without the leading axis, and the walk."""

    start: npt.NDArray[np.float64]
    cumulative: npt.NDArray[np.float64]
    next_states: npt.NDArray[np.int64]
    deviations: npt.NDArray[np.float64]
    mean_rewards: npt.NDArray[np.float64]


@register_dynamics(DriftingGarnetEnv)
class DriftingGarnetDynamics(ClockDynamics):
    """
    The compiled twin of :class:`DriftingGarnetEnv`. Its state is (state, clock), both whole numbers.

    :param env: the environment
    :param grid: unused
    """

    def __init__(self, env: gym.Env, grid: Grid | None) -> None:
        super().__init__(env, grid)
        assert isinstance(env, DriftingGarnetEnv)
        arrays = OutcomeArrays.of([env.deviations])
        expected = arrays.next_states.shape[1:3]
        if env.mean_rewards.shape[1:] != expected or not len(env.mean_rewards):
            raise ValueError(
                f"`mean_rewards` of {type(env).__name__} must have blocks of shape {expected}, but has the shape "
                f"{env.mean_rewards.shape}: please make a new environment."
            )
        self.parameters = DriftingGarnet(
            start=np.cumsum(env.start),
            cumulative=arrays.cumulative[0],
            next_states=arrays.next_states[0],
            deviations=arrays.rewards[0],
            mean_rewards=env.mean_rewards,
        )

    @staticmethod
    def step(parameters: Any, state: Any, action: Any, generator: Any) -> Any:
        """
        Draw the noise of the reward and the next state.

        :param parameters: process and walk
        :param state: state and clock
        :param action: the number of the action
        :param generator: to draw from
        :return: the state afterwards, the reward, and that the episode goes on
        """
        row, clock = int(state[0]), state[1]
        n_blocks = parameters.mean_rewards.shape[0]
        block = int(clock) // BLOCK % (2 * n_blocks)
        block = min(block, 2 * n_blocks - 1 - block)
        number = random_float(generator)
        outcome = 0
        for i in range(parameters.cumulative.shape[2] - 1):
            outcome += 1 if parameters.cumulative[row, action, i] <= number else 0
        reward = parameters.mean_rewards[block, row, action] + parameters.deviations[row, action, outcome]
        return (float(parameters.next_states[row, action, outcome]), clock + 1.0), reward, False
