"""Numbers, names and tables as text, in Markdown."""

import re
from collections.abc import Sequence

import numpy as np


def markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """
    :param header: the titles of the columns
    :param rows: the cells
    :return: a table in Markdown, its columns padded so that it reads well as plain text too
    """
    lines = [header, *rows]
    widths = [max(3, *(len(line[i]) for line in lines)) for i in range(len(header))]
    padded = ["| " + " | ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)) + " |" for line in lines]
    rule = "|" + "|".join("-" * (width + 2) for width in widths) + "|"
    return "\n".join([padded[0], rule, *padded[1:]])


def format_number(value: float) -> str:
    """
    :param value: a number
    :return: it with as many decimals as it needs, at most two
    """
    return f"{value:.2f}".rstrip("0").rstrip(".") if np.isfinite(value) else "–"


def format_estimate(value: float, low: float, high: float, decimals: int = 2) -> str:
    """
    :param value: of a statistic
    :param low: the lower end of its interval, or NaN for none
    :param high: the upper end
    :param decimals: how many
    :return: the value with its interval in brackets
    """
    if np.isnan(low):
        return format_number(value)
    return f"{value:.{decimals}f} [{low:.{decimals}f}, {high:.{decimals}f}]"


def p_value(value: float) -> str:
    """
    :param value: of a test
    :return: it in words
    """
    return "p < 0.0001" if value < 1e-4 else f"p = {value:.4f}"


def join(names: Sequence[str]) -> str:
    """
    :param names: some names
    :return: a list in words, "Methods 1, 2 and 3" for instance
    """
    first = "Method "
    if len(names) > 1 and all(re.fullmatch(first + r"\d+", name) for name in names):
        return f"Methods {join([name.removeprefix(first) for name in names])}"
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def file_name(name: str) -> str:
    """
    :param name: of anything
    :return: it as a part of a path
    """
    return re.sub(r"[^\w.-]", "_", name)
