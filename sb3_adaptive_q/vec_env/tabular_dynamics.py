"""Dynamics of environments with a transition table ``P``, such as gymnasium's toy-text environments."""

from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.envs.toy_text.cliffwalking import CliffWalkingEnv
from gymnasium.envs.toy_text.frozen_lake import FrozenLakeEnv
from gymnasium.envs.toy_text.taxi import TaxiEnv

from sb3_adaptive_q.compiled.loops import check_nothing
from sb3_adaptive_q.random_numbers import draw_place, random_float
from sb3_adaptive_q.vec_env.dynamics import Dynamics, Grid, whole_number_of
from sb3_adaptive_q.vec_env.readings import Readings

#: A VecEnv returns rewards as float32
LARGEST_REWARD = float(np.finfo(np.float32).max)

#: An outcome of an action in a state. It is one record, because separate arrays would cost a cache miss each
OUTCOME = np.dtype(
    [("cumulative", np.float64), ("reward", np.float64), ("next_state", np.int64), ("terminated", np.bool_)], align=True
)

#: gymnasium's environments whose steps do nothing but draw from their tables
_BY_TABLE = (FrozenLakeEnv, TaxiEnv, CliffWalkingEnv)

#: The tables that were read, by the class of the environment and by whether they have more states than these
_readings: dict[tuple[type, bool], Readings] = {}
LARGE = 1000

#: Up to this number of outcomes, machine code is specialised for the number
MOST_UNROLLED = 8


class TransitionTable(NamedTuple):
    """
    ``P`` and the initial distribution as arrays.

    :param initial: cumulative probabilities of the first state, of shape (n_states,)
    :param outcomes: of shape (n_states, n_actions, n). A pair with fewer than n outcomes is padded with its first outcome and
        an infinite cumulative probability, because gymnasium takes the first outcome if rounding leaves a drawn number above
        all cumulative probabilities. n is the largest number of outcomes, plus 1 if such padding is needed there too
    :param comparisons: one entry for each outcome but the last. Only the length matters, which the compiler knows of a tuple.
        Empty if there are more than ``MOST_UNROLLED`` outcomes
    """

    initial: np.ndarray
    outcomes: np.ndarray
    comparisons: tuple[int, ...]


class TabularDynamics(Dynamics):
    """
    Draws from ``env.P[state][action]``, a list of (probability, next state, reward, terminated), and from
    ``env.initial_state_distrib``, as gymnasium does.

    :param env: an environment with both, and its state in ``s``
    :param grid: unused
    :raises ValueError: if probabilities do not sum to 1, a next state is out of range or a reward is not finite
    """

    check = staticmethod(check_nothing)  # the table is checked when it is read
    draws_from_words = True

    def __init__(self, env: gym.Env, grid: Grid | None) -> None:
        super().__init__(env, grid)
        self.parameters = read_table(env)

    def read_state(self) -> int:
        if not hasattr(self.env, "s"):
            raise ValueError(
                f"{type(self.env).__name__} has a transition table `P`, so its state must be in the attribute `s`, but it "
                "has none after a reset: please keep the state in `s`, or use LeanVecEnv, which works with everything."
            )
        return whole_number_of(self.env, "s")

    def table_shape(self) -> tuple[int, int] | None:
        if type(self).index is not TabularDynamics.index:  # states and rows are then two things
            return None
        return self.parameters.outcomes.shape[:2]

    def write_state(self, state: Any) -> None:
        self.env.s = int(state)  # type: ignore[attr-defined]

    @staticmethod
    def reset(parameters, generator):
        """Draw the first state."""
        return draw_place(parameters.initial, generator)

    @staticmethod
    def step(parameters, state, action, generator):
        """Draw an outcome. Counting without a branch is fastest if there are few."""
        number = random_float(generator)
        outcome = 0
        state, action = np.uint64(state), np.uint64(action)  # unsigned: Numba does not check for negative indices
        for i in range(len(parameters.comparisons) or parameters.outcomes.shape[2] - 1):
            outcome += 1 if parameters.outcomes[state, action, i]["cumulative"] <= number else 0
        drawn = parameters.outcomes[state, action, outcome]
        return drawn["next_state"], drawn["reward"], drawn["terminated"]

    @staticmethod
    def index(parameters, state):
        """The state is the row."""
        return state


def has_table(env: gym.Env) -> bool:
    """
    :param env: an environment without its wrappers
    :return: whether it has what :class:`TabularDynamics` reads
    """
    return all(hasattr(env, name) for name in ("P", "initial_state_distrib"))


def steps_by_table(env: gym.Env) -> bool:
    """
    :param env: an environment without its wrappers
    :return: whether its steps do nothing but draw from its table: gymnasium's own classes, and those with the attribute
        ``compile_by_table = True``
    """
    kind = type(env)
    if getattr(kind, "compile_by_table", False):
        return True
    if getattr(env, "fickle_passenger", False):  # Taxi then moves by more than its table
        return False
    return any(kind.step is known.step and kind.reset is known.reset for known in _BY_TABLE)


