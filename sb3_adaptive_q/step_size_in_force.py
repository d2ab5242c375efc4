"""The part of a tabular algorithm that checks its arguments, and sets its step size and its exploration rate."""

import warnings
from typing import Any

import numpy as np
from stable_baselines3.common.utils import ConstantSchedule, FloatSchedule, LinearSchedule

from sb3_adaptive_q.algorithms.declaration import AlgorithmDeclaration
from sb3_adaptive_q.algorithms.td_update import NEXT_ACTIONS
from sb3_adaptive_q.callbacks import method as make_method
from sb3_adaptive_q.compiled.jit import as_python
from sb3_adaptive_q.checks import ATTRIBUTES, RATE, RATE_ABOVE_0, TEMPERATURE, Check, check
from sb3_adaptive_q.installed_method import NO_BOUNDS, InstalledMethod, MethodData, is_own
from sb3_adaptive_q.policies import MEMORY, TabularQPolicy
from sb3_adaptive_q.rollouts.functions import Choices, make_explore
from sb3_adaptive_q.saved_values import SIMPLE_LINEAR, path_of
from sb3_adaptive_q.step_sizes.cells import keep_mu, scalar_size, scope_shape
from sb3_adaptive_q.training_state import TrainingState, field_of_state


class StepSizeInForce(AlgorithmDeclaration):
    """Mixin of :class:`sb3_adaptive_q.TabularAlgorithm`: its method, its μ and its exploration rate."""

    training: TrainingState
    policy: Any
    choices: Choices
    learning_rate: Any
    lr_schedule: Any
    method: int | str | None
    method_kwargs: dict[str, Any] | None
    policy_kwargs: dict[str, Any]
    _method: InstalledMethod | None
    _missing_method: MethodData | None
    _known_learning_rate: Any
    _known_method: dict[str, Any]

    _exploration_rate = field_of_state("epsilon", "The exploration rate in force.")
    _mu = field_of_state("mu", "The scalar step size in force.")

    @property
    def mu(self) -> float:
        """
        The step size of the next update, from 0 to 1. You may assign to it, also in a callback: a method continues from the
        new value; without a method, the value stays until ``learn`` ends. If the method has a step size for each entry, this
        is the one used last, and an assignment raises a ValueError.
        """
        return self._mu

    @mu.setter
    def mu(self, value: float) -> None:
        value = check("mu", value)
        if self._method is not None and self._method.has_memory:
            raise ValueError(
                f"{self._method.data.label} has a step size for each entry, so `mu` cannot be set: change its arrays, "
                "`model.memory`, or install another method."
            )
        self.training.record["mu"] = value
        if self._method is None:
            self.training.record["holds_mu"] = 1

    @property
    def exploration_rate(self) -> float:
        """
        The exploration rate ε in force; with Boltzmann exploration, the temperature. A callback may assign to it; the value
        then stays until ``learn`` ends.
        """
        return self._exploration_rate

    @exploration_rate.setter
    def exploration_rate(self, value: float) -> None:
        self.training.record["epsilon"] = self._rate_check().apply("exploration_rate", value)
        self.training.record["holds_epsilon"] = 1

    @property
    def memory(self) -> dict[str, np.ndarray]:
        """
        The live arrays of the step size by name; ``"visits"`` are its counts. With the scope ``"pair"`` they have the
        shape (n_states, n_actions), with ``"state"`` (n_states, 1), and with ``"shared"`` (1, 1). If the algorithm has
        several tables, these are the leading axis.
        """
        arrays = {name: getattr(self.policy, MEMORY + name).numpy() for name in self.policy.memory_names()}
        return {name: array[0] if self.n_tables == 1 else array for name, array in arrays.items()}

    def install_method(self, method: InstalledMethod, restart: bool) -> None:
        """
        Make a method the one in force. Its callback calls this when training starts.

        :param method: the method
        :param restart: whether μ and the memory start anew even if the same method is in force already
        :raises ValueError: if the method resets μ with every episode and there are several environments
        """
        in_force = self._missing_method if self._method is None else self._method.data
        starts = restart or method.data != in_force
        self._use_method(method)
        self._missing_method = None
        if starts:
            self._declare_memory(method)
            self.training.record["mu"] = method.start()
        self._choose_functions()

    def _use_method(self, method: InstalledMethod | None) -> None:
        n_envs = getattr(self, "n_envs", 1)
        if method is not None and method.data.reset_each_episode and n_envs > 1:
            raise ValueError(
                f"`reset_each_episode` needs a single environment, but got {n_envs}: they share one μ, and their "
                "episodes begin at different times."
            )
        self._method = method
        record, data = self.training.record, method.data if method is not None else None
        record["next_action"] = NEXT_ACTIONS[data.next_action] if data else NEXT_ACTIONS["same"]
        record["resets_mu"] = data.reset_each_episode if data else False
        record["mu_0"] = method.start() if method is not None else 0.0

    def _declare_memory(self, method: InstalledMethod) -> None:
        """Make new arrays for the step size."""
        policy: TabularQPolicy = self.policy
        shape = (self.n_tables, *scope_shape(method.data.scope, policy.n_states, policy.n_actions))
        policy.forget_memory()
        for name, start in method.array_starts.items():
            policy.declare({MEMORY + name: shape}, start)

    def _step_size_memory(self) -> tuple[Any, ...]:
        """Arrays, parameters and bounds of the step size, as machine code takes them."""
        method = self._method
        if method is None:
            return (), self._schedule_parameters, NO_BOUNDS
        shape = (self.n_tables, *scope_shape(method.data.scope, self.policy.n_states, self.policy.n_actions))
        arrays = tuple(self.policy.array(MEMORY + name, shape) for name in method.array_starts)
        return arrays, method.arguments, tuple(map(float, method.data.bounds))

    def _choose_functions(self) -> None:
        """Choose the functions of the learning loop by the model's current attributes."""
        self._schedule_parameters: tuple[float, ...] = ()
        size, rule = scalar_size, keep_mu
        if self._method is not None:
            size, rule = self._method.size_function, self._method.rule_function
        else:
            rule = self._schedule_rule()
        model: Any = self
        self.choices = Choices(
            model.update_function(), size, rule, (model.exploration, model.ties), model.exploration_schedule,
            model.use_masking, model.policy.n_actions, model.chooses_before_update,
        )  # fmt: skip

    def _schedule_rule(self) -> Any:
        """The rule of a learning rate without a method: a constant, a line, or a function of the remaining progress."""
        schedule = self.lr_schedule
        while isinstance(schedule, FloatSchedule):
            schedule = schedule.value_schedule
        if isinstance(schedule, ConstantSchedule):
            return keep_mu
        if isinstance(schedule, LinearSchedule):
            self._schedule_parameters = (float(schedule.start), float(schedule.end), float(schedule.end_fraction))
            return _linear_schedule
        if path_of(type(schedule)) == SIMPLE_LINEAR:
            self._schedule_parameters = (float(schedule.initial_value),)
            return _simple_linear_schedule

        def scheduled(mu, step):  # type: ignore[no-untyped-def]
            return float(schedule(1.0 - step.progress))

        return scheduled

    @property
    def is_learning_rate_new(self) -> bool:
        """Whether the user has assigned a learning rate since the last training began."""
        return bool(self.learning_rate != self._known_learning_rate)

    def _start_step_size(self, restart: bool) -> None:
        """Set the first μ of a training. This comes before the callbacks, so that one may set another μ."""
        record = self.training.record
        record["holds_mu"] = record["holds_epsilon"] = 0
        if self._own_method() != self._known_method:  # the user has assigned another one since the last training
            self._install_own_method()
        if self.is_learning_rate_new:
            self._setup_lr_schedule()  # type: ignore[attr-defined]
            self._known_learning_rate = self.learning_rate
            if self._method is not None:
                warnings.warn(
                    f"`learning_rate` is ignored, because the method {self._method.data.label} is in force: set `method` or "
                    "pass another method to `learn`.",
                    stacklevel=4,
                )
        record["progress"] = progress = self._progress_made()
        if self._method is not None:
            if restart:
                self._declare_memory(self._method)
                record["mu"] = self._method.start()
        elif restart or self._missing_method is None:
            self.mu = float(self.lr_schedule(1.0 - progress))
            record["holds_mu"] = 0
        self._choose_functions()

    def _start_exploration(self) -> None:
        record = self.training.record
        for name, value in (
            ("gamma", self.gamma),  # type: ignore[attr-defined]
            ("exploration_initial", self.exploration_initial_eps),  # type: ignore[attr-defined]
            ("exploration_final", self.exploration_final_eps),  # type: ignore[attr-defined]
            ("exploration_fraction", self.exploration_fraction),  # type: ignore[attr-defined]
        ):
            record[name] = value
        schedule, progress = self.exploration_schedule, float(record["progress"][0])  # type: ignore[attr-defined]
        if callable(schedule):
            self._rate_check().apply(f"exploration_schedule({progress:g})", schedule(progress))
        explore = as_python(make_explore(self.choices.behaviour, schedule))
        record["epsilon"] = explore(record.view(np.recarray)[0], progress)

    def _progress_made(self) -> float:
        record = self.training.record[0]
        if record["total_episodes"] > 0:
            return float(min(record["n_episodes"] / record["total_episodes"], 1.0))
        return float(min(record["num_timesteps"] / max(record["total_timesteps"], 1), 1.0))

    def own_functions(self) -> str:
        """
        :return: the method or schedule whose functions the learning loop calls, for messages
        """
        named = [] if isinstance(self.exploration_schedule, str) else ["`exploration_schedule`"]  # type: ignore[attr-defined]
        if self._method is not None:
            named.insert(0, f"The method {self._method.data.owner}")
        elif self.choices.rule is not keep_mu:
            named.insert(0, "`learning_rate`")
        return " or ".join(named) or f"The update of {type(self).__name__}"

    def functions_of_user(self) -> str:
        """
        :return: the method, schedule or update that are not this package's, for messages
        """
        found: dict[str, Any] = {"`learning_rate`": self.learning_rate}
        if self._method is not None:
            found = {f"The method {self._method.data.owner}": self._method.step_size or self._method.rule}
        found["`exploration_schedule`"] = self.exploration_schedule  # type: ignore[attr-defined]
        found[f"The update of {type(self).__name__}"] = self.choices.update
        named = [name for name, function in found.items() if callable(function) and not is_own(function)]
        return " or ".join(named) or self.own_functions()

    def _install_own_method(self) -> None:
        """Install the method of the constructor's arguments, if there is one."""
        self._missing_method = None  # a file may name a method whose class is not imported
        self._known_method = self._own_method()
        self._use_method(None)
        self.policy.forget_memory()
        if self.method is not None:
            self.install_method(make_method(self.method, **(self.method_kwargs or {})).method, restart=True)

    def _own_method(self) -> dict[str, Any]:
        return {"method": self.method, "method_kwargs": dict(self.method_kwargs or {})}

    def _check_arguments(self) -> None:
        """Check the attributes that are the constructor's arguments, and make plain types of them."""
        for name, each in (self.argument_checks() | self._exploration_checks()).items():
            attribute = ATTRIBUTES.get(name, name)
            setattr(self, attribute, each.apply(name, getattr(self, attribute)))
        if callable(self.learning_rate):
            RATE.apply("learning_rate", self.learning_rate(1.0))
        if self.method is None and self.method_kwargs:
            raise ValueError(
                f"`method_kwargs` are the parameters of a method, but got {self.method_kwargs} without a `method`."
            )
        if "initial_q" in self.policy_kwargs:
            raise ValueError(
                f"`initial_q` is an argument of {type(self).__name__} itself: please take it out of `policy_kwargs`."
            )

    def _exploration_checks(self) -> dict[str, Check]:
        """The checks of the exploration rates, which depend on the other arguments."""
        rate = self._rate_check()
        schedule = self.exploration_schedule  # type: ignore[attr-defined]
        if isinstance(schedule, str) and schedule == "exponential" and rate is RATE:
            rate = RATE_ABOVE_0
        return {"exploration_initial_eps": rate, "exploration_final_eps": rate}

    def _rate_check(self) -> Check:
        return TEMPERATURE if self.exploration == "boltzmann" else RATE  # type: ignore[attr-defined]


def _simple_linear_schedule(mu, step, initial_value):  # type: ignore[no-untyped-def]
    """RL Zoo's SimpleLinearSchedule."""
    return (1.0 - step.progress) * initial_value


def _linear_schedule(mu, step, start, end, end_fraction):  # type: ignore[no-untyped-def]
    """SB3's LinearSchedule."""
    done = 1.0 - (1.0 - step.progress)  # rounded as in SB3, which passes the remaining progress
    return end if done > end_fraction else start + done * (end - start) / end_fraction
