"""
Q-learning as bare loops, written from the equations: environment, update and nothing around them.

They draw the numbers that :class:`sb3_adaptive_q.TabularQ` draws, from generators in the same state, and end with the same
table, bit for bit: no statistics, no episode record, no callback, no interface, and all constants known to the compiler.
"""

import math
from collections.abc import Callable

import gymnasium as gym
import numpy as np
from numba import njit

from benchmarks.grid import N_EDGES, POLE_BOUNDS
from sb3_adaptive_q.random_numbers import first_counter, uniform

GAMMA = 0.99
EPSILON, EPSILON_SLOPE = 1.0, 0.05 - 1.0
LAKE_STEPS, POLE_STEPS = 100, 200
INLINED = {"forceinline": True}
#: No references to the arrays are counted in the loop, which costs a third of its speed, and no divisor is checked
BARE = {"nogil": True, "_nrt": False, "error_model": "numpy"}


@njit(**INLINED)
def constant(mu, value, next_value):
    """Method 1: μ is β1 from the start."""
    return mu


@njit(**INLINED)
def by_sign(mu, value, next_value):
    """Method 7."""
    change = 0.005 if next_value >= value else -0.005
    return min(max(mu + change, 0.001), 0.01)


#: The rules by the number of the method
RULES = {1: constant, 7: by_sign}


@njit(**INLINED)
def polynomial_size(memory, state, action, error):
    """1 / n^0.8."""
    memory[0][state, action] += 1.0
    return 1.0 / memory[0][state, action] ** 0.8


@njit(**INLINED)
def bakf_size(memory, state, action, error):
    """The bias-adjusted Kalman filter, with a target of 0.05."""
    counts, weights, biases, squares, factors = memory
    counts[state, action] += 1.0
    count, weight = counts[state, action], 1.0
    if count > 1.0:
        weight = weights[state, action] / (weights[state, action] + (1.0 - 0.05))
    bias = (1.0 - weight) * biases[state, action] + weight * error
    square = (1.0 - weight) * squares[state, action] + weight * error * error
    factor = factors[state, action]
    if count <= 2.0:
        size = 1.0 / count
    elif square == 0.0:
        size = factor / (1.0 + factor)
    else:
        size = 1.0 - max(square - bias * bias, 0.0) / (1.0 + factor) / square
    weights[state, action], biases[state, action], squares[state, action] = weight, bias, square
    factors[state, action] = (1.0 - size) * (1.0 - size) * factor + size * size
    return min(max(size, 0.0), 1.0)


@njit(**INLINED)
def autostep_size(memory, state, action, error):
    """Autostep, with a meta step size of 0.01 and tau = 10 000."""
    sizes, traces, largests = memory
    size, trace = sizes[state, action], traces[state, action]
    change, largest = error * trace, largests[state, action]
    largest = max(abs(change), largest + size / 1e4 * (abs(change) - largest))
    if largest != 0.0:
        size *= math.exp(0.01 * (change / largest))
    size = min(size, 1.0)
    sizes[state, action], largests[state, action] = size, largest
    traces[state, action] = trace * (1.0 - size) + size * error
    return size


#: Step sizes with memory by name, with what each of their arrays starts from
SIZES = {
    "polynomial": (polynomial_size, (0.0,)),
    "bakf": (bakf_size, (0.0, 0.0, 0.0, 0.0, 0.0)),
    "autostep": (autostep_size, (0.1, 0.0, 0.0)),
}

draw = njit(**INLINED)(uniform)


def agent_counter(seed: int) -> np.ndarray:
    """
    :param seed: of the model
    :return: the counter that the model's agent begins to draw from
    """
    return np.array([first_counter(np.random.SeedSequence(seed).spawn(1)[0])], dtype=np.uint64)


@njit(**INLINED)
def choose(table, state, epsilon, agent):
    if draw(agent) < epsilon:
        return int(draw(agent) * table.shape[1])
    best, value = 0, table[state, 0]
    for action in range(1, table.shape[1]):
        if table[state, action] > value:
            best, value = action, table[state, action]
    return best


