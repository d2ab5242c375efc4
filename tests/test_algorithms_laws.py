"""What the algorithms imply: limits in which two of them are one, and the definitions behind the traces."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
from helpers.forced import force_list, play, script_of
from helpers.golden import GoldenSequence, GoldenTransition, assert_close
from helpers.trace_learners import online_lambda_returns, sweep_everything
from hypothesis import given, settings
from hypothesis import strategies as st
from stable_baselines3.common.env_util import make_vec_env

from sb3_adaptive_q import SARSA, DoubleQ, ExpectedSARSA, NStep, QLambda, SARSALambda, TabularAlgorithm, TabularQ
from sb3_adaptive_q.algorithms.td_update import Transition
from sb3_adaptive_q.algorithms.traces import MARKS, longest_list, size_in_force, sweep, visit
from sb3_adaptive_q.rollouts import step_rollout
from sb3_adaptive_q.step_sizes import Step

TRACES = ("accumulating", "replacing", "dutch")
SIZES = {"constant": ({"learning_rate": 0.25}, 0.25), "own": ({"method": "harmonic"}, None)}


def law(**strategies: st.SearchStrategy[Any]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Check a property on a dozen examples."""

    def decorate(test: Callable[..., None]) -> Callable[..., None]:
        return settings(max_examples=15)(given(**strategies)(test))

    return decorate


@st.composite
def sequences(draw: st.DrawFn) -> GoldenSequence:
    """Transitions that follow one another, with self-loops and both kinds of ends."""
    n_states, n_actions = draw(st.integers(1, 4)), draw(st.integers(1, 3))
    states, actions = st.integers(0, n_states - 1), st.integers(0, n_actions - 1)
    ends = st.sampled_from([""] * 6 + ["terminated", "truncated"])
    steps = draw(st.lists(st.tuples(states, actions, actions, st.integers(-8, 8), ends), min_size=12, max_size=40))
    transitions: list[GoldenTransition] = []
    state, action = draw(states), draw(actions)
    for next_state, next_action, other_action, eighths, end in steps:
        terminated, truncated = end == "terminated", end == "truncated"
        transitions.append(GoldenTransition(state, action, eighths / 8, next_state, terminated, truncated, next_action))
        # After a truncation the action that would have been taken is not
        state, action = (draw(states), other_action) if end else (next_state, next_action)
    return GoldenSequence("drawn", n_states, n_actions, draw(st.sampled_from([0.0, 0.5, 0.9, 1.0])), tuple(transitions))


def tables_of(algorithm: type[TabularAlgorithm], sequence: GoldenSequence, **arguments: Any) -> np.ndarray:
    """The table after every transition of a sequence whose actions are forced."""
    with pytest.MonkeyPatch.context() as patch:
        counter = force_list(patch, script_of(sequence))
        return np.array([snapshot.q for snapshot in play(algorithm, sequence, counter, False, **arguments)])


