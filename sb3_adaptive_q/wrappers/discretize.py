"""Binning of continuous observations into the states of a table."""

import math
import operator
from bisect import bisect_right
from collections.abc import Sequence
from itertools import groupby
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from gymnasium.wrappers import DiscretizeObservation as GymnasiumDiscretizeObservation
from gymnasium.wrappers import FlattenObservation

from sb3_adaptive_q.state_index import is_finite


class DiscretizeObservation(gym.ObservationWrapper[Any, Any, Any], RecordConstructorArgs):
    """
    Turn a Box observation into the number of the grid cell that holds it.

    Each dimension has edges in increasing order, n of them and hence n + 1 cells: cell 0 lies below the first edge, cell k
    is the half-open interval ``[edges[k - 1], edges[k])``, and cell n starts at the last edge. This is
    ``np.digitize(x, edges)``. Infinite observations fall in the outer cells. A dimension without edges is left out: its one
    cell holds every value. Observations of more than one axis are flattened in C order. Values are compared in float64,
    whatever the dtype of the observation.

    The edges are spaced evenly, ``np.linspace(low, high, n_edges)`` in each dimension, or given as they are by ``edges``.

    Publications often count buckets. A bucket is a cell, so there is one more than there are edges. Take Cart Pole with
    buckets (1, 1, 6, 12), the last two between -0.4 and 0.4, and -0.9 and 0.9. If the outer buckets lie beyond these bounds,
    pass ``n_edges=[0, 0, 5, 11], low=[None, None, -0.4, -0.9], high=[None, None, 0.4, 0.9]``. If they lie within them, pass
    ``edges=[[], [], np.linspace(-0.4, 0.4, 7)[1:-1], np.linspace(-0.9, 0.9, 13)[1:-1]]``.

    The number of a cell is its mixed-radix index, the first dimension being the most significant digit:
    with 10 edges in each of four dimensions, cell (1, 3, 4, 4) has number 1742.

    :param env: environment with a Box observation space
    :param n_edges: the number of edges, of which ``low`` is the first and ``high`` the last: at least 2, or 0 to leave the
        dimension out. One number for all dimensions, or one per dimension; ``None`` for 10
    :param low: first edge, in the unit of the observation: one number for all dimensions, or one per dimension (any, such as
        ``None``, for a dimension that is left out); ``None`` takes the bounds of the space
    :param high: last edge, given like ``low``
    :param multi_discrete: observe the cell as a MultiDiscrete vector, one entry per dimension, instead of its
        number as a Discrete value
    :param edges: the edges themselves, one array for each dimension, strictly increasing, empty to leave the dimension out;
        instead of ``n_edges``, ``low`` and ``high``
    :raises ValueError: if the observation space is not a Box, a bound is infinite or NaN, ``low`` is not below
        ``high``, there is one edge between them, ``edges`` do not increase strictly, a length does not fit the observation,
        or the cells are too many to be numbered in 64 bits
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        n_edges: int | Sequence[int] | None = None,
        low: npt.ArrayLike | None = None,
        high: npt.ArrayLike | None = None,
        multi_discrete: bool = False,
        edges: Sequence[npt.ArrayLike] | None = None,
    ):
        super().__init__(env)
        space = _check_space(env)
        self._shape = space.shape
        if edges is None:
            self.edges = _even_edges(space, 10 if n_edges is None else n_edges, low, high)
        else:
            _check_alone(n_edges=n_edges, low=low, high=high)
            self.edges = _given_edges(edges, space.shape)
        RecordConstructorArgs.__init__(
            self,
            # Lists rather than arrays, so that specs can be compared and written as JSON
            n_edges=_plain(n_edges),
            low=_plain(low),
            high=_plain(high),
            multi_discrete=bool(multi_discrete),
            edges=None if edges is None else [one.tolist() for one in self.edges],
        )
        #: How many cells each dimension has
        self.n_cells: tuple[int, ...] = tuple(len(one) + 1 for one in self.edges)
        # bisect on lists of Python floats takes a tenth of the time that np.digitize needs for a single value.
        self._edge_lists: list[list[float]] = [one.tolist() for one in self.edges]
        self._multi_discrete = multi_discrete
        self.observation_space = spaces.MultiDiscrete(list(self.n_cells)) if multi_discrete else self._number_cells()

    def __str__(self) -> str:
        """The number of cells, the edges of each dimension, and the wrapped environment."""
        alike = [(text, len(list(group))) for text, group in groupby(map(_describe, self.edges))]
        parts = [f"{text} ({count} times)" if count > 1 else text for text, count in alike]
        shown = parts if len(parts) <= 8 else [*parts[:7], "..."]
        return f"<{type(self).__name__}({math.prod(self.n_cells)} cells; edges: {', '.join(shown)}){self.env}>"

    def _number_cells(self) -> spaces.Discrete[np.int64]:
        total = math.prod(self.n_cells)
        if total > np.iinfo(np.int64).max:
            raise ValueError(
                f"{total} cells are too many to be numbered in 64 bits. Use fewer edges, or multi_discrete=True, "
                f"which observes the cell of each dimension by itself.{_hint_on_flattening(self.env)}"
            )
        return spaces.Discrete(total)

    def observation(self, observation: npt.NDArray[Any]) -> int | npt.NDArray[np.int64]:
        """
        Find the cell of an observation.

        :param observation: array of the shape of the wrapped observation space
        :return: number of the cell, or with ``multi_discrete`` the int64 vector of the cell per dimension
        :raises ValueError: if the shape differs or a value is NaN
        """
        try:
            shape = observation.shape
        except AttributeError:  # a list, perhaps, or None
            observation = np.asarray(observation)
            shape = observation.shape
        if shape != self._shape:
            raise ValueError(
                f"DiscretizeObservation expects observations of shape {self._shape}, but got {observation!r} of shape {shape} "
                f"from {type(self.unwrapped).__name__}."
            )
        values = observation.ravel().tolist()
        if self._multi_discrete:
            cells = [bisect_right(edges, value) for edges, value in zip(self._edge_lists, values, strict=True)]
            number: int | npt.NDArray[np.int64] = np.array(cells, dtype=np.int64)
        else:
            number = 0
            for i, value in enumerate(values):  # a `zip` with `strict=True` takes longer
                number = number * self.n_cells[i] + bisect_right(self._edge_lists[i], value)
        # A sum is NaN if any value is, and also if it holds both infinities.
        if math.isnan(sum(values)):
            _reject_nan(values)
        return number

    def index(self, cells: Sequence[int] | npt.NDArray[np.integer[Any]]) -> int:
        """
        Number a cell.

        :param cells: cell along each dimension, each from 0 to ``n_edges``
        :return: the cell's mixed-radix number, the first dimension most significant
        :raises ValueError: if the length differs from the number of dimensions or an entry is out of range
        """
        if len(cells) != len(self.n_cells):
            raise ValueError(f"Expected one cell for each of {len(self.n_cells)} dimensions, got {len(cells)}: {cells!r}.")
        number = 0
        for dimension, (cell, size) in enumerate(zip(cells, self.n_cells, strict=True)):
            if not 0 <= cell < size:
                raise ValueError(f"The cell of dimension {dimension} must lie in 0..{size - 1}, got {cell}.")
            number = number * size + operator.index(cell)
        return number

    def cells(self, index: int) -> tuple[int, ...]:
        """
        Split the number of a cell, the inverse of :meth:`index`.

        :param index: number of a cell
        :return: cell along each dimension
        :raises ValueError: if there is no cell of that number
        """
        total = math.prod(self.n_cells)
        if not 0 <= index < total:
            raise ValueError(f"The number of a cell must lie in 0..{total - 1}, got {index}.")
        rest = operator.index(index)
        digits = []
        for size in reversed(self.n_cells):
            rest, digit = divmod(rest, size)
            digits.append(digit)
        return tuple(reversed(digits))

    def bounds(self, index: int) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """
        Give the region of a cell: the observations with ``low <= observation < high``.

        The outer cells reach to minus and plus infinity, plus infinity itself included.

        :param index: number of a cell
        :return: low and high, arrays of the shape of the wrapped observation
        :raises ValueError: if there is no cell of that number
        """
        cells = self.cells(index)
        low = [edges[cell - 1] if cell > 0 else -np.inf for edges, cell in zip(self.edges, cells, strict=True)]
        high = [edges[cell] if cell < len(edges) else np.inf for edges, cell in zip(self.edges, cells, strict=True)]
        return np.array(low, dtype=np.float64).reshape(self._shape), np.array(high, dtype=np.float64).reshape(self._shape)


def _plain(value: Any) -> Any:
    """Numbers and lists of them, in place of NumPy's."""
    return None if value is None else np.asarray(value).tolist()


