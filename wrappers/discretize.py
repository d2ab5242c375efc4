"""Binning of continuous observations into the states of a table."""

import math
import operator
from bisect import bisect_right
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs


class DiscretizeObservation(gym.ObservationWrapper[Any, Any, Any], RecordConstructorArgs):
    """
    Turn a Box observation into the number of the grid cell that holds it.

    Each dimension has ``n_edges`` equally spaced edges from ``low`` to ``high``, both included, hence
    ``n_edges + 1`` cells: cell 0 lies below ``low``, cell k is the half-open interval
    ``[edges[k - 1], edges[k])``, and cell ``n_edges`` starts at ``high``. This is
    ``np.digitize(x, np.linspace(low, high, n_edges))``. Infinite observations fall in the outer cells.
    Observations of more than one axis are flattened in C order. Values are compared in float64, whatever
    the dtype of the observation.

    The number of a cell is its mixed-radix index, the first dimension being the most significant digit:
    with 10 edges in each of four dimensions, cell (1, 3, 4, 4) has number 1742.

    :param env: environment with a Box observation space
    :param n_edges: edges per dimension, at least 2 (``low`` and ``high`` themselves): one number for all
        dimensions, or one per dimension
    :param low: first edge, in the unit of the observation: one number for all dimensions, or one per dimension;
        ``None`` takes the bounds of the space
    :param high: last edge, given like ``low``
    :param multi_discrete: observe the cell as a MultiDiscrete vector, one entry per dimension, instead of its
        number as a Discrete value
    :raises ValueError: if the observation space is not a Box, a bound is infinite or NaN, ``low`` is not below
        ``high``, there are fewer than 2 edges, a length does not fit the observation, or the cells are too many
        to be numbered in 64 bits
    """

    def __init__(
        self,
        env: gym.Env[Any, Any],
        n_edges: int | Sequence[int] = 10,
        low: npt.ArrayLike | None = None,
        high: npt.ArrayLike | None = None,
        multi_discrete: bool = False,
    ):
        RecordConstructorArgs.__init__(self, n_edges=n_edges, low=low, high=high, multi_discrete=multi_discrete)
        super().__init__(env)
        space = env.observation_space
        if not isinstance(space, spaces.Box):
            raise ValueError(
                f"DiscretizeObservation needs a Box observation space, got {space}. Discrete and MultiDiscrete "
                "observations need no binning; flatten Dict and Tuple observations first, for instance with "
                "gymnasium.wrappers.FlattenObservation."
            )
        self._shape = space.shape
        counts = _edge_counts(n_edges, space.shape)
        lows = _bounds("low", low, space.low)
        highs = _bounds("high", high, space.high)
        self.edges: tuple[npt.NDArray[np.float64], ...] = tuple(
            _edges(dimension, *arguments) for dimension, arguments in enumerate(zip(lows, highs, counts, strict=True))
        )
        self.n_cells: tuple[int, ...] = tuple(count + 1 for count in counts)
        # bisect on lists of Python floats takes a tenth of the time that np.digitize needs for a single value.
        self._edge_lists: list[list[float]] = [edges.tolist() for edges in self.edges]
        self._multi_discrete = multi_discrete
        self.observation_space = spaces.MultiDiscrete(list(self.n_cells)) if multi_discrete else _discrete(self.n_cells)

    def observation(self, observation: npt.NDArray[Any]) -> int | npt.NDArray[np.int64]:
        """
        Find the cell of an observation.

        :param observation: array of the shape of the wrapped observation space
        :return: number of the cell, or with ``multi_discrete`` the int64 vector of the cell per dimension
        :raises ValueError: if the shape differs or a value is NaN
        """
        if observation.shape != self._shape:
            raise ValueError(f"Expected an observation of shape {self._shape}, got shape {observation.shape}.")
        values = observation.ravel().tolist()
        if self._multi_discrete:
            cells = [bisect_right(edges, value) for edges, value in zip(self._edge_lists, values, strict=True)]
            number: int | npt.NDArray[np.int64] = np.array(cells, dtype=np.int64)
        else:
            number = 0
            for edges, value in zip(self._edge_lists, values, strict=True):
                number = number * (len(edges) + 1) + bisect_right(edges, value)
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


def _per_dimension(name: str, value: npt.ArrayLike, shape: tuple[int, ...]) -> list[Any]:
    """Spread a scalar over all dimensions, or check that there is one value for each."""
    values = np.asarray(value)
    size = math.prod(shape)
    if values.ndim == 0:
        return [values.item()] * size
    if values.shape not in ((size,), shape):
        raise ValueError(
            f"{name} must be one number, or one for each of the {size} dimensions of the observation "
            f"(shape {shape}), got shape {values.shape}."
        )
    return list(values.ravel().tolist())


def _edge_counts(n_edges: int | Sequence[int], shape: tuple[int, ...]) -> list[int]:
    counts = _per_dimension("n_edges", n_edges, shape)
    for dimension, count in enumerate(counts):
        # One edge would leave `high` without effect, none would leave a single cell.
        if not isinstance(count, int) or count < 2:
            raise ValueError(
                f"n_edges must be an integer of at least 2 (low and high are edges themselves), "
                f"got {count!r} for dimension {dimension}."
            )
    return counts


def _bounds(name: str, value: npt.ArrayLike | None, space_bounds: npt.NDArray[Any]) -> list[float]:
    """Take the given bounds, or those of the space, as Python floats, one per dimension."""
    given = space_bounds if value is None else np.asarray(value, dtype=np.float64)
    bounds = [float(bound) for bound in _per_dimension(name, given, space_bounds.shape)]
    bad = [dimension for dimension, bound in enumerate(bounds) if not math.isfinite(bound)]
    if bad:
        source = "the observation space" if value is None else f"the argument {name}"
        raise ValueError(
            f"The {name} bound of dimension(s) {', '.join(map(str, bad))} is not finite in {source}: "
            f"{[bounds[dimension] for dimension in bad]}. Pass finite bounds between which to place the edges: "
            f"{name}=<one number, or a list of {len(bounds)} numbers>; observations beyond them fall in the outer cells."
        )
    return bounds


def _edges(dimension: int, low: float, high: float, n_edges: int) -> npt.NDArray[np.float64]:
    """Space the edges of one dimension; read-only, because the wrapper bins with a copy of them."""
    if low >= high:
        raise ValueError(f"low must be below high in every dimension, got low={low}, high={high} for dimension {dimension}.")
    with np.errstate(over="ignore", invalid="ignore"):
        edges = np.linspace(low, high, n_edges, dtype=np.float64)
        distinct = bool((np.diff(edges) > 0).all())
    if not distinct:
        raise ValueError(
            f"{n_edges} edges between low={low} and high={high} of dimension {dimension} are not distinct finite "
            "numbers in float64. Use fewer edges or other bounds."
        )
    edges.flags.writeable = False
    return edges


def _discrete(n_cells: tuple[int, ...]) -> spaces.Discrete[np.int64]:
    total = math.prod(n_cells)
    if total > np.iinfo(np.int64).max:
        raise ValueError(
            f"{total} cells are too many to be numbered in 64 bits. Use fewer edges, or multi_discrete=True, "
            "which observes the cell of each dimension by itself."
        )
    return spaces.Discrete(total)


def _reject_nan(values: list[float]) -> None:
    bad = [dimension for dimension, value in enumerate(values) if math.isnan(value)]
    if bad:
        raise ValueError(
            f"The observation is NaN in dimension(s) {', '.join(map(str, bad))} (of {len(values)}, flattened); NaN lies "
            "in no cell. Look for the cause in the environment."
        )
