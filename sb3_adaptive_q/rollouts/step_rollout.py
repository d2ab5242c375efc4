"""Training on ordinary environments: one step at a time."""

import warnings
from collections.abc import Callable
from math import isfinite
from typing import Any, NamedTuple, NoReturn

import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from sb3_adaptive_q.action_masks import note_mask
from sb3_adaptive_q.callbacks import Episodes
from sb3_adaptive_q.compiled.jit import CannotCompile, as_python, is_disabled, machine_code

#: A transition with the types that machine code takes
_EXAMPLE = (0, 0, 0.0, 0, False, False, 0)

#: The entries of a :class:`sb3_adaptive_q.algorithms.td_update.Transition`
TransitionEntries = tuple[int, int, float, int, bool, bool, int]


class RolloutState(NamedTuple):
    """
    The state of a rollout between two steps.

    :param transitions: for each environment the transition that was not learned from yet; empty if there are none
    :param infos: for each of these, what the log needs of the episode that it ended
    :param returns: for each environment, the rewards of the running episode
    :param lengths: for each environment, the number of steps of the running episode
    """

    transitions: list[TransitionEntries]
    infos: list[dict[str, Any]]
    returns: list[float]
    lengths: list[int]


class StepRollout:
    """
    Steps each environment once, and then learns from the n transitions in order. Each update starts from the table and the μ
    that the update before it has left.

    :param model: the tabular algorithm that learns
    :param step_locals: the variables that callbacks see, to which every step adds its own. It is one dictionary for all steps,
        because a call of ``locals()`` at every step, as in SB3, would collect all variables again
    """

    def __init__(self, model: Any, step_locals: dict[str, Any]) -> None:
        self.model = model
        self.step_locals = step_locals
        self.step_locals["rollout"] = self
        self.env: VecEnv = model.env
        self.n_envs = self.env.num_envs
        self.learner, self.draws, self.counts = model.training.record, model.training.draws, model.training.fields
        self.state_index = model.policy.state_index
        self.considered = model.considered
        self.first_action = int(model.action_space.start)
        self.states = self.state_index.of_vec(model._last_obs)
        self.episode_returns, self.episode_lengths = [0.0] * self.n_envs, [0] * self.n_envs
        self.transitions: list[TransitionEntries] = []
        self.take_choices()
        if model._next_actions is None:
            model._next_actions = np.array([self._choose_action(i) for i in range(self.n_envs)], dtype=np.int64)
        self._action_array = model._next_actions
        # A memoryview gives Python's integers, which machine code takes faster than NumPy's
        self.actions: Any = memoryview(model._next_actions)

    def __reduce__(self) -> tuple[Any, ...]:
        """A rollout belongs to a training that runs: a copy of a callback, which knows it by a variable, has ``None``."""
        return type(None), ()

    def take_choices(self) -> None:
        """Fetch the machine code for the model's algorithm and method, which may change between two steps."""
        model = self.model
        self.choices = model.choices
        self.tables, self.memory = model.learning_arrays()
        self._compile()

    def _compile(self) -> None:
        function = self.choices.update_loop()
        try:
            self._check_own_functions()
            arguments = (self.tables, self.memory, self.learner, self.draws, _EXAMPLE, 0, self.considered)
            self._update = self._in_python(function) if is_disabled() else machine_code(function, arguments)
        except CannotCompile as error:
            warnings.warn(f"{self.model.own_functions()} runs as Python, which is slower: {error}.", stacklevel=5)
            self._update = self._in_python(function)

    def _check_own_functions(self) -> None:
        if self.model._method is not None and not is_disabled():
            self.model._method.check_functions()

    def _in_python(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """The update as a Python function. An error restores the entry of the table, if the algorithm changes only one."""
        self.learner = self.learner.view(np.recarray)  # whose fields Python reads by their names, as machine code does
        run, table = as_python(function), self.tables[0]

        def update(tables: Any, memory: Any, learner: Any, draws: Any, transition: Any, env: int, considered: Any) -> int:
            entry = transition[:2]
            value = table[entry]
            try:
                return run(tables, memory, learner, draws, transition, env, considered)
            except BaseException:
                if self.model.updates_one_entry:
                    table[entry] = value
                raise

        return update

    def advance(self) -> None:
        """
        Take the chosen actions. Callbacks then find ``actions``, ``new_obs``, ``rewards``, ``dones`` and ``infos`` among
        the variables, as with ``VecEnv.step``.

        :raises ValueError: if a reward is not a finite number; the table stays as it was
        """
        actions = self._action_array.copy()
        if self.first_action:
            actions += self.first_action
        new_obs, rewards, dones, infos = self.env.step(actions)
        self.counts.num_timesteps += self.n_envs
        self.infos, self.dones = infos, dones.tolist()
        self.transitions = self._transitions(self.state_index.of_vec(new_obs), rewards.tolist())
        if self.model.use_masking:
            self._note_masks(self.model.policy.allowed.numpy())
        if True in self.dones:
            self._hand_over_episodes()
        self.show(actions, new_obs, rewards, dones, infos)

    def learn(self) -> None:
        """Learn from the transitions that were made last, and choose the next actions."""
        if self.model.choices is not self.choices:
            self.take_choices()
        self.note_episodes()
        update, states, actions = self._update, self.states, self.actions
        tables, memory, learner, draws, considered = self.tables, self.memory, self.learner, self.draws, self.considered
        for i, transition in enumerate(self.transitions):
            try:
                action = update(tables, memory, learner, draws, transition, i, considered)
            except IndexError as error:
                self.refuse_index(error, self.model.functions_of_user())
            if action < 0:
                self.refuse(states[i], actions[i])
            states[i], actions[i] = transition[-1], action
        self.transitions = []
        self.model._last_obs = self.new_obs

    def abandon(self) -> None:
        """Drop the last transitions, as SB3 does when a callback ends the training. Their episodes are counted."""
        self.note_episodes()
        self.model._episode_num += sum(self.dones)
        self.model._next_actions = None
        self.model._last_obs = self.new_obs
        self.transitions = []

    def state(self) -> RolloutState:
        """
        :return: the state of the rollout, for a callback that saves the model
        """
        infos = self._infos_for_log() if self.transitions else []
        return RolloutState(self.transitions, infos, self.episode_returns, self.episode_lengths)

    def restore(self, state: RolloutState) -> None:
        """
        Continue another rollout. :meth:`learn` then learns from its transitions.

        :param state: the state of the other rollout
        """
        self.episode_returns, self.episode_lengths = list(state.returns), list(state.lengths)
        self.transitions = state.transitions
        self._restore_last_step(state)

    def _infos_for_log(self) -> list[dict[str, Any]]:
        return [{name: info[name] for name in ("episode", "is_success") if name in info} for info in self.infos]

    def _restore_last_step(self, state: RolloutState) -> None:
        for i, transition in enumerate(state.transitions):
            self.states[i], self.actions[i] = transition[:2]
        self.dones, self.infos = [transition[5] for transition in state.transitions], state.infos
        self.new_obs = self.model._last_obs

    def show(
        self, actions: np.ndarray, new_obs: Any, rewards: np.ndarray, dones: np.ndarray, infos: list[dict[str, Any]]
    ) -> None:
        """Put the results of a step among the variables that callbacks see."""
        step_locals = self.step_locals
        step_locals["actions"], step_locals["new_obs"] = actions, new_obs
        step_locals["rewards"], step_locals["dones"], step_locals["infos"] = rewards, dones, infos
        self.new_obs = new_obs

    def note_episodes(self) -> None:
        """Give the log the episodes that the last step ended."""
        if True in self.dones:
            ended = [info for info, done in zip(self.infos, self.dones, strict=True) if done]
            self.model._update_info_buffer(ended, [True] * len(ended))

    def refuse(self, state: int, action: int) -> NoReturn:
        """
        :param state: the state that the refused update started from
        :param action: its action
        :raises ValueError: always; the table is as it was where the algorithm changes one entry
        """
        model, learner = self.model, self.learner[0]
        sizes = [float(learner[name]) for name in ("refused_size", "refused_mu")]
        refused = [size for size in sizes if not 0.0 <= size <= 1.0]
        if not learner["refused_epsilon"] >= 0.0:
            who, what = "`exploration_schedule`", "exploration rates from 0 to 1 (temperatures above 0)"
            given = "another value"
        elif refused:
            who, what, given = model.own_functions(), "step sizes from 0 to 1", repr(refused[0])
        else:
            who, what = f"The update of {type(model).__name__}", f"actions from 0 to {model.policy.n_actions - 1}"
            given = repr(int(learner["refused_action"]))
        if model.updates_one_entry:
            model.q_table[state, action] = learner["value"]
        raise ValueError(
            f"{who} must give {what}, but at step {model.num_timesteps}, in state {state} for action "
            f"{action + self.first_action}, it gave {given}: please check it."
        )

    @staticmethod
    def refuse_index(error: IndexError, who: str) -> NoReturn:
        """
        :param error: what a function of the user's has raised
        :param who: whose function it may be
        :raises ValueError: always
        """
        raise ValueError(
            f"{who} looked beyond the end of an array ({error}): please check it. The cell of a step size is "
            "`[step.row, step.column]`, that of a table `[state, action]`."
        ) from error

    def _hand_over_episodes(self) -> None:
        """Pass the episodes that have just ended to the callbacks that record episodes."""
        ended = [i for i, done in enumerate(self.dones) if done]
        if self.model.episode_series:
            returns, lengths = zip(*map(self._finished, ended), strict=True)
            mu, epsilon = np.full(len(ended), self.model.mu), np.full(len(ended), self.model.exploration_rate)
            episodes = Episodes(np.array(returns, dtype=np.float64), np.array(lengths, dtype=np.int64), mu, epsilon)
            for series in self.model.episode_series:
                series.add(episodes)
        for i in ended:
            self.episode_returns[i], self.episode_lengths[i] = 0.0, 0

    def _finished(self, i: int) -> tuple[float, int]:
        """Return and length of the episode that environment i has just ended, from its Monitor if there is one."""
        episode = self.infos[i].get("episode")
        if isinstance(episode, dict) and {"r", "l", "t"} <= set(episode):
            return episode["r"], episode["l"]
        return round(self.episode_returns[i], 6), self.episode_lengths[i]

    def _transitions(self, start_states: list[int], rewards: list[float]) -> list[TransitionEntries]:
        transitions = []
        for i, done in enumerate(self.dones):
            reward, start_state = rewards[i], start_states[i]
            if not isfinite(reward):
                self.refuse_reward(i, reward)
            next_state, terminated = start_state, done
            if done:
                terminated = not self.infos[i].get("TimeLimit.truncated", False)
                if not terminated or self.infos[i].get("terminal_observation") is not None:
                    next_state = self.state_index.of(self._terminal_observation(i))
            self.episode_returns[i] += reward
            self.episode_lengths[i] += 1
            transitions.append((self.states[i], self.actions[i], reward, next_state, terminated, done, start_state))
        return transitions

    def _terminal_observation(self, i: int) -> Any:
        if self.infos[i].get("terminal_observation") is None:
            raise ValueError(
                f"Environment {i} has truncated an episode at step {self.model.num_timesteps} without "
                '`info["terminal_observation"]`, whose value the target needs: a VecEnv must tell it.'
            )
        return self.infos[i]["terminal_observation"]

    def _choose_action(self, i: int) -> int:
        behaviour = self.choices.functions_of_behaviour()
        behaviour.show(self.tables, self.states[i], self.considered[i])
        return int(as_python(behaviour.choose)(self.tables, self.states[i], self.model.exploration_rate, self.draws))

    def _note_masks(self, allowed: np.ndarray) -> None:
        """Store the masks of the states in which an action is chosen next."""
        for i, (_, _, _, next_state, terminated, done, start_state) in enumerate(self.transitions):
            if not terminated:
                note_mask(allowed, next_state, self.infos[i])
            if done:
                note_mask(allowed, start_state, self.env.unwrapped.reset_infos[i])

    def refuse_reward(self, i: int, reward: float) -> NoReturn:
        """
        :param i: the number of the environment
        :param reward: the reward that it gave
        :raises ValueError: always
        """
        raise ValueError(
            f"Rewards must be finite, but at step {self.model.num_timesteps} environment {i} gave {reward} for action "
            f"{self.actions[i] + self.first_action} in state {self.states[i]}: please check its reward."
        )