def _check_space(env: gym.Env[Any, Any]) -> spaces.Box:
    space = env.observation_space
    if isinstance(space, spaces.Box):
        return space
    needed = f"DiscretizeObservation needs a Box observation space, but got {space}"
    if is_finite(space):
        raise ValueError(f"{needed}, which needs no binning: TabularQ takes it as it is, without a wrapper.")
    raise ValueError(
        f"{needed}: flatten Dict and Tuple observations of Box parts first, for instance with "
        "gymnasium.wrappers.FlattenObservation, and turn others into a Box by a gymnasium.ObservationWrapper of your own."
    )


def _hint_on_flattening(env: gym.Env[Any, Any]) -> str:
    """A hint for messages, if FlattenObservation has made one dimension of every value of a Discrete part."""
    if isinstance(env, FlattenObservation) and is_finite(env.env.observation_space):
        return (
            f" Or remove FlattenObservation and this wrapper: {env.env.observation_space} needs neither, because TabularQ "
            "takes it as it is."
        )
    return ""


def _check_alone(**even: Any) -> None:
    others = [name for name, value in even.items() if value is not None]
    if others:
        raise ValueError(f"`edges` alone sets the cells, but got {', '.join(others)} too: give one or the other.")


def _as_numbers(name: str, value: Any, dtype: type | None = None) -> npt.NDArray[Any]:
    try:
        values = np.asarray(value.tolist() if isinstance(value, np.ndarray) else value, dtype)
    except (TypeError, ValueError):  # among others, lists of different lengths
        values = np.asarray(None)
    if values.dtype.kind not in "buif":
        raise ValueError(f"{name} must be a number or a list of numbers, got {value!r}.")
    return values


