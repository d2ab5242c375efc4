"""Readings of transition tables that are kept, because most of a short run would be spent on reading the same table again."""

from collections import deque
from collections.abc import Callable
from copy import deepcopy
from typing import Any


class Readings:
    """
    Results, each with a copy of what it was read from.

    :param most: how many are kept; the oldest one is dropped
    """

    def __init__(self, most: int) -> None:
        self._kept: deque[tuple[Any, Any]] = deque(maxlen=most)

    def get(self, contents: Any, read: Callable[[], Any]) -> Any:
        """
        :param contents: dicts, lists and tuples of numbers and texts
        :param read: makes the result of them
        :return: the result for these contents, a kept one or a new one. It is shared, so nobody may change it
        """
        for others, result in tuple(self._kept):  # a copy, as other threads may add to it
            if _are_equal(contents, others):
                return result
        result = read()
        self._kept.append((deepcopy(contents), result))
        return result


def _are_equal(contents: Any, others: Any) -> bool:
    try:
        return bool(contents == others)
    except ValueError:  # an array among the numbers
        return False
