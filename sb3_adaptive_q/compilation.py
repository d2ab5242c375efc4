"""
What is needed of Numba: plain functions that enter compiled code, and a disk cache that never runs an edited one stale
and works without a disk.
"""

import hashlib
import sys
import types
from collections.abc import Callable, Iterator
from enum import Enum
from functools import cached_property
from pickle import UnpicklingError
from typing import Any

import numpy as np
from numba import njit

#: Functions from these packages are Numba's to know, and do not change under us
_FOREIGN = {*sys.stdlib_module_names, "numpy", "numba"} - {"__main__"}


class FunctionSet:
    """
    Plain functions under one name, to be handed to compiled code.

    The value carries nothing at run time. Its Numba type is made of the name and a digest of the source, and selects
    the functions while the loop is being compiled. So the disk cache hits in a later process, and misses after an edit.

    :param name: who they are, unique and equal in every process
    :param container: the named tuple that they expect their parameters in, or ``tuple``
    :param functions: the functions by the name under which the loop calls them
    """

    def __init__(self, name: str, container: type = tuple, **functions: Callable[..., Any]) -> None:
        self.name = name
        self.container = container
        self.functions = functions
        self.__dict__.update(functions)

    @cached_property
    def digest(self) -> str:
        """Differs when one of the functions, or what it calls, was edited."""
        return source_digest(*self.functions.values()) + "-".join(getattr(self.container, "_fields", ()))


class CachedFunction:
    """
    A function that is compiled, and whose machine code is kept on disk where there is a place for it.

    :param function: a function of the part of Python that Numba compiles
    :param nogil: whether it gives the interpreter lock away
    """

    def __init__(self, function: Callable[..., Any], nogil: bool) -> None:
        self.function, self.nogil = function, nogil
        try:
            self.dispatcher = njit(function, nogil=nogil, cache=True)
        except RuntimeError:  # a read-only installation and no home directory: Numba finds no place for its cache
            self.dispatcher = njit(function, nogil=nogil)

    def use(self, action: Callable[[Any], Any]) -> Any:
        """
        :param action: what to do with the compiled function, such as to call it
        :return: what the action returns
        """
        try:
            return action(self.dispatcher)
        except (OSError, EOFError, UnpicklingError, ImportError):  # a full disk, a file cut off, functions made by `exec`
            self.dispatcher = njit(self.function, nogil=self.nogil)
            return action(self.dispatcher)

    def __call__(self, *arguments: Any) -> Any:
        return self.use(lambda dispatcher: dispatcher(*arguments))


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
    item = getattr(item, "py_func", item)
    if isinstance(item, types.FunctionType) and item not in found and not _is_foreign(item.__module__):
        found.append(item)
        for value in _values_used(item):
            _collect(value, found)


def _is_foreign(module_name: str | None) -> bool:
    return (module_name or "").partition(".")[0] in _FOREIGN


def _parts(functions: tuple[Callable[..., Any], ...]) -> Iterator[Any]:
    """What decides how the functions behave, in an order that is the same in every process."""
    for function in functions:
        yield _constant(function)
        for helper in helpers_of(function):
            yield helper.__qualname__, helper.__defaults__, helper.__kwdefaults__
            for code in _code_of(helper):
                yield code.co_code, code.co_names, code.co_varnames
                yield from (constant for constant in code.co_consts if not isinstance(constant, types.CodeType))
            yield from map(_constant, _values_used(helper))


def _constant(value: Any) -> Any:
    """What the compiler freezes of a value that a function uses, with a ``repr`` that tells it from every other."""
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, tuple):
        return tuple(map(_constant, value))
    if isinstance(value, type) and issubclass(value, Enum):
        return [(member.name, member.value) for member in value]
    if isinstance(value, bool | int | float | complex | str | np.generic):
        return value
    # A function of the user's that is compiled already: fastmath and the like
    return sorted(getattr(value, "targetoptions", {}).items())


def _code_of(function: types.FunctionType) -> list[types.CodeType]:
    """The code of a function, and of the functions and comprehensions inside it."""
    found = [function.__code__]
    for code in found:
        found += [constant for constant in code.co_consts if isinstance(constant, types.CodeType)]
    return found


def _values_used(function: types.FunctionType) -> list[Any]:
    """The globals, closure cells, and attributes of global modules and of packages' modules that a function's code names."""
    names = [name for code in _code_of(function) for name in code.co_names]
    values = [function.__globals__[name] for name in names if name in function.__globals__]
    for value in values:  # grows: a package's module is a value with attributes of its own
        if isinstance(value, types.ModuleType) and not _is_foreign(value.__name__):
            attributes = [getattr(value, name) for name in names if hasattr(value, name)]
            seen = {id(other) for other in values if isinstance(other, types.ModuleType)}  # they may name one another
            values += [attribute for attribute in attributes if id(attribute) not in seen]
    return values + [cell.cell_contents for cell in function.__closure__ or ()]