class TestTraces:
    @pytest.mark.parametrize("sizes", SIZES)
    @pytest.mark.parametrize("trace", TRACES)
    @law(
        sequence=sequences(),
        decay=st.sampled_from([0.0, 0.5, 0.9, 1.0]),
        threshold=st.sampled_from([0.0, 0.0, 1e-8, 0.1, 0.3]),
    )
    def test_the_list_is_the_sweep(
        self, trace: str, sizes: str, sequence: GoldenSequence, decay: float, threshold: float
    ) -> None:
        """Bit for bit."""
        arguments, constant = SIZES[sizes]
        arguments = {**arguments, "trace": trace, "trace_decay": decay, "trace_threshold": threshold}
        for algorithm, variant in ((SARSALambda, "sarsa"), (QLambda, "watkins"), (QLambda, "naive"), (QLambda, "peng")):
            own = {} if algorithm is SARSALambda else {"variant": variant}
            found = tables_of(algorithm, sequence, **arguments, **own)
            expected = np.array(sweep_everything(variant, trace, sequence, decay, constant, threshold))
            np.testing.assert_array_equal(found, expected, variant)

    @pytest.mark.parametrize("variant", ["sarsa", "watkins", "naive", "peng"])
    @law(sequence=sequences())
    def test_all_pairs_move_with_the_step_size_in_force(self, variant: str, sequence: GoldenSequence) -> None:
        """Method 3, whose step size falls from 0.05 to 0.01."""
        n = len(sequence.transitions)
        falling = [0.01 + 0.04 * (1.0 - place / n) for place in range(n)]
        algorithm, own = (SARSALambda, {}) if variant == "sarsa" else (QLambda, {"variant": variant})
        found = tables_of(algorithm, sequence, method=3, trace_decay=0.5, trace_threshold=0.0, **own)
        expected = np.array(sweep_everything(variant, "accumulating", sequence, 0.5, None, 0.0, falling))
        np.testing.assert_array_equal(found, expected)

    @pytest.mark.parametrize("sizes", SIZES)
    @law(sequence=sequences(), decay=st.sampled_from([0.0, 0.5, 0.9, 1.0]))
    def test_true_online_is_the_lambda_return(self, sizes: str, sequence: GoldenSequence, decay: float) -> None:
        arguments, constant = SIZES[sizes]
        arguments = {**arguments, "true_online": True, "trace_decay": decay, "trace_threshold": 0.0}
        found = tables_of(SARSALambda, sequence, **arguments)
        assert_close(found, np.array(online_lambda_returns(sequence, decay, constant)))

    @law(sequence=sequences())
    def test_a_small_threshold_changes_little(self, sequence: GoldenSequence) -> None:
        whole = tables_of(SARSALambda, sequence, trace_decay=0.5, trace_threshold=0.0)
        cut = tables_of(SARSALambda, sequence, trace_decay=0.5, trace_threshold=1e-6)
        np.testing.assert_allclose(cut, whole, rtol=0.0, atol=1e-4)

    @law(
        decay=st.floats(0.0, 1.0),
        threshold=st.floats(1e-12, 2.0),
        trace=st.sampled_from(TRACES),
        stays=st.lists(st.integers(1, 200), min_size=1, max_size=8),
    )
    def test_the_list_is_long_enough(self, decay: float, threshold: float, trace: str, stays: list[int]) -> None:
        """Where a pair is visited again and again, so that its trace is as large as can be, and then new ones only."""
        n_pairs = 400
        longest = longest_list(decay, threshold, n_pairs)
        places, pairs, n_listed = np.zeros((1, n_pairs, 1), int), np.zeros((1, longest, 2), int), np.zeros(1, int)
        tables = (np.zeros((n_pairs, 1)), places, pairs, np.zeros((1, longest, 2)), n_listed)
        visited = [state for state, stay in enumerate(stays) for _ in range(stay)] + list(range(len(stays), n_pairs))
        step = Step(0, 0, 0, 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.01)
        for state in visited:
            visit(tables, 0, Transition(state, 0, 0.0, 0, False, False, 0), step.size, MARKS[trace])
            sweep(tables, 0, step, size_in_force, 1.0, (1.0, decay, threshold))
        assert 0 <= n_listed[0] <= longest


