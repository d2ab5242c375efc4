"""What all pictures share: fonts that journals take, and colours and lines that survive grey print."""

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib import colormaps, rc_context
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, ListedColormap, Normalize
from matplotlib.figure import Figure

#: Settings that hold while a picture is drawn and saved: TrueType fonts are embedded (42), no Type 3 fonts.
#: For an axis in a figure of your own, save it within ``with matplotlib.rc_context(STYLE):``
STYLE: Any = {"pdf.fonttype": 42, "ps.fonttype": 42, "hatch.linewidth": 0.6}

#: From the palette of Okabe and Ito (2008), which the colour-blind can tell apart; dark and light take turns
COLORS = ("#000000", "#D55E00", "#0072B2", "#E69F00", "#00664B", "#CC79A7", "#56B4E9")
LINE_STYLES: tuple[Any, ...] = (
    "-",
    (0, (5, 1.5)),
    (0, (6, 1.5, 1.2, 1.5)),
    (0, (1.2, 1.2)),
    (0, (6, 1.5, 1.2, 1.5, 1.2, 1.5)),
)
INK, PAPER, AGENT = "#222222", "#FFFFFF", "#D55E00"

# Darker without exception, so that grey print keeps the order; light enough throughout for black letters
SEQUENTIAL: Colormap = ListedColormap([colormaps["YlGnBu"](0.03 + 0.52 * i / 255) for i in range(256)], name="light_to_dark")
SEQUENTIAL = SEQUENTIAL.with_extremes(bad=PAPER)


class PlotFigure(Figure):
    """A figure that is saved with :data:`STYLE`, whatever matplotlib's settings are by then."""

    def savefig(self, *args: Any, **kwargs: Any) -> None:
        """
        Save the figure as matplotlib does, with fonts that journals take.

        :param args: as in matplotlib
        :param kwargs: as in matplotlib
        """
        with rc_context(STYLE):
            super().savefig(*args, **kwargs)


def new_axes(size: tuple[float, float]) -> Axes:
    """
    :param size: width and height of the figure in inches
    :return: the only axes of a new figure, which pyplot shows
    """
    figure = plt.figure(FigureClass=PlotFigure, figsize=size, layout="constrained")
    return figure.subplots()


def color_scale(values: np.ndarray, limits: tuple[float, float] | None) -> Normalize:
    """
    :param values: what is drawn, of any shape; NaN for nothing
    :param limits: the values that the lightest and the darkest colour stand for; ``None`` for the least and the largest
    :return: the scale of the colours; where all values are equal, one that gives the lightest colour
    :raises ValueError: if the first limit is not below the second
    """
    if limits is not None:
        if not limits[0] < limits[1]:
            raise ValueError(f"`limits` must be a smaller and a larger number, but got {limits}.")
        return Normalize(*limits)
    known = values[np.isfinite(values)]
    if known.size and known.min() < known.max():
        return Normalize(float(known.min()), float(known.max()))
    low = float(known[0]) if known.size else 0.0
    return Normalize(low, low + 1.0)


def tidy(ax: Axes) -> None:
    """
    Leave the frame away where it says nothing, and draw a faint grid.

    :param ax: the axes of a curve
    """
    ax.spines[["top", "right"]].set_visible(False)
    ax.grid(alpha=0.3, linewidth=0.6)
