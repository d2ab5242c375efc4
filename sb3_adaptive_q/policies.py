"""The table as an SB3 policy."""

from decimal import Decimal
from typing import Any

import numpy as np
import psutil
import torch as th
from gymnasium import spaces
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import PyTorchObs, Schedule

from sb3_adaptive_q.state_index import make_state_index


class TabularQPolicy(BasePolicy):
    """
    A table of action values, greedy in every state; the first of the best actions where they tie.

    What learning changes are its two buffers, both float64: a step of 1e-9 would be lost in float32.

    - ``q_table``, of shape (n_states, n_actions)
    - ``mu``, of shape (1,): the step size of the next update

    :param observation_space: Discrete, MultiDiscrete or MultiBinary
    :param action_space: Discrete
    :param lr_schedule: the learning rate by the remaining progress; its value at 1 is the first step size
    :param initial_q: what every entry of the table starts from
    :raises ValueError: if a space is of another kind
    :raises MemoryError: if the table would not fit into the memory that is free
    """

    q_table: th.Tensor
    mu: th.Tensor

    def __init__(
        self,
        observation_space: spaces.Space[Any],
        action_space: spaces.Space[Any],
        lr_schedule: Schedule,
        initial_q: float = 0.0,
    ) -> None:
        super().__init__(observation_space, action_space)
        self.state_index = make_state_index(observation_space)
        self.initial_q = initial_q
        n_actions = count_actions(action_space)
        _check_memory(self.state_index.n_states, n_actions)
        self.register_buffer("q_table", th.full((self.state_index.n_states, n_actions), initial_q, dtype=th.float64))
        self.register_buffer("mu", th.full((1,), lr_schedule(1), dtype=th.float64))

    def forward(self, obs: PyTorchObs, deterministic: bool = True) -> th.Tensor:
        return self._predict(obs, deterministic)

    def _predict(self, observation: PyTorchObs, deterministic: bool = False) -> th.Tensor:
        return th.as_tensor(self._greedy_actions(self.state_index.of_batch(_as_arrays(observation))))

    def predict(
        self,
        observation: Any,
        state: tuple[np.ndarray, ...] | None = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = False,
    ) -> tuple[np.ndarray, tuple[np.ndarray, ...] | None]:
        """
        The greedy action; without a detour through PyTorch, which costs several times the look-up.

        The action of one observation is a number of NumPy's, ``np.int64``, where other algorithms of SB3 return an array
        without axes: gymnasium's toy-text environments look an action up in a dict, which cannot be asked for an array.

        :param observation: one observation, or several: a batch as a VecEnv gives it, or a list of observations
        :param state: handed back as it is
        :param episode_start: unused
        :param deterministic: unused: this policy has no randomness; :meth:`TabularQ.predict` adds ε-greedy exploration
        :return: the action, or the array of actions; and ``state``
        :raises ValueError: if an observation lies outside the observation space
        """
        if self.state_index.is_single(observation):
            action: Any = self._greedy_actions(self.state_index.of(observation))
            return action, state
        return self._greedy_actions(self.state_index.of_several(observation)), state

    def _greedy_actions(self, rows: Any) -> Any:
        """
        :param rows: of the table, an array of them or one
        :return: the actions of largest value, an array or one
        """
        return self.q_table.numpy()[rows].argmax(axis=-1) + int(self.action_space.start)  # type: ignore[attr-defined]

    def parameters_to_vector(self) -> np.ndarray:
        """
        :return: an empty vector: what learning changes are buffers, not parameters
        """
        return np.zeros(0, dtype=np.float32)

    def _get_constructor_parameters(self) -> dict[str, Any]:
        data = super()._get_constructor_parameters()
        del data["normalize_images"]
        return {**data, "lr_schedule": self._dummy_schedule, "initial_q": self.initial_q}


def _as_arrays(observation: Any) -> Any:
    """Tensors as arrays, those in a tuple or a dict too."""
    if isinstance(observation, dict):
        return {key: _as_arrays(part) for key, part in observation.items()}
    if isinstance(observation, tuple):
        return tuple(map(_as_arrays, observation))
    return observation.cpu().numpy()


def count_actions(space: spaces.Space[Any]) -> int:
    """
    :param space: the action space
    :return: how many actions it has
    :raises ValueError: if it is not Discrete
    """
    if not isinstance(space, spaces.Discrete):
        raise ValueError(
            f"TabularQ needs a Discrete action space, but got {space}: wrap the environment in a "
            "`gymnasium.ActionWrapper` that numbers the actions to choose from."
        )
    return int(space.n)


def _check_memory(n_states: int, n_actions: int) -> None:
    needed, free = 8 * n_states * n_actions, psutil.virtual_memory().available
    if needed > free:
        raise MemoryError(
            f"A table of {n_states} states and {n_actions} actions takes {Decimal(needed) / 2**30:.1f} GiB, but "
            f"{free / 2**30:.1f} GiB of memory are free: use fewer cells, or fewer components of the observation."
        )


MlpPolicy = TabularQPolicy
