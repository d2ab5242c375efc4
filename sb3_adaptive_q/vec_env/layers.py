"""The wrappers around an environment, and a step through all of them in one call."""

from collections.abc import Callable
from typing import Any, NamedTuple

import gymnasium as gym
from gymnasium.wrappers import DiscretizeObservation as GymnasiumDiscretizeObservation
from gymnasium.wrappers import OrderEnforcing, PassiveEnvChecker
from gymnasium.wrappers.common import TimeLimit
from stable_baselines3.common.monitor import Monitor

from sb3_adaptive_q.vec_env.protocol import CONVERSION_ERRORS, find_fault_of_step, raise_fault
from sb3_adaptive_q.wrappers import DiscretizeObservation

Step = tuple[Any, Any, bool, bool, dict[str, Any]]

#: gymnasium's checks look at two steps: the second is compared with the first
CHECKED_STEPS = 2
#: At most this many wrappers with gymnasium's checks are looked through
MOST_CHECKERS = 3
#: The Monitor, a discretisation, the time limit, and gymnasium's checks
MOST_WRAPPERS = 3 + MOST_CHECKERS


class Layers(NamedTuple):
    """
    The wrappers of an environment from the outside, up to the first that is of another kind or in another order.

    :param monitor: SB3's Monitor
    :param discretizer: the discretisation of the observation, ours or gymnasium's, around the Monitor or inside it;
        :func:`sb3_adaptive_q.wrappers.edges_of` gives its edges
    :param limit: the time limit
    :param checked: the environment with gymnasium's own checks around it
    :param inner: what is inside all of these: the environment itself, or a wrapper of another kind
    """

    monitor: Monitor | None
    discretizer: DiscretizeObservation | GymnasiumDiscretizeObservation[Any, Any, Any] | None
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
    for _ in range(MOST_CHECKERS):
        if type(env) in (OrderEnforcing, PassiveEnvChecker) and not is_patched(env):
            env = env.env  # type: ignore[attr-defined]
    return Layers(found[Monitor], found[DiscretizeObservation], found[TimeLimit], checked, env)


def is_patched(wrapper: gym.Env) -> bool:
    """
    :param wrapper: a wrapper of one of the kinds that are peeled off
    :return: whether its ``step``, ``reset`` or ``observation`` was replaced on this object
    """
    return any(_is_replaced(wrapper, name) for name in ("step", "reset", "observation") if hasattr(type(wrapper), name))


def _is_replaced(wrapper: gym.Env, name: str) -> bool:
    # Not by `vars(wrapper)`: CPython 3.11 reads an object's attributes more slowly after that
    method = getattr(wrapper, name)
    is_own = getattr(method, "__func__", None) is getattr(type(wrapper), name) and method.__self__ is wrapper
    return not is_own


def _is_exactly(env: gym.Env, kind: type) -> bool:
    """Whether it is a wrapper of that class: a subclass may step differently."""
    if kind is TimeLimit:  # rl_zoo3 replaces gymnasium's class by one that ends episodes at the same steps
        name = f"{type(env).__module__}.{type(env).__qualname__}"
        is_kind = name in ("gymnasium.wrappers.common.TimeLimit", "rl_zoo3.gym_patches.PatchedTimeLimit")
    elif kind is DiscretizeObservation:
        is_kind = type(env) in (DiscretizeObservation, GymnasiumDiscretizeObservation)
    else:
        is_kind = type(env) is kind
    return is_kind and not is_patched(env)


def layered_step(env: gym.Env) -> Callable[[gym.Env, Any], Step | None]:
    """
    Make a function that does what ``env.step`` does, in one call instead of one for each wrapper. It leaves the wrappers in
    the same state.

    gymnasium's checks look at the first steps only, so later steps skip them. The Monitor's own ``step`` is called only where
    an episode ends; until then its list of rewards and its count of steps are updated directly.

    :param env: the environment with its wrappers
    :return: a function of the environment and the action, which returns what ``env.step`` returns. If the environment has
        changed (replaced, another wrapper inside it or, where an episode starts, the ``step`` of a wrapper replaced), the
        function steps nothing and returns ``None``. Make a new function then
    """
    monitor, discretizer, limit, checked, inner = peel(env)
    outermost, is_first_step, checks_left = env, True, 0 if checked is inner else CHECKED_STEPS
    wrappers = _wrappers_around(inner, env)
    own_steps = [wrapper.step for wrapper in wrappers]
    # Those of now, though others may replace them before the episode ends
    checked_step, monitor_step = checked.step, monitor and monitor.step
    first, second, third, fourth, fifth, sixth = wrappers + [_NO_WRAPPER] * (MOST_WRAPPERS - len(wrappers))
    in_first, in_second, in_third, in_fourth, in_fifth, in_sixth = (
        wrapper.env for wrapper in (first, second, third, fourth, fifth, sixth)
    )

    def step(env: gym.Env, action: Any) -> Step | None:
        nonlocal checks_left, is_first_step
        # A loop over the wrappers would take five times as long: Python reads attributes of one class the fastest
        if (
            env is not outermost
            or first.env is not in_first
            or second.env is not in_second
            or third.env is not in_third
            or fourth.env is not in_fourth
            or fifth.env is not in_fifth
            or sixth.env is not in_sixth
            or (is_first_step and [wrapper.step for wrapper in wrappers] != own_steps)
        ):
            return None
        if checks_left:
            outcome = checked_step(action)
            checks_left -= 1
        else:
            outcome = inner.step(action)
        try:
            observation, reward, terminated, truncated, info = outcome
            if limit is not None:
                limit._elapsed_steps = elapsed_steps = limit._elapsed_steps + 1
                truncated = truncated or elapsed_steps >= limit._max_episode_steps
            if discretizer is not None:
                observation = discretizer.observation(observation)
            is_first_step = terminated or truncated
            if monitor is None:
                float(reward)  # NumPy would make a NaN of None
            elif is_first_step or monitor.needs_reset:
                return _finish_episode(monitor, monitor_step, action, (observation, reward, terminated, truncated, info))
            else:
                monitor.rewards.append(float(reward))
                monitor.total_steps += 1
        except CONVERSION_ERRORS as error:
            raise_fault(find_fault_of_step(inner, outcome), error)
            raise
        return observation, reward, terminated, truncated, info

    return step


def _wrappers_around(inner: gym.Env, env: Any) -> list[Any]:
    """The wrappers outside ``inner``."""
    found = []
    while env is not inner:
        found.append(env)
        env = env.env
    return found


def _finish_episode(monitor: Monitor, monitor_step: Any, action: Any, outcome: Step) -> Step:
    env = monitor.env
    monitor.env = _Outcome(outcome)  # type: ignore[assignment]
    try:
        return monitor_step(action)
    finally:
        monitor.env = env


class _NoWrapper:
    """Fills the places where an environment has no wrapper."""

    def __init__(self) -> None:
        self.env = None


_NO_WRAPPER = _NoWrapper()


class _Outcome:
    """Replaces an environment that has made its step already."""

    def __init__(self, outcome: Step) -> None:
        self.outcome = outcome

    def step(self, action: Any) -> Step:
        return self.outcome
