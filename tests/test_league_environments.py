"""The environments of the literature: their printed optima, gymnasium's contract, their rules, and changes that are hidden."""

import copy
import warnings

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from helpers.decision_processes import solved
from scipy.stats import chi2
from stable_baselines3.common.monitor import Monitor

from sb3_adaptive_q import CompiledVecEnv, EpisodeSeriesCallback, LeanVecEnv, TabularQ
from sb3_adaptive_q.compiled.jit import as_python, is_disabled, machine_code
from sb3_adaptive_q.envs import PROBLEMS, TableEnv
from sb3_adaptive_q.envs.drifting_garnet import DriftingGarnetDynamics, DriftingGarnetEnv
from sb3_adaptive_q.envs.drifting_mean import DriftingMeanDynamics, DriftingMeanEnv
from sb3_adaptive_q.envs.switching_tables import SwitchingTablesDynamics, SwitchingTablesEnv
from sb3_adaptive_q.envs.tables import chain, double_loop
from sb3_adaptive_q.planning import (
    TabularModel,
    average_reward,
    optimal_return,
    policy_evaluation,
    reference,
    value_iteration,
)
from sb3_adaptive_q.random_numbers import read_pcg64

#: Of every statistical test here: how often it would fail for a correct program, were its seed not fixed
ERROR_RATE = 1e-6

#: Optimal discounted value, optimal return and return of the uniform policy within the horizon, with all printed digits
PRINTED = {
    "lake4": ("0.542026", "0.74419", "0.01394"),
    "lake8": ("0.41464", "0.91322", "0.00190"),
    "lake4_dry": ("0.95099", "1", "0.01394"),
    "taxi": ("6.327464", "7.93", "-771.09"),
    "cliff_slippery": ("-46.352672", "-64.7023", "-2079.1"),
    "windy_king": ("-10.288393", "-10.9646", "-191.49"),
    "chain": ("354.7681", "3665.8", "1311.25"),
    "double_loop": ("39.20004", "400", "158.36"),
    "dyna_maze": ("0.513342", "1", "0.1408"),
    "hasselt_grid": ("0.362656", None, None),
    "roulette": ("0", "0", None),
    "garnet": ("25.242607", None, None),
    "cliff": ("-12.247898", "-13", None),
    "lake8_dry": ("0.877521", None, None),
    "windy": (None, "-15", None),
    "six_arms": ("19159.66", None, None),
}
TABLES = [name for name, problem in PROBLEMS.items() if isinstance(problem.make().unwrapped, TableEnv)]
OWN = [name for name, problem in PROBLEMS.items() if problem.make().unwrapped.__module__.startswith("sb3_adaptive_q")]
HIDDEN = ["moving_goal", "drifting_garnet", "blocking_maze", "shortcut_maze", "hl_21_switch", "drift_01"]


def assert_printed(value, printed):
    """Equal to all the digits that are printed."""
    if printed is not None:
        unit = 10.0 ** -len(printed.partition(".")[2])
        assert value == pytest.approx(float(printed), abs=0.5001 * unit)


