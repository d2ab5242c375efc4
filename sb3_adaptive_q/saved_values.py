"""
Values as plain data, for saved files: numbers, texts, containers, arrays, spaces, schedules, and functions by their names.

Decoding executes nothing. Functions and classes are looked up in modules that are imported already; no module is imported.
"""

import math
import sys
from collections import deque
from collections.abc import Callable
from math import prod
from pathlib import PurePath
from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.utils import ConstantSchedule, FloatSchedule, LinearSchedule

#: The key that tells an encoded value from a dict of the user
KIND = ":kind:"
#: Kinds of NumPy types that arrays may have: booleans, integers, floats
ARRAY_KINDS = "biuf"
#: The largest number of components of a space. A table can have 2^63 rows, so 63 components of two or more values
MOST_COMPONENTS = 10_000

#: RL Zoo's class for a learning rate such as ``lin_0.1``
SIMPLE_LINEAR = "rl_zoo3.utils:SimpleLinearSchedule"
#: The arguments of the schedules of SB3 and RL Zoo, by class
_SCHEDULES = {
    "stable_baselines3.common.utils:ConstantSchedule": ("val",),
    "stable_baselines3.common.utils:LinearSchedule": ("start", "end", "end_fraction"),
    SIMPLE_LINEAR: ("initial_value",),
}


class NotData(ValueError):
    """A value that is not plain data."""


class MissingFunction:
    """
    Stands for a function of a saved model that is not imported in this process.

    :param path: the function, as ``module:qualified name``
    """

    def __init__(self, path: str) -> None:
        self.path = path

    def __call__(self, progress: float) -> float:
        """
        :param progress: unused
        :return: 0. It is never used to learn: ``learn`` raises an error while the function is missing
        """
        return 0.0


def encode(value: Any, arrays: dict[str, np.ndarray]) -> Any:
    """
    :param value: a value
    :param arrays: arrays by name; those of the value are added to it
    :return: the value as JSON can hold it
    :raises NotData: if it is not plain data
    """
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, np.bool_ | np.integer):
        return value.item()
    if isinstance(value, np.floating | float):
        return _encode_number(float(value))
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, spaces.Space):
        return _encode_space(value, arrays)
    if isinstance(value, np.ndarray):
        return _encode_array(value, arrays)
    return _encode_container(value, arrays)


def _encode_number(value: float) -> Any:
    return value if math.isfinite(value) else {KIND: "float", "value": repr(value)}


def _encode_array(value: np.ndarray, arrays: dict[str, np.ndarray]) -> Any:
    if value.dtype.kind not in ARRAY_KINDS:
        raise NotData(f"an array of {value.dtype}")
    name = f"value.{len(arrays)}"
    arrays[name] = value
    return {KIND: "array", "name": name}


def _encode_container(value: Any, arrays: dict[str, np.ndarray]) -> Any:
    if type(value) is list:
        return [encode(item, arrays) for item in value]
    if type(value) is tuple:
        return {KIND: "tuple", "items": [encode(item, arrays) for item in value]}
    if type(value) is deque:
        return {KIND: "deque", "items": [encode(item, arrays) for item in value], "maxlen": value.maxlen}
    if isinstance(value, dict):
        if all(isinstance(key, str) for key in value) and KIND not in value:
            return {key: encode(item, arrays) for key, item in value.items()}
        return {KIND: "dict", "items": [[encode(key, arrays), encode(item, arrays)] for key, item in value.items()]}
    raise NotData(f"a {type(value).__qualname__}")


def decode(value: Any, arrays: dict[str, np.ndarray]) -> Any:
    """
    :param value: what :func:`encode` returned
    :param arrays: the arrays by name
    :return: the value
    :raises ValueError: if it is not what :func:`encode` returns. Similar values may also raise other errors
    """
    if isinstance(value, list):
        return [decode(item, arrays) for item in value]
    if not isinstance(value, dict):
        return value
    if KIND not in value:
        return {key: decode(item, arrays) for key, item in value.items()}
    kind = value[KIND]
    if kind == "float":
        return float(value["value"])
    if kind == "array":
        return arrays[value["name"]]
    if kind == "space":
        return _decode_space(value, arrays)
    items = value["items"]
    if kind == "tuple":
        return tuple(decode(item, arrays) for item in items)
    if kind == "deque":
        return deque((decode(item, arrays) for item in items), maxlen=value["maxlen"])
    if kind == "dict":
        return {decode(key, arrays): decode(item, arrays) for key, item in items}
    raise ValueError(f"it has a value of the unknown kind {kind!r}")


def _encode_space(space: Any, arrays: dict[str, np.ndarray]) -> dict[str, Any]:
    name = type(space).__name__
    if type(space) is spaces.Discrete:
        content: dict[str, Any] = {"n": int(space.n), "start": int(space.start), "dtype": space.dtype.str}
    elif type(space) is spaces.MultiDiscrete:
        content = {"nvec": space.nvec.tolist(), "start": space.start.tolist(), "dtype": space.dtype.str}
    elif type(space) is spaces.MultiBinary:
        content = {"n": list(space.shape)}
    elif type(space) is spaces.Tuple:
        content = {"spaces": [_encode_space(each, arrays) for each in space.spaces]}
    elif type(space) is spaces.Dict:
        content = {"spaces": [[key, _encode_space(each, arrays)] for key, each in space.spaces.items()]}
    elif type(space) is spaces.Box:
        content = {
            "low": _encode_array(space.low, arrays),
            "high": _encode_array(space.high, arrays),
            "dtype": space.dtype.str,
        }
    else:
        raise NotData(f"a space of the class {name}")
    return {KIND: "space", "name": name, **content}


