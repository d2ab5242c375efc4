"""
Q-learning as the fastest loops we could write where the draws need not be anyone else's: one number of the cheapest
generator for each step, no branch where it would be mispredicted, the table's shape and the environment known to the compiler.

They learn what the others learn, but from other draws: what they gain is the price of drawing as gymnasium does.
"""

from collections.abc import Callable

import numpy as np
from numba import njit

from benchmarks.bare_loops import (
    BARE,
    EPSILON,
    EPSILON_SLOPE,
    GAMMA,
    INLINED,
    LAKE_STEPS,
    POLE_STEPS,
    RULES,
    lake_arrays,
)
from benchmarks.grid import N_EDGES, POLE_BOUNDS

GOLDEN = np.uint64(0x9E3779B97F4A7C15)
FIRST, SECOND = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
LOW_HALF, HALF = np.uint64(0xFFFFFFFF), np.uint64(32)
N_CELLS = np.uint64(N_EDGES + 1)
#: Cells per unit of each dimension, and the cell of 0
SCALES = tuple((N_EDGES - 1) / (2.0 * bound) for bound in POLE_BOUNDS)
CENTRE = 1.0 + (N_EDGES - 1) / 2.0


@njit(**INLINED)
def scramble(counter):
    """The output of SplitMix64 (Steele, Lea and Flood, 2014): its state is a counter, so no draw waits for another."""
    mixed = (counter ^ (counter >> np.uint64(30))) * FIRST
    mixed = (mixed ^ (mixed >> np.uint64(27))) * SECOND
    return mixed ^ (mixed >> np.uint64(31))


@njit(**INLINED)
def limit_of(epsilon):
    """What the upper half of a draw is below with probability ε."""
    return np.uint64(epsilon * 4294967296.0)


def make_lake_loop(method: int) -> Callable[[int, int], np.ndarray]:
    """
    :param method: 1 or 7
    :return: a function of the seed and the number of steps that returns the table which FrozenLake-v1 teaches
    """
    rule = RULES[method]

    @njit(**BARE)
    def loop(next_states, rewards, terminal, table, seed, n_steps):
        counter = np.uint64(seed)
        state, action, length, mu = np.uint64(0), np.uint64(0), 0, 0.01
        slope = EPSILON_SLOPE / n_steps
        for step in range(1, n_steps + 1):
            counter += GOLDEN
            number = scramble(counter)
            # Three outcomes of equal probability by the lower half; what is left of it is as good a number again
            product = (number & LOW_HALF) * np.uint64(3)
            next_state = next_states[state, action, product >> HALF]
            explored = (product & LOW_HALF) >> np.uint64(30)
            explores = (number >> HALF) < limit_of(EPSILON + slope * step)
            terminated = terminal[next_state]
            length += 1
            value = table[state, action]
            upper = table[next_state, 1] if table[next_state, 1] > table[next_state, 0] else table[next_state, 0]
            lower = table[next_state, 3] if table[next_state, 3] > table[next_state, 2] else table[next_state, 2]
            best = lower if lower > upper else upper  # of a terminal state 0: its row is never written
            table[state, action] = value + mu * (rewards[next_state] + GAMMA * best - value)
            reached = np.uint64(0) if terminated or length >= LAKE_STEPS else next_state
            length = 0 if terminated or length >= LAKE_STEPS else length
            upper_action = np.uint64(1) if table[reached, 1] > table[reached, 0] else np.uint64(0)
            lower_action = np.uint64(3) if table[reached, 3] > table[reached, 2] else np.uint64(2)
            greedy = lower_action if table[reached, lower_action] > table[reached, upper_action] else upper_action
            next_action = explored if explores else greedy
            is_same = next_state == state and next_action == action
            mu = rule(mu, value, value if is_same else table[next_state, next_action])
            state, action = reached, next_action

    _, next_states, rewards, terminal = lake_arrays()
    reward_of, terminal_of = np.zeros(16), np.zeros(16, dtype=bool)
    np.maximum.at(reward_of, next_states, rewards)
    np.logical_or.at(terminal_of, next_states, terminal)

    def learn(seed: int, n_steps: int) -> np.ndarray:
        table = np.zeros((16, 4))
        loop(next_states.astype(np.uint64), reward_of, terminal_of, table, seed, n_steps)
        return table

    return learn