class TestPrintedValues:
    @pytest.mark.parametrize("name", PRINTED)
    def test_optimum_and_uniform_policy(self, name):
        scale = reference(name)
        for value, printed in zip(
            (scale.optimal_value, scale.optimal_return, scale.uniform_return), PRINTED[name], strict=True
        ):
            assert_printed(value, printed)

    def test_river_swim_as_published(self):
        scale = reference("RiverSwim-v0", gamma=0.99, largest_reward=10_000.0)
        assert_printed(scale.optimal_value, "56687.65")
        assert_printed(scale.optimal_return, "3332778")
        assert_printed(scale.uniform_return, "14419")
        assert reference("riverswim").optimal_value == pytest.approx(scale.optimal_value / 10_000)

    @pytest.mark.parametrize(
        ("env_id", "arguments", "gain"),
        [
            ("RiverSwim-v0", {"largest_reward": 10_000.0}, "668.80734"),
            ("RiverSwim-v0", {}, "0.0668807"),
            ("Chain-v0", {}, "3.6768"),
            ("DoubleLoop-v0", {}, "0.4"),
            ("SixArms-v0", {}, "6000"),
        ],
    )
    def test_gains(self, env_id, arguments, gain):
        value = average_reward(gym.make(env_id, **arguments))
        assert_printed(value, gain)
        if len(gain) < 7:  # these are printed exactly
            assert value == pytest.approx(float(gain), rel=1e-10)

    def test_taxi_has_300_starts(self):
        assert (reference("taxi").model.start == 1 / 300).sum() == 300

    @pytest.mark.parametrize(("name", "step", "steps"), [
        ("blocking_maze", 999, 10), ("blocking_maze", 1000, 16), ("shortcut_maze", 2999, 16), ("shortcut_maze", 3000, 10),
    ])  # fmt: skip
    def test_the_shortest_ways_of_the_mazes(self, name, step, steps):
        assert reference(name, step=step).optimal_value == pytest.approx(0.95 ** (steps - 1), abs=1e-12)

    def test_the_corners_of_the_moving_goal(self):
        """The two nearer corners mirror each other; the return within 200 steps is nearly 1 for all."""
        scales = [reference("moving_goal", step=40_000 * phase) for phase in range(4)]
        assert scales[3] is scales[0]
        assert scales[1].optimal_value == pytest.approx(scales[2].optimal_value, abs=1e-12)
        assert scales[0].optimal_value < scales[1].optimal_value
        assert all(scale.optimal_return > 0.9999 for scale in scales)

    def test_bets_lose_a_nineteenth(self):
        """All but the one on five numbers, which loses 3/38."""
        rewards = reference("roulette").model.rewards[:170]
        assert np.isclose(rewards, -1 / 19, rtol=0, atol=1e-12).sum() == 169
        assert np.isclose(rewards, -3 / 38, rtol=0, atol=1e-12).sum() == 1


class TestPrediction:
    def test_random_walk(self):
        values = policy_evaluation(PROBLEMS["random_walk_19"].make(), np.zeros(21, int), 1.0)
        np.testing.assert_allclose(values[1:20], (np.arange(1, 20) - 10) / 10, rtol=0, atol=1e-11)

    def test_boyan_chain(self):
        values = policy_evaluation(PROBLEMS["boyan"].make(), np.zeros(13, int), 1.0)
        np.testing.assert_allclose(values, -2.0 * np.arange(13), rtol=0, atol=1e-11)

    def test_one_state(self):
        assert reference("one_state").optimal_value == pytest.approx(10.0)
        assert reference("one_state_99").optimal_value == pytest.approx(100.0)

    @pytest.mark.parametrize(("name", "n_states", "gamma"), [("hl_21", 21, 0.9), ("hl_51", 51, 0.99)])
    def test_ring_walk(self, name, n_states, gamma):
        """The equations written down by hand; with 1 and -1 the values are antisymmetric."""
        expected = ring_walk_values(n_states, -1.0, gamma)
        values = policy_evaluation(PROBLEMS[name].make(), np.zeros(n_states, int), gamma)
        np.testing.assert_allclose(values, expected, rtol=0, atol=1e-10)
        np.testing.assert_allclose(values, -values[::-1], rtol=0, atol=1e-10)

    @pytest.mark.parametrize(("step", "reward"), [(0, -1.0), (4999, -1.0), (5000, 0.5), (10_000, -1.0)])
    def test_the_ring_walk_that_switches(self, step, reward):
        table, start = PROBLEMS["hl_21_switch"].make().unwrapped.table_at(step)
        expected = ring_walk_values(21, reward, 0.9)
        np.testing.assert_allclose(solved(table, np.ones((21, 1)), 0.9), expected, rtol=0, atol=1e-12)
        assert reference("hl_21_switch", step=step).optimal_value == pytest.approx(expected[10], abs=1e-12)
        assert np.flatnonzero(start).tolist() == [10]


def ring_walk_values(n_states, last_reward, gamma):
    middle = n_states // 2
    equations, rewards = np.eye(n_states), np.zeros(n_states)
    for state in range(1, n_states - 1):
        equations[state, [state - 1, state + 1]] -= gamma / 2
    equations[[0, n_states - 1], middle] -= gamma
    rewards[[0, n_states - 1]] = 1.0, last_reward
    return np.linalg.solve(equations, rewards)


