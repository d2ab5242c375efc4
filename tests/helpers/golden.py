"""
The expected numbers in ``tests/golden``: a reader, a plain Q-learning loop over their transitions, and an environment that
plays them.

Nothing here uses the package. How the file is laid out is written in ``tests/golden/README.md``.
"""

import json
from collections.abc import Callable, Mapping
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium import spaces

#: Numbers agree within this, relative to max(1, |expected|)
TOLERANCE = 1e-12


class GoldenTransition(NamedTuple):
    """
    A transition of a sequence.

    :param next_action: the action taken next; at a truncation the one that would be taken; meaningless at a termination
    """

    state: int
    action: int
    reward: float
    next_state: int
    terminated: bool
    truncated: bool
    next_action: int


class GoldenSequence(NamedTuple):
    """A decision process, and the transitions that are made in it."""

    name: str
    n_states: int
    n_actions: int
    gamma: float
    transitions: tuple[GoldenTransition, ...]


class Rule(NamedTuple):
    """
    What a step size must give.

    :param name: its name in the file
    :param step_size: its name in the package
    :param parameters: its parameters, by their names in the package
    :param arrays: for each array of its memory the name in the file, by the name in the package
    :param gamma: the discount factor that the step size sees, where it is not that of the sequence
    :param cases: by the name of the sequence, a record for each transition: td_error, step_size, q, memory
    """

    name: str
    step_size: str
    parameters: dict[str, float]
    arrays: dict[str, str]
    gamma: float | None
    cases: dict[str, list[dict[str, Any]]]


#: Where the package has another name than the file: of a step size, of parameters, and of arrays by step size
_STEP_SIZES = {"harmonic_1": "harmonic", "mcclain_0": "mcclain", "autostep_fast": "autostep"}
_PARAMETERS = {"mu": "meta_step_size", "H": "horizon"}
_ARRAYS = {
    "unbiased_constant": {"o": "weight"},
    "mcclain": {"alpha": "size"},
    "kesten": {"K": "changes", "last": "last_error"},
    "trigg": {"E": "mean_error", "M": "mean_absolute_error"},
    "bakf": {"nu": "smoothing", "bias": "bias", "second": "mean_square", "lam": "variance_factor"},
    "delta_bar_delta": {"alpha": "size", "bar": "mean_error"},
    "rmsprop": {"v": "mean_square"},
    "adagrad": {"g": "sum_of_squares"},
    "benveniste": {"alpha": "size", "psi": "derivative"},
    "idbd": {"beta": "log_size", "h": "trace"},
    "k1": {"beta": "log_gain", "h": "trace"},
    "autostep": {"alpha": "size", "h": "trace", "v": "normalizer"},
    "swift_td": {"beta": "log_size", "h": "trace"},
}


class Update(NamedTuple):
    """What an update gave: see the golden records, of which it has the keys."""

    td_error: float
    step_size: float
    q: np.ndarray
    memory: dict[str, float]


@cache
def load() -> dict[str, Any]:
    """The whole file. It is read once, so do not change what you get."""
    path = Path(__file__).parents[1] / "golden" / "golden.json"
    return json.loads(path.read_text(encoding="utf-8"))


def load_sequence(name: str) -> GoldenSequence:
    """One of ``bandit``, ``zero``, ``loop``, ``corridor``, ``cycle``."""
    found = load()["mdps"][name]
    transitions = tuple(GoldenTransition(**transition) for transition in found["transitions"])
    return GoldenSequence(name, found["n_states"], found["n_actions"], found["gamma"], transitions)


def load_rules() -> dict[str, Rule]:
    """What the step sizes must give, by the name in the file."""
    return {name: _rule(name, found) for name, found in load()["rules"].items()}


def load_algorithm(name: str) -> dict[str, list[dict[str, Any]]]:
    """What an algorithm must give: by the name of the sequence, a record for each transition."""
    return load()["algorithms"][name]


