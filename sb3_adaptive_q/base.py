"""What all tabular algorithms share: the interface of Stable-Baselines3, and the learning loop."""

import random
import warnings
import weakref
from collections.abc import Callable
from math import inf
from typing import Any, ClassVar, TypeVar

import numpy as np
import torch as th
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import GymEnv, MaybeCallback, Schedule
from stable_baselines3.common.utils import get_device

from sb3_adaptive_q.action_masks import ALLOWED, note_mask
from sb3_adaptive_q.callbacks import EpisodeSeriesCallback, check_callback
from sb3_adaptive_q.checks import MOST_STEPS, check
from sb3_adaptive_q.hyperparameters import record_hyperparameters, run_name
from sb3_adaptive_q.learned_table import LearnedTable
from sb3_adaptive_q.logs import record_logs
from sb3_adaptive_q.one_at_a_time import OneAtATime, Training
from sb3_adaptive_q.policies import MlpPolicy, TabularQPolicy, count_actions
from sb3_adaptive_q.prediction import Prediction
from sb3_adaptive_q.random_numbers import first_counter
from sb3_adaptive_q.refused_call import Before
from sb3_adaptive_q.resume import Resumable, Unfinished
from sb3_adaptive_q.rollouts.choice import make_rollout
from sb3_adaptive_q.rollouts.step_rollout import StepRollout
from sb3_adaptive_q.state_index import make_state_index
from sb3_adaptive_q.training_state import TrainingState, field_of_state
from sb3_adaptive_q.wrapped_environment import WrappedEnvironment

SelfTabularAlgorithm = TypeVar("SelfTabularAlgorithm", bound="TabularAlgorithm")