@njit(**INLINED)
def largest(table, state):
    best = table[state, 0]
    for action in range(1, table.shape[1]):
        if table[state, action] > best:
            best = table[state, action]
    return best


@njit(**INLINED)
def look_ahead(table, state, action, value, next_state, terminated, epsilon, agent):
    """The action to take next, and its value before the update."""
    if terminated:
        return 0, 0.0
    next_action = choose(table, next_state, epsilon, agent)
    is_same = next_state == state and next_action == action
    return next_action, value if is_same else table[next_state, next_action]


def lake_arrays() -> tuple[np.ndarray, ...]:
    """
    :return: of FrozenLake's transitions, in arrays of shape (states, actions, outcomes), the cumulative probabilities but the
        last, the next states, the rewards, and whether they are terminal
    """
    table = gym.make("FrozenLake-v1").unwrapped.P  # type: ignore[attr-defined]
    shape = (16, 4, 3)
    cumulative, rewards = np.full(shape, np.inf), np.zeros(shape)
    next_states, terminal = np.zeros(shape, dtype=np.int64), np.zeros(shape, dtype=bool)
    for state, action in np.ndindex(16, 4):
        total = np.cumsum([outcome[0] for outcome in table[state][action]])
        for i, (_, next_state, reward, terminated) in enumerate(table[state][action]):
            cumulative[state, action, i], next_states[state, action, i] = total[i], next_state
            rewards[state, action, i], terminal[state, action, i] = reward, terminated
    return cumulative[:, :, :2].copy(), next_states, rewards, terminal


@njit(**INLINED)
def lake_outcome(cumulative, state, action, environment):
    number, outcome = environment.random(), 0
    for i in range(2):
        outcome += 1 if cumulative[state, action, i] <= number else 0
    return outcome


def make_lake_loop(method: int) -> Callable[[int, int], np.ndarray]:
    """
    :param method: 1 or 7
    :return: a function of the seed and the number of steps that returns the table which FrozenLake-v1 teaches
    """
    rule = RULES[method]

    @njit(**BARE)
    def loop(cumulative, next_states, rewards, terminal, table, environment, agent, n_steps):
        environment.random()  # the first state is always 0
        state, length, mu = 0, 0, 0.01
        action = choose(table, state, EPSILON, agent)
        for step in range(1, n_steps + 1):
            outcome = lake_outcome(cumulative, state, action, environment)
            next_state, terminated = next_states[state, action, outcome], terminal[state, action, outcome]
            length += 1
            value = table[state, action]
            best = 0.0 if terminated else largest(table, next_state)
            table[state, action] = value + mu * (rewards[state, action, outcome] + GAMMA * best - value)
            epsilon = EPSILON + EPSILON_SLOPE * (step / n_steps)
            next_action, next_value = look_ahead(table, state, action, value, next_state, terminated, epsilon, agent)
            mu = rule(mu, value, next_value)
            if terminated or length >= LAKE_STEPS:
                environment.random()
                next_state, length = 0, 0
                next_action = choose(table, next_state, epsilon, agent)
            state, action = next_state, next_action

    arrays = lake_arrays()

    def learn(seed: int, n_steps: int) -> np.ndarray:
        table = np.zeros((16, 4))
        loop(*arrays, table, np.random.default_rng(seed), agent_counter(seed), n_steps)
        return table

    return learn


def make_memory_loop(name: str) -> Callable[[int, int], np.ndarray]:
    """
    :param name: a key of ``SIZES``
    :return: as :func:`make_lake_loop`, with a step size for each entry
    """
    size, starts = SIZES[name]

    @njit(**BARE)
    def loop(cumulative, next_states, rewards, terminal, table, memory, environment, agent, n_steps):
        environment.random()  # the first state is always 0
        state, length = 0, 0
        action = choose(table, state, EPSILON, agent)
        for step in range(1, n_steps + 1):
            outcome = lake_outcome(cumulative, state, action, environment)
            next_state, terminated = next_states[state, action, outcome], terminal[state, action, outcome]
            length += 1
            value = table[state, action]
            best = 0.0 if terminated else largest(table, next_state)
            error = rewards[state, action, outcome] + GAMMA * best - value
            table[state, action] = value + size(memory, state, action, error) * error
            epsilon = EPSILON + EPSILON_SLOPE * (step / n_steps)
            next_action = 0 if terminated else choose(table, next_state, epsilon, agent)
            if terminated or length >= LAKE_STEPS:
                environment.random()
                next_state, length = 0, 0
                next_action = choose(table, next_state, epsilon, agent)
            state, action = next_state, next_action

    arrays = lake_arrays()

    def learn(seed: int, n_steps: int) -> np.ndarray:
        table, memory = np.zeros((16, 4)), tuple(np.full((16, 4), start) for start in starts)
        loop(*arrays, table, memory, np.random.default_rng(seed), agent_counter(seed), n_steps)
        return table

    return learn


