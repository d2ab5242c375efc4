"""Which of the two loops a model learns by."""

import warnings
from typing import Any

from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnvWrapper

from sb3_adaptive_q.callbacks import warn_of_rare_calls
from sb3_adaptive_q.rollouts.compiled_rollout import CompiledRollout
from sb3_adaptive_q.rollouts.step_rollout import StepRollout
from sb3_adaptive_q.vec_env import CompiledVecEnv


def make_rollout(model: Any, callback: BaseCallback, step_locals: dict[str, Any]) -> StepRollout:
    """
    :param model: a tabular algorithm that begins to learn
    :param callback: what it calls
    :param step_locals: the variables that callbacks see
    :return: the compiled loop where the model has a CompiledVecEnv, else the one of single steps
    :raises ValueError: if the environment cannot be compiled, or gives no action masks where the model needs them
    """
    if model.use_masking and isinstance(model.env, CompiledVecEnv):
        raise ValueError("Compiled environments give no action masks: use LeanVecEnv, or leave `use_masking` out.")
    if not isinstance(model.env, CompiledVecEnv):
        if isinstance(model.env, VecEnvWrapper) and isinstance(model.env.unwrapped, CompiledVecEnv):
            warnings.warn(
                f"A CompiledVecEnv inside a {type(model.env).__name__} is stepped like any other environment: for "
                "compiled rollouts, hand it over without a wrapper.",
                stacklevel=3,
            )
        return StepRollout(model, step_locals)
    warn_of_rare_calls(model, callback)
    return CompiledRollout(model, step_locals, callback)
