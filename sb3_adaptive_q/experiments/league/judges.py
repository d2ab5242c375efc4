"""How good a table is: by dynamic programming where there is a transition table, by rollouts elsewhere."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from sb3_adaptive_q.experiments.league.greedy_episodes import player
from sb3_adaptive_q.planning import (
    Reference,
    TabularModel,
    action_values,
    expected_return,
    optimal_return,
    policy_evaluation,
    reference,
    uniform_policy,
    value_iteration,
)

_of_process: dict[Any, Any] = {}


class Judge(NamedTuple):
    """
    :param score: of a table after so many steps
    :param online: of the returns of all episodes
    :param largest_value: what a value can be at most, in absolute value
    :param nothing_learned: the score of a run that has failed
    """

    score: Callable[[np.ndarray, int], float]
    online: Callable[[np.ndarray], float]
    largest_value: float
    nothing_learned: float = 0.0


def control_judge(recipe: Mapping[str, Any], arguments: dict[str, Any], env: VecEnv) -> Judge:
    """
    :param recipe: of a cell
    :param arguments: of the environment
    :param env: the environment
    :return: the judge of greedy policies
    """
    gamma = recipe["learner"]["settings"]["gamma"]
    if recipe["scale"]:
        low, high = recipe["scale"]
        play = player(recipe["learner"]["environment"], arguments)

        def score_of(returns: np.ndarray) -> float:
            return float((returns.mean() - low) / (high - low))

        return Judge(lambda table, step: score_of(play(table)), score_of, _sum_of_all(high - low, gamma))
    greedy = _GreedyReturn(recipe, arguments, env, gamma)
    return Judge(greedy.score, greedy.online, greedy.largest_value)


class _GreedyReturn:
    """The exact return of the greedy policy, computed anew where that policy or the environment has changed."""

    def __init__(self, recipe: Mapping[str, Any], arguments: dict[str, Any], env: VecEnv, gamma: float) -> None:
        self.environment: Any = unwrapped(env)
        self.horizon = horizon_of(env)
        self.gamma = gamma
        self.key = (recipe["learner"]["environment"], *sorted(arguments.items()), gamma)
        self.steps, self.checkpoints = recipe["steps"], recipe["checkpoints"]
        self.policy: np.ndarray = np.zeros(0)
        self.phase: int | None = None
        self.last = np.nan
        self.largest_value = kept((*self.key, "largest"), lambda: largest_value(self.environment, gamma))

    def score(self, table: np.ndarray, step: int) -> float:
        policy, phase = table.argmax(axis=1), phase_at(self.environment, step)
        if phase != self.phase or not np.array_equal(policy, self.policy):
            scale = self._reference(step)
            self.policy, self.phase = policy, phase
            self.last = float(scale.score(scale.measure(policy)))
        return self.last

    def online(self, returns: np.ndarray) -> float:
        interval = self.steps // self.checkpoints
        low, high = np.mean([self._ends(step) for step in range(interval, self.steps + 1, interval)], axis=0)
        return float((returns.mean() - low) / (high - low))

    def _reference(self, step: int) -> Reference:
        key = (*self.key, "reference", phase_at(self.environment, step))
        return kept(key, lambda: reference(self.environment, gamma=self.gamma, horizon=self.horizon, step=last_of(step)))

    def _ends(self, step: int) -> tuple[float, float]:
        return kept((*self.key, "online", phase_at(self.environment, step)), lambda: self._undiscounted(step))

    def _undiscounted(self, step: int) -> tuple[float, float]:
        """What an episode returns on average under the uniform and under the best policy; NaN where that may be infinite."""
        model = model_at(self.environment, step)
        try:
            return (
                expected_return(model, uniform_policy(model), 1.0, self.horizon),
                optimal_return(model, 1.0, self.horizon),
            )
        except ValueError:
            return np.nan, np.nan


def estimation_judge(recipe: Mapping[str, Any], arguments: dict[str, Any], env: VecEnv) -> Judge:
    """
    :param recipe: of a cell
    :param arguments: of the environment
    :param env: the environment, which does not change
    :return: the judge of values
    """
    settings = recipe["learner"]["settings"]
    gamma, environment = settings["gamma"], unwrapped(env)
    key = (recipe["learner"]["environment"], *sorted(arguments.items()), gamma)
    best, reachable = kept((*key, "values"), lambda: _optimal_values(environment, gamma))
    largest = kept((*key, "largest"), lambda: largest_value(environment, gamma))
    first = float(np.sqrt(np.mean((settings["initial_q"] - best[reachable]) ** 2)))

    def score(table: np.ndarray, step: int) -> float:
        return 1.0 - float(np.sqrt(np.mean((table - best)[reachable] ** 2))) / first

    return Judge(score, lambda returns: np.nan, largest)


def _optimal_values(environment: Any, gamma: float) -> tuple[np.ndarray, np.ndarray]:
    model = model_at(environment, 0)
    return action_values(model, value_iteration(model, gamma), gamma), model.reachable_states()


def prediction_judge(recipe: Mapping[str, Any], arguments: dict[str, Any], env: VecEnv) -> Judge:
    """
    :param recipe: of a cell
    :param arguments: of the environment
    :param env: the environment, which has one action
    :return: the judge of values, whose score is an error: less is better
    """
    gamma, environment = recipe["learner"]["settings"]["gamma"], unwrapped(env)
    name = (recipe["learner"]["environment"], *sorted(arguments.items()), gamma, "truth")

    def score(table: np.ndarray, step: int) -> float:
        if hasattr(environment, "mean"):
            return float((table[0, 0] - environment.mean) ** 2)
        key = (*name, phase_at(environment, step))
        truth, reachable = kept(key, lambda: _true_values(environment, step, gamma))
        return float(np.mean((table[:, 0] - truth)[reachable] ** 2))

    return Judge(score, lambda returns: np.nan, np.inf, nothing_learned=np.inf)


def _true_values(environment: Any, step: int, gamma: float) -> tuple[np.ndarray, np.ndarray]:
    model = model_at(environment, step)
    return policy_evaluation(model, uniform_policy(model), gamma), model.reachable_states()


def kept(key: Any, make: Callable[[], Any]) -> Any:
    """
    :param key: of a result of dynamic programming
    :param make: computes it
    :return: it, computed once in this process
    """
    if key not in _of_process:
        _of_process[key] = make()
    return _of_process[key]


def unwrapped(env: VecEnv) -> Any:
    """
    :param env: one environment
    :return: it without its wrappers
    """
    return env.get_attr("unwrapped")[0]


def horizon_of(env: VecEnv) -> int | None:
    """
    :param env: one environment
    :return: the steps after which an episode is cut off, if it is
    """
    spec = env.get_attr("spec")[0]
    return None if spec is None else spec.max_episode_steps


def phase_at(environment: Any, step: int) -> int:
    """
    :param environment: without its wrappers
    :param step: the number of steps so far
    :return: a number that is the same where the last of these steps was made under the same rules
    """
    return environment.phase_at(last_of(step)) if hasattr(environment, "phase_at") else 0


def model_at(environment: Any, step: int) -> TabularModel:
    """
    :param environment: without its wrappers
    :param step: the number of steps so far
    :return: the rules under which the last of these steps was made
    """
    return TabularModel.of(environment.table_at(last_of(step)) if hasattr(environment, "table_at") else environment)


def last_of(steps: int) -> int:
    """
    :param steps: a number of steps
    :return: the number of steps before the last of them. Rules may change at a checkpoint: what was learned until then is
        judged by the rules that it was learned under, as nobody can follow a change before the first step after it
    """
    return max(steps - 1, 0)


def largest_value(environment: Any, gamma: float) -> float:
    """
    :param environment: without its wrappers, with a transition table
    :param gamma: the discount factor
    :return: the largest reward in absolute value, divided by 1 - gamma
    """
    table = environment.table_at(0)[0] if hasattr(environment, "table_at") else environment.P
    rewards = [abs(reward) for state in _entries(table) for row in _entries(state) for _, _, reward, _ in row]
    return _sum_of_all(float(max(rewards)), gamma)


def _sum_of_all(reward: float, gamma: float) -> float:
    """The discounted sum of a reward at every step for ever."""
    return reward / (1.0 - gamma) if gamma < 1.0 else np.inf


def _entries(table: Any) -> Any:
    return table.values() if isinstance(table, Mapping) else table
