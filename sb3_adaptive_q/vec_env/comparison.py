"""Check that an environment and the functions that are compiled in its place take the same steps."""

import copy
import hashlib
from typing import Any

import numpy as np

from sb3_adaptive_q.random_numbers import read_pcg64
from sb3_adaptive_q.state_index import make_state_index
from sb3_adaptive_q.vec_env.compiled_env import CompiledEnv
from sb3_adaptive_q.vec_env.tabular_dynamics import TabularDynamics, playable_states

#: What was compared in this process already, and needs no second comparison
_compared: set[tuple[Any, ...]] = set()


def compare_with_environment(compiled: CompiledEnv, n_steps: int = 100, n_pairs: int = 2000) -> None:
    """
    Step a copy of the environment and the functions that are compiled in its place from the same seed, and compare them.
    Both run as Python.

    :param compiled: the environment
    :param n_steps: the number of steps to compare
    :param n_pairs: how many pairs of state and action of a transition table to compare
    :raises ValueError: if they differ
    """
    key = _key(compiled)
    if key in _compared:
        return
    both = _SideBySide(compiled)
    actions = np.random.default_rng(0)
    for _ in range(n_steps):
        if both.step(int(actions.integers(both.n_actions))):
            both.reset()
    if isinstance(compiled.dynamics, TabularDynamics):
        _compare_pairs(both, compiled.dynamics, actions, n_pairs)
    _compared.add(key)


def _key(compiled: CompiledEnv) -> tuple[Any, ...]:
    """All that the steps of both sides depend on: classes, parameters and cells."""
    numbers = [np.asarray(value) for value in compiled.dynamics.parameters]
    digest = hashlib.sha256(b"".join(repr((each.dtype, each.shape)).encode() + each.tobytes() for each in numbers)).digest()
    discretizer = compiled.layers.discretizer
    return type(compiled.unwrapped), type(compiled.dynamics), None if discretizer is None else type(discretizer), digest


def _compare_pairs(both: "_SideBySide", dynamics: TabularDynamics, actions: np.random.Generator, n_pairs: int) -> None:
    """Try the actions of a transition table in the states where they may be taken."""
    states = playable_states(dynamics.parameters)
    pairs = actions.permutation(len(states) * both.n_actions)
    for pair in np.resize(pairs, n_pairs).tolist():
        both.put(int(states[pair // both.n_actions]))
        both.step(pair % both.n_actions)


class _SideBySide:
    """A copy of an environment, and the functions that replace it. Their generators start in the same state."""

    def __init__(self, compiled: CompiledEnv) -> None:
        self.env: Any = _copy(compiled.unwrapped)
        self.n_actions = int(self.env.action_space.n)
        self.first_action = int(self.env.action_space.start)
        self.dynamics = copy.copy(compiled.dynamics)
        self.dynamics.env = self.env
        discretizer = compiled.layers.discretizer
        self.observe = discretizer.observation if discretizer else _as_it_is
        self.state_index = make_state_index((discretizer or self.env).observation_space)
        self.env.reset(seed=0)
        self.generator: Any = copy.deepcopy(self.env.np_random)
        if self.dynamics.draws_from_words:
            self.generator = np.zeros(4, np.uint64)
            read_pcg64(self.env.np_random, self.generator)
        self.state = self.dynamics.read_state()
        self.reset()

    def put(self, state: Any) -> None:
        self.dynamics.write_state(state)
        self.state = state

    def reset(self) -> None:
        observation, _ = self.env.reset()
        self.state = self._run(self.dynamics.reset_function(), self.state, self.generator)
        self._compare("a reset", self._theirs(observation), self._ours())

    def step(self, action: int) -> bool:
        before = self.state
        observation, reward, terminated, truncated, _ = self.env.step(action + self.first_action)
        self.state, our_reward, our_terminated = self._run(self.dynamics.step, before, action, self.generator)
        theirs = self._theirs(observation) | {"reward": reward, "terminated": bool(terminated), "truncated": bool(truncated)}
        ours = self._ours() | {"reward": our_reward, "terminated": bool(our_terminated), "truncated": False}
        self._compare(f"action {action} in state {before}", theirs, ours)
        return bool(terminated)

    def _run(self, function: Any, *arguments: Any) -> Any:
        with np.errstate(all="ignore"):  # machine code does not warn either
            return function(self.dynamics.parameters, *arguments)

    def _theirs(self, observation: Any) -> dict[str, Any]:
        observation = self.observe(observation)
        index = self.state_index.of(observation)
        return {"state": self.dynamics.read_state(), "row of the table": index}

    def _ours(self) -> dict[str, Any]:
        return {"state": self.state, "row of the table": self.dynamics.index(self.dynamics.parameters, self.state)}

    def _compare(self, event: str, theirs: dict[str, Any], ours: dict[str, Any]) -> None:
        for name, value in theirs.items():
            if value != ours[name] and not (name == "state" and _is_close(value, ours[name])):
                raise ValueError(
                    f"{type(self.env).__name__} does not step as {type(self.dynamics).__name__} does: after {event} the "
                    f"environment's {name} is {value}, but the dynamics give {ours[name]}. Correct the dynamics, or use "
                    "LeanVecEnv, which works with everything."
                )


def _as_it_is(observation: Any) -> Any:
    return observation


def _is_close(state: Any, other: Any) -> bool:
    """Whether two states agree to 1e-12, because the platform's sine may differ from the compiler's by that much."""
    return np.shape(state) == np.shape(other) and np.allclose(state, other, rtol=0.0, atol=1e-12)


def _copy(env: Any) -> Any:
    try:
        return copy.deepcopy(env)
    except TypeError:  # a rendered environment holds a window and a clock, which cannot be copied
        return copy.copy(env)
