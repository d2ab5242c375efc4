"""The paper's eight methods: values worked by hand in exact fractions, and the laws the equations obey."""

from fractions import Fraction

import numpy as np
import pytest
from helpers.environments import Episode, MarkovEnv, ScriptedEnv, Step
from helpers.paper_learner import greedy, learn_by_the_paper, paper_rates, paper_start
from helpers.recording import Recorder
from hypothesis import given, settings
from hypothesis import strategies as st
from stable_baselines3.common.vec_env import DummyVecEnv

from sb3_adaptive_q import METHODS, TabularQ, method

NUMBERS = sorted(METHODS)
SELF_ADAPTIVE = (5, 6, 7, 8)
READINGS = {5: "same", 6: "same", 7: "next", 8: "next"}

# Ten steps with γ = 1/2, greedy. Q_0 is 0, but for Q_0(3, 0) = 0.125 and Q_0(3, 1) = 0.25. The actions come out alike
# for every method; what a step is there for stands beside it, Q and Q' meaning the two values that Eqs. 7-10 compare.
SCRIPT = [
    Episode(
        0,
        [
            Step(100.0, 1),  # action 0: a tie, Q' = 0 >= Q = 0
            Step(0.0, 0),  # action 0: Q' > Q
            Step(0.0, 0),  # action 0: back into the same state: Q' is Q, and a tie, in the table before the update alone
            Step(0.0, 2),  # action 0: Q' < Q
            Step(-100.0, 0, "terminated"),  # action 0: the terminal state has a row with values, but counts as 0
        ],
    ),
    Episode(2, [Step(0.0, 0, "truncated")]),  # action 1: bootstraps from state 0, not from 1, where the next one starts
    Episode(1, [Step(0.0, 2, "truncated")]),  # action 0: Q' < Q for Methods 7 and 8, but not with the value of the start, 0
    Episode(
        0,
        [
            Step(0.0, 1),  # action 0: Q' < Q
            Step(0.0, 3),  # action 0: a small difference, which Eqs. 7 and 8 need not clip
            Step(0.0, 3, "terminated"),  # action 1: Q' = 0 < Q = 0.25
        ],
    ),
]
CHANGED = [(0, 0), (1, 0), (0, 0), (0, 0), (2, 0), (2, 1), (1, 0), (0, 0), (1, 0), (3, 1)]
INITIAL = [["0", "0"], ["0", "0"], ["0", "0"], ["0.125", "0.25"]]

# Worked by hand: for each step the μ of the update and the value it gives to the entry of CHANGED; then the last μ.
# fmt: off
BY_HAND = {
    1: ("0.01 0.01 0.01 0.01 0.01 0.01 0.01 0.01 0.01 0.01 0.01",
        "1 0.005 0.995 0.98505 -1 0.00492525 0.00497462625 0.97522437313125 0.0061748799875 0.2475"),
    2: ("0.05 0.05 0.05 0.05 0.05 0.05 0.05 0.05 0.05 0.05 0.05",
        "5 0.125 4.875 4.63125 -5 0.11578125 0.12164453125 4.40272861328125 0.1218123046875 0.2375"),
    3: ("0.05 0.046 0.042 0.038 0.034 0.03 0.026 0.022 0.018 0.014 0.01",
        "5 0.115 4.895 4.70899 -3.4 0.07063485 0.11292825305 4.60663443078355 0.1131455444951 0.2465"),
    4: ("0.01 0.014 0.018 0.022 0.026 0.03 0.034 0.038 0.042 0.046 0.05",
        "1 0.007 0.991 0.969198 -2.6 0.01453797 0.00700914549 0.93250164976431 0.01196476137942 0.2385"),
    5: ("0.01 0.01 0.001 0.001 0.01 0.01 0.01 0.01 0.01 0.003998748125625 0.01",
        "1 0.005 0.9995 0.9985005 -1 0.0049925025 0.0049749625125 0.9885403698125625 0.006175212887375 0.24900031296859375"),
    6: ("0.01 0.01 0.01 0.01 0.001 0.001 0.001 0.001 0.001 0.007000237686875 0.001",
        "1 0.005 0.995 0.98505 -0.1 0.000492525 0.0049952462625 0.98406744762313125 0.0051152510162375 0.24824994057828125"),
    7: ("0.01 0.01 0.01 0.01 0.005 0.01 0.01 0.005 0.001 0.006 0.001",
        "1 0.005 0.995 0.98505 -0.5 0.00492525 0.00497462625 0.980137186565625 0.00509465162375 0.2485"),
    8: ("0.01 0.005 0.001 0.001 0.006 0.001 0.001 0.006 0.01 0.005 0.01",
        "1 0.0025 0.9995 0.9985005 -0.6 0.00049925025 0.002497749625125 0.992516990248875375 0.00372277212887375 0.24875"),
}
# fmt: on