def read_table(env: Any) -> TransitionTable:
    """
    :param env: an environment with ``P`` and ``initial_state_distrib``
    :return: both as arrays; the same ones as in an earlier call for an equal environment of the class
    :raises ValueError: if probabilities do not sum to 1, a next state is out of range or a reward is not finite
    """
    if not isinstance(env.P, dict) or hasattr(env.P, "__missing__"):  # it may give more than it holds
        return _read_table(env)
    sizes = getattr(env.observation_space, "n", None), getattr(env.action_space, "n", None)
    contents = env.P, list(env.initial_state_distrib), sizes, repr(env.observation_space)
    is_large = len(env.P) > LARGE
    readings = _readings.setdefault((type(env), is_large), Readings(most=1 if is_large else 30))
    return readings.get(contents, lambda: _read_table(env))


def _read_table(env: Any) -> TransitionTable:
    n_states, n_actions = _count(env, "observation_space"), _count(env, "action_space")
    if not 1 <= len(env.initial_state_distrib) <= n_states:
        raise ValueError(
            f"`initial_state_distrib` must have a probability for each of the {n_states} states, but has "
            f"{len(env.initial_state_distrib)}: please check it."
        )
    rows = [[_outcomes_of(env, state, action) for action in range(n_actions)] for state in range(n_states)]
    most = max(len(outcomes) for row in rows for outcomes in row)
    table = np.empty((n_states, n_actions, most + 1), dtype=OUTCOME)
    for state, row in enumerate(rows):
        for action, outcomes in enumerate(row):
            name = f"P[{state}][{action}]"
            _check_outcomes(name, outcomes, n_states)
            cumulative = _cumulative(name, [outcome[0] for outcome in outcomes]).tolist()
            records = [
                (bound, reward, next_state, terminated)
                for bound, (_, next_state, reward, terminated) in zip(cumulative, outcomes, strict=True)
            ]
            table[state, action] = records + [(np.inf, *records[0][1:])] * (most + 1 - len(records))
    if (table["cumulative"][:, :, most - 1] >= 1.0).all():
        table = table[:, :, :most].copy()
    comparisons = tuple(range(table.shape[2] - 1)) if most <= MOST_UNROLLED else ()
    return TransitionTable(_cumulative("initial_state_distrib", env.initial_state_distrib), table, comparisons)


def playable_states(table: TransitionTable, most_rows: int = 10_000) -> np.ndarray:
    """
    :param table: the transitions
    :param most_rows: the largest number of states to look at, in a large table
    :return: states in which an action may be taken: where an episode begins or goes on
    """
    n_states = len(table.outcomes)
    outcomes = table.outcomes[:: -(-n_states // most_rows)]
    bounds = outcomes["cumulative"]
    possible = np.isfinite(bounds)
    possible[:, :, 1:] &= bounds[:, :, 1:] > bounds[:, :, :-1]
    possible[:, :, 0] &= bounds[:, :, 0] > 0.0
    begins = np.flatnonzero(np.diff(table.initial[:most_rows], prepend=0.0) > 0.0)
    return np.union1d(begins, outcomes["next_state"][possible & ~outcomes["terminated"]])


def _count(env: Any, name: str) -> int:
    space = getattr(env, name)
    if not isinstance(space, spaces.Discrete) or (name == "observation_space" and space.start != 0):
        raise ValueError(
            f"An environment with a transition table `P` compiles only if its {name} is Discrete and its states count from 0, "
            f"but the {name} of {type(env).__name__} is {space}: use LeanVecEnv, which works with everything."
        )
    return int(space.n)


def _outcomes_of(env: Any, state: int, action: int) -> Any:
    try:
        outcomes = env.P[state][action]
        len(outcomes)
    except (LookupError, TypeError) as error:
        raise ValueError(f"`P` must have a list P[{state}][{action}], but that is missing: please check the table.") from error
    return outcomes


def _cumulative(name: str, probabilities: Any) -> np.ndarray:
    values = np.asarray(probabilities, dtype=np.float64)
    if values.ndim != 1 or not (values >= 0.0).all() or not np.isclose(values.sum(), 1.0, rtol=0.0, atol=1e-8):
        shown = values.tolist() if values.size < 100 else f"an array of shape {values.shape}"
        raise ValueError(f"The probabilities of {name} must sum to 1, but are {shown}: please check the table.")
    return np.cumsum(values)


def _check_outcomes(name: str, outcomes: Any, n_states: int) -> None:
    if not outcomes:
        raise ValueError(f"{name} must have at least one outcome, but is empty: please check the table.")
    for outcome in outcomes:
        try:
            *numbers, _ = outcome
            _, next_state, reward = (float(each + 0.0) for each in numbers)  # a text is no number
        except (TypeError, ValueError) as error:
            raise ValueError(
                f"The outcomes of {name} must be (probability, next state, reward, terminated), but one is {outcome!r}."
            ) from error
        if not (0 <= next_state < n_states and next_state == int(next_state)):
            raise ValueError(f"The next states of {name} must be 0 to {n_states - 1}, but one is {next_state:.16g}.")
        if not abs(reward) <= LARGEST_REWARD:
            raise ValueError(f"The rewards of {name} must be finite numbers of float32, but one is {reward}.")
