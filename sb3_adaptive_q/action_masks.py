"""Action masks: behaviour and targets use only the actions that ``info["action_mask"]`` allows."""

from typing import Any

import numpy as np

from sb3_adaptive_q.behaviour import Behaviour

#: The key of ``info`` that says which actions are allowed, as in gymnasium's Taxi
ACTION_MASK = "action_mask"
#: The buffer of the policy with the latest mask of every state: 1 for an action that is allowed, 0 for others. A state that
#: was not seen yet has 1 for all actions
ALLOWED = "allowed"


def mask_arrays(n_actions: int) -> dict[str, np.ndarray]:
    """
    :param n_actions: columns of the table
    :return: the working arrays of the functions of :func:`make_masked`, besides the masks: a buffer for two rows
    """
    return {"allowed_rows": np.zeros((2, 1, n_actions))}


def note_mask(allowed: np.ndarray, state: int, info: dict[str, Any]) -> None:
    """
    Store the mask of a state in which an action is to be chosen. The mask must depend on the state only.

    :param allowed: the masks of all states, of shape (n_states, n_actions)
    :param state: the row of the table
    :param info: the info dict that the environment returned with the state
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
    :param where: the states that it belongs to, for the message
    :return: the mask as booleans
    :raises ValueError: if it has another shape or other values, or a row forbids every action
    """
    if mask.shape != shape:
        raise ValueError(f"The action mask of {where} must have the shape {shape}, but has {mask.shape}.")
    allowed = mask == 1
    if not (allowed | (mask == 0)).all():
        raise ValueError(
            f"The action mask of {where} must be 1 for an action that is allowed and 0 for others, but is {mask}."
        )
    if not allowed.any(axis=-1).all():
        raise ValueError(f"The action mask of {where} forbids every action: at least one must be allowed.")
    return allowed


def gather(values, allowed, state, row):
    """
    :param values: of shape (n_states, n_actions)
    :param allowed: which actions are allowed, of the same shape
    :param state: the row
    :param row: of shape (1, n_actions); its first entries are set to the values of the allowed actions
    :return: the number of allowed actions
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
    :param place: the place among the allowed actions, from 0
    :return: the allowed action at that place
    """
    for action in range(allowed.shape[1]):
        if allowed[state, action]:
            if place == 0:
                return action
            place -= 1
    return 0


def show_allowed(tables, state, row):
    """
    :param tables: the table of action values first, of shape (n_states, n_actions), and the masks last
    :param state: the state to act in
    :param row: of shape (n_actions,); set to the values of the actions, minus infinity for those that are not allowed
    """
    for action in range(row.shape[0]):
        row[action] = tables[0][state, action] if tables[-1][state, action] else -np.inf


def make_masked(behaviour: Behaviour) -> Behaviour:
    """
    :param behaviour: a behaviour policy
    :return: the same behaviour among the actions that are allowed. The last two of the tables that its functions get are a
        buffer for two rows, of shape (2, 1, n_actions), and the masks, of shape (n_states, n_actions)
    """
    choose, expect, best, _ = behaviour

    def choose_allowed(tables, state, epsilon, draws):
        allowed, row = tables[-1], tables[-2][0]
        n_allowed = gather(tables[0], allowed, state, row)
        return allowed_action(allowed, state, choose((row[:, :n_allowed],), 0, epsilon, draws))

    def expect_allowed(tables, values, state, epsilon):
        allowed, row, other = tables[-1], tables[-2][0], tables[-2][1]
        n_allowed = gather(tables[0], allowed, state, row)
        gather(values, allowed, state, other)
        return expect((row[:, :n_allowed],), other[:, :n_allowed], 0, epsilon)

    def best_allowed(tables, values, state):
        allowed, row = tables[-1], tables[-2][0]
        n_allowed = gather(values, allowed, state, row)
        place, value = best((row[:, :n_allowed],), row[:, :n_allowed], 0)
        return allowed_action(allowed, state, place), value

    return Behaviour(choose_allowed, expect_allowed, best_allowed, show_allowed)
