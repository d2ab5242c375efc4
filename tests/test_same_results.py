"""
The compiled path beside the ordinary one: the same table, step size and episodes, bit for bit.

What is covered: each built-in environment with each of the eight methods over 40 000 steps in rollouts of the default length
(Cliff Walking, whose first episodes are long, over 100 000), on one environment or on three in turn of the pairs; and each
pair on the other number of environments over 3 000 steps in rollouts of 1, 7 and the default length. Three pairs learn for
200 000 steps in short rollouts.
"""

import math
from functools import partial

import gymnasium as gym
import numba
import numpy as np
import pytest
from helpers.both_paths import CELLS, ENVIRONMENTS, assert_same, learn, make_env, make_model
from helpers.paper_learner import SplitMix64, greedy, learn_by_the_paper, paper_rates, paper_start
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from sb3_adaptive_q import METHODS, CompiledVecEnv, LearningRateCallback, TabularQ
from sb3_adaptive_q.compiled.freezing import freeze
from sb3_adaptive_q.vec_env.dynamics import Grid, find_dynamics
from wrappers import DiscretizeObservation

LAKE = "slippery lake"


@numba.njit
def compiled_sines(angles):
    return [(math.sin(angle), math.cos(angle)) for angle in angles]


def has_one_sine():
    """Whether NumPy's sine and cosine, and Python's, are the compiler's to the last bit, as far as can be told."""
    angles = np.random.default_rng(0).uniform(-0.5, 0.5, 100_000)
    ours = compiled_sines(angles)
    theirs = [[(float(of.sin(angle)), float(of.cos(angle))) for angle in angles] for of in (np, math)]
    return theirs == [ours, ours]


ONE_SINE = has_one_sine()
CART_POLES = pytest.mark.skipif(
    not ONE_SINE, reason="another sine than the compiler's is in use here; the promise is then 1e-12 on the states of a step"
)
PAIRS = [
    pytest.param(name, number, marks=CART_POLES if name.startswith("CartPole") else ())
    for name in ENVIRONMENTS
    for number in METHODS
]
ALL_PAIRS = pytest.mark.parametrize("name, number", PAIRS)


def number_of_envs(name, number):
    """1 and 3 in turn, so that each environment and each method has both."""
    return 1 if (list(ENVIRONMENTS).index(name) + number) % 2 else 3


def compare(name, n_envs, total_timesteps, intervals, **arguments):
    ordinary = learn(make_model(name, False, n_envs, **arguments), total_timesteps)
    for interval in intervals:
        compiled = learn(make_model(name, True, n_envs, callback_interval=interval, **arguments), total_timesteps)
        assert_same(compiled, ordinary)
    return ordinary


class TestBuiltInEnvironments:
    @ALL_PAIRS
    def test_long(self, name, number):
        total_timesteps = 100_000 if name == "CliffWalking" else 40_000
        ordinary = compare(name, number_of_envs(name, number), total_timesteps, [None], method=number, initial_q=0.5)
        assert len(ordinary.returns) > 20  # CliffWalking has no step limit
        assert np.count_nonzero(ordinary.table != 0.5) > 30

    @ALL_PAIRS
    def test_short_rollouts(self, name, number):
        compare(name, 4 - number_of_envs(name, number), 3_000, [1, 7, None], method=number, initial_q=0.5)

    @pytest.mark.parametrize(
        "name, number, n_envs, intervals",
        [("slippery lake", 7, 3, [1, 7]), ("CartPole", 5, 1, [7]), ("Taxi", 8, 1, [7])],
    )
    def test_long_in_short_rollouts(self, name, number, n_envs, intervals):
        compare(name, n_envs, 200_000, intervals, method=number)


