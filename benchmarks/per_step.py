"""The path through ordinary gymnasium environments, against a loop written by hand and against SB3's DQN."""

import tempfile
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3 import DQN

from benchmarks.grid import N_EDGES, POLE_BOUNDS
from benchmarks.measure import Contestant, Row, Times, measure, print_rows, speed_ratio
from benchmarks.models import PlainCallback, discretize
from sb3_adaptive_q import TabularQ

N_STEPS, DQN_STEPS = 100_000, 2_000
N_ROUNDS = 9
#: At least how many times the speed of the loop by hand
ASKED = {"FrozenLake-v1": 1.05, "CartPole-v1": 2.1}


def main() -> None:
    """Print the ratios for FrozenLake and for Cart Pole."""
    with tempfile.TemporaryDirectory() as folder:
        for env_id in ASKED:
            times = measure(_contestants(env_id, folder), N_ROUNDS)
            speeds = ", ".join(f"{name} {each.steps_per_second()}" for name, each in times.items())
            print_rows(f"{env_id}, one step at a time: {speeds}", _rows(env_id, times))


def learn_by_hand(env_id: str, n_steps: int) -> list[float]:
    """
    Q-learning as tutorials have it.

    :param env_id: FrozenLake-v1 or CartPole-v1
    :param n_steps: the environment steps to learn from
    :return: the episodes' sums of rewards
    """
    env = gym.make(env_id)
    is_pole = env_id.startswith("CartPole")
    edges = [np.linspace(-bound, bound, N_EDGES) for bound in POLE_BOUNDS]
    shape = (N_EDGES + 1,) * 4 if is_pole else (env.observation_space.n,)  # type: ignore[attr-defined]
    table = np.zeros((*shape, env.action_space.n))  # type: ignore[attr-defined]
    generator = np.random.default_rng(0)
    alpha, gamma, epsilon, decay, least_epsilon = 0.01, 0.99, 1.0, 0.95 / n_steps, 0.05
    step = 0
    returns = []

    def cell(observation: Any) -> tuple[Any, ...]:
        return tuple(np.digitize(value, each) for value, each in zip(observation, edges, strict=True))

    while step < n_steps:
        state, _ = env.reset()
        if is_pole:
            state = cell(state)
        episode_return, done = 0.0, False
        while not done and step < n_steps:
            if generator.random() < epsilon:
                action = env.action_space.sample()
            else:
                action = np.argmax(table[state])
            next_state, reward, terminated, truncated, _ = env.step(action)
            if is_pole:
                next_state = cell(next_state)
                entry: Any = (*state, action)
            else:
                entry = (state, action)
            target = reward if terminated else reward + gamma * np.max(table[next_state])
            table[entry] += alpha * (target - table[entry])
            epsilon = max(epsilon - decay, least_epsilon)
            state = next_state
            episode_return += float(reward)
            done = terminated or truncated
            step += 1
        returns.append(episode_return)
    return returns


def _contestants(env_id: str, folder: str) -> dict[str, Contestant]:
    def prepare(tensorboard_log: str | None) -> Callable[[], Any]:
        # TabularQ itself puts the Monitor and the LeanVecEnv around it
        env = gym.make(env_id)
        env = discretize(env) if env_id.startswith("CartPole") else env
        model = TabularQ("MlpPolicy", env, method=1, seed=0, tensorboard_log=tensorboard_log)
        return lambda: model.learn(N_STEPS, callback=PlainCallback())

    def prepare_dqn() -> Callable[[], Any]:
        model = DQN("MlpPolicy", env_id, seed=0, device="cpu")
        return lambda: model.learn(DQN_STEPS, callback=PlainCallback())

    return {
        "TabularQ": Contestant(N_STEPS, lambda: prepare(None)),
        "with TensorBoard": Contestant(N_STEPS, lambda: prepare(folder)),
        "by hand": Contestant(N_STEPS, lambda: lambda: learn_by_hand(env_id, N_STEPS)),
        "DQN": Contestant(DQN_STEPS, prepare_dqn),
    }


def _rows(env_id: str, times: dict[str, Times]) -> list[Row]:
    own, logged = times["TabularQ"], times["with TensorBoard"]
    asked = f"at least {ASKED[env_id]}"
    return [
        speed_ratio("speed of TabularQ / of the loop by hand", own, times["by hand"], asked),
        speed_ratio("speed of TabularQ with TensorBoard / of the loop by hand", logged, times["by hand"]),
        speed_ratio("speed of TabularQ / of DQN", own, times["DQN"], "at least 40"),
        Row("time with TensorBoard / without", logged.cpu / own.cpu, logged.wall / own.wall, "at most 1.05"),
    ]
