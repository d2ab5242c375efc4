"""SB3's DummyVecEnv without its deep copies."""

from collections import OrderedDict
from collections.abc import Callable
from copy import deepcopy
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import DummyVecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn
from stable_baselines3.common.vec_env.util import dict_to_obs

from sb3_adaptive_q.vec_env.layers import layered_step
from sb3_adaptive_q.vec_env.protocol import (
    CONVERSION_ERRORS,
    explain_reset,
    find_fault_of_call,
    find_fault_of_observation,
    find_fault_of_step,
    is_whole,
    raise_fault,
)

FINITE_SPACES = (spaces.Discrete, spaces.MultiDiscrete, spaces.MultiBinary)

#: Types whose values fit into an array of whole numbers unchanged
WHOLE = frozenset({int, np.int64, np.int32, np.int16, np.int8, np.uint32, np.uint16, np.uint8})


class LeanVecEnv(DummyVecEnv):
    """
    Steps environments one after the other, as SB3's DummyVecEnv does, and returns the same values.

    DummyVecEnv makes deep copies of its buffers and info dicts, which takes half the time of a step in a small environment.
    LeanVecEnv copies only the arrays, and returns the environments' own info dicts. These have the same contents, unless an
    environment changes a dict after it has returned it.

    An environment in ``envs`` or a wrapper inside it may be replaced at any time: the next step uses the new one. A function
    that replaces the ``step`` of a wrapper is used after the next :meth:`reset`, or once the running episode has ended.

    :param env_fns: functions that each make a new environment
    :raises ValueError: if two of them return the same environment; in ``step`` and ``reset``, if an environment returns
        something invalid, such as a fraction where its observation space is Discrete
    """

    _prepared = ("_steps", "_only_array", "_parts", "_fitting_types", "_finite_shapes")

    def __init__(self, env_fns: list[Callable[[], gym.Env]]) -> None:
        super().__init__(env_fns)
        self._prepare()

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name not in self._prepared}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        # A copy steps its own environments, not those of the original
        self._prepare()

    def _prepare(self) -> None:
        self._steps = [layered_step(env) for env in self.envs]
        #: The buffer of observations; ``None`` if these are a dict or a tuple of arrays
        self._only_array: Any = self.buf_obs.get(None)  # type: ignore[call-overload]
        #: The names of the parts of an observation; ``None`` for an observation that has no parts
        self._parts = list[Any](self.keys)
        space: Any = self.observation_space
        parts = {key: space if key is None else space[key] for key in self._parts}
        #: The shapes of the parts of an observation that are whole numbers
        self._finite_shapes = {key: part.shape for key, part in parts.items() if isinstance(part, FINITE_SPACES)}
        #: Types whose values fit into the only array unchanged
        self._fitting_types = frozenset[type]()
        if isinstance(space, spaces.Discrete):
            self._fitting_types = WHOLE
        elif isinstance(space, spaces.Box):
            self._fitting_types = frozenset({np.ndarray})

    def step_wait(self) -> VecEnvStepReturn:
        actions, steps, observations, fitting_types = self.actions, self._steps, self._only_array, self._fitting_types
        rewards, dones = self.buf_rews, self.buf_dones
        infos: list[dict[str, Any]] = []
        for i, env in enumerate(self.envs):
            try:
                outcome: Any = steps[i](env, actions[i])
                if outcome is None:
                    steps[i] = layered_step(env)
                    outcome = steps[i](env, actions[i])
            except CONVERSION_ERRORS as error:
                raise_fault(find_fault_of_call(env, "step", error), error)
                raise
            try:
                observation, rewards[i], terminated, truncated, info = outcome
                dones[i] = done = terminated or truncated
                info["TimeLimit.truncated"] = truncated and not terminated
                if done:
                    info["terminal_observation"] = observation if type(observation) is int else deepcopy(observation)
            except CONVERSION_ERRORS as error:
                raise_fault(find_fault_of_step(env, outcome), error)
                raise
            if done:
                observation, self.reset_infos[i] = _reset(env)
            if type(observation) in fitting_types:
                observations[i] = observation
            else:
                self._save_obs(i, observation)
            infos.append(info)
        # Copied, so that a later step does not overwrite what this one returns
        new_obs = self._obs_from_buf() if observations is None else observations.copy()
        return new_obs, rewards.copy(), dones.copy(), infos

    def reset(self) -> VecEnvObs:
        for i, env in enumerate(self.envs):
            options = {"options": self._options[i]} if self._options[i] else {}
            observation, self.reset_infos[i] = _reset(env, seed=self._seeds[i], **options)
            self._save_obs(i, observation)
            self._steps[i] = layered_step(env)
        # Seeds and options are only used once
        self._reset_seeds()
        self._reset_options()
        return self._obs_from_buf()

    def _save_obs(self, env_idx: int, obs: Any) -> None:
        try:
            for key in self._parts:
                value = obs if key is None else obs[key]
                shape = self._finite_shapes.get(key)
                if shape is not None and not (shape == () and type(value) in WHOLE) and not is_whole(value, shape):
                    raise ValueError("NumPy would cut off a fraction, and repeat a number where there should be several")
                self.buf_obs[key][env_idx] = value
        except (*CONVERSION_ERRORS, LookupError) as error:
            raise_fault(find_fault_of_observation(self.envs[env_idx], obs), error)
            raise

    def _obs_from_buf(self) -> VecEnvObs:
        if self._only_array is not None:
            return self._only_array.copy()
        return dict_to_obs(self.observation_space, OrderedDict((key, array.copy()) for key, array in self.buf_obs.items()))


def _reset(env: gym.Env, **arguments: Any) -> tuple[Any, dict[str, Any]]:
    """Call ``reset``, and raise an error that names the environment if it does not return (observation, info)."""
    try:
        outcome: Any = env.reset(**arguments)
    except CONVERSION_ERRORS as error:
        raise_fault(find_fault_of_call(env, "reset", error), error)
        raise
    if not (isinstance(outcome, tuple) and len(outcome) == 2 and isinstance(outcome[1], dict)):
        raise ValueError(explain_reset(env, outcome))
    return outcome
