"""The layers of wrappers around an environment, and a step that goes through them at once."""

from collections.abc import Callable
from typing import Any, NamedTuple

import gymnasium as gym
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker
from gymnasium.wrappers.common import TimeLimit
from stable_baselines3.common.monitor import Monitor

from wrappers import DiscretizeObservation

Step = tuple[Any, Any, bool, bool, dict[str, Any]]


class Layers(NamedTuple):
    """
    The outermost wrappers of an environment, as far as they are of the kinds named here and in this order.

    :param monitor: SB3's Monitor
    :param discretizer: the discretisation of the observation, around the Monitor or inside it
    :param limit: the time limit
    :param checked: the environment with gymnasium's own checks around it
    :param inner: what is inside all of these: the environment itself, or a wrapper of another kind
    """

    monitor: Monitor | None
    discretizer: DiscretizeObservation | None
    limit: Any  # TimeLimit | None, but gymnasium types its counter of steps as None
    checked: gym.Env
    inner: gym.Env


def peel(env: gym.Env) -> Layers:
    """
    :param env: an environment with its wrappers
    :return: the layers
    """
    found: dict[type, Any] = dict.fromkeys((DiscretizeObservation, Monitor, TimeLimit))
    for kind in (DiscretizeObservation, Monitor, DiscretizeObservation, TimeLimit):
        if _is_exactly(env, kind) and found[kind] is None:
            found[kind] = env
            env = env.env  # type: ignore[attr-defined]
    checked = env
    while type(env) in (OrderEnforcing, PassiveEnvChecker):
        env = env.env  # type: ignore[attr-defined]
    return Layers(found[Monitor], found[DiscretizeObservation], found[TimeLimit], checked, env)


def _is_exactly(env: gym.Env, kind: type) -> bool:
    """Whether it is a wrapper of that class: a subclass may step differently."""
    if kind is TimeLimit:  # rl_zoo3 puts a class of its own in the place of gymnasium's, which ends the same steps
        name = f"{type(env).__module__}.{type(env).__qualname__}"
        return name in ("gymnasium.wrappers.common.TimeLimit", "rl_zoo3.gym_patches.PatchedTimeLimit")
    return type(env) is kind


def layered_step(env: gym.Env) -> Callable[[Any], Step]:
    """
    What ``env.step`` does, in one call instead of one for each wrapper; they are left as they would be.

    gymnasium's checks look at the first step alone, so later steps pass them by. A Monitor is given the last step of an
    episode to do its work there, and until then its rewards.

    :param env: the environment with its wrappers
    :return: a function of the action that returns what ``env.step`` returns
    """
    monitor, discretizer, limit, checked, inner = peel(env)
    inner_step, checked_step = inner.step, checked.step
    observe = discretizer.observation if discretizer is not None else None
    was_checked = False

    def step(action: Any) -> Step:
        nonlocal was_checked
        if was_checked:
            observation, reward, terminated, truncated, info = inner_step(action)
        else:
            observation, reward, terminated, truncated, info = checked_step(action)
            was_checked = True
        if limit is not None:
            limit._elapsed_steps = elapsed_steps = limit._elapsed_steps + 1
            truncated = truncated or elapsed_steps >= limit._max_episode_steps
        if observe is not None:
            observation = observe(observation)
        if monitor is not None:
            if terminated or truncated or monitor.needs_reset:
                return _finish_episode(monitor, action, (observation, reward, terminated, truncated, info))
            monitor.rewards.append(float(reward))
            monitor.total_steps += 1
        return observation, reward, terminated, truncated, info

    return step


def _finish_episode(monitor: Monitor, action: Any, outcome: Step) -> Step:
    env = monitor.env
    monitor.env = _Outcome(outcome)  # type: ignore[assignment]
    try:
        return monitor.step(action)
    finally:
        monitor.env = env


class _Outcome:
    """Stands in for an environment that has made its step already."""

    def __init__(self, outcome: Step) -> None:
        self.outcome = outcome

    def step(self, action: Any) -> Step:
        return self.outcome
