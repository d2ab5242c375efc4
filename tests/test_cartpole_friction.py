"""CartPoleFrictionEnv against Eq. 12 as printed, gymnasium's own Cart Pole, and both env checkers."""

import math
import subprocess
import sys
from typing import Any

import gymnasium as gym
import numba
import numpy as np
import pytest
from gymnasium.envs.classic_control.cartpole import CartPoleEnv
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env as check_gymnasium_env
from hypothesis import example, given
from hypothesis import strategies as st
from stable_baselines3.common.env_checker import check_env as check_sb3_env

from sb3_adaptive_q.envs import CartPoleFrictionEnv, register_envs
from sb3_adaptive_q.envs.cartpole_friction import friction_dynamics, is_within_limits
from wrappers import DiscretizeObservation

PARAMETERS = CartPoleFrictionEnv().parameters


def equation_12(x: float, v: float, theta: float, omega: float, force: float, mu_c: float, mu_p: float) -> list[float]:
    """One Euler step of Eq. 12, term by term as the paper prints it, with the values of its Table 2."""
    g, m_c, m, length = 9.8, 1.0, 0.1, 0.5
    total = m + m_c
    bracket = (-force - m * length * omega**2 * math.sin(theta) + mu_c * np.sign(v)) / total
    denominator = length * (4 / 3 - m * math.cos(theta) ** 2 / total)
    alpha = math.cos(theta) * bracket / denominator + (g * math.sin(theta) - mu_p * omega / (m * length)) / denominator
    a = (force + m * length * (omega**2 * math.sin(theta) - alpha * math.cos(theta))) / total - mu_c * np.sign(v) / total
    return [x + 0.02 * v, v + 0.02 * a, theta + 0.02 * omega, omega + 0.02 * alpha]


states = st.tuples(*(st.floats(-limit, limit) for limit in (2.5, 5.0, 0.3, 5.0)))


# Eq. 12


