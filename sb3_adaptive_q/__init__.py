"""Tabular reinforcement learning for Stable-Baselines3, with methods that set the step size online."""

from pathlib import Path

import sb3_adaptive_q.envs  # registers the environments  # noqa: F401
from sb3_adaptive_q.algorithms.double_q import DoubleQ
from sb3_adaptive_q.algorithms.expected_sarsa import ExpectedSARSA
from sb3_adaptive_q.algorithms.n_step import NStep
from sb3_adaptive_q.algorithms.q_lambda import QLambda
from sb3_adaptive_q.algorithms.q_learning import TabularQ
from sb3_adaptive_q.algorithms.registry import ALGORITHMS
from sb3_adaptive_q.algorithms.sarsa import SARSA
from sb3_adaptive_q.algorithms.sarsa_lambda import SARSALambda
from sb3_adaptive_q.base import TabularAlgorithm
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
from sb3_adaptive_q.step_sizes import STEP_SIZES
from sb3_adaptive_q.table_image import TableImageCallback
from sb3_adaptive_q.vec_env import CompiledVecEnv, LeanVecEnv

__version__ = (Path(__file__).parent / "version.txt").read_text().strip()

__all__ = [
    "ALGORITHMS",
    "METHODS",
    "SARSA",
    "STEP_SIZES",
    "CompiledVecEnv",
    "ConstantRateCallback",
    "DoubleQ",
    "EpisodeSeriesCallback",
    "ExpectedSARSA",
    "LeanVecEnv",
    "LearningRateCallback",
    "LinearDecayCallback",
    "LinearGrowthCallback",
    "MlpPolicy",
    "NStep",
    "ProportionalRateCallback",
    "QLambda",
    "SARSALambda",
    "SignRateCallback",
    "TableImageCallback",
    "TabularAlgorithm",
    "TabularQ",
    "TabularQPolicy",
    "__version__",
    "learn_many",
    "method",
]
