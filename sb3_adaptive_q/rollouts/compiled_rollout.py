"""Training on compiled environments: many steps in one call of machine code."""

import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor, wait
from math import ceil
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

from sb3_adaptive_q.algorithms.td_update import Transition
from sb3_adaptive_q.callbacks import Episodes
from sb3_adaptive_q.checks import MOST_STEPS
from sb3_adaptive_q.compiled import loops
from sb3_adaptive_q.compiled.jit import CannotCompile, is_disabled, machine_code
from sb3_adaptive_q.compiled.records import CONTROL, ENV, EPISODE
from sb3_adaptive_q.policies import count_actions
from sb3_adaptive_q.random_numbers import read_pcg64, write_pcg64
from sb3_adaptive_q.rollouts.callbacks_due import callbacks_of_sb3, episodes_until_due, skip_steps, steps_until_due
from sb3_adaptive_q.rollouts.step_rollout import RolloutState, StepRollout
from sb3_adaptive_q.state_index import make_state_index
from sb3_adaptive_q.vec_env.compiled_vec_env import CompiledVecEnv

#: Transitions of all environments between two calls of a user's callback
DEFAULT_INTERVAL = 1_000_000
#: How long one call of machine code may take, in seconds: an interrupt is answered between two calls
LONGEST_CALL = 0.05
#: Steps of the first call, after which the speed is known
FIRST_CALL = 10_000


