"""Values and greedy actions on the map of a grid world."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Rectangle

from sb3_adaptive_q.plots.grid_maps import CLIFF, GOAL, HOLE, MEANINGS, TERMINAL, WALL, WITHOUT_ACTION, GridMap
from sb3_adaptive_q.plots.numbers import greedy_actions, is_undecided, number_texts
from sb3_adaptive_q.plots.style import AGENT, INK, PAPER, SEQUENTIAL, color_scale

#: Where the number of a cell stands below an arrow, in cells from its centre
BELOW = 0.33
#: Points of a cell's side that a letter takes
_LETTER_SIZE = 0.165
UNDECIDED = "·"
#: Inches that a cell takes, and those that the longest side may take
_CELL, _LARGEST_MAP = 0.66, 9.0


def map_size(grid: GridMap, stretch: float = 1.0) -> tuple[float, float]:
    """
    :param grid: a map
    :param stretch: how much larger than usual its cells shall be
    :return: width and height in inches of a figure that it fits into
    """
    rows, columns = grid.letters.shape
    cell = min(_CELL * stretch, _LARGEST_MAP / max(rows, columns))
    return max(cell * columns, 3.4) + 0.2, cell * rows + (0.9 if grid.title else 0.7)


class MapDrawing:
    """
    A map that is being drawn.

    :param ax: the axes to draw on; they are cleared of ticks
    :param grid: the map
    :param limits: the values that the lightest and the darkest colour stand for; ``None`` for those of the map
    """

    def __init__(self, ax: Axes, grid: GridMap, limits: tuple[float, float] | None) -> None:
        self.ax = ax
        self.grid = grid
        self.limits = limits
        self.shape = grid.letters.shape
        self.is_open = ~np.isin(grid.letters, WITHOUT_ACTION)
        self.notes: list[str] = []
        self.agent: Line2D | None = None
        rows, columns = self.shape
        ax.set(xlim=(-0.5, columns - 0.5), ylim=(rows - 0.5, -0.5), aspect="equal", xticks=[], yticks=[])
        box = ax.get_window_extent()
        side = 72.0 / ax.get_figure(root=True).dpi * min(box.width / columns, box.height / rows)  # type: ignore[union-attr]
        self.font_size = float(np.clip(_LETTER_SIZE * side, 3.0, 11.0))

    def draw_values(self, values: np.ndarray, table: np.ndarray | None) -> None:
        """
        Colour the cells and write the numbers; with arrows for the greedy actions where a table is given. Cells whose actions
        are all equal stay white then: what the table started from would decide their colour.

        :param values: one for each row of the table, of shape (n_states,)
        :param table: of shape (n_states, n_actions)
        """
        on_map = values[self.grid.states]
        is_colored = self.is_open if table is None else self.is_open & ~is_undecided(table)[self.grid.states]
        rows, columns = self.shape
        self.ax.pcolormesh(
            np.arange(columns + 1) - 0.5, np.arange(rows + 1) - 0.5, np.ma.masked_array(on_map, mask=~is_colored),
            cmap=SEQUENTIAL, norm=self._scale(on_map[is_colored]), edgecolors=PAPER, linewidth=0.8, gid="values",
        )  # fmt: skip
        texts = number_texts(on_map[self.is_open])
        cells = np.argwhere(self.is_open)
        offset = 0.0 if table is None else BELOW
        for (row, column), text in zip(cells, texts, strict=True):
            self._write(row, column, text, y=offset)
        if table is not None:
            self._draw_greedy_actions(table)
        self._finish()

    def draw_numbers_of_actions(self, numbers: np.ndarray, has_greedy_action: bool) -> None:
        """
        Four triangles in each cell, one for each direction, with their numbers.

        :param numbers: of shape (n_states, 4)
        :param has_greedy_action: whether they are action values: the greedy action's is written in bold type
        """
        cells = np.argwhere(self.is_open)
        values = numbers[self.grid.states[self.is_open]]
        scale = self._scale(values)
        triangles = [_triangle(row, column, move) for row, column in cells for move in self.grid.moves]
        collection = PolyCollection(
            triangles, array=values.ravel(), cmap=SEQUENTIAL, norm=scale, edgecolors=PAPER, linewidth=0.6, gid="action values"
        )
        self.ax.add_collection(collection, autolim=False)
        texts = np.array(number_texts(values.ravel())).reshape(values.shape)
        bold = greedy_actions(values) if has_greedy_action else np.full(len(values), -1)
        for (row, column), cell_texts, bold_action in zip(cells, texts, bold, strict=True):
            for action, (down, right) in enumerate(self.grid.moves):
                weight = "bold" if action == bold_action else "normal"
                self._write(row, column, cell_texts[action], x=0.3 * right, y=0.34 * down, size=0.72, weight=weight)
        self._finish()

    def move_agent(self, row: int, column: int) -> None:
        """
        Show the agent in a cell.

        :param row: of the cell
        :param column: of the cell
        """
        if self.agent is None:
            # A ring, so that the arrow inside it can be seen
            style: dict[str, Any] = {"markersize": 3.9 * self.font_size, "markeredgewidth": 0.35 * self.font_size}
            (self.agent,) = self.ax.plot([], [], "o", color=AGENT, markerfacecolor="none", zorder=9, gid="agent", **style)
        self.agent.set_data([column], [row])

    def _scale(self, values: np.ndarray) -> Any:
        return color_scale(values, self.limits)

    def _write(
        self, row: int, column: int, text: str, x: float = 0.0, y: float = 0.0, size: float = 1.0, **style: Any
    ) -> None:
        style = {"ha": "center", "va": "center", "color": INK, **style}
        self.ax.text(column + x, row + y, text, fontsize=size * self.font_size, **style)

    def _draw_greedy_actions(self, table: np.ndarray) -> None:
        greedy = greedy_actions(table)[self.grid.states]
        undecided = is_undecided(table)[self.grid.states]
        arrows: list[tuple[float, ...]] = []
        for row, column in np.argwhere(self.is_open):
            action = int(greedy[row, column])
            down, right = self.grid.moves[action]
            if undecided[row, column]:
                self._write(row, column, UNDECIDED, y=-0.1, size=2.0)
            elif (down, right) == (0, 0):
                text = self.grid.names[action].replace(" ", "\n")
                self._write(row, column, text, y=-0.1, weight="bold", linespacing=1.0)
            else:
                length = 0.44 / np.hypot(down, right)
                arrows.append((column, row - 0.08, right * length, down * length))
        if undecided[self.is_open].any():
            self.notes.append(f"{UNDECIDED} all actions are equal")
        if arrows:
            x, y, u, v = zip(*arrows, strict=True)
            self.ax.quiver(
                x, y, u, v, color=INK, pivot="mid", angles="xy", scale_units="xy", scale=1.0, units="xy", width=0.055,
                headwidth=4.2, headlength=4.2, headaxislength=4.0, gid="greedy actions", zorder=4,
            )  # fmt: skip

    def _finish(self) -> None:
        for row, column in np.ndindex(self.shape):
            self._draw_letter(row, column, str(self.grid.letters[row, column]))
        for (x_0, y_0), (x_1, y_1) in self.grid.fences:
            self.ax.plot([x_0, x_1], [y_0, y_1], color=INK, linewidth=0.3 * self.font_size, solid_capstyle="round", zorder=5)
        letters = [letter for letter in MEANINGS if letter != WALL and (self.grid.letters == letter).any()]
        self.notes[:0] = [f"{letter} {MEANINGS[letter]}" for letter in letters]
        self.ax.set_xlabel("    ".join(self.notes), fontsize="small", loc="left")

    def _draw_letter(self, row: int, column: int, letter: str) -> None:
        """Shapes and hatches as well as letters, so that no cell is told from another by its colour alone."""
        if letter == HOLE:
            self._cover(row, column, facecolor=PAPER)
            self.ax.add_patch(Circle((column, row), 0.36, facecolor="#444444", edgecolor=INK, gid="hole"))
            self._write(row, column, letter, size=1.5, color=PAPER, weight="bold")
        elif letter == CLIFF:
            self._cover(row, column, facecolor="#DDDDDD", hatch="////", gid="cliff")
            box = {"boxstyle": "circle,pad=0.2", "facecolor": PAPER, "edgecolor": "none"}
            self._write(row, column, letter, size=1.3, weight="bold", bbox=box)
        elif letter == WALL:
            self._cover(row, column, facecolor=INK, gid="wall")
        elif letter in (GOAL, TERMINAL):
            self._cover(row, column, facecolor=PAPER)
            style, name = ("-", "goal") if letter == GOAL else ("--", "terminal")
            frame = Rectangle(
                (column - 0.4, row - 0.4), 0.8, 0.8, facecolor="none", edgecolor=INK, linestyle=style, gid=name,
                linewidth=0.2 * self.font_size,
            )  # fmt: skip
            self.ax.add_patch(frame)
            self._write(row, column, letter, size=1.6, weight="bold")
        elif letter:
            ground = {"boxstyle": "square,pad=0.15", "facecolor": PAPER, "edgecolor": INK, "linewidth": 0.5}
            self._write(row, column, letter, x=-0.34, y=-0.34, size=0.85, weight="bold", bbox=ground, zorder=6)

    def _cover(self, row: int, column: int, **style: Any) -> None:
        style = {"edgecolor": "#888888", "linewidth": 0.6, **style}
        self.ax.add_patch(Rectangle((column - 0.5, row - 0.5), 1.0, 1.0, **style))


def _triangle(row: int, column: int, move: tuple[int, int]) -> np.ndarray:
    """The quarter of a cell on the side that a move leads to, as three points (x, y)."""
    down, right = move
    center = np.array([column, row], dtype=np.float64)
    forward, aside = np.array([right, down]), np.array([down, right])
    return np.array([center, center + 0.5 * (forward + aside), center + 0.5 * (forward - aside)])
