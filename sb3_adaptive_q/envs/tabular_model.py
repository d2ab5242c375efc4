"""A transition table as arrays."""

from typing import Any, TypeAlias

import gymnasium as gym
import numpy as np
import numpy.typing as npt
from gymnasium import wrappers
from stable_baselines3.common.monitor import Monitor

Array: TypeAlias = npt.NDArray[Any]

#: Wrappers whose steps are those of the environment, as long as an episode goes on
_CHANGE_NOTHING = (
    Monitor, wrappers.Autoreset, wrappers.HumanRendering, wrappers.OrderEnforcing, wrappers.PassiveEnvChecker,
    wrappers.RecordEpisodeStatistics, wrappers.RecordVideo, wrappers.RenderCollection, wrappers.TimeLimit,
)  # fmt: skip


class TabularModel:
    """
    The transitions and mean rewards of a finite Markov decision process, read from a table once.

    :param table: ``table[state][action]`` is a list of (probability, next state, reward, terminated), as gymnasium's
        toy-text environments have it in ``P``
    :param start: the probability of every state to be the first of an episode
    :raises ValueError: if an entry is missing, probabilities do not sum to 1, a next state is out of range or a reward is
        not finite
    """

    #: Number of states
    n_states: int
    #: Number of actions
    n_actions: int
    #: Probabilities of the first state, of shape (n_states,)
    start: Array
    #: Mean rewards, of shape (n_states * n_actions,); the row of a state and an action is state * n_actions + action
    rewards: Array
    #: Where the successors of each row begin in ``next_states``, of shape (n_states * n_actions + 1,)
    first: Array
    #: The different successors after which the episode goes on, of all rows, one row after another
    next_states: Array
    #: Their probabilities; where a row's sum is less than 1, the rest is the probability that the episode terminates
    probabilities: Array

    def __init__(self, table: Any, start: Any) -> None:
        self.n_states = len(table)
        self.n_actions = _number_of_actions(table, 0) if self.n_states else 0
        if self.n_states == 0 or self.n_actions == 0:
            raise ValueError("The table must have at least one state with at least one action, but is empty.")
        self.start = _distribution("the start distribution", start, self.n_states)
        self.rewards = np.zeros(self.n_states * self.n_actions)
        successors: list[dict[int, float]] = []
        for state in range(self.n_states):
            if _number_of_actions(table, state) > self.n_actions:
                raise ValueError(
                    f"P[{state}] has more actions than P[0]: every state needs the same, 0 to {self.n_actions - 1}."
                )
            for action in range(self.n_actions):
                self.rewards[len(successors)], merged = self._read_row(table, state, action)
                successors.append(merged)
        self.first = np.concatenate([[0], np.cumsum([len(merged) for merged in successors])]).astype(np.int64)
        self.next_states = np.array([state for merged in successors for state in merged], np.int64)
        self.probabilities = np.array([p for merged in successors for p in merged.values()], np.float64)
        #: The rows of every state, of shape (n_states, n_actions)
        self.rows = np.arange(len(self.rewards)).reshape(self.n_states, self.n_actions)

    @classmethod
    def of(cls, source: Any) -> "TabularModel":
        """
        Read what is given, whatever of the three it is.

        :param source: an environment with a table, wrappers around it or not; the pair (table, start distribution); or a
            model, which is returned as it is
        :return: the model
        :raises ValueError: if an environment has no table, the table is wrong, or a wrapper changes what it says
        """
        if isinstance(source, TabularModel):
            return source
        if isinstance(source, tuple) and len(source) == 2:
            return cls(*source)
        env = getattr(source, "unwrapped", source)
        if hasattr(env, "table_at"):
            raise ValueError(
                f"The table of {type(env).__name__} changes with time: give `env.unwrapped.table_at(step)`, the table after "
                "so many steps."
            )
        if not (hasattr(env, "P") and hasattr(env, "initial_state_distrib")):
            raise ValueError(
                f"{type(env).__name__} has no transition table, which dynamic programming needs: `P[state][action]`, a list "
                "of (probability, next state, reward, terminated), and `initial_state_distrib`. Estimate returns by rollouts "
                "instead, for example with stable_baselines3.common.evaluation.evaluate_policy."
            )
        wrapper = changing_wrapper(source)
        if wrapper is not None:
            raise ValueError(
                f"{type(wrapper).__name__} may change actions, rewards or observations, so the table of {type(env).__name__} "
                "may not be what an agent learns from: give the table with these changes, as the pair (table, start "
                "distribution), or `env.unwrapped` if there are none."
            )
        return cls(env.P, env.initial_state_distrib)

    def _read_row(self, table: Any, state: int, action: int) -> tuple[float, dict[int, float]]:
        """The mean reward of a row, and the probabilities of its successors that do not end the episode."""
        name = f"P[{state}][{action}]"
        try:
            outcomes = [(float(p), float(n), float(r), bool(end)) for p, n, r, end in table[state][action]]
        except (KeyError, IndexError) as error:
            raise ValueError(f"{name} is missing: every state needs the same actions, 0 to {self.n_actions - 1}.") from error
        except (TypeError, ValueError) as error:
            raise ValueError(
                f"{name} must be a list of (probability, next state, reward, terminated), but is {table[state][action]!r}."
            ) from error
        _distribution(name, [outcome[0] for outcome in outcomes], len(outcomes))
        reward, merged = 0.0, dict[int, float]()
        for probability, next_state, outcome_reward, terminated in outcomes:
            if not (0 <= next_state < self.n_states and next_state == int(next_state)):
                raise ValueError(f"The next states of {name} must be 0 to {self.n_states - 1}, but one is {next_state:.16g}.")
            if not np.isfinite(outcome_reward):
                raise ValueError(f"The rewards of {name} must be finite, but one is {outcome_reward}.")
            reward += probability * outcome_reward
            if not terminated and probability > 0.0:
                merged[int(next_state)] = merged.get(int(next_state), 0.0) + probability
        return reward, merged

    def reachable_states(self) -> npt.NDArray[np.bool_]:
        """
        Find the states in which an action may have to be chosen.

        :return: whether some policy comes there from the start, of shape (n_states,); a state in which episodes only end
            does not count
        """
        reached = self.start > 0.0
        possible = self.probabilities > 0.0
        origins = np.repeat(np.arange(len(self.rewards)) // self.n_actions, np.diff(self.first))[possible]
        next_states = self.next_states[possible]
        while True:
            found = reached.copy()
            found[next_states[reached[origins]]] = True
            if (found == reached).all():
                return found
            reached = found

    def under(self, policy: Array) -> "TabularModel":
        """
        Let a policy choose.

        :param policy: probabilities of the actions, of shape (n_states, n_actions)
        :return: the process that it makes of this one, with one action
        """
        weights = np.ascontiguousarray(policy, np.float64).ravel()
        made = object.__new__(TabularModel)
        made.n_states, made.n_actions, made.start = self.n_states, 1, self.start
        made.rewards = (weights * self.rewards).reshape(self.n_states, self.n_actions).sum(axis=1)
        made.first = np.ascontiguousarray(self.first[:: self.n_actions])
        made.next_states = self.next_states
        made.probabilities = np.repeat(weights, np.diff(self.first)) * self.probabilities
        made.rows = np.arange(self.n_states).reshape(-1, 1)
        return made


def changing_wrapper(env: Any) -> gym.Wrapper[Any, Any, Any, Any] | None:
    """
    :param env: an environment
    :return: a wrapper around it that may change actions, rewards or observations, because it has a ``step`` of its own;
        ``None`` if there is none
    """
    while isinstance(env, gym.Wrapper):
        if type(env).step is not gym.Wrapper.step and not isinstance(env, _CHANGE_NOTHING):
            return env
        env = env.env
    return None


def _number_of_actions(table: Any, state: int) -> int:
    try:
        return len(table[state])
    except (KeyError, IndexError, TypeError) as error:
        raise ValueError(f"P[{state}] is missing: the table must have the states 0 to {len(table) - 1}.") from error


def _distribution(name: str, probabilities: Any, length: int) -> Array:
    values = np.ascontiguousarray(probabilities, np.float64)
    if values.shape != (length,) or not length:
        raise ValueError(f"There must be {max(length, 1)} probabilities in {name}, but its shape is {values.shape}.")
    if not (values >= 0.0).all() or abs(values.sum() - 1.0) > 1e-8:
        raise ValueError(f"The probabilities of {name} must sum to 1, but are {values.tolist()}.")
    return values