def _per_dimension(name: str, value: npt.ArrayLike, shape: tuple[int, ...]) -> list[Any]:
    """Spread a scalar over all dimensions, or check that there is one value for each."""
    values = _as_numbers(name, value)
    size = math.prod(shape)
    if values.ndim == 0:
        return [values.item()] * size
    if values.shape not in ((size,), shape):
        raise ValueError(
            f"{name} must be one number, or one for each of the {size} dimensions of the observation "
            f"(shape {shape}), got shape {values.shape}."
        )
    return list(values.ravel().tolist())


def _even_edges(
    space: spaces.Box, n_edges: int | Sequence[int], low: npt.ArrayLike | None, high: npt.ArrayLike | None
) -> tuple[npt.NDArray[np.float64], ...]:
    """Edges evenly spaced from low to high."""
    counts = _edge_counts(n_edges, space.shape)
    lows = _bounds("low", low, space.low, counts)
    highs = _bounds("high", high, space.high, counts)
    return tuple(_space_edges(*arguments) for arguments in zip(range(len(counts)), lows, highs, counts, strict=True))


def _edge_counts(n_edges: int | Sequence[int], shape: tuple[int, ...]) -> list[int]:
    counts = _per_dimension("n_edges", n_edges, shape)
    for dimension, count in enumerate(counts):
        # One edge would leave `high` without effect
        if isinstance(count, bool) or not isinstance(count, int) or count < 0 or count == 1:
            raise ValueError(
                "n_edges must be an integer of at least 2 (low and high are edges themselves), or 0 to leave the dimension "
                f"out, got {count!r} for dimension {dimension}. A bucket is a cell, and there is one more than there are "
                "edges: for one bucket pass n_edges=0; for two, pass the one edge by `edges`."
            )
    return counts


def _bounds(name: str, value: npt.ArrayLike | None, space_bounds: npt.NDArray[Any], counts: list[int]) -> list[float]:
    """Take the given bounds, or those of the space, as Python floats, one per dimension. A dimension left out may have any."""
    given = space_bounds if value is None else _as_numbers(name, value, np.float64)
    bounds = [float(bound) for bound in _per_dimension(name, given, space_bounds.shape)]
    bad = [dimension for dimension, bound in enumerate(bounds) if counts[dimension] and not math.isfinite(bound)]
    if bad:
        source = "the observation space" if value is None else f"the argument {name}"
        raise ValueError(
            f"The {name} bound of dimension(s) {', '.join(map(str, bad))} is not finite in {source}: "
            f"{[bounds[dimension] for dimension in bad]}. Pass finite bounds between which to place the edges: "
            f"{name}=<one number, or a list of {len(bounds)} numbers>; observations beyond them fall in the outer cells. "
            "Or leave the dimension out: n_edges=0 there."
        )
    return bounds


