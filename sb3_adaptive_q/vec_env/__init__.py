"""Vectorised environments that keep up with a table."""

from sb3_adaptive_q.vec_env.lean_vec_env import LeanVecEnv

__all__ = ["LeanVecEnv"]
