"""Numbers and tables in Markdown."""

import numpy as np


def markdown_table(header: list[str], rows: list[list[str]]) -> str:
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


def format_estimate(value: float, low: float, high: float) -> str:
    """
    :param value: of a statistic
    :param low: the lower end of its interval, or NaN for none
    :param high: the upper end
    :return: the value with its interval in brackets
    """
    if np.isnan(low):
        return format_number(value)
    return f"{value:.2f} [{low:.2f}, {high:.2f}]"