class TabularAlgorithm(LearnedTable, Prediction, Resumable, OneAtATime, WrappedEnvironment):
    """
    An algorithm that learns a table of action values, under the interface of Stable-Baselines3.

    A subclass must have one attribute:

    - :attr:`update`, a plain function of numbers and arrays, which is compiled. It learns from one transition and chooses the
      next action; see :func:`sb3_adaptive_q.algorithms.q_learning.q_learning`, the shortest one, for its arguments and what
      it returns. Where arguments of the constructor decide between several functions, :meth:`update_function` gives it.

    It may also say the following, each where the update needs it:

    - :meth:`update_parameters`: numbers of the algorithm such as λ, which the update finds in ``agent.parameters``. The
      constructor keeps its own arguments as attributes of their names before it calls this one; so they are saved too.
    - :attr:`chooses_before_update` is true where the next action is drawn from the table before the update.
    - :attr:`updates_one_entry` is false where an update changes more than one entry of ``q_table``.
    - :meth:`extra_tables`: further tables of action values, which are saved; :attr:`n_tables` says for how many of them
      the step size has memory.
    - :meth:`working_arrays`: what belongs to the episodes of each environment, such as traces, with
      :meth:`check_working_arrays` for those that come from a file.

    :param policy: ``"MlpPolicy"``, which is the table; the name is SB3's, no network is involved. SB3's name for Dict
        observations, ``"MultiInputPolicy"``, means the same
    :param env: the environment to learn from, or its id; ``None`` for a model that is only loaded to predict
    :param learning_rate: the step size μ, from 0 to 1, where no method is installed: a number, or a function of the
        remaining progress (from 1 to 0)
    :param gamma: the discount factor γ; like the exploration's arguments, read when ``learn`` is called
    :param method: the number of the paper's method to install, 1 to 8, or the name of a step size of the literature;
        ``None`` for ``learning_rate``. A method handed to ``learn`` as a callback replaces it
    :param method_kwargs: what shall differ from the method's defaults, as in :func:`sb3_adaptive_q.method`
    :param exploration: ``"epsilon_greedy"``, or ``"boltzmann"``: the exploration rate is then its temperature
    :param ties: which of several best actions is taken while learning: ``"random"`` for any, ``"first"`` for the first.
        Targets and ``predict(deterministic=True)`` always take the first
    :param exploration_schedule: how the exploration rate falls: ``"linear"``, ``"exponential"``, ``"constant"``, or a plain
        function of the progress (from 0 to 1)
    :param exploration_fraction: the fraction of the training over which the exploration rate falls
    :param exploration_initial_eps: the exploration rate at the start
    :param exploration_final_eps: the exploration rate at the end
    :param initial_q: what the table starts from: a number, or an array of shape (n_states, n_actions)
    :param total_episodes: where given, learning ends after that many episodes, and these are what progress counts:
        the exploration rate and the methods' t / t_max are constant within an episode
    :param callback_interval: on a compiled environment, the steps of every environment between two calls of a callback
        of your own; ``None`` for 1 000 000 transitions of all environments together. Elsewhere callbacks are called at
        every step
    :param stats_window_size: the episodes over which the logged means are taken
    :param tensorboard_log: the folder for TensorBoard's files; ``None`` for none
    :param policy_kwargs: further arguments of a policy class of your own; the table takes none
    :param verbose: 0 for no output, 1 for the log and what is being wrapped, 2 for debugging
    :param seed: of the agent's random numbers and the environment
    :param device: ``"auto"`` and ``"cpu"`` mean the CPU: the table is worked on in place there
    :param _init_setup_model: whether to build the table now
    :param use_masking: whether to keep to the actions that ``info["action_mask"]`` of every reset and step allows, in
        behaviour and targets. A mask must be a function of the state. Compiled environments give none. :meth:`predict`
        keeps to the masks that were seen
    :raises ValueError: if an argument lies outside its range, or the environment's spaces are not supported
    :raises MemoryError: if the table would not fit into the memory
    """

    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {"MlpPolicy": MlpPolicy, "MultiInputPolicy": MlpPolicy}
    policy: TabularQPolicy

    # The state of a training, kept where machine code reads and writes it
    num_timesteps: int = field_of_state("num_timesteps", "Environment steps taken.")
    _episode_num: int = field_of_state("n_episodes", "Episodes finished.")
    _n_updates: int = field_of_state("n_updates", "Transitions learned from.")

    def __init__(
        self,
        policy: str | type[TabularQPolicy],
        env: GymEnv | str | None,
        learning_rate: float | Schedule = 0.01,
        gamma: float = 0.99,
        method: int | str | None = None,
        method_kwargs: dict[str, Any] | None = None,
        exploration_fraction: float = 1.0,
        exploration_initial_eps: float = 1.0,
        exploration_final_eps: float = 0.05,
        initial_q: Any = 0.0,
        total_episodes: int | None = None,
        callback_interval: int | None = None,
        stats_window_size: int = 100,
        tensorboard_log: str | None = None,
        policy_kwargs: dict[str, Any] | None = None,
        verbose: int = 0,
        seed: int | None = None,
        device: th.device | str = "auto",
        _init_setup_model: bool = True,
        exploration: str = "epsilon_greedy",
        ties: str = "random",
        exploration_schedule: str | Callable[[float], float] = "linear",
        use_masking: bool = False,
    ) -> None:
        self.training = TrainingState()
        super().__init__(
            # The class rather than its name: SB3 would advise on dict observations by the name
            self._get_policy_from_name(policy) if isinstance(policy, str) else policy,
            env,
            learning_rate,
            policy_kwargs=check("policy_kwargs", policy_kwargs),
            stats_window_size=stats_window_size,
            tensorboard_log=tensorboard_log,
            verbose=check("verbose", verbose),
            device=_cpu(device),
            support_multi_env=True,
            seed=seed,
        )
        self.gamma = gamma
        self.method = method
        self.method_kwargs = method_kwargs
        self.exploration = exploration
        self.ties = ties
        self.exploration_schedule = exploration_schedule
        self.use_masking = use_masking
        self.exploration_fraction = exploration_fraction
        self.exploration_initial_eps = exploration_initial_eps
        self.exploration_final_eps = exploration_final_eps
        self.initial_q = initial_q
        self.total_episodes = total_episodes
        self.callback_interval = callback_interval
        #: The callbacks that keep every episode
        self.episode_series: list[EpisodeSeriesCallback] = []
        self._rollout: StepRollout | None = None
        self._unfinished: Unfinished | None = None
        self._working: dict[str, np.ndarray] = {}
        self._next_actions: np.ndarray | None = None
        self._log_interval: int | None = None
        self._last_dump = 0
        if self.env is not None:
            make_state_index(self.observation_space)
            count_actions(self.action_space)
        if _init_setup_model:
            self._setup_model()

    def _setup_model(self) -> None:
        self._check_arguments()
        self._setup_lr_schedule()
        self._known_learning_rate = self.learning_rate
        self.set_random_seed(self.seed)
        self.policy = self.policy_class(  # type: ignore[assignment]
            self.observation_space, self.action_space, self.lr_schedule, initial_q=self.initial_q, **self.policy_kwargs
        ).to(self.device)
        self.policy.declare(self.extra_tables(self.policy.n_states, self.policy.n_actions), self.initial_q)
        if self.use_masking:
            self.policy.declare({ALLOWED: (self.policy.n_states, self.policy.n_actions)}, 1.0)
        self._share_mu()
        self._learning: weakref.ref[Training] | None = None
        #: For each environment, the values that its last action was chosen from
        self.considered = np.zeros((self.n_envs, self.policy.n_actions))
        self._install_own_method()
        self._choose_functions()

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name not in ("_learning", "_rollout", "choices")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._learning = self._rollout = None
        if "policy" in state:
            self._share_mu()
            self._choose_functions()

    def learn(
        self: SelfTabularAlgorithm,
        total_timesteps: int,
        callback: MaybeCallback = None,
        log_interval: int | None = 300,
        tb_log_name: str | None = None,
        reset_num_timesteps: bool = True,
        progress_bar: bool = False,
    ) -> SelfTabularAlgorithm:
        """
        Learn until ``total_timesteps`` or, where the constructor had ``total_episodes``, that many episodes are done.

        :param total_timesteps: the environment steps to learn from, rounded up to a multiple of the number of environments
        :param callback: called after every step, before the update that it leads to
        :param log_interval: the episodes between two entries of the log; ``None`` for no log
        :param tb_log_name: the name of the run in TensorBoard; ``None`` for the names of algorithm and method
        :param reset_num_timesteps: whether to count steps and episodes, and a method's μ and memory, from the start again
        :param progress_bar: whether to show one
        :return: the model
        :raises ValueError: if an argument is out of range, there is no environment, there are two methods among the callbacks,
            or a reward or a step size is not valid. If this happens before the first step, counts, method and memory are as
            before; if the environment was reset already, or callbacks had begun, the next call starts a new episode. If it
            happens later, what was learned remains, and the next call starts a new episode
        :raises RuntimeError: if the model is learning already
        """
        total_timesteps, log_interval = check("total_timesteps", total_timesteps), check("log_interval", log_interval)
        training = self._claim()
        before = Before(self)
        try:
            total_timesteps, callback = self._begin(
                total_timesteps, callback, log_interval, tb_log_name, reset_num_timesteps, progress_bar
            )
            # Callbacks keep these variables, and would keep all that is in them
            step_locals = {name: value for name, value in locals().items() if name not in ("training", "before")}
            before.callbacks_began = True
            callback.on_training_start(step_locals, globals())
            record_hyperparameters(self)
            self._rollout = rollout = make_rollout(self, callback, step_locals)
            before.forget()
            if self._take_up(rollout):
                self._learn_from(rollout, log_interval)
            counts = self.training.fields
            while counts.num_timesteps < total_timesteps and counts.n_episodes < self._total_episodes:
                callback.on_rollout_start()
                rollout.advance()
                callback.update_locals(step_locals)
                if not callback.on_step():
                    rollout.abandon()
                    break
                self._learn_from(rollout, log_interval)
                callback.on_rollout_end()
            self._rollout = None
            if log_interval is not None and self._n_updates > self.training.record["n_logged"][0]:
                self.dump_logs()
            callback.on_training_end()
        except BaseException:
            before.put_back(self)
            raise
        finally:
            self._learning = self._rollout = None
            del training
        return self

    def _learn_from(self, rollout: StepRollout, log_interval: int | None) -> None:
        rollout.learn()
        counts = self.training.fields
        self._current_progress_remaining = 1.0 - counts.progress
        if log_interval is not None and counts.n_episodes >= self._last_dump + log_interval:
            self.dump_logs()

    def _begin(
        self, total_timesteps: int, callback: MaybeCallback, log_interval: int | None, tb_log_name: str | None,
        reset_num_timesteps: bool, progress_bar: bool,
    ) -> tuple[int, BaseCallback]:  # fmt: skip
        """Check and set up what a training needs, before any callback is called."""
        check_callback(callback)
        tb_log_name = check("tb_log_name", tb_log_name)
        reset_num_timesteps = check("reset_num_timesteps", reset_num_timesteps)
        progress_bar = check("progress_bar", progress_bar)
        if self.env is None:
            raise ValueError("There is no environment to learn from: please hand one to `load` as `env`, or call `set_env`.")
        self.check_counts(reset_num_timesteps)
        self._check_arguments()
        self.check_functions_found(callback)
        self._log_interval = log_interval
        self._share_mu()
        restart = reset_num_timesteps or self._last_obs is None
        if restart:
            self._next_actions = None
        self.episode_series = []
        with self.setting_up:
            total_timesteps, callback = self._setup_learn(
                total_timesteps, callback, reset_num_timesteps, tb_log_name or run_name(self, callback), progress_bar
            )
        if reset_num_timesteps:
            self._last_dump = 0
            self.training.forget_updates()
        self._prepare_update()
        if restart and self.use_masking:
            states = self.policy.state_index.of_vec(self._last_obs)
            for state, info in zip(states, self.env.unwrapped.reset_infos, strict=True):
                note_mask(self._masks(), state, info)
        self._total_episodes = self._episode_num + self.total_episodes if self.total_episodes else inf
        record = self.training.record
        record["total_timesteps"] = min(max(int(self._total_timesteps), 1), MOST_STEPS)  # progress is a share of it
        record["total_episodes"] = min(self._total_episodes, MOST_STEPS) if self.total_episodes else 0
        self._start_step_size(reset_num_timesteps)
        self._start_exploration()
        self._go_on(reset_num_timesteps)
        return total_timesteps, callback

    def dump_logs(self) -> None:
        """Write the means over the last episodes, and over the updates since the last time, to the log."""
        record_logs(self)
        self._last_dump = self._episode_num

    def set_random_seed(self, seed: int | None = None) -> None:
        """
        Seed the environment, the agent's counter to learn with, and a generator for :meth:`predict`, so that an evaluation in
        between leaves the learning as it would be without. Python, NumPy, torch and the action space are seeded too, torch on
        the CPU only.

        :param seed: the seed; ``None`` for fresh entropy, which leaves the environment's generator alone
        """
        seed = check("seed", seed)
        if seed is not None:
            self._seed_everything(seed)
        # Spawned, because an environment that is seeded with the same number draws from SeedSequence(seed) itself
        learning, predicting = np.random.SeedSequence(seed).spawn(2)
        self.training.record["counter"] = first_counter(learning)
        self._predict_generator = np.random.default_rng(predicting)

    def _seed_everything(self, seed: int) -> None:
        """What SB3 seeds, but no GPU: to prepare all kinds of them, as `torch.manual_seed` does, takes 0.7 ms."""
        random.seed(seed)
        np.random.seed(seed)
        th.default_generator.manual_seed(seed)
        self.action_space.seed(seed)
        if self.env is not None:
            self.env.seed(seed)

    def _get_policy_from_name(self, policy_name: str) -> type[BasePolicy]:
        if policy_name not in self.policy_aliases:
            raise ValueError(f"Policy {policy_name} unknown: use one of {', '.join(self.policy_aliases)}.")
        return self.policy_aliases[policy_name]


def _cpu(device: th.device | str) -> th.device | str:
    if device != "auto" and get_device(device).type != "cpu":
        warnings.warn(f"The table's memory is worked on in place, on the CPU; device={device} is ignored.", stacklevel=3)
    return "cpu"