class TestContract:
    @pytest.mark.parametrize("name", OWN)
    def test_gymnasium_finds_no_fault(self, name):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            check_env(PROBLEMS[name].make().unwrapped)

    @pytest.mark.parametrize("name", PROBLEMS)
    def test_ids_make_themselves_again(self, name):
        env = PROBLEMS[name].make()
        again = gym.make(env.spec)
        assert again.spec == env.spec
        assert (env.reset(seed=1)[0], env.step(0)[:2]) == (again.reset(seed=1)[0], again.step(0)[:2])

    @pytest.mark.parametrize("name", TABLES)
    def test_tables_compile(self, name):
        """Compilation compares the environment with its table, and refuses what differs."""
        CompiledVecEnv([PROBLEMS[name].make])

    def test_a_table_is_played_as_gymnasium_plays_it(self):
        original = gym.make("FrozenLake-v1").unwrapped
        copy = TableEnv(original.P, original.initial_state_distrib)
        assert original.reset(seed=5)[0] == copy.reset(seed=5)[0]
        for step in range(2000):
            theirs, ours = original.step(step % 4), copy.step(step % 4)
            assert theirs == ours
            if theirs[2]:
                assert original.reset() == copy.reset()

    def test_limits(self):
        limits = {name: PROBLEMS[name].make().spec.max_episode_steps for name in PROBLEMS}
        assert limits["riverswim"] == 5000
        assert limits["riverswim_osband"] == 20
        assert {limits[name] for name in ("chain", "double_loop", "roulette", "garnet", "drifting_garnet")} == {1000}
        assert {limits[name] for name in ("cliff_slippery", "windy_king", "dyna_maze", "moving_goal")} == {200}
        assert {limits[name] for name in ("hasselt_grid", "max_bias", "random_walk_19", "hl_21", "boyan")} == {None}


def walk_windy_grid(state, action, random):
    """A king's move and wind that varies, from the rules in words; where there is no wind it does not vary."""
    row, column = divmod(state, 10)
    wind = [0, 0, 0, 1, 1, 1, 2, 2, 1, 0][column]
    if wind:
        wind += random.choice([-1, 0, 1])
    north, east = [(1, 0), (-1, 0), (0, -1), (0, 1), (1, -1), (1, 1), (-1, -1), (-1, 1)][action]
    row, column = int(np.clip(row - north - wind, 0, 6)), int(np.clip(column + east, 0, 9))
    return row * 10 + column, -1.0, (row, column) == (3, 7)


def swim_river(state, action, random):
    if action == 0:
        return max(state - 1, 0), 5e-4 * (state == 0), False
    luck = random.random()
    if state == 0:
        return int(luck < 0.3), 0.0, False
    if state == 5:
        return (5, 1.0, False) if luck < 0.3 else (4, 0.0, False)
    return state + (luck < 0.3) - (luck > 0.9), 0.0, False


def walk_chain(state, action, random):
    forward = (action == 0) != (random.random() < 0.2)
    if not forward:
        return 0, 2.0, False
    return (4, 10.0, False) if state == 4 else (state + 1, 0.0, False)


def walk_hasselt_grid(state, action, random):
    row, column = divmod(state, 3)
    if (row, column) == (0, 2):
        return 2, 5.0, True
    row = min(max(row + [-1, 1, 0, 0][action], 0), 2)
    column = min(max(column + [0, 0, -1, 1][action], 0), 2)
    return row * 3 + column, float(random.choice([-12, 10])), False


def walk_slippery_grid(state, action, random):
    """The goal is bottom right; left, down, right, up, and not back."""
    row, column = divmod(state, 8)
    direction = (action + random.choice([-1, 0, 1])) % 4
    row = min(max(row + (direction == 1) - (direction == 3), 0), 7)
    column = min(max(column + (direction == 2) - (direction == 0), 0), 7)
    at_goal = (row, column) == (7, 7)
    return row * 8 + column, float(at_goal), at_goal


