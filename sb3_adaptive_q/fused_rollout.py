"""How transitions are made and learned from on a compiled environment: a stretch of them at a time."""

from math import ceil
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import config
from numba.core.errors import NumbaError
from stable_baselines3.common.callbacks import BaseCallback

from sb3_adaptive_q import fused, kernels
from sb3_adaptive_q.rollouts import HOLD, Episodes, StepRollout
from sb3_adaptive_q.stretches import episodes_until_due, skip_steps, steps_until_due
from sb3_adaptive_q.vec_env.compiled_vec_env import CompiledVecEnv
from sb3_adaptive_q.vec_env.dynamics import RATE_OUT_OF_RANGE, REWARD_NOT_FINITE, STATE_OUT_OF_RANGE

if TYPE_CHECKING:
    from sb3_adaptive_q.tabular_q import TabularQ

#: Transitions between two calls of a user's callback: where a stretch's fixed cost is lost in it, 20 ms with FrozenLake
DEFAULT_INTERVAL = 1_000_000


class FusedRollout(StepRollout):
    """
    Steps the environments many times, learning in between, and leaves the last transition of each unlearned: a callback
    finds the table as it would on the per-step path, and :meth:`learn` is the per-step path's own.

    :param model: the model that learns
    :param learner: what stays as it is in this training
    :param step_locals: the variables that callbacks see
    :param callback: what is called after every stretch; SB3's own callbacks in it bound the stretches
    """

    env: CompiledVecEnv

    def __init__(
        self, model: "TabularQ", learner: kernels.Learner, step_locals: dict[str, Any], callback: BaseCallback
    ) -> None:
        if config.DISABLE_JIT:  # type: ignore[attr-defined]
            raise ValueError("A CompiledVecEnv needs Numba's compiler: please unset NUMBA_DISABLE_JIT, or use LeanVecEnv.")
        super().__init__(model, learner, step_locals)
        self.callback = callback
        self.twins = self.env.compile()
        self.dynamics = self.twins[0].dynamics.function_set()
        self.parameters = tuple(self.twins[0].dynamics.parameters)
        self.template = self.twins[0].dynamics.read_state()
        self.lanes = _empty_lanes(self.env.num_envs, np.size(self.template))
        interval = model.callback_interval or max(DEFAULT_INTERVAL // self.env.num_envs, 1)
        self.interval = min(interval, max(self._steps_left(), 1))
        self.record = _empty_record(self.interval * self.env.num_envs)

    def advance(self) -> None:
        """
        Run a stretch. Callbacks then find what they would on the per-step path after its last step, but for ``dones``:
        whether an episode ended, for every step of the stretch, of shape (steps, n_envs).

        :raises ValueError: as on the per-step path, or if the rule or the dynamics do not compile or leave their range
        """
        max_steps, max_episodes = self._limits()
        dones = np.zeros((max_steps, self.env.num_envs), dtype=bool)
        n_steps = self._run(dones, max_steps, max_episodes)
        skip_steps(self.callback, n_steps - 1, self.env.num_envs)
        lanes = self.lanes
        for i, twin in enumerate(self.twins):
            state = lanes.states[i].tolist() if isinstance(self.template, tuple) else lanes.states[i, 0]
            twin.put(state, int(lanes.lengths[i]), float(lanes.returns[i]), n_steps)
        self.dones = lanes.dones.tolist()
        self.infos = self._last_infos()
        self._hand_over_episodes()
        self.transitions = list(
            zip(
                lanes.rewards.tolist(), lanes.next_indices.tolist(), lanes.terminated.tolist(), self.dones,
                lanes.start_indices.tolist(), strict=True,
            )
        )  # fmt: skip
        new_obs = self.state_index.observations(lanes.start_indices)
        self._show(self._action_array + self.first_action, new_obs, lanes.rewards.copy(), dones[:n_steps], self.infos)

    def finished_episodes(self) -> Episodes:
        record, end = self.record, self.n_ended
        return Episodes(
            _round_as_monitor(record.returns[:end]), record.lengths[:end].copy(), record.rates[:end].copy(),
            record.epsilons[:end].copy(),
        )  # fmt: skip

    def _steps_left(self) -> int:
        return ceil((self.model._total_timesteps - self.model.num_timesteps) / self.env.num_envs)

    def _limits(self) -> tuple[int, int]:
        model, n_envs = self.model, self.env.num_envs
        episodes_left = model._total_episodes - model._episode_num
        max_steps = min(self.interval, self._steps_left(), steps_until_due(self.callback, model.num_timesteps, n_envs))
        max_episodes = min(episodes_left, episodes_until_due(self.callback), 2**62)
        return int(max_steps), int(max_episodes)

    def _run(self, dones: np.ndarray, max_steps: int, max_episodes: int) -> int:
        model, lanes = self.model, self.lanes
        self._read_lanes()
        if model._rule is not self._rule:
            self._take_rule()
        lanes.actions[:] = self._action_array
        lanes.indices[:] = self.states
        counters = fused.Counters(model.mu, model.exploration_rate, self.progress, model._episode_num)
        try:
            flaw, n_steps, self.n_ended, counters, statistics = fused.run_stretch(
                self.dynamics, self.parameters, self.generators, self.template, self.twins[0].max_episode_steps, lanes,
                model._table, model._generator, self.learner, model._rule, model._rule_arguments,
                counters, tuple(self.statistics.tolist()), model.num_timesteps,
                self.record._replace(dones=dones), max_steps, max_episodes,
            )  # fmt: skip
        except NumbaError as error:
            if model._rate is None and model._rule is not HOLD:
                raise ValueError(
                    "A `learning_rate` that is a Python function does not compile: a compiled environment takes a number, "
                    "or a method such as Methods 3 and 4; LeanVecEnv takes any function."
                ) from error
            raise ValueError(
                f"The rule {model._rule.name} or the dynamics {self.dynamics.name} do not compile. A compiled environment "
                "takes a constant `learning_rate`, or the rule of a LearningRateCallback in the part of Python that Numba "
                f"knows; LeanVecEnv runs any Python function. What Numba says:\n{error}"
            ) from error
        model._n_updates += (n_steps - 1) * self.env.num_envs
        model._mu[0], model.exploration_rate, self.progress, model._episode_num = counters
        model.num_timesteps += n_steps * self.env.num_envs
        self.statistics[:] = statistics
        self._action_array[:] = lanes.actions
        self.states[:] = lanes.indices.tolist()
        if flaw == REWARD_NOT_FINITE:
            i = int(np.argmin(np.isfinite(lanes.rewards)))
            self._refuse_reward(i, float(lanes.rewards[i]))
        if flaw == RATE_OUT_OF_RANGE:
            model._refuse_rate(model.mu)
        if flaw == STATE_OUT_OF_RANGE:
            raise ValueError(
                f"`index` of {self.dynamics.name} must give rows 0 to {len(model._table) - 1}, but at step "
                f"{model.num_timesteps} it gave {lanes.next_indices.tolist()}, after a reset {lanes.start_indices.tolist()}."
            )
        return int(n_steps)

    def _last_infos(self) -> list[dict[str, Any]]:
        """What the environments would have said of the last transition."""
        infos: list[dict[str, Any]] = []
        for i, done in enumerate(self.dones):
            info: dict[str, Any] = {"TimeLimit.truncated": done and not bool(self.lanes.terminated[i])}
            if done:
                info["terminal_observation"] = self.state_index.observations(self.lanes.next_indices[i : i + 1])[0]
            infos.append(info)
        # The last step's episodes are the last on the record
        for i, episode in self._episode_infos(self.n_ended - sum(self.dones), self.n_ended):
            infos[i]["episode"] = episode
        return infos

    def _hand_over_episodes(self) -> None:
        """Write the Monitors' files; give the log what ended before the last step, whose own follow the callbacks."""
        assert self.model.ep_info_buffer is not None
        earlier = self.n_ended - sum(self.dones)
        episodes = self._episode_infos(max(earlier - self.model._stats_window_size, 0), earlier)
        self.model.ep_info_buffer.extend(episode for _, episode in episodes)
        record, end = self.record, self.n_ended
        for i, twin in enumerate(self.twins):
            if twin.writes_file:
                mine = record.lanes[:end] == i
                twin.write_monitor_rows(record.returns[:end][mine], record.lengths[:end][mine])

    def _episode_infos(self, start: int, stop: int) -> list[tuple[int, dict[str, Any]]]:
        """Some of the stretch's episodes, with the number of the environment, as the Monitors would have them."""
        columns = (self.record.lanes[start:stop], self.record.returns[start:stop], self.record.lengths[start:stop])
        times = [twin.seconds for twin in self.twins]
        return [
            (i, {"r": round(episode_return, 6), "l": length, "t": seconds})
            for i, episode_return, length in zip(*(column.tolist() for column in columns), strict=True)
            if (seconds := times[i]) is not None
        ]

    def _read_lanes(self) -> None:
        """Where the environments are: where the last stretch left them, unless a callback has moved one since."""
        for i, twin in enumerate(self.twins):
            if twin.was_moved():
                self.lanes.states[i] = twin.dynamics.read_state()
                self.lanes.lengths[i] = twin.episode_length
                self.lanes.returns[i] = twin.episode_return
        self.generators = tuple(twin.unwrapped.np_random for twin in self.twins)


def _empty_lanes(n_envs: int, state_size: int) -> fused.Lanes:
    return fused.Lanes(
        states=np.zeros((n_envs, state_size)),
        lengths=np.zeros(n_envs, dtype=np.int64),
        returns=np.zeros(n_envs),
        indices=np.zeros(n_envs, dtype=np.int64),
        actions=np.zeros(n_envs, dtype=np.int64),
        rewards=np.zeros(n_envs, dtype=np.float32),
        next_indices=np.zeros(n_envs, dtype=np.int64),
        terminated=np.zeros(n_envs, dtype=bool),
        dones=np.zeros(n_envs, dtype=bool),
        start_indices=np.zeros(n_envs, dtype=np.int64),
    )


def _empty_record(n_rows: int) -> fused.Record:
    return fused.Record(
        dones=np.zeros((0, 0), dtype=bool),
        returns=np.empty(n_rows),
        lengths=np.empty(n_rows, dtype=np.int64),
        rates=np.empty(n_rows),
        epsilons=np.empty(n_rows),
        lanes=np.empty(n_rows, dtype=np.int64),
    )


def _round_as_monitor(returns: np.ndarray) -> np.ndarray:
    """Six decimals by Python's own rounding, which NumPy's does not always equal; whole numbers need none."""
    rounded = returns.copy()
    for i in np.flatnonzero(returns != np.rint(returns)):
        rounded[i] = round(float(returns[i]), 6)
    return rounded
