"""
The fused loop: an environment's dynamics and the functions of :mod:`sb3_adaptive_q.kernels`, compiled into one.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit, types
from numba.extending import overload
from numba.np.unsafe.ndarray import to_fixed_tuple

from sb3_adaptive_q import kernels
from sb3_adaptive_q.compilation import CachedFunction
from sb3_adaptive_q.function_set_type import INLINED, container_of, make_compilable
from sb3_adaptive_q.vec_env.dynamics import RATE_OUT_OF_RANGE, SOUND


def name_parameters(dynamics, parameters):
    """The parameters as the named tuple that the dynamics expect; by name, so that the disk cache needs no user's class."""


@overload(name_parameters, jit_options=INLINED)
def _name_parameters(dynamics, parameters):
    container = container_of(dynamics)
    if container is tuple:
        return lambda dynamics, parameters: parameters
    return lambda dynamics, parameters: container(*parameters)


def load_state(states, i, template):
    """Row i of the states, as a number or a tuple like the template."""


def store_state(states, i, state):
    """Put a state, a number or a tuple, into row i of the states."""


@overload(load_state, jit_options=INLINED)
def _load_state(states, i, template):
    if isinstance(template, types.BaseTuple):
        size = len(template)
        return lambda states, i, template: to_fixed_tuple(states[i], size)  # type: ignore[call-arg]
    number = types.int64 if isinstance(template, types.Integer) else types.float64
    return lambda states, i, template: number(states[i, 0])


@overload(store_state, jit_options=INLINED)
def _store_state(states, i, state):
    if isinstance(state, types.BaseTuple):
        size = len(state)

        def store(states, i, state):
            for j in range(size):
                states[i, j] = state[j]

        return store

    def store_number(states, i, state):
        states[i, 0] = state

    return store_number


class Lanes(NamedTuple):
    """
    Where each of the n environments stands, and the transition it made last. All are arrays of length n, but ``states``.

    :param states: the environments' own states, of shape (n, size of a state)
    :param lengths: steps since the episode began
    :param returns: rewards summed since the episode began
    :param indices: s_t, as rows of the table
    :param actions: a_t
    :param rewards: r_t
    :param next_indices: s_{t+1}, before any reset
    :param terminated: whether s_{t+1} is terminal
    :param dones: whether the transition ended the episode
    :param start_indices: where the environment is now: s_{t+1}, or the next episode's first state
    """

    states: np.ndarray
    lengths: np.ndarray
    returns: np.ndarray
    indices: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    next_indices: np.ndarray
    terminated: np.ndarray
    dones: np.ndarray
    start_indices: np.ndarray


class Lane(NamedTuple):
    """One environment of :class:`Lanes`."""

    state: Any
    length: int
    episode_return: float
    index: int  # type: ignore[assignment]  # not the tuple's method
    action: int
    reward: float
    next_index: int
    terminated: bool
    done: bool
    start_index: int


class Record(NamedTuple):
    """
    What a stretch leaves behind. The first is of shape (steps, n_envs), the others have a row for each episode.

    :param dones: whether a transition ended an episode
    :param returns: an episode's sum of rewards
    :param lengths: its steps
    :param rates: μ in force at its last transition
    :param epsilons: ε in force at its last transition
    :param lanes: the environment it was played in
    """

    dones: np.ndarray
    returns: np.ndarray
    lengths: np.ndarray
    rates: np.ndarray
    epsilons: np.ndarray
    lanes: np.ndarray


class Counters(NamedTuple):
    """
    What moves with every transition.

    :param mu: the step size of the next update
    :param epsilon: ε in force
    :param progress: the part of the training that is done
    :param n_episodes: finished episodes whose last transition has been learned
    """

    mu: float
    epsilon: float
    progress: float
    n_episodes: int


def load_lane(lanes, i, template):
    """Environment i, as a value that the compiler can keep in registers."""
    return Lane(
        load_state(lanes.states, i, template), lanes.lengths[i], lanes.returns[i], lanes.indices[i], lanes.actions[i],
        lanes.rewards[i], lanes.next_indices[i], lanes.terminated[i], lanes.dones[i], lanes.start_indices[i],
    )  # fmt: skip


def store_lane(lanes, i, lane):
    """Put environment i back."""
    store_state(lanes.states, i, lane.state)
    lanes.lengths[i] = lane.length
    lanes.returns[i] = lane.episode_return
    lanes.indices[i] = lane.index
    lanes.actions[i] = lane.action
    lanes.rewards[i] = lane.reward
    lanes.next_indices[i] = lane.next_index
    lanes.terminated[i] = lane.terminated
    lanes.dones[i] = lane.done
    lanes.start_indices[i] = lane.start_index


