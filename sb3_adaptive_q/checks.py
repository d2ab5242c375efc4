"""The types and ranges of all arguments, in one table, and one form of message for them."""

import math
import os
import reprlib
from collections.abc import Callable, Collection, Mapping
from numbers import Integral, Real
from typing import Any, NamedTuple

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

from sb3_adaptive_q.algorithms.td_update import NEXT_ACTIONS
from sb3_adaptive_q.behaviour import EXPLORATIONS, SCHEDULES, TIES
from sb3_adaptive_q.step_sizes.cells import SCOPES

#: The largest number of steps. No training takes as many, and 64 bits can count them
MOST_STEPS = 2**62

#: Compiled code needs more than a byte of memory for every step between two calls of a callback
LONGEST_INTERVAL = 100_000_000

#: Seeds are also passed to NumPy's global generator, which takes 32 bits
LARGEST_SEED = 2**32 - 1

#: The largest window of episodes. A machine would not have the memory for a larger one
LARGEST_WINDOW = 100_000_000

MOST_WORKERS = 1024

#: The largest number of runs of one experiment. A list of more would take longer than most experiments
MOST_RUNS = 1_000_000

_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = 200


class Check(NamedTuple):
    """
    The type and the range of an argument.

    :param expected: a description, which follows the words "must be" in messages
    :param convert: a function that returns a valid value as a plain Python type, and raises a ValueError, TypeError or
        OverflowError for any other
    """

    expected: str
    convert: Callable[[Any], Any]

    def apply(self, name: str, value: Any) -> Any:
        """
        :param name: the name of the argument
        :param value: the value that was given
        :return: the value as a plain Python type
        :raises ValueError: if it is not what is expected
        """
        try:
            return self.convert(value)
        except (TypeError, ValueError, OverflowError) as error:
            raise ValueError(f"`{name}` must be {self.expected}, but got {_show(value)}.") from error

    def or_none(self, meaning: str = "") -> "Check":
        """
        :param meaning: the meaning of ``None``
        :return: a check that also accepts ``None``
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


def real_number(least: float = -math.inf, most: float = math.inf, above: float = -math.inf) -> Check:
    """
    :param least: the least number
    :param most: the largest number
    :param above: a number that it must be larger than
    :return: the check for a finite ``float``
    """

    def convert(value: Any) -> float:
        number = float(_number(value))
        if not (math.isfinite(number) and least <= number <= most and number > above):
            raise ValueError
        return number

    if math.isfinite(most):
        return Check(f"a number from {least:g} to {most:g}", convert)
    return Check(f"a finite number of at least {least:g}" if math.isfinite(least) else "a finite number", convert)


def one_of(choices: Collection[str]) -> Check:
    """
    :param choices: the words to choose from
    :return: the check for one of them
    """

    def convert(value: Any) -> str:
        if not isinstance(value, str) or value not in choices:
            raise ValueError
        return str(value)

    return Check(f"one of {', '.join(choices)}", convert)


def of_type(kind: type | tuple[type, ...], expected: str) -> Check:
    """
    :param kind: the type
    :param expected: its description in messages
    :return: the check for that type
    """

    def convert(value: Any) -> Any:
        if not isinstance(value, kind):
            raise TypeError
        return value

    return Check(expected, convert)


def _show(value: Any) -> str:
    """The value as a short text."""
    try:
        return _SHORT.repr(value)
    except ValueError:  # Python writes no number of more than 4300 digits
        return f"a number of the type {type(value).__name__} that is too long to be written"


def _number(value: Any) -> Any:
    """A number of any library, or an array without axes, as a plain number."""
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


def _schedule_of_exploration(value: Any) -> Any:
    return value if callable(value) else one_of(SCHEDULES).convert(value)


def _numbers_by_name(value: Any) -> dict[str, float]:
    if not isinstance(value, Mapping) or not all(isinstance(name, str) for name in value):
        raise TypeError
    return {name: FINITE.convert(number) for name, number in value.items()}


def _steps(value: Any) -> int:
    return min(whole_number(0).convert(value), MOST_STEPS)  # a larger number makes no difference


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
NOT_NEGATIVE = real_number(0.0)
RATE_ABOVE_0 = Check(
    "a number above 0 and up to 1, for an exploration rate that falls exponentially",
    real_number(0.0, 1.0, above=0.0).convert,
)
TEMPERATURE = Check("a finite number above 0, the temperature of Boltzmann exploration", real_number(above=0.0).convert)
FLAG = Check("True or False", _flag)
MAPPING = of_type(Mapping, "a dict of arguments")

#: Arguments of the constructors
CONSTRUCTOR: dict[str, Check] = {
    "learning_rate": Check(
        f"{RATE.expected}, or a function of the remaining progress that gives such numbers", _rate_or_schedule
    ),
    "gamma": RATE,
    "method_kwargs": MAPPING.or_none(),
    "exploration": one_of(EXPLORATIONS),
    "ties": one_of(TIES),
    "exploration_schedule": Check(f"{one_of(SCHEDULES).expected}, or a function of the progress", _schedule_of_exploration),
    "exploration_fraction": RATE,
    "exploration_initial_eps": RATE,
    "exploration_final_eps": RATE,
    "initial_q": Check("a finite number or an array of finite numbers", _number_or_array),
    "use_masking": FLAG,
    "total_episodes": whole_number(1, MOST_STEPS).or_none("any number of episodes"),
    "callback_interval": whole_number(1, LONGEST_INTERVAL).or_none("1 000 000 transitions of all environments together"),
    "stats_window_size": whole_number(1, LARGEST_WINDOW),
    "tensorboard_log": Check("the path of a folder", os.fspath).or_none("no log of TensorBoard"),
    "policy_kwargs": MAPPING.or_none(),
    "verbose": Check(whole_number(0).expected, _verbosity),
    "seed": whole_number(0, LARGEST_SEED).or_none("a new one every time"),
}

#: Arguments whose attribute of the model has another name
ATTRIBUTES = {"stats_window_size": "_stats_window_size"}

#: Arguments of ``learn`` and ``learn_many``
LEARN: dict[str, Check] = {
    "total_timesteps": Check(whole_number(0).expected, _steps),
    "callback": Check("a callback, a list of callbacks, or a function of two arguments", _callback).or_none(),
    "log_interval": whole_number(1).or_none("no log"),
    "tb_log_name": of_type(str, "the name of a run").or_none("the names of algorithm and method"),
    "reset_num_timesteps": FLAG,
    "progress_bar": FLAG,
    "workers": whole_number(1, MOST_WORKERS).or_none("the number of cores"),
}

#: Arguments of ``load`` and ``resume``
LOAD: dict[str, Check] = {
    "custom_objects": MAPPING.or_none(),
    "print_system_info": FLAG,
    "force_reset": FLAG,
    "allow_pickle": FLAG,
}

#: Arguments of methods. Those of the literature's step sizes are in :data:`sb3_adaptive_q.STEP_SIZES`
METHOD: dict[str, Check] = {
    "mu": RATE,
    "mu_0": RATE.or_none("what the functions give"),
    "lower": RATE,
    "upper": RATE,
    "beta": RATE,
    "beta_1": RATE,
    "beta_3": FINITE,
    "gain": FINITE,
    "step": FINITE,
    "next_action": one_of(NEXT_ACTIONS),
    "reset_each_episode": FLAG,
    "scope": one_of(SCOPES),
    "memory": Check("a dict of finite numbers by name", _numbers_by_name).or_none("the class's own"),
}

#: Settings of experiments, the paper's included
STUDY: dict[str, Check] = {
    "runs": whole_number(1, MOST_RUNS),
    "seed": whole_number(0),
    "steps": whole_number(1, MOST_STEPS).or_none("as many as the episodes take"),
    "episodes": whole_number(1, MOST_STEPS),
    **{name: RATE for name in ("gamma", "exploration_fraction", "exploration_initial_eps", "exploration_final_eps")},
    **{f"beta_{number}": NOT_NEGATIVE for number in (1, 2, 3, 5, 6, 7, 8)},
    "next_action": one_of(NEXT_ACTIONS).or_none("the preset's"),
}

#: How an experiment is carried out
EXECUTION: dict[str, Check] = {"workers": LEARN["workers"], "progress": FLAG}

#: Settings of the league. Its statistics need at least two of each
LEAGUE: dict[str, Check] = {
    "runs": whole_number(2, MOST_RUNS),
    "tuning_runs": whole_number(2, MOST_RUNS),
    "steps": whole_number(2, MOST_STEPS),
    "resamples": whole_number(2, 1_000_000),
    "gamma": RATE,
    "quick": FLAG,
}

#: The checks of all arguments of a model, its training and its method, by name
CHECKS: dict[str, Check] = {**CONSTRUCTOR, **LEARN, **LOAD, **METHOD}


def check(name: str, value: Any) -> Any:
    """
    Check an argument.

    :param name: its name, one of :data:`CHECKS`
    :param value: the value that was given
    :return: the value as a plain Python type, such as ``int`` instead of ``np.int64``
    :raises ValueError: if it is not what :data:`CHECKS` expects
    """
    return CHECKS[name].apply(name, value)


def check_range(name: str, values: np.ndarray, stop: int) -> None:
    """
    Check an array that was read from a file.

    :param name: the name of the array
    :param values: whole numbers
    :param stop: the first number that is too large
    :raises ValueError: if a number is negative, or not below ``stop``
    """
    if ((values < 0) | (values >= stop)).any():
        raise ValueError(f"`{name}` must hold numbers from 0 to {stop - 1}, but has others.")
