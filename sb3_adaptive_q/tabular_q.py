"""Q-learning with a table, under the interface of Stable-Baselines3."""

import sys
import threading
import time
import warnings
from math import inf
from typing import Any, ClassVar, NoReturn, TypeVar

import numpy as np
import torch as th
from stable_baselines3.common.base_class import BaseAlgorithm, maybe_make_env
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import is_wrapped
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.save_util import load_from_zip_file
from stable_baselines3.common.type_aliases import GymEnv, MaybeCallback, Schedule, TensorDict
from stable_baselines3.common.utils import ConstantSchedule, get_device, safe_mean
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.patch_gym import _patch_env

from sb3_adaptive_q import kernels, rules
from sb3_adaptive_q.callbacks import check_one_method, method as make_method
from sb3_adaptive_q.compilation import FunctionSet
from sb3_adaptive_q.fused_rollout import FusedRollout
from sb3_adaptive_q.installed_rate import InstalledRate, check_rate
from sb3_adaptive_q.policies import MlpPolicy, TabularQPolicy, count_actions
from sb3_adaptive_q.rollouts import HOLD, NO_UPDATES, StepRollout
from sb3_adaptive_q.state_index import make_state_index
from sb3_adaptive_q.vec_env import CompiledVecEnv, LeanVecEnv

SelfTabularQ = TypeVar("SelfTabularQ", bound="TabularQ")

#: More steps than are ever taken, and few enough for 64 bits
NO_END = 2**62

#: Of what a saved file holds; to be raised when older versions could not read it
FORMAT_VERSION = 1

#: Held while SB3 looks for a free folder for the log and makes it, as models in other threads may do
_SETTING_UP = threading.Lock()