ARGUMENTS = {
    "no method": {},
    "a constant rate": {"learning_rate": 0.3},
    "optimistic": {"method": 7, "initial_q": 1.0, "gamma": 1.0},
    "short-sighted and pessimistic": {"method": 6, "initial_q": -0.5, "gamma": 0.0},
    "early greed": {"method": 1, "exploration_fraction": 0.3, "exploration_final_eps": 0.0},
    "no exploration": {"method": 8, "exploration_initial_eps": 0.0, "exploration_final_eps": 0.0},
    "no decay": {"method": 2, "exploration_fraction": 0.0},
    "the best next action": {"method": 5, "method_kwargs": {"next_action": "max"}},
    "the action taken next": {"method": 6, "method_kwargs": {"next_action": "next"}},
    "the same action": {"method": 7, "method_kwargs": {"next_action": "same"}},
    "parameters of its own": {"method": 3, "method_kwargs": {"beta_1": 0.1, "beta_3": 0.2}},
    "episodes": {"method": 4, "total_episodes": 250},
    "more episodes than there is time for": {"method": 3, "total_episodes": 10**6},
    "another seed": {"method": 7, "seed": 12345},
}


class FromError(LearningRateCallback):
    """A rule of a user: far from the target the step is larger."""

    @staticmethod
    def rule(mu, transition, least, gain):
        return min(least + gain * abs(transition.td_error) * (1.0 - transition.progress), 1.0)


class SetTheRate(BaseCallback):
    """A user's schedule by callback, once in 1000 steps of the environment."""

    def _on_step(self):
        if self.num_timesteps % 1000 == 0:
            self.model.mu = 1.0 / (1.0 + self.num_timesteps / 1000)
        return True


class TestArguments:
    @pytest.mark.parametrize("n_envs", [1, 3])
    @pytest.mark.parametrize("arguments", ARGUMENTS.values(), ids=ARGUMENTS)
    def test_of_the_model(self, arguments, n_envs):
        ordinary = compare(LAKE, n_envs, 12_000, [7, None], **arguments)
        assert len(ordinary.returns) > 100

    def test_a_rate_that_starts_again_with_every_episode(self):
        compare(LAKE, 1, 12_000, [7, None], method=7, method_kwargs={"reset_each_episode": True, "mu_0": 0.004})

    @pytest.mark.parametrize("n_envs", [1, 3])
    def test_a_rule_of_a_user(self, n_envs):
        ordinary, compiled = (
            learn(make_model(LAKE, path, n_envs), 12_000, FromError(least=0.01, gain=0.5)) for path in (False, True)
        )
        assert_same(compiled, ordinary)
        assert len(set(ordinary.rates.tolist())) > 100

    @pytest.mark.parametrize("method", [None, 8])
    def test_a_callback_that_sets_the_rate(self, method):
        ordinary = learn(make_model(LAKE, False, method=method), 20_000, SetTheRate())
        compiled = learn(make_model(LAKE, True, method=method, callback_interval=1000), 20_000, SetTheRate())
        assert_same(compiled, ordinary)

    @pytest.mark.parametrize("kind", ["Monitor outside", "Monitor inside", "no Monitor", "a vector of cells"])
    def test_order_of_the_wrappers(self, kind):
        def make(compiled):
            def env():
                if kind == "Monitor inside":
                    return DiscretizeObservation(Monitor(gym.make("CartPoleFriction-v0")), **CELLS)
                wrap = partial(DiscretizeObservation, **CELLS, multi_discrete=kind == "a vector of cells")
                discretized = wrap(gym.make("CartPoleFriction-v0", max_episode_steps=15))
                return discretized if kind == "no Monitor" else Monitor(discretized)

            return TabularQ("MlpPolicy", (CompiledVecEnv if compiled else DummyVecEnv)([env, env]), seed=3, method=7)

        ordinary, compiled = (learn(make(path), 6_000) for path in (False, True))
        assert len(ordinary.returns) > 50
        assert_same(compiled, ordinary)

    def test_as_a_user_would_write_it(self):
        ordinary = TabularQ("MlpPolicy", "FrozenLake-v1", method=7, seed=1)
        compiled = TabularQ("MlpPolicy", make_vec_env("FrozenLake-v1", vec_env_cls=CompiledVecEnv), method=7, seed=1)
        assert_same(*(learn(model, 20_000) for model in (compiled, ordinary)))

    @pytest.mark.parametrize("n_envs", [1, 3])
    def test_going_on(self, n_envs):
        models = [make_model(LAKE, path, n_envs, method=7, initial_q=1.0) for path in (False, True)]
        for steps in (3_000, 12, 5_001):
            ordinary, compiled = (learn(model, steps, reset_num_timesteps=False) for model in models)
            assert_same(compiled, ordinary)

    def test_starting_again_and_changing_path(self):
        models = [make_model(LAKE, path, method=7, initial_q=1.0) for path in (False, True)]
        for _ in range(2):
            ordinary, compiled = (learn(model, 4_000) for model in models)
            assert_same(compiled, ordinary)
        models[1].set_env(make_model(LAKE, False).env)
        models[0].set_env(make_model(LAKE, True).env)
        assert_same(*(learn(model, 4_000) for model in models))


