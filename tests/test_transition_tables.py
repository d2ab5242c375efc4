"""Environments with a transition table ``P``: what is read equals it, what is drawn follows it."""

from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace

import gymnasium as gym
import numba
import numpy as np
import pytest
from gymnasium.envs.toy_text.frozen_lake import generate_random_map
from gymnasium.envs.toy_text.utils import categorical_sample
from gymnasium.wrappers import TimeLimit
from helpers.both_paths import assert_same, learn
from helpers.table_env import TableEnv
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2
from stable_baselines3.common.monitor import Monitor

from sb3_adaptive_q import CompiledVecEnv, EpisodeSeriesCallback, LeanVecEnv, TabularQ
from sb3_adaptive_q.compiled.freezing import freeze
from sb3_adaptive_q.envs.hidden import OutcomeArrays
from sb3_adaptive_q.random_numbers import read_pcg64
from sb3_adaptive_q.vec_env.readings import Readings
from sb3_adaptive_q.vec_env.tabular_dynamics import TabularDynamics, read_table

#: Of every statistical test here: how often it would fail for a correct program, were its seed not fixed
ERROR_RATE = 1e-6

#: A user's own: rows of different lengths, impossible outcomes, equal outcomes, negative and broken rewards
RAGGED = [
    [[(0.5, 1, 0.25, False), (0.5, 2, -1.5, False)], [(1.0, 0, 0.0, False)]],
    [[(0.1, 0, 0.0, False), (0.2, 1, 1.0, False), (0.3, 2, 2.0, False), (0.4, 3, 3.0, True)], [(1.0, 3, 1 / 3, True)]],
    [[(0.0, 0, 9.0, True), (0.7, 1, 0.1, False), (0.0, 3, 9.0, True), (0.3, 1, 0.1, False)], [(1, 0, 7, 0), (0, 1, 8, 1)]],
    [[(1.0, 3, 0.0, True)], [(1.0, 3, 0.0, True)]],
]
ENVIRONMENTS = {
    "slippery lake": lambda: gym.make("FrozenLake-v1"),
    "firm lake": lambda: gym.make("FrozenLake-v1", is_slippery=False),
    "large lake": lambda: gym.make("FrozenLake8x8-v1"),
    "random lake": lambda: gym.make("FrozenLake-v1", desc=generate_random_map(6, p=0.7, seed=1), success_rate=0.6),
    "lake with two starts": lambda: gym.make("FrozenLake-v1", desc=["SFFS", "FHFF", "FFFG"]),
    "Taxi": lambda: gym.make("Taxi-v4"),
    "rainy Taxi": lambda: gym.make("Taxi-v4", is_rainy=True),
    "CliffWalking": lambda: gym.make("CliffWalking-v1", max_episode_steps=200),
    "slippery CliffWalking": lambda: gym.make("CliffWalkingSlippery-v1", max_episode_steps=200),
    "ragged": lambda: TimeLimit(TableEnv(RAGGED, [0.25, 0.0, 0.75, 0.0]), 50),
}
ALL = pytest.mark.parametrize("name", ENVIRONMENTS)


def pairs(env):
    """Every state and action with its outcomes."""
    return [(s, a, env.P[s][a]) for s in range(env.observation_space.n) for a in range(env.action_space.n)]


def check_frequencies(*tables):
    """
    Pearson's chi-square test.

    :param tables: pairs of (probabilities, counts), drawn independently
    :raises AssertionError: if together they are as unlikely as ``ERROR_RATE``, or what is impossible was drawn
    """
    statistic, degrees = 0.0, 0
    for probabilities, counts in tables:
        probabilities, counts = np.array(probabilities), np.array(counts)
        possible = probabilities > 0.0
        assert not counts[~possible].any()
        expected = probabilities[possible] * counts.sum()
        assert (expected >= 5.0).all(), "too few draws for the statistic's distribution"
        statistic += float(((counts[possible] - expected) ** 2 / expected).sum())
        degrees += int(possible.sum()) - 1
    assert degrees > 0
    assert chi2.sf(statistic, degrees) > ERROR_RATE, (statistic, degrees)