class TabularQ(BaseAlgorithm):
    """
    Q-learning (Watkins, 1989; Eq. 2 of the paper) with a table, ε-greedy exploration and a step size μ that a method
    may set anew at every update.

    :param policy: ``"MlpPolicy"``, which is the table; the name is SB3's, no network is involved
    :param env: the environment to learn from, or its id; ``None`` for a model that is only loaded to predict
    :param learning_rate: the step size μ, from 0 to 1, where no method is installed: a number, or a function of the
        remaining progress (from 1 to 0)
    :param gamma: the discount factor γ; like the exploration's arguments, read when ``learn`` is called
    :param method: the number of the paper's method to install, 1 to 8; ``None`` for ``learning_rate``. A
        method handed to ``learn`` as a callback replaces it
    :param method_kwargs: what shall differ from the paper's parameters, as in :func:`sb3_adaptive_q.method`
    :param exploration_fraction: the fraction of the training over which the exploration rate falls
    :param exploration_initial_eps: the exploration rate ε at the start
    :param exploration_final_eps: the exploration rate ε at the end
    :param initial_q: what every entry of the table starts from
    :param total_episodes: where given, learning ends after that many episodes, and these are what progress counts:
        ε and the methods' t / t_max are constant within an episode
    :param callback_interval: on a compiled environment, the steps of every environment between two calls of a callback
        of your own; ``None`` for 1 000 000 transitions of all environments together. Elsewhere callbacks are called at
        every step
    :param stats_window_size: the episodes over which the logged means are taken
    :param tensorboard_log: the folder for TensorBoard's files; ``None`` for none
    :param policy_kwargs: further arguments of the policy
    :param verbose: 0 for no output, 1 for the log and what is being wrapped, 2 for debugging
    :param seed: of the agent's generators and the environment
    :param device: ``"auto"`` and ``"cpu"`` mean the CPU: the table is worked on in place there
    :param _init_setup_model: whether to build the table now
    :raises ValueError: if an argument lies outside its range, or the environment's spaces are not supported
    """

    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"MlpPolicy": MlpPolicy}
    policy: TabularQPolicy

    def __init__(
        self,
        policy: str | type[TabularQPolicy],
        env: GymEnv | str | None,
        learning_rate: float | Schedule = 0.01,
        gamma: float = 0.99,
        method: int | None = None,
        method_kwargs: dict[str, Any] | None = None,
        exploration_fraction: float = 1.0,
        exploration_initial_eps: float = 1.0,
        exploration_final_eps: float = 0.05,
        initial_q: float = 0.0,
        total_episodes: int | None = None,
        callback_interval: int | None = None,
        stats_window_size: int = 100,
        tensorboard_log: str | None = None,
        policy_kwargs: dict[str, Any] | None = None,
        verbose: int = 0,
        seed: int | None = None,
        device: th.device | str = "auto",
        _init_setup_model: bool = True,
    ) -> None:
        super().__init__(
            # The class rather than its name: SB3 would advise on dict observations by the name
            self._get_policy_from_name(policy) if isinstance(policy, str) else policy,
            env,
            learning_rate,
            policy_kwargs=policy_kwargs,
            stats_window_size=stats_window_size,
            tensorboard_log=tensorboard_log,
            verbose=verbose,
            device=_cpu(device),
            support_multi_env=True,
            seed=seed,
        )
        self.gamma = gamma
        self.method = method
        self.method_kwargs = method_kwargs
        self.exploration_fraction = exploration_fraction
        self.exploration_initial_eps = exploration_initial_eps
        self.exploration_final_eps = exploration_final_eps
        self.initial_q = initial_q
        self.total_episodes = total_episodes
        self.callback_interval = callback_interval
        self.format_version = FORMAT_VERSION
        #: ε in force
        self.exploration_rate = 0.0
        self._rate_data: dict[str, Any] | None = None
        if self.env is not None:
            make_state_index(self.observation_space)
            count_actions(self.action_space)
        if _init_setup_model:
            self._setup_model()

    def _setup_model(self) -> None:
        self._check_arguments()
        self._setup_lr_schedule()
        self.set_random_seed(self.seed)
        self.policy = self.policy_class(  # type: ignore[assignment]
            self.observation_space, self.action_space, self.lr_schedule, initial_q=self.initial_q, **self.policy_kwargs
        ).to(self.device)
        self._view_buffers()
        self._rate: InstalledRate | None = None
        self._rule = HOLD
        self._rule_arguments: tuple[float, ...] = ()
        self._next_actions: np.ndarray | None = None
        if self._rate_data is not None:
            self._restore_rate(InstalledRate(**self._rate_data))
        elif self.method is not None:
            self.install_rate(make_method(self.method, **(self.method_kwargs or {})).rate, restart=True)

    def _view_buffers(self) -> None:
        """Views of the policy's buffers: to ask a tensor for its array would cost more than an update."""
        policy = self.policy
        self._table = _view("q_table", policy.q_table, (policy.state_index.n_states, count_actions(self.action_space)))
        self._mu: Any = memoryview(_view("mu", policy.mu, (1,)))  # type: ignore[arg-type]

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name not in ("_table", "_mu")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        if "policy" in state:
            self._view_buffers()

    def _check_arguments(self) -> None:
        if self.format_version > FORMAT_VERSION:
            raise ValueError(
                f"The file has format version {self.format_version}, and this version of sb3_adaptive_q reads up to "
                f"{FORMAT_VERSION}: please update the package."
            )
        self.format_version = FORMAT_VERSION
        for name in ("gamma", "exploration_fraction", "exploration_initial_eps", "exploration_final_eps"):
            check_rate(name, getattr(self, name))
        check_rate("learning_rate", self.learning_rate(1.0) if callable(self.learning_rate) else self.learning_rate)
        if self.method is None and self.method_kwargs:
            raise ValueError(
                f"`method_kwargs` are the parameters of a method, but got {self.method_kwargs} without a `method`."
            )
        if "initial_q" in self.policy_kwargs:
            raise ValueError("`initial_q` is an argument of TabularQ itself: please take it out of `policy_kwargs`.")
        for name in ("total_episodes", "callback_interval"):
            value = getattr(self, name)
            if value is not None and not (isinstance(value, int | np.integer) and value >= 1):
                raise ValueError(f"`{name}` must be at least 1, or None, and a whole number, but got {value}.")
        if not np.isfinite(self.initial_q):
            raise ValueError(f"`initial_q` must be finite, but got {self.initial_q}.")

    @property
    def q_table(self) -> np.ndarray:
        """The live table of action values, of shape (n_states, n_actions)."""
        return self.policy.q_table.numpy()

    @property
    def mu(self) -> float:
        """
        The step size of the next update, from 0 to 1. It may be set, by a callback of your own too: a method computes on
        from what was set; without a method it holds until ``learn`` ends.
        """
        return self._mu[0]

    @mu.setter
    def mu(self, value: float) -> None:
        check_rate("mu", value)
        self._mu[0] = value
        if self._rate is None:
            self._rule = HOLD

    def install_rate(self, rate: InstalledRate, restart: bool) -> None:
        """
        Put a method in force; called by its callback when training starts.

        :param rate: the method
        :param restart: whether μ starts again from the method's ``mu_0`` even where the same method is in force already
        :raises ValueError: if the method resets μ with every episode and there are several environments
        """
        starts = restart or rate.as_data() != self._rate_data
        self._use_rate(rate)
        if starts:
            self._mu[0] = rate.start()

    def _restore_rate(self, rate: InstalledRate) -> None:
        try:
            self._use_rate(rate)
        except (ImportError, AttributeError):
            warnings.warn(
                f"The class of the learning-rate method in force, {rate.owner}, cannot be imported: until its callback is "
                "given to `learn`, or another method, the model learns with its `learning_rate`.",
                stacklevel=4,
            )

    def _use_rate(self, rate: InstalledRate) -> None:
        if rate.reset_each_episode and getattr(self, "n_envs", 1) > 1:
            raise ValueError(
                f"`reset_each_episode` needs a single environment, but got {self.n_envs}: they share one μ, and their "
                "episodes begin at different times."
            )
        self._rule, self._rule_arguments = rate.rule, rate.arguments
        self._rate_data = rate.as_data()
        self._rate = rate

    def learn(
        self: SelfTabularQ,
        total_timesteps: int,
        callback: MaybeCallback = None,
        log_interval: int | None = 300,
        tb_log_name: str = "TabularQ",
        reset_num_timesteps: bool = True,
        progress_bar: bool = False,
    ) -> SelfTabularQ:
        """
        Learn until ``total_timesteps`` or, where the constructor had ``total_episodes``, that many episodes are done.

        :param total_timesteps: the environment steps to learn from; with n environments, a multiple of n that reaches it
        :param callback: called after every step, before the update that it leads to
        :param log_interval: the episodes between two entries of the log; ``None`` for no log
        :param tb_log_name: the name of the run in TensorBoard
        :param reset_num_timesteps: whether to count steps and episodes, and a method's μ, from the start again
        :param progress_bar: whether to show one
        :return: the model
        :raises ValueError: if there is no environment, there are two methods among the callbacks, or a reward is not a
            finite number
        """
        check_one_method(callback)
        if self.env is None:
            raise ValueError("There is no environment to learn from: please hand one to `load` as `env`, or call `set_env`.")
        if log_interval is not None and log_interval < 1:
            raise ValueError(f"`log_interval` must be at least 1, or None for no log, but got {log_interval}.")
        self._view_buffers()  # the policy may be another one by now
        if reset_num_timesteps or self._last_obs is None:
            self._next_actions = None
        with _SETTING_UP:
            total_timesteps, callback = self._setup_learn(
                total_timesteps, callback, reset_num_timesteps, tb_log_name, progress_bar
            )
        self._start_rate(reset_num_timesteps)
        step_locals = locals()
        callback.on_training_start(step_locals, globals())
        rollout = self._begin_rollout(callback, step_locals)
        try:
            while self.num_timesteps < total_timesteps and self._episode_num < self._total_episodes:
                callback.on_rollout_start()
                rollout.advance()
                callback.update_locals(step_locals)
                if not callback.on_step():
                    rollout.abandon()
                    break
                rollout.learn()
                self._current_progress_remaining = 1.0 - rollout.progress
                if log_interval is not None and self._episode_num >= self._last_dump + log_interval:
                    self.dump_logs()
                callback.on_rollout_end()
        except BaseException:
            self._last_obs = None  # the environment may have moved on without the agent: begin with a reset next time
            raise
        callback.on_training_end()
        return self

    def _begin_rollout(self, callback: BaseCallback, step_locals: dict[str, Any]) -> StepRollout:
        rollout = self._make_rollout(callback, step_locals)
        self._last_dump = self._episode_num
        self._statistics = rollout.statistics
        self._forget_updates()
        return rollout

    def _make_rollout(self, callback: BaseCallback, step_locals: dict[str, Any]) -> StepRollout:
        if not isinstance(self.env, CompiledVecEnv):
            if isinstance(self.env, VecEnvWrapper) and isinstance(self.env.unwrapped, CompiledVecEnv):
                warnings.warn(
                    f"A CompiledVecEnv inside a {type(self.env).__name__} is stepped like any other environment: for "
                    "compiled stretches, hand it over without a wrapper.",
                    stacklevel=4,
                )
            return StepRollout(self, self._make_learner(), step_locals)
        return FusedRollout(self, self._make_learner(), step_locals, callback)

    def _make_learner(self) -> kernels.Learner:
        decay = self.exploration_final_eps - self.exploration_initial_eps
        return kernels.Learner(
            n_actions=self.q_table.shape[1],
            gamma=float(self.gamma),
            exploration_initial_eps=float(self.exploration_initial_eps),
            exploration_final_eps=float(self.exploration_final_eps),
            exploration_fraction=float(self.exploration_fraction),
            exploration_slope=decay / self.exploration_fraction if self.exploration_fraction else 0.0,
            total_timesteps=min(int(self._total_timesteps), NO_END),
            total_episodes=int(self._total_episodes) if self.total_episodes else 0,
            **self._rate_constants(),
        )

    def _rate_constants(self) -> dict[str, Any]:
        """The fields of ``Learner`` that the method in force decides."""
        rate = self._rate
        return {
            "next_action": kernels.NEXT_ACTIONS[rate.next_action] if rate else kernels.SAME_ACTION,
            "reset_each_episode": rate.reset_each_episode if rate else False,
            "mu_0": float(rate.start()) if rate else 0.0,
        }

    def _refuse_rate(self, rate: Any) -> NoReturn:
        raise ValueError(
            f"The rule of {self._rule.name} must give step sizes from 0 to 1, but gave {rate!r}: please check it."
        )

    def _start_rate(self, restart: bool) -> None:
        """Before any callback is called, so that one may set another μ when training starts."""
        self._total_episodes = self._episode_num + self.total_episodes if self.total_episodes else inf
        if self._rate is not None:
            self.mu = self._rate.start() if restart else self.mu
        elif restart or self._rate_data is None:  # otherwise a method is in force, but out of reach
            progress = kernels.progress_made(self._make_learner(), self.num_timesteps, self._episode_num)
            self.mu = self.lr_schedule(1.0 - progress)
            self._rule = self._schedule_rule()

    def _schedule_rule(self) -> FunctionSet:
        schedule = self.lr_schedule
        if isinstance(schedule.value_schedule, ConstantSchedule):  # type: ignore[attr-defined]
            return HOLD

        def schedule_rate(mu: float, transition: rules.Transition) -> float:
            rate = schedule(1.0 - transition.progress)
            check_rate("learning_rate", rate)
            return rate

        return FunctionSet("learning_rate", function=schedule_rate)

    def dump_logs(self) -> None:
        """Write the means over the last episodes, and over the updates since the last time, to the log."""
        assert self.ep_info_buffer is not None and self.ep_success_buffer is not None
        seconds = max((time.time_ns() - self.start_time) / 1e9, sys.float_info.epsilon)
        record = self.logger.record
        if len(self.ep_info_buffer) > 0:
            record("rollout/ep_rew_mean", safe_mean([info["r"] for info in self.ep_info_buffer]))
            record("rollout/ep_len_mean", safe_mean([info["l"] for info in self.ep_info_buffer]))
        if len(self.ep_success_buffer) > 0:
            record("rollout/success_rate", safe_mean(self.ep_success_buffer))
        record("rollout/exploration_rate", self.exploration_rate)
        record("time/fps", int((self.num_timesteps - self._num_timesteps_at_start) / seconds))
        record("time/episodes", self._episode_num, exclude="tensorboard")
        record("time/time_elapsed", int(seconds), exclude="tensorboard")
        record("time/total_timesteps", self.num_timesteps, exclude="tensorboard")
        self._record_updates()
        self.logger.dump(step=self.num_timesteps)
        self._last_dump = self._episode_num

    def _record_updates(self) -> None:
        n_updates = self._n_updates - self._n_updates_at_dump
        mu_sum, mu_min, mu_max, td_error_sum = self._statistics.tolist()
        self._forget_updates()
        record = self.logger.record
        record("train/learning_rate", self.mu)
        record("train/n_updates", self._n_updates, exclude="tensorboard")
        if n_updates > 0:
            record("train/mu_mean", mu_sum / n_updates)
            record("train/mu_min", mu_min)
            record("train/mu_max", mu_max)
            record("train/td_error", td_error_sum / n_updates)

    def _forget_updates(self) -> None:
        self._statistics[:] = NO_UPDATES
        self._n_updates_at_dump = self._n_updates

    def predict(
        self,
        observation: np.ndarray | dict[str, np.ndarray],
        state: tuple[np.ndarray, ...] | None = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = False,
    ) -> tuple[np.ndarray, tuple[np.ndarray, ...] | None]:
        """
        The greedy action; with ``deterministic=False`` a random one instead with probability ``exploration_rate``.

        :param observation: one observation or a batch of them
        :param state: handed back as it is
        :param episode_start: unused
        :param deterministic: whether to leave exploration out
        :return: the action or the batch of actions, and ``state``
        :raises ValueError: if an observation lies outside the observation space
        """
        actions, state = self.policy.predict(observation, state, episode_start, deterministic)
        if deterministic:
            return actions, state
        generator, shape = self._predict_generator, np.shape(actions)
        random_actions = generator.integers(self.action_space.n, size=shape) + self.action_space.start  # type: ignore[attr-defined]
        chosen = np.where(generator.random(shape) < self.exploration_rate, random_actions, actions)
        return chosen[()], state  # a scalar rather than an array without axes, which no dict could be asked for

    def set_random_seed(self, seed: int | None = None) -> None:
        """
        Seed the environment and the agent's two generators: one to learn with, one for :meth:`predict`, so that an
        evaluation in between leaves the learning as it would be without.

        :param seed: the seed; ``None`` for fresh entropy, which leaves the environment's generator alone
        """
        super().set_random_seed(seed)
        # Spawned, because an environment that is seeded with the same number draws from SeedSequence(seed) itself
        learning, predicting = np.random.SeedSequence(seed).spawn(2)
        self._generator = np.random.default_rng(learning)
        self._predict_generator = np.random.default_rng(predicting)

    def set_parameters(
        self, load_path_or_dict: str | TensorDict, exact_match: bool = True, device: th.device | str = "auto"
    ) -> None:
        """
        Take over a table and its μ, as :meth:`stable_baselines3.common.base_class.BaseAlgorithm.set_parameters` does.

        :param load_path_or_dict: a saved file, or what ``get_parameters`` returned
        :param exact_match: whether all parameters must be there
        :param device: unused: the table stays where it is
        :raises ValueError: if they do not fit the model, or μ is not from 0 to 1
        """
        parameters: Any = load_path_or_dict
        if not isinstance(parameters, dict):
            _, parameters, _ = load_from_zip_file(parameters, device=device, load_data=False)
        if "mu" in parameters.get("policy", {}):
            check_rate("mu", float(parameters["policy"]["mu"]))
        super().set_parameters(parameters, exact_match, device)

    @classmethod
    def load(cls: type[SelfTabularQ], *args: Any, **kwargs: Any) -> SelfTabularQ:
        """
        Load a model, as :meth:`stable_baselines3.common.base_class.BaseAlgorithm.load` does. A ``method`` or a
        ``learning_rate`` among the keyword arguments replaces the method that was in force when the model was saved.

        :param args: as in SB3
        :param kwargs: as in SB3
        :return: the model
        :raises ValueError: if the environment has other spaces, or an argument lies outside its range
        """
        if "method" in kwargs:
            kwargs = {"_rate_data": None, "method_kwargs": None, **kwargs}
        elif "method_kwargs" in kwargs:
            kwargs = {"_rate_data": None, **kwargs}
        elif "learning_rate" in kwargs:
            kwargs = {"_rate_data": None, "method": None, "method_kwargs": None, **kwargs}
        model = super().load(*args, **kwargs)
        if "_rate_data" in kwargs:  # the file's μ is that of the method which has been replaced
            model.mu = model._rate.start() if model._rate is not None else model.lr_schedule(1.0)
        return model

    def set_env(self, env: GymEnv, force_reset: bool = True) -> None:
        super().set_env(env, force_reset)
        self._next_actions = None

    @staticmethod
    def _wrap_env(env: GymEnv | str, verbose: int = 0, monitor_wrapper: bool = True) -> VecEnv:
        env = maybe_make_env(env, verbose)  # `load` and `set_env` take an id too
        if not isinstance(env, VecEnv):
            env = _patch_env(env)
            if not is_wrapped(env, Monitor) and monitor_wrapper:
                if verbose >= 1:
                    print("Wrapping the env with a `Monitor` wrapper")
                env = Monitor(env)
            if verbose >= 1:
                print("Wrapping the env in a LeanVecEnv.")
            wrapped = env
            env = LeanVecEnv([lambda: wrapped])
        return BaseAlgorithm._wrap_env(env, verbose, monitor_wrapper)

    def _get_policy_from_name(self, policy_name: str) -> type[BasePolicy]:
        if policy_name not in self.policy_aliases:
            raise ValueError(f"Policy {policy_name} unknown: use one of {', '.join(self.policy_aliases)}.")
        return self.policy_aliases[policy_name]

    def _excluded_save_params(self) -> list[str]:
        derived = [
            "_table",
            "_mu",
            "_generator",
            "_predict_generator",
            "_rule",
            "_rule_arguments",
            "_rate",
            "lr_schedule",
        ]
        of_one_training = ["_next_actions", "_statistics", "_n_updates_at_dump", "_last_dump", "_total_episodes"]
        return [*super()._excluded_save_params(), *derived, *of_one_training]


def _view(name: str, buffer: th.Tensor, shape: tuple[int, ...]) -> np.ndarray:
    """The memory of a policy's buffer, which machine code takes to be laid out like this."""
    fits = (
        tuple(buffer.shape) == shape and buffer.dtype == th.float64 and buffer.is_contiguous() and buffer.device.type == "cpu"
    )
    if not fits:
        raise ValueError(
            f"The policy's `{name}` must be a contiguous tensor of float64 and of shape {shape} on the CPU, but is of "
            f"{buffer.dtype}, {tuple(buffer.shape)}, on {buffer.device}: please copy the values into the buffer that is there."
        )
    return buffer.numpy()


def _cpu(device: th.device | str) -> th.device | str:
    if device != "auto" and get_device(device).type != "cpu":
        warnings.warn(f"TabularQ works on the table's memory in place, on the CPU; device={device} is ignored.", stacklevel=3)
    return "cpu"
