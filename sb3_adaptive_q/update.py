"""
The functions of :mod:`sb3_adaptive_q.kernels`, compiled for one transition at a time.

A call costs 0.3 µs, where the same functions cost 2 as Python: whatever takes long to hand over (an array 40 ns, a
Generator several µs) lies in one record, and the search for a matching signature, with which a call of a Numba function
begins, is left out.
"""

import ctypes
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, get_type_hints

import numpy as np
from llvmlite import ir
from numba import from_dtype, types
from numba.extending import intrinsic, overload_method

from sb3_adaptive_q import kernels
from sb3_adaptive_q.compilation import FunctionSet, compile_cached
from sb3_adaptive_q.function_set_type import INLINED_METHOD, type_of_function_set

#: What the machine code reads and writes besides its arguments: the constants of a training, the address of a bit
#: generator's function that returns a number in [0, 1) and that of its argument, and what ``record_update`` adds up
WORKSPACE = np.dtype(
    [
        ("learner", list(get_type_hints(kernels.Learner).items())),
        ("draws", np.uintp, (2,)),
        ("statistics", np.float64, (4,)),
    ]
)


_WORKSPACES = types.Array(from_dtype(WORKSPACE), 1, "C")


class Draws(NamedTuple):
    """
    A NumPy generator in compiled code.

    :param next_double: the address of its function that returns a number in [0, 1)
    :param state: the address of its state, the argument of that function
    """

    next_double: int
    state: int


def addresses_of(generator: np.random.Generator) -> tuple[int, int]:
    """
    :param generator: to draw from; it must live as long as the addresses are used
    :return: the fields of ``Draws``; ``Generator.random`` and compiled code take the same sequence of numbers
    """
    interface: Any = generator.bit_generator.ctypes
    return ctypes.cast(interface.next_double, ctypes.c_void_p).value or 0, interface.state_address


def compile_update(
    rule: FunctionSet, arguments: tuple[float, ...], table: np.ndarray, workspace: np.ndarray
) -> Callable[..., Any]:
    """
    :param rule: the rule that forms μ_{t+1}
    :param arguments: its parameters
    :param table: Q, of shape (n_states, n_actions)
    :param workspace: of type ``WORKSPACE``, of shape (1,)
    :return: :func:`_update` with these as its first arguments, for Python numbers of exactly the types it expects
    """
    integer, number, flag = types.int64, types.float64, types.boolean
    signature = (
        type_of_function_set(rule), types.UniTuple(number, len(arguments)), number[:, ::1], _WORKSPACES,
        number, number, integer, integer, integer, integer, number, integer, flag, flag, integer,
    )  # fmt: skip
    return partial(_compiled.compile(signature), rule, arguments, table, workspace)


def _update(
    rule, arguments, table, workspace,
    mu, epsilon, n_episodes, num_timesteps, state, action, reward, next_state, terminated, done, reset_state,
):  # fmt: skip
    """
    :return: (action to take next, μ_{t+1}, ε, and the fields of the transition as rules see it)
    """
    learner, draws, statistics = workspace[0].learner, workspace[0].draws, workspace[0].statistics
    progress = kernels.progress_made(learner, num_timesteps, n_episodes)
    next_action, epsilon, progress, n_episodes, transition = kernels.learn_transition(
        table, Draws(draws[0], draws[1]), learner, mu, epsilon, progress, n_episodes, num_timesteps,
        state, action, reward, next_state, terminated, done, reset_state,
    )  # fmt: skip
    totals = (statistics[0], statistics[1], statistics[2], statistics[3])
    totals = kernels.record_update(totals, mu, transition.td_error)
    for i in range(4):
        statistics[i] = totals[i]
    mu = kernels.next_rate(rule, arguments, learner, mu, transition, done)
    return next_action, mu, epsilon, transition.value, transition.next_value, transition.td_error, transition.progress


@intrinsic
def _call_next_double(typing_context, next_double, state):
    def generate(context, builder, signature, arguments):
        pointer = ir.IntType(8).as_pointer()
        function_type = ir.FunctionType(ir.DoubleType(), [pointer])
        function = builder.inttoptr(arguments[0], function_type.as_pointer())
        return builder.call(function, [builder.inttoptr(arguments[1], pointer)])

    return types.float64(types.uintp, types.uintp), generate


@overload_method(types.NamedUniTuple, "random", **INLINED_METHOD)
def _random(draws):
    if draws.instance_class is Draws:
        return lambda draws: _call_next_double(draws.next_double, draws.state)  # type: ignore[call-arg]
    return None


_compiled = compile_cached(_update, nogil=False)
