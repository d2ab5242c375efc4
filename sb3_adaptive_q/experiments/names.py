"""What the names in a design stand for: algorithms, methods and whatever else is given as ``module:name``."""

import hashlib
import importlib
import inspect
import os
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from sb3_adaptive_q import ALGORITHMS, METHODS, STEP_SIZES, LearningRateCallback, method
from sb3_adaptive_q.experiments.errors import DesignError, unknown_name
from sb3_adaptive_q.output import locate

IMPORT_PATH = "Something of your own is given as `module:name`."


def is_import_path(name: str) -> bool:
    """
    :param name: a name in a design
    :return: whether it is given as ``module:name``
    """
    return ":" in name


def load_object(path: str) -> Any:
    """
    :param path: ``module:name``; the working directory is looked into as well
    :return: what has that name in that module
    :raises DesignError: if there is no such thing
    """
    module_name, _, name = path.partition(":")
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())
    try:
        return getattr(importlib.import_module(module_name), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise DesignError(
            f"Cannot import {path!r} ({error}): give `module:name`, with the module in the working directory or installed."
        ) from error
    except (Exception, SystemExit) as error:  # a module of the user's may raise anything
        raise DesignError(f"Cannot import {path!r}: its module raises {locate(error)}.") from error


def algorithm_class(name: str) -> type[Any]:
    """
    :param name: of an algorithm, or the ``module:name`` of a class like :class:`sb3_adaptive_q.TabularQ`
    :return: its class
    :raises DesignError: if there is no such algorithm
    """
    if is_import_path(name):
        found = load_object(name)
        if not (isinstance(found, type) and hasattr(found, "learn")):
            raise DesignError(f"{name} must be the class of an algorithm, like sb3_adaptive_q.TabularQ, but is {found!r}.")
        return found
    if name not in ALGORITHMS:
        raise unknown_name("algorithm", name, ALGORITHMS, IMPORT_PATH)
    return ALGORITHMS[name]


def method_names() -> list[str]:
    """
    :return: the numbers of the paper's methods, and the names of the other step sizes
    """
    return [*map(str, METHODS), *STEP_SIZES]


def make_method(name: str, parameters: dict[str, Any]) -> LearningRateCallback:
    """
    :param name: the number or the name of a method, or the ``module:name`` of a subclass of ``LearningRateCallback``
    :param parameters: of the method, by name
    :return: its callback
    :raises DesignError: if there is no such method, or it does not take these parameters
    """
    if not is_import_path(name) and name not in method_names():
        raise unknown_name("method", name, method_names(), IMPORT_PATH)
    try:
        if not is_import_path(name):
            return method(int(name) if name.isdecimal() else name, **parameters)
        made = load_object(name)(**parameters)
    except (TypeError, ValueError) as error:
        raise DesignError(f"{method_label(name)} cannot be made with {parameters}: {error}") from error
    if not isinstance(made, LearningRateCallback):
        raise DesignError(f"{name} must make a LearningRateCallback, but made a {type(made).__name__}.")
    return made


def method_parameters(name: str) -> set[str]:
    """
    :param name: of a method
    :return: the names of what it may be given
    :raises DesignError: if there is no such method
    """
    if is_import_path(name):
        made = load_object(name)
        functions = [made, *(getattr(made, attribute, None) for attribute in ("rule", "step_size"))]
        return {each for function in functions if callable(function) for each in inspect.signature(function).parameters}
    if name not in method_names():
        raise unknown_name("method", name, method_names(), IMPORT_PATH)
    if name.isdecimal():
        return set(inspect.signature(METHODS[int(name)].callback).parameters)
    return {*STEP_SIZES[name].parameters, "scope", "lower", "upper"}


def method_label(name: str) -> str:
    """
    :param name: of a method
    :return: what to call it in a table
    """
    return f"Method {name}" if name.isdecimal() else name.rpartition(":")[2]


def source_digests(names: Iterable[str]) -> dict[str, str]:
    """
    :param names: the names in a design
    :return: a digest of the source of every module among them that is not the package's own, by the module's name
    """
    modules = sorted({name.partition(":")[0] for name in names if is_import_path(name)})
    return {module: _file_digest(module) for module in modules}


def _file_digest(module_name: str) -> str:
    path = getattr(importlib.import_module(module_name), "__file__", None)
    return hashlib.sha256(Path(path).read_bytes()).hexdigest() if path else ""