class TestRules:
    """Transitions of independent simulations from the rules, against the tables."""

    @pytest.mark.parametrize(
        ("name", "simulate", "ended"),
        [
            ("windy_king", walk_windy_grid, [37]),
            ("riverswim", swim_river, []),
            ("chain", walk_chain, []),
            ("hasselt_grid", walk_hasselt_grid, []),
            ("moving_goal", walk_slippery_grid, []),
        ],
    )
    def test_frequencies_follow_the_table(self, name, simulate, ended):
        """60 draws for each state and action, and Pearson's chi-square test over all of them."""
        random = np.random.default_rng(0)
        env = PROBLEMS[name].make().unwrapped
        table = env.table_at(0)[0] if hasattr(env, "table_at") else env.P
        statistic, degrees = 0.0, 0
        for state, row in table.items():
            for action, outcomes in row.items():
                if state in ended:
                    continue
                expected: dict[tuple[float, ...], float] = {}
                for probability, *outcome in outcomes:
                    key = tuple(map(float, outcome))
                    expected[key] = expected.get(key, 0.0) + 60 * probability
                counts = dict.fromkeys(expected, 0)
                for _ in range(60):
                    counts[tuple(map(float, simulate(state, action, random)))] += 1  # a KeyError is an impossible outcome
                statistic += sum((counts[key] - mean) ** 2 / mean for key, mean in expected.items())
                degrees += len(expected) - 1
        assert chi2.sf(statistic, degrees) > ERROR_RATE

    def test_max_bias(self):
        """Left in A leads to B, where everything ends with a mean of -0.1 and a variance of 1."""
        env = PROBLEMS["max_bias"].make().unwrapped
        assert env.P[0][0] == [(1.0, 1, 0.0, False)] and env.P[0][9] == [(1.0, 2, 0.0, True)]
        rewards = np.array([reward for _, _, reward, _ in env.P[1][3]])
        assert rewards.mean() == pytest.approx(-0.1) and rewards.var() == pytest.approx(1.0)

    def test_garnet_instances(self):
        """Distinct successors, rewards of noise 1 around their means, another process for another instance."""
        env = gym.make("Garnet-v0", instance=3).unwrapped
        assert gym.make("Garnet-v0", instance=3).unwrapped.P == env.P
        assert gym.make("Garnet-v0", instance=4).unwrapped.P != env.P
        means = []
        for row in env.P.values():
            for outcomes in row.values():
                assert len({next_state for _, next_state, _, _ in outcomes}) == 3 and len(outcomes) == 6
                rewards = {round(reward, 12) for _, _, reward, _ in outcomes}
                assert max(rewards) - min(rewards) == pytest.approx(2.0)
                means.append(sum(rewards) / 2)
        assert abs(np.mean(means)) < 4.9 / 120**0.5, "the mean of 120 standard normal numbers"

    def test_van_hasselts_optimum(self):
        """Four steps of -1 on average, then 5."""
        assert optimal_return(PROBLEMS["hasselt_grid"].make(), 0.95) == pytest.approx(
            5 * 0.95**4 - sum(0.95**k for k in range(4)), abs=1e-12
        )


DYNAMICS = {
    SwitchingTablesEnv: SwitchingTablesDynamics,
    DriftingGarnetEnv: DriftingGarnetDynamics,
    DriftingMeanEnv: DriftingMeanDynamics,
}


def twin_of(env):
    return DYNAMICS[type(env)](env, None)


def words_of(generator):
    words = np.zeros(4, np.uint64)
    read_pcg64(generator, words)
    return words


