"""
A NumPy generator that machine code draws from without the detour through Python.

To hand a Generator to a compiled function takes several µs, more than a step. NumPy publishes for this purpose the address
of a bit generator's function that returns a number in [0, 1), and that of its argument.
"""

import ctypes
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import (
    intrinsic,
    lower_builtin,
    make_attribute_wrapper,
    models,
    overload_method,
    register_model,
    type_callable,
)

from sb3_adaptive_q.function_set_type import INLINED_METHOD


class Draws:
    """
    What the kernels need of a generator: ``random``.

    :param next_double: the address of the function
    :param state: the address of its argument
    """

    def __init__(self, next_double: int, state: int) -> None:
        self.next_double = next_double
        self.state = state

    def random(self) -> float:
        """
        :return: the number that ``Generator.random`` would give next
        """
        return ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_void_p)(int(self.next_double))(int(self.state))


def addresses_of(generator: np.random.Generator) -> tuple[int, int]:
    """
    :param generator: to draw from; it must live as long as the addresses are used
    :return: the arguments of ``Draws``
    """
    interface: Any = generator.bit_generator.ctypes
    next_double = ctypes.cast(interface.next_double, ctypes.c_void_p).value
    assert next_double is not None
    return next_double, interface.state_address


class DrawsType(types.Type):
    """The Numba type of :class:`Draws`."""

    def __init__(self) -> None:
        super().__init__(name="Draws")


@register_model(DrawsType)
class _DrawsModel(models.StructModel):
    def __init__(self, manager, numba_type):
        super().__init__(manager, numba_type, [("next_double", types.uintp), ("state", types.uintp)])


make_attribute_wrapper(DrawsType, "next_double", "next_double")
make_attribute_wrapper(DrawsType, "state", "state")


@type_callable(Draws)
def _type_draws(context):
    return lambda next_double, state: DrawsType()


@lower_builtin(Draws, types.Integer, types.Integer)
def _make_draws(context, builder, signature, arguments):
    draws = cgutils.create_struct_proxy(signature.return_type)(context, builder)
    draws.next_double, draws.state = arguments
    return draws._getvalue()


@intrinsic
def _call(typing_context, next_double, state):
    """Call the function at an address, as no pointer that were a constant of the machine code could be kept on disk."""

    def generate(context, builder, signature, arguments):
        pointer = ir.IntType(8).as_pointer()
        function_type = ir.FunctionType(ir.DoubleType(), [pointer])
        function = builder.inttoptr(arguments[0], function_type.as_pointer())
        return builder.call(function, [builder.inttoptr(arguments[1], pointer)])

    return types.float64(types.uintp, types.uintp), generate


@overload_method(DrawsType, "random", **INLINED_METHOD)
def _random(draws):
    return lambda draws: _call(draws.next_double, draws.state)  # type: ignore[call-arg]