def fractions(text):
    return [Fraction(word) for word in text.split()]


def tables_by_hand(number):
    table = [[Fraction(value) for value in row] for row in INITIAL]
    tables = [[list(row) for row in table]]
    for (state, action), value in zip(CHANGED, fractions(BY_HAND[number][1]), strict=True):
        table[state][action] = value
        tables.append([list(row) for row in table])
    return tables


def make_model(envs, table, **arguments):
    """A greedy learner whose table starts from the given one."""
    model = TabularQ(
        "MlpPolicy",
        DummyVecEnv([lambda env=env: env for env in envs]),
        exploration_initial_eps=0.0,
        exploration_final_eps=0.0,
        **{"ties": "first", **arguments},
    )
    model.q_table[:] = np.array([[float(value) for value in row] for row in table])
    return model


def train(envs, table, n_steps, **arguments):
    """Train for ``n_steps`` in every environment; the recorder shows every table and μ on the way."""
    recorder = Recorder()
    make_model(envs, table, **arguments).learn(n_steps * len(envs), callback=recorder, log_interval=None)
    return recorder


def assert_moments_equal(recorder, moments, exactly=False):
    tolerance = {"rtol": 0.0, "atol": 0.0} if exactly else {"rtol": 1e-13, "atol": 1e-15}
    assert len(recorder.rates) == len(moments)
    for step, (table, rate, moment) in enumerate(zip(recorder.tables, recorder.rates, moments, strict=True)):
        expected = np.array([[float(value) for value in row] for row in moment.table])
        np.testing.assert_allclose(table, expected, **tolerance, err_msg=f"table after {step} steps")
        np.testing.assert_allclose(rate, float(moment.mu), **tolerance, err_msg=f"μ after {step} steps")


class TestByHand:
    @pytest.mark.parametrize("number", NUMBERS)
    def test_reference_agrees_with_hand_worked_values_exactly(self, number):
        moments = learn_by_the_paper(
            [ScriptedEnv(SCRIPT)],
            10,
            tables_by_hand(number)[0],
            Fraction(1, 2),
            paper_start(number),
            paper_rates()[number],
            READINGS.get(number, "next"),
        )
        assert [moment.mu for moment in moments] == fractions(BY_HAND[number][0])
        assert [moment.table for moment in moments] == tables_by_hand(number)

    @pytest.mark.parametrize("number", NUMBERS)
    @pytest.mark.parametrize("installed_by", ["constructor", "callback"])
    def test_sequence_of_tables_and_rates(self, number, installed_by):
        recorder = Recorder()
        chosen = {"method": number} if installed_by == "constructor" else {}
        model = make_model([ScriptedEnv(SCRIPT)], INITIAL, gamma=0.5, **chosen)
        callbacks = [recorder] if installed_by == "constructor" else [method(number), recorder]
        model.learn(10, callback=callbacks, log_interval=None)

        assert [int(action[0]) for action in recorder.actions] == [action for _, action in CHANGED]
        rates = [float(rate) for rate in fractions(BY_HAND[number][0])]
        np.testing.assert_allclose(recorder.rates, rates, rtol=1e-13)
        tables = np.array([[[float(value) for value in row] for row in table] for table in tables_by_hand(number)])
        np.testing.assert_allclose(recorder.tables, tables, rtol=1e-13, atol=1e-16)

    def test_learning_rate_without_a_method(self):
        recorder = train([ScriptedEnv(SCRIPT)], INITIAL, 10, gamma=0.5, learning_rate=0.05)
        tables = np.array([[[float(value) for value in row] for row in table] for table in tables_by_hand(2)])
        np.testing.assert_allclose(recorder.tables, tables, rtol=1e-13, atol=1e-16)

    def test_learning_rate_schedule_is_the_rate_of_the_remaining_progress(self):
        """The schedule that is Method 3 in other words."""
        recorder = train([ScriptedEnv(SCRIPT)], INITIAL, 10, gamma=0.5, learning_rate=lambda left: 0.01 + 0.04 * left)
        np.testing.assert_allclose(recorder.rates, [float(rate) for rate in fractions(BY_HAND[3][0])], rtol=1e-12)
        tables = np.array([[[float(value) for value in row] for row in table] for table in tables_by_hand(3)])
        np.testing.assert_allclose(recorder.tables, tables, rtol=1e-12, atol=1e-16)


