"""Processes that are drawn at random."""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from sb3_adaptive_q.envs.tables.types import Start, Table, start_in


class Garnet(NamedTuple):
    """
    A random process (Archibald, McKinnon and Thomas, 1995; Bhatnagar et al., 2009), without the noise of its rewards.

    :param successors: of every state and action, all different, of shape (n_states, n_actions, n_successors)
    :param probabilities: of the successors, from uniform cut points of [0, 1], of the same shape
    :param mean_rewards: of every state and action, standard normal, of shape (n_states, n_actions)
    """

    successors: npt.NDArray[np.int64]
    probabilities: npt.NDArray[np.float64]
    mean_rewards: npt.NDArray[np.float64]

    @classmethod
    def draw(cls, instance: int, n_states: int, n_actions: int, n_successors: int) -> "Garnet":
        """
        Draw a process.

        :param instance: the seed
        :param n_states: number of states
        :param n_actions: number of actions
        :param n_successors: of each state and action
        :return: the process
        """
        generator = np.random.default_rng(instance)
        shape = (n_states, n_actions)
        drawn = cls(
            np.empty((*shape, n_successors), np.int64), np.empty((*shape, n_successors)), np.empty((n_states, n_actions))
        )
        for pair in np.ndindex(shape):
            drawn.successors[pair] = generator.choice(n_states, n_successors, replace=False)
            cuts = np.sort(generator.random(n_successors - 1))
            drawn.probabilities[pair] = np.diff(cuts, prepend=0.0, append=1.0)
            drawn.mean_rewards[pair] = generator.normal()
        return drawn

    def table(self, noise: float) -> Table:
        """
        Write the process as a table.

        :param noise: what every reward is above or below its mean, each half of the time
        :return: the table
        """
        return {
            state: {
                action: [
                    (0.5 * probability, successor, mean + deviation, False)
                    for successor, probability in zip(
                        self.successors[state, action].tolist(), self.probabilities[state, action].tolist(), strict=True
                    )
                    for deviation in (noise, -noise)
                ]
                for action, mean in enumerate(self.mean_rewards[state].tolist())
            }
            for state in range(len(self.mean_rewards))
        }


def garnet(
    instance: int = 0, n_states: int = 30, n_actions: int = 4, n_successors: int = 3, noise: float = 1.0
) -> tuple[Table, Start]:
    """
    Build a garnet, a process drawn at random (Archibald, McKinnon and Thomas, 1995), which begins in state 0.

    :param instance: the seed; another instance is another task
    :param n_states: number of states
    :param n_actions: number of actions
    :param n_successors: of each state and action
    :param noise: what every reward is above or below its mean, each half of the time
    :return: table and start distribution
    """
    return Garnet.draw(instance, n_states, n_actions, n_successors).table(noise), start_in(n_states, 0)
