"""All that learning changes besides the table and the memory of the step size: one record, the agent's random counter in it."""

from math import inf
from typing import Any

import numpy as np

from sb3_adaptive_q.compiled.loops import LEARNER

_NAMES = LEARNER.names or ()
_PLACES = {name: place for place, name in enumerate(_NAMES)}


class TrainingState:
    """
    The scalars of a learner, which machine code reads and writes in place; see ``LEARNER``.

    :param data: a record to begin with, as :meth:`as_data` returned it; ``None`` for zeros
    """

    def __init__(self, data: dict[str, Any] | None = None) -> None:
        self.record = np.zeros(1, LEARNER)
        self._view()
        self.forget_updates()
        for name, value in (data or {}).items():
            self.record[name] = value

    def _view(self) -> None:
        #: The agent's random counter
        self.draws: np.ndarray = self.record["counter"]
        # Entries of a memory view are Python's numbers, and cost a third of what a record's fields cost
        self._integers: Any = memoryview(self.record.view(np.int64))  # type: ignore[arg-type]
        self._numbers: Any = memoryview(self.record.view(np.float64))  # type: ignore[arg-type]

    def __getstate__(self) -> dict[str, Any]:
        return {"record": self.record.copy()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._view()

    def forget_updates(self) -> None:
        """Begin to add up anew what the logger shows of the updates."""
        self.record["mu_sum"] = self.record["td_error_sum"] = 0.0
        self.record["mu_min"], self.record["mu_max"] = inf, -inf
        self.record["n_logged"] = self.record["n_updates"]

    def as_data(self) -> dict[str, Any]:
        """
        :return: the record as numbers by name
        """
        return {name: self.record[name].item() for name in _NAMES}


def integer_of_state(name: str, meaning: str) -> Any:
    """
    :param name: a field of ``LEARNER``
    :param meaning: the docstring
    :return: a property of a model that reads and writes it
    """
    place = _PLACES[name]

    def read(model: Any) -> int:
        return model.training._integers[place]  # type: ignore[no-any-return]

    def write(model: Any, value: int) -> None:
        model.training._integers[place] = int(value)

    return property(read, write, doc=meaning)


def number_of_state(name: str, meaning: str) -> Any:
    """
    :param name: a field of ``LEARNER``
    :param meaning: the docstring
    :return: a property of a model that reads it
    """
    place = _PLACES[name]

    def read(model: Any) -> float:
        return model.training._numbers[place]  # type: ignore[no-any-return]

    return property(read, doc=meaning)