def _rule(name: str, found: Mapping[str, Any]) -> Rule:
    step_size = _STEP_SIZES.get(name, name)
    parameters = {_PARAMETERS.get(key, key): float(Fraction(value)) for key, value in found["parameters"].items()}
    one_minus_gamma = parameters.pop("one_minus_gamma", None)
    gamma = None if one_minus_gamma is None else 1.0 - one_minus_gamma
    arrays = {_ARRAYS[step_size][key]: key for key in found["memory"]}
    return Rule(name, step_size, parameters, arrays, gamma, found["cases"])


def learn_by_q_learning(
    sequence: GoldenSequence,
    form: Callable[[GoldenTransition, int, float, float, dict[str, np.ndarray]], float],
    starts: Mapping[str, float],
) -> list[Update]:
    """
    Q-learning over a sequence, from a table of zeros.

    :param sequence: the transitions
    :param form: the step size, of the transition, the pair's updates with this one, Q(s, a), the error, and the arrays of
        the memory, in which it may change the cell of the pair
    :param starts: what each array of the memory starts from, by its name
    :return: an item for each transition
    """
    shape = sequence.n_states, sequence.n_actions
    q, counts = np.zeros(shape), np.zeros(shape, dtype=int)
    memory = {name: np.full(shape, start) for name, start in starts.items()}
    updates = []
    for transition in sequence.transitions:
        pair = transition.state, transition.action
        counts[pair] += 1
        bootstrap = 0.0 if transition.terminated else sequence.gamma * float(q[transition.next_state].max())
        td_error = transition.reward + bootstrap - float(q[pair])
        size = form(transition, int(counts[pair]), float(q[pair]), td_error, memory)
        q[pair] += size * td_error
        cells = {name: float(array[pair]) for name, array in memory.items()}
        updates.append(Update(td_error, float(size), q.copy(), cells))
    return updates


def assert_close(actual: Any, expected: Any, what: str = "") -> None:
    """Fail unless all numbers agree with the expected ones within the tolerance of the file."""
    actual, expected = np.asarray(actual, dtype=float), np.asarray(expected, dtype=float)
    assert actual.shape == expected.shape, what
    bound = TOLERANCE * np.maximum(1.0, np.abs(expected))
    assert (np.abs(actual - expected) <= bound).all(), f"{what}: {actual} instead of {expected}"


class SequenceEnv(gym.Env):
    """
    Plays a sequence, whatever actions it is given, and begins anew after its last transition.

    A learner must be made to choose :attr:`required_action`, or it attributes the transitions to other actions.

    :param sequence: the transitions
    """

    metadata = {"render_modes": []}  # noqa: RUF012, as in gymnasium

    def __init__(self, sequence: GoldenSequence) -> None:
        self.sequence = sequence
        self.observation_space = spaces.Discrete(sequence.n_states)
        self.action_space = spaces.Discrete(sequence.n_actions)
        self._position = 0
        self._last: GoldenTransition | None = None

    @property
    def required_action(self) -> int:
        """
        The action to choose in the state that was seen last. After a truncation, until ``reset``, it is the one that would
        be taken there; after a termination it means nothing.
        """
        if self._last is not None and (self._last.terminated or self._last.truncated):
            return self._last.next_action
        return self._upcoming.action

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[int, dict[str, Any]]:
        super().reset(seed=seed)
        if self._last is not None and not (self._last.terminated or self._last.truncated):
            self._position = 0
        self._last = None
        return self._upcoming.state, {}

    def step(self, action: Any) -> tuple[int, float, bool, bool, dict[str, Any]]:
        played = self._last = self._upcoming
        self._position = (self._position + 1) % len(self.sequence.transitions)
        info = {"next_action": played.next_action}
        return played.next_state, played.reward, played.terminated, played.truncated, info

    @property
    def _upcoming(self) -> GoldenTransition:
        return self.sequence.transitions[self._position]
