"""Small environments whose every transition is known."""

import copy
from collections.abc import Sequence
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium import spaces


class Step(NamedTuple):
    """What an environment answers: ``end`` is ``""``, ``"terminated"`` or ``"truncated"``."""

    reward: float
    state: int
    end: str = ""


class Episode(NamedTuple):
    start: int
    steps: Sequence[Step]


class ScriptedEnv(gym.Env):
    """
    Plays episodes as they are written, whatever the action, and begins again after the last one.

    :param episodes: the script
    :param n_states: of the observation space
    :param n_actions: of the action space
    """

    def __init__(self, episodes: Sequence[Episode], n_states: int = 4, n_actions: int = 2) -> None:
        self.observation_space = spaces.Discrete(n_states)
        self.action_space = spaces.Discrete(n_actions)
        self.episodes = episodes
        self.episode = -1

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[int, dict[str, Any]]:
        super().reset(seed=seed)
        self.episode = (self.episode + 1) % len(self.episodes)
        self.moment = 0
        return self.episodes[self.episode].start, {}

    def step(self, action: Any) -> tuple[int, float, bool, bool, dict[str, Any]]:
        assert self.action_space.contains(action)
        reward, state, end = self.episodes[self.episode].steps[self.moment]
        self.moment += 1
        return state, reward, end == "terminated", end == "truncated", {}


class MarkovEnv(gym.Env):
    """
    Deterministic transitions that depend on the action, written as a table.

    :param outcomes: ``outcomes[state][action]`` is the step that follows
    :param starts: the first states of the episodes, used in turn
    :param time_limit: steps after which an episode is truncated
    """

    def __init__(self, outcomes: Sequence[Sequence[Step]], starts: Sequence[int] = (0,), time_limit: int = 10**9) -> None:
        self.observation_space = spaces.Discrete(len(outcomes))
        self.action_space = spaces.Discrete(len(outcomes[0]))
        self.outcomes = outcomes
        self.starts = starts
        self.time_limit = time_limit
        self.episode = -1

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[int, dict[str, Any]]:
        super().reset(seed=seed)
        self.episode += 1
        self.moment = 0
        self.state = self.starts[self.episode % len(self.starts)]
        return self.state, {}

    def step(self, action: Any) -> tuple[int, float, bool, bool, dict[str, Any]]:
        assert self.action_space.contains(action)
        reward, self.state, end = self.outcomes[self.state][int(action)]
        self.moment += 1
        return self.state, reward, end == "terminated", self.moment >= self.time_limit, {}


class SampledEnv(gym.Env):
    """
    Observations drawn from any space, no end but a time limit, a reward that the action and the draw decide.

    :param observation_space: what to draw from
    :param action_space: what to accept
    :param time_limit: steps after which an episode is truncated
    """

    def __init__(self, observation_space: spaces.Space, action_space: spaces.Space, time_limit: int = 10) -> None:
        self.observation_space = copy.deepcopy(observation_space)  # it has a random state, which is not to be shared
        self.action_space = action_space
        self.time_limit = time_limit

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        if seed is not None:
            self.observation_space.seed(seed)
        self.moment = 0
        return self.observation_space.sample(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        assert self.action_space.contains(action)
        self.moment += 1
        reward = float(self.np_random.random() + 0.25 * np.sum(action))
        return self.observation_space.sample(), reward, False, self.moment >= self.time_limit, {}


class RenumberObservation(gym.ObservationWrapper):
    """
    Shows a Discrete observation as a member of another finite space, the first component most significant.

    :param env: numbers its states from 0
    :param space: what to show them in
    """

    def __init__(self, env: gym.Env, space: spaces.Space) -> None:
        super().__init__(env)
        self.observation_space = space

    def observation(self, observation: Any) -> Any:
        space = self.observation_space
        if isinstance(space, spaces.Discrete):
            return int(space.start + observation)
        if isinstance(space, spaces.MultiDiscrete):
            return np.array(np.unravel_index(observation, space.nvec), space.dtype) + space.start
        assert isinstance(space, spaces.MultiBinary)
        digits = [int(digit) for digit in np.binary_repr(observation, int(np.prod(space.shape)))]
        return np.array(digits, np.int8).reshape(space.shape)


class RenumberAction(gym.ActionWrapper):
    """
    Counts a Discrete action from another number than 0.

    :param env: counts its actions from 0
    :param start: the number of the first action
    """

    def __init__(self, env: gym.Env, start: int) -> None:
        super().__init__(env)
        assert isinstance(env.action_space, spaces.Discrete)
        self.action_space = spaces.Discrete(int(env.action_space.n), start=start)

    def action(self, action: Any) -> Any:
        assert self.action_space.contains(action)
        return action - self.action_space.start
