"""
The learning loops, made of an algorithm, a step size, a behaviour policy and an environment: all of them plain functions.

A *factory* closes over the functions and returns the loop, an ordinary Python function of numbers and arrays;
:mod:`sb3_adaptive_q.compiled.jit` makes machine code of it. The same :func:`make_learn_one` serves a transition of an
ordinary environment and the loops with a compiled one.
"""

import numpy as np

from sb3_adaptive_q.algorithms.td_update import Agent, Memory, Transition, is_sound
from sb3_adaptive_q.compiled.records import (
    Now,
    load_fixed,
    load_now,
    load_transition,
    note_episode,
    store_control,
    store_now,
    store_transition,
)
from sb3_adaptive_q.step_sizes.step import Step

#: What may be wrong with a transition, or with the update that it led to
SOUND, REWARD_NOT_FINITE, STATE_OUT_OF_RANGE, UPDATE_REFUSED = range(4)


def go_on(t, action):
    """The transition to come: by this action, from where the environment is now."""
    return Transition(t.start_state, action, t.reward, t.next_state, t.terminated, t.done, t.start_state)


def seen_by_rule(step, next_value, progress):
    """The update as the rule for the next step size sees it."""
    return Step(
        step.state, step.action, step.row, step.column, step.count, step.value, next_value, step.td_error, progress,
        step.gamma, step.size,
    )  # fmt: skip


def make_learn_one(update, size, rule, behaviour, explore):
    """
    :param update: the algorithm's update
    :param size: forms the step size of this update, as a :class:`Step`
    :param rule: forms the scalar step size that the next update starts from
    :param behaviour: the :class:`sb3_adaptive_q.behaviour.Behaviour`
    :param explore: the exploration rate by the progress, from a :class:`Fixed`
    :return: a function that learns from one transition and chooses what to do next. It tells whether the step size, the μ
        after it, the exploration rate and the action are in range
    """
    choose, expect, best, _ = behaviour

    def learn_one(tables, memory, fixed, now, num_timesteps, draws, t, env):
        epsilon, progress, n_episodes = now.epsilon, now.progress, now.n_episodes
        if fixed.total_episodes == 0:
            progress = min(num_timesteps / fixed.total_timesteps, 1.0)
            if fixed.holds_epsilon == 0:
                epsilon = explore(fixed, progress)
        rate = epsilon if epsilon >= 0.0 else now.epsilon  # one that is refused below must not enter the tables
        agent = Agent(fixed.gamma, rate, now.mu, progress, fixed.next_action, env, memory.algorithm_parameters)
        action, step, next_value = update(tables, agent, size, choose, expect, best, memory, draws, t)
        if t.done:
            n_episodes += 1
            if fixed.total_episodes > 0:
                progress = min(n_episodes / fixed.total_episodes, 1.0)
                if fixed.holds_epsilon == 0:
                    epsilon = explore(fixed, progress)
            action = choose(tables, t.start_state, epsilon, draws)
        if t.done and fixed.resets_mu != 0:
            mu = fixed.mu_0
        elif fixed.holds_mu != 0:
            mu = now.mu
        else:
            mu = rule(now.mu, seen_by_rule(step, next_value, progress), *memory.parameters)
        sound = is_sound(step) and 0.0 <= mu <= 1.0 and epsilon >= 0.0 and 0 <= action < tables[0].shape[1]
        now = Now(
            mu, epsilon, progress, n_episodes, now.n_updates + 1, now.mu_sum + step.size, min(now.mu_min, step.size),
            max(now.mu_max, step.size), now.td_error_sum + abs(step.td_error),
        )  # fmt: skip
        return action, sound, now, step

    return learn_one


def refuse(learner, now, step, action):
    """Note what was computed, and leave the counters as they are."""
    learner.value, learner.refused_size = step.value, step.size
    learner.refused_mu, learner.refused_epsilon, learner.refused_action = now.mu, now.epsilon, action


