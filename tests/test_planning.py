"""Dynamic programming: against values worked out by hand, linear equations, forward simulation and laws."""

from itertools import product

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import NormalizeReward, TransformReward
from helpers.decision_processes import policies, processes, solved, under
from helpers.own_rules import mirrored_lake
from hypothesis import given, settings
from hypothesis import strategies as st
from stable_baselines3.common.monitor import Monitor

from sb3_adaptive_q.envs import TableEnv
from sb3_adaptive_q.planning import (
    TabularModel,
    action_values,
    average_reward,
    epsilon_greedy_optimum,
    epsilon_greedy_policy,
    expected_return,
    greedy_policy,
    optimal_policy,
    optimal_return,
    policy_evaluation,
    reference,
    uniform_policy,
    value_iteration,
)

#: To stay for 1, or to leave for 3, which succeeds half of the time
STAY_OR_LEAVE = ({0: {0: [(1.0, 0, 1.0, False)], 1: [(0.5, 0, 0.0, False), (0.5, 0, 3.0, True)]}}, [1.0])
GAMMAS = st.sampled_from([0.0, 0.5, 0.9])


class TestByHand:
    def test_optimal_values(self):
        """Staying for ever is worth 1 / (1 - gamma); leaving v = (gamma v + 3) / 2, so 3 / (2 - gamma)."""
        assert value_iteration(STAY_OR_LEAVE, 0.9) == pytest.approx([10.0], abs=1e-11)
        assert value_iteration(STAY_OR_LEAVE, 0.25) == pytest.approx([12 / 7], abs=1e-12)
        assert optimal_policy(STAY_OR_LEAVE, 0.9).tolist() == [0]
        assert optimal_policy(STAY_OR_LEAVE, 0.25).tolist() == [1]

    def test_a_horizon(self):
        """
        With one step left leaving is worth 1.5; with two, 1.5 + 1.5 / 2 = 2.25 against 1 + 1.5 by staying first; with three,
        1 + 2.5. A policy that always leaves gets 1.5 (1 + 1/2 + 1/4).
        """
        assert [optimal_return(STAY_OR_LEAVE, horizon=n) for n in range(4)] == [0.0, 1.5, 2.5, 3.5]
        assert expected_return(STAY_OR_LEAVE, [1], horizon=3) == 2.625
        assert expected_return(STAY_OR_LEAVE, [1], gamma=0.5, horizon=3) == 1.5 * (1 + 1 / 4 + 1 / 16)
        assert expected_return(STAY_OR_LEAVE, [0], horizon=1000) == 1000.0

    def test_the_uniform_policy(self):
        """v = (1 + v) / 2 + (v / 2 + 1.5) / 2, so v / 4 = 1.25."""
        assert uniform_policy(STAY_OR_LEAVE).tolist() == [[0.5, 0.5]]
        assert expected_return(STAY_OR_LEAVE, uniform_policy(STAY_OR_LEAVE)) == pytest.approx(5.0, abs=1e-11)

    def test_epsilon_greedy(self):
        """At gamma 0.9 staying and epsilon 0.2: v = 0.9 (1 + 0.9 v) + 0.1 (1.5 + 0.45 v), so 0.145 v = 1.05."""
        best = epsilon_greedy_optimum(STAY_OR_LEAVE, 0.2, 0.9)
        assert best.start_value == pytest.approx(1.05 / 0.145, abs=1e-11)
        np.testing.assert_allclose(best.policy, [[0.9, 0.1]], rtol=1e-15)

    def test_ties_go_to_the_first_action(self):
        assert greedy_policy([[1.0, 2.0, 2.0], [0.0, 0.0, 0.0]]).tolist() == [1, 0]
        assert greedy_policy([[1.0, 1.0 + 1e-12]]).tolist() == [1]
        table = {0: {a: [(1.0, 0, r, True)] for a, r in enumerate([0.0, 0.3, 0.1 + 0.2])}}
        assert optimal_policy((table, [1.0]), 0.9).tolist() == [1], "0.1 + 0.2 is larger by rounding alone"

    def test_gain_of_a_periodic_process(self):
        """0 -> 1 -> 0 with rewards of 1 and 4."""
        table = {0: {0: [(1.0, 1, 1.0, False)]}, 1: {0: [(1.0, 0, 4.0, False)]}}
        assert average_reward((table, [1.0, 0.0])) == pytest.approx(2.5, abs=1e-11)

    def test_gain_of_a_choice(self):
        """To stay in 0 pays 1; to go round through 1 pays 0 and then 3."""
        table = {0: {0: [(1.0, 0, 1.0, False)], 1: [(1.0, 1, 0.0, False)]}, 1: {a: [(1.0, 0, 3.0, False)] for a in (0, 1)}}
        assert average_reward((table, [1.0, 0.0])) == pytest.approx(1.5, abs=1e-11)
        assert average_reward((table, [1.0, 0.0]), [0, 0]) == pytest.approx(1.0, abs=1e-11)
        # Uniform: two thirds of the time in 0, where half of the choices pay 1, and one third in 1
        assert average_reward((table, [1.0, 0.0]), np.full((2, 2), 0.5)) == pytest.approx(4 / 3, abs=1e-11)

    def test_reachable_states(self):
        """State 2 is entered only where the episode ends, 3 never, and nothing leads to 4 with a positive probability."""
        table = {state: {0: [(1.0, state, 0.0, False)]} for state in range(5)}
        table[0] = {0: [(0.5, 1, 0.0, False), (0.5, 2, 1.0, True), (0.0, 4, 0.0, False)]}
        assert TabularModel(table, [1.0, 0, 0, 0, 0]).reachable_states().tolist() == [True, True, False, False, False]