@njit(**INLINED)
def cell_of(value, scale):
    """``np.digitize`` up to the rounding of the edges."""
    return np.uint64(min(max(value * scale + CENTRE, 0.0), float(N_EDGES)))


@njit(**INLINED)
def pole_cell(x, x_dot, theta, theta_dot):
    index = cell_of(x, SCALES[0])
    index = index * N_CELLS + cell_of(x_dot, SCALES[1])
    index = index * N_CELLS + cell_of(theta, SCALES[2])
    return index * N_CELLS + cell_of(theta_dot, SCALES[3])


@njit(**INLINED)
def sine_and_cosine(angle):
    """Taylor's polynomials; below 0.21 rad they are exact to 1e-13."""
    square = angle * angle
    sine = angle * (1.0 + square * (-1 / 6 + square * (1 / 120 + square * (-1 / 5040 + square / 362880))))
    cosine = 1.0 + square * (-1 / 2 + square * (1 / 24 + square * (-1 / 720 + square / 40320)))
    return sine, cosine


@njit(**INLINED)
def pole_start(counter):
    """Four numbers in ±0.05 from two draws."""
    first, second = scramble(counter + GOLDEN), scramble(counter + GOLDEN + GOLDEN)
    scale = 0.1 / 4294967296.0
    return (
        (first >> HALF) * scale - 0.05,
        (first & LOW_HALF) * scale - 0.05,
        (second >> HALF) * scale - 0.05,
        (second & LOW_HALF) * scale - 0.05,
    )


def make_pole_loop(method: int) -> Callable[[int, int], np.ndarray]:
    """
    :param method: 1 or 7
    :return: a function of the seed and the number of steps that returns the table which CartPoleFriction-v0 teaches
    """
    rule = RULES[method]

    @njit(**BARE, fastmath=True)
    def loop(table, seed, n_steps):
        counter = np.uint64(seed)
        x, x_dot, theta, theta_dot = pole_start(counter)
        state, action, length, mu = pole_cell(x, x_dot, theta, theta_dot), np.uint64(0), 0, 0.01
        slope = EPSILON_SLOPE / n_steps
        for step in range(1, n_steps + 1):
            counter += GOLDEN
            number = scramble(counter)
            sin, cos = sine_and_cosine(theta)
            sign = 1.0 if x_dot > 0.0 else (-1.0 if x_dot < 0.0 else 0.0)
            force = 20.0 * action - 10.0
            drive = (force + 0.05 * (theta_dot * theta_dot) * sin - 0.0005 * sign) * (1.0 / 1.1)
            turn = (9.8 * sin - cos * drive - 0.00004 * theta_dot) / (2.0 / 3.0 - (0.05 / 1.1) * (cos * cos))
            push = drive - (0.05 / 1.1) * turn * cos
            x, x_dot = x + 0.02 * x_dot, x_dot + 0.02 * push
            theta, theta_dot = theta + 0.02 * theta_dot, theta_dot + 0.02 * turn
            inside = abs(x) < 2.4 and abs(theta) < 0.2095
            next_state = pole_cell(x, x_dot, theta, theta_dot)
            length += 1
            value = table[state, action]
            best = table[next_state, 1] if table[next_state, 1] > table[next_state, 0] else table[next_state, 0]
            target = 1.0 + GAMMA * best if inside else 0.0
            table[state, action] = value + mu * (target - value)
            reached = next_state
            if not inside or length >= POLE_STEPS:
                x, x_dot, theta, theta_dot = pole_start(counter)
                reached, length = pole_cell(x, x_dot, theta, theta_dot), 0
                counter += GOLDEN + GOLDEN
            explores = (number >> HALF) < limit_of(EPSILON + slope * step)
            greedy = np.uint64(1) if table[reached, 1] > table[reached, 0] else np.uint64(0)
            next_action = number & np.uint64(1) if explores else greedy
            is_same = next_state == state and next_action == action
            next_value = value if is_same else table[next_state, next_action]
            mu = rule(mu, value, next_value if inside else 0.0)
            state, action = reached, next_action

    def learn(seed: int, n_steps: int) -> np.ndarray:
        table = np.zeros(((N_EDGES + 1) ** 4, 2))
        loop(table, seed, n_steps)
        return table

    return learn
