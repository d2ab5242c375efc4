"""
Random decision processes with every algorithm and every step size: both paths agree in every bit, no table holds NaN, μ stays
within its bounds, a training that is saved and resumed ends as it would have, and Q-learning is that of a plain learner.

``FUZZ_CASES=5000 python -m pytest tests/test_random_mdps.py`` tries more cases than the suite does.
"""

import math
import os

import numpy as np
import pytest
from gymnasium import spaces
from helpers.algorithms import algorithms
from helpers.environments import MarkovEnv, SampledEnv, Step
from helpers.plain_learner import PaperRate, PlainLearner, learn_plainly
from helpers.random_mdps import STEP_SIZE_NAMES, Case, make_case, pairs_to_try
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sb3_adaptive_q import METHODS, STEP_SIZES, EpisodeSeriesCallback, TabularQ
from sb3_adaptive_q.behaviour import WIDE
from sb3_adaptive_q.rollouts import step_rollout
from sb3_adaptive_q.vec_env import compiled_vec_env

N_CASES = int(os.environ.get("FUZZ_CASES", "200"))
#: The suite's cases try every step size and every algorithm, more of them each with each
PAIRS = pairs_to_try(algorithms(), all_pairs=N_CASES > 200)
#: Cases of one test, so that a failure is told soon, and a case still costs little
BATCH = 10


def learn(model, steps, **how):
    """Train, and tell what is left behind, in bits."""
    series = EpisodeSeriesCallback()
    model.learn(steps, callback=series, log_interval=None, **how)
    arrays = {name: buffer.numpy().tobytes() for name, buffer in model.policy.state_dict().items()}
    arrays |= {f"working {name}": array.tobytes() for name, array in model._working.items()}
    episodes = np.stack([series.returns, series.lengths, series.rates, series.epsilons]).tobytes()
    return arrays, model.training.as_data(), episodes


def check_bounds(model, step_size):
    """The step sizes that were used lie in the bounds of Eq. 11 or of the step size, and the table is finite."""
    state = model.training.record[0]
    assert np.isfinite(model.q_table).all()
    lower, upper = 0.0, 1.0
    if isinstance(step_size, str):
        lower, upper = STEP_SIZES[step_size].lower, STEP_SIZES[step_size].upper
    elif step_size in (5, 6, 7, 8):
        lower, upper = 0.001, 0.01
    elif step_size is not None:
        lower, upper = 0.01, 0.01 + 0.04
    assert lower <= state["mu_min"] <= state["mu_max"] <= upper
    assert 0.0 <= state["mu"] <= 1.0


