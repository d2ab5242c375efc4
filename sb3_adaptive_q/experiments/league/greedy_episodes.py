"""What the greedy policy of a table returns, by playing it: for environments without a transition table."""

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium.utils import seeding
from gymnasium.wrappers import TimeLimit
from stable_baselines3.common.env_util import make_vec_env

from sb3_adaptive_q import CompiledVecEnv, EpisodeSeriesCallback, TabularQ
from sb3_adaptive_q.compiled.jit import machine_code
from sb3_adaptive_q.experiments.environments import make_env, reused_vec_env
from sb3_adaptive_q.experiments.learners import silent_logger
from sb3_adaptive_q.random_numbers import read_pcg64

#: Episodes of a greedy policy, and the seed that they always have
EPISODES, SEED = 20, 20_000
#: The limit of steps of these episodes, if the environment has no TimeLimit. A greedy policy may walk against a wall for ever
EPISODE_LIMIT = 1000

Play = Callable[[np.ndarray], np.ndarray]

_of_thread = threading.local()


def player(environment: str, arguments: dict[str, Any]) -> Play:
    """
    :param environment: the name of an environment
    :param arguments: for it
    :return: a function from a table to the returns of ``EPISODES`` episodes of its greedy policy, which start alike each time,
        and end after ``EPISODE_LIMIT`` steps where the environment has no TimeLimit; one for each thread, with an environment
        of its own
    """
    made: dict[str, Play] = _of_thread.__dict__
    key = str((environment, sorted(arguments.items())))
    if key not in made:
        env = reused_vec_env(environment, purpose="rollouts", **arguments)
        if not env.env_is_wrapped(TimeLimit)[0]:
            kind: Any = type(env)
            env = make_vec_env(lambda: TimeLimit(make_env(environment, **arguments), EPISODE_LIMIT), vec_env_cls=kind)
        if isinstance(env, CompiledVecEnv) and env.compile()[0].dynamics.draws_from_words:
            made[key] = _compiled_player(env)
        else:
            made[key] = _ordinary_player(env)
    return made[key]


def _ordinary_player(env: Any) -> Play:
    """A model that plays greedily and learns nothing."""
    still: dict[str, Any] = {"learning_rate": 0.0, "exploration_initial_eps": 0.0, "exploration_final_eps": 0.0}
    model = TabularQ("MlpPolicy", env, total_episodes=EPISODES, ties="first", **still)
    model.set_logger(silent_logger())

    def play(table: np.ndarray) -> np.ndarray:
        series = EpisodeSeriesCallback()
        model.q_table[:] = table
        model.set_random_seed(SEED)
        model.learn(2**60, callback=series, log_interval=None)
        return series.returns

    return play


def _compiled_player(env: CompiledVecEnv) -> Play:
    """The same as one call of machine code, in a fraction of the time: it is done at every checkpoint of every run."""
    env.reset()  # a state to begin with; the episodes start from others
    compiled = env.compile()[0]
    dynamics, limit = compiled.dynamics, compiled.max_episode_steps
    first_words = np.zeros(4, np.uint64)
    read_pcg64(seeding.np_random(SEED)[0], first_words)
    place = dynamics.empty_places(1)
    place[0] = dynamics.read_state()
    actions = np.zeros(env.observation_space.n, np.int64)  # type: ignore[attr-defined]
    returns = np.zeros(EPISODES)
    arguments = (actions, first_words.copy(), place, tuple(dynamics.parameters), limit, returns)
    function = machine_code(_make_greedy_episodes(*dynamics.loop_functions()), arguments)

    def play(table: np.ndarray) -> np.ndarray:
        returns = np.zeros(EPISODES)
        function(table.argmax(axis=1), first_words.copy(), place.copy(), tuple(dynamics.parameters), limit, returns)
        return returns

    return play


def _make_greedy_episodes(reset, step, index, load_state, store_state, name_parameters, check):
    """
    :param reset: the environment's, as are ``step`` and ``index``; see :class:`sb3_adaptive_q.vec_env.Dynamics`
    :param step: see there
    :param index: see there
    :param load_state: reads the environment's state from an array
    :param store_state: unused
    :param name_parameters: makes the dynamics' named tuple
    :param check: unused
    :return: a function that plays an episode for each entry of ``returns``, which it fills
    """

    def greedy_episodes(actions, words, places, parameters, limit, returns):
        named = name_parameters(*parameters)
        place = load_state(places, 0)
        for i in range(len(returns)):
            place = reset(named, place, words)
            episode_return, length, terminated = 0.0, 0, False
            while not terminated and length < limit:
                place, reward, terminated = step(named, place, actions[index(named, place)], words)
                episode_return += reward
                length += 1
            returns[i] = episode_return

    return greedy_episodes