class TestReading:
    @ALL
    def test_every_outcome_is_there(self, name):
        env = ENVIRONMENTS[name]().unwrapped
        table = read_table(env)
        assert table.outcomes.shape[:2] == (env.observation_space.n, env.action_space.n)
        for state, action, outcomes in pairs(env):
            row = table.outcomes[state, action]
            running = 0.0
            for outcome, (probability, next_state, reward, terminated) in zip(row, outcomes, strict=False):
                running += probability
                assert (outcome["cumulative"], outcome["next_state"], outcome["reward"], bool(outcome["terminated"])) == (
                    running,
                    next_state,
                    reward,
                    bool(terminated),
                )
            assert (row["cumulative"][len(outcomes) :] == np.inf).all()
        np.testing.assert_array_equal(table.initial, np.cumsum(env.initial_state_distrib))

    def test_a_table_as_lists_is_as_good_as_dicts(self):
        env = TableEnv(RAGGED, [1.0, 0.0, 0.0, 0.0])
        expected = read_table(env)
        env.P = RAGGED
        np.testing.assert_array_equal(read_table(env).outcomes, expected.outcomes)

    def test_tables_of_a_class_are_told_apart(self):
        """Each is read once, and again where it was changed, in whatever way."""
        first, second = (TableEnv([[[[1.0, 0, reward, True]]]], [1.0]) for reward in (1.0, 2.0))
        tables = [read_table(first), read_table(second)]
        assert [table.outcomes["reward"].tolist() for table in tables] == [[[[1.0]]], [[[2.0]]]]
        assert read_table(first) is tables[0] and read_table(second) is tables[1]
        first.P[0][0][0][2] = 3.0
        assert read_table(first).outcomes["reward"].tolist() == [[[3.0]]]
        first.P[0] = {0: [(1.0, 0, 4.0, True)]}
        assert read_table(first).outcomes["reward"].tolist() == [[[4.0]]]
        assert read_table(second) is tables[1]


@st.composite
def distributions(draw):
    """Up to twelve probabilities whose sum is 1 up to rounding, zeros among them."""
    weights = draw(st.lists(st.integers(0, 20), min_size=1, max_size=12).filter(any))
    return [weight / sum(weights) for weight in weights]


#: What a generator can give, in units of 2**-53
NUMBERS = st.integers(0, 2**53 - 1) | st.sampled_from([0, 2**53 - 1])


def about_to_give(number):
    """
    :param number: a whole number from 0, below 2**53
    :return: a generator of NumPy's that gives the number in units of 2**-53 next, and its state as dynamics take it. The
        state after the draw has a high half of 0, which leaves the low half as it is: it is the output
    """
    multiplier, increment = 0x2360ED051FC65DA44385DF649FCCF645, 1
    state = ((number << 11) - increment) * pow(multiplier, -1, 2**128) % 2**128
    generator, words = np.random.default_rng(0), np.empty(4, np.uint64)
    generator.bit_generator.state = {**generator.bit_generator.state, "state": {"state": state, "inc": increment}}
    read_pcg64(generator, words)
    return generator, words


compiled_step = freeze(TabularDynamics.step)


@numba.njit
def draw(table, state, action, generator, n_draws):
    outcomes = np.empty((n_draws, 3))
    for i in range(n_draws):
        outcomes[i, 0], outcomes[i, 1], outcomes[i, 2] = compiled_step(table, state, action, generator)
    return outcomes


class TestDrawing:
    @given(distributions(), NUMBERS)
    @settings(max_examples=300)
    def test_any_number_means_the_outcome_that_it_means_to_gymnasium(self, probabilities, number):
        n = len(probabilities)
        rows = [[(p, i, float(i), False) for i, p in enumerate(probabilities)]]
        filler = [[[(1.0, 0, 0.0, True)]]] * (n - 1)
        table = read_table(TableEnv([rows, *filler], probabilities))
        generator, words = about_to_give(number)
        expected = categorical_sample(probabilities, generator)
        with np.errstate(over="ignore"):
            next_state, reward, terminated = TabularDynamics.step(table, 0, 0, words.copy())
            assert (next_state, reward, terminated) == (expected, expected, False)
            assert TabularDynamics.reset(table, words.copy()) == expected

    def test_a_number_above_a_sum_that_rounding_left_below_1_means_the_first(self):
        tenths, almost_1 = [0.1] * 10, float(np.nextafter(1.0, 0.0))
        assert np.cumsum(tenths)[-1] == almost_1
        rows = [[(p, i, 0.0, False) for i, p in enumerate(tenths)]]
        table = read_table(TableEnv([rows] + [[[(1.0, 0, 0.0, True)]]] * 9, tenths))
        generator, words = about_to_give(2**53 - 1)
        assert about_to_give(2**53 - 1)[0].random() == almost_1
        assert categorical_sample(tenths, generator) == 0
        with np.errstate(over="ignore"):
            assert TabularDynamics.step(table, 0, 0, words.copy())[0] == 0
            assert TabularDynamics.reset(table, words.copy()) == 0
            assert TabularDynamics.step(table, 0, 0, about_to_give(2**53 - 2)[1])[0] == 9

    @pytest.mark.parametrize("name", ["slippery lake", "large lake", "rainy Taxi", "slippery CliffWalking", "ragged"])
    def test_compiled_draws_follow_the_table(self, name):
        """In every state with every action; equal outcomes are counted as one."""
        env = ENVIRONMENTS[name]().unwrapped
        table, generator = read_table(env), np.empty(4, np.uint64)
        read_pcg64(np.random.default_rng(0), generator)
        tables = []
        for state, action, outcomes in pairs(env):
            expected = Counter()
            for probability, *outcome in outcomes:
                expected[tuple(map(float, outcome))] += probability
            counts = Counter(map(tuple, draw(table, state, action, generator, 1000).tolist()))
            assert set(counts) <= set(expected)
            tables.append((list(expected.values()), [counts[outcome] for outcome in expected]))
        check_frequencies(*tables)

    def test_whole_rollouts_follow_the_table(self):
        """Episodes of one step that tell by their return which outcome was drawn."""
        probabilities = [0.5, 0.05, 0.0, 0.2, 0.25]
        env = TableEnv([[[(p, 0, float(i), True) for i, p in enumerate(probabilities)]]], [1.0])
        returns = returns_of(env)
        assert len(returns) == 400_000
        check_frequencies((probabilities, np.bincount(returns.astype(int), minlength=5)))

    def test_whole_rollouts_follow_the_initial_distribution(self):
        """The first state is what an episode returns."""
        probabilities = [0.1, 0.0, 0.6, 0.3]
        env = TableEnv([[[(1.0, 0, float(state), True)]] for state in range(4)], probabilities)
        check_frequencies((probabilities, np.bincount(returns_of(env).astype(int), minlength=4)))


