"""
What the compiled path needs of Numba: plain functions that enter compiled code, and a disk cache that never runs an
edited one stale and works without a disk.
"""

import hashlib
import sys
import types
from collections.abc import Callable, Iterator
from functools import cached_property
from typing import Any

#: Functions from these packages are Numba's to know, and do not change under us
_FOREIGN = {*sys.stdlib_module_names, "numpy", "numba"} - {"__main__"}


class FunctionSet:
    """
    Plain functions under one name, to be handed to compiled code.

    The value carries nothing at run time. Its Numba type is made of the name and a digest of the source, and selects
    the functions while the loop is being compiled. So the disk cache hits in a later process, misses after an edit, and
    never needs to import a user's module in order to be read.

    :param name: who they are, unique and equal in every process
    :param container: the named tuple that they expect their parameters in, or ``tuple``
    :param functions: the functions by the name under which the loop calls them
    """

    def __init__(self, name: str, container: type = tuple, **functions: Callable[..., Any]) -> None:
        self.name = name
        self.container = container
        self.functions = functions
        self.__dict__.update(functions)  # a plain attribute is what costs least on the per-step path

    @cached_property
    def digest(self) -> str:
        """Differs when one of the functions, or what it calls, was edited."""
        return source_digest(*self.functions.values()) + "-".join(getattr(self.container, "_fields", ()))


def compile_cached(function: Callable[..., Any]) -> Any:
    """
    Compile a function without the interpreter lock, and keep the machine code on disk where there is a place for it.

    :param function: a function of the part of Python that Numba compiles
    :return: its compiled form
    """
    from numba import njit

    try:
        return njit(function, nogil=True, cache=True)
    except RuntimeError:  # a read-only installation and no home directory: Numba finds no place for its cache
        return njit(function, nogil=True)


def source_digest(*functions: Callable[..., Any]) -> str:
    """
    :param functions: functions whose byte code, defaults, constants and helpers count
    :return: a hexadecimal digest that is equal in every process, and differs when any of it was edited
    """
    digest = hashlib.sha256()
    for part in _parts(functions):
        digest.update(repr(part).encode())
    return digest.hexdigest()[:20]


def helpers_of(function: Callable[..., Any]) -> list[types.FunctionType]:
    """
    :param function: a function
    :return: the plain functions that it calls by name, directly or through others, itself first
    """
    found: list[types.FunctionType] = []
    _collect(function, found)
    return found


def _collect(item: Any, found: list[types.FunctionType]) -> None:
    if isinstance(item, types.FunctionType) and item not in found and item.__module__.partition(".")[0] not in _FOREIGN:
        found.append(item)
        for value in _values_used(item):
            _collect(value, found)


def _parts(functions: tuple[Callable[..., Any], ...]) -> Iterator[Any]:
    """What decides how the functions behave, in an order that is the same in every process."""
    for function in functions:
        for helper in helpers_of(getattr(function, "py_func", function)):
            yield helper.__qualname__, helper.__defaults__
            yield from _parts_of_code(helper.__code__)
            yield from (value for value in _values_used(helper) if isinstance(value, bool | int | float | str | tuple))


def _parts_of_code(code: types.CodeType) -> Iterator[Any]:
    yield code.co_code, code.co_names, code.co_varnames
    for constant in code.co_consts:
        if isinstance(constant, types.CodeType):
            yield from _parts_of_code(constant)
        else:
            yield constant


def _values_used(function: types.FunctionType) -> list[Any]:
    """The globals, closure cells, and attributes of global modules that a function's code names."""
    names = function.__code__.co_names
    direct = [function.__globals__[name] for name in names if name in function.__globals__]
    modules = [value for value in direct if isinstance(value, types.ModuleType)]
    through_modules = [getattr(module, name) for module in modules for name in names if hasattr(module, name)]
    cells = [cell.cell_contents for cell in function.__closure__ or ()]
    return [getattr(value, "py_func", value) for value in (*direct, *through_modules, *cells)]
