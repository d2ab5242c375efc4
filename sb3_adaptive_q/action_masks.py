"""Action masks: behaviour and targets that keep to the actions which ``info["action_mask"]`` allows."""

from typing import Any

import numpy as np

from sb3_adaptive_q.behaviour import Behaviour

#: Where an environment says which actions are allowed, as gymnasium's Taxi does
ACTION_MASK = "action_mask"
#: The name of the array of masks among those that an update works with
ALLOWED = "allowed"


def mask_arrays(n_states: int, n_actions: int) -> dict[str, np.ndarray]:
    """
    :param n_states: rows of the table
    :param n_actions: columns of the table
    :return: what the functions of :func:`make_masked` find behind the algorithm's own arrays: the mask of every state, as it
        was seen last, all ones where it was not; and room for two rows
    """
    return {ALLOWED: np.ones((n_states, n_actions), dtype=bool), "allowed_rows": np.zeros((2, 1, n_actions))}


def note_mask(allowed: np.ndarray, state: int, info: dict[str, Any]) -> None:
    """
    Take over the mask of a state in which an action is to be chosen. Masks must be functions of the state.

    :param allowed: the masks of all states, of shape (n_states, n_actions)
    :param state: the row of the table
    :param info: what the environment said when it reached the state
    :raises ValueError: if there is no mask, it does not fit, or it forbids every action
    """
    mask = info.get(ACTION_MASK)
    if mask is None:
        raise ValueError(
            f'`use_masking=True` needs `info["{ACTION_MASK}"]` from every reset and step, but there was none in state '
            f"{state}: let the environment give it, or leave `use_masking` out."
        )
    allowed[state] = check_mask(np.asarray(mask), allowed.shape[1:], f"state {state}")


def check_mask(mask: np.ndarray, shape: tuple[int, ...], where: str) -> np.ndarray:
    """
    :param mask: 1 for every action that is allowed, 0 for the others
    :param shape: the shape that it must have, actions last
    :param where: what it belongs to, for the message
    :return: the mask as booleans
    :raises ValueError: if it has another shape, or a row forbids every action
    """
    if mask.shape != shape:
        raise ValueError(f"The action mask of {where} must have the shape {shape}, but has {mask.shape}.")
    allowed = mask.astype(bool)
    if not allowed.any(axis=-1).all():
        raise ValueError(f"The action mask of {where} forbids every action: at least one must be allowed.")
    return allowed


def gather(values, allowed, state, row):
    """
    :param values: of shape (n_states, n_actions)
    :param allowed: which actions are allowed, of the same shape
    :param state: the row
    :param row: of shape (1, n_actions); its beginning is set to the values of the allowed actions
    :return: how many these are
    """
    n_allowed = 0
    for action in range(values.shape[1]):
        if allowed[state, action]:
            row[0, n_allowed] = values[state, action]
            n_allowed += 1
    return n_allowed


def allowed_action(allowed, state, place):
    """
    :param allowed: which actions are allowed, of shape (n_states, n_actions)
    :param state: the row
    :param place: a number from 0
    :return: the allowed action with that many allowed ones before it
    """
    for action in range(allowed.shape[1]):
        if allowed[state, action]:
            if place == 0:
                return action
            place -= 1
    return 0


def show_allowed(tables, state, row):
    """
    :param tables: of action values first, of shape (n_states, n_actions), the mask in the last place but one
    :param state: the state to act in
    :param row: of shape (n_actions,); set to the values of the actions, minus infinity for those that are not allowed
    """
    for action in range(row.shape[0]):
        row[action] = tables[0][state, action] if tables[-2][state, action] else -np.inf


def make_masked(behaviour: Behaviour) -> Behaviour:
    """
    :param behaviour: a behaviour policy
    :return: the same among the actions that are allowed. The last two tables that its functions are given are the mask, of
        shape (n_states, n_actions), and room for two rows, of shape (2, 1, n_actions)
    """
    choose, expect, best, _ = behaviour

    def choose_allowed(tables, state, epsilon, draws):
        allowed, row = tables[-2], tables[-1][0]
        n_allowed = gather(tables[0], allowed, state, row)
        return allowed_action(allowed, state, choose((row[:, :n_allowed],), 0, epsilon, draws))

    def expect_allowed(tables, values, state, epsilon):
        allowed, row, other = tables[-2], tables[-1][0], tables[-1][1]
        n_allowed = gather(tables[0], allowed, state, row)
        gather(values, allowed, state, other)
        return expect((row[:, :n_allowed],), other[:, :n_allowed], 0, epsilon)

    def best_allowed(tables, values, state):
        allowed, row = tables[-2], tables[-1][0]
        n_allowed = gather(values, allowed, state, row)
        place, value = best((row[:, :n_allowed],), row[:, :n_allowed], 0)
        return allowed_action(allowed, state, place), value

    return Behaviour(choose_allowed, expect_allowed, best_allowed, show_allowed)
