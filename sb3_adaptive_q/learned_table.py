"""The part of a tabular algorithm that holds what was learned: the table, the masks of actions, and what is read from them."""

from typing import Any

import numpy as np
import torch as th
from stable_baselines3.common.vec_env import VecEnv

from sb3_adaptive_q.action_masks import ALLOWED, check_mask, mask_arrays
from sb3_adaptive_q.checks import MOST_STEPS
from sb3_adaptive_q.policies import TabularQPolicy
from sb3_adaptive_q.step_size_in_force import StepSizeInForce
from sb3_adaptive_q.vec_env import CompiledVecEnv


class LearnedTable(StepSizeInForce):
    """Mixin of :class:`sb3_adaptive_q.TabularAlgorithm`: its tables, and the arrays that machine code is given."""

    policy: TabularQPolicy
    env: VecEnv | None
    n_envs: int
    num_timesteps: int
    use_masking: bool
    considered: np.ndarray
    _working: dict[str, np.ndarray]
    _next_actions: np.ndarray | None
    _update_parameters: tuple[float, ...]

    @property
    def q_table(self) -> np.ndarray:
        """
        The live table of action values, of shape (n_states, n_actions). Another table may be assigned: its values are copied.
        """
        return self.policy.q_table.numpy()

    @q_table.setter
    def q_table(self, values: Any) -> None:
        values = np.asarray(values, dtype=np.float64)
        if values.shape != self.q_table.shape or not np.isfinite(values).all():
            raise ValueError(
                f"`q_table` must be given finite values of shape {self.q_table.shape}, but got an array of shape "
                f"{values.shape}{'' if np.isfinite(values).all() else ' with NaN or infinities'}."
            )
        self.q_table[:] = values
        for name in self.extra_tables(*values.shape):
            getattr(self.policy, name).numpy()[:] = values

    def learning_arrays(self) -> tuple[tuple[np.ndarray, ...], tuple[Any, ...]]:
        """
        :return: the algorithm's arrays, ``q_table`` first; and arrays, parameters and bounds of the step size and parameters
            of the algorithm, all as machine code takes them
        :raises ValueError: if a buffer of the policy was replaced by one of another kind
        """
        shape = (self.policy.n_states, self.policy.n_actions)
        shapes = {"q_table": shape, **self.extra_tables(*shape)}
        tables = [self.policy.array(name, expected) for name, expected in shapes.items()]
        masks = (self._masks(),) if self.use_masking else ()
        return (*tables, *self._working.values(), *masks), (*self._step_size_memory(), self._update_parameters)

    def check_counts(self, restarts: bool) -> None:
        """
        Check two counts that a training begins with.

        :param restarts: whether it counts steps from 0
        :raises ValueError: if there are more or fewer environments than the model was made for, or too many steps to count on
        """
        assert self.env is not None
        if self.n_envs != self.env.num_envs:
            raise ValueError(
                f"The model was made for a VecEnv of {self.n_envs}, but this one has {self.env.num_envs} environments: please "
                "make a new model, or `load` one with `env=`."
            )
        if self.num_timesteps > MOST_STEPS and not restarts:
            raise ValueError(f"`num_timesteps` must be at most {MOST_STEPS}, but is {self.num_timesteps}: please set it to 0.")

    def _share_mu(self) -> None:
        """Let the policy's ``mu`` and the training state's be the same memory: the policy may be another one by now."""
        own = th.from_numpy(self.training.record["mu"])
        if self.policy.mu.data_ptr() != own.data_ptr():
            own[:] = self.policy.mu
            self.policy.register_buffer("mu", own)

    def check_masks(self) -> None:
        """
        Check action masks that were read from a file or set by hand.

        :raises ValueError: if the mask of a state forbids every action
        """
        if self.use_masking:
            masks = self._masks()
            for state in np.flatnonzero(~masks.any(axis=1)):
                check_mask(masks[state], masks.shape[1:], f"state {state}")

    def new_working_arrays(self) -> dict[str, np.ndarray]:
        """
        :return: the arrays that the update works with in the course of episodes, and room for action masks, as they begin
        """
        shape = self.q_table.shape
        return self.working_arrays(self.n_envs, *shape) | (mask_arrays(shape[1]) if self.use_masking else {})

    def _prepare_update(self) -> None:
        """
        Fix what the update works with for this call of ``learn``. Arrays that belong to episodes start anew where these do,
        and where a parameter has changed that decides on their size.
        """
        self._update_parameters = tuple(map(float, self.update_parameters()))
        working = self.new_working_arrays()
        if self._next_actions is None or _shapes_of(working) != _shapes_of(self._working):
            self._working = working
        if self.considered.shape != (self.n_envs, self.policy.n_actions):  # the policy may be another one by now
            self.considered = np.zeros((self.n_envs, self.policy.n_actions))
        self.check_masks()

    def _masks(self) -> np.ndarray:
        if ALLOWED not in self.policy._buffers:
            raise ValueError("There is no table of masks in the policy: please pass `use_masking=True` to the constructor.")
        return self.policy.array(ALLOWED, (self.policy.n_states, self.policy.n_actions))

    def was_exploratory(self) -> np.ndarray:
        """
        For a callback, on an ordinary environment: whether the action that each environment took last was exploratory, which
        means not among the best by the table that it was chosen from.

        :return: of shape (n_envs,)
        :raises RuntimeError: on a compiled environment, where a callback sees the end of many steps, or before any action
        """
        if isinstance(self.env, CompiledVecEnv) or self._next_actions is None:
            raise RuntimeError("Exploratory actions are known while `learn` steps an ordinary environment: use LeanVecEnv.")
        taken = self.considered[np.arange(self.n_envs), self._next_actions]
        return taken < self.considered.max(axis=1)

    def to_frame(self) -> Any:
        """
        :return: the table, its greedy actions and the memory of the step size as a pandas DataFrame, a row for each state
        :raises ModuleNotFoundError: if what it needs is not installed: the extra ``plots``
        """
        from sb3_adaptive_q.plots import to_frame

        return to_frame(self)

    def __repr__(self) -> str:
        if not hasattr(self, "policy"):
            return f"{type(self).__name__} without a table"
        method = "learning_rate" if self._method is None else self._method.data.label
        return (
            f"{type(self).__name__}({method}, {self.policy.n_states} states, {self.policy.n_actions} actions, "
            f"{self.num_timesteps} steps learned)"
        )


def _shapes_of(arrays: dict[str, np.ndarray]) -> dict[str, tuple[int, ...]]:
    return {name: array.shape for name, array in arrays.items()}
