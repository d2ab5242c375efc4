"""The text of ``python -m sb3_adaptive_q methods``: every method with its formula, parameters and source."""

import textwrap
from collections.abc import Iterable
from typing import NamedTuple

from sb3_adaptive_q.output import spell
from sb3_adaptive_q.step_sizes.registry import STEP_SIZES
from sb3_adaptive_q.step_sizes.step import StepSize

LEGEND = (
    "μ: the step size. n: the number of updates of the cell, this one included. δ: the temporal-difference error. "
    "γ: the discount factor. A ← B: B replaces A at every update. Other letters: parameters, or what the cell remembers."
)


class Description(NamedTuple):
    """
    An entry of the listing.

    :param name: the number or the name that selects the method
    :param formula: what it computes
    :param parameters: a line for each parameter
    :param source: where it was published
    """

    name: str
    formula: str
    parameters: tuple[str, ...]
    source: str


def describe(paper: Iterable[Description] = (), encoding: str | None = "utf-8", width: int = 100) -> str:
    """
    List the methods: the paper's, where they are handed over, then the step sizes of the literature.

    :param paper: the entries of the paper's methods
    :param encoding: the encoding of the file that the text is for, such as ``sys.stdout.encoding``; signs that it does not
        have are spelled out. None stands for ASCII
    :param width: the width of the text, in characters
    :return: the text
    """
    entries = [*paper, *map(_description, STEP_SIZES.values())]
    blocks = [_block(entry, width) for entry in entries] + [textwrap.fill(LEGEND, width, break_on_hyphens=False)]
    return spell("\n\n".join(blocks), encoding or "ascii") + "\n"


def _description(step_size: StepSize) -> Description:
    parameters = tuple(
        f"{name} = {parameter.default:g} in {parameter.range}: {parameter.meaning}"
        for name, parameter in step_size.parameters.items()
    )
    return Description(step_size.name, step_size.formula, parameters, step_size.source)


def _block(entry: Description, width: int) -> str:
    """The name and the source in one line, then the formula and the parameters below it, indented."""
    lines = [f"{entry.name}  ({entry.source})"]
    for text in (entry.formula, *entry.parameters):
        lines += textwrap.wrap(text, width, initial_indent="    ", subsequent_indent="        ")
    return "\n".join(lines)
