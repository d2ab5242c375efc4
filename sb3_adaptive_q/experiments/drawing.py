"""What the figures of all experiments share, besides the style of all pictures."""

import gc
from collections.abc import Callable, Iterable, Iterator
from io import BytesIO
from typing import Any, NamedTuple

import numpy as np
from matplotlib import rc_context
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from sb3_adaptive_q.experiments.runner import in_processes
from sb3_adaptive_q.plots.style import COLORS, LINE_STYLES, STYLE

MARKERS = "osD^vPX*<>hp"
#: Dots per inch of PNG files, and of the dense curves inside PDF files
RESOLUTION = 150
_STYLE: Any = {**STYLE, "path.simplify_threshold": 1.0}


class Picture(NamedTuple):
    """
    :param name: of its file, without the ending
    :param caption: what it shows
    :param make: makes the figure; it must be picklable, as another process may call it
    """

    name: str
    caption: str
    make: Callable[[], Figure]


def line_style(i: int) -> dict[str, Any]:
    """
    :param i: the place of a curve among those of a figure
    :return: its colour and its dashes; two neighbours share the colour and differ in the dashes
    """
    color, line = COLORS[i // 2 % len(COLORS)], i % 2 + 2 * (i // (2 * len(COLORS)) % 2)
    return {"color": color, "linestyle": LINE_STYLES[line]}


def render_all(pictures: Iterable[Picture], workers: int | None, mark: str = "") -> Iterator[bytes]:
    """
    Render many pictures, in processes of their own.

    :param pictures: the pictures
    :param workers: the number of processes; ``None``: one for each core; with 1 they are rendered in this process
    :param mark: what stands in the corner of each
    :return: the content of each picture's PNG file, in order
    :raises ExperimentError: if a worker dies
    """
    return in_processes(_render_marked, [(picture.make, mark) for picture in pictures], workers)


def _render_marked(make: Callable[[], Figure], mark: str) -> bytes:
    figure = make()
    if mark:
        figure.text(0.005, 0.005, mark, ha="left", va="bottom", fontsize="small")
    image = paint(figure)
    del figure
    gc.collect()  # figures are full of reference cycles, and would pile up to a GiB
    return png_of(image)


def paint(figure: Figure) -> Image.Image:
    """
    :param figure: a figure
    :return: its picture
    """
    with rc_context(_STYLE):
        _lay_out(figure)
        canvas = FigureCanvasAgg(figure)
        canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")


def png_of(image: Image.Image) -> bytes:
    """
    :param image: from :func:`paint`
    :return: the content of its PNG file, with 128 colours and so of a third of the size: a report holds dozens of them
    """
    content = BytesIO()
    image.quantize(128, dither=Image.Dither.NONE).save(content, format="png")
    return content.getvalue()


def pdf_of(figure: Figure) -> bytes:
    """
    :param figure: a figure
    :return: the content of its PDF file, which is the same whenever it is made
    """
    content = BytesIO()
    with rc_context(_STYLE):
        _lay_out(figure)
        figure.savefig(content, format="pdf", dpi=RESOLUTION, metadata={"CreationDate": None})
    return content.getvalue()


def _lay_out(figure: Figure) -> None:
    """Find all places once: with its layout engine, saving would draw everything twice, and find them again the next time."""
    figure.set_dpi(RESOLUTION)
    layout = figure.get_layout_engine()
    if layout is not None:
        layout.execute(figure)
        figure.set_layout_engine(None)
