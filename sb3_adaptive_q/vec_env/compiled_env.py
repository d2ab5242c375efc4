"""One environment that learning loops can run as machine code."""

import time
from typing import Any

import gymnasium as gym
import numpy as np

from sb3_adaptive_q.checks import MOST_STEPS
from sb3_adaptive_q.vec_env import cart_pole_dynamics  # registers the Cart Poles  # noqa: F401
from sb3_adaptive_q.vec_env.dynamics import Dynamics, Grid, find_dynamics, registered_names
from sb3_adaptive_q.vec_env.layers import Layers, peel
from sb3_adaptive_q.vec_env.summed_rewards import SummedRewards
from sb3_adaptive_q.vec_env.tabular_dynamics import TabularDynamics, has_table, steps_by_table


class CompiledEnv:
    """
    One environment of a :class:`CompiledVecEnv`, as a compiled learning loop sees it.

    :param env: the environment with its wrappers
    :raises ValueError: if it does not compile
    """

    def __init__(self, env: gym.Env) -> None:
        self.unwrapped: Any = env.unwrapped
        self.layers = _peel_completely(env)
        if self.unwrapped.render_mode == "human":
            raise ValueError("render_mode='human' draws every step, but compiled code cannot draw: use LeanVecEnv to watch.")
        limit, discretizer = self.layers.limit, self.layers.discretizer
        self.max_episode_steps = limit._max_episode_steps if limit else MOST_STEPS
        self.dynamics = _dynamics_of(self.unwrapped)(self.unwrapped, Grid.of(discretizer) if discretizer else None)
        self._left: tuple[Any, Any, Any] | None = None
        self._rewards: Any = SummedRewards()

    def is_like(self, other: "CompiledEnv") -> bool:
        """
        :param other: another environment
        :return: whether the same compiled functions and parameters serve both
        """
        if type(self.dynamics) is not type(other.dynamics) or self.max_episode_steps != other.max_episode_steps:
            return False
        pairs = zip(self.dynamics.parameters, other.dynamics.parameters, strict=True)
        return all(np.array_equal(mine, theirs) for mine, theirs in pairs)

    @property
    def episode_length(self) -> int:
        """Steps since the last reset."""
        if self.layers.limit:
            return int(self.layers.limit._elapsed_steps or 0)
        return len(self.layers.monitor.rewards) if self.layers.monitor else 0

    @property
    def episode_return(self) -> float:
        """The sum of rewards since the last reset; 0 without a Monitor, which keeps them."""
        return float(sum(self.layers.monitor.rewards)) if self.layers.monitor else 0.0

    def put(self, state: Any, length: int, episode_return: float, n_steps: int) -> None:
        """
        Put the environment and its wrappers into the state in which a rollout ended.

        :param state: the state of the environment
        :param length: steps since the last reset
        :param episode_return: the sum of rewards since then
        :param n_steps: the steps of the rollout
        """
        self.dynamics.write_state(state)
        if self.layers.limit:
            self.layers.limit._elapsed_steps = length
        monitor = self.layers.monitor
        if monitor is not None:
            # A Monitor sums and counts the rewards at the end of the episode, so single rewards need not be kept
            self._rewards.total, self._rewards.count = episode_return, length
            monitor.rewards = self._rewards
            monitor.total_steps += n_steps
        self._left = self._place()

    def read_state(self, n_states: int) -> Any:
        """
        :param n_states: the rows of the table
        :return: the state of the environment
        :raises ValueError: if the state is not in the table: machine code would read outside of the table
        """
        state = self.dynamics.read_state()
        try:
            row = self.dynamics.index(self.dynamics.parameters, state) if _is_known(state) else -1
        except (IndexError, OverflowError, ValueError):
            row = -1
        if not 0 <= row < n_states:
            raise ValueError(
                f"{type(self.unwrapped).__name__} was put into the state {state}, which does not exist: the table has rows 0 "
                f"to {n_states - 1}."
            )
        return state

    def was_moved(self) -> bool:
        """
        :return: whether other code, such as a callback, has stepped, reset or seeded the environment since :meth:`put`
        """
        if self._left is None:
            return True
        state, generator, rewards = self._place()
        return state != self._left[0] or generator is not self._left[1] or rewards is not self._left[2]

    def _place(self) -> tuple[Any, Any, Any]:
        monitor = self.layers.monitor
        return self.dynamics.read_state(), self.unwrapped.np_random, None if monitor is None else monitor.rewards

    @property
    def seconds(self) -> float | None:
        """Seconds since the Monitor was made; ``None`` without a Monitor."""
        monitor = self.layers.monitor
        return None if monitor is None else round(time.time() - monitor.t_start, 6)

    @property
    def writes_file(self) -> bool:
        """Whether there is a Monitor that writes a file."""
        return self.layers.monitor is not None and self.layers.monitor.results_writer is not None

    def write_monitor_rows(self, returns: np.ndarray, lengths: np.ndarray) -> None:
        """
        Write finished episodes to the Monitor's file.

        :param returns: the sum of rewards of each episode
        :param lengths: the steps of each episode
        """
        assert self.layers.monitor is not None and self.layers.monitor.results_writer is not None
        seconds = self.seconds
        for episode_return, length in zip(returns.tolist(), lengths.tolist(), strict=True):
            row = {"r": round(episode_return, 6), "l": length, "t": seconds}
            self.layers.monitor.results_writer.write_row(row)


def _is_known(state: Any) -> bool:
    return bool(np.isfinite(state).all()) and (isinstance(state, tuple) or abs(state) < 2**53)  # so far floats are exact


def _dynamics_of(env: gym.Env) -> type[Dynamics]:
    patched = sorted({"step", "reset"} & set(vars(env)))
    if patched:
        raise ValueError(
            f"CompiledVecEnv compiles `step` and `reset` of the class {type(env).__name__}, but `{patched[0]}` of this "
            "environment was replaced: use LeanVecEnv, which works with everything."
        )
    dynamics = find_dynamics(env)
    if dynamics is not None:
        return dynamics
    if steps_by_table(env):
        return TabularDynamics
    if has_table(env):
        raise ValueError(
            f"{type(env).__name__} has a transition table `P`, but its `step` or `reset` may do more than draw from it. If "
            "they do not, set the class attribute `compile_by_table = True`, or call "
            "`register_dynamics(MyEnv)(TabularDynamics)`. Otherwise use LeanVecEnv, which works with everything."
        )
    raise ValueError(
        f"CompiledVecEnv cannot compile {type(env).__name__}: it compiles gymnasium's FrozenLake, Taxi and CliffWalking, "
        f"classes with `compile_by_table = True`, and {', '.join(registered_names())}. Register its dynamics with "
        "`register_dynamics`, or use LeanVecEnv, which works with everything."
    )


def _peel_completely(env: gym.Env) -> Layers:
    layers = peel(env)
    if isinstance(layers.inner, gym.Wrapper):
        kind = type(layers.inner)
        raise ValueError(
            f"CompiledVecEnv cannot compile the wrapper {kind.__qualname__} of {kind.__module__} in this place. It compiles, "
            "from the outside to the inside: Monitor and DiscretizeObservation (this package's or gymnasium's) in either "
            "order, TimeLimit, and gymnasium's own checks. Use LeanVecEnv, which works with everything."
        )
    if layers.monitor is not None and layers.monitor.info_keywords:
        raise ValueError(
            f"Compiled environments give no infos, but the Monitor records {layers.monitor.info_keywords} of them: leave out "
            "`info_keywords`, or use LeanVecEnv, which works with everything."
        )
    return layers