class CompiledRollout(StepRollout):
    """
    Steps the environments many times, and learns from all transitions but the last of each environment. So a callback finds
    the same table as on the ordinary path. :meth:`learn` then learns from the last transitions, with the same machine code.

    :param model: the tabular algorithm that learns
    :param step_locals: the variables that callbacks see
    :param callback: what is called after every rollout. A rollout ends where one of SB3's own callbacks in it is due
    :raises ValueError: if the method, the exploration schedule or the dynamics do not compile
    """

    env: CompiledVecEnv

    def __init__(self, model: Any, step_locals: dict[str, Any], callback: BaseCallback) -> None:
        if is_disabled():
            raise ValueError(
                "A CompiledVecEnv needs Numba's compiler, which is disabled: please unset NUMBA_DISABLE_JIT, or use "
                "LeanVecEnv."
            )
        self.callback = callback
        self.compiled_envs = model.env.compile()
        self.dynamics = self.compiled_envs[0].dynamics
        n_envs = model.env.num_envs
        self.envs = np.zeros(n_envs, ENV)
        self.control = np.zeros(1, CONTROL)
        self.control["max_episode_steps"] = self.compiled_envs[0].max_episode_steps
        self.places = self.dynamics.empty_places(n_envs)
        self.words = np.zeros((n_envs, 4), np.uint64)
        self.call_steps = max(FIRST_CALL // n_envs, 1)
        super().__init__(model, step_locals)
        interval = model.callback_interval or max(DEFAULT_INTERVAL // n_envs, 1)
        self.interval = int(min(interval, max(self._steps_left(), 1)))
        self.episodes = np.zeros(self.interval * n_envs, EPISODE)

    def _compile(self) -> None:
        self._compare_with_table()
        make_loop = loops.make_single_loop if len(self.envs) == 1 else loops.make_several_loop
        loop = make_loop(self.choices.learn_one(), *self.dynamics.loop_functions())
        record = (np.zeros(0, EPISODE), np.zeros((0, len(self.envs)), dtype=bool))
        try:
            self._check_own_functions()
            self._loop = machine_code(loop, self._arguments(record))
        except CannotCompile as error:
            raise ValueError(
                f"A compiled environment needs machine code, but {self.model.own_functions()} or the dynamics "
                f"{type(self.dynamics).__name__} do not compile: {error}. LeanVecEnv runs any Python function."
            ) from error

    def _compare_with_table(self) -> None:
        """
        Machine code does not look at sizes, and an environment may be another one than when the model was made.

        :raises ValueError: if it has not the states and actions of the table
        """
        env, table = self.env.envs[0], self.tables[0].shape
        found = self.dynamics.table_shape() or (
            make_state_index(env.observation_space).n_states,
            count_actions(env.action_space),
        )
        if found != table:
            raise ValueError(
                f"{type(env.unwrapped).__name__} has {found[0]} states and {found[1]} actions, but the model's table has "
                f"{table[0]} and {table[1]}: please make a new model for this environment."
            )

    def _arguments(self, record: tuple[np.ndarray, np.ndarray]) -> tuple[Any, ...]:
        dynamics = (self.places, self._generators(), tuple(self.dynamics.parameters))
        return self.tables, self.memory, self.learner, self.draws, self.envs, dynamics, self.control, record

    def _generators(self) -> Any:
        if self.dynamics.draws_from_words:
            return self.words
        return tuple(each.unwrapped.np_random for each in self.compiled_envs)

    def advance(self) -> None:
        """
        Run a rollout. Callbacks then find the same variables as on the ordinary path after its last step, except ``dones``:
        it has the shape (steps, n_envs), and says for every step of the rollout whether it ended an episode.

        :raises ValueError: as on the ordinary path, or if the method or the dynamics give a value out of range
        """
        if self.model.choices is not self.choices:
            self.take_choices()
        callbacks = callbacks_of_sb3(self.callback)
        max_steps, max_episodes = self._limits(callbacks)
        dones = np.zeros((max_steps, self.n_envs), dtype=bool)
        self._read_environments()
        n_steps = self._run(dones, max_steps, max_episodes)
        self._write_environments(n_steps)
        skip_steps(callbacks, n_steps - 1, self.n_envs)
        self.dones = self.envs["done"].tolist()
        self.infos = self._last_infos()
        self._hand_over_episodes()
        new_obs = self.state_index.observations(self.envs["start_state"])
        rewards = self.envs["reward"].astype(np.float32)
        self.show(self._action_array + self.first_action, new_obs, rewards, dones[:n_steps], self.infos)

    def learn(self) -> None:
        """Learn from the transitions that were made last, and choose the next actions."""
        if self.model.choices is not self.choices:
            self.take_choices()
        self.note_episodes()
        self.control["pending"] = 1
        self._call((self.episodes, np.zeros((0, self.n_envs), dtype=bool)), 0, 0)
        self._take_over()
        self.model._last_obs = self.new_obs

    def abandon(self) -> None:
        super().abandon()
        self.control["pending"] = 0

    def state(self) -> RolloutState:
        pending = self.envs[list(Transition._fields)].tolist() if self.control["pending"][0] else []
        returns, lengths = self.envs["episode_return"].tolist(), self.envs["length"].tolist()
        return RolloutState(pending, self._infos_for_log() if pending else [], returns, lengths)

    def restore(self, state: RolloutState) -> None:
        self._read_environments()
        for i, each in enumerate(self.compiled_envs):
            if each.layers.monitor is None:  # then these are kept nowhere else
                self.envs[i]["episode_return"] = state.returns[i]
                if each.layers.limit is None:
                    self.envs[i]["length"] = state.lengths[i]
        self._write_environments(0)
        for i, transition in enumerate(state.transitions):
            for name, value in zip(Transition._fields, transition, strict=True):
                self.envs[i][name] = value
        self._restore_last_step(state)

    def _run(self, dones: np.ndarray, max_steps: int, max_episodes: int) -> int:
        """Call the machine code repeatedly, until the rollout has its full length."""
        control = self.control
        control["pending"] = 0
        n_steps, self.n_ended = 0, 0
        while n_steps < max_steps and self.n_ended < max_episodes:
            steps = min(max_steps - n_steps, self.call_steps)
            start = time.perf_counter()
            self._call((self.episodes[self.n_ended :], dones[n_steps:]), steps, max_episodes - self.n_ended)
            seconds = time.perf_counter() - start
            n_steps += int(control["n_steps"][0])
            self.n_ended += int(control["n_ended"][0])
            if steps == self.call_steps:
                self._adapt(seconds)
        self._take_over()
        return n_steps

    def _adapt(self, seconds: float) -> None:
        """Choose the steps of the next call so that it takes about as long as it may."""
        self.call_steps = max(int(self.call_steps * min(max(LONGEST_CALL / max(seconds, 1e-6), 0.25), 4.0)), 1)

    def _call(self, record: tuple[np.ndarray, np.ndarray], max_steps: int, max_episodes: int) -> None:
        self.control["max_steps"], self.control["max_episodes"] = max_steps, max_episodes
        arguments = self._arguments(record)
        try:
            if self.dynamics.draws_from_words or threading.current_thread() is not threading.main_thread():
                self._loop(*arguments)
            else:
                self._call_in_thread(arguments)
        except IndexError as error:
            self.refuse_index(error, f"{self.model.functions_of_user()}, or the dynamics {type(self.dynamics).__name__},")
        status = int(self.control["status"][0])
        if status != loops.SOUND:
            self._refuse_status(status)

    def _call_in_thread(self, arguments: tuple[Any, ...]) -> None:
        """
        Run the loop in another thread. To pass a Generator, Numba runs Python code that a signal must not interrupt, and
        signals reach only the main thread, which waits here.
        """
        with ThreadPoolExecutor(1) as executor:
            future: Future[None] = executor.submit(self._loop, *arguments)
            try:
                future.result()
            finally:
                wait([future])

    def _take_over(self) -> None:
        self._action_array[:] = self.envs["action"]
        self.states[:] = self.envs["state"].tolist()

    def _refuse_status(self, status: int) -> None:
        i = int(self.control["env"][0])
        env = self.envs[i]
        self._take_over()
        if status == loops.REWARD_NOT_FINITE:
            self.refuse_reward(i, float(env["reward"]))
        if status == loops.STATE_OUT_OF_RANGE:
            raise ValueError(
                f"`index` of {type(self.dynamics).__name__} must give rows 0 to {self.state_index.n_states - 1}, but at step "
                f"{self.model.num_timesteps} it gave {int(env['next_state'])} for the next state and "
                f"{int(env['start_state'])} for the one after a reset: please check it."
            )
        self.refuse(int(env["state"]), int(env["action"]))

    def _steps_left(self) -> int:
        return ceil((self.model._total_timesteps - self.model.num_timesteps) / self.n_envs)

    def _limits(self, callbacks: list[BaseCallback]) -> tuple[int, int]:
        model = self.model
        episodes_left = model._total_episodes - model._episode_num
        due = steps_until_due(callbacks, model.num_timesteps, self.n_envs)
        max_steps = max(min(self.interval, self._steps_left(), due), 1)
        max_episodes = max(min(episodes_left, episodes_until_due(callbacks), MOST_STEPS), 1)
        return int(max_steps), int(max_episodes)

    def _read_environments(self) -> None:
        """Read the state of the environments that a callback has moved since the last rollout, and all their generators."""
        for i, each in enumerate(self.compiled_envs):
            if each.was_moved():
                state = each.read_state(self.state_index.n_states)
                self.places[i] = state
                self.envs[i]["length"], self.envs[i]["episode_return"] = each.episode_length, each.episode_return
            if self.dynamics.draws_from_words:
                read_pcg64(each.unwrapped.np_random, self.words[i])
        self.envs["action"] = self._action_array
        self.envs["state"] = self.states

    def _write_environments(self, n_steps: int) -> None:
        for i, each in enumerate(self.compiled_envs):
            if self.dynamics.draws_from_words:
                write_pcg64(each.unwrapped.np_random, self.words[i])
            place = self.dynamics.state_of(self.places[i])
            each.put(place, int(self.envs[i]["length"]), float(self.envs[i]["episode_return"]), n_steps)

    def _last_infos(self) -> list[dict[str, Any]]:
        """The info dicts that the environments would have returned for the last transition."""
        infos: list[dict[str, Any]] = []
        for i, done in enumerate(self.dones):
            info: dict[str, Any] = {"TimeLimit.truncated": done and not bool(self.envs[i]["terminated"])}
            if done:
                info["terminal_observation"] = self.state_index.observation(int(self.envs["next_state"][i]))
            infos.append(info)
        # The episodes that the last step ended are the last of the record
        for i, episode in self._episode_infos(self.n_ended - sum(self.dones), self.n_ended):
            infos[i]["episode"] = episode
        return infos

    def _hand_over_episodes(self) -> None:
        """
        Write the Monitors' files, and add the episodes that ended before the last step to the log. Those that the last step
        ended are added after the callbacks.
        """
        model, episodes = self.model, self.episodes[: self.n_ended]
        earlier = self.n_ended - sum(self.dones)
        recent = self._episode_infos(max(earlier - model._stats_window_size, 0), earlier)
        model.ep_info_buffer.extend(episode for _, episode in recent)
        for i, each in enumerate(self.compiled_envs):
            if each.writes_file:
                mine = episodes[episodes["env"] == i]
                each.write_monitor_rows(mine["episode_return"], mine["length"])
        if model.episode_series:
            rest = (episodes[name].copy() for name in ("length", "mu", "epsilon"))
            kept = Episodes(_round_as_monitor(episodes["episode_return"]), *rest)
            for series in model.episode_series:
                series.add(kept)

    def _episode_infos(self, start: int, stop: int) -> list[tuple[int, dict[str, Any]]]:
        """Episodes of the rollout, each with the number of its environment, as the Monitors would give them."""
        if start == stop:
            return []
        rows = self.episodes[start:stop]
        columns = (rows["env"], rows["episode_return"], rows["length"])
        times = [each.seconds for each in self.compiled_envs]
        return [
            (i, {"r": round(episode_return, 6), "l": length, "t": seconds})
            for i, episode_return, length in zip(*(column.tolist() for column in columns), strict=True)
            if (seconds := times[i]) is not None
        ]


def _round_as_monitor(returns: np.ndarray) -> np.ndarray:
    """Round to six decimals as Python does, because NumPy sometimes rounds otherwise. Whole numbers need no rounding."""
    rounded = np.rint(returns)
    if not (rounded == returns).all():
        for i in np.flatnonzero(rounded != returns):
            rounded[i] = round(float(returns[i]), 6)
    return rounded
