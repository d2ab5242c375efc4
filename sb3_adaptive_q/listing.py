"""The command ``python -m sb3_adaptive_q methods``."""

import argparse
import inspect
import sys

from sb3_adaptive_q.callbacks import METHODS
from sb3_adaptive_q.step_sizes import Description, describe


#: What the parameters of the paper's methods are
MEANINGS = {
    "beta": "the step size: β1 for Method 1, β2 for Method 2",
    "beta_1": "β1, the smaller end of μ",
    "beta_3": "β3, how much larger the other end is",
    "gain": "the factor of Q(s', a) - Q(s, a): -β5 for Method 5, β5 for Method 6",
    "step": "what is added where Q(s', a') is not below Q(s, a), else subtracted: β6 for Method 7, -β6 for Method 8",
    "mu_0": "the first μ, β1 in the paper",
    "lower": "β7, the least μ",
    "upper": "β8, the largest μ",
    "next_action": "the action in s' whose value is compared: that of s (same), the one taken next (next), the best (max)",
    "reset_each_episode": "whether μ starts again from mu_0 with every episode",
}


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
    for number, paper_method in METHODS.items():
        defaults = inspect.signature(paper_method.callback).parameters.values()
        parameters = tuple(f"{each.name} = {each.default}: {MEANINGS[each.name]}" for each in defaults)
        rows.append(Description(str(number), paper_method.formula, parameters, f"the paper, Eq. {paper_method.equation}"))
    return rows