class TestOptions:
    @pytest.mark.parametrize("number", SELF_ADAPTIVE)
    @pytest.mark.parametrize("reading", ["same", "next", "max"])
    def test_next_action(self, number, reading):
        recorder = train([ScriptedEnv(SCRIPT)], INITIAL, 10, gamma=0.5, method=number, method_kwargs={"next_action": reading})
        table = tables_by_hand(number)[0]
        moments = learn_by_the_paper(
            [ScriptedEnv(SCRIPT)], 10, table, Fraction(1, 2), Fraction("0.01"), paper_rates()[number], reading
        )
        assert_moments_equal(recorder, moments)

    @pytest.mark.parametrize("reading", ["same", "next", "max"])
    def test_next_action_by_hand(self, reading):
        """An agent that always explores goes from state 0, where Q = 0, to state 1: μ_1 = 0.01 - 0.05 Q(1, a)."""
        rate_by_value = {0.04: 0.008, -0.04: 0.012, 0.06: 0.007}
        values = list(rate_by_value)
        seen = set()
        for seed in range(12):
            env = MarkovEnv([[Step(0.0, 1)] * 3, [Step(0.0, 1)] * 3])
            chosen = {"next_action": reading, "upper": 0.1}
            model = TabularQ(
                "MlpPolicy", env, ties="first", method=5, method_kwargs=chosen, exploration_final_eps=1.0, seed=seed
            )
            model.q_table[1] = values
            recorder = Recorder()
            model.learn(2, callback=recorder, log_interval=None)
            actions = tuple(int(action[0]) for action in recorder.actions)
            meant = {"same": values[actions[0]], "next": values[actions[1]], "max": 0.06}[reading]
            assert recorder.rates[1] == pytest.approx(rate_by_value[meant], rel=1e-13)
            seen.add(actions)
        assert len(seen) > 3

    @pytest.mark.parametrize("number", SELF_ADAPTIVE)
    @pytest.mark.parametrize("mu_0", [0.001, 0.0075])
    def test_reset_each_episode(self, number, mu_0):
        chosen = {"method": number, "method_kwargs": {"reset_each_episode": True, "mu_0": mu_0}}
        recorder = train([ScriptedEnv(SCRIPT)], INITIAL, 10, gamma=0.5, **chosen)
        start = Fraction(str(mu_0))
        moments = learn_by_the_paper(
            [ScriptedEnv(SCRIPT)],
            10,
            tables_by_hand(number)[0],
            Fraction(1, 2),
            start,
            paper_rates()[number],
            READINGS[number],
            mu_at_start=start,
        )
        assert_moments_equal(recorder, moments)
        first_of_episodes = [0, 5, 6, 7, 10]
        assert [recorder.rates[step] for step in first_of_episodes] == [mu_0] * 5
        assert len(set(recorder.rates)) > 1

    @pytest.mark.parametrize("number", NUMBERS)
    def test_progress_counts_episodes_where_their_total_is_given(self, number):
        """Four of eight episodes end within the ten steps; the paper's "iteration" t is a finished episode."""
        recorder = train([ScriptedEnv(SCRIPT)], INITIAL, 10, gamma=0.5, method=number, total_episodes=8)
        moments = learn_by_the_paper(
            [ScriptedEnv(SCRIPT)],
            10,
            tables_by_hand(number)[0],
            Fraction(1, 2),
            paper_start(number),
            paper_rates()[number],
            READINGS.get(number, "next"),
            total_episodes=8,
        )
        assert_moments_equal(recorder, moments)
        if number == 3:
            np.testing.assert_allclose(recorder.rates, [0.05] * 5 + [0.045, 0.04, 0.035, 0.035, 0.035, 0.03], rtol=1e-13)

    def test_parameters_other_than_the_papers(self):
        """Eq. 7 with β5 = 1/2, β7 = 1/8, β8 = 1, all exact in binary: one step up, one clipped at either end."""
        script = [Episode(0, [Step(0.0, 1), Step(0.0, 2), Step(0.0, 0, "terminated")])]
        table = [[0.5, 0.0], [1.0, 0.0], [-1.0, -1.0], [0.0, 0.0]]
        chosen = {"gain": -0.5, "mu_0": 0.5, "lower": 0.125, "upper": 1.0}
        recorder = train([ScriptedEnv(script)], table, 3, gamma=0.5, method=5, method_kwargs=chosen)
        # 1/2 - (1 - 1/2)/2 = 1/4;  1/4 - (-1 - 1)/2 = 5/4, clipped to 1;  1 - (0 + 1)/2 = 1/2
        assert recorder.rates == [0.5, 0.25, 1.0, 0.5]