class TestHiddenChanges:
    def test_the_goal_jumps_when_it_should(self):
        env = gym.make("MovingGoal-v0", period=50).unwrapped
        env.reset(seed=0)
        goals = {0: 63, 1: 7, 2: 56}
        seen = set()
        for step in range(20_000):
            state, reward, terminated, *_ = env.step(int(env.np_random.integers(4)))
            goal = goals[step // 50 % 3]
            assert (reward, terminated) == (float(state == goal), state == goal)
            seen |= {step // 50 % 3} if terminated else set()
            if terminated:
                env.reset()
        assert seen == {0, 1, 2}
        assert env.clock == 20_000

    def test_a_maze_changes_once(self):
        env = gym.make("ShortcutMaze-v0", period=10).unwrapped
        assert [env.phase_at(step) for step in (0, 9, 10, 19, 20, 10**9)] == [0, 0, 1, 1, 1, 1]

    def test_seeding_turns_the_clock_back(self):
        env = PROBLEMS["moving_goal"].make()
        env.reset(seed=0)
        env.step(0)
        env.reset()
        env.step(0)
        assert env.unwrapped.clock == 2
        env.reset(seed=0)
        assert env.unwrapped.clock == 0

    def test_the_drift_begins_as_the_garnet_of_its_instance(self):
        scale = reference("drifting_garnet", instance=2)
        assert scale.optimal_value == pytest.approx(reference("garnet", instance=2).optimal_value, abs=1e-11)

    def test_the_drift_belongs_to_the_instance(self):
        envs = [gym.make("DriftingGarnet-v0", instance=instance).unwrapped for instance in (1, 1, 2)]
        for seed, env in enumerate(envs):
            env.reset(seed=seed)
        np.testing.assert_array_equal(envs[0].mean_rewards, envs[1].mean_rewards)
        assert not np.array_equal(envs[0].mean_rewards, envs[2].mean_rewards)

    def test_the_speed_of_the_drift(self):
        """Of 2000 blocks of 100 steps and 120 means: independent normal moves of variance 100 x 0.01²."""
        moves = np.diff(gym.make("DriftingGarnet-v0").unwrapped.mean_rewards, axis=0).ravel()
        assert len(moves) == 1999 * 120
        statistic = (moves**2).sum() / 0.01
        assert ERROR_RATE / 2 < chi2.sf(statistic, len(moves)) < 1 - ERROR_RATE / 2
        assert abs(moves.mean()) < 4.9 * 0.1 / len(moves) ** 0.5

    def test_the_drift_goes_on_and_then_back(self):
        env = gym.make("DriftingGarnet-v0", n_steps=300).unwrapped
        assert [env.phase_at(100 * block) for block in range(8)] == [0, 1, 2, 2, 1, 0, 0, 1]
        assert env.phase_at(99) == 0
        rewards = TabularModel.of(env.table_at(250)).rewards
        np.testing.assert_allclose(rewards, env.mean_rewards[2].ravel(), rtol=0, atol=1e-12)

    def test_rewards_are_those_of_the_table_of_the_time(self):
        env = gym.make("DriftingGarnet-v0", n_steps=1000).unwrapped
        env.reset(seed=3)
        for step in range(1000):
            state, action = env.s, step % 4
            next_state, reward, *_ = env.step(action)
            outcomes = env.table_at(step)[0][state][action]
            assert any(to == next_state and paid == pytest.approx(reward, abs=1e-12) for _, to, paid, _ in outcomes)

    def test_the_drifting_mean_is_tracked_as_theory_says(self):
        """
        With a constant step size a and moves of variance q, the squared error before an update is (a² + q) / (a (2 - a)) on
        average. 200 000 steps; their errors are correlated over some 1 / a steps.
        """
        env = PROBLEMS["drift_01"].make().unwrapped
        env.reset(seed=1)
        rate = (-0.01 + (0.01**2 + 0.04) ** 0.5) / 2
        assert rate == pytest.approx(0.0951, abs=5e-5)
        estimate, errors = 0.0, []
        for _ in range(200_000):
            _, reward, *_ = env.step(0)
            errors.append((env.mean - estimate) ** 2)
            estimate += rate * (reward - estimate)
        batches = np.mean(np.reshape(errors, (200, 1000)), axis=1)
        expected = (rate**2 + 0.01) / (rate * (2 - rate))
        assert abs(batches.mean() - expected) < 4.9 * batches.std() / 200**0.5


class TestHiddenDynamics:
    """The functions that are compiled draw the same numbers as the environment, and give the same bits."""

    @pytest.mark.parametrize("name", HIDDEN)
    def test_equal_to_the_environment(self, name):
        env = PROBLEMS[name].make().unwrapped
        if hasattr(env, "period"):
            env.period = 30
        env.reset(seed=7)
        twin = twin_of(env)
        generator = words_of(env.np_random)
        state, actions = twin.read_state(), np.random.default_rng(0)
        for step in range(1500):
            action = int(actions.integers(env.action_space.n))
            observation, reward, terminated, *_ = env.step(action)
            state, our_reward, our_terminated = as_python(twin.step)(twin.parameters, state, action, generator)
            assert (state, our_reward, bool(our_terminated)) == (twin.read_state(), reward, terminated)
            assert twin.index(twin.parameters, state) == observation
            if terminated or step % 40 == 39:
                observation, _ = env.reset()
                state = as_python(twin.reset)(twin.parameters, state, generator)
                assert state == twin.read_state() and twin.index(twin.parameters, state) == observation
        assert len(state) <= 8 and all(type(part) is float for part in state)

    @pytest.mark.skipif(is_disabled(), reason="Numba is switched off")
    @pytest.mark.parametrize("name", ["moving_goal", "drifting_garnet", "drift_01"])
    def test_compiled(self, name):
        """10 000 steps across changes as machine code, and as Python."""
        env = PROBLEMS[name].make().unwrapped
        if hasattr(env, "period"):
            env.period = 3000
        env.reset(seed=2)
        twin = twin_of(env)

        step, reset = type(twin).step, type(twin).reset

        def play(parameters, state, generator, n_actions):
            total = 0.0
            for i in range(10_000):
                state, reward, terminated = step(parameters, state, i * i % n_actions, generator)
                total += reward
                if terminated:
                    state = reset(parameters, state, generator)
            return total, state

        arguments = (twin.parameters, twin.read_state(), words_of(np.random.default_rng(0)), int(env.action_space.n))
        compiled = machine_code(play, arguments)(*copy.deepcopy(arguments))
        assert compiled == as_python(play)(*arguments)

    @pytest.mark.parametrize("name", HIDDEN)
    def test_a_state_is_written_as_it_is_read(self, name):
        env = PROBLEMS[name].make().unwrapped
        env.reset(seed=0)
        twin = twin_of(env)
        for _ in range(5):
            env.step(0)
        state = twin.read_state()
        env.step(0)
        twin.write_state(state)
        assert twin.read_state() == state

    def test_phases_that_do_not_fit_are_refused(self):
        with pytest.raises(ValueError, match="one shape"):
            SwitchingTablesEnv([chain(), double_loop()], 10)
        with pytest.raises(ValueError, match="at least 1 step"):
            SwitchingTablesEnv([chain()], 0)


class TestLearning:
    @pytest.mark.parametrize(
        ("name", "n_envs"), [("moving_goal", 1), ("moving_goal", 3), ("drifting_garnet", 1), ("drift_01", 1)]
    )
    def test_both_paths_are_the_same_to_the_bit(self, name, n_envs):
        """Across changes, in rollouts of 700 steps, and on in a second call of ``learn``."""

        def make():
            env = PROBLEMS[name].make()
            if hasattr(env.unwrapped, "period"):
                env.unwrapped.period = 1000
            return Monitor(env)

        left = []
        for kind in (LeanVecEnv, CompiledVecEnv):
            series = EpisodeSeriesCallback()
            model = TabularQ("MlpPolicy", kind([make] * n_envs), seed=2, method=7, callback_interval=700)
            for _ in range(2):
                model.learn(2500, callback=series, log_interval=None, reset_num_timesteps=False)
            clocks = [getattr(env.unwrapped, "clock", 0) for env in model.get_env().envs]
            left.append((model.q_table.tobytes(), model.mu, series.returns.tolist(), clocks))
        assert left[0] == left[1]
        assert np.frombuffer(left[0][0]).any() or name == "moving_goal"


def test_values_scale_with_the_rewards():
    """RiverSwim's rewards may be divided by any number: values are divided by it, and the best policy stays."""
    small, large = (gym.make("RiverSwim-v0", largest_reward=scale) for scale in (1.0, 10_000.0))
    np.testing.assert_allclose(value_iteration(large, 0.99), 10_000 * value_iteration(small, 0.99), rtol=1e-11)
