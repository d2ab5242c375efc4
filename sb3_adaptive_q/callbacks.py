"""The paper's eight ways of setting the learning rate, as SB3 callbacks over :mod:`sb3_adaptive_q.rules`."""

import inspect
from collections.abc import Callable, Iterable, Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback, CallbackList, EventCallback

from sb3_adaptive_q import rules
from sb3_adaptive_q.installed_rate import InstalledRate, check_rate
from sb3_adaptive_q.rollouts import Episodes


class LearningRateCallback(BaseCallback):
    """
    Base class of everything that sets the learning rate μ at every update.

    When training starts, the callback installs its rule in the model, which applies it inside the update: SB3 calls
    ``on_step`` before the update and before the next action is chosen, so a rule that looks at either cannot live there.
    The rule stays in force for later calls of ``learn``, and is saved with the model. ``reset_num_timesteps=True``
    starts again from ``mu_0``, ``False`` goes on.

    A rule of your own is a subclass with the attribute :attr:`rule`, a plain function
    ``rule(mu, transition, *parameters)`` of scalars that returns μ_{t+1}; see :class:`sb3_adaptive_q.rules.Transition`
    for what it may look at. It runs as the Python it is, and on a compiled environment as machine code: there it must be
    written with numbers only, without lists or arrays, in the part of Python that Numba compiles.

    :param mu_0: the step size of the first update; ``None`` asks the rule itself, with a transition of zeros
    :param next_action: which action's value in the next state the rule sees: ``"same"``, Q_t(s_{t+1}, a_t);
        ``"next"``, Q_t(s_{t+1}, a_{t+1}); ``"max"``, max_a Q_t(s_{t+1}, a)
    :param reset_each_episode: whether μ starts again from ``mu_0`` with every episode (with one environment only)
    :param parameters: the rule's further arguments, by name
    :raises ValueError: if ``mu_0`` or ``next_action`` is not one of these, or the parameters are not the rule's
    """

    rule: Callable[..., float]

    def __init__(
        self,
        mu_0: float | None = None,
        next_action: str = "next",
        reset_each_episode: bool = False,
        **parameters: float,
    ) -> None:
        super().__init__()
        self.rate = InstalledRate.of(type(self), mu_0, next_action, reset_each_episode, parameters)

    def _on_training_start(self) -> None:
        if not hasattr(self.model, "install_rate"):
            raise ValueError(
                f"{type(self).__name__} sets the learning rate of a TabularQ, but got a {type(self.model).__name__}."
            )
        self.model.install_rate(self.rate, restart=self.locals["reset_num_timesteps"])

    def _on_step(self) -> bool:
        return True


class ConstantRateCallback(LearningRateCallback):
    """
    Methods 1 and 2 (Eqs. 3 and 4): μ stays where it is.

    :param beta: the step size: β1 = 0.01 in Method 1, β2 = 0.05 in Method 2
    :raises ValueError: if it is not from 0 to 1
    """

    rule = staticmethod(rules.constant_rate)

    def __init__(self, beta: float = 0.01) -> None:
        check_rate("beta", beta)
        super().__init__(beta=beta)


class _LinearRateCallback(LearningRateCallback):
    """What Methods 3 and 4 have in common: from one end of [β1, β1 + β3] to the other."""

    def __init__(self, beta_1: float = 0.01, beta_3: float = 0.04) -> None:
        check_rate("beta_1", beta_1)
        check_rate("beta_1 + beta_3", beta_1 + beta_3)
        super().__init__(beta_1=beta_1, beta_3=beta_3)


class LinearDecayCallback(_LinearRateCallback):
    """
    Method 3 (Eq. 5): μ falls from β1 + β3 to β1 in the course of the training.

    :param beta_1: the step size at the end
    :param beta_3: what is added to it at the start
    :raises ValueError: if the first or the last step size is not from 0 to 1
    """

    rule = staticmethod(rules.linear_decay_rate)


class LinearGrowthCallback(_LinearRateCallback):
    """
    Method 4 (Eq. 6): μ grows from β1 to β1 + β3 in the course of the training.

    :param beta_1: the step size at the start
    :param beta_3: what is added to it at the end
    :raises ValueError: if the first or the last step size is not from 0 to 1
    """

    rule = staticmethod(rules.linear_growth_rate)


class ProportionalRateCallback(LearningRateCallback):
    """
    Methods 5 and 6 (Eqs. 7, 8 and 11): μ moves in proportion to the change of value along the transition.

    :param gain: what the change of value is multiplied with: -β5 = -0.05 in Method 5, +β5 in Method 6
    :param mu_0: the step size of the first update
    :param lower: β7, the least step size
    :param upper: β8, the largest step size
    :param next_action: as in :class:`LearningRateCallback`; the paper's equations do not say which, ``"same"`` is our reading
    :param reset_each_episode: as in :class:`LearningRateCallback`
    :raises ValueError: if a step size is not from 0 to 1, or ``lower`` lies above ``upper``
    """

    rule = staticmethod(rules.proportional_rate)

    def __init__(
        self,
        gain: float = -0.05,
        mu_0: float = 0.01,
        lower: float = 0.001,
        upper: float = 0.01,
        next_action: str = "same",
        reset_each_episode: bool = False,
    ) -> None:
        _check_bounds(lower, upper)
        super().__init__(mu_0, next_action, reset_each_episode, gain=gain, lower=lower, upper=upper)


