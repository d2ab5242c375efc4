"""The state of a running training, as plain data, for a model that is saved in the middle of it."""

from typing import Any

import numpy as np

from sb3_adaptive_q.environment_state import read_environments
from sb3_adaptive_q.rollouts.step_rollout import RolloutState, TransitionEntries
from sb3_adaptive_q.vec_env.tabular_dynamics import LARGEST_REWARD


def read_running(model: Any) -> dict[str, Any]:
    """
    :param model: a model in the middle of an episode, between two steps
    :return: the actions that were chosen for the next step, the state of the rollout, and that of the environments
    :raises ValueError: if the environments have no state that can be read
    """
    rollout = None if model._rollout is None else model._rollout.state()
    is_pending = rollout is not None and bool(rollout.transitions)
    chosen = None if is_pending or model._next_actions is None else model._next_actions.tolist()
    return {
        "next_actions": chosen,
        "rollout": None if rollout is None else rollout._asdict(),
        "environments": read_environments(model.env),
    }


def last_observations(model: Any) -> Any:
    """
    :param model: a model
    :return: the current observations of its environments. While a callback is called, they are one step after ``_last_obs``
    """
    rollout = model._rollout
    return rollout.new_obs if rollout is not None and rollout.state().transitions else model._last_obs


def check_rollout(data: dict[str, Any] | None, n_envs: int, n_states: int, n_actions: int) -> RolloutState | None:
    """
    :param data: the entry ``rollout`` of :func:`read_running`
    :param n_envs: the number of environments
    :param n_states: rows of the table
    :param n_actions: columns of the table
    :return: the state of the rollout, if there is one
    :raises ValueError: if it does not fit such a training
    """
    if data is None:
        return None
    state = RolloutState(
        [_check_transition(each, n_states, n_actions) for each in data["transitions"]],
        [dict(info) for info in data["infos"]],
        [float(each) for each in data["returns"]],
        [int(each) for each in data["lengths"]],
    )
    numbers = {
        len(state.returns),
        len(state.lengths),
        len(state.transitions or state.returns),
        len(state.infos or state.returns),
    }
    if numbers != {n_envs} or len(state.infos) != len(state.transitions):
        raise ValueError(f"its rollout is not one of {n_envs} environments")
    return state


def check_actions(actions: Any, n_envs: int, n_actions: int) -> np.ndarray | None:
    """
    :param actions: the entry ``next_actions`` of :func:`read_running`
    :param n_envs: the number of environments
    :param n_actions: columns of the table
    :return: the actions, of shape (n_envs,), if there are any
    :raises ValueError: if they do not fit such a training
    """
    if actions is None:
        return None
    if len(actions) != n_envs or not all(_is_below(action, n_actions) for action in actions):
        raise ValueError(f"its next actions are not {n_envs} actions below {n_actions}")
    return np.array(actions, dtype=np.int64)


def _check_transition(entry: Any, n_states: int, n_actions: int) -> TransitionEntries:
    state, action, reward, next_state, terminated, done, start_state = entry
    rows = all(_is_below(row, n_states) for row in (state, next_state, start_state))
    if not (rows and _is_below(action, n_actions) and abs(reward) <= LARGEST_REWARD):
        raise ValueError(f"its last transition {list(entry)} is none of this table")
    return state, action, float(reward), next_state, bool(terminated), bool(done), start_state


def _is_below(number: Any, limit: int) -> bool:
    return type(number) is int and 0 <= number < limit
