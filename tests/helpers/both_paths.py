"""The built-in environments that compile, a model on either path, and what a training leaves behind."""

from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from stable_baselines3.common.callbacks import CallbackList
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecEnv

from sb3_adaptive_q import CompiledVecEnv, EpisodeSeriesCallback, LeanVecEnv, TabularQ
from wrappers import DiscretizeObservation


class Setting(NamedTuple):
    """How to make an environment: its id, its arguments, and whether its observation is to be put into cells."""

    env_id: str
    arguments: dict[str, Any]
    discretized: bool = False


#: The 11 x 11 x 11 x 11 cells of the paper's Table 5
CELLS = {"n_edges": 10, "low": [-2.4, -4.0, -0.2095, -4.0], "high": [2.4, 4.0, 0.2095, 4.0]}

ENVIRONMENTS = {
    "slippery lake": Setting("FrozenLake-v1", {}),
    "firm lake": Setting("FrozenLake-v1", {"is_slippery": False}),
    "large lake": Setting("FrozenLake8x8-v1", {}),
    "Taxi": Setting("Taxi-v4", {}),
    "CliffWalking": Setting("CliffWalking-v1", {}),
    "CartPole": Setting("CartPole-v1", {}, discretized=True),
    "CartPoleFriction": Setting("CartPoleFriction-v0", {}, discretized=True),
}


def make_env(name: str, **arguments: Any) -> gym.Env:
    """
    :param name: a key of ``ENVIRONMENTS``
    :param arguments: further arguments of ``gymnasium.make``
    :return: the environment, without a Monitor
    """
    setting = ENVIRONMENTS[name]
    env = gym.make(setting.env_id, **setting.arguments, **arguments)
    return DiscretizeObservation(env, **CELLS) if setting.discretized else env


def make_vec(name: str, compiled: bool, n_envs: int = 1, **arguments: Any) -> LeanVecEnv:
    """
    :param name: a key of ``ENVIRONMENTS``
    :param compiled: whether the fused loop may run it
    :param n_envs: how many
    :param arguments: further arguments of ``make_vec_env``
    :return: the vectorised environment, with Monitors
    """
    setting = ENVIRONMENTS[name]
    if setting.discretized:
        arguments.update(wrapper_class=DiscretizeObservation, wrapper_kwargs=CELLS)
    kind = CompiledVecEnv if compiled else LeanVecEnv
    return make_vec_env(setting.env_id, n_envs, env_kwargs=setting.arguments, vec_env_cls=kind, **arguments)  # type: ignore


def make_model(name: str, compiled: bool, n_envs: int = 1, **arguments: Any) -> TabularQ:
    """
    :param name: a key of ``ENVIRONMENTS``
    :param compiled: whether the fused loop runs it
    :param n_envs: how many environments
    :param arguments: further arguments of :class:`TabularQ`
    :return: a model on them
    """
    return TabularQ("MlpPolicy", make_vec(name, compiled, n_envs), **{"seed": 0, **arguments})


def step_alike(ours: VecEnv, theirs: VecEnv, actions: np.ndarray) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """
    Step two environments, which have to do the same.

    :param ours: one
    :param theirs: the other
    :param actions: for both
    :return: their infos, in pairs
    :raises AssertionError: if an observation, a reward or a done differs
    """
    (*our_arrays, our_infos), (*their_arrays, their_infos) = ours.step(actions), theirs.step(actions)
    for our, their in zip(our_arrays, their_arrays, strict=True):
        np.testing.assert_array_equal(our, their)
    return list(zip(our_infos, their_infos, strict=True))


class Outcome(NamedTuple):
    """What a training leaves behind; the last four are arrays with a row for each episode."""

    table: np.ndarray
    mu: float
    exploration_rate: float
    num_timesteps: int
    n_episodes: int
    n_updates: int
    statistics: tuple[float, ...]
    counter: int
    returns: np.ndarray
    lengths: np.ndarray
    rates: np.ndarray
    epsilons: np.ndarray


def learn(model: TabularQ, total_timesteps: int, callback: Any = None, **arguments: Any) -> Outcome:
    """
    :param model: the model to train
    :param total_timesteps: as in ``learn``
    :param callback: as in ``learn``; beside it the episodes are kept
    :param arguments: further arguments of ``learn``
    :return: what it leaves behind
    """
    series = EpisodeSeriesCallback()
    callbacks = [series] if callback is None else [series, *(callback if isinstance(callback, list) else [callback])]
    model.learn(total_timesteps, callback=CallbackList(callbacks), **{"log_interval": None, **arguments})
    return Outcome(
        model.q_table.copy(),
        model.mu,
        model.exploration_rate,
        model.num_timesteps,
        model._episode_num,
        model._n_updates,
        tuple(model.training.record[0][name].item() for name in ("mu_sum", "mu_min", "mu_max", "td_error_sum")),
        int(model.training.draws[0]),  # equal here: as many numbers were drawn
        series.returns,
        series.lengths,
        series.rates,
        series.epsilons,
    )


def assert_same(ours: Outcome, theirs: Outcome) -> None:
    """
    :param ours: what one path left behind
    :param theirs: what the other did
    :raises AssertionError: unless they are equal in every bit
    """
    for name, our, their in zip(Outcome._fields, ours, theirs, strict=True):
        our, their = np.asarray(our), np.asarray(their)
        assert (our.dtype, our.shape) == (their.dtype, their.shape), name
        np.testing.assert_array_equal(our, their, name)
        assert our.tobytes() == their.tobytes(), name  # the sign of a zero too