def make_update_loop(learn_one, show, chooses_before_update):
    """
    :param learn_one: from :func:`make_learn_one`
    :param show: writes what the behaviour policy looks at into a row
    :param chooses_before_update: whether the next action is drawn from the table before the update
    :return: a function that learns from one transition of an ordinary environment; it returns the next action, or -1
        where the update was refused. For each environment it notes the values that the action was chosen from
    """

    def update_loop(tables, memory, learner, draws, transition, env, considered):
        before = load_now(learner[0])
        state, action, reward, next_state, terminated, done, start_state = transition
        t = Transition(state, action, reward, next_state, terminated, done, start_state)
        known = Memory(memory[0], memory[1], memory[2], memory[3], 0)
        if chooses_before_update:
            show(tables, next_state, considered[env])
        fixed, num_timesteps = load_fixed(learner[0]), learner[0].num_timesteps
        action, sound, now, step = learn_one(tables, known, fixed, before, num_timesteps, draws, t, env)
        if not sound:
            refuse(learner[0], now, step, action)
            return -1
        store_now(learner[0], now)
        if done or not chooses_before_update:
            show(tables, start_state, considered[env])
        return action

    return update_loop


def make_env_step(reset, step, index):
    """
    :param reset: the environment's, as are ``step`` and ``index``
    :param step: see :class:`sb3_adaptive_q.vec_env.Dynamics`
    :param index: see there
    :return: a function that makes the transition which state and action of ``t`` begin, and resets where the episode ends
    """

    def env_step(parameters, place, generator, t, length, episode_return, limit):
        place, reward, terminated = step(parameters, place, t.action, generator)
        next_state = start_state = index(parameters, place)
        length, episode_return = length + 1, episode_return + reward
        done = terminated or length >= limit
        if done:
            place = reset(parameters, place, generator)
            start_state = index(parameters, place)
        reward = np.float64(np.float32(reward))  # as a VecEnv hands it on
        return place, Transition(t.state, t.action, reward, next_state, terminated, done, start_state), length, episode_return

    return env_step


def make_single_loop(learn_one, reset, step, index, load_state, store_state, name_parameters, check):
    """
    The loop for one environment, all of it in local variables.

    :param learn_one: from :func:`make_learn_one`
    :param reset: the environment's, as are ``step`` and ``index``
    :param step: see :class:`sb3_adaptive_q.vec_env.Dynamics`
    :param index: see there
    :param load_state: reads the environment's state from an array
    :param store_state: writes it
    :param name_parameters: makes the dynamics' named tuple
    :param check: what is wrong with a transition
    :return: the loop; it begins by learning from the transition that is pending, if there is one
    """
    env_step = make_env_step(reset, step, index)

    def single_loop(tables, memory, learner, draws, envs, dynamics, control, record):
        known = Memory(memory[0], memory[1], memory[2], memory[3], 0)
        fixed, now, steps_before = load_fixed(learner[0]), load_now(learner[0]), learner[0].num_timesteps
        generator, parameters = dynamics[1][0], name_parameters(*dynamics[2])
        place, env, (episodes, dones) = load_state(dynamics[0], 0), envs[0], record
        t, length, episode_return = load_transition(env), env.length, env.episode_return
        limit, max_steps, max_episodes = control[0].max_episode_steps, control[0].max_steps, control[0].max_episodes
        pending, status, n_steps, n_ended, n_states = control[0].pending != 0, SOUND, 0, 0, tables[0].shape[0]
        only_learns = max_steps <= 0 or max_episodes <= 0
        while True:
            if pending:
                num_timesteps = steps_before + n_steps
                action, sound, later, update = learn_one(tables, known, fixed, now, num_timesteps, draws, t, 0)
                if not sound:
                    refuse(learner[0], later, update, action)
                    status = UPDATE_REFUSED
                    break
                now, t = later, go_on(t, action)
            pending = False
            if only_learns:
                break
            place, t, length, episode_return = env_step(parameters, place, generator, t, length, episode_return, limit)
            if t.done:
                dones[n_steps, 0] = True
                note_episode(episodes[n_ended], length, episode_return, now, 0)
                length, episode_return, n_ended = 0, 0.0, n_ended + 1
                if n_ended >= max_episodes:
                    max_steps = n_steps + 1  # this step is the last
            n_steps += 1
            status = check(t.next_state, t.start_state, t.reward, n_states)
            if status != SOUND:
                break
            pending = True
            if n_steps >= max_steps:
                break
        store_transition(env, t)
        env.length, env.episode_return = length, episode_return
        store_state(dynamics[0], 0, place)
        store_now(learner[0], now)
        learner[0].num_timesteps = steps_before + n_steps
        store_control(control[0], pending, status, n_steps, n_ended, 0)

    return single_loop


