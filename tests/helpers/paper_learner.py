"""
Q-learning with the eight methods, written from the paper's Algorithm 1 and Eqs. 2-11 alone, in numbers of any kind:
fractions for hand-worked values, floats for long runs.

It shares no code with the package. It drives Gymnasium environments itself, and is greedy unless told otherwise.
"""

from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Any, NamedTuple

import gymnasium as gym

Number = Any
Rate = Callable[[Number, Number, Number, Number], Number]


def paper_rates(number: Callable[[str], Number] = Fraction) -> dict[int, Rate]:
    """
    Eqs. 3-11 with the paper's β, each as ``rate(mu, here, there, progress)``: ``here`` is Q_t(s_t, a_t), ``there``
    Q_t(s_{t+1}, a), ``progress`` t / t_max.

    :param number: makes a number of the kind to compute in
    :return: by the number of the method
    """
    beta_1, beta_2, beta_3, beta_5, beta_6, beta_7, beta_8 = map(number, "0.01 0.05 0.04 0.05 0.005 0.001 0.01".split())

    def constrain(mu: Number) -> Number:
        if mu < beta_7:
            return beta_7
        if mu > beta_8:
            return beta_8
        return mu

    return {
        1: lambda mu, here, there, progress: beta_1,
        2: lambda mu, here, there, progress: beta_2,
        3: lambda mu, here, there, progress: beta_1 + beta_3 * (1 - progress),
        4: lambda mu, here, there, progress: beta_1 + beta_3 * progress,
        5: lambda mu, here, there, progress: constrain(mu - beta_5 * (there - here)),
        6: lambda mu, here, there, progress: constrain(mu + beta_5 * (there - here)),
        7: lambda mu, here, there, progress: constrain(mu + beta_6 if there >= here else mu - beta_6),
        8: lambda mu, here, there, progress: constrain(mu - beta_6 if there >= here else mu + beta_6),
    }


def paper_start(method: int, number: Callable[[str], Number] = Fraction) -> Number:
    """
    :param method: its number
    :param number: makes a number of the kind to compute in
    :return: μ of the first update: β1, but for Methods 2 and 3, which start from β2 and from β1 + β3
    """
    return {2: number("0.05"), 3: number("0.01") + number("0.04")}.get(method, number("0.01"))


class Moment(NamedTuple):
    """Where learning stands between two steps."""

    table: list[list[Number]]
    mu: Number


def greedy(table: Sequence[Sequence[Number]], state: int) -> int:
    """
    :param table: Q
    :param state: the row
    :return: the first of the best actions
    """
    return max(range(len(table[state])), key=lambda action: (table[state][action], -action))


def learn_by_the_paper(
    envs: Sequence[gym.Env],
    n_steps: int,
    table: Sequence[Sequence[Number]],
    gamma: Number,
    mu: Number,
    rate: Rate,
    next_action: str,
    total_episodes: int | None = None,
    mu_at_start: Number | None = None,
    choose: Callable[[Any, int], int] = greedy,
) -> list[Moment]:
    """
    :param envs: one or several, taken in turn
    :param n_steps: steps of each
    :param table: Q_0; its entries say in what kind of numbers to compute
    :param gamma: the discount factor
    :param mu: μ_0
    :param rate: forms μ_{t+1}
    :param next_action: which action the rule looks at in s_{t+1}: ``"same"``, ``"next"`` or ``"max"``
    :param total_episodes: what t_max counts, where not steps
    :param mu_at_start: what μ is set to with every episode, if anything
    :param choose: picks an action for a state; not asked in terminal states
    :return: where learning stood before the first step and after each
    """
    number = type(table[0][0])
    table = [list(row) for row in table]
    states = [int(env.reset()[0]) for env in envs]
    actions = [choose(table, state) for state in states]
    finished = 0
    moments = [Moment([list(row) for row in table], mu)]
    for step in range(1, n_steps + 1):
        outcomes = [env.step(action) for env, action in zip(envs, actions, strict=True)]
        for i, (reached, reward, terminated, truncated, _) in enumerate(outcomes):
            before = [list(row) for row in table]
            state, action = states[i], actions[i]
            here = before[state][action]
            best = number(0) if terminated else max(before[reached])
            table[state][action] = here + mu * (number(reward) + gamma * best - here)

            there, upcoming = number(0), 0
            if not terminated:
                upcoming = choose(table, reached)
                there = {"same": before[reached][action], "next": before[reached][upcoming], "max": best}[next_action]
            ended = terminated or truncated
            if ended:
                finished += 1
                reached = int(envs[i].reset()[0])
                upcoming = choose(table, reached)
            progress = number(step) / n_steps if total_episodes is None else number(finished) / total_episodes
            mu = rate(mu, here, there, progress)
            if ended and mu_at_start is not None:
                mu = mu_at_start
            states[i], actions[i] = reached, upcoming
        moments.append(Moment([list(row) for row in table], mu))
    return moments


class SplitMix64:
    """
    The agent's random numbers, in Python's integers (Steele, Lea and Flood, 2014).

    :param counter: to begin with
    """

    def __init__(self, counter: int) -> None:
        self.counter = counter

    def random(self) -> float:
        """:return: the next number in [0, 1)"""
        self.counter = (self.counter + 0x9E3779B97F4A7C15) % 2**64
        mixed = (self.counter ^ (self.counter >> 30)) * 0xBF58476D1CE4E5B9 % 2**64
        mixed = (mixed ^ (mixed >> 27)) * 0x94D049BB133111EB % 2**64
        return ((mixed ^ (mixed >> 31)) >> 11) / 2**53
