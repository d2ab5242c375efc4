"""The dynamics of a compiled environment: three plain functions, their parameters, and access to the Python object."""

import inspect
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple, TypeVar

import gymnasium as gym
import numpy as np

from sb3_adaptive_q.compiled.loops import check_transition
from sb3_adaptive_q.compiled.places import empty_places, place_functions
from sb3_adaptive_q.wrappers import edges_of

DynamicsT = TypeVar("DynamicsT", bound="type[Dynamics]")

_registered: dict[type[gym.Env], "type[Dynamics]"] = {}


class Dynamics:
    """
    An environment's ``reset`` and ``step`` as plain functions. A subclass has three static functions in the part of Python
    that Numba compiles; a state is a whole number, or a tuple of up to eight floats:

    - ``reset(parameters, generator) -> state``, or ``reset(parameters, state, generator) -> state`` if something lasts
      longer than an episode; ``state`` is the one in which the last episode ended
    - ``step(parameters, state, action, generator) -> (state, reward, terminated)``; actions count from 0
    - ``index(parameters, state) -> row of the table``

    ``generator`` is the environment's own ``np_random``. The functions must draw the same numbers from it as the environment,
    in the same order, and compute in the same order of operations. Both paths then give the same bits.

    With ``draws_from_words = True``, ``generator`` is the state of that generator as four 64-bit numbers, and
    :func:`sb3_adaptive_q.random_numbers.random_float` draws from it what ``np_random.random()`` would. This is the fastest
    way, if the environment draws nothing else.

    :param env: the environment without its wrappers
    :param grid: the edges of the :class:`sb3_adaptive_q.wrappers.DiscretizeObservation` around it, if there is one
    :raises ValueError: if the environment has settings that these functions do not cover
    """

    reset: ClassVar[Callable[..., Any]]
    step: ClassVar[Callable[..., Any]]
    index: ClassVar[Callable[..., int]]
    #: The check of every transition
    check: ClassVar[Callable[..., int]] = staticmethod(check_transition)
    draws_from_words: ClassVar[bool] = False
    #: The constants that the functions need, as a named tuple of numbers and arrays
    parameters: Any

    def __init__(self, env: gym.Env, grid: "Grid | None") -> None:
        self.env = env

    def table_shape(self) -> tuple[int, int] | None:
        """
        :return: how many states ``index`` numbers, and for how many actions there are parameters; ``None`` for what the
            environment's spaces say
        """
        return None

    def read_state(self) -> Any:
        """
        :return: the environment's state as the functions take it
        :raises ValueError: if it is not made of numbers
        """
        state = self.env.state  # type: ignore[attr-defined]
        try:
            return tuple(float(value) for value in state)
        except (TypeError, ValueError) as error:
            raise ValueError(
                f"`state` of {type(self.env).__name__} must be numbers, but is {state!r}: please reset the environment."
            ) from error

    def write_state(self, state: Any) -> None:
        """
        :param state: the state to put the environment into
        """
        self.env.state = np.array(state)  # type: ignore[attr-defined]

    def empty_places(self, n_envs: int) -> np.ndarray:
        """
        :param n_envs: the number of environments
        :return: the array for their states, of shape (n_envs, size of a state)
        """
        return empty_places(n_envs, self.read_state())

    def state_of(self, row: np.ndarray) -> Any:
        """
        :param row: a row of the array of states
        :return: the state in it
        """
        return tuple(row.tolist()) if isinstance(self.read_state(), tuple) else int(row[0])

    def reset_function(self) -> Callable[..., Any]:
        """
        :return: ``reset`` as a function of the parameters, the state in which the last episode ended, and the generator
        """
        if len(inspect.signature(self.reset).parameters) == 3:
            return self.reset
        reset = self.reset

        def reset_anew(parameters, state, generator):
            return reset(parameters, generator)

        return reset_anew

    def loop_functions(self) -> tuple[Callable[..., Any], ...]:
        """
        :return: the functions that a learning loop calls: reset, step, index, load and store of the state, the function that
            names the parameters, and the check of a transition
        """
        load, store = place_functions(self.read_state())
        return self.reset_function(), self.step, self.index, load, store, _name_parameters(type(self.parameters)), self.check