def make_several_loop(  # noqa: C901  # one function of machine code
    learn_one, reset, step, index, load_state, store_state, name_parameters, check
):
    """
    The loop for any number of environments, each in a record; for the parameters see :func:`make_single_loop`.

    :return: the loop; it begins by learning from the transitions that are pending, if there are any
    """
    env_step = make_env_step(reset, step, index)

    def several_loop(tables, memory, learner, draws, envs, dynamics, control, record):  # noqa: C901
        known = Memory(memory[0], memory[1], memory[2], memory[3], 0)
        fixed, now, num_timesteps = load_fixed(learner[0]), load_now(learner[0]), learner[0].num_timesteps
        states, generators, parameters, (episodes, dones) = dynamics[0], dynamics[1], name_parameters(*dynamics[2]), record
        limit, max_steps, max_episodes = control[0].max_episode_steps, control[0].max_steps, control[0].max_episodes
        pending, status, n_steps, n_ended, n_states = control[0].pending != 0, SOUND, 0, 0, tables[0].shape[0]
        culprit = 0
        while True:
            if pending:
                for i in range(len(envs)):
                    t = load_transition(envs[i])
                    action, sound, later, update = learn_one(tables, known, fixed, now, num_timesteps, draws, t, i)
                    if not sound:
                        refuse(learner[0], later, update, action)
                        status, culprit = UPDATE_REFUSED, i
                        break
                    now = later
                    envs[i].state, envs[i].action = t.start_state, action
            if status != SOUND:
                break
            pending = False
            if max_steps <= 0 or max_episodes <= 0:
                break
            for i in range(len(envs)):
                env, place, t = envs[i], load_state(states, i), load_transition(envs[i])
                place, t, length, episode_return = env_step(
                    parameters, place, generators[i], t, env.length, env.episode_return, limit
                )  # fmt: skip
                if t.done:
                    dones[n_steps, i] = True
                    note_episode(episodes[n_ended], length, episode_return, now, i)
                    length, episode_return, n_ended = 0, 0.0, n_ended + 1
                store_transition(env, t)
                env.length, env.episode_return = length, episode_return
                store_state(states, i, place)
                found = check(t.next_state, t.start_state, t.reward, n_states)
                if found != SOUND:
                    status, culprit = found, i
            num_timesteps, n_steps = num_timesteps + len(envs), n_steps + 1
            if status != SOUND:
                break
            pending = True
            if n_steps >= max_steps or n_ended >= max_episodes:
                break
        store_now(learner[0], now)
        learner[0].num_timesteps = num_timesteps
        store_control(control[0], pending, status, n_steps, n_ended, culprit)

    return several_loop


def check_transition(next_state, start_state, reward, n_states):
    """
    :param next_state: the row that a transition reached
    :param start_state: the row that the environment is in now
    :param reward: what the transition was rewarded with
    :param n_states: the rows of the table
    :return: what forbids learning from the transition, or ``SOUND``
    """
    if not (0 <= next_state < n_states and 0 <= start_state < n_states):
        return STATE_OUT_OF_RANGE
    return SOUND if np.isfinite(reward) else REWARD_NOT_FINITE


def check_nothing(next_state, start_state, reward, n_states):
    """
    For dynamics whose rewards are finite and rows in range by construction, which saves one step in twenty.

    :return: ``SOUND``
    """
    return SOUND
