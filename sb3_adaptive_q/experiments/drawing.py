"""What the figures of all experiments share: legible in grey print and to the colour-blind."""

from io import BytesIO
from typing import Any

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

# From the palette of Okabe and Ito, which the colour-blind can tell apart; light and thin against dark and thick, so
# that grey print can as well
BLUE, GREEN, GREY, INK = "#56B4E9", "#00664B", "#AAAAAA", "#222222"
COLORS = ("#000000", "#E69F00", "#0072B2", "#CC79A7", "#009E73", "#D55E00", "#56B4E9")
LINES: tuple[Any, ...] = ("-", (0, (4, 1.5)), (0, (1, 1.2)), (0, (6, 1.5, 1, 1.5)))
MARKERS = "osD^vPX*<>hp"
#: Dots per inch of PNG files, and of the dense curves inside PDF files
RESOLUTION = 150


def line_style(i: int) -> dict[str, Any]:
    """
    :param i: the place of a curve among those of a figure
    :return: its colour and its dashes; two neighbours share the colour and differ in the dashes
    """
    color, line = COLORS[i // 2 % len(COLORS)], i % 2 + 2 * (i // (2 * len(COLORS)) % 2)
    return {"color": color, "linestyle": LINES[line]}


def tidy(axis: Axes) -> None:
    """
    :param axis: what to free of lines that say nothing
    """
    axis.spines[["top", "right"]].set_visible(False)
    axis.grid(alpha=0.25, linewidth=0.6)


def render(figure: Figure, kind: str) -> bytes:
    """
    :param figure: a figure
    :param kind: ``"png"`` or ``"pdf"``
    :return: the content of its file, which is the same whenever it is made
    """
    buffer = BytesIO()
    with rc_context({"path.simplify_threshold": 1.0}):
        figure.savefig(buffer, format=kind, dpi=RESOLUTION, metadata={"CreationDate": None} if kind == "pdf" else None)
    figure.set_layout_engine("none")  # which keeps the places of everything, and saves finding them again
    return buffer.getvalue()
