"""
The records that machine code reads and writes in place, and the values that a loop works with: the compiler keeps values in
registers, and must go to the memory for every field of a record.
"""

from typing import NamedTuple

import numpy as np

from sb3_adaptive_q.algorithms.td_update import Transition


class Fixed(NamedTuple):
    """What a training holds fixed; see ``LEARNER``."""

    gamma: float
    exploration_initial: float
    exploration_final: float
    exploration_fraction: float
    mu_0: float
    total_timesteps: int
    total_episodes: int
    next_action: int
    resets_mu: int
    holds_mu: int
    holds_epsilon: int


class Now(NamedTuple):
    """What every transition moves; see ``LEARNER``."""

    mu: float
    epsilon: float
    progress: float
    n_episodes: int
    n_updates: int
    mu_sum: float
    mu_min: float
    mu_max: float
    td_error_sum: float


def _fields(kind: type) -> list[tuple[str, type]]:
    """The fields of a named tuple, as those of a record."""
    return [(name, {float: np.float64, int: np.int64, bool: np.bool_}[of]) for name, of in kind.__annotations__.items()]


#: The scalars of a learner: what a training holds fixed, what every transition moves, and the agent's random counter
LEARNER = np.dtype(
    [
        *_fields(Fixed), *_fields(Now), ("num_timesteps", np.int64), ("n_logged", np.int64), ("value", np.float64),
        ("refused_size", np.float64), ("refused_mu", np.float64), ("refused_epsilon", np.float64),
        ("refused_action", np.int64), ("counter", np.uint64),
    ]
)  # fmt: skip
#: An environment: its last transition, and the episode that it is in
ENV = np.dtype([*_fields(Transition), ("length", np.int64), ("episode_return", np.float64)], align=True)
#: A finished episode: sum of rewards, steps, μ and ε in force at its last transition, number of the environment
EPISODE = np.dtype(
    [
        ("episode_return", np.float64), ("length", np.int64), ("mu", np.float64), ("epsilon", np.float64), ("env", np.int64),
    ]
)  # fmt: skip
#: How far a rollout may go, and how far it went
CONTROL = np.dtype(
    [
        ("pending", np.int64), ("max_steps", np.int64), ("max_episodes", np.int64), ("max_episode_steps", np.int64),
        ("status", np.int64), ("n_steps", np.int64), ("n_ended", np.int64), ("env", np.int64),
    ]
)  # fmt: skip


def load_fixed(learner):
    """The scalars that a training holds fixed, as values, which the compiler keeps in registers."""
    return Fixed(
        learner.gamma, learner.exploration_initial, learner.exploration_final, learner.exploration_fraction, learner.mu_0,
        learner.total_timesteps, learner.total_episodes, learner.next_action, learner.resets_mu, learner.holds_mu,
        learner.holds_epsilon,
    )  # fmt: skip


def load_now(learner):
    """The scalars that every transition moves, as values."""
    return Now(
        learner.mu, learner.epsilon, learner.progress, learner.n_episodes, learner.n_updates, learner.mu_sum,
        learner.mu_min, learner.mu_max, learner.td_error_sum,
    )  # fmt: skip


def store_now(learner, now):
    """Put back what every transition moves."""
    learner.mu, learner.epsilon, learner.progress, learner.n_episodes = now.mu, now.epsilon, now.progress, now.n_episodes
    learner.n_updates, learner.mu_sum, learner.mu_min, learner.mu_max = now.n_updates, now.mu_sum, now.mu_min, now.mu_max
    learner.td_error_sum = now.td_error_sum


def load_transition(env):
    """The last transition of an environment, as values."""
    return Transition(
        env.state, env.action, env.reward, env.next_state, env.terminated, env.done, env.start_state
    )  # fmt: skip


def store_transition(env, t):
    """Put back the last transition of an environment."""
    env.state, env.action, env.reward, env.next_state = t.state, t.action, t.reward, t.next_state
    env.terminated, env.done, env.start_state = t.terminated, t.done, t.start_state


def note_episode(ended, length, episode_return, now, env):
    """Write a finished episode down."""
    ended.length, ended.episode_return, ended.env = length, episode_return, env
    ended.mu, ended.epsilon = now.mu, now.epsilon


def store_control(control, pending, status, n_steps, n_ended, env):
    """Write down how far a rollout went."""
    control.status, control.n_steps, control.n_ended, control.env = status, n_steps, n_ended, env
    control.pending = 1 if pending else 0
