"""The package's algorithms, so that a new one is tested like the others."""

from typing import Any

from sb3_adaptive_q.algorithms.registry import ALGORITHMS


def algorithms() -> list[type[Any]]:
    """
    :return: the classes of the algorithms that the package offers
    """
    return list(ALGORITHMS.values())