@cache
def learn_on_lake(algorithm: type[TabularAlgorithm], method: Any, **arguments: Any) -> bytes:
    """The table of an agent that chooses for itself in two environments, in plain Python."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(step_rollout, "is_disabled", lambda: True)
        defaults = {"learning_rate": 0.3, "gamma": 0.9, "initial_q": 0.25, "exploration_final_eps": 0.2, "seed": 3}
        env = make_vec_env("FrozenLake-v1", 2)
        model = algorithm("MlpPolicy", env, method=method, **{**defaults, **arguments})
        model.learn(200, log_interval=None)
        assert not (model.q_table == 0.25).all()
        return model.q_table.tobytes()


ONE_STEP = [(SARSALambda, {"trace_decay": 0.0, "trace": trace}, SARSA) for trace in TRACES] + [
    (QLambda, {"trace_decay": 0.0, "variant": "naive"}, TabularQ),
    (QLambda, {"trace_decay": 0.0, "variant": "peng"}, TabularQ),
    (NStep, {"n": 1, "target": "sarsa"}, SARSA),
    (NStep, {"n": 1, "target": "expected"}, ExpectedSARSA),
    (NStep, {"n": 1, "target": "tree_backup"}, TabularQ),
    (NStep, {"n": 1, "target": "q"}, TabularQ),
    (ExpectedSARSA, {"exploration_initial_eps": 0.0, "exploration_final_eps": 0.0}, TabularQ),
    (ExpectedSARSA, {"exploration_initial_eps": 0.0, "exploration_final_eps": 0.0, "ties": "first"}, TabularQ),
]


class TestOneStep:
    @pytest.mark.parametrize("method", [None, 6, 7, "idbd"])
    @pytest.mark.parametrize(("algorithm", "arguments", "other"), ONE_STEP)
    def test_agents_are_the_same(
        self, algorithm: type[TabularAlgorithm], arguments: dict[str, Any], other: type[TabularAlgorithm], method: Any
    ) -> None:
        """Bit for bit, with what they draw, whatever the method."""
        shared = {name: value for name, value in arguments.items() if name.startswith(("exploration", "ties"))}
        assert learn_on_lake(algorithm, method, **arguments) == learn_on_lake(other, method, **shared)

    @law(sequence=sequences())
    def test_watkins_without_traces_is_q_learning(self, sequence: GoldenSequence) -> None:
        """On the same transitions: as agents, they draw their actions before the update and after it."""
        for trace in TRACES:
            found = tables_of(QLambda, sequence, trace_decay=0.0, trace=trace)
            np.testing.assert_array_equal(found, tables_of(TabularQ, sequence))


@law(sequence=sequences())
def test_single_actions_leave_temporal_difference_learning(sequence: GoldenSequence) -> None:
    """Where there is nothing to choose, all one-step algorithms estimate the value of the one policy, TD(0)."""
    forced = [t._replace(action=0, next_action=0) for t in sequence.transitions]
    single = sequence._replace(n_actions=1, transitions=tuple(forced))
    values, expected = np.zeros((single.n_states, 1)), []
    for t in forced:
        next_value = 0.0 if t.terminated else values[t.next_state, 0]
        values[t.state, 0] += 0.5 * (t.reward + single.gamma * next_value - values[t.state, 0])
        expected.append(values.copy())
    for algorithm in (TabularQ, SARSA, ExpectedSARSA):
        assert_close(tables_of(algorithm, single), np.array(expected))


@law(sequence=sequences())
def test_watkins_is_naive_where_every_action_is_greedy(sequence: GoldenSequence) -> None:
    watkins = {"variant": "watkins", "trace_decay": 0.9}
    greedy = make_greedy(sequence, **watkins)
    np.testing.assert_array_equal(tables_of(QLambda, greedy, **watkins), tables_of(QLambda, greedy, variant="naive"))


def make_greedy(sequence: GoldenSequence, **arguments: Any) -> GoldenSequence:
    """The same states and rewards with actions that are greedy when they are chosen: on the table before the update."""
    transitions = list(sequence.transitions)
    for place, t in enumerate(transitions[:-1]):
        before = np.zeros((sequence.n_states, sequence.n_actions))
        if place > 0:
            seen = sequence._replace(transitions=tuple(transitions[:place]))
            before = tables_of(QLambda, seen, **arguments)[-1]
        action = int(before[t.next_state].argmax())
        transitions[place] = t._replace(next_action=action)
        if not (t.terminated or t.truncated):
            transitions[place + 1] = transitions[place + 1]._replace(action=action)
    return sequence._replace(transitions=tuple(transitions))


class TestDoubleQ:
    @pytest.fixture
    def model(self, monkeypatch: pytest.MonkeyPatch) -> DoubleQ:
        """A model that has learned 400 steps with 1/n, each table with its own n."""
        monkeypatch.setattr(step_rollout, "is_disabled", lambda: True)
        start = np.random.default_rng(0).random((16, 4))
        model = DoubleQ("MlpPolicy", make_vec_env("FrozenLake-v1", 2), method="harmonic", initial_q=start, seed=0)
        return model.learn(400, log_interval=None)

    def test_each_table_has_its_own_memory(self, model: DoubleQ) -> None:
        """A pair has been visited by the coin of a table exactly where that table has changed."""
        visits = model.memory["visits"]
        assert visits.shape == (2, 16, 4) and visits.sum() == 400
        np.testing.assert_array_equal(visits > 0, model.q_tables != model.initial_q)
        # A fair coin; five standard errors
        assert visits[0].sum() == pytest.approx(200, abs=50)

    def test_the_table_is_the_mean_of_both(self, model: DoubleQ) -> None:
        np.testing.assert_array_equal(model.q_table, 0.5 * (model.q_tables[0] + model.q_tables[1]))

    def test_to_assign_the_table_sets_both(self, model: DoubleQ) -> None:
        values = np.arange(64.0).reshape(16, 4)
        model.q_table = values
        np.testing.assert_array_equal(model.q_tables, [values, values])
