"""Vectorised environments for tabular algorithms: without deep copies, or compiled."""

from sb3_adaptive_q.vec_env.compiled_vec_env import CompiledVecEnv
from sb3_adaptive_q.vec_env.dynamics import Dynamics, Grid, as_float32, grid_index, register_dynamics
from sb3_adaptive_q.vec_env.lean_vec_env import LeanVecEnv
from sb3_adaptive_q.vec_env.tabular_dynamics import TabularDynamics

__all__ = [
    "CompiledVecEnv",
    "Dynamics",
    "Grid",
    "LeanVecEnv",
    "TabularDynamics",
    "as_float32",
    "grid_index",
    "register_dynamics",
]
