"""What a user might write: rules, environments and an algorithm that a design names as ``module:name``."""

from typing import Any

import gymnasium as gym

from sb3_adaptive_q import LearningRateCallback, TabularQ


class Halving(LearningRateCallback):
    """μ starts at ``first`` and is divided by ``divisor`` at every update, down to 0.01."""

    def __init__(self, first: float = 0.5, divisor: float = 2.0) -> None:
        super().__init__(mu_0=first, divisor=divisor)

    @staticmethod
    def rule(mu: float, step: Any, divisor: float) -> float:
        return max(mu / divisor, 0.01)


class Broken(LearningRateCallback):
    """Gives no number once half of the training is over."""

    @staticmethod
    def rule(mu: float, step: Any) -> float:
        return 0.1 if step.progress < 0.5 else float("nan")


class NoRule:
    """Not a callback at all."""


class OwnAlgorithm(TabularQ):
    """Learns as TabularQ does."""


def make_lake() -> gym.Env:
    """A lake without ice."""
    return gym.make("FrozenLake-v1", is_slippery=False)


class CountingEnv(gym.Env):
    """Two states, which nothing can compile: every step is to the right, the third ends the episode."""

    def __init__(self) -> None:
        self.observation_space = gym.spaces.Discrete(3)
        self.action_space = gym.spaces.Discrete(2)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[int, dict[str, Any]]:
        super().reset(seed=seed)
        self.state = 0
        return self.state, {}

    def step(self, action: int) -> tuple[int, float, bool, bool, dict[str, Any]]:
        self.state += 1
        return self.state, float(action), self.state == 2, False, {}


class MirroredActions(gym.ActionWrapper[Any, Any, Any]):
    """Left is right, and up is down: what a transition table says no longer holds."""

    def action(self, action: int) -> int:
        return 3 - int(action)


def mirrored_lake() -> gym.Env:
    """A lake whose transition table is not the agent's."""
    return MirroredActions(make_lake())


def broken() -> gym.Env:
    """Cannot be made."""
    raise RuntimeError("no such luck")
