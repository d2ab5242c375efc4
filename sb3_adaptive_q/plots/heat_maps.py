"""Heat maps of what has no map: a whole table, or two components of the observation."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator

from sb3_adaptive_q.plots.numbers import greedy_actions, is_undecided, number_texts
from sb3_adaptive_q.plots.sources import Components, Quantity
from sb3_adaptive_q.plots.style import SEQUENTIAL, color_scale

#: More cells than these get no letters
_FEW_CELLS = 450
#: More states than these get no numbers
_FEW_STATES = 16
#: More states than these get no dots for the greedy actions
_SOME_STATES = 100
_MOST_TICKS = 6


def draw_table(
    ax: Axes, quantity: Quantity, limits: tuple[float, float] | None, first_state: int = 0, first_action: int = 0
) -> None:
    """
    A column for each state, a row for each action; a dot in each column for the greedy action of a table of values.

    :param ax: the axes to draw on
    :param quantity: the numbers
    :param limits: the values that the lightest and the darkest colour stand for; ``None`` for the least and the largest
    :param first_state: the number that the environment gives to the first state
    :param first_action: and to the first action
    """
    values = quantity.values
    n_states, n_columns = values.shape
    image = ax.imshow(values.T, cmap=SEQUENTIAL, norm=color_scale(values, limits), aspect="auto", interpolation="nearest")
    ax.set(xlabel="state", ylabel="action" if n_columns > 1 else "")
    ax.set_title(quantity.label, loc="left", fontsize="medium")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.yaxis.set_major_locator(MaxNLocator(integer=True) if n_columns > 1 else FixedLocator([]))
    ax.xaxis.set_major_formatter(_counted_from(first_state))
    ax.yaxis.set_major_formatter(_counted_from(first_action))
    ax.figure.colorbar(image, ax=ax)
    if n_states <= _FEW_STATES:
        for (state, column), text in zip(np.ndindex(values.shape), number_texts(values.ravel()), strict=True):
            ax.text(state, column, text, ha="center", va="center", size="small")
    if "Q(s, a)" in quantity.label and n_states <= _SOME_STATES:
        decided = np.flatnonzero(~is_undecided(values))
        greedy = greedy_actions(values)[decided]
        height = 0.0 if n_states > _FEW_STATES else 0.3
        ax.plot(decided, greedy + height, "o", color="black", markersize=3, gid="greedy actions")
        ax.set_xlabel("state   (dots: greedy actions)")


def _counted_from(first: int) -> FuncFormatter:
    return FuncFormatter(lambda value, _: f"{value + first:.0f}".replace("-", "−"))


class Plane:
    """
    Two components of the observation, the others fixed at given cells or averaged over.

    :param table: of shape (n_states, k)
    :param components: what the observations consist of
    :param dimensions: the components along x and along y
    :param at: the cells that other components are fixed at; over those that are missing the mean is taken
    :param is_known: the states to take into the mean, of shape (n_states,)
    :raises ValueError: if there are no such components or cells
    """

    def __init__(
        self,
        table: np.ndarray,
        components: Components,
        dimensions: tuple[int, int],
        at: Mapping[int, int],
        is_known: np.ndarray,
    ) -> None:
        self.components = components
        self.dimensions = dimensions
        self.at = dict(at)
        self._check()
        sizes = components.sizes
        fixed = tuple(self.at.get(i, slice(None)) for i in range(len(sizes)))
        free = [i for i in range(len(sizes)) if i not in self.at]
        cells = np.where(is_known[:, None], table, np.nan).reshape(*sizes, -1)[fixed]
        cells = np.moveaxis(cells, [free.index(dimensions[1]), free.index(dimensions[0])], [0, 1])
        cells = cells.reshape(*cells.shape[:2], -1, table.shape[1])
        counts = (~np.isnan(cells)).sum(axis=2)
        #: The means, of shape (cells along y, cells along x, k); NaN where no state is known
        self.values = np.divide(np.nansum(cells, axis=2), counts, out=np.full(counts.shape, np.nan), where=counts > 0)

    def _check(self) -> None:
        sizes = self.components.sizes
        if len(sizes) < 2:
            raise ValueError(
                f"`dimensions` and `at` need observations of two components or more, but these have {len(sizes)}."
            )
        numbers = range(len(sizes))
        x, y = self.dimensions
        if x not in numbers or y not in numbers or x == y:
            raise ValueError(f"`dimensions` must be two different numbers from 0 to {len(sizes) - 1}, but got {(x, y)}.")
        for dimension, cell in self.at.items():
            if dimension not in numbers or dimension in (x, y):
                others = [i for i in numbers if i not in (x, y)]
                raise ValueError(f"`at` fixes the dimensions that are not drawn, {others}, but got dimension {dimension}.")
            if not 0 <= cell < sizes[dimension]:
                raise ValueError(f"`at` must give cells 0 to {sizes[dimension] - 1} of dimension {dimension}, but got {cell}.")

    def describe_rest(self) -> str:
        """
        :return: what the other components are, in words
        """
        rest = [i for i in range(len(self.components.sizes)) if i not in self.dimensions]
        mean = [str(i) for i in rest if i not in self.at]
        words = [f"dimension {i} in cell {self.at[i]}" for i in rest if i in self.at]
        if mean:
            words.append(f"mean over dimension{'s' if len(mean) > 1 else ''} {', '.join(mean)}")
        return ", ".join(words)


def draw_plane(
    ax: Axes, plane: Plane, label: str, limits: tuple[float, float] | None, has_actions: bool, first_action: int = 0
) -> None:
    """
    :param ax: the axes to draw on
    :param plane: what to draw
    :param label: what the numbers are, in words
    :param limits: the values that the lightest and the darkest colour stand for; ``None`` for the least and the largest
    :param has_actions: whether the plane holds action values, whose largest is drawn, with the number of the greedy action
    :param first_action: the number that the environment gives to the first action
    """
    values = plane.values.max(axis=2) if has_actions else plane.values.mean(axis=2)
    shown = np.ma.masked_invalid(values)
    mesh = ax.pcolormesh(shown, cmap=SEQUENTIAL, norm=color_scale(values, limits), rasterized=shown.size > _FEW_CELLS)
    ax.set_facecolor("white")
    ax.figure.colorbar(mesh, ax=ax, label=label)
    _label_axis(ax, "x", plane)
    _label_axis(ax, "y", plane)
    notes = []
    if has_actions and shown.size <= _FEW_CELLS:
        notes.append("digits: greedy action")
        for row, column in np.argwhere(np.isfinite(values)):
            action = int(plane.values[row, column].argmax()) + first_action
            ax.text(column + 0.5, row + 0.5, str(action), ha="center", va="center", size=6.5)
    if shown.count() < shown.size:
        notes.append("white: nothing learned")
    lines = [plane.describe_rest(), "; ".join(notes)]
    ax.set_title("\n".join(line for line in lines if line), loc="left", fontsize="medium")


def _label_axis(ax: Axes, which: str, plane: Plane) -> None:
    """Bounds of cells where the observation was discretised, and the cells' numbers elsewhere."""
    components, dimension = plane.components, plane.dimensions[which == "y"]
    axis = ax.xaxis if which == "x" else ax.yaxis
    size = components.sizes[dimension]
    axis.set_label_text(f"dimension {dimension} of the observation")
    if components.edges is None:
        step = -(-size // _MOST_TICKS)
        values = np.arange(0, size, step)
        axis.set_ticks(values + 0.5, [str(value + components.starts[dimension]) for value in values])
        return
    edges = components.edges[dimension]
    step = -(-(len(edges) - 1) // (_MOST_TICKS - 1))
    chosen = np.arange(0, len(edges), step)
    # The first edge is the upper bound of the first cell, which has no lower one
    axis.set_ticks(chosen + 1, [f"{edges[i]:.3g}".replace("-", "−") for i in chosen])
