"""Play a sequence of the expected numbers with any algorithm: its actions and coins are forced upon the behaviour policy."""

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.wrappers import TimeLimit
from helpers.golden import GoldenSequence, GoldenTransition, SequenceEnv
from stable_baselines3.common.callbacks import BaseCallback

from sb3_adaptive_q import CompiledVecEnv, LeanVecEnv, TabularAlgorithm
from sb3_adaptive_q.algorithms import double_q
from sb3_adaptive_q.behaviour import BEHAVIOURS
from sb3_adaptive_q.rollouts import step_rollout

ONE = np.uint64(1)


class Snapshot:
    """What a model holds after an update: its table, further tables, dense traces and the sum of absolute errors."""

    def __init__(self, model: TabularAlgorithm) -> None:
        self.q = model.q_table.copy()
        self.q_tables = model.policy.q_tables.numpy().copy() if model.n_tables == 2 else None
        self.trace = dense_trace(model) if "pairs" in model._working else None
        self.error_sum = float(model.training.record["td_error_sum"][0])


class SequenceTableEnv(gym.Env):
    """
    The decision process of a sequence, as a transition table. Pairs that the sequence does not visit stay where they are.

    :param sequence: with deterministic transitions
    """

    metadata = {"render_modes": []}  # noqa: RUF012, as in gymnasium
    compile_by_table = True

    def __init__(self, sequence: GoldenSequence) -> None:
        self.observation_space = spaces.Discrete(sequence.n_states)
        self.action_space = spaces.Discrete(sequence.n_actions)
        self.P = {
            state: {action: [(1.0, state, 0.0, False)] for action in range(sequence.n_actions)}
            for state in range(sequence.n_states)
        }
        for t in sequence.transitions:
            outcome = [(1.0, t.next_state, t.reward, t.terminated)]
            known = self.P[t.state][t.action]
            assert known in (outcome, [(1.0, t.state, 0.0, False)]), "the sequence is not deterministic"
            self.P[t.state][t.action] = outcome
        self.initial_state_distrib = np.eye(sequence.n_states)[sequence.transitions[0].state]

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[int, dict[str, Any]]:
        super().reset(seed=seed)
        self.np_random.random()
        self.s = int(np.argmax(self.initial_state_distrib))
        return self.s, {}

    def step(self, action: Any) -> tuple[int, float, bool, bool, dict[str, Any]]:
        self.np_random.random()
        ((_, self.s, reward, terminated),) = self.P[self.s][int(action)]
        return self.s, reward, terminated, False, {}


def dense_trace(model: TabularAlgorithm) -> np.ndarray:
    """The traces of the only environment, of shape (n_states, n_actions)."""
    trace = np.zeros(model.q_table.shape)
    n_pairs = model._working["n_pairs"][0]
    states, actions = model._working["pairs"][0, :n_pairs].T
    trace[states, actions] = model._working["traces"][0, :n_pairs, 0]
    return trace


def script_of(sequence: GoldenSequence, coins: list[int] | None = None) -> list[int]:
    """
    :param sequence: the transitions
    :param coins: one for each, where the algorithm draws them
    :return: what is chosen and drawn in the course of the sequence: the first action; for each transition the coin, the next
        action where the state is not terminal, and at the end of an episode the first action of the next one
    """
    script = [sequence.transitions[0].action]
    following = (*sequence.transitions[1:], sequence.transitions[0])
    for number, (t, next_one) in enumerate(zip(sequence.transitions, following, strict=True)):
        if coins is not None:
            script.append(coins[number])
        if not t.terminated:
            script.append(t.next_action)
        if t.terminated or t.truncated:
            script.append(next_one.action)
    return script


def take_bit(draws):  # type: ignore[no-untyped-def]
    """The next bit of the agent's counter, which holds the script: so compiled code is the same for every script."""
    bit = 1 if draws[0] & ONE == ONE else 0
    draws[0] = draws[0] >> ONE
    return bit


