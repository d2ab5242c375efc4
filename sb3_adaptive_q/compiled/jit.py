"""
Machine code from plain functions, by Numba.

:func:`sb3_adaptive_q.compiled.freezing.freeze` copies a plain function under a name made of the digest of all that it uses;
:func:`machine_code` compiles the copy, which Numba's disk cache then knows by its name.
"""

import threading
import types
from collections.abc import Callable
from functools import wraps
from pickle import UnpicklingError
from typing import Any

import numpy as np
from numba import config, njit, typeof
from numba import types as numba_types
from numba.core.errors import NumbaError

from sb3_adaptive_q.compiled.freezing import OPTIONS, CannotFreeze, freeze

#: What a disk cache may raise that is full, cut off, or written by functions that cannot be imported
_CACHE_FAULTS = (OSError, EOFError, UnpicklingError, ImportError, AttributeError)

_lock = threading.RLock()
_compiled: dict[tuple[Any, ...], tuple[Callable[..., Any], Any]] = {}


class CannotCompile(ValueError):
    """A function is outside the part of Python that becomes machine code; the message is the reason, one sentence."""


def is_disabled() -> bool:
    """
    :return: whether ``NUMBA_DISABLE_JIT`` asks for plain Python everywhere
    """
    return bool(config.DISABLE_JIT)  # type: ignore[attr-defined]


def as_python(function: Callable[..., Any]) -> Callable[..., Any]:
    """
    :param function: a function of 64-bit numbers
    :return: the function as Python runs it, with the silent overflow of machine code
    """

    @wraps(function)
    def run(*arguments: Any) -> Any:
        with np.errstate(all="ignore"):
            return function(*arguments)

    return run


def machine_code(function: Callable[..., Any], arguments: tuple[Any, ...]) -> Callable[..., Any]:
    """
    Compile a function, or fetch its machine code from the disk cache.

    :param function: a plain function of numbers, arrays, and tuples of them
    :param arguments: arguments of the types that it will always be called with
    :return: the machine code, to be called with arguments of exactly these types
    :raises CannotCompile: if the function is outside the part of Python that Numba compiles
    """
    return _compiled_once(function, arguments)[0]


def type_returned(function: Callable[..., Any], arguments: tuple[Any, ...]) -> str | None:
    """
    :param function: a plain function that shall return a number
    :param arguments: as for :func:`machine_code`
    :return: what its machine code returns instead, in Numba's words; ``None`` if it returns a number
    :raises CannotCompile: if the function is outside the part of Python that Numba compiles
    """
    returned = _compiled_once(function, arguments)[1]
    return None if isinstance(returned, numba_types.Number | numba_types.Boolean) else str(numba_types.unliteral(returned))


def _compiled_once(function: Callable[..., Any], arguments: tuple[Any, ...]) -> tuple[Callable[..., Any], Any]:
    """The machine code, and the type that it returns."""
    try:
        copy = freeze(function)
        key = (copy, _kind(arguments))
        with _lock:
            if key not in _compiled:
                _compiled[key] = _compile(copy, tuple(map(typeof, arguments)))
        return _compiled[key]
    except CannotFreeze as error:
        raise CannotCompile(str(error)) from error
    except NumbaError as error:
        raise CannotCompile(_reason(error)) from error


def _kind(argument: Any) -> Any:
    """What Numba's type of an argument depends on. It takes less time to find than the type, above all for records."""
    if isinstance(argument, tuple):
        return type(argument), *map(_kind, argument)
    if isinstance(argument, np.ndarray):
        flags, dtype = argument.flags, argument.dtype
        layout = "C" if flags.c_contiguous else "F" if flags.f_contiguous else "A"
        return type(argument), dtype, dtype.isalignedstruct, argument.ndim, layout, flags.writeable
    return typeof(argument)


def _compile(function: types.FunctionType, signature: tuple[Any, ...]) -> tuple[Callable[..., Any], Any]:
    try:
        return _compile_or_load(function, signature)
    except (NumbaError, MemoryError):
        raise
    except Exception as error:  # such as that of `float(str(mu))`, which Numba tries with a type in place of the number
        raise CannotCompile(f"Numba fails with {type(error).__name__}: {_reason(error)}") from error


def _compile_or_load(function: types.FunctionType, signature: tuple[Any, ...]) -> tuple[Callable[..., Any], Any]:
    try:
        return _entry_point(njit(function, cache=True, **OPTIONS), signature)
    except RuntimeError:  # a read-only installation and no home directory: Numba finds no place for its cache
        pass
    except _CACHE_FAULTS:
        pass
    return _entry_point(njit(function, **OPTIONS), signature)


def _entry_point(dispatcher: Any, signature: tuple[Any, ...]) -> tuple[Callable[..., Any], Any]:
    """
    The machine code itself, without the search for a matching signature with which a call of a Numba function begins:
    0.2 µs instead of 1.2. Where Numba hands out no such thing, the ordinary call does the same.
    """
    code = dispatcher.compile(signature)
    return code if callable(code) else dispatcher, dispatcher.overloads[signature].signature.return_type


def _reason(error: Exception) -> str:
    """Numba's explanation, as one sentence."""
    lines = [line.strip() for line in str(error).splitlines()] or [""]
    told = [
        line
        for line in lines
        if line and not line.startswith(("Failed in", "During:", "File ", "- Resolution", "Invalid use"))
    ]
    return (told or lines)[0].rstrip(".")
