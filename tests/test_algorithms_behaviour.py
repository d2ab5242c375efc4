"""How actions are chosen: probabilities, expectations, masks, what a rule sees of them, and what was exploratory."""

import math
from collections.abc import Callable
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.wrappers import TimeLimit
from hypothesis import example, given
from hypothesis import strategies as st
from scipy import stats
from sb3_contrib.common.maskable.evaluation import evaluate_policy as evaluate_with_masks
from sb3_contrib.common.wrappers import ActionMasker
from scipy.special import softmax
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.monitor import Monitor

from sb3_adaptive_q import (
    ALGORITHMS,
    SARSA,
    CompiledVecEnv,
    LearningRateCallback,
    TabularAlgorithm,
    TabularQ,
)
from sb3_adaptive_q.action_masks import make_masked
from sb3_adaptive_q.behaviour import (
    BEHAVIOURS,
    EXPLORATIONS,
    SCHEDULES,
    TIES,
    WIDE_BEHAVIOURS,
    Behaviour,
    linear,
    search,
    search_wide,
)
from sb3_adaptive_q.compiled.jit import as_python
from sb3_adaptive_q.random_numbers import uniform
from sb3_adaptive_q.rollouts import step_rollout

#: The algorithms with what differs from the defaults of their class
VARIANTS: dict[str, tuple[str, dict[str, Any]]] = {
    **{name: (name, {}) for name in ALGORITHMS},
    "double_expected_sarsa": ("double_q", {"target": "expected"}),
    "true_online": ("sarsa_lambda", {"true_online": True}),
    "naive": ("q_lambda", {"variant": "naive"}),
    "peng": ("q_lambda", {"variant": "peng"}),
    **{f"n_step_{target}": ("n_step", {"target": target}) for target in ("expected", "q", "tree_backup")},
}
TABLE = np.array([[1.0, 3.0, 3.0, -2.0], [0.0, 0.0, 0.0, 0.0], [0.5, 0.25, 2.0, 1.0]])
VALUES = np.array([[4.0, 1.0, 2.0, 3.0], [1.0, 2.0, 3.0, 5.0], [1.0, 2.0, 4.0, 8.0]])
MASKS = {"all": np.ones((3, 4), bool), "some": np.array([[1, 0, 1, 1], [0, 1, 1, 0], [0, 0, 0, 1]], bool)}


def probabilities(name: tuple[str, str], values: np.ndarray, rate: float) -> np.ndarray:
    """What a behaviour policy does in a state with these action values."""
    exploration, ties = name
    if exploration == "boltzmann":
        return softmax(values / rate)
    best = values == values.max()
    if ties == "first":
        best = np.arange(len(values)) == values.argmax()
    return rate / len(values) + (1.0 - rate) * best / best.sum()


@pytest.mark.parametrize("mask", MASKS)
@pytest.mark.parametrize("name", BEHAVIOURS, ids="-".join)
@pytest.mark.parametrize("state", range(3))
@pytest.mark.parametrize("behaviours", [BEHAVIOURS, WIDE_BEHAVIOURS], ids=["narrow", "wide"])
class TestPolicies:
    """The policies for many actions work with few actions too: with masks there may be one."""

    rate = 0.4

    def tables(self, mask: str) -> tuple[np.ndarray, ...]:
        return TABLE, np.zeros((2, 1, 4)), MASKS[mask]

    def expected(self, name: tuple[str, str], mask: str, state: int) -> np.ndarray:
        allowed = MASKS[mask][state]
        chances = np.zeros(4)
        chances[allowed] = probabilities(name, TABLE[state][allowed], self.rate)
        return chances

    def test_expectation(self, behaviours: dict[Any, Behaviour], name: tuple[str, str], mask: str, state: int) -> None:
        """Of other values, and of those that the policy looks at."""
        chances = self.expected(name, mask, state)
        policies = [make_masked(behaviours[name])] + ([behaviours[name]] if mask == "all" else [])
        for policy in policies:
            for values in (VALUES, TABLE):
                found = policy.expect(self.tables(mask), values, state, self.rate)
                np.testing.assert_allclose(found, chances @ values[state], rtol=1e-14)

    def test_choice(self, behaviours: dict[Any, Behaviour], name: tuple[str, str], mask: str, state: int) -> None:
        """The seed is fixed; of other seeds, one in 10 000 would fail."""
        chances, draws, n_draws = self.expected(name, mask, state), np.array([7], np.uint64), 3000
        choose = as_python(make_masked(behaviours[name]).choose)
        counts = np.bincount([choose(self.tables(mask), state, self.rate, draws) for _ in range(n_draws)], minlength=4)
        possible = chances > 0.0
        assert (counts[~possible] == 0).all()
        if possible.sum() > 1:
            assert stats.chisquare(counts[possible], n_draws * chances[possible]).pvalue > 1e-4

    def test_best(self, behaviours: dict[Any, Behaviour], name: tuple[str, str], mask: str, state: int) -> None:
        allowed = np.where(MASKS[mask][state], VALUES[state], -np.inf)
        action, value = make_masked(behaviours[name]).best(self.tables(mask), VALUES, state)
        assert (action, value) == (allowed.argmax(), allowed.max())


