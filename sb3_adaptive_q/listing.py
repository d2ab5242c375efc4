"""The command ``python -m sb3_adaptive_q methods``."""

import inspect
import sys

from sb3_adaptive_q.callbacks import METHODS
from sb3_adaptive_q.step_sizes import Description, describe


def main(arguments: list[str]) -> None:
    """
    Print every method: number or name, formula, parameters and source.

    :param arguments: none are taken
    :raises SystemExit: if there are any
    """
    if arguments:
        raise SystemExit(f"error: `methods` takes no arguments, but got {' '.join(arguments)}.")
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