@njit(**INLINED)
def pole_cell(edges, x, x_dot, theta, theta_dot):
    index = 0
    for dimension in range(4):
        value = x if dimension == 0 else x_dot if dimension == 1 else theta if dimension == 2 else theta_dot
        shown = np.float64(np.float32(value))
        cell = 0
        for i in range(N_EDGES):
            cell += 1 if edges[dimension, i] <= shown else 0
        index = index * (N_EDGES + 1) + cell
    return index


@njit(**INLINED)
def pole_start(environment):
    return -0.05 + 0.1 * environment.random()


def make_pole_loop(method: int) -> Callable[[int, int], np.ndarray]:
    """
    :param method: 1 or 7
    :return: a function of the seed and the number of steps that returns the table which CartPoleFriction-v0 teaches
    """
    rule = RULES[method]

    @njit(**BARE)
    def loop(edges, table, environment, agent, n_steps):
        x, x_dot = pole_start(environment), pole_start(environment)
        theta, theta_dot = pole_start(environment), pole_start(environment)
        state, length, mu = pole_cell(edges, x, x_dot, theta, theta_dot), 0, 0.01
        action = choose(table, state, EPSILON, agent)
        for step in range(1, n_steps + 1):
            force = 10.0 if action == 1 else -10.0
            cos, sin = math.cos(theta), math.sin(theta)
            sign = 1.0 if x_dot > 0.0 else (-1.0 if x_dot < 0.0 else 0.0)
            drive = (force + 0.05 * (theta_dot * theta_dot) * sin - 0.0005 * sign) / 1.1
            turn = (9.8 * sin - cos * drive - 0.000002 * theta_dot / 0.05) / (0.5 * (4.0 / 3.0 - 0.1 * (cos * cos) / 1.1))
            push = drive - 0.05 * turn * cos / 1.1
            x, x_dot = x + 0.02 * x_dot, x_dot + 0.02 * push
            theta, theta_dot = theta + 0.02 * theta_dot, theta_dot + 0.02 * turn
            terminated = not (-2.4 < x < 2.4 and -0.2095 < theta < 0.2095)
            next_state = pole_cell(edges, x, x_dot, theta, theta_dot)
            length += 1
            value = table[state, action]
            target = 0.0 if terminated else 1.0 + GAMMA * largest(table, next_state)
            table[state, action] = value + mu * (target - value)
            epsilon = EPSILON + EPSILON_SLOPE * (step / n_steps)
            next_action, next_value = look_ahead(table, state, action, value, next_state, terminated, epsilon, agent)
            mu = rule(mu, value, next_value)
            if terminated or length >= POLE_STEPS:
                x, x_dot = pole_start(environment), pole_start(environment)
                theta, theta_dot = pole_start(environment), pole_start(environment)
                next_state, length = pole_cell(edges, x, x_dot, theta, theta_dot), 0
                next_action = choose(table, next_state, epsilon, agent)
            state, action = next_state, next_action

    edges = np.stack([np.linspace(-bound, bound, N_EDGES) for bound in POLE_BOUNDS])

    def learn(seed: int, n_steps: int) -> np.ndarray:
        table = np.zeros(((N_EDGES + 1) ** 4, 2))
        loop(edges, table, np.random.default_rng(seed), agent_counter(seed), n_steps)
        return table

    return learn