def _name_parameters(container: type) -> Callable[..., Any]:
    if container is tuple:

        def as_tuple(*parameters):
            return parameters

        return as_tuple

    def as_named_tuple(*parameters):
        return container(*parameters)

    return as_named_tuple


def register_dynamics(env_class: type[gym.Env]) -> Callable[[DynamicsT], DynamicsT]:
    """
    Let :class:`CompiledVecEnv` compile an environment of yours.

    :param env_class: the class of the environment, without wrappers
    :return: a decorator for the :class:`Dynamics` of that environment
    """

    def register(dynamics: DynamicsT) -> DynamicsT:
        _registered[env_class] = dynamics
        return dynamics

    return register


def find_dynamics(env: gym.Env) -> "type[Dynamics] | None":
    """
    :param env: an environment without its wrappers
    :return: the dynamics registered for exactly this class, because a subclass may step differently; ``None`` without any
    """
    return _registered.get(type(env))


def registered_names() -> list[str]:
    """
    :return: the names of the environment classes with registered dynamics
    """
    return sorted(env_class.__name__ for env_class in _registered)


def whole_number_of(env: Any, name: str) -> int:
    """
    :param env: an environment without its wrappers
    :param name: of an attribute that must be a whole number from 0 to 2**53, up to which floats are exact
    :return: the number
    :raises ValueError: if it is anything else
    """
    value = getattr(env, name)
    try:
        is_fit = bool(int(value) == value) and 0 <= value <= 2**53
    except (TypeError, ValueError, OverflowError):
        is_fit = False
    if not is_fit:
        raise ValueError(
            f"`{name}` of {type(env).__name__} must be a whole number from 0 to 2**53, but is {value!r}: please set it to one."
        )
    return int(value)


class Grid(NamedTuple):
    """
    The cells of a :class:`sb3_adaptive_q.wrappers.DiscretizeObservation`, for compiled code.

    :param edges: of shape (dimensions, largest number of edges), padded with infinity
    :param counts: how many edges each dimension has
    :param scales: cells per unit of each dimension
    """

    edges: np.ndarray
    counts: np.ndarray
    scales: np.ndarray

    @classmethod
    def of(cls, discretizer: Any) -> "Grid":
        """
        :param discretizer: the wrapper, ours or gymnasium's of the same name
        :return: its cells
        """
        edges_of_dimensions = edges_of(discretizer)
        counts = np.array([len(edges) for edges in edges_of_dimensions])
        edges = np.full((len(counts), max(1, counts.max())), np.inf)
        scales = np.ones(len(counts))
        for dimension, values in enumerate(edges_of_dimensions):
            edges[dimension, : len(values)] = values
            if len(values) == 0:
                edges[dimension, 0] = 0.0  # any finite number: there is one cell
            elif len(values) > 1:
                scales[dimension] = (len(values) - 1) / (values[-1] - values[0])
        return cls(edges, counts, scales)


def grid_index(edges, counts, scales, observation):
    """
    The number of the cell that holds an observation, as :class:`sb3_adaptive_q.wrappers.DiscretizeObservation` numbers it.

    :param edges: as in :class:`Grid`
    :param counts: as in :class:`Grid`
    :param scales: as in :class:`Grid`
    :param observation: a tuple of floats, rounded to the observation's dtype
    :return: the number of the cell; there is one for everything, also for what is no number
    """
    index, one = np.uint64(0), np.uint64(1)  # unsigned: Numba does not check for negative indices
    for dimension in range(len(observation)):
        value, count = observation[dimension], counts[dimension]
        # Exact up to rounding if the edges are evenly spaced. The two loops then find the exact cell
        distance = (value - edges[dimension, 0]) * scales[dimension]
        guess = min(distance, float(count)) if distance > 0.0 else 0.0  # 0 also for what is no number
        cell, end = np.uint64(int(guess)), np.uint64(count)
        while cell < end and edges[dimension, cell] <= value:
            cell += one
        while cell > 0 and edges[dimension, cell - one] > value:
            cell -= one
        index = index * (end + one) + cell
    return np.int64(index)


def as_float32(value):
    """
    :param value: a component of the state, float64
    :return: the value rounded to float32, as an observation has it
    """
    return np.float64(np.float32(value))