def check_case(number, folder, patch):
    """In most cases Python runs the ordinary path: machine code of its own takes as long to make as many cases to run."""
    patch.setattr(step_rollout, "is_disabled", lambda: number % 5 > 0)
    case = make_case(number, PAIRS)
    steps = case.steps * case.n_envs
    ordinary = case.make_model(compiled=False)
    one = learn(ordinary, steps)
    other = learn(case.make_model(compiled=True, callback_interval=[None, 1, 7][number % 3]), steps)
    assert one == other, case
    check_bounds(ordinary, case.step_size)

    compiled, part = number % 2 == 1, case.n_envs * (case.steps // 3)
    halves = case.make_model(compiled)
    first = learn(halves, part)
    halves.save(folder / "model")
    resumed = case.kind.resume(folder / "model", case.make_vec_env(compiled))
    assert first[1]["num_timesteps"] == resumed.num_timesteps
    assert learn(halves, part, reset_num_timesteps=False) == learn(resumed, part, reset_num_timesteps=False), case

    if case.kind is TabularQ:
        plain = learn_plainly(case)
        assert plain.table.tobytes() == ordinary.q_table.tobytes(), case
        assert (plain.mu, plain.counter, plain.n_episodes) == (
            ordinary.mu, one[1]["counter"], ordinary._episode_num
        ), case  # fmt: skip
        assert np.array(plain.returns).tobytes() == one[2][: 8 * len(plain.returns)], case


@pytest.fixture
def no_comparison(monkeypatch):
    """CompiledVecEnv's own comparison takes most of the time, and what it could find is found here."""
    monkeypatch.setattr(compiled_vec_env, "compare_with_environment", lambda compiled: None)


@pytest.mark.usefixtures("no_comparison")
@pytest.mark.parametrize("batch", range(math.ceil(N_CASES / BATCH)))
def test_random_processes(batch, tmp_path, monkeypatch):
    for number in range(batch * BATCH, min((batch + 1) * BATCH, N_CASES)):
        check_case(number, tmp_path, monkeypatch)


def test_the_cases_go_through_everything():
    """All algorithms and all step sizes in the suite; in 5 000 cases each with each, on one and on several environments."""
    pairs, all_pairs = (pairs_to_try(algorithms(), each) for each in (False, True))
    assert {kind for kind, _ in pairs} == set(algorithms()) and {name for _, name in pairs} == set(STEP_SIZE_NAMES)
    assert len(STEP_SIZE_NAMES) == 1 + len(METHODS) + len(STEP_SIZES) and len(pairs) <= 200
    assert {(case.kind, case.step_size) for case in (make_case(number, pairs) for number in range(200))} == set(pairs)
    cases = [make_case(number, all_pairs) for number in range(5000)]
    assert len({(case.kind, case.step_size, case.n_envs > 1) for case in cases}) == 2 * len(all_pairs)


@pytest.mark.parametrize("n_envs", [1, 2])
@pytest.mark.parametrize("exploration", ["epsilon_greedy", "boltzmann"])
def test_many_actions(n_envs, exploration):
    """As machine code on both paths, and as Python."""
    arguments = {"exploration": exploration, "exploration_initial_eps": 0.5, "exploration_final_eps": 0.1}
    case = Case(TabularQ, 7, 3, n_envs, 20, 200, arguments, wide=True)
    assert case.make_envs()[0].action_space.n >= WIDE
    results = [learn(case.make_model(compiled), 200 * n_envs) for compiled in (True, False)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(step_rollout, "is_disabled", lambda: True)
        results.append(learn(case.make_model(compiled=False), 200 * n_envs))
    assert results[0] == results[1] == results[2]


def test_the_plain_learner_by_hand():
    """One state, one action, the reward 1, step size and γ 1/2: Q = 1/2, 7/8, 37/32."""
    arguments = {"gamma": 0.5, "exploration_initial_eps": 0.0, "exploration_final_eps": 0.0, "exploration_fraction": 1.0}
    for steps, expected in ((1, 1 / 2), (2, 7 / 8), (3, 37 / 32)):
        env = MarkovEnv([[Step(1.0, 0)]])
        learner = PlainLearner([env], PaperRate(None, 0.5), 0, np.zeros((1, 1)), {**arguments, "total_episodes": None})
        assert learner.learn(steps).table == expected


SPACES = st.one_of(
    st.builds(spaces.Discrete, st.integers(1, 50), start=st.integers(-5, 5)),
    st.builds(spaces.MultiDiscrete, st.lists(st.integers(1, 4), min_size=1, max_size=4)),
    st.builds(spaces.MultiBinary, st.integers(1, 5)),
)
UNIT = st.floats(0.0, 1.0)
ARGUMENTS = st.fixed_dictionaries(
    {"gamma": UNIT, "learning_rate": UNIT, "exploration_initial_eps": UNIT, "exploration_final_eps": UNIT},
    optional={
        "method": st.sampled_from(STEP_SIZE_NAMES),
        "exploration_fraction": UNIT,
        "ties": st.sampled_from(["first", "random"]),
        "initial_q": st.floats(-1e12, 1e12),
        "total_episodes": st.integers(1, 5),
        "callback_interval": st.integers(1, 100),
        "stats_window_size": st.integers(1, 100),
        "tensorboard_log": st.none(),
        "seed": st.none() | st.integers(0, 2**32 - 1),
        "verbose": st.just(0),
    },
)


@settings(max_examples=max(N_CASES // 5, 10), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(space=SPACES, n_actions=st.integers(1, 4), start=st.integers(-3, 3), arguments=ARGUMENTS)
def test_arguments_and_spaces_come_back(tmp_path, space, n_actions, start, arguments):
    """Whatever they are: a model that is saved and loaded is the same, and learns."""
    env = SampledEnv(space, spaces.Discrete(n_actions, start=start))
    model = TabularQ("MlpPolicy", env, **arguments)
    model.q_table[:] = np.random.default_rng(0).normal(size=model.q_table.shape)
    model.save(tmp_path / "model")
    loaded = TabularQ.load(tmp_path / "model", env=SampledEnv(space, spaces.Discrete(n_actions, start=start)))
    kept = {name: value for name, value in arguments.items() if name not in ("stats_window_size", "tensorboard_log")}
    assert {name: getattr(loaded, name) for name in kept} == kept
    assert (loaded.observation_space, loaded.action_space) == (space, env.action_space)
    assert loaded.q_table.tobytes() == model.q_table.tobytes()
    assert loaded.training.as_data() == model.training.as_data()
    assert loaded._method is None or loaded._method.data == model._method.data
