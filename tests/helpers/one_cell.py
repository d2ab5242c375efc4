"""A step size of the catalogue at work in a single cell, fed with errors."""

from collections.abc import Iterable

import numpy as np

from sb3_adaptive_q.step_sizes import Step, find_step_size, resolve_parameters


def make_step(td_error: float = 0.0, count: float = 0.0, gamma: float = 0.9, **fields: float) -> Step:
    """The update of the first pair, with zeros where nothing is given."""
    zeros = dict.fromkeys(Step._fields, 0) | {"td_error": td_error, "count": count, "gamma": gamma}
    return Step(**(zeros | fields))


class Cell:
    """
    One cell of a step size, whose function runs as plain Python.

    :param name: the name of the step size
    :param gamma: the discount factor it sees
    :param parameters: its parameters; the others have their defaults
    """

    def __init__(self, name: str, gamma: float = 0.9, **parameters: float) -> None:
        self.step_size = find_step_size(name)
        self.gamma = gamma
        self.parameters = resolve_parameters(name, parameters)
        self.count = 0
        starts = self.step_size.start_values(self.parameters)
        self.memory = {array: np.full((1, 1), start) for array, start in starts.items()}

    def form(self, td_error: float = 0.0) -> float:
        """The step size of the next update, before the last clip."""
        self.count += 1
        step = make_step(float(td_error), float(self.count), self.gamma)
        return float(self.step_size.step_size(0.0, step, *self.parameters.values(), *self.memory.values()))


def sizes_of(name: str, errors: Iterable[float], gamma: float = 0.9, **parameters: float) -> np.ndarray:
    """The step sizes of updates with these errors, from the first on."""
    cell = Cell(name, gamma, **parameters)
    return np.array([cell.form(error) for error in errors])


def estimate(name: str, targets: Iterable[float], start: float = 0.0, **parameters: float) -> tuple[np.ndarray, np.ndarray]:
    """The estimates of Q += size (target - Q) after each target, from a start, and the step sizes."""
    cell, value = Cell(name, **parameters), start
    values, sizes = [], []
    for target in targets:
        size = cell.form(target - value)
        value += size * (target - value)
        values.append(value)
        sizes.append(size)
    return np.array(values), np.array(sizes)
