"""What a tabular algorithm writes to SB3's logger."""

import sys
import time
from typing import Any

from stable_baselines3.common.utils import safe_mean


def record_logs(model: Any) -> None:
    """
    Hand the means over the last episodes, and over the updates since the last entry, to the logger, and write the entry.

    :param model: the tabular algorithm
    """
    seconds = max((time.time_ns() - model.start_time) / 1e9, sys.float_info.epsilon)
    record = model.logger.record
    if len(model.ep_info_buffer) > 0:
        record("rollout/ep_rew_mean", safe_mean([info["r"] for info in model.ep_info_buffer]))
        record("rollout/ep_len_mean", safe_mean([info["l"] for info in model.ep_info_buffer]))
    if len(model.ep_success_buffer) > 0:
        record("rollout/success_rate", safe_mean(model.ep_success_buffer))
    record("rollout/exploration_rate", model.exploration_rate)
    record("time/fps", int((model.num_timesteps - model._num_timesteps_at_start) / seconds))
    record("time/episodes", model._episode_num, exclude="tensorboard")
    record("time/time_elapsed", int(seconds), exclude="tensorboard")
    record("time/total_timesteps", model.num_timesteps, exclude="tensorboard")
    _record_updates(model)
    model.logger.dump(step=model.num_timesteps)


def _record_updates(model: Any) -> None:
    state, record = model.training.record[0], model.logger.record
    n_updates = int(state["n_updates"] - state["n_logged"])
    record("train/learning_rate", model.mu)
    record("train/n_updates", model._n_updates, exclude="tensorboard")
    if n_updates > 0:
        record("train/mu_mean", state["mu_sum"] / n_updates)
        record("train/mu_min", float(state["mu_min"]))
        record("train/mu_max", float(state["mu_max"]))
        record("train/td_error", state["td_error_sum"] / n_updates)
    model.training.forget_updates()
