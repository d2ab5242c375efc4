"""The part of a tabular algorithm that puts environments into vectorised ones."""

import numpy as np
from stable_baselines3.common.base_class import BaseAlgorithm, maybe_make_env
from stable_baselines3.common.env_util import is_wrapped
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.type_aliases import GymEnv
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.patch_gym import _patch_env

from sb3_adaptive_q.state_index import make_state_index
from sb3_adaptive_q.vec_env import LeanVecEnv
from sb3_adaptive_q.vec_env.protocol import check_is_single_env


class WrappedEnvironment(BaseAlgorithm):
    """An algorithm of SB3 that puts a plain environment into a LeanVecEnv."""

    _next_actions: np.ndarray | None

    def set_env(self, env: GymEnv, force_reset: bool = True) -> None:
        super().set_env(env, force_reset)
        self._next_actions = None

    @staticmethod
    def _wrap_env(env: GymEnv | str, verbose: int = 0, monitor_wrapper: bool = True) -> VecEnv:
        env = maybe_make_env(env, verbose)  # `load` and `set_env` take an id too
        if not isinstance(env, VecEnv):
            check_is_single_env(env)
            make_state_index(env.observation_space)  # raises where SB3's vectorised environments would, in other words
            env = _patch_env(env)
            if not is_wrapped(env, Monitor) and monitor_wrapper:
                if verbose >= 1:
                    print("Wrapping the env with a `Monitor` wrapper")
                env = Monitor(env)
            if verbose >= 1:
                print("Wrapping the env in a LeanVecEnv.")
            wrapped = env
            env = LeanVecEnv([lambda: wrapped])
        return BaseAlgorithm._wrap_env(env, verbose, monitor_wrapper)
