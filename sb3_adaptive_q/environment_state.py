"""The state of a training's environments as plain data: read for a saved file, and put back when training resumes."""

from collections.abc import Callable, Iterator
from typing import Any

import gymnasium as gym
from gymnasium.envs.classic_control import AcrobotEnv, CartPoleEnv, Continuous_MountainCarEnv, MountainCarEnv, PendulumEnv
from gymnasium.envs.toy_text.blackjack import BlackjackEnv
from gymnasium.envs.toy_text.cliffwalking import CliffWalkingEnv
from gymnasium.envs.toy_text.frozen_lake import FrozenLakeEnv
from gymnasium.envs.toy_text.taxi import TaxiEnv
from gymnasium.wrappers import DiscretizeObservation as GymnasiumDiscretizeObservation
from gymnasium.wrappers import (
    OrderEnforcing,
    PassiveEnvChecker,
    TransformAction,
    TransformObservation,
    TransformReward,
)
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

from sb3_adaptive_q.envs import CartPoleFrictionEnv
from sb3_adaptive_q.saved_values import path_of
from sb3_adaptive_q.vec_env.compiled_env import CompiledEnv
from sb3_adaptive_q.vec_env.dynamics import find_dynamics
from sb3_adaptive_q.vec_env.summed_rewards import SummedRewards
from sb3_adaptive_q.vec_env.tabular_dynamics import steps_by_table
from sb3_adaptive_q.wrappers import DiscretizeObservation

#: The attributes that gymnasium's environments, and ours, keep from step to step
_STATE_OF_ENV: dict[type[gym.Env], tuple[str, ...]] = {
    FrozenLakeEnv: ("s", "lastaction"),
    CliffWalkingEnv: ("s", "lastaction"),
    TaxiEnv: ("s", "lastaction", "fickle_step", "taxi_orientation"),
    BlackjackEnv: ("player", "dealer"),
    CartPoleEnv: ("state", "steps_beyond_terminated"),
    CartPoleFrictionEnv: ("state", "steps_beyond_terminated"),
    MountainCarEnv: ("state",),
    Continuous_MountainCarEnv: ("state",),
    AcrobotEnv: ("state",),
    PendulumEnv: ("state",),
}
_TIME_LIMIT = "gymnasium.wrappers.common:TimeLimit"
#: rl_zoo3 replaces gymnasium's class by its own
_SAME_AS = {"rl_zoo3.gym_patches:PatchedTimeLimit": _TIME_LIMIT}
#: The attributes that wrappers keep from step to step
_STATE_OF_WRAPPER: dict[str, tuple[str, ...]] = {
    path_of(Monitor): ("rewards", "needs_reset", "total_steps", "current_reset_info"),
    _TIME_LIMIT: ("_elapsed_steps",),
    **{path_of(kind): () for kind in (OrderEnforcing, PassiveEnvChecker)},
    **{path_of(kind): () for kind in (DiscretizeObservation, GymnasiumDiscretizeObservation)},
    **{path_of(kind): () for kind in (TransformAction, TransformObservation, TransformReward)},
}


class CannotRead(ValueError):
    """The state of an environment cannot be read. The message names the class, and says what it needs."""


def read_environments(env: VecEnv) -> list[dict[str, Any]]:
    """
    :param env: the environments
    :return: for each of them, the state of its generator, and the state of the environment and its wrappers
    :raises CannotRead: if one of them has no state that can be read and put back
    """
    return [_read(each) for each in _single_envs(env)]


def check_environments(env: VecEnv, states: list[dict[str, Any]]) -> None:
    """
    :param env: environments
    :param states: what :func:`read_environments` returned
    :raises ValueError: if the environments are not like those that were read, or their number differs
    """
    envs = _single_envs(env)
    if len(envs) != len(states):
        raise ValueError(f"the training had {len(states)} environments, but got {len(envs)}")
    for each, state in zip(envs, states, strict=True):
        _check_alike(each, state)