def _space_edges(dimension: int, low: float, high: float, n_edges: int) -> npt.NDArray[np.float64]:
    """Space the edges of one dimension."""
    if n_edges == 0:
        return _frozen([])
    if low >= high:
        raise ValueError(f"low must be below high in every dimension, got low={low}, high={high} for dimension {dimension}.")
    with np.errstate(over="ignore", invalid="ignore"):
        edges = np.linspace(low, high, n_edges, dtype=np.float64)
    if not _increase(edges):
        raise ValueError(
            f"{n_edges} edges between low={low} and high={high} of dimension {dimension} are not distinct finite "
            "numbers in float64. Use fewer edges or other bounds."
        )
    return _frozen(edges)


def _given_edges(edges: Sequence[npt.ArrayLike], shape: tuple[int, ...]) -> tuple[npt.NDArray[np.float64], ...]:
    """The edges that were given, checked."""
    size = math.prod(shape)
    given = list(edges) if hasattr(edges, "__len__") else []
    if len(given) != size:
        raise ValueError(
            f"edges must be one array for each of the {size} dimensions of the observation (shape {shape}), got {edges!r}."
        )
    return tuple(_check_edges(dimension, one) for dimension, one in enumerate(given))


def _check_edges(dimension: int, edges: npt.ArrayLike) -> npt.NDArray[np.float64]:
    try:
        array = _frozen(edges)
    except (TypeError, ValueError):
        array = _frozen(np.nan)
    if array.ndim != 1 or not _increase(array):
        raise ValueError(
            "edges must be one array of finite numbers in strictly increasing order for each dimension, empty to leave the "
            f"dimension out, got {edges!r} for dimension {dimension}."
        )
    return array


def _increase(edges: npt.NDArray[np.float64]) -> bool:
    """Whether they are finite and strictly increasing."""
    with np.errstate(over="ignore", invalid="ignore"):
        return bool(np.isfinite(edges).all() and (np.diff(edges) > 0).all())


def _frozen(edges: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """The edges as a read-only array: the wrapper bins with a copy, so changes would have no effect."""
    array = np.array(edges, dtype=np.float64)
    array.flags.writeable = False
    return array


def _describe(edges: npt.NDArray[np.float64]) -> str:
    if len(edges) == 0:
        return "left out"
    return f"{edges[0]:g}" if len(edges) == 1 else f"{len(edges)} from {edges[0]:g} to {edges[-1]:g}"


def _reject_nan(values: list[float]) -> None:
    bad = [dimension for dimension, value in enumerate(values) if math.isnan(value)]
    if bad:
        raise ValueError(
            f"The observation is NaN in dimension(s) {', '.join(map(str, bad))} (of {len(values)}, flattened); NaN lies "
            "in no cell. Look for the cause in the environment."
        )


def edges_of(wrapper: gym.ObservationWrapper[Any, Any, Any]) -> tuple[npt.NDArray[np.float64], ...]:
    """
    :param wrapper: a :class:`DiscretizeObservation`, or gymnasium's wrapper of that name, which numbers its cells alike
    :return: the edges of each dimension in increasing order, evenly spaced or not; none for a dimension that is left out
    :raises ValueError: if gymnasium's wrapper does not bin by its edges, because cells are too narrow
    """
    if isinstance(wrapper, DiscretizeObservation):
        return wrapper.edges
    assert isinstance(wrapper, GymnasiumDiscretizeObservation)
    edges = tuple(np.asarray(one, dtype=np.float64) for one in wrapper.bin_edges)
    # gymnasium clips observations to these values. In float32 they usually equal the bound, which is in the last cell
    tops = (wrapper.high - 1e-8).tolist()
    for dimension, (one, top) in enumerate(zip(edges, tops, strict=True)):
        if len(one) and one[-1] > top:
            raise ValueError(
                f"gymnasium.wrappers.DiscretizeObservation leaves cells of dimension {dimension} empty that are narrower "
                "than 1e-8: please use sb3_adaptive_q.wrappers.DiscretizeObservation."
            )
    return edges