VALUE = st.sampled_from([-1.5, -0.0, 0.0, 0.25, 3.0, np.inf, -np.inf]) | st.floats(-1.0, 1.0)


@pytest.mark.parametrize("find", [search, search_wide])
@given(st.lists(VALUE, min_size=4, max_size=4) | st.lists(VALUE, min_size=1, max_size=70))
def test_the_best_actions(find: Callable[..., tuple[int, float, int]], values: list[float]) -> None:
    """As NumPy finds it, from one action to many; four are looked at in a way of their own."""
    row = np.array(values)
    action, value, n_best = find(np.stack([row - 9.0, row, row + 9.0]), 1)
    assert (action, value, n_best) == (row.argmax(), row.max(), np.count_nonzero(row == row.max()))


def test_no_action_is_out_of_range_where_all_values_are_nan() -> None:
    action, value, n_best = search_wide(np.full((1, 30), np.nan), 0)
    assert (action, n_best) == (0, 1) and np.isnan(value)


def in_python(patch: pytest.MonkeyPatch) -> None:
    """Run updates as Python, so that a rule can append to a list and nothing has to be compiled."""
    patch.setattr(step_rollout, "is_disabled", lambda: True)


class Recorder(BaseCallback):
    """What was there before every update."""

    def __init__(self) -> None:
        super().__init__()
        self.tables: list[np.ndarray] = []
        self.actions: list[int] = []
        self.dones: list[bool] = []
        self.terminated: list[bool] = []
        self.states: list[int] = []
        self.reached: list[int] = []
        self.exploratory: list[bool] = []
        self.rewards: list[float] = []

    def _on_step(self) -> bool:
        model: Any = self.model
        double = model.n_tables == 2
        self.tables.append((model.q_tables if double else model.q_table).copy())
        (action,), (done,), (info,) = self.locals["actions"], self.locals["dones"], self.locals["infos"]
        self.actions.append(int(action))
        self.dones.append(bool(done))
        self.terminated.append(bool(done) and not info["TimeLimit.truncated"])
        self.states.append(int(model._last_obs[0]))
        self.reached.append(int(info["terminal_observation"] if done else self.locals["new_obs"][0]))
        self.exploratory.append(bool(model.was_exploratory()[0]))
        self.rewards.append(float(self.locals["rewards"][0]))
        return True


def learn_and_record(name: str, callbacks: list[BaseCallback], n_steps: int = 300, **arguments: Any) -> TabularAlgorithm:
    """Learn on a lake whose episodes are cut after 12 steps; the recorder is the first of the callbacks."""
    key, own = VARIANTS[name]
    env = make_vec_env("FrozenLake-v1", 1, env_kwargs={"max_episode_steps": 12}, seed=1)
    arguments = {"gamma": 0.9, "exploration_initial_eps": 0.5, "exploration_final_eps": 0.5, "seed": 1, **own, **arguments}
    start = np.random.default_rng(0).random((16, 4))
    model = ALGORITHMS[key]("MlpPolicy", env, learning_rate=0.5, initial_q=start, **arguments)
    return model.learn(n_steps, callback=callbacks, log_interval=None)


