"""What Numba has to know of a :class:`FunctionSet`, and of plain functions that compiled code calls."""

from collections.abc import Callable
from typing import Any

from numba import types
from numba.extending import (
    NativeValue,
    models,
    overload_method,
    register_jitable,
    register_model,
    typeof_impl,
    unbox,
)

from sb3_adaptive_q import kernels
from sb3_adaptive_q.compilation import FunctionSet, helpers_of, source_digest

INLINED: Any = {"forceinline": True}
INLINED_METHOD: Any = {"jit_options": INLINED}

_functions: dict[tuple[str, str], dict[str, Callable[..., Any]]] = {}
_containers: dict[tuple[str, str], type] = {}
_compilable: set[Any] = set()


class FunctionSetType(types.Opaque):
    """The Numba type of a :class:`FunctionSet`: its identity, and nothing at run time."""

    def __init__(self, identity: tuple[str, str]) -> None:
        self.identity = identity
        super().__init__(name=f"FunctionSet{identity}")

    @property
    def key(self) -> tuple[str, str]:
        return self.identity


register_model(FunctionSetType)(models.OpaqueModel)


def type_of_function_set(value: FunctionSet, context: Any = None) -> FunctionSetType:
    """
    :param value: functions that compiled code is to call
    :param context: why Numba asks; unused
    :return: their type
    """
    identity = (value.name, f"{value.digest}-{_kernels_digest}")
    if identity not in _functions:
        for function in value.functions.values():
            make_compilable(function)
        _containers[identity] = value.container
        _functions[identity] = value.functions  # last: from here on another thread takes it to be ready
    return FunctionSetType(identity)


typeof_impl.register(FunctionSet, type_of_function_set)


@unbox(FunctionSetType)
def _unbox_function_set(numba_type: Any, value: Any, context: Any) -> NativeValue:
    return NativeValue(context.context.get_dummy_value())


def make_compilable(function: Callable[..., Any]) -> None:
    """
    Let compiled code call a plain function, and whatever plain functions that one calls.

    :param function: a function of the subset of Python that Numba knows
    """
    for helper in helpers_of(function):
        if helper not in _compilable:
            _compilable.add(helper)
            register_jitable(**INLINED)(helper)


def container_of(numba_type: FunctionSetType) -> type:
    """
    :param numba_type: the type of a function set
    :return: the named tuple that its functions expect their parameters in, or ``tuple``
    """
    return _containers[numba_type.key]


def _make_callable(name: str) -> None:
    """Let compiled code call the function of that name, as Python does: ``functions.name(...)``."""

    @overload_method(FunctionSetType, name, **INLINED_METHOD)
    def _find(functions, *arguments):
        function = _functions[functions.key][name]
        return lambda functions, *arguments: function(*arguments)


for _name in ("function", "reset", "step", "index", "flaw"):
    _make_callable(_name)

_KERNELS = (kernels.learn_transition, kernels.record_update, kernels.next_rate)
#: Part of every identity, as the kernels are compiled into whatever takes a function set
_kernels_digest = source_digest(*_KERNELS)
for _kernel in _KERNELS:
    make_compilable(_kernel)
