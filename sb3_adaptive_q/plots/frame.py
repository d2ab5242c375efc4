"""The table as a pandas DataFrame."""

from typing import Any

import numpy as np
import pandas as pd

from sb3_adaptive_q.plots.numbers import greedy_actions
from sb3_adaptive_q.plots.sources import find_components, find_env, read_memory, read_table


def to_frame(model: Any) -> pd.DataFrame:
    """
    A row for each state, with these columns:

    - ``state``, or ``observation_0``, ``observation_1``, ... where an observation has several components; for an environment
      under :class:`sb3_adaptive_q.wrappers.DiscretizeObservation` the number of the cell, and ``cell_0``, ``cell_1``, ...
    - ``q_0``, ``q_1``, ...: the value of every action
    - ``greedy_action`` and ``value``, that of the greedy action
    - what the step size remembers: ``<name>_0``, ``<name>_1``, ... for every action, or ``<name>`` for one number a state, or
      one for all. Where an algorithm keeps several tables, ``<name>_table_0_0`` and so on

    Actions have the numbers that the environment takes.

    :param model: a model
    :return: the frame, with a row for each row of the table
    """
    table = read_table(model)
    first_action = int(getattr(model.action_space, "start", 0))
    columns = _state_columns(model, len(table))
    columns |= {f"q_{first_action + action}": table[:, action] for action in range(table.shape[1])}
    columns["greedy_action"] = greedy_actions(table) + first_action
    columns["value"] = table.max(axis=1)
    for name, array in read_memory(model).items():
        columns |= _memory_columns(name, array, len(table), first_action)
    return pd.DataFrame(columns)


def _state_columns(model: Any, n_states: int) -> dict[str, np.ndarray]:
    components = find_components(model, find_env(model, None), n_states)
    rows = np.arange(n_states)
    values = np.unravel_index(rows, components.sizes)
    columns = [digits + start for digits, start in zip(values, components.starts, strict=True)]
    if components.edges is not None:
        return {"state": rows} | {f"cell_{i}": column for i, column in enumerate(columns)}
    if len(columns) == 1:
        return {"state": columns[0]}
    return {f"observation_{i}": column for i, column in enumerate(columns)}


def _memory_columns(name: str, array: np.ndarray, n_states: int, first_action: int) -> dict[str, np.ndarray]:
    if array.ndim > 2:
        parts = (_memory_columns(f"{name}_table_{i}", part, n_states, first_action) for i, part in enumerate(array))
        return {key: column for part in parts for key, column in part.items()}
    spread = np.broadcast_to(array, (n_states, array.shape[1]))
    if array.shape[1] == 1:
        return {name: spread[:, 0]}
    return {f"{name}_{first_action + action}": spread[:, action] for action in range(array.shape[1])}
