"""All that learning changes besides the table and the step size's memory: one record, the agent's random counter in it."""

from math import inf, isnan
from operator import attrgetter
from typing import Any

import numpy as np

from sb3_adaptive_q.checks import MOST_STEPS
from sb3_adaptive_q.compiled.records import LEARNER

_NAMES = LEARNER.names or ()
#: What the attributes of a model decide, and what tells of a refused transition
_NOT_RESTORED = {
    "gamma", "exploration_initial", "exploration_final", "exploration_fraction", "mu_0", "next_action", "resets_mu", "value",
    "refused_size", "refused_mu", "refused_epsilon", "refused_action",
}  # fmt: skip
_FIELDS: Any = np.ctypeslib.as_ctypes_type(LEARNER)  # type: ignore[arg-type]  # its stubs know no records


class TrainingState:
    """
    The scalars of a learner, which machine code reads and writes in place; see ``LEARNER``.
    """

    def __init__(self) -> None:
        self.record = np.zeros(1, LEARNER)
        self._view()
        self.forget_updates()

    def _view(self) -> None:
        #: The agent's random counter
        self.draws: np.ndarray = self.record["counter"]
        #: The same memory with an attribute for each field: Python reads it five times as fast as the fields of a record
        self.fields: Any = _FIELDS.from_buffer(self.record)

    def __getstate__(self) -> dict[str, Any]:
        return {"record": self.record.copy()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.record = state["record"].copy()  # pickle may hand over an array that is read-only
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

    def restore(self, data: dict[str, Any]) -> None:
        """
        Take over what a training has moved.

        :param data: some or all of what :meth:`as_data` returned
        :raises ValueError: if a number is not one that a training reaches
        """
        known = {name: value for name, value in data.items() if name in _NAMES and name not in _NOT_RESTORED}
        for name, value in known.items():
            is_number = isinstance(value, int | float) and not isinstance(value, bool) and not isnan(value)
            if name in ("mu", "progress"):
                is_sound = is_number and 0.0 <= value <= 1.0
            elif LEARNER[name].kind == "f":
                is_sound = is_number and (value >= 0.0 or name == "mu_max")
            else:
                most = np.iinfo(np.uint64).max if name == "counter" else MOST_STEPS
                is_sound = type(value) is int and 0 <= value <= most
            if not is_sound:
                expected = "from 0 to 1" if name in ("mu", "progress") else "a number that counts something"
                raise ValueError(f"`{name}` must be {expected}, but got {value!r}.")
        for name, value in known.items():
            self.record[name] = value


def field_of_state(name: str, meaning: str) -> Any:
    """
    :param name: a field of ``LEARNER``
    :param meaning: the docstring
    :return: a property of a model that reads and writes it
    """

    def write(model: Any, value: Any) -> None:
        model.training.record[name] = value

    return property(attrgetter(f"training.fields.{name}"), write, doc=meaning)
