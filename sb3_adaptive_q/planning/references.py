"""What the best policy and the uniform policy reach in an environment: the scale on which learned policies are measured."""

from dataclasses import dataclass
from typing import Any

import gymnasium as gym

from sb3_adaptive_q.envs.catalogue import PROBLEMS
from sb3_adaptive_q.planning.evaluation import expected_return, optimal_return
from sb3_adaptive_q.planning.policies import uniform_policy
from sb3_adaptive_q.envs.tabular_model import TabularModel


@dataclass(frozen=True)
class Reference:
    """
    The scale of an environment.

    A policy is measured by its mean return within the horizon, undiscounted; where there is no horizon, by its discounted
    value at the start.

    :param model: the table
    :param gamma: the discount factor
    :param horizon: the steps of an episode, or ``None``
    :param optimal_value: the largest discounted value at the start, without a horizon
    :param optimal_return: the largest measure that a policy can have; within a horizon it may count the steps that are left,
        which a greedy policy of a Q table cannot
    :param uniform_return: the measure of the uniform policy
    """

    model: TabularModel
    gamma: float
    horizon: int | None
    optimal_value: float
    optimal_return: float
    uniform_return: float

    def measure(self, policy: Any) -> float:
        """
        Compute the measure of a policy.

        :param policy: the action of every state, or the probabilities of all actions
        :return: its mean return within the horizon, or its discounted value
        :raises ValueError: if the policy does not fit the table, or its value is infinite
        """
        return _measure(self.model, policy, self.gamma, self.horizon)

    def score(self, measure: Any) -> Any:
        """
        Put a measure on the scale.

        :param measure: of a policy, a number or an array
        :return: 0 for the uniform policy, 1 for the optimal one
        :raises ValueError: if these two are the same, as where there is one action
        """
        if self.optimal_return == self.uniform_return:
            raise ValueError("There is no scale: the uniform policy is as good as the optimal one.")
        return (measure - self.uniform_return) / (self.optimal_return - self.uniform_return)


#: What was made and computed in this process for names and ids with their arguments
_environments: dict[str, gym.Env[Any, Any]] = {}
_references: dict[tuple[Any, ...], Reference] = {}


def reference(
    environment: Any, *, gamma: float | None = None, horizon: int | None = None, step: int = 0, **arguments: Any
) -> Reference:
    """
    Compute the scale of an environment by dynamic programming.

    The scales of names and ids are kept for the process, so that asking again costs little.

    :param environment: a name in :data:`sb3_adaptive_q.envs.catalogue.PROBLEMS`, an id that gymnasium knows, or an
        environment with a table
    :param gamma: the discount factor; a name brings its own
    :param horizon: the steps of an episode; ``None``: the environment's limit of steps, if it has one
    :param step: the steps since the environment was seeded, where its rules change with time
    :param arguments: for ``gymnasium.make``, where a name or an id is given: ``instance=3`` for example
    :return: the scale
    :raises ValueError: if gamma is missing, or there is no table
    """
    if not isinstance(environment, str):
        return _compute(environment, gamma, horizon, step)
    problem = PROBLEMS.get(environment)
    name = f"{environment} {sorted(arguments.items())}"
    if name not in _environments:
        _environments[name] = problem.make(**arguments) if problem else gym.make(environment, **arguments)
    env = _environments[name]
    phase = env.unwrapped.phase_at(step) if hasattr(env.unwrapped, "phase_at") else 0
    key = (name, gamma, horizon, phase)
    if key not in _references:
        _references[key] = _compute(env, problem.gamma if problem and gamma is None else gamma, horizon, step)
    return _references[key]


def _compute(env: Any, gamma: float | None, horizon: int | None, step: int) -> Reference:
    if gamma is None:
        raise ValueError(f"Give gamma=...: the discount factor is no part of {env!r}.")
    inner = getattr(env, "unwrapped", env)
    model = TabularModel.of(inner.table_at(step) if hasattr(inner, "table_at") else inner)
    spec = getattr(env, "spec", None)
    if horizon is None and spec is not None:
        horizon = spec.max_episode_steps
    uniform = _measure(model, uniform_policy(model), gamma, horizon)
    value = optimal_return(model, gamma)
    return Reference(model, gamma, horizon, value, value if horizon is None else optimal_return(model, 1.0, horizon), uniform)


def _measure(model: TabularModel, policy: Any, gamma: float, horizon: int | None) -> float:
    return expected_return(model, policy, gamma if horizon is None else 1.0, horizon)
