"""What can go wrong with an experiment, told to the user without a traceback."""

from collections.abc import Iterable
from difflib import get_close_matches


class ExperimentError(Exception):
    """An experiment cannot go on, for a reason outside its design: the disk, the cluster, a worker, a file."""


class DesignError(ExperimentError, ValueError):
    """What was asked for is no experiment: an unknown name, a number out of range, a folder with another design."""


def unknown_name(kind: str, name: object, choices: Iterable[object], advice: str = "") -> DesignError:
    """
    :param kind: what the name should be the name of
    :param name: the name that was given
    :param choices: the names that exist
    :param advice: what else could be given
    :return: an error that offers the nearest name, or all of them where none is near
    """
    names = [str(choice) for choice in choices]
    near = get_close_matches(str(name), names, n=1, cutoff=0.5)
    hint = f"Did you mean {near[0]!r}?" if near else f"There are {', '.join(names)}."
    return DesignError(" ".join(part for part in (f"Unknown {kind} {str(name)!r}.", hint, advice) if part))