def force_bits(patch: pytest.MonkeyPatch, script: list[int]) -> int:
    """
    Let the policy of ties="first" take its actions, and Double Q its coins, from a script, on either path.

    :param patch: takes it back
    :param script: of zeros and ones
    :return: the agent's counter to begin with
    """

    def choose(tables, state, epsilon, draws):  # type: ignore[no-untyped-def]
        return take_bit(draws)

    def draw_coin(draws):  # type: ignore[no-untyped-def]
        return 0.5 * take_bit(draws)

    assert len(script) <= 64
    _force(patch, choose, draw_coin)
    return sum(bit << place for place, bit in enumerate(script))


def force_list(patch: pytest.MonkeyPatch, script: list[int]) -> int:
    """
    The same for scripts of any length and numbers, on the ordinary path and in Python.

    :param patch: takes it back
    :param script: the actions and coins
    :return: the agent's counter to begin with
    """
    entries = iter(script)
    _force(patch, lambda tables, state, epsilon, draws: next(entries), lambda draws: 0.5 * next(entries))
    patch.setattr(step_rollout, "is_disabled", lambda: True)
    return 0


def _force(patch: pytest.MonkeyPatch, choose: Callable[..., int], draw_coin: Callable[..., float]) -> None:
    name = ("epsilon_greedy", "first")
    patch.setitem(BEHAVIOURS, name, BEHAVIOURS[name]._replace(choose=choose))
    patch.setattr(double_q, "uniform", draw_coin)


def play(
    algorithm: type[TabularAlgorithm], sequence: GoldenSequence, counter: int, compiled: bool, **arguments: Any
) -> list[Snapshot]:
    """
    Learn from a sequence whose actions are forced.

    :param algorithm: the class
    :param sequence: the transitions
    :param counter: the agent's counter to begin with
    :param compiled: whether the transitions are made on the compiled path
    :param arguments: of the algorithm
    :return: what was there after each transition
    """
    env = CompiledVecEnv([lambda: _table_env(sequence)]) if compiled else LeanVecEnv([lambda: SequenceEnv(sequence)])
    defaults = {"learning_rate": 0.5, "ties": "first", "exploration_initial_eps": 0.2, "exploration_final_eps": 0.2}
    model = algorithm("MlpPolicy", env, **{"gamma": sequence.gamma, "callback_interval": 1, **defaults, **arguments})
    model.training.record["counter"] = counter
    snapshots = _Snapshots()
    model.learn(len(sequence.transitions), callback=snapshots, log_interval=None)
    return [*snapshots.taken[1:], Snapshot(model)]


def _table_env(sequence: GoldenSequence) -> gym.Env:
    lengths = np.diff([-1, *(i for i, t in enumerate(sequence.transitions) if t.truncated or t.terminated)])
    truncated = any(t.truncated for t in sequence.transitions)
    return TimeLimit(SequenceTableEnv(sequence), int(lengths.max())) if truncated else SequenceTableEnv(sequence)


class _Snapshots(BaseCallback):
    """Called before every update, so what it sees is what the update before left."""

    def _on_training_start(self) -> None:
        self.taken: list[Snapshot] = []

    def _on_step(self) -> bool:
        self.taken.append(Snapshot(self.model))  # type: ignore[arg-type]
        return True


def make_sequence(name: str, found: list[dict[str, Any]], n_states: int, n_actions: int, gamma: float) -> GoldenSequence:
    """
    :param name: what to call it
    :param found: the transitions as the file has them, perhaps without the next action
    :param n_states: of the decision process
    :param n_actions: of the decision process
    :param gamma: the discount factor
    :return: the sequence, with the action of the next transition where the file says none
    """
    known = set(GoldenTransition._fields)
    transitions = []
    for t, following in zip(found, [*found[1:], found[-1]], strict=True):
        fields = {"terminated": False, "truncated": False, "next_action": following["action"], **t}
        transitions.append(GoldenTransition(**{key: value for key, value in fields.items() if key in known}))
    return GoldenSequence(name, n_states, n_actions, gamma, tuple(transitions))