class TestSeveralEnvironments:
    """Each environment in turn: update, choose, rule; the next one sees the table and the μ that this leaves."""

    def test_the_same_entry_twice_in_one_step(self):
        """Method 8, worked by hand; both environments do the same, and every update counts."""
        script = [Episode(0, [Step(100.0, 1), Step(0.0, 0)])]
        recorder = train([ScriptedEnv(script), ScriptedEnv(script)], np.zeros((4, 2)), 2, gamma=0.5, method=8)
        # Step 1, environment 0: μ = 0.01, Q(0, 0) = 1; a tie, 0 >= 0, μ = 0.005
        #         environment 1: Q(0, 0) = 1 + 0.005 (100 - 1) = 1.495; 0 < 1, μ = 0.01
        # Step 2, environment 0: μ = 0.01, Q(1, 0) = 0.01 · 0.7475 = 0.007475; 1.495 >= 0, μ = 0.005
        #         environment 1: Q(1, 0) = 0.007475 + 0.005 (0.7475 - 0.007475) = 0.011175125; μ = 0, clipped to 0.001
        assert recorder.tables[1][0, 0] == pytest.approx(1.495, rel=1e-13)
        assert recorder.tables[2][1, 0] == pytest.approx(0.011175125, rel=1e-13)
        assert recorder.rates == pytest.approx([0.01, 0.01, 0.001], rel=1e-13)

    def test_a_choice_sees_the_updates_before_it_and_no_later_one(self):
        first = ScriptedEnv([Episode(0, [Step(0.0, 1), Step(-100.0, 2), Step(0.0, 1)])])
        second = ScriptedEnv([Episode(1, [Step(-100.0, 2), Step(0.0, 1), Step(0.0, 1)])])
        recorder = train([first, second], np.zeros((4, 2)), 3, gamma=0.5, learning_rate=0.5)
        # Environment 0 chooses action 0 in state 1 before environment 1 makes it the worse one there, in the same step.
        # Environment 1 enters state 1 in step 2, where Q(1, 0) = -50 already.
        assert [actions.tolist() for actions in recorder.actions] == [[0, 0], [0, 0], [0, 1]]
        # Step 2, environment 0: Q(1, 0) = -50 + (-100 + 50)/2 = -75
        assert recorder.tables[1][1, 0] == -50.0
        assert recorder.tables[2][1, 0] == -75.0

    def test_environment_1_chooses_with_the_table_environment_0_leaves(self):
        first = ScriptedEnv([Episode(0, [Step(-100.0, 1), Step(0.0, 1)])])
        second = ScriptedEnv([Episode(2, [Step(0.0, 0), Step(0.0, 0)])])
        recorder = train([first, second], np.zeros((4, 2)), 2, gamma=0.5, learning_rate=0.5)
        assert recorder.actions[1].tolist() == [0, 1]

    @pytest.mark.parametrize("number", NUMBERS)
    def test_every_method_with_three_environments(self, number):
        def envs():
            return [ScriptedEnv(SCRIPT), ScriptedEnv(SCRIPT[1:]), ScriptedEnv(SCRIPT[3:])]

        recorder = train(envs(), INITIAL, 12, gamma=0.5, method=number)
        moments = learn_by_the_paper(
            envs(),
            12,
            tables_by_hand(number)[0],
            Fraction(1, 2),
            paper_start(number),
            paper_rates()[number],
            READINGS.get(number, "next"),
        )
        assert_moments_equal(recorder, moments)


