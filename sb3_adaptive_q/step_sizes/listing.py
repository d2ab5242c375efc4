"""The text of ``python -m sb3_adaptive_q methods``: every method with its formula, parameters and source."""

import io
from collections.abc import Iterable
from typing import NamedTuple

from rich.box import ASCII, HORIZONTALS
from rich.console import Console
from rich.table import Table

from sb3_adaptive_q.step_sizes.registry import STEP_SIZES
from sb3_adaptive_q.step_sizes.step import StepSize

#: What is written where a terminal cannot show a sign
_SPELLED = {
    "α": "alpha",
    "β": "beta",
    "γ": "gamma",
    "δ": "delta",
    "ε": "epsilon",
    "η": "eta",
    "θ": "theta",
    "κ": "kappa",
    "λ": "lambda",
    "μ": "mu",
    "ν": "nu",
    "σ": "sigma",
    "τ": "tau",
    "φ": "phi",
    "ψ": "psi",
    "ω": "omega",
    "₀": "_0",
    "²": "^2",
    "√": "sqrt ",
    "←": "<-",
    "≤": "<=",
    "≥": ">=",
    "é": "e",
}

LEGEND = (
    "μ: the step size. n: the number of updates of the cell, this one included. δ: the temporal-difference error. "
    "γ: the discount factor. A ← B: B replaces A at every update. Other letters: what the cell remembers, 0 at first."
)


class Description(NamedTuple):
    """
    A row of the listing.

    :param name: the number or the name that selects the method
    :param formula: what it computes
    :param parameters: a line for each parameter
    :param source: where it was published
    """

    name: str
    formula: str
    parameters: tuple[str, ...]
    source: str


def describe(paper: Iterable[Description] = (), encoding: str | None = "utf-8", width: int = 127) -> str:
    """
    List the methods: the paper's, where they are handed over, then the step sizes of the literature.

    :param paper: the rows of the paper's methods
    :param encoding: the encoding of the file that the text is for, such as ``sys.stdout.encoding``; signs that it does not
        have are spelled out. None stands for ASCII
    :param width: the width of the text, in characters
    :return: the text
    """
    rows = [*paper, *map(_description, STEP_SIZES.values())]
    encoding = encoding or "ascii"
    table = Table(
        box=HORIZONTALS if _can_show(HORIZONTALS.head_row_horizontal, encoding) else ASCII, show_lines=True, pad_edge=False
    )
    for heading, share in (("Method", None), ("Formula", 4), ("Parameters", 4), ("Source", 2)):
        table.add_column(heading, ratio=share, no_wrap=share is None)
    for row in rows:
        table.add_row(*(_spell(text, encoding) for text in (row.name, row.formula, "\n".join(row.parameters), row.source)))
    console = Console(file=io.StringIO(), width=width, color_system=None, legacy_windows=False, markup=False, highlight=False)
    with console.capture() as captured:
        console.print(table)
        console.print(_spell(LEGEND, encoding))
    return "\n".join(line.rstrip() for line in captured.get().splitlines()) + "\n"


def _description(step_size: StepSize) -> Description:
    parameters = tuple(
        f"{name} = {parameter.default:g} in {parameter.range}: {parameter.meaning}"
        for name, parameter in step_size.parameters.items()
    )
    return Description(step_size.name, step_size.formula, parameters, step_size.source)


def _can_show(text: str, encoding: str) -> bool:
    try:
        text.encode(encoding)
    except (UnicodeEncodeError, LookupError):
        return False
    return True


def _spell(text: str, encoding: str) -> str:
    return "".join(sign if _can_show(sign, encoding) else _SPELLED.get(sign, "?") for sign in text)
