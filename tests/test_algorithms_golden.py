"""Every algorithm against expected numbers: from exact fractions, and from the tests of other libraries."""

from typing import Any, NamedTuple

import numpy as np
import pytest
from helpers.forced import Snapshot, force_bits, force_list, make_sequence, play, script_of
from helpers.golden import GoldenSequence, assert_close, load, load_algorithm, load_sequence

from sb3_adaptive_q import (
    SARSA,
    DoubleQ,
    ExpectedSARSA,
    NStep,
    QLambda,
    SARSALambda,
    TabularAlgorithm,
    TabularQ,
)
from sb3_adaptive_q.behaviour import BEHAVIOURS
from sb3_adaptive_q.rollouts import step_rollout


class Case(NamedTuple):
    """The algorithm that a name of the file stands for."""

    algorithm: type[TabularAlgorithm]
    arguments: dict[str, Any]


SAMPLE_MEAN = {"method": "harmonic"}  # 1/n(s, a)
TRACED = {"trace_decay": 0.5}
CASES = {
    "q_learning": Case(TabularQ, {}),
    "sarsa": Case(SARSA, {}),
    "expected_sarsa": Case(ExpectedSARSA, {}),
    "double_q": Case(DoubleQ, {}),
    "double_expected_sarsa": Case(DoubleQ, {"target": "expected"}),
    "sarsa_lambda_accumulating": Case(SARSALambda, TRACED),
    "sarsa_lambda_replacing": Case(SARSALambda, {**TRACED, "trace": "replacing"}),
    "sarsa_lambda_dutch": Case(SARSALambda, {**TRACED, "trace": "dutch"}),
    "sarsa_lambda_accumulating_1_over_n": Case(SARSALambda, {**TRACED, **SAMPLE_MEAN}),
    "true_online_sarsa_lambda": Case(SARSALambda, {**TRACED, "true_online": True}),
    "watkins_q_lambda_accumulating": Case(QLambda, TRACED),
    "watkins_q_lambda_replacing": Case(QLambda, {**TRACED, "trace": "replacing"}),
    "watkins_q_lambda_accumulating_1_over_n": Case(QLambda, {**TRACED, **SAMPLE_MEAN}),
    "naive_q_lambda_replacing": Case(QLambda, {**TRACED, "variant": "naive", "trace": "replacing"}),
    "peng_q_lambda": Case(QLambda, {**TRACED, "variant": "peng"}),
    "n_step_sarsa_2": Case(NStep, {"n": 2}),
    "n_step_sarsa_3": Case(NStep, {"n": 3}),
    "n_step_expected_sarsa_2": Case(NStep, {"n": 2, "target": "expected"}),
    "n_step_q_2": Case(NStep, {"n": 2, "target": "q"}),
    "tree_backup_2": Case(NStep, {"n": 2, "target": "tree_backup"}),
    "tree_backup_3": Case(NStep, {"n": 3, "target": "tree_backup"}),
}
ALL = [(name, sequence) for name in CASES for sequence in load_algorithm(name)]
#: In the others the rewards of a pair differ, so that no transition table plays them
DETERMINISTIC = ("loop", "corridor", "cycle")


def learn(name: str, sequence: GoldenSequence, patch: pytest.MonkeyPatch, compiled: bool = False) -> list[Snapshot]:
    """What the algorithm holds after each transition of the sequence."""
    case, records = CASES[name], load_algorithm(name)[sequence.name]
    coins = [record["coin"] for record in records] if case.algorithm is DoubleQ else None
    counter = force_bits(patch, script_of(sequence, coins))
    return play(case.algorithm, sequence, counter, compiled, **case.arguments)


def check(name: str, sequence: GoldenSequence, snapshots: list[Snapshot]) -> None:
    """Compare tables, traces and errors with the file."""
    records = load_algorithm(name)[sequence.name]
    assert len(snapshots) == len(records) == len(sequence.transitions)
    error_sum = 0.0
    for number, (t, found, record) in enumerate(zip(sequence.transitions, snapshots, records, strict=True)):
        where = f"transition {number} of {name} on {sequence.name}"
        if found.q_tables is not None:
            assert_close(found.q_tables, [record["q"], record["q_b"]], f"both tables after {where}")
            assert_close(found.q, np.mean([record["q"], record["q_b"]], axis=0), f"their mean after {where}")
        else:
            assert_close(found.q, record["q"], f"table after {where}")
        if "td_error" in record:
            assert_close(found.error_sum - error_sum, abs(record["td_error"]), f"error of {where}")
            error_sum = found.error_sum
        if "trace" in record and not (t.terminated or t.truncated):  # there it is recorded before it is emptied
            # The file records these traces after the marking; true online, the step size of 1/2 is in them
            factor = {"true_online_sarsa_lambda": 0.5 * 0.5 * sequence.gamma}.get(name, 1.0)
            assert_close(found.trace, factor * np.array(record["trace"]), f"traces after {where}")