class TestExploration:
    @pytest.mark.parametrize("number", SELF_ADAPTIVE)
    def test_the_next_action_is_the_one_really_taken(self, number):
        """An agent that always explores: the reference is told what it did, and follows bit for bit."""
        outcomes = [
            [Step(float(3 * s - a), (s + a) % 4, "terminated" if s == a == 2 else "") for a in range(3)] for s in range(4)
        ]
        recorder = Recorder()
        model = TabularQ(
            "MlpPolicy",
            DummyVecEnv([lambda: MarkovEnv(outcomes)]),
            method=number,
            method_kwargs={"next_action": "next"},
            exploration_final_eps=1.0,
            seed=number,
        )
        model.learn(400, callback=recorder, log_interval=None)
        taken = iter([int(action[0]) for action in recorder.actions] + [0])
        moments = learn_by_the_paper(
            [MarkovEnv(outcomes)],
            399,
            np.zeros((4, 3)).tolist(),
            0.99,
            0.01,
            paper_rates(float)[number],
            "next",
            choose=lambda table, state: next(taken),
        )
        assert sum(dones[0] for dones in recorder.dones) > 5
        np.testing.assert_array_equal(recorder.tables[:400], [moment.table for moment in moments])
        assert recorder.rates[:400] == [moment.mu for moment in moments]

    def test_epsilon_falls_linearly_and_holds_for_an_episode_where_episodes_count(self):
        script = [Episode(0, [Step(0.0, 1), Step(0.0, 0, "terminated")])]
        recorder = Recorder()
        model = TabularQ(
            "MlpPolicy", DummyVecEnv([lambda: ScriptedEnv(script)]), ties="first", total_episodes=5, exploration_fraction=0.5
        )
        model.learn(1000, callback=recorder, log_interval=None)
        # ε = 1 - 0.95 (k/5) / 0.5, down to 0.05 from half of the five episodes on, for the k finished ones
        assert recorder.epsilons == pytest.approx([1.0, 1.0, 0.62, 0.62, 0.24, 0.24, 0.05, 0.05, 0.05, 0.05])

    def test_epsilon_by_steps(self):
        recorder = Recorder()
        model = TabularQ(
            "MlpPolicy",
            DummyVecEnv([lambda: ScriptedEnv(SCRIPT)]),
            exploration_initial_eps=0.8,
            exploration_final_eps=0.2,
            exploration_fraction=0.5,
        )
        model.learn(10, callback=recorder, log_interval=None)
        assert recorder.epsilons == pytest.approx([0.8, 0.68, 0.56, 0.44, 0.32, 0.2, 0.2, 0.2, 0.2, 0.2])
        assert model.exploration_rate == pytest.approx(0.2)

    def test_the_first_action_is_chosen_with_the_initial_epsilon(self):
        """With ε falling from 1 to 0 in the first hundredth, only the first of the actions is random: 2^-20 to miss it."""
        first_actions, later_actions = set(), set()
        for seed in range(20):
            recorder = Recorder()
            model = TabularQ(
                "MlpPolicy",
                DummyVecEnv([lambda: ScriptedEnv([Episode(0, [Step(0.0, 0)] * 200)])]),
                exploration_fraction=0.01,
                exploration_final_eps=0.0,
                learning_rate=0.0,
                ties="first",
                seed=seed,
            )
            model.learn(100, callback=recorder, log_interval=None)
            first_actions.add(int(recorder.actions[0][0]))
            later_actions.update(int(action[0]) for action in recorder.actions[1:])
        assert first_actions == {0, 1}
        assert later_actions == {0}