class TestAgainstOtherMethods:
    @given(st.data(), GAMMAS)
    @settings(max_examples=30)
    def test_policy_evaluation_solves_the_linear_equations(self, data, gamma):
        table, start = data.draw(processes())
        policy = data.draw(policies(table))
        expected = solved(table, policy, gamma)
        np.testing.assert_allclose(policy_evaluation((table, start), policy, gamma), expected, rtol=0, atol=1e-10)
        assert expected_return((table, start), policy, gamma) == pytest.approx(start @ expected, abs=1e-10)

    @given(st.data(), GAMMAS | st.just(1.0), st.integers(0, 40))
    @settings(max_examples=30)
    def test_a_return_is_the_sum_of_what_the_states_on_the_way_pay(self, data, gamma, horizon):
        """Forward: the distribution of the state after every step."""
        table, start = data.draw(processes())
        policy = data.draw(policies(table))
        transitions, rewards = under(table, policy)
        distribution, total = np.array(start), 0.0
        for step in range(horizon):
            total += gamma**step * distribution @ rewards
            distribution = distribution @ transitions
        assert expected_return((table, start), policy, gamma, horizon) == pytest.approx(total, abs=1e-11)
        assert start @ policy_evaluation((table, start), policy, gamma, horizon) == pytest.approx(total, abs=1e-11)

    @given(processes(), GAMMAS)
    @settings(max_examples=30)
    def test_value_iteration_is_the_best_of_all_policies(self, process, gamma):
        table, start = process
        every = [np.eye(len(table[0]))[list(actions)] for actions in product(range(len(table[0])), repeat=len(table))]
        best = np.max([solved(table, policy, gamma) for policy in every], axis=0)
        np.testing.assert_allclose(value_iteration((table, start), gamma), best, rtol=0, atol=1e-10)

    def test_a_long_horizon_after_the_values_have_stopped_changing(self):
        """The sweeps that are left out would change nothing: a path of three steps and a million left."""
        table = {s: {0: [(1.0, s + 1, float(s), s == 2)]} for s in range(3)} | {3: {0: [(1.0, 3, 0.0, True)]}}
        assert expected_return((table, [1.0, 0, 0, 0]), [0, 0, 0, 0], horizon=10**6) == 3.0

    @given(processes(continuing=True))
    @settings(max_examples=30)
    def test_gain_is_the_mean_over_the_stationary_distribution(self, process):
        """Every action also leads anywhere with a little probability, so that there is one."""
        table, start = process
        n = len(table)
        mixed = {
            s: {
                a: [(0.8 * p, t, r, False) for p, t, r, _ in outcomes] + [(0.2 / n, t, 0.0, False) for t in range(n)]
                for a, outcomes in row.items()
            }
            for s, row in table.items()
        }
        policy = np.full((n, len(table[0])), 1.0 / len(table[0]))
        transitions, rewards = under(mixed, policy)
        stationary = np.linalg.matrix_power(transitions, 1024)[0]
        assert average_reward((mixed, start), policy) == pytest.approx(stationary @ rewards, abs=1e-10)
        assert average_reward((mixed, start)) >= stationary @ rewards - 1e-10

    @pytest.mark.parametrize("epsilon", [0.0, 0.1, 0.5, 1.0])
    def test_the_epsilon_greedy_optimum_by_policy_iteration(self, epsilon):
        """On the cliff, with gamma 0.99: evaluate by linear equations, improve, until nothing changes."""
        env = gym.make("CliffWalking-v1").unwrapped
        actions = np.zeros(48, int)
        for _ in range(100):
            values = solved(env.P, epsilon / 4 + (1 - epsilon) * np.eye(4)[actions], 0.99)
            looking_ahead = action_values(env, values, 0.99)
            better = looking_ahead.argmax(axis=1)
            gains = looking_ahead[np.arange(48), better] - looking_ahead[np.arange(48), actions]
            if epsilon == 1.0 or gains.max() < 1e-9:
                break
            actions = np.where(gains > 1e-9, better, actions)
        best = epsilon_greedy_optimum(env, epsilon, 0.99)
        np.testing.assert_allclose(best.values, values, rtol=0, atol=1e-8)
        assert expected_return(env, best.policy, 0.99) == pytest.approx(best.start_value, abs=1e-8)


