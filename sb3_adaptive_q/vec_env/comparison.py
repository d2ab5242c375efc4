"""A check that an environment steps as the functions do that are compiled in its place."""

import copy
from typing import TYPE_CHECKING, Any

import numpy as np

from sb3_adaptive_q.state_index import make_state_index
from sb3_adaptive_q.vec_env.tabular_dynamics import TabularDynamics, playable_states

if TYPE_CHECKING:
    from sb3_adaptive_q.vec_env.compiled_vec_env import CompiledEnv


def compare_with_environment(twin: "CompiledEnv", n_steps: int = 100, n_pairs: int = 2000) -> None:
    """
    Step a copy of the environment beside the functions that stand for it, both uncompiled, from the same seed.

    :param twin: the environment
    :param n_steps: how long to play
    :param n_pairs: how many states and actions of a transition table to try
    :raises ValueError: if they differ
    """
    both = _SideBySide(twin)
    actions = np.random.default_rng(0)
    for _ in range(n_steps):
        if both.step(int(actions.integers(both.n_actions))):
            both.reset()
    if not isinstance(twin.dynamics, TabularDynamics):
        return
    states = playable_states(twin.dynamics.parameters)
    pairs = actions.permutation(len(states) * both.n_actions)
    for pair in np.resize(pairs, n_pairs).tolist():
        both.put(int(states[pair // both.n_actions]))
        both.step(pair % both.n_actions)


class _SideBySide:
    """A copy of an environment, and the functions that stand for it, with generators of the same state."""

    def __init__(self, twin: "CompiledEnv") -> None:
        self.env: Any = _copy(twin.unwrapped)
        self.n_actions = int(self.env.action_space.n)
        self.first_action = int(self.env.action_space.start)
        self.dynamics = copy.copy(twin.dynamics)
        self.dynamics.env = self.env
        discretizer = twin.layers.discretizer
        self.observe = discretizer.observation if discretizer else _as_it_is
        self.state_index = make_state_index((discretizer or self.env).observation_space)
        self.env.reset(seed=0)
        self.generator = np.random.default_rng()
        self.generator.bit_generator.state = self.env.np_random.bit_generator.state
        self.reset()

    def put(self, state: Any) -> None:
        self.dynamics.write_state(state)
        self.state = state

    def reset(self) -> None:
        observation, _ = self.env.reset()
        self.state = self.dynamics.reset(self.dynamics.parameters, self.generator)
        self._compare("a reset", self._theirs(observation), self._ours())

    def step(self, action: int) -> bool:
        before = self.state
        observation, reward, terminated, truncated, _ = self.env.step(action + self.first_action)
        self.state, our_reward, our_terminated = self.dynamics.step(self.dynamics.parameters, before, action, self.generator)
        theirs = self._theirs(observation) | {"reward": reward, "terminated": bool(terminated), "truncated": bool(truncated)}
        ours = self._ours() | {"reward": our_reward, "terminated": bool(our_terminated), "truncated": False}
        self._compare(f"action {action} in state {before}", theirs, ours)
        return bool(terminated)

    def _theirs(self, observation: Any) -> dict[str, Any]:
        observation = self.observe(observation)
        index = self.state_index.of(observation.tolist() if isinstance(observation, np.ndarray) else observation)
        return {"state": self.dynamics.read_state(), "row of the table": index}

    def _ours(self) -> dict[str, Any]:
        return {"state": self.state, "row of the table": self.dynamics.index(self.dynamics.parameters, self.state)}

    def _compare(self, event: str, theirs: dict[str, Any], ours: dict[str, Any]) -> None:
        for name, value in theirs.items():
            if value != ours[name] and not (name == "state" and _is_close(value, ours[name])):
                raise ValueError(
                    f"{type(self.env).__name__} does not step as {type(self.dynamics).__name__} does: after {event} its "
                    f"{name} is {value}, which should be {ours[name]}. Use LeanVecEnv, which works with everything."
                )


def _as_it_is(observation: Any) -> Any:
    return observation


def _is_close(state: Any, other: Any) -> bool:
    """Within what is promised where the platform's sine differs from the compiler's."""
    return np.shape(state) == np.shape(other) and np.allclose(state, other, rtol=0.0, atol=1e-12)


def _copy(env: Any) -> Any:
    try:
        return copy.deepcopy(env)
    except TypeError:  # what has been rendered holds a window and a clock, of which there is no copy
        return copy.copy(env)
