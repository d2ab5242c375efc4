"""Methods that set the step size, as SB3 callbacks, and a callback that records every episode."""

import inspect
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from typing import Any, ClassVar, NamedTuple

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback, CallbackList, ConvertCallback, EventCallback

from sb3_adaptive_q.checks import RATE, check
from sb3_adaptive_q.installed_method import InstalledMethod, MethodData
from sb3_adaptive_q.step_sizes import find_step_size, paper, resolve_parameters


class LearningRateCallback(BaseCallback):
    """
    Base class of everything that sets the step size μ at every update.

    When training starts, the callback installs its functions in the model, which calls them inside the update. (SB3 calls
    ``on_step`` before the update, too early for a rule that depends on the update.) The method remains active in later calls
    of ``learn``, and is saved with the model. ``reset_num_timesteps=True`` starts it anew, ``False`` continues it.

    A method of your own is a subclass with one of these plain functions, or both, as static methods:

    - ``step_size(mu, step, *parameters, *arrays)`` returns the step size of *this* update, before the table is written. It may
      change its arrays in place, at ``[step.row, step.column]``.
    - ``rule(mu, step, *parameters)`` returns the scalar step size that the *next* update starts from.

    ``step`` is a :class:`sb3_adaptive_q.step_sizes.Step`, which lists what they may use. Both are compiled with Numba: write
    them with numbers only. A function that Numba does not compile runs as Python on an ordinary environment, after a warning.

    :param mu_0: the scalar step size of the first update; ``None`` takes what the functions give for a
        :class:`Step` whose numbers are all 0
    :param next_action: which action's value in the next state a rule sees: ``"same"``, Q_t(s_{t+1}, a_t);
        ``"next"``, Q_t(s_{t+1}, a_{t+1}); ``"max"``, max_a Q_t(s_{t+1}, a)
    :param reset_each_episode: whether μ starts again from ``mu_0`` with every episode (with one environment only)
    :param scope: how many cells the arrays have: ``"pair"`` one for each state and action, ``"state"`` one for each state,
        ``"shared"`` a single one
    :param memory: the number that every cell of an array starts from, by the array's name; ``None`` for the class's own
    :param parameters: the functions' further arguments, by name
    :raises ValueError: if an argument is out of range, or the parameters do not match the functions' arguments
    """

    step_size: ClassVar[Callable[..., float] | None] = None
    rule: ClassVar[Callable[..., float] | None] = None
    #: The arrays of ``step_size``: the number that every cell starts from, by name, in the order of its arguments
    memory: ClassVar[Mapping[str, float]] = {}
    #: Whether the functions use ``step.count``, the number of updates of a cell
    counts: ClassVar[bool] = False
    #: The bounds to which both functions' step sizes are clipped. Without them, a step size outside [0, 1] is an error
    lower: ClassVar[float | None] = None
    upper: ClassVar[float | None] = None
    #: Whether a call at the end of each rollout, as on the compiled path, is enough for this callback
    knows_rollouts: ClassVar[bool] = True

    def __init__(
        self,
        mu_0: float | None = None,
        next_action: str = "next",
        reset_each_episode: bool = False,
        scope: str = "pair",
        memory: Mapping[str, float] | None = None,
        **parameters: float,
    ) -> None:
        super().__init__()
        kind = type(self)
        if not callable(kind.step_size) and not callable(kind.rule):
            raise ValueError(
                f"{kind.__qualname__} needs the class attribute `step_size`, a function `step_size(mu, step, *parameters, "
                "*arrays)`, or `rule`, a function `rule(mu, step, *parameters)`."
            )
        data = MethodData(
            owner=f"{kind.__module__}:{kind.__qualname__}",
            label=kind.__name__,
            parameters=dict(parameters),
            memory=check("memory", kind.memory if memory is None else memory),
            counts=kind.counts,
            scope=scope,
            mu_0=mu_0,
            next_action=next_action,
            reset_each_episode=reset_each_episode,
        )
        if kind.lower is not None and kind.upper is not None:
            if not kind.lower <= kind.upper:
                raise ValueError(f"`lower` must not be above `upper`, but got lower={kind.lower} and upper={kind.upper}.")
            data = data._replace(bounds=(kind.lower, kind.upper))
        elif kind.lower is not None or kind.upper is not None:
            raise ValueError(
                f"{kind.__qualname__} has the class attributes lower={kind.lower} and upper={kind.upper}: please set both, or "
                "neither."
            )
        self._install(InstalledMethod(data, (kind.step_size, kind.rule)))

    def _install(self, method: InstalledMethod) -> None:
        self.method = method
        method.start()  # raises an error if the functions give no step size

    def _on_training_start(self) -> None:
        if not hasattr(self.model, "install_method"):
            raise ValueError(
                f"{type(self).__name__} sets the step size of a tabular algorithm, but got a {type(self.model).__name__}."
            )
        self.model.install_method(self.method, restart=self.locals["reset_num_timesteps"])

    def _on_step(self) -> bool:
        return True