def _decode_space(value: dict[str, Any], arrays: dict[str, np.ndarray]) -> spaces.Space[Any]:
    name = value["name"]
    if name == "Discrete":
        return spaces.Discrete(value["n"], start=value["start"], dtype=_dtype(value["dtype"]))
    if name == "MultiDiscrete":
        sizes = np.array(value["nvec"], dtype=np.int64)
        _check_components(sizes.size)
        return spaces.MultiDiscrete(sizes, dtype=_dtype(value["dtype"]), start=np.array(value["start"], dtype=np.int64))
    if name == "MultiBinary":
        _check_components(prod(value["n"]))
        return spaces.MultiBinary(value["n"][0] if len(value["n"]) == 1 else value["n"])
    if name == "Tuple":
        return spaces.Tuple([_decode_space(each, arrays) for each in value["spaces"]])
    if name == "Dict":
        return spaces.Dict([(key, _decode_space(each, arrays)) for key, each in value["spaces"]])
    if name == "Box":
        low, high = decode(value["low"], arrays), decode(value["high"], arrays)
        return spaces.Box(low, high, shape=low.shape, dtype=_dtype(value["dtype"]).type)
    raise ValueError(f"it has a space of the unknown class {name!r}")


def _dtype(name: str) -> np.dtype[Any]:
    dtype = np.dtype(name)
    if dtype.kind not in ARRAY_KINDS:
        raise ValueError(f"it has the type {name!r}, but a type of numbers is expected")
    return dtype


def _check_components(number: int) -> None:
    if not 0 < number <= MOST_COMPONENTS:
        raise ValueError(f"it has a space of {number} components, but there may be 1 to {MOST_COMPONENTS}")


def encode_schedule(schedule: Any) -> Any:
    """
    :param schedule: a number, a name, a schedule of SB3's, or a function
    :return: the schedule as JSON can hold it; a function by its name, even if it cannot be found by that
    """
    if isinstance(schedule, FloatSchedule):
        return {KIND: "FloatSchedule", "schedule": encode_schedule(schedule.value_schedule)}
    if isinstance(schedule, MissingFunction):
        return {KIND: "function", "path": schedule.path}
    if not callable(schedule):
        return encode(schedule, {})
    name = path_of(type(schedule))
    if name in _SCHEDULES:
        arguments = {argument: _encode_number(float(getattr(schedule, argument))) for argument in _SCHEDULES[name]}
        return {KIND: "schedule", "name": name, "arguments": arguments}
    return {KIND: "function", "path": path_of(schedule)}


def decode_schedule(value: Any) -> Any:
    """
    :param value: what :func:`encode_schedule` returned
    :return: the schedule; a :class:`MissingFunction` for a function that is not imported
    :raises ValueError: if it is not what :func:`encode_schedule` returns
    """
    kind = value.get(KIND) if isinstance(value, dict) else None
    if kind == "FloatSchedule":
        return FloatSchedule(decode_schedule(value["schedule"]))
    if kind == "function":
        return find_function(value["path"]) or MissingFunction(value["path"])
    if kind == "schedule":
        known = {"ConstantSchedule": ConstantSchedule, "LinearSchedule": LinearSchedule}
        name = value["name"]
        arguments = [float(decode(value["arguments"][argument], {})) for argument in _SCHEDULES[name]]
        make = known.get(name.partition(":")[2]) or _find(name)
        return MissingFunction(name) if make is None else make(*arguments)
    return decode(value, {})


def path_of(item: Any) -> str:
    """
    :param item: a function or a class
    :return: its path, ``module:qualified name``
    """
    named = item if hasattr(item, "__qualname__") else type(item)
    return f"{named.__module__}:{named.__qualname__}"


def find_function(path: str) -> Callable[..., Any] | None:
    """
    Look up a function of the user. Functions of Python's standard library are not found, because some are dangerous.

    :param path: the function, as :func:`path_of` gives it
    :return: the function; ``None`` if its module is not imported, or has no such function
    """
    if path.partition(".")[0].partition(":")[0] in sys.stdlib_module_names:
        return None
    found = _find(path)
    is_function = callable(found) and not isinstance(found, type) and hasattr(found, "__qualname__")
    return found if is_function and path_of(found) == path else None


def find_class(path: str, base: type) -> Any:
    """
    :param path: a class, as :func:`path_of` gives it
    :param base: its base class
    :return: the class
    :raises LookupError: if no such class is imported
    """
    found = _find(path)
    if not (isinstance(found, type) and issubclass(found, base) and path_of(found) == path):
        raise LookupError(path)
    return found


def _find(path: str) -> Any:
    module_name, _, name = path.partition(":")
    found: Any = sys.modules.get(module_name)
    for part in name.split("."):
        # Only what is in `__dict__`: no attribute that a module or a class computes on demand
        found = getattr(found, "__dict__", {}).get(part)
        found = found.__func__ if isinstance(found, staticmethod) else found
    return found
