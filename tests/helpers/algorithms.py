"""The package's algorithms, so that a new one is tested like the others."""

from typing import Any

import sb3_adaptive_q
from sb3_adaptive_q import TabularAlgorithm


def algorithms() -> list[type[Any]]:
    """
    :return: the classes of the algorithms that the package offers, by name
    """
    offered = [getattr(sb3_adaptive_q, name) for name in sorted(sb3_adaptive_q.__all__)]
    return [
        each
        for each in offered
        if isinstance(each, type) and issubclass(each, TabularAlgorithm) and each is not TabularAlgorithm
    ]
