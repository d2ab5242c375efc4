"""How transitions are made and learned from: one step of the environment at a time."""

from math import inf, isfinite
from numbers import Real
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from sb3_adaptive_q import kernels, rules
from sb3_adaptive_q.compilation import FunctionSet
from sb3_adaptive_q.draws import addresses_of
from sb3_adaptive_q.rules import Transition
from sb3_adaptive_q.update import WORKSPACE, compile_update

if TYPE_CHECKING:
    from sb3_adaptive_q.tabular_q import TabularQ

NO_UPDATES = (0.0, inf, -inf, 0.0)
HOLD = FunctionSet("hold", function=rules.hold_rate)


class Episodes(NamedTuple):
    """
    Finished episodes, one row each.

    :param returns: sums of rewards, rounded to six decimals as SB3's Monitor does
    :param lengths: steps
    :param rates: μ in force at the last transition
    :param epsilons: ε in force at the last transition
    """

    returns: np.ndarray
    lengths: np.ndarray
    rates: np.ndarray
    epsilons: np.ndarray


class StepRollout:
    """
    Steps the environments once, and learns from the n transitions in their order, each with the table and the μ that
    the one before it left.

    :param model: the model that learns
    :param learner: what stays as it is in this training
    :param step_locals: the variables that callbacks see; those of a step are put in. One dictionary, because ``locals()``,
        which SB3 hands over at every step, would gather all the others again
    """

    def __init__(self, model: "TabularQ", learner: kernels.Learner, step_locals: dict[str, Any]) -> None:
        assert model.env is not None
        self.model = model
        self.step_locals = step_locals
        self.step_locals["rollout"] = self
        self.env: VecEnv = model.env
        self.learner = learner
        self._workspace = np.zeros(1, WORKSPACE)
        self._take_rule()
        self._take_generator()
        #: Sum of μ, least μ, largest μ and sum of absolute temporal-difference errors since the last entry of the log
        self.statistics: np.ndarray = self._workspace["statistics"][0]
        self.progress = kernels.progress_made(learner, model.num_timesteps, model._episode_num)
        model.exploration_rate = kernels.exploration_rate(learner, self.progress)
        self.state_index = model.policy.state_index
        self.states = self.state_index.of_vec(model._last_obs)
        self.first_action = int(model.action_space.start)  # type: ignore[attr-defined]
        if model._next_actions is None:
            model._next_actions = np.array([self._choose_action(state) for state in self.states], dtype=np.int64)
        self._action_array = model._next_actions
        # Its entries are Python's integers, which machine code takes faster than NumPy's
        self.actions: Any = memoryview(model._next_actions)  # type: ignore[arg-type]

    def advance(self) -> None:
        """
        Take the chosen actions. Callbacks then find ``actions``, ``new_obs``, ``rewards``, ``dones`` and ``infos`` among
        the variables, as ``VecEnv.step`` has them.

        :raises ValueError: if a reward is not a finite number; the table stays as it was
        """
        actions = self._action_array.copy()
        if self.first_action:
            actions += self.first_action
        new_obs, rewards, dones, infos = self.env.step(actions)
        self.model.num_timesteps += self.env.num_envs
        self.infos, self.dones = infos, dones.tolist()
        self.transitions = self._transitions(self.state_index.of_vec(new_obs), rewards.tolist())
        self._show(actions, new_obs, rewards, dones, infos)

    def learn(self) -> None:
        """Learn from the transitions that were made last, and choose the next actions."""
        if True in self.dones:
            self._note_episodes()
        model, states, actions = self.model, self.states, self.actions
        if model._rule is not self._rule:
            self._take_rule()
        if model._generator is not self._generator:
            self._take_generator()
        mu, epsilon, progress, n_episodes = model._mu[0], model.exploration_rate, self.progress, model._episode_num
        num_timesteps = model.num_timesteps
        for i, (reward, next_state, terminated, done, start_state) in enumerate(self.transitions):
            # One variable after the other: to gather them in a tuple would take a tenth of the time
            actions[i], next_mu, epsilon, value, next_value, td_error, progress = self._update(
                mu, epsilon, n_episodes, num_timesteps,
                states[i], actions[i], reward, next_state, terminated, done, start_state,
            )  # fmt: skip
            if self._runs_as_python:
                transition = Transition(value, next_value, td_error, progress)
                next_mu = kernels.next_rate(self._rule, model._rule_arguments, self.learner, mu, transition, done)
                if not isinstance(next_mu, Real):
                    model._refuse_rate(next_mu)
            mu, states[i] = next_mu, start_state
            n_episodes += done
            if not 0.0 <= mu <= 1.0:
                model._refuse_rate(mu)
        model._mu[0] = mu
        model.exploration_rate, self.progress, model._episode_num = epsilon, progress, n_episodes
        model._n_updates += len(actions)
        model._last_obs = self.new_obs

    def _take_rule(self) -> None:
        """A rule of this package is compiled; any other stays the Python it is, whatever it may do."""
        model = self.model
        self._rule = model._rule
        self.learner = self.learner._replace(**model._rate_constants())
        self._workspace["learner"] = tuple(self.learner)
        self._runs_as_python = self._rule.functions["function"] not in vars(rules).values()
        rule, arguments = (HOLD, ()) if self._runs_as_python else (self._rule, model._rule_arguments)
        self._update = compile_update(rule, arguments, model._table, self._workspace)

    def _take_generator(self) -> None:
        generator = self.model._generator
        self._workspace["draws"] = addresses_of(generator)
        self._generator = generator  # kept, so that the addresses stay good; and last, so that an interrupt is harmless

    def abandon(self) -> None:
        """Leave the last transitions unlearned, as SB3 does when a callback ends the training; their episodes count."""
        if True in self.dones:
            self._note_episodes()
        self.model._episode_num += sum(self.dones)
        self.model._next_actions = None
        self.model._last_obs = self.new_obs

    def finished_episodes(self) -> Episodes:
        """
        :return: the episodes that ended since the last call of the callbacks, as far as a Monitor saw them
        """
        infos = [info["episode"] for info in self.infos if "episode" in info]
        return Episodes(
            np.array([info["r"] for info in infos], dtype=np.float64),
            np.array([info["l"] for info in infos], dtype=np.int64),
            np.full(len(infos), self.model.mu),
            np.full(len(infos), self.model.exploration_rate),
        )

    def _show(
        self, actions: np.ndarray, new_obs: Any, rewards: np.ndarray, dones: np.ndarray, infos: list[dict[str, Any]]
    ) -> None:
        step_locals = self.step_locals
        step_locals["actions"], step_locals["new_obs"] = actions, new_obs
        step_locals["rewards"], step_locals["dones"], step_locals["infos"] = rewards, dones, infos
        self.new_obs = new_obs

    def _note_episodes(self) -> None:
        self.model._update_info_buffer(self.infos, self.dones)

    def _transitions(self, states: list[int], rewards: list[float]) -> list[tuple[float, int, bool, bool, int]]:
        """For each environment: reward, state reached, whether it is terminal, whether the episode ended, state now."""
        transitions = []
        for i, done in enumerate(self.dones):
            if not isfinite(rewards[i]):
                self._refuse_reward(i, rewards[i])
            state = states[i]
            next_state, terminated = state, done
            if done:
                next_state = self.state_index.of(self.infos[i]["terminal_observation"])
                terminated = not self.infos[i].get("TimeLimit.truncated", False)
            transitions.append((rewards[i], next_state, terminated, done, state))
        return transitions

    def _choose_action(self, state: int) -> int:
        model = self.model
        return kernels.choose_action(model._table, state, self.learner.n_actions, model.exploration_rate, model._generator)

    def _refuse_reward(self, i: int, reward: float) -> NoReturn:
        raise ValueError(
            f"Rewards must be finite, but at step {self.model.num_timesteps} environment {i} gave {reward} for action "
            f"{self.actions[i] + self.first_action} in state {self.states[i]}: please check its reward."
        )