#: The ``next_action`` with which a rule sees the very value that is inside the one-step target
BOOTSTRAPS = {
    **dict.fromkeys(("sarsa", "sarsa_lambda", "true_online", "n_step"), "next"),
    **dict.fromkeys(("tabular_q", "q_lambda", "naive", "peng", "n_step_q", "n_step_tree_backup"), "max"),
}


def check_update(name: str, next_action: str, record: Recorder, place: int, step: Any) -> None:
    """Compare what a rule sees besides the values with what was recorded."""
    assert (step.count, step.progress, step.gamma, step.size) == (0.0, (place + 1) / 300, 0.9, 0.5)
    moved = place
    if name.startswith("n_step") and place >= 3 and not any(record.dones[place - 3 : place + 1]):
        moved = place - 3  # the oldest of four; at an episode's end all that are left, this one last
    assert (step.row, step.column) == (record.states[moved], record.actions[moved])
    if record.terminated[place] or (BOOTSTRAPS.get(name) == next_action and not record.dones[place]):
        assert step.td_error == record.rewards[place] + 0.9 * step.next_value - step.value


@pytest.mark.parametrize("next_action", ["same", "next", "max"])
@pytest.mark.parametrize("name", VARIANTS)
def test_what_a_rule_sees(name: str, next_action: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Values of the table before the update, of the action that ``next_action`` names; of two tables, the updated one."""
    seen: list[Any] = []

    class Watching(LearningRateCallback):
        @staticmethod
        def rule(mu: float, step: Any) -> float:
            seen.append(step)
            return 0.5

    in_python(monkeypatch)
    record, watching = Recorder(), Watching(mu_0=0.5, next_action=next_action)
    model = learn_and_record(name, [record, watching])
    after = [*record.tables[1:], model.policy.q_tables.numpy() if model.n_tables == 2 else model.q_table]
    assert len(seen) == len(record.tables) == 300
    n_checked = 0
    for place, step in enumerate(seen):
        before = record.tables[place]
        if model.n_tables == 2:
            changed = [coin for coin in range(2) if (before[coin] != after[place][coin]).any()]
            if len(changed) != 1:
                continue
            before = before[changed[0]]
        state, reached, action = record.states[place], record.reached[place], record.actions[place]
        assert (step.state, step.action, step.value) == (state, action, before[state, action])
        check_update(name, next_action, record, place, step)
        if record.terminated[place]:
            assert step.next_value == 0.0
        elif next_action == "max":
            assert step.next_value == before[reached].max()
        elif next_action == "same":
            assert step.next_value == before[reached, action]
        elif record.dones[place]:  # the action that would have been taken there is not known
            assert step.next_value in before[reached]
        elif place + 1 < len(seen):
            assert step.next_value == before[reached, record.actions[place + 1]]
        n_checked += 1
    assert n_checked > 250


def bootstrapped(name: str, before: np.ndarray, other: np.ndarray, reached: int, next_action: int | None) -> float | None:
    """
    :param name: a key of ``VARIANTS``
    :param before: the table that is updated, before the update
    :param other: the other table of two, else the same
    :param reached: s', which is not terminal
    :param next_action: the action that is taken there, where that is known
    :return: the value of s' in the one-step target, ``None`` where it needs an action that is not known
    """
    greedy_value = other[reached, before[reached].argmax()]
    if name in ("sarsa", "sarsa_lambda", "true_online", "n_step"):
        return None if next_action is None else before[reached, next_action]
    if "expected" in name:
        looked_at = (before + other) / 2
        return probabilities(("epsilon_greedy", "first"), looked_at[reached], 0.5) @ other[reached]
    return greedy_value


@pytest.mark.parametrize("name", VARIANTS)
def test_what_a_step_size_sees(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """
    The value inside the target, the one-step error, how often the pair was updated, and what it gave the last time. The rule
    then sees the same update, with its step size.
    """
    seen: list[tuple[float, Any, float]] = []
    after_update: list[Any] = []

    class Watching(LearningRateCallback):
        memory: ClassVar = {"last": 0.25}
        counts: ClassVar = True

        @staticmethod
        def step_size(mu: float, step: Any, last: np.ndarray) -> float:
            seen.append((mu, step, float(last[step.row, step.column])))
            last[step.row, step.column] = 0.5 / step.count
            return 0.5 / step.count

        @staticmethod
        def rule(mu: float, step: Any) -> float:
            after_update.append(step)
            return step.size

    in_python(monkeypatch)
    record = Recorder()
    one_step = {"n": 1} if name.startswith("n_step") else {}
    model = learn_and_record(name, [record, Watching(mu_0=0.125)], ties="first", **one_step)
    after = [*record.tables[1:], model.policy.q_tables.numpy() if model.n_tables == 2 else model.q_table]
    counts = np.zeros((2, 16, 4))
    n_checked, size = 0, 0.125
    for place, (mu, step, last) in enumerate(seen):
        before, coin = record.tables[place], 0
        if model.n_tables == 2:
            changed = [number for number in range(2) if (before[number] != after[place][number]).any()]
            coin = changed[0] if len(changed) == 1 else int(step.value == before[1, step.state, step.action])
            before, other = before[coin], before[1 - coin]
        else:
            other = before
        state, reached, action = record.states[place], record.reached[place], record.actions[place]
        counts[coin, state, action] += 1.0
        assert step[:7] == (state, action, state, action, counts[coin, state, action], before[state, action], step.next_value)
        assert step[8:] == ((place + 1) / 300, 0.9, 0.0)
        assert (mu, last) == (size, 0.25 if step.count == 1.0 else 0.5 / (step.count - 1.0))
        assert step.td_error == record.rewards[place] + 0.9 * step.next_value - step.value
        size = 0.5 / step.count
        assert after_update[place] == step._replace(next_value=after_update[place].next_value, size=size)
        next_action = None if record.dones[place] or place == 299 else record.actions[place + 1]
        expected = 0.0 if record.terminated[place] else bootstrapped(name, before, other, reached, next_action)
        if expected is not None:
            assert step.next_value == pytest.approx(expected, rel=1e-14)
            n_checked += 1
    assert len(seen) == 300 and n_checked > 250


@pytest.mark.parametrize("name", ["tabular_q", "sarsa", "sarsa_lambda", "q_lambda", "n_step", "peng"])
def test_what_was_exploratory(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the table that the action was chosen from: after the update before, or before it where the algorithm chooses so."""
    in_python(monkeypatch)
    record = Recorder()
    model = learn_and_record(name, [record])
    for place in range(1, 300):
        chosen_before = model.chooses_before_update and not record.dones[place - 1]
        row = record.tables[place - 1 if chosen_before else place][record.states[place]]
        assert record.exploratory[place] == (row[record.actions[place]] < row.max())
    # Half of the actions are drawn at random, of which a quarter are greedy; five standard errors
    assert np.mean(record.exploratory) == pytest.approx(0.375, abs=5 * (0.375 * 0.625 / 300) ** 0.5)


class TestExploratory:
    def test_with_several_environments(self) -> None:
        shapes = []

        def look(found: dict[str, Any], _: dict[str, Any]) -> bool:
            shapes.append(found["self"].was_exploratory().shape)
            return True

        env = make_vec_env("FrozenLake-v1", 3)
        TabularQ("MlpPolicy", env, exploration_initial_eps=0.0, exploration_final_eps=0.0).learn(9, callback=look)
        assert shapes == [(3,)] * 3

    def test_it_is_unknown_before_learning_and_on_a_compiled_environment(self) -> None:
        with pytest.raises(RuntimeError, match="ordinary environment"):
            TabularQ("MlpPolicy", "FrozenLake-v1").was_exploratory()
        model = TabularQ("MlpPolicy", make_vec_env("FrozenLake-v1", vec_env_cls=CompiledVecEnv), seed=0)
        model.learn(10, log_interval=None)
        with pytest.raises(RuntimeError, match="LeanVecEnv"):
            model.was_exploratory()


class MaskedEnv(gym.Env):
    """
    A random walk over seven states, in each of which one action of three is forbidden; taking it is an error.

    :param mask: makes the mask of a state
    """

    def __init__(self, mask: Callable[[int], Any] = lambda state: np.arange(3) != state % 3) -> None:
        self.observation_space, self.action_space = spaces.Discrete(8), spaces.Discrete(3)
        self.mask = mask

    def info(self) -> dict[str, Any]:
        mask = self.mask(self.state)
        return {} if mask is None else {"action_mask": np.asarray(mask)}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[int, dict[str, Any]]:
        super().reset(seed=seed)
        self.state = int(self.np_random.integers(7))
        return self.state, self.info()

    def step(self, action: Any) -> tuple[int, float, bool, bool, dict[str, Any]]:
        assert self.info()["action_mask"][action], f"the forbidden action {action} in state {self.state}"
        self.state = int(self.np_random.integers(8))
        terminated = self.state == 7
        return self.state, 1.0, terminated, False, {} if terminated else self.info()


FORBIDDEN = 1e6
START = np.where(np.arange(3) == np.arange(8)[:, None] % 3, FORBIDDEN, 0.0)


@pytest.mark.parametrize("exploration", EXPLORATIONS)
@pytest.mark.parametrize("name", VARIANTS)
def test_masks_in_behaviour_and_targets(name: str, exploration: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Forbidden actions have large values here, which would show in the others if they were taken or looked at."""
    in_python(monkeypatch)
    (key, own), rate = VARIANTS[name], {"epsilon_greedy": 0.5, "boltzmann": 5.0}[exploration]
    model = ALGORITHMS[key](
        "MlpPolicy", make_masked_env(n_envs=2), learning_rate=0.5, gamma=0.9, initial_q=START, use_masking=True, seed=0,
        exploration=exploration, exploration_initial_eps=rate, exploration_final_eps=rate, **own,
    )  # fmt: skip
    model.learn(400, log_interval=None)
    allowed = START == 0.0
    assert (model.q_table[~allowed] == FORBIDDEN).all()
    assert (model.q_table[:7][allowed[:7]] > 0.0).all() and (model.q_table[allowed] < 1000.0).all()


def make_masked_env(n_envs: int = 1, **arguments: Any) -> Any:
    return make_vec_env(lambda: TimeLimit(MaskedEnv(**arguments), 10), n_envs)


class TestMasks:
    @pytest.mark.parametrize("name", ["tabular_q", "double_expected_sarsa", "n_step_tree_backup"])
    def test_a_mask_that_allows_all_changes_nothing(self, name: str) -> None:
        """Bit for bit, in machine code."""
        key, own = VARIANTS[name]
        tables = [
            ALGORITHMS[key]("MlpPolicy", make_masked_env(mask=lambda _: np.ones(3)), seed=0, use_masking=masked, **own)
            .learn(300, log_interval=None)
            .q_table
            for masked in (False, True)
        ]
        assert tables[0].tobytes() == tables[1].tobytes()

    def test_taxi(self) -> None:
        """Without the actions that change nothing and those that are illegal, which cost 10, no step costs more than 1."""
        model = SARSA("MlpPolicy", "Taxi-v4", use_masking=True, seed=0, learning_rate=0.5)
        rewards: list[float] = []
        model.learn(2000, callback=lambda found, _: rewards.append(float(found["rewards"][0])) or True, log_interval=None)
        assert set(rewards) <= {-1.0, 20.0}
        env = gym.make("Taxi-v4")
        observation, info = env.reset(seed=3)
        for _ in range(100):
            action, _ = model.predict(observation, action_masks=info["action_mask"])
            assert info["action_mask"][action] == 1
            observation, reward, terminated, truncated, info = env.step(action)
            assert reward in (-1, 20)
            if terminated or truncated:
                observation, info = env.reset()

    def test_sb3_contrib_evaluates_with_masks(self) -> None:
        """By the names of its own evaluation, which asks the environment for ``action_masks``: no step costs more than 1."""
        model = TabularQ("MlpPolicy", "Taxi-v4", seed=0)
        model.q_table[:, 5] = 1.0  # to drop a passenger, which is illegal almost everywhere and then costs 10
        env = ActionMasker(Monitor(gym.make("Taxi-v4")), lambda env: env.unwrapped.action_mask(env.unwrapped.s))
        for use_masking, low, high in ((True, -200.0, 20.0), (False, -2000.0, -1000.0)):
            returns, _ = evaluate_with_masks(model, env, 3, use_masking=use_masking, return_episode_rewards=True)  # type: ignore[arg-type]
            assert all(low <= each <= high for each in returns)  # type: ignore[union-attr]

    def test_what_was_seen_is_kept_and_saved(self, monkeypatch: pytest.MonkeyPatch, tmp_path: Any) -> None:
        """The greedy policy then needs no masks: it would take forbidden actions, whose values are those of the start."""
        in_python(monkeypatch)
        model = TabularQ("MlpPolicy", make_masked_env(), use_masking=True, initial_q=START, seed=0)
        model.learn(300, log_interval=None)
        model.save(tmp_path / "model")
        for each in (model, TabularQ.load(tmp_path / "model")):
            np.testing.assert_array_equal(each.policy.allowed.numpy()[:7], START[:7] == 0.0)
            for deterministic in (True, False):
                actions, _ = each.predict(np.arange(7), deterministic=deterministic)
                assert (START[np.arange(7), actions] == 0.0).all()
        mean, _ = evaluate_policy(model, make_masked_env(), n_eval_episodes=5)
        assert mean > 0.0

    def test_a_callback_may_stop_in_the_middle_of_an_episode(self, monkeypatch: pytest.MonkeyPatch) -> None:
        in_python(monkeypatch)
        model = TabularQ("MlpPolicy", make_masked_env(), use_masking=True, seed=0)
        model.learn(100, callback=lambda found, _: found["self"].num_timesteps < 4, log_interval=None)
        model.learn(100, reset_num_timesteps=False, log_interval=None)
        assert model.num_timesteps == 104

    @pytest.mark.parametrize(
        ("mask", "message"),
        [
            (lambda state: None, r'needs `info\["action_mask"\]` from every reset and step'),
            (lambda state: np.ones(2), r"must have the shape \(3,\), but has \(2,\)"),
            (lambda state: np.full(3, state != 5), "mask of state 5 forbids every action"),
            (lambda state: np.array([0.0, -np.inf, 0.0]), "must be 1 for an action that is allowed and 0 for others, but is"),
            (lambda state: np.array(["1", "0", "1"]), "must be 1 for an action that is allowed and 0 for others, but is"),
        ],
    )
    def test_a_bad_mask(self, mask: Callable[[int], Any], message: str, monkeypatch: pytest.MonkeyPatch) -> None:
        in_python(monkeypatch)
        model = TabularQ("MlpPolicy", make_masked_env(mask=mask), use_masking=True, seed=0)
        with pytest.raises(ValueError, match=message):
            model.learn(100)

    def test_the_compiled_path_refuses(self) -> None:
        model = TabularQ("MlpPolicy", make_vec_env("Taxi-v4", vec_env_cls=CompiledVecEnv), use_masking=True)
        with pytest.raises(ValueError, match="Compiled environments give no action masks"):
            model.learn(10)


class TestPredict:
    @pytest.fixture
    def model(self) -> TabularQ:
        model = TabularQ("MlpPolicy", make_masked_env())
        model.q_table = np.arange(24.0).reshape(8, 3) / 10
        return model

    def test_masks(self, model: TabularQ) -> None:
        for deterministic in (True, False):
            actions, _ = model.predict(np.array([0, 1]), deterministic=deterministic, action_masks=[[1, 1, 0], [1, 0, 0]])
            np.testing.assert_array_equal(actions, [1, 0])
            action, _ = model.predict(2, deterministic=deterministic, action_masks=[0, 1, 0])
            assert action == 1 and np.shape(action) == ()

    def test_bad_masks(self, model: TabularQ) -> None:
        with pytest.raises(ValueError, match=r"must have the shape \(2, 3\), but has \(3,\)"):
            model.predict(np.array([0, 1]), action_masks=[1, 1, 0])
        with pytest.raises(ValueError, match="forbids every action"):
            model.predict(0, action_masks=[0, 0, 0])
        with pytest.raises(ValueError, match=r"must have the shape \(2, 3\), but has \(6,\)"):
            model.predict(np.array([0, 1]), action_masks=[1, 1, 0, 1, 0, 0])
        with pytest.raises(ValueError, match="The action mask of `predict` must be 1 for an action that is allowed"):
            model.predict(0, action_masks=[1, np.nan, 0])

    @pytest.mark.parametrize("exploration", EXPLORATIONS)
    @pytest.mark.parametrize("mask", [[1, 1, 1], [1, 0, 1]])
    def test_it_explores_as_the_behaviour_policy(self, exploration: str, mask: list[int]) -> None:
        """The seed is fixed; of other seeds, one in 10 000 would fail."""
        model = TabularQ("MlpPolicy", make_masked_env(), exploration=exploration, seed=0)
        model.q_table = np.arange(24.0).reshape(8, 3) / 10
        model.exploration_rate = 0.3
        actions, _ = model.predict(np.full(3000, 4), action_masks=np.tile(mask, (3000, 1)))
        allowed = np.flatnonzero(mask)
        chances = probabilities((exploration, "first"), model.q_table[4][allowed], 0.3)
        counts = np.bincount(actions, minlength=3)
        assert counts[allowed].sum() == 3000
        assert stats.chisquare(counts[allowed], 3000 * chances).pvalue > 1e-4


@pytest.mark.parametrize("rate", [0.0, -1.0, float("nan"), "0.5"])
def test_a_bad_temperature(rate: Any) -> None:
    for name in ("exploration_initial_eps", "exploration_final_eps"):
        with pytest.raises(ValueError, match=f"`{name}` must be a finite number above 0, the temperature of Boltzmann"):
            TabularQ("MlpPolicy", "FrozenLake-v1", exploration="boltzmann", **{name: rate})


def test_an_unknown_behaviour() -> None:
    with pytest.raises(ValueError, match="`exploration` must be one of epsilon_greedy, boltzmann, but got 'softmax'"):
        TabularQ("MlpPolicy", "FrozenLake-v1", exploration="softmax")


def counter_that_draws(number: float) -> np.ndarray:
    """
    The agent's counter from which SplitMix64 draws a number next: its steps backwards.

    :param number: a multiple of 2^-53 in [0, 1)
    """
    word = int(number * 2**53) << 11
    for shift, factor in ((31, 0x94D049BB133111EB), (27, 0xBF58476D1CE4E5B9), (30, 1)):
        found = word
        for _ in range(64 // shift):
            found = word ^ (found >> shift)
        word = found * pow(factor, -1, 2**64) % 2**64
    return np.array([(word - 0x9E3779B97F4A7C15) % 2**64], dtype=np.uint64)


@pytest.mark.parametrize("number", [0.0, 2.0**-53, 0.25, 0.5, 1.0 - 2.0**-53])
def test_the_counter_backwards(number: float) -> None:
    with np.errstate(over="ignore"):
        assert uniform(counter_that_draws(number)) == number


@pytest.mark.parametrize("ties", TIES)
def test_exploration_at_the_edge_of_the_drawn_numbers(ties: str) -> None:
    """A number is below ε or not: with ε = 0 none is, and with ε = 1/4 the number 1/4 is not."""
    choose = as_python(BEHAVIOURS["epsilon_greedy", ties].choose)
    table = np.array([[0.0, 0.0, 1.0, 0.0]])
    for number in (0.0, 0.25):
        assert choose((table,), 0, number, counter_that_draws(number)) == 2


@pytest.mark.parametrize(("number", "action"), [(0.0, 0), (0.5 - 2.0**-53, 0), (0.5, 1), (1.0 - 2.0**-53, 1)])
def test_the_boltzmann_policy_divides_the_numbers(number: float, action: int) -> None:
    """Two equal actions have a half of the numbers each."""
    choose = as_python(BEHAVIOURS["boltzmann", "first"].choose)
    assert choose((np.array([[1.0, 1.0]]),), 0, 1.0, counter_that_draws(number)) == action


def test_rounding_leaves_the_last_action() -> None:
    """Here the weights, subtracted one after the other from the largest number times their sum, leave 0.0."""
    table = np.array([[-2.1, -0.8, -0.3]])
    choose = as_python(BEHAVIOURS["boltzmann", "first"].choose)
    assert choose((table,), 0, 1.0, counter_that_draws(1.0 - 2.0**-53)) == 2


@pytest.mark.parametrize(
    ("name", "progress", "rate"),
    [
        ("linear", 0.0, 1.0), ("linear", 0.25, 0.53125), ("linear", 0.375, 0.296875), ("linear", 0.5, 0.0625),
        ("linear", 0.9, 0.0625),
        ("exponential", 0.0, 1.0), ("exponential", 0.25, 0.25), ("exponential", 0.5, 0.0625), ("exponential", 0.9, 0.0625),
        ("constant", 0.0, 1.0), ("constant", 0.9, 1.0),
    ],
)  # fmt: skip
def test_schedules_by_hand(name: str, progress: float, rate: float) -> None:
    """From 1 to 1/16 in the first half of the training."""
    assert SCHEDULES[name](progress, 1.0, 0.0625, 0.5) == rate


def test_an_exponential_schedule_from_a_half() -> None:
    assert SCHEDULES["exponential"](0.25, 0.5, 0.125, 0.5) == 0.25


@pytest.mark.parametrize(("name", "initial", "final"), [("linear", 1.0, 0.05), ("exponential", 0.14, 0.11)])
def test_a_schedule_ends_at_the_very_number(name: str, initial: float, final: float) -> None:
    """What its formula gives there differs in the last bits."""
    assert SCHEDULES[name](0.3, initial, final, 0.3) == final


@pytest.mark.parametrize("best", range(3))
def test_the_largest_value_may_stand_anywhere(best: int) -> None:
    """It is subtracted before the exponential, which would overflow else."""
    table = np.where(np.arange(3) == best, 1000.0, 0.0)[None]
    policy = BEHAVIOURS["boltzmann", "first"]
    assert as_python(policy.choose)((table,), 0, 1.0, counter_that_draws(0.5)) == best
    assert as_python(policy.expect)((table,), np.arange(3.0)[None], 0, 1.0) == best


def test_a_small_temperature_overflows_nowhere() -> None:
    """The differences to the largest value are what is exponentiated: e^1000 is no float."""
    table = np.array([[0.0, 1000.0, 999.0]])
    assert BEHAVIOURS["boltzmann", "first"].expect((table,), table, 0, 0.1) == pytest.approx(1000.0, abs=0.001)


@given(*[st.floats(0.0, 1.0)] * 4)
@example(1.0, 0.0, 0.3, math.nextafter(0.3, 0.0))
def test_linear_exploration_stays_between_its_ends(initial: float, final: float, fraction: float, progress: float) -> None:
    """Up to rounding; but one that fell below 0 would end the training."""
    rate = linear(progress, initial, final, max(fraction, 1e-9))
    low, high = sorted((initial, final))
    assert 0.0 <= rate and low - 1e-15 <= rate <= high + 1e-15
    assert linear(0.0, initial, final, 1.0) == initial and linear(1.0, initial, final, fraction) == final
