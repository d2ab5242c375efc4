"""Tabular Q-learning for Stable-Baselines3, with eight ways of setting its learning rate online."""

from pathlib import Path

import sb3_adaptive_q.envs  # registers the environments  # noqa: F401
from sb3_adaptive_q.callbacks import (
    METHODS,
    ConstantRateCallback,
    EpisodeSeriesCallback,
    LearningRateCallback,
    LinearDecayCallback,
    LinearGrowthCallback,
    ProportionalRateCallback,
    SignRateCallback,
    method,
)
from sb3_adaptive_q.many import learn_many
from sb3_adaptive_q.policies import MlpPolicy, TabularQPolicy
from sb3_adaptive_q.tabular_q import TabularQ
from sb3_adaptive_q.vec_env import CompiledVecEnv, LeanVecEnv

__version__ = (Path(__file__).parent / "version.txt").read_text().strip()

__all__ = [
    "METHODS",
    "CompiledVecEnv",
    "ConstantRateCallback",
    "EpisodeSeriesCallback",
    "LeanVecEnv",
    "LearningRateCallback",
    "LinearDecayCallback",
    "LinearGrowthCallback",
    "MlpPolicy",
    "ProportionalRateCallback",
    "SignRateCallback",
    "TabularQ",
    "TabularQPolicy",
    "__version__",
    "learn_many",
    "method",
]