class StepSizeCallback(LearningRateCallback):
    """
    A step size of the literature.

    :param name: a name in :data:`sb3_adaptive_q.STEP_SIZES`
    :param scope: as in :class:`LearningRateCallback`
    :param lower: the least step size. If the step size has a parameter of that name, this sets the parameter
    :param upper: the largest step size, likewise
    :param parameters: values of its parameters that differ from the defaults
    :raises ValueError: if there is no such step size, it has no such parameter, or a value is out of range
    """

    def __init__(
        self, name: str, scope: str = "pair", lower: float | None = None, upper: float | None = None, **parameters: float
    ) -> None:
        BaseCallback.__init__(self)
        each = find_step_size(name)
        given = {"lower": lower, "upper": upper}
        own = {key: value for key, value in given.items() if key in each.parameters and value is not None}
        bounds = {key: value for key, value in given.items() if key not in each.parameters and value is not None}
        limits = _check_bounds(bounds.get("lower", each.lower), bounds.get("upper", each.upper))
        values = resolve_parameters(name, {**parameters, **own})
        data = MethodData(name, name, values, each.start_values(values), each.counts, scope, limits)
        self._install(InstalledMethod(data, (each.step_size, None)))


class ConstantRateCallback(LearningRateCallback):
    """
    Methods 1 and 2 (Eqs. 3 and 4): μ is constant.

    :param beta: the step size: β1 = 0.01 in Method 1, β2 = 0.05 in Method 2
    :raises ValueError: if it is not from 0 to 1
    """

    rule = staticmethod(paper.constant_rate)

    def __init__(self, beta: float = 0.01) -> None:
        beta = check("beta", beta)
        super().__init__(beta=beta)


class _LinearRateCallback(LearningRateCallback):
    """The base class of Methods 3 and 4: μ goes linearly from one end of [β1, β1 + β3] to the other."""

    def __init__(self, beta_1: float = 0.01, beta_3: float = 0.04) -> None:
        beta_1, beta_3 = check("beta_1", beta_1), check("beta_3", beta_3)
        RATE.apply("beta_1 + beta_3", beta_1 + beta_3)
        super().__init__(beta_1=beta_1, beta_3=beta_3)


class LinearDecayCallback(_LinearRateCallback):
    """
    Method 3 (Eq. 5): μ falls from β1 + β3 to β1 in the course of the training.

    :param beta_1: the step size at the end
    :param beta_3: what is added to it at the start
    :raises ValueError: if the first or the last step size is not from 0 to 1
    """

    rule = staticmethod(paper.linear_decay_rate)


class LinearGrowthCallback(_LinearRateCallback):
    """
    Method 4 (Eq. 6): μ grows from β1 to β1 + β3 in the course of the training.

    :param beta_1: the step size at the start
    :param beta_3: what is added to it at the end
    :raises ValueError: if the first or the last step size is not from 0 to 1
    """

    rule = staticmethod(paper.linear_growth_rate)


class ProportionalRateCallback(LearningRateCallback):
    """
    Methods 5 and 6 (Eqs. 7, 8 and 11): μ moves in proportion to the change of value along the transition.

    :param gain: the factor of the change of value: -β5 = -0.05 in Method 5, +β5 in Method 6
    :param mu_0: the step size of the first update
    :param lower: β7, the least step size
    :param upper: β8, the largest step size
    :param next_action: as in :class:`LearningRateCallback`; the paper's equations do not say
        which, and ``"same"`` is our reading
    :param reset_each_episode: as in :class:`LearningRateCallback`
    :raises ValueError: if a step size is not from 0 to 1, or ``lower`` lies above ``upper``
    """

    rule = staticmethod(paper.proportional_rate)

    def __init__(
        self,
        gain: float = -0.05,
        mu_0: float = 0.01,
        lower: float = 0.001,
        upper: float = 0.01,
        next_action: str = "same",
        reset_each_episode: bool = False,
    ) -> None:
        lower, upper = _check_bounds(lower, upper)
        super().__init__(mu_0, next_action, reset_each_episode, gain=check("gain", gain), lower=lower, upper=upper)


