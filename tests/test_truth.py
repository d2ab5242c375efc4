"""Whether it learns: greedy policies against optima that dynamic programming finds on the environments' own dynamics."""

from collections.abc import Callable

import gymnasium as gym
import numpy as np
import pytest
from stable_baselines3.common.vec_env import VecEnv

from sb3_adaptive_q import CompiledVecEnv, TabularQ
from wrappers import DiscretizeObservation


def train(env: gym.Env | VecEnv, steps: int, **arguments: object) -> np.ndarray:
    """Learn for a number of steps from seed 0, and return the greedy policy: the action of every state."""
    model = TabularQ("MlpPolicy", env, seed=0, **arguments)
    model.learn(steps, log_interval=None)
    return model.predict(np.arange(len(model.q_table)), deterministic=True)[0]


def returns_of(policy: np.ndarray, env: gym.Env, episodes: int) -> np.ndarray:
    """The returns of a policy, one episode each from seeds 0, 1, ..."""
    returns = np.zeros(episodes)
    for episode in range(episodes):
        state, _ = env.reset(seed=episode)
        ended = False
        while not ended:
            state, reward, terminated, truncated, _ = env.step(int(policy[state]))
            returns[episode] += reward
            ended = terminated or truncated
    return returns


def backward_induction(env: gym.Env, n_steps: int, choose: Callable[[np.ndarray], np.ndarray]) -> float:
    """
    The expected return of an episode, undiscounted as it is counted, within a limit of steps.

    ``choose`` makes state values of the action values, of shape (states, actions), with ever more steps left.
    """
    table, starts = env.unwrapped.P, env.unwrapped.initial_state_distrib
    values = np.zeros(len(table))
    for _ in range(n_steps):
        action_values = np.array(
            [
                [
                    sum(p * (r + (0.0 if end else values[s])) for p, s, r, end in table[state][action])
                    for action in table[state]
                ]
                for state in table
            ]
        )
        values = choose(action_values)
    return float(np.dot(starts, values))


def optimum(env: gym.Env) -> float:
    """What the best policy reaches, which may depend on the steps that are left."""
    return backward_induction(env, env.spec.max_episode_steps, lambda action_values: action_values.max(axis=1))


def expectation(policy: np.ndarray, env: gym.Env) -> float:
    """What a policy reaches."""
    states = np.arange(len(policy))
    return backward_induction(env, env.spec.max_episode_steps, lambda action_values: action_values[states, policy])


def discounted_values(env: gym.Env, gamma: float) -> np.ndarray:
    """Value iteration for the discounted values without a step limit, the fixed point that Q-learning converges to."""
    table = env.unwrapped.P
    values = np.zeros(len(table))
    for _ in range(3000):
        values = np.array(
            [
                max(
                    sum(p * (r + gamma * (0.0 if end else values[s])) for p, s, r, end in outcomes)
                    for outcomes in row.values()
                )
                for row in table.values()
            ]
        )
    return values


@pytest.fixture(scope="module")
def lake_policy():
    """Method 1 on slippery FrozenLake for 400 000 steps."""
    return train(gym.make("FrozenLake-v1"), 400_000, method=1)


class TestFrozenLake:
    def test_the_optimum_is_what_is_known_of_it(self):
        """Of the test's own dynamic programming: V* at gamma 0.99 is 0.542 in state 0 and 0.863 in state 14."""
        env = gym.make("FrozenLake-v1")
        values = discounted_values(env, 0.99)
        assert values[0] == pytest.approx(0.542, abs=5e-4)
        assert values[14] == pytest.approx(0.863, abs=5e-4)
        assert 0.73 < optimum(env) < 0.75

    def test_success_of_the_greedy_policy(self, lake_policy):
        """At least 0.70 of 2000 episodes; the optimum is 0.74."""
        returns = returns_of(lake_policy, gym.make("FrozenLake-v1"), 2000)
        assert returns.mean() >= 0.70

    def test_the_policy_is_close_to_optimal_in_expectation(self, lake_policy):
        env = gym.make("FrozenLake-v1")
        assert optimum(env) - 0.02 <= expectation(lake_policy, env) <= optimum(env)

    def test_values_converge_to_the_fixed_point(self):
        """
        Without slipping the dynamics are deterministic, and a rate of 1 makes the visited values exact: 0.99 to the power of
        the steps that remain. 60 000 steps of a random walk.
        """
        env = gym.make("FrozenLake-v1", is_slippery=False)
        model = TabularQ("MlpPolicy", env, learning_rate=1.0, exploration_final_eps=1.0, seed=0)
        model.learn(60_000, log_interval=None)
        np.testing.assert_allclose(model.q_table.max(axis=1), discounted_values(env, 0.99), rtol=1e-12)
        assert model.q_table[0].max() == pytest.approx(0.99**5)


class TestTaxi:
    def test_mean_return_is_within_5_percent_of_optimal(self):
        """300 000 steps; 1000 episodes."""
        env = gym.make("Taxi-v4")
        policy = train(gym.make("Taxi-v4"), 300_000, learning_rate=0.5, exploration_fraction=0.8)
        best = optimum(env)
        assert 7.5 < best < 8.5
        assert expectation(policy, env) >= 0.95 * best
        # The starts are drawn: 1000 of them have a mean within 0.3 of the expectation (the deviation is 2.6 or so)
        assert returns_of(policy, env, 1000).mean() >= 0.95 * best - 0.3


class TestCliffWalking:
    def test_the_shortest_way(self):
        """60 000 steps; thirteen steps along the edge, each with a reward of -1."""
        env = gym.make("CliffWalkingLimited-v1")
        policy = train(gym.make("CliffWalkingLimited-v1"), 60_000, learning_rate=0.5)
        assert optimum(env) == -13.0
        assert returns_of(policy, env, 1).tolist() == [-13.0]


class TestCartPole:
    def test_balances(self):
        """
        Method 2 for four million steps, of which a compiled environment makes the same as an ordinary one, but sooner;
        200 steps are the most an episode has. At a quarter of this budget the outcome still hangs on the seed.
        """

        def make_env():
            return DiscretizeObservation(
                gym.make("CartPoleFriction-v0"), 10, [-2.4, -4.0, -0.2095, -4.0], [2.4, 4.0, 0.2095, 4.0]
            )

        policy = train(CompiledVecEnv([make_env]), 4_000_000, method=2)
        assert returns_of(policy, make_env(), 100).mean() >= 180.0
