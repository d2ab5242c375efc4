"""What the algorithms converge to, against dynamic programming. All on the compiled path, with constant step sizes."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3.common.env_util import make_vec_env

from sb3_adaptive_q import (
    ALGORITHMS,
    SARSA,
    CompiledVecEnv,
    DoubleQ,
    EpisodeSeriesCallback,
    ExpectedSARSA,
    TabularAlgorithm,
    TabularQ,
)
from sb3_adaptive_q.envs.table_env import TableEnv
from sb3_adaptive_q.planning import (
    TabularModel,
    action_values,
    epsilon_greedy_optimum,
    epsilon_greedy_policy,
    expected_return,
    optimal_return,
    policy_evaluation,
    uniform_policy,
    value_iteration,
)

GAMMA, DECAY, N = 0.8, 0.5, 4


def learn(name: str, env: Any, n_steps: int, epsilon: tuple[float, float], **arguments: Any) -> TabularAlgorithm:
    """Learn on the compiled path, with an exploration rate that falls from the first number to the second."""
    vec_env = make_vec_env(env, vec_env_cls=CompiledVecEnv)
    exploration = {"exploration_initial_eps": epsilon[0], "exploration_final_eps": epsilon[1]}
    model = ALGORITHMS[name]("MlpPolicy", vec_env, **{"seed": 0, "gamma": 1.0, **exploration, **arguments})
    return model.learn(n_steps, log_interval=None)


def ring_of_chords() -> TableEnv:
    """Six states and three actions that lead from each to others, surely, with rewards from -1 to 1; no end."""
    generator = np.random.default_rng(0)

    def lead(state: int, action: int) -> list[tuple[float, int, float, bool]]:
        further = int(generator.integers(6)) if action > 0 else 1
        return [(1.0, (state + further) % 6, float(generator.integers(-8, 9)) / 8, False)]

    table = {state: {action: lead(state, action) for action in range(3)} for state in range(6)}
    return TableEnv(table, np.full(6, 1 / 6))


class Chords:
    """Fixed points on the ring of chords where actions are uniformly random, by iteration of their definitions."""

    def __init__(self) -> None:
        env = ring_of_chords()
        self.next = np.array([[env.P[state][action][0][1] for action in range(3)] for state in range(6)])
        self.rewards = np.array([[env.P[state][action][0][2] for action in range(3)] for state in range(6)])
        self.of_policy = action_values(env, policy_evaluation(env, uniform_policy(env), GAMMA), GAMMA)
        self.optimal = action_values(env, value_iteration(env, GAMMA), GAMMA)

    def back_up(self, values: np.ndarray) -> np.ndarray:
        """Action values by the values of the states that follow."""
        return self.rewards + GAMMA * values[self.next]

    def n_step(self) -> np.ndarray:
        """N - 1 further steps at random, and the largest value where they lead."""
        q = np.zeros((6, 3))
        for _ in range(500):
            values = q.max(axis=1)
            for _ in range(N - 1):
                values = self.back_up(values).mean(axis=1)
            q = self.back_up(values)
        return q

    def peng(self) -> np.ndarray:
        """The one-step error of the pair and, weighted by (γλ)^k, those of the largest values that follow, are 0 together."""
        q, moves = np.zeros((6, 3)), np.eye(6)[self.next].mean(axis=1)
        for _ in range(500):
            largest = q.max(axis=1)
            errors = (self.back_up(largest) - largest[:, None]).mean(axis=1)
            following = np.linalg.solve(np.eye(6) - GAMMA * DECAY * moves, errors)
            q = q + 0.5 * (self.back_up(largest) + GAMMA * DECAY * following[self.next] - q)
        return q


#: For each algorithm what it tends to, and how near it comes. Where the target is random, a step size of 0.002 leaves a
#: standard deviation of some hundredths
TRACED = {"trace_decay": DECAY}
LIMITS: dict[str, tuple[str, dict[str, Any], str, float]] = {
    "tabular_q": ("tabular_q", {}, "optimal", 1e-6),
    "sarsa": ("sarsa", {}, "of_policy", 0.1),
    "expected_sarsa": ("expected_sarsa", {}, "of_policy", 1e-6),
    "double_q": ("double_q", {}, "optimal", 1e-6),
    "double_expected_sarsa": ("double_q", {"target": "expected"}, "of_policy", 1e-6),
    "sarsa_lambda": ("sarsa_lambda", TRACED, "of_policy", 0.1),
    "sarsa_lambda_replacing": ("sarsa_lambda", {**TRACED, "trace": "replacing"}, "of_policy", 0.1),
    "sarsa_lambda_dutch": ("sarsa_lambda", {**TRACED, "trace": "dutch"}, "of_policy", 0.1),
    "true_online": ("sarsa_lambda", {**TRACED, "true_online": True}, "of_policy", 0.1),
    "watkins": ("q_lambda", TRACED, "optimal", 1e-6),
    "peng": ("q_lambda", {**TRACED, "variant": "peng"}, "peng", 0.1),
    "naive": ("q_lambda", {**TRACED, "variant": "naive"}, "optimal", 1e-6),
    "n_step_sarsa": ("n_step", {"n": N}, "of_policy", 0.1),
    "n_step_expected": ("n_step", {"n": N, "target": "expected"}, "of_policy", 0.1),
    "n_step_q": ("n_step", {"n": N, "target": "q"}, "n_step", 0.1),
    "tree_backup": ("n_step", {"n": N, "target": "tree_backup"}, "optimal", 1e-6),
}


@pytest.mark.parametrize("case", LIMITS)
def test_random_actions(case: str) -> None:
    """On-policy algorithms find the values of random actions, off-policy ones the optimal values, two a mixture of both."""
    name, arguments, limit, tolerance = LIMITS[case]
    chords = Chords()
    found = getattr(chords, limit)
    expected = found() if callable(found) else found
    others = [chords.of_policy, chords.optimal, chords.n_step(), chords.peng()]
    assert sorted(np.abs(each - expected).max() > 5 * tolerance for each in others) == [False, True, True, True]
    size = 0.1 if tolerance < 0.1 else 0.002
    model = learn(name, ring_of_chords, 600_000, (1.0, 1.0), gamma=GAMMA, learning_rate=size, **arguments)
    np.testing.assert_allclose(model.q_table, expected, rtol=0.0, atol=tolerance)


class TestCliff:
    """With ε = 0.1 the best ε-greedy policy walks away from the edge; the optimal one falls."""

    epsilon = 0.1

    def learned_return(self, name: str, **arguments: Any) -> float:
        """What the ε-greedy policy of the learned table returns."""
        model = learn(name, "CliffWalking-v1", 1_000_000, (self.epsilon, self.epsilon), **arguments)
        policy = epsilon_greedy_policy(model.q_table.argmax(axis=1), self.epsilon, 4)
        return expected_return(gym.make("CliffWalking-v1"), policy)

    @pytest.mark.parametrize(
        ("name", "arguments"), [("expected_sarsa", {}), ("double_q", {"target": "expected"})], ids=["expected", "double"]
    )
    def test_expected_sarsa(self, name: str, arguments: dict[str, Any]) -> None:
        best = epsilon_greedy_optimum(gym.make("CliffWalking-v1"), self.epsilon).start_value
        assert best == pytest.approx(-20.71, abs=0.005)
        assert self.learned_return(name, learning_rate=0.2, **arguments) == pytest.approx(best, abs=1e-3)

    def test_sarsa(self) -> None:
        assert -21.5 < self.learned_return("sarsa", learning_rate=0.02) < -20.7

    def test_q_learning(self) -> None:
        """Its greedy actions are optimal; which of several, the table's last digits say, and the return with them."""
        low, high = self.returns_of_optimal_actions()
        assert low <= self.learned_return("tabular_q", learning_rate=0.5) <= high < -40.0

    def returns_of_optimal_actions(self) -> tuple[float, float]:
        """The least and the largest return of an ε-greedy policy whose greedy actions are all optimal."""
        env = TabularModel.of(gym.make("CliffWalking-v1"))
        optimal = action_values(env, value_iteration(env, 1.0), 1.0)
        is_best = np.isclose(optimal, optimal.max(axis=1, keepdims=True), rtol=0.0, atol=1e-9)
        found = []
        for pick in (np.min, np.max):
            values = np.zeros(48)
            for _ in range(3000):
                q = action_values(env, values, 1.0)
                greedy = pick(np.where(is_best, q, np.inf if pick is np.min else -np.inf), axis=1)
                values = (1.0 - self.epsilon) * greedy + self.epsilon * q.mean(axis=1)
            found.append(float(values[36]))
        return found[0] - 1e-9, found[1] + 1e-9