class SignRateCallback(LearningRateCallback):
    """
    Methods 7 and 8 (Eqs. 9, 10 and 11): μ moves by a fixed step, up or down with the change of value along the transition.

    :param step: the change of μ if the value does not fall: +β6 = 0.005 in Method 7, -β6 in Method 8. If the value falls, μ
        changes by the negative of it
    :param mu_0: the step size of the first update
    :param lower: β7, the least step size
    :param upper: β8, the largest step size
    :param next_action: as in :class:`LearningRateCallback`
    :param reset_each_episode: as in :class:`LearningRateCallback`
    :raises ValueError: if a step size is not from 0 to 1, or ``lower`` lies above ``upper``
    """

    rule = staticmethod(paper.sign_rate)

    def __init__(
        self,
        step: float = 0.005,
        mu_0: float = 0.01,
        lower: float = 0.001,
        upper: float = 0.01,
        next_action: str = "next",
        reset_each_episode: bool = False,
    ) -> None:
        lower, upper = _check_bounds(lower, upper)
        super().__init__(mu_0, next_action, reset_each_episode, change=check("step", step), lower=lower, upper=upper)


class Method(NamedTuple):
    """
    One of the paper's methods.

    :param equation: the number of its equation in the paper
    :param formula: what it does to μ
    :param callback: a function that makes its callback, by default with the paper's β
    """

    equation: str
    formula: str
    callback: Callable[..., LearningRateCallback]


#: The paper's methods by number
METHODS = {
    1: Method("3", "μ = β1", partial(ConstantRateCallback, beta=0.01)),
    2: Method("4", "μ = β2", partial(ConstantRateCallback, beta=0.05)),
    3: Method("5", "μ = β1 + β3 (1 - t/t_max)", LinearDecayCallback),
    4: Method("6", "μ = β1 + β3 t/t_max", LinearGrowthCallback),
    5: Method("7, 11", "μ ← clip(μ - β5 (Q(s', a) - Q(s, a)))", partial(ProportionalRateCallback, gain=-0.05)),
    6: Method("8, 11", "μ ← clip(μ + β5 (Q(s', a) - Q(s, a)))", partial(ProportionalRateCallback, gain=0.05)),
    7: Method("9, 11", "μ ← clip(μ + β6) if Q(s', a') ≥ Q(s, a) else clip(μ - β6)", partial(SignRateCallback, step=0.005)),
    8: Method("10, 11", "μ ← clip(μ - β6) if Q(s', a') ≥ Q(s, a) else clip(μ + β6)", partial(SignRateCallback, step=-0.005)),
}


def method(number: int | str, **parameters: Any) -> LearningRateCallback:
    """
    The callback of a method: one of the paper's, or a step size of the literature.

    :param number: 1 to 8 for the paper's, see :data:`METHODS`; a name for the literature's, see :data:`STEP_SIZES`
    :param parameters: arguments of the callback that differ from the defaults
    :return: the callback to pass to ``learn``
    :raises ValueError: if there is no such method, or it has no such parameter
    """
    if isinstance(number, str) and number.isdecimal():
        number = int(number)
    if isinstance(number, str):
        return StepSizeCallback(number, **parameters)
    if not _is_method_number(number):
        raise ValueError(
            f"A method is a number from 1 to 8 or the name of a step size, but got {number!r}: see `sb3_adaptive_q.METHODS` "
            "and `sb3_adaptive_q.STEP_SIZES`."
        )
    make = METHODS[number].callback
    known = list(inspect.signature(make).parameters)
    unknown = sorted(set(parameters) - set(known))
    if unknown:
        raise ValueError(f"Method {number} has the parameters {', '.join(known)}, but got {', '.join(unknown)}.")
    callback = make(**parameters)
    callback.method.data = callback.method.data._replace(label=f"method{number}")
    return callback


class Episodes(NamedTuple):
    """
    Finished episodes, one row each.

    :param returns: sums of rewards, rounded to six decimals as SB3's Monitor does
    :param lengths: steps
    :param rates: μ in force at the last transition
    :param epsilons: the exploration rate in force at the last transition
    """

    returns: np.ndarray
    lengths: np.ndarray
    rates: np.ndarray
    epsilons: np.ndarray