def advance_lane(dynamics, parameters, generator, max_episode_steps, lane):
    """
    Take one step and, where it ends the episode, reset the environment.

    :return: the lane after it; its length and return are still those of the episode that the step belongs to
    """
    state, reward, terminated = dynamics.step(parameters, lane.state, lane.action, generator)
    next_index = dynamics.index(parameters, state)
    length = lane.length + 1
    done = terminated or length >= max_episode_steps
    start_index = next_index
    if done:
        state = dynamics.reset(parameters, generator)
        start_index = dynamics.index(parameters, state)
    episode_return = lane.episode_return + reward
    reward = np.float32(reward)  # as a VecEnv hands it on
    return Lane(
        state, length, episode_return, lane.index, lane.action, reward, next_index, terminated, done, start_index
    )  # fmt: skip


def begin_episode(lane):
    """The lane with nothing counted yet."""
    return Lane(
        lane.state, 0, 0.0, lane.index, lane.action,
        lane.reward, lane.next_index, lane.terminated, lane.done, lane.start_index,
    )  # fmt: skip


def continue_lane(lane, action):
    """The lane with its last transition behind it, about to take the action."""
    return Lane(
        lane.state, lane.length, lane.episode_return, lane.start_index, action,
        lane.reward, lane.next_index, lane.terminated, lane.done, lane.start_index,
    )  # fmt: skip


def record_episode(record, row, lane, i, counters):
    """Note the episode that environment i has just finished."""
    record.returns[row] = lane.episode_return
    record.lengths[row] = lane.length
    record.rates[row] = counters.mu
    record.epsilons[row] = counters.epsilon
    record.lanes[row] = i


def learn_lane(table, generator, learner, rule, rule_parameters, counters, statistics, num_timesteps, lane):
    """
    Learn from the lane's last transition.

    :return: the lane about to take its next action, the counters and the statistics
    """
    action, epsilon, progress, n_episodes, transition = kernels.learn_transition(
        table, generator, learner, counters.mu, counters.epsilon, counters.progress, counters.n_episodes,
        num_timesteps, lane.index, lane.action, np.float64(lane.reward), lane.next_index, lane.terminated,
        lane.done, lane.start_index,
    )  # fmt: skip
    statistics = kernels.record_update(statistics, counters.mu, transition.td_error)
    mu = kernels.next_rate(rule, rule_parameters, learner, counters.mu, transition, lane.done)
    counters = Counters(mu, epsilon, progress, n_episodes)
    return continue_lane(lane, action), counters, statistics


for _lane_function in (load_lane, store_lane, advance_lane, begin_episode, continue_lane, record_episode, learn_lane):
    make_compilable(_lane_function)


@njit(nogil=True, _nrt=False)  # type: ignore[call-overload]  # counting references to the arrays in the loop would triple its time
def _stretch(
    dynamics, parameters, generators, template, max_episode_steps, lanes,
    table, generator, learner, rule, rule_parameters, counters, statistics, num_timesteps, record, max_steps, max_episodes,
):  # fmt: skip
    n_envs = len(generators)  # known to the compiler, as the number of environments is part of the type
    is_single = n_envs == 1  # then the lane stays in registers
    lane = load_lane(lanes, 0, template)
    flaw, step, n_ended = SOUND, 0, 0
    while True:
        for i in range(n_envs):
            lane = lane if is_single else load_lane(lanes, i, template)
            lane = advance_lane(dynamics, parameters, generators[i], max_episode_steps, lane)
            flaw = max(flaw, dynamics.flaw(lane.next_index, lane.start_index, lane.reward, table.shape[0]))
            if lane.done:
                record.dones[step, i] = True
                record_episode(record, n_ended, lane, i, counters)
                lane = begin_episode(lane)
                n_ended += 1
            if not is_single:
                store_lane(lanes, i, lane)
        step += 1
        if not 0.0 <= counters.mu <= 1.0:
            flaw = RATE_OUT_OF_RANGE
        if step == max_steps or n_ended >= max_episodes or flaw != SOUND:
            break
        num_timesteps += n_envs
        for i in range(n_envs):
            lane = lane if is_single else load_lane(lanes, i, template)
            lane, counters, statistics = learn_lane(
                table, generator, learner, rule, rule_parameters, counters, statistics, num_timesteps, lane
            )
            if not is_single:
                store_lane(lanes, i, lane)
    if is_single:
        store_lane(lanes, 0, lane)
    return flaw, step, n_ended, counters, statistics


def _run_stretch(
    dynamics, parameters, generators, template, max_episode_steps, lanes,
    table, generator, learner, rule, rule_parameters, counters, statistics, num_timesteps, record, max_steps, max_episodes,
):  # fmt: skip
    """
    Take steps in every environment and learn from all of them but the last, until ``max_steps`` are taken or
    ``max_episodes`` have ended.

    :return: (what is wrong with the last transition, steps, finished episodes, counters, statistics)
    """
    # The entry from Python counts references, once; the loop does not
    return _stretch(
        dynamics, name_parameters(dynamics, parameters), generators, template, max_episode_steps, lanes,
        table, generator, learner, rule, rule_parameters, counters, statistics, num_timesteps, record, max_steps, max_episodes,
    )  # fmt: skip


run_stretch = CachedFunction(_run_stretch, nogil=True)
