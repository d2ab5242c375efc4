"""SB3's DummyVecEnv without its deep copies."""

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env import DummyVecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from sb3_adaptive_q.vec_env.layers import LayeredStep


class LeanVecEnv(DummyVecEnv):
    """
    Steps environments one after the other, as SB3's DummyVecEnv does, and returns the same values.

    DummyVecEnv copies its buffers and every info dict deeply, which takes half of a step in a small environment. Here the
    arrays are made anew at every step and the info dicts are the environments' own: they hold what DummyVecEnv's
    hold, unless an environment goes on writing into a dict that it has handed out.

    :param env_fns: functions that make the environments, each its own
    :raises ValueError: if two of them return the same environment
    """

    def __init__(self, env_fns: list[Callable[[], gym.Env]]) -> None:
        super().__init__(env_fns)
        self._steps = [LayeredStep(env) for env in self.envs]
        self._scalar_actions = isinstance(self.action_space, spaces.Discrete)
        self._scalar_observations = isinstance(self.observation_space, spaces.Discrete)

    def step_wait(self) -> VecEnvStepReturn:
        # A plain int indexes a transition table twice as fast as a NumPy scalar does
        actions = np.asarray(self.actions).tolist() if self._scalar_actions else self.actions
        observations, rewards, dones, infos = [], [], [], []
        for i, step in enumerate(self._steps):
            observation, reward, terminated, truncated, info = step(actions[i])
            done = terminated or truncated
            info["TimeLimit.truncated"] = truncated and not terminated
            if done:
                info["terminal_observation"] = observation
                observation, self.reset_infos[i] = self.envs[i].reset()
            observations.append(observation)
            rewards.append(reward)
            dones.append(done)
            infos.append(info)
        return self._stack(observations), np.array(rewards, np.float32), np.array(dones, bool), infos

    def _stack(self, observations: list[Any]) -> Any:
        if self._scalar_observations:
            return np.array(observations, self.observation_space.dtype)
        for i, observation in enumerate(observations):
            self._save_obs(i, observation)
        return self._obs_from_buf()