@pytest.mark.parametrize("name", ALGORITHMS)
def test_windy_grid(name: str) -> None:
    """With exploration falling to 0, all of them find the way of 15 steps (Sutton and Barto, example 6.9)."""
    env = gym.make("WindyGrid-v0")
    assert optimal_return(env) == -15.0
    size = 0.1 if name in ("sarsa_lambda", "q_lambda", "n_step") else 0.5
    model = learn(name, "WindyGrid-v0", 1_000_000, (0.2, 0.0), learning_rate=size)
    assert expected_return(env, model.q_table.argmax(axis=1), horizon=200) == -15.0


class TestMaximisationBias:
    """Example 6.7 of Sutton and Barto: to go left is wrong, and looks right while the largest of noisy values is taken."""

    def shares_of_left(self, algorithm: type[TabularAlgorithm], seed: int, n_episodes: int) -> np.ndarray:
        """For each episode, whether its first action went left, which an episode of two steps tells."""
        series = EpisodeSeriesCallback()
        env = make_vec_env("MaxBias-v0", vec_env_cls=CompiledVecEnv)
        exploration = {"exploration_initial_eps": 0.1, "exploration_final_eps": 0.1}
        model = algorithm(
            "MlpPolicy", env, seed=seed, gamma=1.0, learning_rate=0.1, total_episodes=n_episodes, **exploration
        )  # fmt: skip
        model.learn(2 * n_episodes, callback=series, log_interval=None)
        return series.lengths == 2

    def test_double_q_learning_has_none(self) -> None:
        """In the end it goes left where it explores, in 5 % of the episodes; within five standard errors."""
        share = self.shares_of_left(DoubleQ, 0, 20_000)[10_000:].mean()
        assert share == pytest.approx(0.05, abs=5 * (0.05 * 0.95 / 10_000) ** 0.5)

    def test_q_learning_has_much(self) -> None:
        """In the first 300 episodes, as in figure 6.5."""
        shares = {kind: np.mean([self.shares_of_left(kind, seed, 300) for seed in range(10)]) for kind in (TabularQ, DoubleQ)}
        assert shares[TabularQ] > 0.3 > 0.25 > shares[DoubleQ]


def test_names_are_those_of_the_classes() -> None:
    assert ALGORITHMS["sarsa"] is SARSA and ALGORITHMS["expected_sarsa"] is ExpectedSARSA
