"""The command ``python -m sb3_adaptive_q methods``."""

import argparse
import inspect
import sys

from sb3_adaptive_q.callbacks import METHODS
from sb3_adaptive_q.step_sizes import Description, describe


def main(arguments: list[str]) -> None:
    """
    Print every method: number or name, formula, parameters and source.

    :param arguments: of the command line; there are none but ``--help``
    :raises SystemExit: if there are others, with an error on standard error
    """
    description = "Print every method: its number or name, its formula, its parameters and its source."
    argparse.ArgumentParser(prog="python -m sb3_adaptive_q methods", description=description).parse_args(arguments)
    print(describe(paper_methods(), sys.stdout.encoding))


def paper_methods() -> list[Description]:
    """
    :return: the rows of the paper's methods
    """
    rows = []
    for number, each in METHODS.items():
        defaults = inspect.signature(each.callback).parameters.values()
        parameters = tuple(f"{parameter.name} = {parameter.default}" for parameter in defaults)
        rows.append(Description(str(number), each.formula, parameters, f"the paper, Eq. {each.equation}"))
    return rows
