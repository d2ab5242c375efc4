"""
The maps of grid worlds: which row of the table belongs to which cell, and where each action leads.

FrozenLake, CliffWalking, Taxi and the grids of this package are known. An environment of your own has a map if
``env.unwrapped`` has these attributes:

- ``desc``: the letters of the cells, an array of shape (rows, columns) or a list of strings: S start, G goal, H hole, C cliff,
  # wall, anything else an ordinary cell. Or ``grid_shape``: (rows, columns), and with it, if there are any, ``walls``: the
  cells that cannot be entered, as pairs (row, column).
- ``moves``: for each action the change of row and column, (-1, 0) for one up; (0, 0) for an action that does not move.

State r * columns + c is the cell in row r and column c. Where there are a transition table ``P`` and
``initial_state_distrib`` as in gymnasium's toy-text environments, start and terminal states are read from them.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.envs.toy_text.cliffwalking import POSITION_MAPPING, CliffWalkingEnv
from gymnasium.envs.toy_text.frozen_lake import FrozenLakeEnv
from gymnasium.envs.toy_text.taxi import TaxiEnv

START, GOAL, HOLE, CLIFF, TERMINAL, WALL = "S", "G", "H", "C", "T", "#"
PASSENGER, DESTINATION = "P", "D"
#: What the letters of a cell mean
MEANINGS = {
    START: "start",
    GOAL: "goal",
    HOLE: "hole",
    CLIFF: "cliff",
    TERMINAL: "end of the episode",
    WALL: "wall",
    PASSENGER: "passenger",
    DESTINATION: "destination",
}
#: Cells whose values say nothing: no action is taken there
WITHOUT_ACTION = (GOAL, HOLE, CLIFF, TERMINAL, WALL)

_LAKE_MOVES = ((0, -1), (1, 0), (0, 1), (-1, 0))
_TAXI_MOVES = ((1, 0), (-1, 0), (0, 1), (0, -1), (0, 0), (0, 0))
#: Taxi's four places, in gymnasium's order, and the taxi itself as the passenger's fifth
TAXI_PLACES = ("R", "G", "Y", "B", "taxi")

Segment = tuple[tuple[float, float], tuple[float, float]]


@dataclass(frozen=True)
class GridMap:
    """
    A map.

    :param letters: of the cells, of shape (rows, columns); the empty string for an ordinary cell
    :param states: the rows of the table that the cells belong to, of the same shape
    :param moves: for each action the change of row and column
    :param names: what to write for actions that do not move
    :param fences: lines between cells that cannot be crossed, from (x, y) to (x, y), x in columns and y in rows
    :param title: what part of the environment it shows, where it is not all
    """

    letters: np.ndarray
    states: np.ndarray
    moves: tuple[tuple[int, int], ...]
    names: dict[int, str] = field(default_factory=dict)
    fences: tuple[Segment, ...] = ()
    title: str = ""

    def cell_of(self, state: int) -> tuple[int, int] | None:
        """
        :param state: a row of the table
        :return: the row and the column of its cell; ``None`` if it is not on the map
        """
        found = np.argwhere(self.states == state)
        return (int(found[0, 0]), int(found[0, 1])) if len(found) else None

    def has_four_directions(self) -> bool:
        """
        :return: whether the actions are up, down, left and right, in some order
        """
        return sorted(self.moves) == sorted(_LAKE_MOVES)


def find_map(
    env: gym.Env[Any, Any] | None, n_states: int, passenger: str | None = None, destination: str | None = None
) -> GridMap | None:
    """
    :param env: an environment
    :param n_states: the rows of the table
    :param passenger: where Taxi's passenger is: ``"R"``, ``"G"``, ``"Y"``, ``"B"`` or ``"taxi"``; ``None`` for ``"R"``
    :param destination: where they want to go: one of the first four; ``None`` for the first other than the passenger's
    :return: its map; ``None`` if it has none, or one with another number of cells than the table has rows
    :raises ValueError: if ``passenger`` or ``destination`` does not fit, or ``moves`` is missing or does not fit
    """
    inner: Any = None if env is None else env.unwrapped
    if isinstance(inner, TaxiEnv) and n_states == inner.observation_space.n:  # type: ignore[attr-defined]
        return _taxi_map(inner, *_taxi_places(passenger, destination))
    if passenger is not None or destination is not None:
        raise ValueError("`passenger` and `destination` are Taxi's: please leave them out for other environments.")
    letters = _letters(inner)
    if letters is None or letters.size != n_states:
        return None
    _mark_start_and_end(letters, inner)
    moves, first_action = _moves(inner), int(getattr(env, "action_space", inner.action_space).start)
    names = {action: f"action {action + first_action}" for action in range(len(moves))}
    return GridMap(letters, np.arange(n_states).reshape(letters.shape), moves, names)


def taxi_layer(env: gym.Env[Any, Any], state: int) -> dict[str, str]:
    """
    :param env: an environment
    :param state: a row of its table
    :return: ``passenger`` and ``destination`` of a Taxi in that state; nothing for other environments
    """
    inner: Any = env.unwrapped
    if not isinstance(inner, TaxiEnv):
        return {}
    _, _, passenger, destination = inner.decode(state)
    return {"passenger": TAXI_PLACES[passenger], "destination": TAXI_PLACES[destination]}


def _letters(inner: Any) -> np.ndarray | None:
    """The letters that the environment itself gives to its cells."""
    if isinstance(inner, CliffWalkingEnv):
        return _cliff_letters(inner)
    described = inner if hasattr(inner, "desc") or hasattr(inner, "grid_shape") else _table(inner)
    if hasattr(described, "desc"):
        rows = [[_text(letter) for letter in row] for row in described.desc]
        return np.array([[letter if letter in MEANINGS else "" for letter in row] for row in rows])
    if hasattr(inner, "grid_shape"):
        letters = np.full(tuple(inner.grid_shape), "")
        for row, column in getattr(inner, "walls", ()):
            letters[row, column] = WALL
        return letters
    return None


def _text(letter: Any) -> str:
    return letter.decode() if isinstance(letter, bytes) else str(letter)


def _cliff_letters(inner: CliffWalkingEnv) -> np.ndarray:
    """No transition leads onto the cliff: who steps there finds themselves at the start."""
    letters = np.full(inner.shape, CLIFF)
    letters.flat[[int(next_state) for _, next_state, _, _ in _outcomes(inner)]] = ""
    letters.flat[-1] = GOAL
    return letters


def _mark_start_and_end(letters: np.ndarray, inner: Any) -> None:
    """Give ordinary cells the letter of what the transition table says of them."""
    flat = letters.ravel()  # a view
    for start in np.flatnonzero(getattr(inner, "initial_state_distrib", np.zeros(0))):
        flat[start] = flat[start] or START
    # Where an episode may go on, an action is taken
    goes_on = {next_state for _, next_state, _, terminated in _outcomes(inner) if not terminated}
    for _, next_state, _, _ in _outcomes(inner):
        if next_state not in goes_on and flat[next_state] == "":
            flat[next_state] = TERMINAL


def _table(inner: Any) -> Any:
    """The transition table of the moment, empty where there is none."""
    if hasattr(inner, "table_at"):  # one whose rules change
        return inner.table_at(inner.clock)[0]
    return getattr(inner, "P", {})


def _outcomes(inner: Any) -> Iterator[tuple[float, int, float, bool]]:
    """Every transition of the table, if there is one: probability, next state, reward, whether the episode ends."""
    table = _table(inner)
    for state in range(len(table)):
        for action in range(len(table[state])):
            yield from table[state][action]


def _moves(inner: Any) -> tuple[tuple[int, int], ...]:
    if isinstance(inner, FrozenLakeEnv):
        return _LAKE_MOVES
    if isinstance(inner, CliffWalkingEnv):
        return tuple((row, column) for row, column in (POSITION_MAPPING[action] for action in range(4)))
    moves = getattr(inner, "moves", None)
    moves = getattr(_table(inner), "moves", None) if moves is None else moves
    if moves is None or len(moves) != inner.action_space.n:
        raise ValueError(
            f"{type(inner).__name__} has a map but does not say where its actions lead: give it the attribute `moves`, a pair "
            f"(change of row, change of column) for each of the {inner.action_space.n} actions, but got {moves!r}."
        )
    return tuple((int(row), int(column)) for row, column in moves)


def _taxi_places(passenger: str | None, destination: str | None) -> tuple[int, int]:
    passenger = TAXI_PLACES[0] if passenger is None else passenger
    if destination is None:
        destination = next(place for place in TAXI_PLACES if place != passenger)
    if passenger not in TAXI_PLACES or destination not in TAXI_PLACES[:-1] or passenger == destination:
        raise ValueError(
            f"`passenger` must be one of {', '.join(TAXI_PLACES)}, and `destination` another one of "
            f"{', '.join(TAXI_PLACES[:-1])}, but got {passenger!r} and {destination!r}."
        )
    return TAXI_PLACES.index(passenger), TAXI_PLACES.index(destination)


def _taxi_map(inner: TaxiEnv, passenger: int, destination: int) -> GridMap:
    letters = np.full((5, 5), "")
    letters[inner.locs[destination]] = DESTINATION
    where = "in the taxi"
    if passenger < len(inner.locs):
        letters[inner.locs[passenger]] = PASSENGER
        where = f"at {TAXI_PLACES[passenger]}"
    states = [[inner.encode(row, column, passenger, destination) for column in range(5)] for row in range(5)]
    fences = tuple(
        ((column + 0.5, row - 0.5), (column + 0.5, row + 0.5))
        for row, column in np.ndindex(5, 4)
        if inner.desc[1 + row, 2 * column + 2] == b"|"
    )
    return GridMap(
        letters, np.array(states), _TAXI_MOVES, {4: "pick up", 5: "drop off"}, fences,
        f"passenger {where}, destination {TAXI_PLACES[destination]}",
    )  # fmt: skip
