"""
Copies of plain functions that nothing changes any more, each under a name made of all that decides its machine code.

One walk through a function's globals makes both: the copy, whose globals are the frozen ones, and the digest in its name.
A function or a global that changes later gives another copy under another name.
"""

import hashlib
import sys
import threading
import types
from collections.abc import Callable
from enum import Enum
from functools import cache
from typing import Any

import numba
import numpy as np
from numba import config
from numba.extending import register_jitable

from sb3_adaptive_q.compiled import frozen

#: How functions are compiled into their caller. Without reference counts, which would cost a third of the speed: every array
#: is the caller's, who holds it. Without the entrances from Python and C, which nobody uses and which take time to compile
INLINED: dict[str, Any] = {"forceinline": True, "_nrt": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
#: How the function that is called from Python is compiled
OPTIONS: dict[str, Any] = {"nogil": True, "error_model": "numpy", "_nrt": False}

#: Functions of these packages are Numba's to know, and do not change under us
_FOREIGN = {*sys.stdlib_module_names, "numpy", "numba"} - {"__main__"}
_PLAIN = (bool, int, float, complex, str, bytes, np.generic, type(None), type(Ellipsis))

_lock = threading.RLock()
_being_copied: list[types.FunctionType] = []
_copies: dict[tuple[Any, ...], types.FunctionType] = {}


class CannotFreeze(ValueError):
    """A function uses a value that machine code cannot hold."""


def freeze(function: Callable[..., Any]) -> types.FunctionType:
    """
    Copy a function and the plain functions that it uses, with the values that its globals have now.

    :param function: a plain function
    :return: the copy, which other compiled code may call; the same object as long as nothing has changed. Its name ends in a
        digest that is equal in every process
    :raises CannotFreeze: if it uses a value that machine code cannot hold
    """
    original = _plain_function(function)
    if original is None:
        raise CannotFreeze(f"{function!r} is not a plain Python function")
    with _lock:
        if original in _being_copied:
            raise CannotFreeze(f"it uses `{original.__name__}`, which calls itself")
        _being_copied.append(original)
        try:
            return _copy(original, _options_of(function))
        finally:
            _being_copied.pop()


def _copy(original: types.FunctionType, options: list[tuple[str, Any]]) -> types.FunctionType:
    names, text = _read_code(original.__code__)
    in_scope, cells = original.__globals__, original.__closure__ or ()
    scope, keys = _freeze_values({name: in_scope[name] for name in names if name in in_scope}, names)
    contents = [cell.cell_contents for cell in cells]
    closure, cell_keys = _freeze_values(dict(zip(original.__code__.co_freevars, contents, strict=True)), names)
    # A function of the user's may look beyond the end of an array. Ours do not, and are slower with checks
    is_checked = (original.__module__ or "").partition(".")[0] != __name__.partition(".")[0]
    decides = (
        is_checked, bool(config.BOUNDSCHECK), repr(options), original.__name__, keys, cell_keys,  # type: ignore[attr-defined]
        _key("a default", original.__defaults__), _key("a default", original.__kwdefaults__), text,
    )  # fmt: skip
    if decides in _copies:
        return _copies[decides]
    name = f"{original.__name__}_{hashlib.sha256(repr(decides).encode()).hexdigest()[:20]}"
    scope |= {"__name__": frozen.__name__, "__builtins__": original.__globals__.get("__builtins__")}
    copy = types.FunctionType(
        original.__code__, scope, name, original.__defaults__, tuple(map(types.CellType, closure.values()))
    )
    copy.__kwdefaults__ = original.__kwdefaults__
    copy.__module__, copy.__qualname__ = frozen.__name__, name
    register_jitable(**INLINED, boundscheck=is_checked)(copy)
    setattr(frozen, name, copy)
    _copies[decides] = copy
    return copy


def _freeze_values(values: dict[str, Any], names: list[str], module: str = "") -> tuple[dict[str, Any], tuple[Any, ...]]:
    """The values as the copy shall have them, by name, and what tells each from every other. They may be a module's."""
    frozen_values, keys = {}, []
    for name, value in values.items():
        # Modules may hold each other: so a part of one is searched without its own name
        others = [each for each in names if each != name] if module else names
        frozen_values[name], key = _freeze_value(f"{module}.{name}" if module else name, value, others)
        keys.append((name, key))
    return frozen_values, tuple(keys)


def _freeze_value(name: str, value: Any, names: list[str]) -> tuple[Any, Any]:
    """
    :param name: what a function knows the value by
    :param value: what it uses
    :param names: what its code names beside it, attributes of a module among them
    :return: the value as the copy shall have it, and what tells it from every other
    """
    helper = _plain_function(value)
    if helper is not None:
        if not _options_of(value):
            copy = freeze(helper)
            return copy, copy.__name__
        # Compiled by the user, with options of its own: it stays as it is, and may call itself
        return value, _being_copied.index(helper) if helper in _being_copied else freeze(value).__name__
    if isinstance(value, types.ModuleType) and not _is_foreign(value.__name__):
        held = {other: getattr(value, other) for other in names if getattr(value, other, value) is not value}
        contents, keys = _freeze_values(held, names, module=name)
        copy_of_module = types.ModuleType(value.__name__)
        vars(copy_of_module).update(contents)
        return copy_of_module, (value.__name__, keys)
    return value, _key(name, value)


def _is_foreign(module_name: str | None) -> bool:
    return (module_name or "").partition(".")[0] in _FOREIGN


def _plain_function(value: Any) -> types.FunctionType | None:
    """The Python function in a value that is compiled with its caller; ``None`` if there is none."""
    function = getattr(value, "py_func", value)
    if isinstance(function, types.FunctionType) and not _is_foreign(function.__module__):
        return function
    return None


def _options_of(function: Any) -> list[tuple[str, Any]]:
    options = getattr(function, "targetoptions", None)
    return sorted(options.items()) if options else []


@cache
def _read_code(code: types.CodeType) -> tuple[list[str], str]:
    """
    The names in the code of a function and of the functions and comprehensions inside it, and a digest of that code and of how
    it is compiled.
    """
    found = [code]
    for each in found:
        found += [constant for constant in each.co_consts if isinstance(constant, types.CodeType)]
    names = list(dict.fromkeys(name for each in found for name in each.co_names))
    facts = [(each.co_code, each.co_names, each.co_varnames, _constants_of(each)) for each in found]
    return names, hashlib.sha256(repr((INLINED, OPTIONS, facts)).encode()).hexdigest()


def _constants_of(code: types.CodeType) -> list[Any]:
    return [_key("a constant", constant) for constant in code.co_consts if not isinstance(constant, types.CodeType)]


def _key(name: str, value: Any) -> Any:
    """What the compiler freezes of a value, the same in every process. 1, 1.0 and True differ, and so do 0.0 and -0.0."""
    if isinstance(value, _PLAIN):
        return type(value).__name__, repr(value)
    if isinstance(value, np.ndarray):
        return value.dtype.str, value.shape, value.tobytes()
    if isinstance(value, tuple):
        return type(value).__name__, repr(getattr(value, "_fields", ())), *[_key(name, item) for item in value]
    if isinstance(value, frozenset):  # its order depends on the seed of hashes
        return tuple(sorted(repr(_key(name, item)) for item in value))
    if isinstance(value, dict):
        return tuple((repr(key), _key(name, item)) for key, item in value.items())
    if isinstance(value, types.ModuleType):
        return "module", value.__name__
    return _key_of_named(name, value)


def _key_of_named(name: str, value: Any) -> Any:
    """A type or a foreign function: known by what it is called, and by what it holds."""
    if isinstance(value, type) and issubclass(value, Enum):
        return tuple((member.name, repr(member.value)) for member in value)
    if isinstance(value, type):
        return value.__module__, value.__qualname__, repr(getattr(value, "_fields", ()))
    if isinstance(value, np.ufunc | np.dtype):
        return type(value).__name__, str(value)
    body = getattr(getattr(value, "_dispatcher", None), "py_func", None)
    if body is not None:  # made by ``numba.vectorize``
        return "vectorize", freeze(body).__name__
    if isinstance(value, numba.types.Type):
        return "numba", repr(value)
    if callable(value) and _is_foreign(getattr(value, "__module__", None) or type(value).__module__):
        return getattr(value, "__module__", None), getattr(value, "__qualname__", repr(type(value)))
    if _is_foreign(type(value).__module__) and type(value).__module__.startswith("numba"):
        return "numba", repr(value)
    raise CannotFreeze(
        f"it uses `{name}`, which is a {type(value).__qualname__}: machine code can hold numbers, arrays, tuples and functions"
    )
