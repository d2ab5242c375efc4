"""Every step size against expected numbers that were computed from the formulas in exact fractions or with 50 digits."""

from collections.abc import Callable

import numpy as np
import pytest
from helpers.golden import (
    GoldenSequence,
    GoldenTransition,
    Rule,
    SequenceEnv,
    assert_close,
    learn_by_q_learning,
    load,
    load_rules,
    load_sequence,
)

from sb3_adaptive_q.step_sizes import STEP_SIZES, Step, StepSize, resolve_parameters

RULES = load_rules()
CASES = [(name, sequence) for name, rule in RULES.items() for sequence in rule.cases]


def former(step_size: StepSize, rule: Rule, sequence: GoldenSequence) -> Callable[..., float]:
    """The step size as the loop over a sequence calls it, with a cell for each pair."""
    parameters = resolve_parameters(rule.step_size, rule.parameters)
    gamma = sequence.gamma if rule.gamma is None else rule.gamma

    def form(t: GoldenTransition, count: int, value: float, error: float, memory: dict[str, np.ndarray]) -> float:
        next_value = 0.0  # no step size of the catalogue looks at it
        seen = float(count) if step_size.counts else 0.0
        step = Step(t.state, t.action, t.state, t.action, seen, value, next_value, error, 0.0, gamma, 0.0)
        return step_size.step_size(0.0, step, *parameters.values(), *memory.values())

    return form


@pytest.mark.parametrize(("name", "sequence_name"), CASES)
def test_step_size(name: str, sequence_name: str) -> None:
    rule, sequence = RULES[name], load_sequence(sequence_name)
    step_size = STEP_SIZES[rule.step_size]
    starts = step_size.start_values(resolve_parameters(rule.step_size, rule.parameters))
    updates = learn_by_q_learning(sequence, former(step_size, rule, sequence), starts)
    records = rule.cases[sequence_name]
    assert len(updates) == len(records) == len(sequence.transitions)
    for number, (update, record) in enumerate(zip(updates, records, strict=True)):
        where = f"update {number} of {name} on {sequence_name}"
        assert_close(update.td_error, record["td_error"], f"error of {where}")
        assert_close(update.step_size, record["step_size"], f"step size of {where}")
        assert_close(update.q, record["q"], f"table of {where}")
        assert update.memory.keys() == rule.arrays.keys()
        for array, key in rule.arrays.items():
            assert_close(update.memory[array], record["memory"][key], f"{array} of {where}")


def test_every_step_size_has_expected_numbers() -> None:
    assert {rule.step_size for rule in RULES.values()} == set(STEP_SIZES)
    assert {name for name, _ in CASES} == set(RULES)


def test_a_wrong_number_is_seen() -> None:
    assert_close([1.0, 2e6], [1.0 + 5e-13, 2e6 + 1e-6])
    with pytest.raises(AssertionError, match="instead of"):
        assert_close([1.0], [1.0 + 2e-12])
    with pytest.raises(AssertionError, match="instead of"):
        assert_close([float("nan")], [1.0])


class TestSequenceEnv:
    @pytest.mark.parametrize("name", load()["mdps"])
    def test_it_plays_the_sequence(self, name: str) -> None:
        """Whatever the actions, states, rewards and ends are the sequence's, twice over where its end is an episode's."""
        sequence = load_sequence(name)
        env = SequenceEnv(sequence)
        state, _ = env.reset(seed=0)
        ends = sequence.transitions[-1].terminated or sequence.transitions[-1].truncated
        for expected in sequence.transitions * (2 if ends else 1):
            assert (state, env.required_action) == (expected.state, expected.action)
            state, reward, terminated, truncated, info = env.step(env.action_space.sample())
            played = expected.next_state, expected.reward, expected.terminated, expected.truncated
            assert (state, reward, terminated, truncated) == played
            assert info["next_action"] == expected.next_action
            if not terminated:
                assert env.required_action == expected.next_action
            if terminated or truncated:
                state, _ = env.reset()

    def test_a_reset_inside_an_episode_begins_anew(self) -> None:
        sequence = load_sequence("corridor")
        env = SequenceEnv(sequence)
        env.reset()
        env.step(0)
        assert env.reset()[0] == sequence.transitions[0].state
        assert env.required_action == sequence.transitions[0].action