@pytest.mark.parametrize(("name", "sequence_name"), ALL)
def test_ordinary_path(name: str, sequence_name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """In plain Python, so that nothing has to be compiled: the same functions are on the compiled path."""
    monkeypatch.setattr(step_rollout, "is_disabled", lambda: True)
    sequence = load_sequence(sequence_name)
    check(name, sequence, learn(name, sequence, monkeypatch))


@pytest.mark.parametrize(("name", "sequence_name"), [(name, sequence) for name, sequence in ALL if sequence in DETERMINISTIC])
def test_compiled_path(name: str, sequence_name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    sequence = load_sequence(sequence_name)
    check(name, sequence, learn(name, sequence, monkeypatch, compiled=True))


STREAMS = load()["mushroom_rl"]["streams"]
TABLES = load()["mushroom_rl"]["tables"]
MUSHROOM_RL = {
    "q_learning": Case(TabularQ, {}),
    "double_q": Case(DoubleQ, {}),
    "sarsa": Case(SARSA, {}),
    "sarsa_lambda_replacing": Case(SARSALambda, {"trace": "replacing"}),
    "naive_q_lambda_replacing": Case(QLambda, {"variant": "naive", "trace": "replacing"}),
    "expected_sarsa": Case(ExpectedSARSA, {"exploration_initial_eps": 1.0, "exploration_final_eps": 1.0}),
}


def break_ties_as_recorded(stream: list[dict[str, Any]], patch: pytest.MonkeyPatch) -> None:
    """Let the best action be the one that MushroomRL found, which breaks ties at random."""
    actions = iter([t["argmax"] for t in stream if not t["terminated"]])

    def best(tables: Any, values: np.ndarray, state: int) -> tuple[int, float]:
        action = next(actions)
        assert values[state, action] == values[state].max()
        return action, float(values[state, action])

    name = ("epsilon_greedy", "first")
    patch.setitem(BEHAVIOURS, name, BEHAVIOURS[name]._replace(best=best))


@pytest.mark.parametrize("name", MUSHROOM_RL)
def test_tables_of_mushroom_rl(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its test's own transitions, with its tables as they are printed there, to eight digits."""
    case, expected = MUSHROOM_RL[name], TABLES[name]
    stream, mushroom_rl = STREAMS[expected["stream"]], load()["mushroom_rl"]
    sequence = make_sequence(name, stream, mushroom_rl["n_states"], mushroom_rl["n_actions"], mushroom_rl["gamma"])
    coins = [t["coin"] for t in stream] if case.algorithm is DoubleQ else None
    arguments = {"learning_rate": expected["step_size"], **case.arguments}
    if "trace_decay" in expected:
        arguments["trace_decay"] = expected["trace_decay"]
    counter = force_list(monkeypatch, script_of(sequence, coins))
    if coins is not None:
        break_ties_as_recorded(stream, monkeypatch)
    last = play(case.algorithm, sequence, counter, False, **arguments)[-1]
    tables = [last.q] if last.q_tables is None else list(last.q_tables)
    printed = [expected["q"]] if last.q_tables is None else [expected["q"], expected["q_b"]]
    np.testing.assert_allclose(tables, printed, rtol=0.0, atol=mushroom_rl["tolerance"])


def test_values_of_ai_toolbox(monkeypatch: pytest.MonkeyPatch) -> None:
    toolbox = load()["ai_toolbox"]
    found = toolbox["q_learning"]["transitions"]
    # Its transitions do not follow one another: each is cut off, which leaves the bootstrap
    sequence = make_sequence("ai_toolbox", [{**t, "truncated": True} for t in found], 5, 2, toolbox["gamma"])
    counter = force_list(monkeypatch, script_of(sequence))
    snapshots = play(TabularQ, sequence, counter, False, learning_rate=toolbox["q_learning"]["step_size"])
    for transition, snapshot in zip(found, snapshots, strict=True):
        assert_close(snapshot.q[transition["state"], transition["action"]], transition["expected"])