def returns_of(env):
    series = EpisodeSeriesCallback()
    TabularQ("MlpPolicy", CompiledVecEnv([lambda: Monitor(env)]), seed=1).learn(400_000, callback=series, log_interval=None)
    return series.returns


class TestLearning:
    @pytest.mark.parametrize("n_envs", [1, 3])
    @pytest.mark.parametrize("name", ["random lake", "lake with two starts", "rainy Taxi", "slippery CliffWalking", "ragged"])
    def test_both_paths_are_the_same_to_the_bit(self, name, n_envs):
        ordinary, compiled = (
            learn(
                TabularQ("MlpPolicy", kind([lambda: Monitor(ENVIRONMENTS[name]())] * n_envs), seed=2, method=7, initial_q=0.5),
                9_000,
            )
            for kind in (LeanVecEnv, CompiledVecEnv)
        )
        assert len(ordinary.returns) > 10
        assert_same(compiled, ordinary)

    def test_the_table_is_read_when_learning_begins(self):
        """So a table that is changed in between is learned from as it is then."""
        env = TableEnv([[[(1.0, 0, 1.0, True)]]], [1.0])
        model = TabularQ("MlpPolicy", CompiledVecEnv([lambda: Monitor(env)]), learning_rate=1.0)
        model.learn(10)
        assert model.q_table.tolist() == [[1.0]]
        env.P[0][0] = [(1.0, 0, 5.0, True)]
        model.learn(10)
        assert model.q_table.tolist() == [[5.0]]


def test_what_has_a_table_and_no_distribution_is_no_table_environment():
    from sb3_adaptive_q.vec_env.tabular_dynamics import has_table

    assert not has_table(SimpleNamespace(P={}))


def test_readings_serve_several_threads() -> None:
    """Two threads that read ever new tables do not disturb each other."""
    readings = Readings(most=3)

    def read(first: int) -> list[int]:
        return [readings.get([[i]], lambda i=i: i) for i in range(first, first + 20_000)]

    with ThreadPoolExecutor(4) as executor:
        for first, found in zip(range(4), executor.map(read, range(4)), strict=True):
            assert found == list(range(first, first + 20_000))


def test_arrays_of_outcomes_follow_the_numbers_of_states_and_actions() -> None:
    """Dicts are equal whatever the order of their entries, and numbers whatever their type."""
    whole = {0: {0: [(1.0, 0, 2, True)]}, 1: {0: [(1.0, 1, 0, False)]}}
    turned = {state: {0: [(p, s, float(r), t) for p, s, r, t in whole[state][0]]} for state in (1, 0)}
    assert whole == turned
    for tables in ([turned], [whole]):
        arrays = OutcomeArrays.of(tables)
        assert arrays.rewards[0, :, 0, 0].tolist() == [2.0, 0.0] and arrays.next_states[0, :, 0, 0].tolist() == [0, 1]
        assert [each.dtype.kind for each in arrays] == ["f", "i", "f", "b"]
    # The first with these numbers, so that no equal table has been read
    of_whole_numbers = OutcomeArrays.of([{0: {0: [(1, 0, 3, 1)]}}])
    assert [each.dtype.kind for each in of_whole_numbers] == ["f", "i", "f", "b"]
