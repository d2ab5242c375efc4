"""
Q-learning in plain Python, written from the paper's Algorithm 1 and the documentation, to be compared bit for bit.

It shares nothing with the package but the functions of the literature's step sizes, which the golden numbers check; it draws
its own random numbers (SplitMix64, Steele, Lea and Flood, 2014), and drives gymnasium's environments itself.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from helpers.paper_learner import paper_rates, paper_start

from sb3_adaptive_q import STEP_SIZES
from sb3_adaptive_q.step_sizes import Step, resolve_parameters

_MASK = 2**64 - 1


class Draws:
    """
    The agent's random numbers.

    :param seed: of the training
    """

    def __init__(self, seed: int) -> None:
        self.counter = int(np.random.SeedSequence(seed).spawn(2)[0].generate_state(1, np.uint64)[0])

    def uniform(self) -> float:
        """The next number in [0, 1)."""
        self.counter = (self.counter + 0x9E3779B97F4A7C15) & _MASK
        mixed = ((self.counter ^ (self.counter >> 30)) * 0xBF58476D1CE4E5B9) & _MASK
        mixed = ((mixed ^ (mixed >> 27)) * 0x94D049BB133111EB) & _MASK
        return ((mixed ^ (mixed >> 31)) >> 11) * 2.0**-53


class PaperRate:
    """
    The step size of the paper's methods, or a constant: one μ for all.

    :param number: of the method; ``None`` for a constant
    :param constant: the constant
    """

    def __init__(self, number: int | None, constant: float) -> None:
        self.mu = constant if number is None else float(paper_start(number, float))
        self.reading = "same" if number in (5, 6) else "next"
        self._rate: Callable[..., float] = (lambda mu, *_: mu) if number is None else paper_rates(float)[number]

    def form(self, state: int, action: int, value: float, next_value: float, td_error: float, progress: float) -> float:
        """The step size of this update."""
        return self.mu

    def move(self, size: float, here: float, there: float, progress: float) -> None:
        """Form that of the next."""
        self.mu = self._rate(self.mu, here, there, progress)


class CellRate:
    """
    A step size of the literature, with memory for each state and action.

    :param name: its name
    :param shape: of the table
    :param gamma: the discount factor
    """

    reading = "next"

    def __init__(self, name: str, shape: tuple[int, int], gamma: float) -> None:
        self.step_size, self.gamma = STEP_SIZES[name], gamma
        self.parameters = resolve_parameters(name, {})
        starts = self.step_size.start_values(self.parameters)
        self.counts, self.memory = np.zeros(shape), {key: np.full(shape, start) for key, start in starts.items()}
        self.mu = 0.0

    def form(self, state: int, action: int, value: float, next_value: float, td_error: float, progress: float) -> float:
        count = 0.0
        if self.step_size.counts:
            self.counts[state, action] += 1.0
            count = float(self.counts[state, action])
        step = Step(state, action, state, action, count, value, next_value, td_error, progress, self.gamma, 0.0)
        with np.errstate(all="ignore"):
            size = float(self.step_size.step_size(self.mu, step, *self.parameters.values(), *self.memory.values()))
        return min(max(size, self.step_size.lower), self.step_size.upper)

    def move(self, size: float, here: float, there: float, progress: float) -> None:
        self.mu = size


class Ended(NamedTuple):
    """
    What a training leaves behind.

    :param table: Q
    :param mu: the step size of the next update, or that of the last
    :param counter: the agent's
    :param n_episodes: how many have ended
    :param returns: their sums of rewards
    """

    table: np.ndarray
    mu: float
    counter: int
    n_episodes: int
    returns: list[float]


class PlainLearner:
    """
    :param envs: the environments
    :param rate: the step size
    :param seed: of the training; environment i has seed + i
    :param first_table: Q_0
    :param arguments: γ, exploration, ties and total_episodes, by the names of the model's arguments
    """

    def __init__(self, envs: list[gym.Env], rate: Any, seed: int, first_table: np.ndarray, arguments: dict[str, Any]) -> None:
        self.envs, self.rate, self.draws = envs, rate, Draws(seed)
        self.table: list[list[float]] = first_table.tolist()
        self.arguments, self.gamma = arguments, arguments["gamma"]
        self.n_episodes, self.returns = 0, [0.0] * len(envs)
        self.ended: list[float] = []
        self.states = [int(env.reset(seed=seed + i)[0]) for i, env in enumerate(envs)]

    def learn(self, steps: int) -> Ended:
        """
        :param steps: of each environment
        :return: what is left behind
        """
        total, goal = steps * len(self.envs), self.arguments["total_episodes"]
        self.progress = 0.0
        self.actions = [self.choose(state) for state in self.states]
        for step in range(1, steps + 1):
            outcomes = [self.step(i) for i in range(len(self.envs))]
            for i, outcome in enumerate(outcomes):
                if goal is None:
                    self.progress = min(step * len(self.envs) / total, 1.0)
                self.update(i, *outcome)
            if goal is not None and self.n_episodes >= goal:
                break
        return Ended(np.array(self.table), self.rate.mu, self.draws.counter, self.n_episodes, self.ended)

    def step(self, i: int) -> tuple[float, int, bool, bool, int]:
        """Reward, state reached, whether it is terminal, whether the episode ended, and the state now."""
        reached, reward, terminated, truncated, _ = self.envs[i].step(self.actions[i])
        self.returns[i] += float(reward)
        now = int(reached)
        if terminated or truncated:
            now = int(self.envs[i].reset()[0])
            self.ended.append(round(self.returns[i], 6))
            self.returns[i] = 0.0
        return float(np.float32(reward)), int(reached), terminated, terminated or truncated, now

    def update(self, i: int, reward: float, reached: int, terminated: bool, done: bool, now: int) -> None:
        """Learn from one transition, and choose what comes next."""
        state, action, progress = self.states[i], self.actions[i], self.progress
        before = list(self.table[reached])
        here = self.table[state][action]
        best = 0.0 if terminated else max(before)
        td_error = reward + self.gamma * best - here
        size = self.rate.form(state, action, here, best, td_error, progress)
        self.table[state][action] = here + size * td_error
        there, upcoming = 0.0, 0
        if not terminated:
            upcoming = self.choose(reached)
            there = before[action if self.rate.reading == "same" else upcoming]
        if done:
            self.n_episodes += 1
            if self.arguments["total_episodes"] is not None:
                self.progress = min(self.n_episodes / self.arguments["total_episodes"], 1.0)
            upcoming = self.choose(now)
        self.rate.move(size, here, there, self.progress)
        self.states[i], self.actions[i] = now, upcoming

    def choose(self, state: int) -> int:
        """ε-greedy; where several actions are best any of them, or the first."""
        row = self.table[state]
        if self.draws.uniform() < self.exploration_rate():
            return int(self.draws.uniform() * len(row))
        best = [action for action, value in enumerate(row) if value == max(row)]
        if self.arguments.get("ties") == "first" or len(best) == 1:
            return best[0]
        return best[int(self.draws.uniform() * len(best))]

    def exploration_rate(self) -> float:
        """ε at this moment of the training."""
        initial, final = self.arguments["exploration_initial_eps"], self.arguments["exploration_final_eps"]
        fraction = self.arguments["exploration_fraction"]
        if self.arguments.get("exploration_schedule") == "constant":
            return initial  # type: ignore[no-any-return]
        return final if self.progress >= fraction else initial + (final - initial) * (self.progress / fraction)


def learn_plainly(case: Any) -> Ended:
    """
    :param case: a case of :mod:`helpers.random_mdps`
    :return: what Q-learning leaves behind there
    """
    envs, arguments = case.make_envs(), case.arguments
    shape = int(envs[0].observation_space.n), int(envs[0].action_space.n)  # type: ignore[attr-defined]
    if isinstance(case.step_size, str):
        rate: Any = CellRate(case.step_size, shape, arguments["gamma"])
    else:
        rate = PaperRate(case.step_size, arguments.get("learning_rate", 0.0))
    return PlainLearner(envs, rate, case.seed, np.full(shape, arguments["initial_q"]), arguments).learn(case.steps)
