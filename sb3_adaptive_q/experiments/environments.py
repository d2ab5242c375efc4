"""The environments that a design names."""

import threading
from typing import Any

import gymnasium as gym
from gymnasium.envs.classic_control.cartpole import CartPoleEnv
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecEnv

from sb3_adaptive_q import CompiledVecEnv, LeanVecEnv
from sb3_adaptive_q.envs.catalogue import PROBLEMS
from sb3_adaptive_q.experiments.errors import DesignError, unknown_name
from sb3_adaptive_q.experiments.names import IMPORT_PATH, is_import_path, load_object
from sb3_adaptive_q.output import locate
from sb3_adaptive_q.wrappers import DiscretizeObservation

#: The bins of the paper's Table 5, for every Cart Pole
CART_POLE_BINS = {"n_edges": 10, "low": [-2.4, -4.0, -0.2095, -4.0], "high": [2.4, 4.0, 0.2095, 4.0]}

_of_thread = threading.local()


def make_env(name: str, **arguments: Any) -> gym.Env:
    """
    :param name: the id of an environment, the name of a problem in :data:`sb3_adaptive_q.envs.catalogue.PROBLEMS`, or the
        ``module:name`` of a function that makes an environment
    :param arguments: for the environment
    :return: the environment; a Cart Pole with the bins of the paper
    :raises DesignError: if there is no such environment
    """
    if is_import_path(name):
        make = load_object(name)
        try:
            env = make(**arguments)
        except Exception as error:  # a function of the user's may raise anything
            raise DesignError(f"The environment {name} cannot be made: {locate(error)}") from error
        if not isinstance(env, gym.Env):
            raise DesignError(f"{name} must make a gymnasium environment, but made a {type(env).__name__}.")
    else:
        env = _make_known(name, arguments)
    is_raw_cart_pole = isinstance(env.unwrapped, CartPoleEnv) and isinstance(env.observation_space, gym.spaces.Box)
    return DiscretizeObservation(env, **CART_POLE_BINS) if is_raw_cart_pole else env  # type: ignore[arg-type]


def _make_known(name: str, arguments: dict[str, Any]) -> gym.Env:
    try:
        return PROBLEMS[name].make(**arguments) if name in PROBLEMS else gym.make(name, **arguments)
    except gym.error.UnregisteredEnv as error:
        raise unknown_name("environment", name, [*PROBLEMS, *gym.registry], IMPORT_PATH) from error
    except (gym.error.Error, ImportError) as error:
        raise DesignError(f"The environment {name!r} cannot be made: {error}") from error


def reused_vec_env(name: str, purpose: str = "", **arguments: Any) -> VecEnv:
    """
    An environment that is made once in every thread, because most of a short run would be spent on it.

    :param name: of an environment
    :param purpose: one that is not in use for another purpose
    :param arguments: for the environment
    :return: it, compiled where it compiles; to be seeded and reset, and then nothing is left in it of its earlier uses
    :raises DesignError: if there is no such environment
    """
    made: dict[str, VecEnv] = _of_thread.__dict__
    key = f"{name} {purpose} {sorted(arguments.items())}"
    if key not in made:
        try:
            made[key] = make_vec_env(lambda: make_env(name, **arguments), vec_env_cls=CompiledVecEnv)
        except DesignError:
            raise
        except ValueError:  # it does not compile
            made[key] = make_vec_env(lambda: make_env(name, **arguments), vec_env_cls=LeanVecEnv)
    return made[key]


def is_compiled(name: str, **arguments: Any) -> bool:
    """
    :param name: of an environment
    :param arguments: for the environment
    :return: whether runs in it are machine code, which threads can share a process for
    :raises DesignError: if there is no such environment
    """
    return isinstance(reused_vec_env(name, **arguments), CompiledVecEnv)
