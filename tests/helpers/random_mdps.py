"""Random decision processes, and trainings on them."""

from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.envs.toy_text.utils import categorical_sample
from gymnasium.wrappers import TimeLimit
from stable_baselines3.common.monitor import Monitor

from sb3_adaptive_q import METHODS, STEP_SIZES, CompiledVecEnv, LeanVecEnv, TabularQ
from sb3_adaptive_q.behaviour import WIDE

#: Outcomes of an action, as many as FrozenLake has: machine code is made for their number
N_OUTCOMES = 3


class RandomMDP(gym.Env):
    """
    Draws from a random table, as gymnasium's toy-text environments do from theirs.

    :param seed: decides the table
    :param wide: whether there are many actions
    """

    compile_by_table = True

    def __init__(self, seed: int, wide: bool) -> None:
        draw = np.random.default_rng(seed)
        n_states = int(draw.choice([1, 2, 3, int(draw.integers(4, 30)), int(draw.integers(30, 301))]))
        n_actions = int(draw.integers(WIDE, 3 * WIDE) if wide else draw.integers(1, 7))
        self.observation_space, self.action_space = spaces.Discrete(n_states), spaces.Discrete(n_actions)
        # Sums of eighths are exact, so that every row ends at 1
        weights = draw.multinomial(8, [1 / N_OUTCOMES] * N_OUTCOMES, (n_states, n_actions)) / 8
        next_states = draw.integers(0, n_states, (n_states, n_actions, N_OUTCOMES))
        rewards = _rewards(draw, (n_states, n_actions, N_OUTCOMES))
        ends = draw.random((n_states, n_actions, N_OUTCOMES)) < draw.choice([0.0, 0.05, 0.5])
        self.P = {
            state: {
                action: [
                    (float(weights[at]), int(next_states[at]), float(rewards[at]), bool(ends[at]))
                    for at in ((state, action, outcome) for outcome in range(N_OUTCOMES))
                ]
                for action in range(n_actions)
            }
            for state in range(n_states)
        }
        starts = draw.multinomial(8, [1 / n_states] * n_states) / 8
        self.initial_state_distrib = starts.tolist()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[int, dict[str, Any]]:
        super().reset(seed=seed)
        self.s = int(categorical_sample(self.initial_state_distrib, self.np_random))
        return self.s, {}

    def step(self, action: Any) -> tuple[int, float, bool, bool, dict[str, Any]]:
        outcomes = self.P[self.s][int(action)]
        chosen = categorical_sample([outcome[0] for outcome in outcomes], self.np_random)
        probability, self.s, reward, terminated = outcomes[chosen]
        return self.s, reward, terminated, False, {"prob": probability}


def _rewards(draw: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    kind = draw.integers(6)
    if kind == 0:
        return draw.choice([0.0, 1.0], shape)
    if kind == 1:
        return 1e12 * draw.normal(size=shape)
    if kind == 2:
        return draw.choice([5e-324, -1e-310, 1e-45, -3e-40, 0.0], shape)
    if kind == 3:
        return draw.choice([-1e12, 1e-40, 0.0, 1e12, 1.0], shape)
    return draw.normal(size=shape)


class Case(NamedTuple):
    """
    A training on a random process.

    :param kind: the class of the model
    :param step_size: a number of a method, a name of a step size, or None for a learning rate
    :param seed: of the process and of the training
    :param n_envs: the number of environments
    :param limit: steps after which an episode is truncated; None for no limit
    :param steps: environment steps of each environment
    :param arguments: further arguments of the model
    :param wide: whether the process has many actions
    """

    kind: type[Any]
    step_size: int | str | None
    seed: int
    n_envs: int
    limit: int | None
    steps: int
    arguments: dict[str, Any]
    wide: bool

    def make_envs(self) -> list[gym.Env]:
        """The environments, without a Monitor."""
        envs: list[gym.Env] = [RandomMDP(self.seed, self.wide) for _ in range(self.n_envs)]
        return envs if self.limit is None else [TimeLimit(env, self.limit) for env in envs]

    def make_vec_env(self, compiled: bool) -> LeanVecEnv:
        """The environments with Monitors, on one of the paths."""
        functions = [lambda env=env: Monitor(env) for env in self.make_envs()]
        return (CompiledVecEnv if compiled else LeanVecEnv)(functions)

    def make_model(self, compiled: bool, callback_interval: int | None = None) -> Any:
        """A model on these."""
        env = self.make_vec_env(compiled)
        return self.kind(
            "MlpPolicy", env, method=self.step_size, callback_interval=callback_interval, seed=self.seed, **self.arguments
        )


#: All step sizes; a learning rate stands for none
STEP_SIZE_NAMES: list[int | str | None] = [None, *METHODS, *STEP_SIZES]


def pairs_to_try(kinds: list[type[Any]], all_pairs: bool) -> list[tuple[type[Any], int | str | None]]:
    """
    :param kinds: the classes of the algorithms
    :param all_pairs: whether to try every algorithm with every step size, for each of which machine code has to be made;
        otherwise Q-learning with every step size, and the others with Method 7
    :return: the algorithms and step sizes to try
    """
    return [
        (kind, step_size) for kind in kinds for step_size in STEP_SIZE_NAMES if all_pairs or kind is TabularQ or step_size == 7
    ]


def make_case(number: int, pairs: list[tuple[type[Any], int | str | None]]) -> Case:
    """
    Cases with consecutive numbers go through the pairs; the rest is drawn. In one round a pair has either one environment or
    several, for each of which machine code has to be made, and in later rounds the other.

    :param number: of the case
    :param pairs: from :func:`pairs_to_try`
    :return: the case
    """
    draw = np.random.default_rng(number)
    place = number % len(pairs)
    kind, step_size = pairs[place]
    several = (place + number // max(len(pairs), 200)) % 2 == 1
    arguments: dict[str, Any] = {
        "gamma": float(draw.choice([0.0, 1.0, 0.9, draw.random()])),
        "exploration_initial_eps": float(draw.choice([0.0, 1.0, draw.random()])),
        "exploration_final_eps": float(draw.choice([0.0, 1.0, draw.random()])),
        "exploration_fraction": float(draw.choice([0.0, 1.0, 0.5])),
        "initial_q": float(draw.choice([0.0, 1.0, -1e12, draw.normal()])),
        "total_episodes": int(draw.integers(1, 40)) if draw.random() < 0.2 else None,
    }
    if step_size is None:
        arguments["learning_rate"] = float(draw.choice([0.0, 1.0, draw.random()]))
    wide = False
    if kind is TabularQ and step_size == 7:  # these are compiled anew, so one pair stands for all
        arguments.update([{"ties": "first"}, {"exploration_schedule": "constant"}, {}][draw.integers(3)])
        wide = bool(draw.random() < 0.5)
    return Case(
        kind,
        step_size,
        number,
        int(draw.integers(2, 5)) if several else 1,
        None if draw.random() < 0.3 else int(draw.integers(1, 40)),
        int(draw.integers(30, 250)),
        arguments,
        wide,
    )