class Clock(gym.Wrapper):
    """Seeds the first episode, and counts."""

    def __init__(self, env, seed):
        super().__init__(env)
        self.seeds = [seed]
        self.n_steps = self.n_resets = 0

    def reset(self, **arguments):
        self.n_resets += 1
        return self.env.reset(seed=self.seeds.pop() if self.seeds else None)

    def step(self, action):
        self.n_steps += 1
        return self.env.step(action)


def learn_lake_by_the_paper(number, seed, n_steps, n_envs=1, total_episodes=None):
    """
    The table of Algorithm 1 and Eqs. 2-11 with floats, ε-greedy: a number below ε asks for another one, which is the
    action. The agent draws from the first of the two sequences that are spawned from the seed, the environment from its own.
    """
    generator = SplitMix64(int(np.random.SeedSequence(seed).spawn(2)[0].generate_state(1, np.uint64)[0]))
    clocks = [Clock(gym.make("FrozenLake-v1"), seed + i) for i in range(n_envs)]

    def choose(table, state):
        if total_episodes is None:
            progress = clocks[0].n_steps / n_steps
        else:
            progress = (sum(clock.n_resets for clock in clocks) - n_envs) / total_episodes
        if generator.random() < 1.0 - 0.95 * progress:
            return int(generator.random() * 4)
        return greedy(table, state)

    moments = learn_by_the_paper(
        clocks,
        n_steps,
        [[0.0] * 4 for _ in range(16)],
        gamma=0.99,
        mu=paper_start(number, float),
        rate=paper_rates(float)[number],
        next_action="same" if number in (5, 6) else "next",
        total_episodes=total_episodes,
        choose=choose,
    )
    return np.array(moments[-1].table), moments[-1].mu


class TestAgainstThePaper:
    @pytest.mark.parametrize("number", METHODS)
    def test_one_environment(self, number):
        table, mu = learn_lake_by_the_paper(number, seed=5, n_steps=15_000)
        ours = learn(make_model(LAKE, True, method=number, seed=5, ties="first"), 15_000)
        assert np.count_nonzero(table) > 10
        np.testing.assert_array_equal(ours.table, table)
        assert ours.mu == mu

    @pytest.mark.parametrize("number", [3, 7])
    def test_three_environments(self, number):
        table, mu = learn_lake_by_the_paper(number, seed=6, n_steps=6_000, n_envs=3)
        ours = learn(make_model(LAKE, True, 3, method=number, seed=6, ties="first"), 18_000)
        assert np.count_nonzero(table) > 10
        np.testing.assert_array_equal(ours.table, table)
        assert ours.mu == mu

    @pytest.mark.parametrize("number", [4, 8])
    def test_iterations_are_episodes(self, number):
        ours = learn(make_model(LAKE, True, method=number, seed=7, ties="first", total_episodes=1000), 10**6)
        table, mu = learn_lake_by_the_paper(number, seed=7, n_steps=ours.num_timesteps, total_episodes=1000)
        assert np.count_nonzero(table) > 10
        np.testing.assert_array_equal(ours.table, table)
        assert ours.mu == mu