class SignRateCallback(LearningRateCallback):
    """
    Methods 7 and 8 (Eqs. 9, 10 and 11): μ moves by a fixed step, up or down with the change of value along the transition.

    :param step: what μ moves by where the value does not fall: +β6 = 0.005 in Method 7, -β6 in Method 8
    :param mu_0: the step size of the first update
    :param lower: β7, the least step size
    :param upper: β8, the largest step size
    :param next_action: as in :class:`LearningRateCallback`
    :param reset_each_episode: as in :class:`LearningRateCallback`
    :raises ValueError: if a step size is not from 0 to 1, or ``lower`` lies above ``upper``
    """

    rule = staticmethod(rules.sign_rate)

    def __init__(
        self,
        step: float = 0.005,
        mu_0: float = 0.01,
        lower: float = 0.001,
        upper: float = 0.01,
        next_action: str = "next",
        reset_each_episode: bool = False,
    ) -> None:
        _check_bounds(lower, upper)
        super().__init__(mu_0, next_action, reset_each_episode, step=step, lower=lower, upper=upper)


class Method(NamedTuple):
    """
    One of the paper's methods.

    :param equation: the number of its equation in the paper
    :param formula: what it does to μ
    :param callback: makes its callback, with the paper's β unless told otherwise
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


def method(number: int, **parameters: Any) -> LearningRateCallback:
    """
    The callback of one of the paper's methods.

    :param number: 1 to 8
    :param parameters: what shall differ from the paper's values, by the names of the callback's arguments
    :return: the callback, to be handed to ``learn``
    :raises ValueError: if there is no such method, or it has no such parameter
    """
    if not _is_method_number(number):
        raise ValueError(f"There are methods 1 to 8, but got {number!r}: see `sb3_adaptive_q.METHODS`.")
    make = METHODS[number].callback
    known = _argument_names(make)
    unknown = sorted(set(parameters) - set(known))
    if unknown:
        raise ValueError(f"Method {number} has the parameters {', '.join(known)}, but got {', '.join(unknown)}.")
    return make(**parameters)


class EpisodeSeriesCallback(BaseCallback):
    """
    Keeps what every finished episode was like, as arrays with a row for each. Needs SB3's Monitor around the environment,
    as for the log, unless the environment is compiled.

    After ``learn``: ``returns``, ``lengths``, ``rates`` (μ in force at the last transition) and ``epsilons``.
    """

    def __init__(self) -> None:
        super().__init__()
        self._parts: list[Episodes] = []

    def _on_training_start(self) -> None:
        self._parts = []

    def _on_step(self) -> bool:
        episodes = self.locals["rollout"].finished_episodes()
        if len(episodes.returns):
            self._parts.append(episodes)
        return True

    def _on_training_end(self) -> None:
        empty = Episodes(np.empty(0), np.empty(0, dtype=np.int64), np.empty(0), np.empty(0))
        columns = zip(*(self._parts or [empty]), strict=True)
        self.returns, self.lengths, self.rates, self.epsilons = (np.concatenate(column) for column in columns)


def iterate_callbacks(callback: Any) -> Iterator[BaseCallback]:
    """
    :param callback: what ``learn`` takes: a callback, a list of them, a function, or None
    :return: every callback object in it, the nested ones too
    """
    children: Iterable[Any] = ()
    if isinstance(callback, list | tuple):
        children = callback
    elif isinstance(callback, CallbackList):
        children = callback.callbacks
    elif isinstance(callback, EventCallback):
        children = (callback.callback,)
    if isinstance(callback, BaseCallback):
        yield callback
    for child in children:
        yield from iterate_callbacks(child)


def check_one_method(callback: Any) -> None:
    """
    :param callback: what ``learn`` takes
    :raises ValueError: if more than one callback in it would set the learning rate
    """
    found = [type(each).__name__ for each in iterate_callbacks(callback) if isinstance(each, LearningRateCallback)]
    if len(found) > 1:
        raise ValueError(f"One learning-rate method can be in force at a time, but got {', '.join(found)}: pass one of them.")


def _is_method_number(number: Any) -> bool:
    return isinstance(number, int | np.integer) and not isinstance(number, bool) and number in METHODS


def _check_bounds(lower: float, upper: float) -> None:
    check_rate("lower", lower)
    check_rate("upper", upper)
    if lower > upper:
        raise ValueError(f"`lower` must not be above `upper`, but got lower={lower} and upper={upper}.")


def _argument_names(make: Callable[..., LearningRateCallback]) -> list[str]:
    return list(inspect.signature(make).parameters)
