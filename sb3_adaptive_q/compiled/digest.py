"""What decides how a plain function behaves once it is machine code, as a digest that is equal in every process."""

import hashlib
import sys
import types
from collections.abc import Callable, Iterator
from enum import Enum
from typing import Any

import numba
import numpy as np

#: Functions of these packages are Numba's to know, and do not change under us
_FOREIGN = {*sys.stdlib_module_names, "numpy", "numba"} - {"__main__"}
_PLAIN = (bool, int, float, complex, str, bytes, np.generic, type(None), type(Ellipsis))


class CannotFreeze(ValueError):
    """A function uses a value that machine code cannot hold."""


def is_foreign(module_name: str | None) -> bool:
    """
    :param module_name: the name of a module
    :return: whether Numba knows it, so that its functions are not compiled by us
    """
    return (module_name or "").partition(".")[0] in _FOREIGN


def plain_function(value: Any) -> types.FunctionType | None:
    """
    :param value: any object
    :return: the Python function in it that is compiled with its caller; ``None`` if there is none
    """
    function = getattr(value, "py_func", value)
    if isinstance(function, types.FunctionType) and not is_foreign(function.__module__):
        return function
    return None


def names_of(function: types.FunctionType) -> list[str]:
    """
    :param function: a function
    :return: the names of globals and attributes that its code uses, those of functions inside it too
    """
    return [name for code in _code_of(function) for name in code.co_names]


def digest_of(function: Callable[..., Any], *options: Any) -> str:
    """
    :param function: a function whose byte code, defaults, constants, globals and helpers count
    :param options: what else decides the machine code, with a ``repr`` that is equal in every process
    :return: a hexadecimal digest
    :raises CannotFreeze: if a global is of a kind that machine code cannot hold
    """
    digest = hashlib.sha256(repr(options).encode())
    for part in _parts(function, []):
        digest.update(repr(part).encode())
    return digest.hexdigest()[:20]


def _parts(function: Any, seen: list[Any]) -> Iterator[Any]:
    seen.append(function)
    yield function.__name__, _constant("a default", function.__defaults__), _constant("a default", function.__kwdefaults__)
    for code in _code_of(function):
        yield code.co_code, code.co_names, code.co_varnames
        for constant in code.co_consts:
            if not isinstance(constant, types.CodeType):
                yield _constant("a constant", constant)
    for name, value in _values_used(function):
        helper = plain_function(value)
        if helper is None:
            yield name, _constant(name, value)
            continue
        yield name, sorted(getattr(value, "targetoptions", {}).items())
        if helper in seen:
            yield seen.index(helper)
        else:
            yield from _parts(helper, seen)


def _values_used(function: types.FunctionType) -> Iterator[tuple[str, Any]]:
    """The globals and closure cells that a function's code names, and what it may read of modules."""
    names = names_of(function)
    for name in dict.fromkeys(names):
        if name in function.__globals__:
            yield from _with_attributes(name, function.__globals__[name], names)
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        yield from _with_attributes(name, cell.cell_contents, names)


def _with_attributes(name: str, value: Any, names: list[str]) -> Iterator[tuple[str, Any]]:
    yield name, value
    if isinstance(value, types.ModuleType) and not is_foreign(value.__name__):
        for attribute in dict.fromkeys(names):
            held = getattr(value, attribute, None)
            if isinstance(held, types.ModuleType) and held is not value:
                yield from _with_attributes(f"{name}.{attribute}", held, [other for other in names if other != attribute])
            elif held is not None and held is not value:
                yield f"{name}.{attribute}", held


def _constant(name: str, value: Any) -> Any:
    """What the compiler freezes of a value, with a ``repr`` that tells it from every other."""
    if isinstance(value, _PLAIN):
        return type(value).__name__, value
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, tuple):
        return type(value).__name__, getattr(value, "_fields", ()), [_constant(name, item) for item in value]
    if isinstance(value, frozenset):  # its order depends on the seed of hashes
        return sorted(repr(_constant(name, item)) for item in value)
    if isinstance(value, dict):
        return [(key, _constant(name, item)) for key, item in value.items()]
    if isinstance(value, types.ModuleType):
        return "module", value.__name__
    return _named(name, value)


def _named(name: str, value: Any) -> Any:
    """A type or a foreign function: known by what it is called, and by what it holds."""
    if isinstance(value, type) and issubclass(value, Enum):
        return [(member.name, member.value) for member in value]
    if isinstance(value, type):
        return value.__module__, value.__qualname__, getattr(value, "_fields", ())
    if isinstance(value, np.ufunc | np.dtype):
        return type(value).__name__, str(value)
    body = getattr(getattr(value, "_dispatcher", None), "py_func", None)
    if body is not None:  # made by ``numba.vectorize``
        return "vectorize", list(_parts(body, []))
    if isinstance(value, numba.types.Type):
        return "numba", repr(value)
    if callable(value) and is_foreign(getattr(value, "__module__", None) or type(value).__module__):
        return getattr(value, "__module__", None), getattr(value, "__qualname__", repr(type(value)))
    if is_foreign(type(value).__module__) and type(value).__module__.startswith("numba"):
        return "numba", repr(value)
    raise CannotFreeze(
        f"it uses `{name}`, which is a {type(value).__qualname__}: machine code can hold numbers, arrays, tuples and functions"
    )


def _code_of(function: types.FunctionType) -> list[types.CodeType]:
    """The code of a function, and of the functions and comprehensions inside it."""
    found = [function.__code__]
    for code in found:
        found += [constant for constant in code.co_consts if isinstance(constant, types.CodeType)]
    return found
