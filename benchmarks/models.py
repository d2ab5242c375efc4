"""The learners that the comparisons run."""

from typing import Any

import gymnasium as gym
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env

from benchmarks.grid import N_EDGES, POLE_BOUNDS
from sb3_adaptive_q import CompiledVecEnv, TabularQ
from wrappers import DiscretizeObservation


class PlainCallback(BaseCallback):
    """A callback of a user's own, which SB3 calls at every step and the compiled path once for each rollout."""

    knows_rollouts = True

    def _on_step(self) -> bool:
        return True


def discretize(env: gym.Env) -> gym.Env:
    """
    :param env: a Cart Pole
    :return: the same with the cells of the paper
    """
    return DiscretizeObservation(env, N_EDGES, [-bound for bound in POLE_BOUNDS], POLE_BOUNDS)


def compiled_model(env_id: str, method: int | str, seed: int = 0, n_envs: int = 1, **options: Any) -> TabularQ:
    """
    :param env_id: FrozenLake-v1, or one of the Cart Poles
    :param method: a number of the paper, or a name
    :param seed: of the model
    :param n_envs: the number of environments
    :param options: further arguments of TabularQ; ties are broken by the first action if none says otherwise
    :return: a model that has not learned yet
    """
    wrapper = discretize if env_id.startswith("CartPole") else None
    env = make_vec_env(env_id, n_envs, vec_env_cls=CompiledVecEnv, wrapper_class=wrapper)
    return TabularQ("MlpPolicy", env, method=method, seed=seed, **{"ties": "first", **options})