def write_environments(env: VecEnv, states: list[dict[str, Any]]) -> None:
    """
    Put environments into a state that was read. They are reset first, so that they have all that a reset makes.

    :param env: environments that :func:`check_environments` has found to be like those that were read
    :param states: what :func:`read_environments` returned
    """
    env.reset()
    for each, state in zip(_single_envs(env), states, strict=True):
        _write(each, state)


def _single_envs(env: VecEnv) -> list[gym.Env]:
    if not isinstance(env, DummyVecEnv):
        raise CannotRead(f"the environments inside a {type(env).__name__} cannot be read: use LeanVecEnv without a wrapper")
    return env.envs


def _layers(env: gym.Env) -> Iterator[tuple[str, Callable[[], Any], Callable[[Any], None]]]:
    """
    The wrappers that have a state, from the outside to the inside, and then the environment: for each the name of its class,
    a function that reads its state, and one that puts a state back.
    """
    layer = env
    while isinstance(layer, gym.Wrapper):
        if _state_names(layer) != ():
            yield _class_name(layer), *_access(layer, env)
        layer = layer.env
    yield _class_name(layer), *_access(layer, env)


def _class_name(layer: gym.Env) -> str:
    path = path_of(type(layer))
    return _SAME_AS.get(path, path)


def _read(env: gym.Env) -> dict[str, Any]:
    return {
        "generator": dict(env.unwrapped.np_random.bit_generator.state),
        "layers": [{"class": name, "state": read()} for name, read, _ in _layers(env)],
    }


def _check_alike(env: gym.Env, state: dict[str, Any]) -> None:
    ours, theirs = [name for name, _, _ in _layers(env)], [layer["class"] for layer in state["layers"]]
    if ours != theirs:
        told = [" around ".join(name.rpartition(":")[2] for name in names) for names in (theirs, ours)]
        raise ValueError(f"the training's environment was {told[0]}, but got {told[1]}")
    kinds = state["generator"]["bit_generator"], type(env.unwrapped.np_random.bit_generator).__name__
    if kinds[0] != kinds[1]:
        raise ValueError(f"the training's environment drew from a {kinds[0]}, but got one that draws from a {kinds[1]}")


def _write(env: gym.Env, state: dict[str, Any]) -> None:
    env.unwrapped.np_random.bit_generator.state = state["generator"]
    for (_, _, write), saved in zip(_layers(env), state["layers"], strict=True):
        write(saved["state"])


def _access(layer: gym.Env, env: gym.Env) -> tuple[Callable[[], Any], Callable[[Any], None]]:
    """How to read the state of a layer, and how to put one back."""
    get, put = getattr(layer, "get_state", None), getattr(layer, "set_state", None)
    if callable(get) and callable(put):
        return get, put
    names = _state_names(layer)
    if names is not None:
        return lambda: {name: _as_data(getattr(layer, name)) for name in names}, lambda state: _set(layer, names, state)
    if not isinstance(layer, gym.Wrapper) and find_dynamics(layer) is not None:
        dynamics = CompiledEnv(env).dynamics
        return dynamics.read_state, dynamics.write_state
    raise CannotRead(
        f"the state of {type(layer).__name__} cannot be read: give it the methods `get_state()`, which returns plain data, "
        "and `set_state(data)`"
    )


def _as_data(value: Any) -> Any:
    return {"total": value.total, "count": value.count} if isinstance(value, SummedRewards) else value


def _set(layer: gym.Env, names: tuple[str, ...], state: dict[str, Any]) -> None:
    for name in names:
        value = state[name]
        setattr(layer, name, SummedRewards(**value) if name == "rewards" and isinstance(value, dict) else value)


def _state_names(layer: gym.Env) -> tuple[str, ...] | None:
    if {"step", "reset"} & set(vars(layer)):  # they were replaced on this object, and may keep more
        return None
    if isinstance(layer, gym.Wrapper):
        return _STATE_OF_WRAPPER.get(_class_name(layer))
    for kind, names in _STATE_OF_ENV.items():
        if type(layer).step is kind.step and type(layer).reset is kind.reset:
            return names
    return ("s",) if steps_by_table(layer) else None
