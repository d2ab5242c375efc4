"""The table as an SB3 policy, with the buffers that an algorithm and a step size declare."""

from collections.abc import Callable, Mapping
from decimal import Decimal
from math import prod
from typing import Any, TypeVar

import numpy as np
import psutil
import torch as th
from gymnasium import spaces
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import PyTorchObs, Schedule

from sb3_adaptive_q.action_masks import ALLOWED, check_mask
from sb3_adaptive_q.state_index import make_state_index

#: What the names of the buffers of a step size begin with
MEMORY = "memory_"
#: Arrays of fewer bytes are made without asking the system how much memory is free
SURELY_FREE = 2**20


SelfTabularQPolicy = TypeVar("SelfTabularQPolicy", bound="TabularQPolicy")


def greedy(rows: np.ndarray) -> np.ndarray:
    """
    :param rows: action values, of shape (batch, n_actions)
    :return: the best action of each row, the first of them in a tie
    """
    return rows.argmax(axis=1)


class TabularQPolicy(BasePolicy):
    """
    A table of action values, greedy in every state; the first of the best actions where they tie.

    What learning changes are its buffers, all float64: a step of 1e-9 would be lost in float32. The values of a tensor that is
    assigned to one of them are copied.

    - ``q_table``, of shape (n_states, n_actions)
    - ``mu``, of shape (1,): the scalar step size of the next update
    - what the algorithm declares, such as ``q_tables`` of Double Q-learning
    - ``memory_<name>`` for each array of the step size
    - ``allowed``, where actions are masked: 1 for those that are allowed in a state, as it was seen last, and 0 for the others

    :param observation_space: Discrete, MultiDiscrete, MultiBinary, or a Tuple or Dict of these
    :param action_space: Discrete
    :param lr_schedule: the learning rate by the remaining progress; its value at 1 is the first step size
    :param initial_q: what every entry of the table starts from: a number, or an array of shape (n_states, n_actions)
    :raises ValueError: if a space is of another kind, or ``initial_q`` does not fit
    :raises MemoryError: if the table would not fit into the memory that is free
    """

    q_table: th.Tensor
    mu: th.Tensor

    def __init__(
        self,
        observation_space: spaces.Space[Any],
        action_space: spaces.Space[Any],
        lr_schedule: Schedule,
        initial_q: Any = 0.0,
    ) -> None:
        super().__init__(observation_space, action_space)
        self.state_index = make_state_index(observation_space)
        self.initial_q = initial_q
        self.n_actions = count_actions(action_space)
        self.declare({"q_table": (self.n_states, self.n_actions)}, initial_q)
        self.register_buffer("mu", th.full((1,), float(lr_schedule(1)), dtype=th.float64))

    def __setattr__(self, name: str, value: Any) -> None:
        """Copy a tensor that is assigned to a buffer: a training works in the buffer's memory, and would not see another."""
        buffer = self.__dict__.get("_buffers", {}).get(name)
        if buffer is None or buffer.dtype != th.float64:  # no training works in a buffer of another type
            super().__setattr__(name, value)
        elif isinstance(value, th.Tensor) and value.shape == buffer.shape:
            buffer.copy_(value.detach().clone())  # which may be a view of the buffer itself
        else:
            given = f"one of shape {tuple(value.shape)}" if isinstance(value, th.Tensor) else repr(value)
            raise ValueError(f"`{name}` must be given a tensor of shape {tuple(buffer.shape)}, but got {given}.")

    @property
    def n_states(self) -> int:
        """The rows of the table."""
        return self.state_index.n_states

    def declare(self, shapes: Mapping[str, tuple[int, ...]], start: Any) -> None:
        """
        Add buffers of float64, or start them anew.

        :param shapes: their shapes by name
        :param start: what they start from: a number, or an array that fits
        :raises ValueError: if an array does not fit
        :raises MemoryError: if they would not fit into the memory that is free
        """
        check_memory(shapes)
        for name, shape in shapes.items():
            values = np.asarray(start, dtype=np.float64)
            if values.ndim and values.shape != shape[-values.ndim :]:
                raise ValueError(f"`{name}` has the shape {shape}, but got values of shape {values.shape} to start from.")
            self.register_buffer(name, th.from_numpy(np.broadcast_to(values, shape).copy()))

    def array(self, name: str, shape: tuple[int, ...]) -> np.ndarray:
        """
        :param name: of a buffer
        :param shape: that it must have
        :return: the buffer as an array for machine code, which does not look at shapes
        :raises ValueError: if it was removed, or replaced by a tensor of another kind
        """
        if name not in self._buffers:
            raise ValueError(f"The policy has no buffer `{name}` any more, which the training needs: please do not remove it.")
        array = getattr(self, name).numpy()
        if array.shape != shape or array.dtype != np.float64 or not array.flags.c_contiguous:
            raise ValueError(
                f"`{name}` must be a contiguous tensor of float64 and of shape {shape}, but is one of {array.dtype} "
                f"and of shape {array.shape}: please put such a tensor into the policy."
            )
        return array

    def forget_memory(self) -> None:
        """Drop the arrays of a step size."""
        for name in self.memory_names():
            delattr(self, MEMORY + name)

    def memory_names(self) -> list[str]:
        """
        :return: the names of the arrays of the step size
        """
        return [name[len(MEMORY) :] for name, _ in self.named_buffers() if name.startswith(MEMORY)]

    def forward(self, obs: PyTorchObs, deterministic: bool = True) -> th.Tensor:
        return self._predict(obs, deterministic)

    def _predict(self, observation: PyTorchObs, deterministic: bool = False) -> th.Tensor:
        states = self.state_index.of_batch(_as_arrays(observation))
        return th.as_tensor(self._actions(states, None, greedy))

    def predict(
        self,
        observation: Any,
        state: tuple[np.ndarray, ...] | None = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = False,
        action_masks: np.ndarray | None = None,
        choose: Callable[[np.ndarray], np.ndarray] = greedy,
    ) -> tuple[np.ndarray, tuple[np.ndarray, ...] | None]:
        """
        The greedy action; without a detour through PyTorch, which costs several times the look-up.

        The action of one observation is a number of NumPy's, ``np.int64``, where other algorithms of SB3 return an array
        without axes: gymnasium's toy-text environments look the action up in a dict, and an array cannot be a key.

        :param observation: one observation, or several: a batch as a VecEnv gives it, or a list of observations
        :param state: handed back as it is
        :param episode_start: unused
        :param deterministic: unused: this policy has no randomness; :meth:`TabularQ.predict` adds exploration
        :param action_masks: 1 for every action that is allowed, 0 for the others, of shape (n_actions,) or (batch, n_actions);
            ``None`` for those of the buffer ``allowed``, and without it for all
        :param choose: gives actions, counted from 0, by rows of action values; those of forbidden actions are minus infinity
        :return: the action, or the array of actions; and ``state``
        :raises ValueError: if an observation lies outside the observation space, or a mask does not fit or forbids all actions
        """
        if self.state_index.is_single(observation):
            action: Any = self._actions(np.array([self.state_index.of(observation)]), action_masks, choose)[0]
            return action, state
        return self._actions(self.state_index.of_several(observation), action_masks, choose), state

    def _actions(
        self, states: np.ndarray, action_masks: np.ndarray | None, choose: Callable[[np.ndarray], np.ndarray]
    ) -> np.ndarray:
        rows = self.q_table.numpy()[states]
        if action_masks is not None:
            masks = np.asarray(action_masks)
            shape = rows.shape[1:] if masks.ndim == 1 and len(states) == 1 else rows.shape
            rows = np.where(check_mask(masks, shape, "`predict`"), rows, -np.inf)
        elif ALLOWED in self._buffers:
            rows = np.where(getattr(self, ALLOWED).numpy()[states] > 0.0, rows, -np.inf)
        return choose(rows) + int(self.action_space.start)  # type: ignore[attr-defined]

    def parameters_to_vector(self) -> np.ndarray:
        """
        :return: an empty vector: what learning changes are buffers, not parameters
        """
        return np.zeros(0, dtype=np.float32)

    @classmethod
    def load(cls: type[SelfTabularQPolicy], path: str, device: th.device | str = "auto") -> SelfTabularQPolicy:
        """
        Load a policy that :meth:`save` has written, with the buffers of algorithm and step size. As in SB3, the file is a
        pickle: load only what you trust.

        :param path: the file
        :param device: unused: the table is worked on in place, on the CPU
        :return: the policy
        """
        saved = th.load(path, map_location="cpu", weights_only=False)
        policy = cls(**saved["data"])
        known = policy.state_dict()
        for name, tensor in saved["state_dict"].items():
            if name not in known and "." not in name:  # one that an algorithm or a step size has declared
                policy.register_buffer(name, tensor)
        policy.load_state_dict(saved["state_dict"])
        return policy

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
            f"A tabular algorithm needs a Discrete action space, but got {space}: wrap the environment in a "
            "`gymnasium.ActionWrapper` that numbers the actions to choose from."
        )
    return int(space.n)


def check_memory(
    shapes: Mapping[str, tuple[int, ...]], advice: str = "use fewer cells, or fewer components of the observation"
) -> None:
    """
    :param shapes: the shapes of arrays of 8 bytes an entry, by name
    :param advice: what to do where they do not fit
    :raises MemoryError: if they would not fit into the memory that is free
    """
    needed = 8 * sum(prod(shape) for shape in shapes.values())
    if needed < SURELY_FREE:
        return
    free = psutil.virtual_memory().available
    if needed > free:
        arrays = ", ".join(f"`{name.removeprefix(MEMORY)}` of {_in_words(shape)}" for name, shape in shapes.items())
        raise MemoryError(
            f"The arrays of the table and its memory ({arrays}) take {Decimal(needed) / 2**30:.1f} GiB, but "
            f"{free / 2**30:.1f} GiB of memory are free: {advice}."
        )


def _in_words(shape: tuple[int, ...]) -> str:
    return f"{shape[-2]} states and {shape[-1]} actions" if len(shape) == 2 else f"shape {shape}"


MlpPolicy = TabularQPolicy
