"""
The functions of :mod:`sb3_adaptive_q.kernels`, compiled for one transition at a time.

A call costs 0.2 µs, where the same functions cost 2 as Python: whatever takes long to hand over lies in one record, and the
search for a matching signature, with which a call of a Numba function begins, is left out.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, get_type_hints

import numpy as np
from numba import config, from_dtype, types

from sb3_adaptive_q import kernels
from sb3_adaptive_q.compilation import CachedFunction, FunctionSet
from sb3_adaptive_q.draws import Draws
from sb3_adaptive_q.function_set_type import type_of_function_set

#: What an update reads and writes besides its arguments: the constants of a training, the arguments of ``Draws`` for the
#: agent's generator, and what ``record_update`` adds up
WORKSPACE = np.dtype(
    [
        ("learner", list(get_type_hints(kernels.Learner).items())),
        ("draws", np.uintp, (2,)),
        ("statistics", np.float64, (4,)),
    ]
)
_WORKSPACE_TYPE = types.Array(from_dtype(WORKSPACE), 1, "C")


def compile_update(
    rule: FunctionSet, arguments: tuple[float, ...], table: np.ndarray, workspace: np.ndarray
) -> Callable[..., Any]:
    """
    :param rule: the rule that forms μ_{t+1}
    :param arguments: its parameters
    :param table: Q, of shape (n_states, n_actions), float64 and in C order
    :param workspace: of type ``WORKSPACE``, of shape (1,)
    :return: :func:`_update` with these as its first arguments, for Python numbers of exactly the types it expects
    """
    if config.DISABLE_JIT:  # type: ignore[attr-defined]  # for a debugger, say: the same functions as Python
        return partial(_update, rule, arguments, table, workspace.view(np.recarray))
    integer, number, flag = types.int64, types.float64, types.boolean
    signature = (
        type_of_function_set(rule), types.UniTuple(number, len(arguments)), number[:, ::1], _WORKSPACE_TYPE,
        number, number, integer, integer, integer, integer, number, integer, flag, flag, integer,
    )  # fmt: skip
    return partial(_compiled.use(lambda dispatcher: dispatcher.compile(signature)), rule, arguments, table, workspace)


def _update(
    rule, arguments, table, workspace,
    mu, epsilon, n_episodes, num_timesteps, state, action, reward, next_state, terminated, done, reset_state,
):  # fmt: skip
    """
    Learn from a transition; for the arguments see :func:`kernels.learn_transition`.

    :return: (action to take next, μ_{t+1}, ε, and the fields of the transition as rules see it)
    """
    learner, draws, statistics = workspace[0].learner, workspace[0].draws, workspace[0].statistics
    progress = kernels.progress_made(learner, num_timesteps, n_episodes)
    next_action, epsilon, progress, n_episodes, transition = kernels.learn_transition(
        table, Draws(draws[0], draws[1]), learner, mu, epsilon, progress, n_episodes, num_timesteps,
        state, action, reward, next_state, terminated, done, reset_state,
    )  # fmt: skip
    sums = (statistics[0], statistics[1], statistics[2], statistics[3])
    statistics[0], statistics[1], statistics[2], statistics[3] = kernels.record_update(sums, mu, transition.td_error)
    mu = kernels.next_rate(rule, arguments, learner, mu, transition, done)
    return next_action, mu, epsilon, transition.value, transition.next_value, transition.td_error, transition.progress


# With the interpreter lock: to give it away and to fetch it back takes a fifth of a call, and while it is held nobody can
# replace the generator that is drawn from
_compiled = CachedFunction(_update, nogil=False)