class TestLaws:
    @given(st.data(), GAMMAS, st.sampled_from([None, 0, 1, 7]))
    @settings(max_examples=30)
    def test_no_policy_beats_the_optimum(self, data, gamma, horizon):
        process = data.draw(processes())
        policy = data.draw(policies(process[0]))
        best, values = (
            value_iteration(process, gamma, horizon),
            policy_evaluation(process, policy, gamma, horizon),
        )
        assert (values <= best + 1e-10).all()

    @given(processes(), GAMMAS)
    @settings(max_examples=30)
    def test_the_optimal_policy_attains_the_optimum(self, process, gamma):
        policy = optimal_policy(process, gamma)
        best = value_iteration(process, gamma)
        np.testing.assert_allclose(policy_evaluation(process, policy, gamma), best, rtol=0, atol=1e-7)
        np.testing.assert_allclose(action_values(process, best, gamma).max(axis=1), best, rtol=0, atol=1e-10)

    @given(processes(), GAMMAS)
    @settings(max_examples=30)
    def test_exploration_costs(self, process, gamma):
        """From the optimum without it down to the uniform policy."""
        values = [epsilon_greedy_optimum(process, epsilon, gamma).values for epsilon in (0.0, 0.3, 1.0)]
        np.testing.assert_allclose(values[0], value_iteration(process, gamma), rtol=0, atol=1e-10)
        np.testing.assert_allclose(values[2], policy_evaluation(process, uniform_policy(process), gamma), rtol=0, atol=1e-10)
        assert (values[0] >= values[1] - 1e-10).all() and (values[1] >= values[2] - 1e-10).all()

    @given(processes())
    @settings(max_examples=30)
    def test_actions_are_policies_of_probability_1(self, process):
        actions = np.arange(len(process[0])) % len(process[0][0])
        chosen = epsilon_greedy_policy(actions, 0.0, len(process[0][0]))
        for evaluate in (policy_evaluation, expected_return):
            np.testing.assert_array_equal(evaluate(process, actions, 0.9, 7), evaluate(process, chosen, 0.9, 7))

    def test_a_model_is_read_once(self):
        model = TabularModel.of(STAY_OR_LEAVE)
        assert TabularModel.of(model) is model
        env = gym.make("FrozenLake-v1")
        assert expected_return(TabularModel.of(env), np.zeros(16, int), 0.9) == expected_return(env, np.zeros(16, int), 0.9)