class BesideGymnasium(BaseCallback):
    """
    Takes every step in an ordinary environment too, from the state that the compiled one was in.

    NumPy, Python and the compiler may each have a sine and a cosine of their own, whose last bits differ on some platforms.
    So what is promised everywhere is that a step ends within 1e-12 of gymnasium's in every component of the state, and
    bit for bit where they agree.
    """

    def __init__(self, name):
        super().__init__()
        self.mirror = make_env(name)
        self.mirror.reset(seed=0)
        self.n_resets = self.largest = 0

    def _on_step(self):
        compiled = self.training_env.envs[0].unwrapped
        mirror = self.mirror.unwrapped
        _, reward, terminated, truncated, _ = self.mirror.step(int(self.locals["actions"][0]))
        if terminated or truncated:
            self.mirror.reset()
            self.n_resets += 1
        assert bool(self.locals["dones"][0, 0]) == (terminated or truncated)
        assert self.locals["rewards"][0] == reward
        np.testing.assert_allclose(compiled.state, mirror.state, rtol=0.0, atol=0.0 if ONE_SINE else 1e-12)
        self.largest = max(self.largest, abs(float(mirror.state[0])))
        mirror.state = np.array(compiled.state)
        return True


class TestStatesOfCartPole:
    @pytest.mark.parametrize("name", ["CartPole", "CartPoleFriction"])
    def test_every_step_ends_where_gymnasiums_does(self, name):
        callback = BesideGymnasium(name)
        model = make_model(name, True, callback_interval=1, method=2, initial_q=20.0, exploration_fraction=0.5)
        model.learn(10_000, callback=callback, log_interval=None)
        assert callback.n_resets > 100 and callback.largest > 0.3

    @pytest.mark.parametrize("name", ["CartPole", "CartPoleFriction"])
    def test_from_states_far_and_wide(self, name):
        """Faster and more askew than learning comes to be, where a changed order of operations shows in the last bits."""
        env = CompiledVecEnv([lambda: make_env(name)]).envs[0].unwrapped
        dynamics = find_dynamics(env)(env, Grid.of(DiscretizeObservation(env, **CELLS)))
        step = freeze(dynamics.step)

        @numba.njit
        def step_all(parameters, states, actions, generator):
            ends, rewards = np.empty_like(states), np.empty(len(states))
            for i in range(len(states)):
                state = (states[i, 0], states[i, 1], states[i, 2], states[i, 3])
                end, rewards[i], _ = step(parameters, state, actions[i], generator)
                ends[i, 0], ends[i, 1], ends[i, 2], ends[i, 3] = end
            return ends, rewards

        generator = np.random.default_rng(1)
        states = generator.normal(0.0, [1.5, 2.0, 0.15, 3.0], (60_000, 4))
        actions = generator.integers(2, size=len(states))
        ends, rewards = step_all(dynamics.parameters, states, actions, generator)
        env.reset(seed=0)
        expected, expected_rewards = np.empty_like(states), np.empty(len(states))
        for i, (state, action) in enumerate(zip(states, actions.tolist(), strict=True)):
            env.state, env.steps_beyond_terminated = state, None
            expected_rewards[i] = env.step(action)[1]
            expected[i] = env.state
        np.testing.assert_allclose(ends, expected, rtol=0.0, atol=0.0 if ONE_SINE else 1e-12)
        np.testing.assert_array_equal(rewards, expected_rewards)
        assert len(np.unique(rewards)) == (2 if name == "CartPoleFriction" else 1)
