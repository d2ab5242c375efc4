"""How far a compiled rollout may run before a callback is due, and what the callbacks are told afterwards."""

from collections.abc import Iterable
from math import ceil, inf
from typing import Any, TypeGuard

from stable_baselines3.common.callbacks import (
    BaseCallback,
    CallbackList,
    CheckpointCallback,
    EvalCallback,
    EventCallback,
    EveryNTimesteps,
    ProgressBarCallback,
    StopTrainingOnMaxEpisodes,
)

from sb3_adaptive_q.callbacks import iterate_callbacks

#: How many steps to search for the next multiple of a frequency that is not a whole number
_FURTHEST = 1000
_KNOWN = (EvalCallback, CheckpointCallback, EveryNTimesteps, StopTrainingOnMaxEpisodes, ProgressBarCallback)


def callbacks_of_sb3(callback: BaseCallback) -> list[BaseCallback]:
    """
    :param callback: the callback that ``learn`` calls at every step
    :return: those of SB3's own callbacks in it that act at some steps only, or that count them
    """
    if isinstance(callback, CallbackList):
        return [each for part in callback.callbacks for each in callbacks_of_sb3(part)]
    return [callback] if isinstance(callback, _KNOWN) else []


def steps_until_due(callbacks: Iterable[BaseCallback], num_timesteps: int, n_envs: int) -> float:
    """
    :param callbacks: from :func:`callbacks_of_sb3`
    :param num_timesteps: environment steps taken
    :param n_envs: the number of environments, so the environment steps of one call
    :return: the number of further steps after which one of the callbacks acts, at least 1; infinite if none does
    """
    return min((_steps_until_due(each, num_timesteps, n_envs) for each in callbacks), default=inf)


def _steps_until_due(callback: BaseCallback, num_timesteps: int, n_envs: int) -> float:
    due = _steps_until_it_acts(callback, num_timesteps, n_envs)
    if isinstance(callback, EventCallback) and any(map(_counts_episodes, iterate_callbacks(callback))):
        return max(due - 1, 1)  # it counts the episodes that end at the step of the event, so it must see that step alone
    return due


def _steps_until_it_acts(callback: BaseCallback, num_timesteps: int, n_envs: int) -> float:
    if _counts_episodes(callback) and callback.n_episodes >= callback._total_max_episodes:
        return 1  # it ends the training at once
    if isinstance(callback, EvalCallback):
        return _steps_until_multiple(callback.n_calls, callback.eval_freq) if callback.eval_freq > 0 else inf
    if isinstance(callback, CheckpointCallback):
        return _steps_until_multiple(callback.n_calls, callback.save_freq)
    if isinstance(callback, EveryNTimesteps):
        return max(ceil((callback.last_time_trigger + callback.n_steps - num_timesteps) / n_envs), 1)
    return inf


def episodes_until_due(callbacks: Iterable[BaseCallback]) -> float:
    """
    :param callbacks: from :func:`callbacks_of_sb3`
    :return: the number of further episodes after which one of the callbacks acts, at least 1; infinite if none does
    """
    limits = [each for each in callbacks if _counts_episodes(each)]
    return min((max(each._total_max_episodes - each.n_episodes, 1) for each in limits), default=inf)


def skip_steps(callbacks: Iterable[BaseCallback], n_steps: int, n_envs: int) -> None:
    """
    Advance the counts of callbacks, as if each had been called at all these steps without acting.

    :param callbacks: from :func:`callbacks_of_sb3`
    :param n_steps: steps of every environment
    :param n_envs: the number of environments
    """
    for callback in callbacks:
        if isinstance(callback, EvalCallback | CheckpointCallback):
            callback.n_calls += n_steps
        elif isinstance(callback, ProgressBarCallback):
            callback.pbar.update(n_steps * n_envs)


def _counts_episodes(callback: BaseCallback) -> TypeGuard[StopTrainingOnMaxEpisodes]:
    return isinstance(callback, StopTrainingOnMaxEpisodes)


def _steps_until_multiple(n_calls: int, frequency: Any) -> int:
    """The number of further calls after which ``n_calls % frequency`` may be 0. The callback checks whether it is."""
    if frequency == 0:
        return 1  # the callback raises its own error at its first call, as it does elsewhere
    if frequency == int(frequency):
        return int(abs(frequency) - n_calls % abs(frequency))
    return next((steps for steps in range(1, _FURTHEST) if (n_calls + steps) % frequency == 0), _FURTHEST)
