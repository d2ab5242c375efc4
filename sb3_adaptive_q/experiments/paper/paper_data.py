"""The paper's own numbers, its claims, and what in it cannot be right, as shipped in the folder ``data``."""

from importlib.resources import files

import pandas as pd


def paper_table(number: int) -> pd.DataFrame:
    """
    :param number: 1, 6, 7 or 8
    :return: that table of the paper as printed
    """
    return read_data(f"table_{number}")


def read_data(name: str) -> pd.DataFrame:
    """
    :param name: ``claims``, a row for each claim; ``inconsistencies``, a row for each place in the paper with what is printed
        there and why it cannot be right; or ``table_1``, ``table_6``, ``table_7``, ``table_8``
    :return: what was shipped
    """
    with (files("sb3_adaptive_q.experiments.paper") / "data" / f"{name}.csv").open(encoding="utf-8") as file:
        return pd.read_csv(file)
