"""Checks of environments and of what they return, with messages that say what was expected and what came."""

from math import isfinite
from types import TracebackType
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces

from sb3_adaptive_q.state_index import make_state_index

#: Errors of putting a value of another type into an array of numbers
CONVERSION_ERRORS = (TypeError, ValueError, OverflowError)


def check_is_single_env(env: Any) -> None:
    """
    :param env: what was given as the environment
    :raises ValueError: if it is a vectorised environment of gymnasium, has several agents, or is no environment
    """
    if isinstance(env, gym.vector.VectorEnv):
        raise ValueError(
            f"Expected one gymnasium environment or a VecEnv of SB3, but got the {type(env).__name__} of gymnasium, which "
            f"steps {env.num_envs} environments: please make them with `make_vec_env(id, n_envs={env.num_envs}, "
            "vec_env_cls=LeanVecEnv)` of `stable_baselines3.common.env_util`."
        )
    if any(cls.__module__.split(".")[0] == "pettingzoo" for cls in type(env).__mro__):
        raise ValueError(
            f"Expected an environment of one agent, but got {type(env).__name__}, a PettingZoo environment of several: please "
            "write a gymnasium environment around it in which one agent acts, or turn it into a VecEnv with SuperSuit."
        )
    if isinstance(env, type) or not (hasattr(env, "step") and hasattr(env, "reset")):
        made = isinstance(env, type) or callable(env)
        raise ValueError(
            f"Expected a gymnasium environment, a VecEnv of SB3 or the id of an environment, but got {env!r}: please "
            f"{'call it and pass what it returns' if made else 'pass one of these'}."
        )


def raise_fault(fault: str | None, error: Exception) -> None:
    """
    :param fault: a message that names the culprit, if one was found
    :param error: the error that was raised
    :raises ValueError: if there is a message
    """
    if fault is not None:
        raise ValueError(fault) from error


def find_fault_of_step(env: gym.Env, outcome: Any) -> str | None:
    """
    Find out what is wrong with what a step returned.

    :param env: the environment
    :param outcome: what its ``step`` returned
    :return: a message that names the culprit; ``None`` if all is well
    """
    returned = f"`step` of {_name(env)} must return"
    if not isinstance(outcome, tuple | list) or len(outcome) != 5:
        what = f"{len(outcome)} values, {outcome!r}" if isinstance(outcome, tuple | list) else repr(outcome)
        return f"{returned} (observation, reward, terminated, truncated, info), but returned {what}."
    observation, reward, terminated, truncated, info = outcome
    fault = find_fault_of_observation(env, observation)
    if fault is not None:
        return fault
    if not _is_number(reward):
        return f"{returned} a finite number as the reward, but returned {_describe(reward)}."
    for name, value in (("terminated", terminated), ("truncated", truncated)):
        if np.shape(value) != ():
            return f"{returned} True or False as `{name}`, but returned {_describe(value)}."
    if not isinstance(info, dict):
        return f"{returned} a dict as the info, but returned {_describe(info)}."
    return None


def explain_reset(env: gym.Env, outcome: Any) -> str:
    """
    :param env: the environment
    :param outcome: what its ``reset`` returned, which is not a tuple of an observation and a dict
    :return: a message that says so
    """
    return (
        f"`reset` of {_name(env)} must return (observation, info) with a dict as the info, but returned {_describe(outcome)}."
    )


def find_fault_of_observation(env: gym.Env, observation: Any) -> str | None:
    """
    Find out what is wrong with an observation: its form, and in a finite space also its values.

    :param env: the environment
    :param observation: an observation of it
    :return: a message that names the culprit; ``None`` if all is well
    """
    return _find_fault_of_part(_name(env), "", env.observation_space, observation)


def _find_fault_of_part(name: str, part: str, space: spaces.Space[Any], observation: Any) -> str | None:
    what = f"The part {part} of the observation of {name}" if part else f"The observation of {name}"
    fault = f"{what} must be one of {space}, but is {_describe(observation)}: please check its `reset` and `step`."
    if isinstance(space, spaces.Tuple | spaces.Dict):
        for key, inner in space.spaces.items() if isinstance(space, spaces.Dict) else enumerate(space.spaces):
            try:
                value = observation[key]
            except (TypeError, LookupError):
                return fault
            of_part = _find_fault_of_part(name, f"{part}[{key!r}]", inner, value)
            if of_part is not None:
                return of_part
        return None
    try:
        if isinstance(space, spaces.Box):
            is_sound = np.asarray(observation, dtype=np.float64).shape == space.shape
        else:
            is_sound = make_state_index(space).of(observation) >= 0
    except CONVERSION_ERRORS:
        is_sound = False
    return None if is_sound else fault


def is_whole(values: Any, shape: tuple[int, ...]) -> bool:
    """
    :param values: a number, or an array or a list of them
    :param shape: the shape that they should have
    :return: whether they have it, and all are whole numbers
    """
    array = np.asarray(values)
    if array.shape != shape:
        return False
    return array.dtype.kind in "bui" or bool((array == np.floor(array)).all() and np.isfinite(array).all())


def find_fault_of_call(env: gym.Env, function: str, error: Exception) -> str | None:
    """
    Find out whether a wrapper or a VecEnv could not call an environment, or could not read what it returned. The traceback
    then has only functions of gymnasium, SB3 and this package, none of the environment itself.

    :param env: the environment
    :param function: the name of the method that was called, ``"step"`` or ``"reset"``
    :param error: what was raised
    :return: a message that names the culprit; ``None`` if the error is of another kind
    """
    if not _packages_of(error.__traceback__) <= {"gymnasium", "stable_baselines3", "sb3_adaptive_q"}:
        return None
    if "unpack" in str(error):
        results = "(observation, reward, terminated, truncated, info)" if function == "step" else "(observation, info)"
        return f"`{function}` of {_name(env)} must return {results}, but returned something else: {error}."
    if "unexpected keyword argument" in str(error):
        return f"`{function}` of {_name(env)} must take the keyword arguments `seed` and `options`, but does not: {error}."
    return None


def _packages_of(traceback: TracebackType | None) -> set[str]:
    """The packages of all functions in a traceback."""
    packages = set()
    while traceback is not None:
        packages.add(str(traceback.tb_frame.f_globals.get("__name__", "")).split(".")[0])
        traceback = traceback.tb_next
    return packages


def _is_number(value: Any) -> bool:
    try:
        return np.shape(value) == () and isfinite(value)
    except CONVERSION_ERRORS:
        return False


def _name(env: gym.Env) -> str:
    return type(env.unwrapped).__name__


def _describe(value: Any) -> str:
    shape = f" of shape {value.shape}" if isinstance(value, np.ndarray) else ""
    return f"{value!r}{shape}"