class EpisodeSeriesCallback(BaseCallback):
    """
    Records every episode that ends during a call of ``learn``, in arrays with one entry for each: ``returns``, ``lengths``,
    ``rates`` (μ in force at the last transition) and ``epsilons``. They can be read at any time, also after an interrupt. The
    next call of ``learn`` with the same callback empties them.
    """

    knows_rollouts: ClassVar[bool] = True

    def __init__(self) -> None:
        super().__init__()
        self._parts: list[Episodes] = []

    def _init_callback(self) -> None:
        if not hasattr(self.model, "episode_series"):
            raise ValueError(
                f"{type(self).__name__} records the episodes of a tabular algorithm, but got a {type(self.model).__name__}."
            )
        self._parts = []
        if self not in self.model.episode_series:  # a list of callbacks may have it twice
            self.model.episode_series.append(self)

    def __getstate__(self) -> dict[str, Any]:
        # Without what belongs to the training, most of which cannot be copied
        return {**vars(self), "model": None, "parent": None, "locals": {}, "globals": {}}

    def add(self, episodes: Episodes) -> None:
        """
        :param episodes: episodes that have ended
        """
        self._parts.append(episodes)

    def _on_step(self) -> bool:
        return True

    def _column(self, place: int, kind: type) -> np.ndarray:
        return np.concatenate([part[place] for part in self._parts] or [np.empty(0, kind)])

    @property
    def returns(self) -> np.ndarray:
        """The sum of rewards of every episode, of shape (n_episodes,)."""
        return self._column(0, np.float64)

    @property
    def lengths(self) -> np.ndarray:
        """The steps of every episode, of shape (n_episodes,)."""
        return self._column(1, np.int64)

    @property
    def rates(self) -> np.ndarray:
        """μ in force at every episode's last transition, of shape (n_episodes,)."""
        return self._column(2, np.float64)

    @property
    def epsilons(self) -> np.ndarray:
        """The exploration rate in force at every episode's last transition, of shape (n_episodes,)."""
        return self._column(3, np.float64)


def iterate_callbacks(callback: Any) -> Iterator[BaseCallback]:
    """
    :param callback: what ``learn`` takes: a callback, a list of them, a function, or None
    :return: every callback object in it, also the nested ones
    """
    children: Iterable[Any] = ()
    if isinstance(callback, list | tuple):
        children = callback
    elif isinstance(callback, CallbackList):
        children = callback.callbacks
    elif isinstance(callback, EventCallback):
        children = (
            callback.callback,
            getattr(callback, "callback_on_new_best", None),
            getattr(callback, "callback_after_eval", None),
        )
    if isinstance(callback, BaseCallback):
        yield callback
    for child in children:
        yield from iterate_callbacks(child)


def check_callback(callback: Any) -> None:
    """
    :param callback: what ``learn`` takes
    :raises ValueError: if it is not a callback, or more than one callback in it sets the step size
    """
    check("callback", callback)
    found = [type(each).__name__ for each in iterate_callbacks(callback) if isinstance(each, LearningRateCallback)]
    if len(found) > 1:
        raise ValueError(f"One learning-rate method can be in force at a time, but got {', '.join(found)}: pass one of them.")


#: The callback of RL Zoo that looks at every step; the others act at some steps only
NEEDS_EVERY_STEP = "RawStatisticsCallback"


def warn_of_rare_calls(model: Any, callback: BaseCallback) -> None:
    """
    Warn of every callback of the user that is called once for many steps and does not declare that it expects that.

    :param model: a model on a compiled environment
    :param callback: the callback that is called after every rollout
    """
    if model.callback_interval is not None:
        return
    own = [type(each).__name__ for each in iterate_callbacks(callback) if not _knows_rollouts(each)]
    if own:
        warnings.warn(
            f"On a compiled environment {', '.join(own)} is called once for a block of many steps, and sees only the last of "
            "them. If it needs every step, give the model `callback_interval=1`. EpisodeSeriesCallback records every episode. "
            "To switch this warning off, set the class attribute `knows_rollouts = True`, or choose a `callback_interval`.",
            stacklevel=4,
        )


def _knows_rollouts(callback: BaseCallback) -> bool:
    called: Any = type(callback)
    if isinstance(callback, ConvertCallback) and callback.callback is not None:
        called = callback.callback  # the library wraps functions of its own as well, such as that of LogEveryNTimesteps
    module = getattr(called, "__module__", None) or ""
    library = module.partition(".")[0] in ("stable_baselines3", "sb3_contrib", "rl_zoo3")
    return (library and called.__name__ != NEEDS_EVERY_STEP) or getattr(callback, "knows_rollouts", False)


def _is_method_number(number: Any) -> bool:
    return isinstance(number, int | np.integer) and not isinstance(number, bool) and number in METHODS


def _check_bounds(lower: float, upper: float) -> tuple[float, float]:
    lower, upper = check("lower", lower), check("upper", upper)
    if lower > upper:
        raise ValueError(f"`lower` must not be above `upper`, but got lower={lower} and upper={upper}.")
    return lower, upper