# Rewards pass through float32 on their way from a vectorised environment
rewards = st.floats(-1000.0, 1000.0, width=32)
values = st.floats(-2.0, 2.0)


@st.composite
def markov_problems(draw):
    n_states, n_actions = draw(st.integers(1, 5)), draw(st.integers(1, 4))
    ends = st.sampled_from(["", "", "", "terminated"])
    steps = st.builds(Step, rewards, st.integers(0, n_states - 1), ends)
    row = st.lists(steps, min_size=n_actions, max_size=n_actions)
    outcomes = draw(st.lists(row, min_size=n_states, max_size=n_states))
    starts = draw(st.lists(st.integers(0, n_states - 1), min_size=1, max_size=4))
    value_row = st.lists(values, min_size=n_actions, max_size=n_actions)
    table = draw(st.lists(value_row, min_size=n_states, max_size=n_states))
    time_limit = draw(st.integers(1, 12))
    return (lambda: MarkovEnv(outcomes, starts, time_limit)), table


class TestLaws:
    @settings(max_examples=150)
    @given(
        problem=markov_problems(),
        number=st.sampled_from(NUMBERS),
        reading=st.sampled_from(["same", "next", "max"]),
        n_envs=st.integers(1, 3),
        gamma=st.floats(0.0, 1.0),
        by_episodes=st.booleans(),
    )
    def test_any_problem_bit_for_bit(self, problem, number, reading, n_envs, gamma, by_episodes):
        """The reference in floats, with the equations' own order of operations, gives the same bits."""
        make_env, table = problem
        chosen = {"method": number}
        if number in SELF_ADAPTIVE:
            chosen["method_kwargs"] = {"next_action": reading}
        total_episodes = 200 if by_episodes else None
        recorder = train([make_env() for _ in range(n_envs)], table, 40, gamma=gamma, total_episodes=total_episodes, **chosen)
        moments = learn_by_the_paper(
            [make_env() for _ in range(n_envs)],
            40,
            table,
            gamma,
            paper_start(number, float),
            paper_rates(float)[number],
            reading,
            total_episodes=total_episodes,
        )
        assert_moments_equal(recorder, moments, exactly=True)

    @settings(max_examples=100)
    @given(here=values, there=values, mu_0=st.floats(0.25, 0.75), pair=st.sampled_from([(5, 6), (7, 8)]))
    def test_methods_mirror_each_other_until_the_clip(self, here, there, mu_0, pair):
        """What one adds to μ the other takes away; it is 0.05 · 4 at most here, too little to reach a bound."""
        changes = []
        for number in pair:
            script = [Episode(0, [Step(0.0, 1), Step(0.0, 1)])]
            model = make_model([ScriptedEnv(script)], [[here, here], [there, there], [0, 0], [0, 0]])
            model.learn(1, callback=method(number, mu_0=mu_0, lower=0.0, upper=1.0), log_interval=None)
            changes.append(model.mu - mu_0)
        assert changes[0] == pytest.approx(-changes[1], abs=1e-15)
        assert changes[0] * (there - here) * (1 if 7 in pair else -1) >= 0.0

    @settings(max_examples=60)
    @given(
        problem=markov_problems(),
        number=st.sampled_from(SELF_ADAPTIVE),
        bounds=st.tuples(st.floats(0.0, 1.0), st.floats(0.0, 1.0)).map(sorted),
        scale=st.floats(1e-6, 1e3),
        mu_0=st.floats(0.0, 1.0),
    )
    def test_the_rate_stays_within_its_bounds(self, problem, number, bounds, scale, mu_0):
        make_env, table = problem
        name = "gain" if number in (5, 6) else "step"
        chosen = {name: scale, "lower": bounds[0], "upper": bounds[1], "mu_0": mu_0}
        recorder = train([make_env()], table, 30, method=number, method_kwargs=chosen)
        assert recorder.rates[0] == mu_0
        assert all(bounds[0] <= rate <= bounds[1] for rate in recorder.rates[1:])

    @settings(max_examples=30)
    @given(
        beta_1=st.floats(0.0, 0.5),
        beta_3=st.floats(0.0, 0.5),
        n_steps=st.integers(1, 50),
        total_episodes=st.none() | st.integers(1, 30),
    )
    def test_growth_and_decay_add_up(self, beta_1, beta_3, n_steps, total_episodes):
        """(β1 + β3 (1 - p)) + (β1 + β3 p) = 2 β1 + β3 at every step."""
        script = [Episode(0, [Step(1.0, 1), Step(0.0, 0, "truncated")])]
        falling, growing = (
            train(
                [ScriptedEnv(script)],
                np.zeros((4, 2)),
                n_steps,
                method=number,
                method_kwargs={"beta_1": beta_1, "beta_3": beta_3},
                total_episodes=total_episodes,
            ).rates
            for number in (3, 4)
        )
        assert np.add(falling, growing) == pytest.approx(2 * beta_1 + beta_3, rel=1e-12, abs=1e-15)
        assert np.all(np.diff(falling) <= 1e-15)
        assert np.all(np.diff(growing) >= -1e-15)

    @settings(max_examples=60)
    @given(mu=st.floats(0.0, 1.0), value=values, reward=rewards, best=values)
    def test_an_update_moves_by_the_rates_share_of_the_error(self, mu, value, reward, best):
        """Eq. 2; in particular a rate of 0 leaves the value, and a rate of 1 puts the target in its place."""
        script = [Episode(0, [Step(reward, 1), Step(0.0, 1)])]
        table = [[value, value - 1], [best - 1, best], [0, 0], [0, 0]]
        model = make_model([ScriptedEnv(script)], table, learning_rate=mu, gamma=0.5)
        model.learn(1, log_interval=None)
        target = reward + 0.5 * best
        assert model.q_table[0, 0] == pytest.approx((1 - mu) * value + mu * target, rel=1e-9, abs=1e-9)
        expected = np.array(table, float)
        expected[0, 0] = model.q_table[0, 0]
        np.testing.assert_array_equal(model.q_table, expected)


class TestMethodsTable:
    def test_eight_methods_with_the_papers_parameters(self):
        assert NUMBERS == [1, 2, 3, 4, 5, 6, 7, 8]
        for number in NUMBERS:
            expected = paper_start(number, float)
            model = TabularQ("MlpPolicy", DummyVecEnv([lambda: ScriptedEnv(SCRIPT)]), ties="first", method=number)
            assert model.mu == pytest.approx(expected)
            assert METHODS[number].formula

    def test_a_method_overrides_the_learning_rate(self):
        model = TabularQ("MlpPolicy", DummyVecEnv([lambda: ScriptedEnv(SCRIPT)]), ties="first", learning_rate=0.7, method=1)
        model.learn(4, log_interval=None)
        assert model.mu == 0.01

    def test_greedy_takes_the_first_of_the_best(self):
        """Of the reference, so that its ties are what the paper's tables were made with."""
        assert greedy([[0.0, 1.0, 1.0]], 0) == 1
