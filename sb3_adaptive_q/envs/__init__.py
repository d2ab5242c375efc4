"""Environments of the study and of the literature; importing this package registers them with gymnasium."""

from sb3_adaptive_q.envs.cartpole_friction import CartPoleFrictionEnv, CartPoleParameters
from sb3_adaptive_q.envs.catalogue import PROBLEMS, Problem
from sb3_adaptive_q.envs.registration import register_envs
from sb3_adaptive_q.envs.table_env import TableEnv

register_envs()

__all__ = ["PROBLEMS", "CartPoleFrictionEnv", "CartPoleParameters", "Problem", "TableEnv", "register_envs"]
