"""SB3's DummyVecEnv without its deep copies."""

from collections.abc import Callable
from copy import deepcopy
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3.common.vec_env import DummyVecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from sb3_adaptive_q.vec_env.layers import layered_step


class LeanVecEnv(DummyVecEnv):
    """
    Steps environments one after the other, as SB3's DummyVecEnv does, and returns the same values.

    DummyVecEnv copies its buffers and every info dict deeply, which takes half of a step in a small environment. Here the
    arrays are copied flatly and the info dicts are the environments' own: they hold what DummyVecEnv's hold, unless an
    environment goes on writing into a dict that it has handed out.

    :param env_fns: functions that make the environments, each its own
    :raises ValueError: if two of them return the same environment
    """

    _prepared = ("_steps", "_only_array")

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
        #: The buffer of observations, where these are not a dict or a tuple of arrays
        self._only_array: np.ndarray | None = self.buf_obs.get(None)  # type: ignore[call-overload]

    def step_wait(self) -> VecEnvStepReturn:
        observations, rewards, dones, infos = self._only_array, self.buf_rews, self.buf_dones, []
        for i, step in enumerate(self._steps):
            observation, rewards[i], terminated, truncated, info = step(self.actions[i])
            dones[i] = done = terminated or truncated
            info["TimeLimit.truncated"] = truncated and not terminated
            if done:
                info["terminal_observation"] = deepcopy(observation)
                observation, self.reset_infos[i] = self.envs[i].reset()
            if observations is None:
                self._save_obs(i, observation)
            else:
                observations[i] = observation
            infos.append(info)
        # Copied, so that a later step does not overwrite what this one has handed out
        new_obs = self._obs_from_buf() if observations is None else observations.copy()
        return new_obs, rewards.copy(), dones.copy(), infos
