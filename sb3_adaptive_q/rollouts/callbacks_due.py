"""How far a compiled rollout may run before a callback is due, and what the callbacks are told afterwards."""

from math import ceil, inf
from typing import Any

from stable_baselines3.common.callbacks import (
    BaseCallback,
    CallbackList,
    CheckpointCallback,
    EvalCallback,
    EveryNTimesteps,
    ProgressBarCallback,
    StopTrainingOnMaxEpisodes,
)

#: How many steps to search for the next multiple of a frequency that is not a whole number
_FURTHEST = 1000


def steps_until_due(callback: BaseCallback, num_timesteps: int, n_envs: int) -> float:
    """
    :param callback: the callback that ``learn`` calls at every step
    :param num_timesteps: environment steps taken
    :param n_envs: the number of environments, so the environment steps of one call
    :return: the number of further steps after which one of SB3's own callbacks in it acts, at least 1; infinite if none does
    """
    if isinstance(callback, CallbackList):
        return min((steps_until_due(each, num_timesteps, n_envs) for each in callback.callbacks), default=inf)
    if isinstance(callback, EvalCallback):
        return _steps_until_multiple(callback.n_calls, callback.eval_freq) if callback.eval_freq > 0 else inf
    if isinstance(callback, CheckpointCallback):
        return _steps_until_multiple(callback.n_calls, callback.save_freq)
    if isinstance(callback, EveryNTimesteps):
        return max(ceil((callback.last_time_trigger + callback.n_steps - num_timesteps) / n_envs), 1)
    return inf


def episodes_until_due(callback: BaseCallback) -> float:
    """
    :param callback: the callback that ``learn`` calls at every step
    :return: the number of further episodes after which one of SB3's own callbacks in it acts; infinite if none does
    """
    if isinstance(callback, CallbackList):
        return min((episodes_until_due(each) for each in callback.callbacks), default=inf)
    if isinstance(callback, StopTrainingOnMaxEpisodes):
        return max(callback._total_max_episodes - callback.n_episodes, 1)
    return inf


def skip_steps(callback: BaseCallback, n_steps: int, n_envs: int) -> None:
    """
    Advance the counts of SB3's own callbacks, as if each had been called at all these steps without acting.

    :param callback: the callback that ``learn`` calls at every step
    :param n_steps: steps of every environment
    :param n_envs: the number of environments
    """
    if isinstance(callback, CallbackList):
        for each in callback.callbacks:
            skip_steps(each, n_steps, n_envs)
    elif isinstance(callback, EvalCallback | CheckpointCallback):
        callback.n_calls += n_steps
    elif isinstance(callback, ProgressBarCallback):
        callback.pbar.update(n_steps * n_envs)


def _steps_until_multiple(n_calls: int, frequency: Any) -> int:
    """The number of further calls after which ``n_calls % frequency`` may be 0. The callback checks whether it is."""
    if frequency == 0:
        return 1  # the callback raises its own error at its first call, as it does elsewhere
    if frequency == int(frequency):
        return int(abs(frequency) - n_calls % abs(frequency))
    return next((steps for steps in range(1, _FURTHEST) if (n_calls + steps) % frequency == 0), _FURTHEST)
