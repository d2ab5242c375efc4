"""What the pictures read: the table or the step size's memory of a model, and its environment without the vector around it."""

from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium.wrappers import DiscretizeObservation as GymnasiumDiscretizeObservation
from stable_baselines3.common.vec_env import VecEnv

from sb3_adaptive_q.state_index import make_state_index
from sb3_adaptive_q.wrappers import DiscretizeObservation, edges_of

_MEMORY = "memory:"


class Quantity(NamedTuple):
    """
    Numbers to draw.

    :param values: of shape (n_states, n_actions), or (n_states, 1) for one number a state
    :param label: what they are, in words
    """

    values: np.ndarray
    label: str


class Components(NamedTuple):
    """
    The numbers that an observation consists of.

    :param sizes: how many values each of them can take
    :param starts: the least value of each
    :param edges: for discretised observations the bounds between the cells of each, in the unit of the observation
    """

    sizes: tuple[int, ...]
    starts: tuple[int, ...]
    edges: tuple[np.ndarray, ...] | None


def read_table(model: Any) -> np.ndarray:
    """
    :param model: a model with a ``q_table``, or a table itself, of shape (n_states, n_actions)
    :return: a copy of the table
    :raises ValueError: if it is neither
    """
    table = np.array(getattr(model, "q_table", model))
    if table.ndim != 2 or table.dtype.kind not in "fiu":
        raise ValueError(
            "Expected a model with a `q_table`, or a table of shape (n_states, n_actions), but got "
            f"{type(model).__name__}{f' of shape {table.shape}' if table.ndim else ''}."
        )
    return table.astype(np.float64)


def read_memory(model: Any) -> dict[str, np.ndarray]:
    """
    :param model: a model, or a table
    :return: copies of the arrays of its step size by name, each of shape (n_states, n_actions), (n_states, 1) or (1, 1),
        with a leading axis where an algorithm keeps several tables
    """
    return {name: np.array(array) for name, array in dict(getattr(model, "memory", None) or {}).items()}


def read_quantity(model: Any, what: str) -> Quantity:
    """
    :param model: a model, or a table
    :param what: ``"value"``, ``"q"`` or ``"memory:<name>"``
    :return: the numbers; where an algorithm keeps several tables, the mean over their memories
    :raises ValueError: if the model has no such array, or one number for all states
    """
    table = read_table(model)
    if what == "value":
        return Quantity(table.max(axis=1, keepdims=True), "value of the greedy action, max Q(s, a)")
    if what == "q":
        return Quantity(table, "action value Q(s, a)")
    memory = read_memory(model)
    name = what.removeprefix(_MEMORY)
    if not what.startswith(_MEMORY) or name not in memory:
        known = ", ".join(repr(each) for each in ("value", "q", *(_MEMORY + each for each in memory)))
        raise ValueError(f"`what` must be one of {known} for this model, but got {what!r}.")
    values = memory[name]
    while values.ndim > 2:
        values = values.mean(axis=0)
    if len(values) != len(table):
        raise ValueError(
            f"`{name}` is one number that all states share, {values.ravel().tolist()}: there is nothing to draw. Give the "
            'method the scope "pair" or "state".'
        )
    return Quantity(values, name.replace("_", " "))


def find_env(model: Any, env: gym.Env[Any, Any] | VecEnv | str | None) -> gym.Env[Any, Any] | None:
    """
    :param model: a model, or a table
    :param env: an environment, several of them, or the id of one; ``None`` for the one that the model learns from
    :return: the environment, the first of several; ``None`` where there is none in this process
    """
    if isinstance(env, str):
        return gym.make(env)
    found: Any = env if env is not None or not hasattr(model, "get_env") else model.get_env()
    if isinstance(found, VecEnv):
        found = getattr(found.unwrapped, "envs", [None])[0]
    return found


def find_components(model: Any, env: gym.Env[Any, Any] | None, n_states: int) -> Components:
    """
    :param model: a model, or a table
    :param env: its environment, where there is one
    :param n_states: the rows of the table
    :return: what the observations consist of
    """
    edges = _find_edges(env)
    cells = tuple(len(each) + 1 for each in edges)
    if edges and np.prod(cells) == n_states:
        return Components(cells, (0,) * len(cells), edges)
    space = getattr(model, "observation_space", None) or (None if env is None else env.observation_space)
    if space is not None:
        index = make_state_index(space)
        if index.n_states == n_states:
            return Components(index.sizes, index.starts, None)
    return Components((n_states,), (0,), None)


def _find_edges(env: gym.Env[Any, Any] | None) -> tuple[np.ndarray, ...]:
    """Those of the wrapper that discretises the observations; none without one."""
    while isinstance(env, gym.Wrapper):
        if isinstance(env, DiscretizeObservation | GymnasiumDiscretizeObservation):
            return edges_of(env)
        env = env.env
    return ()
