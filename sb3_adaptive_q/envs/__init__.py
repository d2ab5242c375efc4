"""Environments of the study; importing this package registers them with gymnasium."""

from sb3_adaptive_q.envs.cartpole_friction import CartPoleFrictionEnv, CartPoleParameters
from sb3_adaptive_q.envs.registration import register_envs

register_envs()

__all__ = ["CartPoleFrictionEnv", "CartPoleParameters", "register_envs"]
