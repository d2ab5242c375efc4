"""The paper's own numbers, its claims, and what in it cannot be right, as shipped in the folder ``paper``."""

from importlib.resources import files

import pandas as pd


def paper_table(number: int) -> pd.DataFrame:
    """
    :param number: 1, 6, 7 or 8
    :return: that table of the paper as printed
    """
    return _read(f"table_{number}")


def claims() -> pd.DataFrame:
    """
    :return: a row for each claim: its name, system, kind, measure, the methods it is about, and a text
    """
    return _read("claims")


def inconsistencies() -> pd.DataFrame:
    """
    :return: a row for each: the place in the paper, what is printed there, and why it cannot be right
    """
    return _read("inconsistencies")


def _read(name: str) -> pd.DataFrame:
    with (files("sb3_adaptive_q.study") / "paper" / f"{name}.csv").open(encoding="utf-8") as file:
        return pd.read_csv(file)
