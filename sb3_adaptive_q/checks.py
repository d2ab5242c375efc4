"""What every argument has to be: one table of names, types and ranges, and one form of message."""

import math
import os
import reprlib
from collections.abc import Callable
from numbers import Integral, Real
from typing import Any, NamedTuple

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

#: More steps than are ever taken, and few enough to be counted in 64 bits
MOST_STEPS = 2**62

#: Compiled code keeps a byte and more for every step between two calls of a callback
LONGEST_INTERVAL = 100_000_000

#: Seeds are handed to NumPy's global generator too, which takes 32 bits
LARGEST_SEED = 2**32 - 1

#: As many numbers as a deque can hold are as good as no limit, but a machine has no memory for them
LARGEST_WINDOW = 100_000_000

MOST_WORKERS = 1024

_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = 200

NEXT_ACTIONS = ("same", "next", "max")


class Check(NamedTuple):
    """
    What an argument has to be.

    :param expected: the words for it, as they stand after "must be"
    :param convert: a function of the value that returns it as a plain Python type, and raises a ValueError, TypeError or
        OverflowError for a value that is something else
    """

    expected: str
    convert: Callable[[Any], Any]

    def apply(self, name: str, value: Any) -> Any:
        """
        :param name: what the argument is called
        :param value: what was given
        :return: the value as a plain Python type
        :raises ValueError: if it is something else than expected
        """
        try:
            return self.convert(value)
        except (TypeError, ValueError, OverflowError) as error:
            raise ValueError(f"`{name}` must be {self.expected}, but got {_show(value)}.") from error

    def or_none(self, meaning: str = "") -> "Check":
        """
        :param meaning: what ``None`` stands for
        :return: the check that lets ``None`` pass too
        """

        def convert(value: Any) -> Any:
            return None if value is None else self.convert(value)

        return Check(f"{self.expected}, or None{f' for {meaning}' if meaning else ''}", convert)


def whole_number(least: int, most: int | None = None) -> Check:
    """
    :param least: the least number
    :param most: the largest number; ``None`` for no limit
    :return: the check for an ``int``. NumPy's integers pass, and floats without a fraction, such as 1e6
    """

    def convert(value: Any) -> int:
        number = _number(value)
        if number != int(number) or number < least or (most is not None and number > most):
            raise ValueError
        return int(number)

    return Check(f"a whole number {f'of at least {least}' if most is None else f'from {least} to {most}'}", convert)


def real_number(least: float = -math.inf, most: float = math.inf) -> Check:
    """
    :param least: the least number
    :param most: the largest number
    :return: the check for a finite ``float``
    """

    def convert(value: Any) -> float:
        number = float(_number(value))
        if not (math.isfinite(number) and least <= number <= most):
            raise ValueError
        return number

    is_limited = math.isfinite(least) and math.isfinite(most)
    return Check(f"a number from {least:g} to {most:g}" if is_limited else "a finite number", convert)


def one_of(choices: tuple[str, ...]) -> Check:
    """
    :param choices: the words to choose from
    :return: the check for one of them
    """

    def convert(value: Any) -> str:
        if not isinstance(value, str) or value not in choices:
            raise ValueError
        return str(value)

    return Check(f"one of {', '.join(choices)}", convert)


def of_type(kind: type, expected: str) -> Check:
    """
    :param kind: the type
    :param expected: the words for it
    :return: the check for that type
    """

    def convert(value: Any) -> Any:
        if not isinstance(value, kind):
            raise TypeError
        return value

    return Check(expected, convert)


def _show(value: Any) -> str:
    """The value in not too many words."""
    try:
        return _SHORT.repr(value)
    except ValueError:  # Python writes no number of more than 4300 digits
        return f"a number of the type {type(value).__name__} that is too long to be written"


def _number(value: Any) -> Any:
    """The number in a number of any library, an array without axes included."""
    if getattr(value, "shape", None) == ():
        value = value.item()
    if isinstance(value, bool) or not isinstance(value, Real):
        raise TypeError
    return int(value) if isinstance(value, Integral) else value


def _flag(value: Any) -> bool:
    if not isinstance(value, bool | np.bool_) and value not in (0, 1):
        raise ValueError
    return bool(value)


def _rate_or_schedule(value: Any) -> Any:
    return value if callable(value) else RATE.convert(value)


def _number_or_array(value: Any) -> Any:
    if np.ndim(value) == 0:
        return FINITE.convert(value)
    array = np.asarray(value)
    if array.dtype.kind not in "iuf" or not np.isfinite(array).all():
        raise ValueError
    return array.astype(np.float64)


def _verbosity(value: Any) -> int:
    return int(value) if isinstance(value, bool) else whole_number(0).convert(value)


def _callback(value: Any) -> Any:
    if isinstance(value, list):
        if not all(isinstance(one, BaseCallback) for one in value):
            raise TypeError
    elif not (isinstance(value, BaseCallback) or (callable(value) and not isinstance(value, type))):
        raise TypeError
    return value


#: A step size, a discount factor or an exploration rate
RATE = real_number(0.0, 1.0)
FINITE = real_number()
FLAG = Check("True or False", _flag)
MAPPING = of_type(dict, "a dict of arguments")

#: What each argument has to be, by its name
CHECKS: dict[str, Check] = {
    # Of the constructors
    "learning_rate": Check(
        f"{RATE.expected}, or a function of the remaining progress that gives such numbers", _rate_or_schedule
    ),
    "gamma": RATE,
    "method_kwargs": MAPPING.or_none(),
    "exploration_fraction": RATE,
    "exploration_initial_eps": RATE,
    "exploration_final_eps": RATE,
    "initial_q": Check("a finite number or an array of finite numbers", _number_or_array),
    "total_episodes": whole_number(1, MOST_STEPS).or_none("any number of episodes"),
    "callback_interval": whole_number(1, LONGEST_INTERVAL).or_none("1 000 000 transitions of all environments together"),
    "stats_window_size": whole_number(1, LARGEST_WINDOW),
    "tensorboard_log": Check("the path of a folder", os.fspath).or_none("no log of TensorBoard"),
    "policy_kwargs": MAPPING.or_none(),
    "verbose": Check(whole_number(0).expected, _verbosity),
    "seed": whole_number(0, LARGEST_SEED).or_none("a new one every time"),
    # Of `learn` and `learn_many`
    "total_timesteps": whole_number(0, MOST_STEPS),
    "callback": Check("a callback, a list of callbacks, or a function of two arguments", _callback).or_none(),
    "log_interval": whole_number(1).or_none("no log"),
    "tb_log_name": of_type(str, "the name of a run"),
    "reset_num_timesteps": FLAG,
    "progress_bar": FLAG,
    "workers": whole_number(1, MOST_WORKERS).or_none("the number of cores"),
    # Of methods
    "mu": RATE,
    "mu_0": RATE,
    "lower": RATE,
    "upper": RATE,
    "gain": FINITE,
    "step": FINITE,
    "next_action": one_of(NEXT_ACTIONS),
    "reset_each_episode": FLAG,
}


def check(name: str, value: Any) -> Any:
    """
    Check an argument where it enters.

    :param name: its name, one of :data:`CHECKS`
    :param value: what was given
    :return: the value as a plain Python type, such as ``int`` in place of ``np.int64``
    :raises ValueError: if it is not what the table says
    """
    return CHECKS[name].apply(name, value)