@given(
    state=states,
    action=st.integers(0, 1),
    mu_c=st.sampled_from([0.0, 0.0005, 0.3]),
    mu_p=st.sampled_from([0.0, 0.000002, 0.01]),
)
@example(state=(0.0, 0.0, 0.0, 0.0), action=1, mu_c=0.3, mu_p=0.01)
def test_step_is_equation_12(state: tuple[float, ...], action: int, mu_c: float, mu_p: float) -> None:
    env = CartPoleFrictionEnv(cart_friction=mu_c, pole_friction=mu_p)
    env.reset(seed=0)
    env.state = np.array(state)
    observation, *_ = env.step(action)
    expected = equation_12(*state, 10.0 if action == 1 else -10.0, mu_c, mu_p)
    np.testing.assert_allclose(env.state, expected, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(observation, env.state.astype(np.float32))


def test_one_step_worked_by_hand() -> None:
    # At rest in everything but v = 1, with mu_c = 1.1: the brackets are (-10 + 1.1)/1.1 = -89/11, and with cos 0 = 1
    # the denominator is 0.5 (4/3 - 1/11) = 41/66, so alpha = -(89/11)(66/41) = -534/41 and
    # a = (10 - 0.05 alpha - 1.1)/1.1 = (8.9 + 26.7/41)/1.1 = 391.6/45.1.
    state = friction_dynamics(0.0, 1.0, 0.0, 0.0, 10.0, PARAMETERS._replace(cart_friction=1.1))
    assert state == pytest.approx((0.02, 1 + 0.02 * 391.6 / 45.1, 0.0, -0.02 * 534 / 41), abs=1e-14)
    # Only the pole turns, theta_dot = 1, no force: alpha = -mu_p / 0.05 / (41/66) = -mu_p * 1320/41.
    state = friction_dynamics(0.0, 0.0, 0.0, 1.0, 0.0, PARAMETERS._replace(pole_friction=0.41))
    assert state == pytest.approx((0.0, 0.02 * 0.05 * 13.2 / 1.1, 0.02, 1 - 0.02 * 13.2), abs=1e-14)


def test_default_constants_are_those_of_table_2() -> None:
    assert PARAMETERS == (9.8, 1.0, 0.1, 0.5, 10.0, 0.02, 0.0005, 0.000002, 2.4, 0.2095)


def test_changed_attributes_take_effect() -> None:
    env = CartPoleFrictionEnv()
    env.masscart = 2.0
    env.x_threshold = 1.0
    assert env.parameters == PARAMETERS._replace(cart_mass=2.0, x_limit=1.0)


# gymnasium's Cart Pole


def test_without_friction_the_states_are_those_of_gymnasium() -> None:
    ours, theirs = CartPoleFrictionEnv(0.0, 0.0), CartPoleEnv()
    actions = np.random.default_rng(0).integers(0, 2, 5000)
    ended = True
    for seed, action in enumerate(actions):
        if ended:
            first, _ = ours.reset(seed=seed)
            np.testing.assert_array_equal(first, theirs.reset(seed=seed)[0])
        observation, _, ended, _, _ = ours.step(action)
        theirs.step(action)
        assert ours.state is not None and theirs.state is not None
        np.testing.assert_allclose(ours.state, theirs.state, rtol=0, atol=1e-12)
        assert observation.dtype == np.float32


@pytest.mark.parametrize("name, size", [("cart_friction", 0.0005), ("pole_friction", 0.000002)])
def test_each_friction_alone_slows_its_part(name: str, size: float) -> None:
    smooth = PARAMETERS._replace(cart_friction=0.0, pole_friction=0.0)
    rough = smooth._replace(**{name: size})
    part = 1 if name == "cart_friction" else 3
    for direction in (1.0, -1.0):
        state = (0.0, direction, 0.0, direction)
        with_friction = friction_dynamics(*state, 0.0, rough)[part]
        assert direction * with_friction < direction * friction_dynamics(*state, 0.0, smooth)[part]


def test_start_is_that_of_gymnasium() -> None:
    starts = [CartPoleFrictionEnv().reset(seed=seed)[0] for seed in range(50)]
    np.testing.assert_array_equal(starts, [CartPoleEnv().reset(seed=seed)[0] for seed in range(50)])
    assert np.abs(starts).max() <= 0.05
    wide, _ = CartPoleFrictionEnv().reset(seed=1, options={"low": 0.1, "high": 0.2})
    assert np.all((wide >= 0.1) & (wide <= 0.2))


# Eqs. 13 and 14


@pytest.mark.parametrize(
    "x, theta, inside",
    [
        (0.0, 0.0, True),
        (2.3999, -0.2094, True),
        (2.4, 0.0, False),
        (-2.4, 0.0, False),
        (0.0, 0.2095, False),
        (0.0, -0.2095, False),
        (3.0, 0.0, False),
        (0.0, -1.0, False),
        (3.0, 1.0, False),
        # Twelve degrees, gymnasium's limit, is 0.20943951: this lies between the two.
        (0.0, 0.20945, True),
        (math.nan, 0.0, False),
        (0.0, math.nan, False),
    ],
)
def test_reward_and_end(x: float, theta: float, inside: bool) -> None:
    assert is_within_limits(x, theta, PARAMETERS) is inside
    env = CartPoleFrictionEnv()
    env.reset(seed=0)
    # Without velocity a step leaves position and angle as they are.
    env.state = np.array([x, 0.0, theta, 0.0])
    _, reward, terminated, truncated, _ = env.step(1)
    assert (reward, terminated, truncated) == ((1.0, False, False) if inside else (0.0, True, False))


def test_return_is_the_length_without_the_last_step() -> None:
    env = gym.make("CartPoleFriction-v0")
    env.reset(seed=3)
    rewards = []
    terminated = False
    while not terminated:
        _, reward, terminated, _, _ = env.step(0)
        rewards.append(reward)
    assert rewards == [1.0] * (len(rewards) - 1) + [0.0]


def test_steps_after_the_end_warn_once() -> None:
    env = CartPoleFrictionEnv()
    env.reset(seed=0)
    env.state = np.array([3.0, 0.0, 0.0, 0.0])
    env.step(1)
    with pytest.warns(UserWarning, match="after the episode had terminated") as caught:
        env.step(1)
        env.step(1)
    assert len(caught) == 1


# The compiled form


def test_compiled_functions_give_the_same_bits() -> None:
    dynamics, within = numba.njit(friction_dynamics), numba.njit(is_within_limits)
    generator = np.random.default_rng(1)
    for _ in range(2000):
        state = generator.uniform(-1, 1, 4) * (2.5, 4.0, 0.25, 4.0)
        force = float(generator.choice([-10.0, 10.0]))
        assert dynamics(*state, force, PARAMETERS) == friction_dynamics(*state.tolist(), force, PARAMETERS)
        assert within(state[0], state[2], PARAMETERS) == is_within_limits(state[0], state[2], PARAMETERS)


# Registration


def test_registered_ids_and_their_limits() -> None:
    spec = gym.spec("CartPoleFriction-v0")
    assert (spec.max_episode_steps, spec.reward_threshold) == (200, 195.0)
    assert isinstance(gym.make("CartPoleFriction-v0").unwrapped, CartPoleFrictionEnv)
    assert gym.make("CartPoleFriction-v0", cart_friction=0.1).get_wrapper_attr("parameters").cart_friction == 0.1


def test_limited_cliff_walking_ends() -> None:
    env = gym.make("CliffWalkingLimited-v1")
    env.reset(seed=0)
    # Left of the start is the wall: the greedy policy of a fresh table can push against it for ever.
    steps = [env.step(3)[2:4] for _ in range(200)]
    assert steps == [(False, False)] * 199 + [(False, True)]


@pytest.mark.filterwarnings("error")
def test_registering_twice_changes_nothing() -> None:
    before = dict(gym.registry)
    register_envs()
    assert gym.registry == before


def test_id_with_the_package_imports_it() -> None:
    program = 'import gymnasium as gym; print(gym.make("sb3_adaptive_q.envs:CartPoleFriction-v0").unwrapped.pole_friction)'
    result = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert result.stdout == "2e-06\n"


# As a gymnasium environment


def balance(observation: np.ndarray[Any, Any]) -> int:
    return int(observation[2] + 0.3 * observation[3] > 0)


def test_time_limit_of_200_steps() -> None:
    env = gym.make("CartPoleFriction-v0")
    observation, _ = env.reset(seed=0)
    for step in range(1, 201):
        observation, reward, terminated, truncated, _ = env.step(balance(observation))
        assert (reward, terminated, truncated) == (1.0, False, step == 200)


@pytest.mark.filterwarnings("error", "ignore:.*Box observation space m..imum value is -?infinity")
def test_env_checkers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = gym.make("CartPoleFriction-v0", render_mode="rgb_array").unwrapped
    # The human mode needs a display; rgb_array is checked below.
    check_gymnasium_env(env, skip_render_check=True)
    check_sb3_env(env, skip_render_check=False)


@pytest.mark.filterwarnings("error")
def test_sb3_checker_under_discretization() -> None:
    limits: list[Any] = [2.4, 4.0, 0.2095, 4.0]
    check_sb3_env(DiscretizeObservation(gym.make("CartPoleFriction-v0"), 10, [-limit for limit in limits], limits))


def test_failing_observation_lies_in_the_space() -> None:
    env = CartPoleFrictionEnv()
    np.testing.assert_allclose(env.observation_space.high, [4.8, np.inf, 0.419, np.inf], rtol=1e-7)
    for seed in range(20):
        env.reset(seed=seed)
        terminated = False
        while not terminated:
            observation, _, terminated, _, _ = env.step(seed % 2)
        assert env.observation_space.contains(observation)


def test_rendering(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = gym.make("CartPoleFriction-v0", render_mode="rgb_array")
    env.reset(seed=0)
    first = env.render()
    for _ in range(5):
        env.step(1)
    later = env.render()
    env.close()
    assert isinstance(first, np.ndarray) and isinstance(later, np.ndarray)
    assert first.shape == (400, 600, 3) and first.dtype == np.uint8
    assert (first != later).any()


# Bad input


@pytest.mark.parametrize("name", ["cart_friction", "pole_friction"])
@pytest.mark.parametrize("value", [-1e-9, math.nan, math.inf])
def test_friction_must_be_finite_and_not_negative(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=f"{name} must be a finite number of at least 0"):
        CartPoleFrictionEnv(**{name: value})


@pytest.mark.parametrize("action", [2, -1, 0.5, None, "left"])
def test_action_must_be_0_or_1(action: Any) -> None:
    env = CartPoleFrictionEnv()
    env.reset(seed=0)
    assert env.state is not None
    before = env.state.copy()
    with pytest.raises(ValueError, match=r"Expected action 0 \(push left\) or 1 \(push right\)"):
        env.step(action)
    np.testing.assert_array_equal(env.state, before)


def test_step_needs_a_reset() -> None:
    with pytest.raises(ResetNeeded, match=r"reset\(\) before step"):
        CartPoleFrictionEnv().step(0)
