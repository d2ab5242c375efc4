"""The environments of a study, wrapped as the paper has them."""

import re
import threading
from functools import cache
from typing import Any, NamedTuple

import gymnasium as gym
from gymnasium.envs.classic_control.cartpole import CartPoleEnv
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecEnv

from sb3_adaptive_q.study.errors import DesignError
from sb3_adaptive_q.study.settings import CART_POLE, FROZEN_LAKE
from sb3_adaptive_q.vec_env import CompiledVecEnv
from sb3_adaptive_q.wrappers import DiscretizeObservation

#: The bins of Table 5, for every Cart Pole
CART_POLE_BINS = {"n_edges": 10, "low": [-2.4, -4.0, -0.2095, -4.0], "high": [2.4, 4.0, 0.2095, 4.0]}


class PaperSystem(NamedTuple):
    """
    What the paper has on a system.

    :param title: its name there
    :param results_table: the number of the table of its results
    :param q_table: the number of the table of its Q values
    :param first_figure: the number of the first of its four figures
    :param limit: the largest return of an episode
    :param best_method: the method that it calls the best
    """

    title: str
    results_table: int
    q_table: int
    first_figure: int
    limit: float
    best_method: int


PAPER_SYSTEMS = {
    FROZEN_LAKE: PaperSystem("Frozen Lake", 7, 1, 6, 1.0, 1),
    CART_POLE: PaperSystem("Cart Pole", 8, 6, 10, 200.0, 7),
}

_of_thread = threading.local()


def title_of(system: str) -> str:
    """
    :param system: the id of an environment
    :return: what to call it in a heading
    """
    return PAPER_SYSTEMS[system].title if system in PAPER_SYSTEMS else system


def file_name(system: str) -> str:
    """
    :param system: the id of an environment
    :return: it as a part of a path
    """
    return re.sub(r"[^\w.-]", "_", system)


@cache
def wrapping_of(system: str) -> dict[str, Any]:
    """
    :param system: the id of an environment
    :return: the parameters of its :class:`wrappers.DiscretizeObservation`; empty where none is needed
    """
    env = gym.make(system)
    is_cart_pole = isinstance(env.unwrapped, CartPoleEnv)
    env.close()
    return CART_POLE_BINS if is_cart_pole else {}


def make_system(system: str, wrapping: dict[str, Any]) -> VecEnv:
    """
    :param system: the id of an environment
    :param wrapping: the parameters of its discretisation, or an empty dict
    :return: one compiled environment
    """
    wrapper = {"wrapper_class": DiscretizeObservation, "wrapper_kwargs": wrapping} if wrapping else {}
    return make_vec_env(system, vec_env_cls=CompiledVecEnv, **wrapper)  # type: ignore[arg-type]


def reused_system(system: str, wrapping: dict[str, Any]) -> VecEnv:
    """
    The same as :func:`make_system`, made once in every thread: most of a short cell would be spent on it.

    :param system: the id of an environment
    :param wrapping: the parameters of its discretisation, or an empty dict
    :return: an environment which is to be seeded and reset, and then has nothing left of its earlier uses
    """
    made: dict[str, VecEnv] = _of_thread.__dict__
    key = f"{system} {wrapping}"
    if key not in made:
        made[key] = make_system(system, wrapping)
    return made[key]


def check_system(system: str) -> None:
    """
    :param system: what should be the id of an environment
    :raises DesignError: if there is no such environment, or it does not compile
    """
    try:
        reused_system(system, wrapping_of(system))
    except (gym.error.Error, ImportError) as error:
        raise DesignError(
            f"Unknown system {system!r} ({error}): give the id of a gymnasium environment, "
            f"{', '.join(PAPER_SYSTEMS)} being the paper's."
        ) from error
    except ValueError as error:
        raise DesignError(f"System {system!r} cannot be studied: {error}") from error