class TestKnownValues:
    def test_expected_sarsa_on_the_cliff(self):
        """The best that explores with probability 0.1 returns -20.71; it keeps away from the edge."""
        best = epsilon_greedy_optimum(gym.make("CliffWalking-v1"), 0.1)
        assert best.start_value == pytest.approx(-20.71, abs=0.005)
        state, rows = 36, []
        while state != 47:
            state = gym.make("CliffWalking-v1").unwrapped.P[state][int(best.actions[state])][0][1]
            rows.append(state // 12)
        assert min(rows) == 1 and len(rows) == 15

    def test_the_edge_of_the_cliff_while_exploring(self):
        """Q-learning's limit is the way along the edge, of 13 steps; with epsilon 0.1 it falls off now and then."""
        env = gym.make("CliffWalking-v1")
        edge = epsilon_greedy_policy(optimal_policy(env, 1.0), 0.1, 4)
        assert expected_return(env, optimal_policy(env, 1.0)) == -13.0
        assert expected_return(env, edge) < -45.0

    def test_the_windy_grid_takes_15_steps(self):
        assert optimal_return(gym.make("WindyGrid-v0")) == -15.0


class TestReferences:
    def test_a_name_brings_discount_and_horizon(self):
        lake = reference("lake4")
        assert (lake.gamma, lake.horizon) == (0.99, 100)
        assert reference("lake4") is lake
        assert lake.measure(uniform_policy(lake.model)) == lake.uniform_return
        assert lake.score(lake.uniform_return) == 0.0
        assert lake.score(lake.optimal_return) == 1.0

    def test_ids_and_environments(self):
        env = gym.make("FrozenLake-v1", is_slippery=False)
        expected = reference("lake4_dry")
        for other in (reference(env, gamma=0.99), reference("FrozenLake-v1", gamma=0.99, is_slippery=False)):
            assert (other.optimal_value, other.uniform_return) == (expected.optimal_value, expected.uniform_return)
        assert reference(env, gamma=0.99, horizon=5).optimal_return == 0.0

    def test_without_a_horizon_returns_are_discounted(self):
        grid = reference("hasselt_grid")
        assert grid.horizon is None
        assert grid.optimal_return == grid.optimal_value == grid.measure(optimal_policy(grid.model, 0.95))

    def test_where_there_is_nothing_to_choose(self):
        with pytest.raises(ValueError, match="no scale"):
            reference("hl_21").score(0.0)


class TestBadInput:
    def test_no_table(self):
        with pytest.raises(ValueError, match=r"CartPoleEnv has no transition table.*rollouts"):
            value_iteration(gym.make("CartPole-v1"), 0.9)
        with pytest.raises(ValueError, match="changes with time"):
            value_iteration(gym.make("MovingGoal-v0"), 0.9)

    def test_a_wrapper_that_changes_what_the_table_says(self):
        lake = gym.make("FrozenLake-v1")
        for wrapped in (mirrored_lake(), TransformReward(lake, lambda reward: -reward), NormalizeReward(lake)):
            with pytest.raises(
                ValueError, match=r"may change actions, rewards or observations, so the table of FrozenLakeEnv"
            ):
                value_iteration(Monitor(wrapped), 0.9)
        assert value_iteration(Monitor(gym.make("FrozenLake-v1")), 0.99)[0] == pytest.approx(0.542, abs=1e-3)

    @pytest.mark.parametrize(
        ("outcomes", "message"),
        [
            ([], "probabilities"),
            ([(0.5, 0, 0.0, False)], "sum to 1"),
            ([(1.0, 1, 0.0, False)], "next states"),
            ([(1.0, 0, np.nan, False)], "finite"),
            ([(1.0, 0, 0.0)], "must be a list of"),
            (3, "must be a list of"),
        ],
    )
    def test_a_wrong_row(self, outcomes, message):
        with pytest.raises(ValueError, match=message):
            TabularModel({0: {0: outcomes}}, [1.0])

    def test_a_wrong_table(self):
        with pytest.raises(ValueError, match=r"P\[1\]\[1\] is missing"):
            TabularModel([STAY_OR_LEAVE[0][0], {0: [(1.0, 0, 0.0, True)]}], [1.0, 0.0])
        with pytest.raises(ValueError, match="start distribution"):
            TabularModel(STAY_OR_LEAVE[0], [0.5, 0.5])
        with pytest.raises(ValueError, match="at least one state"):
            TabularModel({}, [])
        with pytest.raises(ValueError, match=r"P\[1\] has more actions than P\[0\]"):
            TabularModel([{0: [(1.0, 1, 0.0, False)]}, STAY_OR_LEAVE[0][0]], [1.0, 0.0])
        with pytest.raises(ValueError, match=r"P\[0\] is missing: the table must have the states 0 to 0"):
            TabularModel({1: {0: [(1.0, 1, 0.0, True)]}}, [1.0])

    @pytest.mark.parametrize("start", [[1.0], [0.5], None])
    def test_an_environment_of_a_wrong_table(self, start):
        rows = [(0.2, 0, 1.0, True), (0.8 if start != [1.0] else 0.1, 0, 0.0, True)]
        with pytest.raises(ValueError, match=r"sum to 1|probabilities in the start distribution"):
            TableEnv({0: {0: rows}}, start)

    @pytest.mark.parametrize("policy", [[2], [-1], [0, 0], [0.5], [[0.5, 0.4]], [[1.5, -0.5]], [[1.0, 0.0, 0.0]]])
    def test_a_wrong_policy(self, policy):
        with pytest.raises(ValueError, match=r"policy|actions"):
            expected_return(STAY_OR_LEAVE, policy, 0.9)

    def test_numbers_out_of_range(self):
        with pytest.raises(ValueError, match="gamma"):
            value_iteration(STAY_OR_LEAVE, 1.5)
        for gamma in (None, "0.9", np.nan):
            with pytest.raises(ValueError, match="gamma must be a number between 0 and 1"):
                value_iteration(STAY_OR_LEAVE, gamma)
        for horizon in (-1, 1.5, "3", np.inf):
            with pytest.raises(ValueError, match="horizon must be a whole number"):
                value_iteration(STAY_OR_LEAVE, 0.9, horizon)
        with pytest.raises(ValueError, match="epsilon"):
            epsilon_greedy_optimum(STAY_OR_LEAVE, 2.0)

    def test_values_that_are_infinite(self):
        with pytest.raises(ValueError, match="never end"):
            value_iteration(STAY_OR_LEAVE, 1.0)
        with pytest.raises(ValueError, match="never end"):
            expected_return(STAY_OR_LEAVE, [0])

    def test_a_policy_may_be_stuck_where_it_never_comes(self):
        """On the cliff the optimal policy is stuck nowhere on its way; in corners that it avoids this one is."""
        env = gym.make("CliffWalking-v1")
        policy = optimal_policy(env, 1.0)
        policy[0] = 3
        assert expected_return(env, policy) == -13.0
        with pytest.raises(ValueError, match="never end"):
            policy_evaluation(env, policy, 1.0)

    def test_gains_that_do_not_exist(self):
        with pytest.raises(ValueError, match="no episode terminates"):
            average_reward(STAY_OR_LEAVE)
        apart = {state: {0: [(1.0, state, float(state), False)]} for state in (0, 1)}
        with pytest.raises(ValueError, match="every first state"):
            average_reward((apart, [0.5, 0.5]))

    def test_no_discount_factor(self):
        with pytest.raises(ValueError, match="gamma="):
            reference("FrozenLake-v1")
