"""LeanVecEnv beside SB3's DummyVecEnv: the same values at every step, and nothing handed out changes afterwards."""

import re
from typing import Any, ClassVar

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.envs.toy_text.frozen_lake import FrozenLakeEnv
from helpers.environments import Episode, RenumberAction, SampledEnv, ScriptedEnv, Step
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.monitor import Monitor, load_results
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecEnvWrapper, VecMonitor

from sb3_adaptive_q import CompiledVecEnv, LeanVecEnv, TabularQ
from sb3_adaptive_q.vec_env.protocol import check_is_single_env, find_fault_of_step
from wrappers import DiscretizeObservation

DICT_SPACE = spaces.Dict({"place": spaces.Box(-1.0, 1.0, (2, 3)), "number": spaces.Discrete(4), "bits": spaces.MultiBinary(3)})

ENVIRONMENTS = {
    "FrozenLake": lambda: gym.make("FrozenLake-v1"),
    "Taxi": lambda: gym.make("Taxi-v4", max_episode_steps=30),
    "CliffWalking": lambda: gym.make("CliffWalking-v1", max_episode_steps=40),
    "CartPole": lambda: gym.make("CartPole-v1"),
    "discretised CartPole": lambda: DiscretizeObservation(
        gym.make("CartPole-v1"), 10, [-2.4, -4, -0.2095, -4], [2.4, 4, 0.2095, 4]
    ),
    "Pendulum": lambda: gym.make("Pendulum-v1", max_episode_steps=50),
    "Dict": lambda: SampledEnv(DICT_SPACE, spaces.Discrete(3), time_limit=7),
    "Tuple": lambda: SampledEnv(spaces.Tuple([spaces.Discrete(3), spaces.Box(0.0, 1.0, (2,))]), spaces.Discrete(3)),
    "MultiDiscrete": lambda: SampledEnv(spaces.MultiDiscrete([3, 4]), spaces.MultiDiscrete([2, 3])),
    "MultiBinary": lambda: SampledEnv(spaces.MultiBinary([2, 2]), spaces.MultiBinary(2)),
    "small integers": lambda: SampledEnv(spaces.Discrete(5, start=2, dtype=np.int32), spaces.Discrete(2)),
    "first action 3": lambda: RenumberAction(gym.make("FrozenLake-v1"), 3),
    "images": lambda: SampledEnv(spaces.Box(0, 255, (4, 4, 1), np.uint8), spaces.Discrete(2)),
}


def make_env(name: str) -> gym.Env:
    return Monitor(ENVIRONMENTS[name]())


def assert_same(ours: Any, theirs: Any) -> None:
    """Equal in kind, dtype, shape and every bit."""
    assert type(ours) is type(theirs)
    if isinstance(theirs, dict):
        assert set(ours) == set(theirs)
        for key in theirs:
            assert_same(ours[key], theirs[key])
    elif isinstance(theirs, list | tuple):
        assert len(ours) == len(theirs)
        for our, their in zip(ours, theirs, strict=True):
            assert_same(our, their)
    elif isinstance(theirs, np.ndarray | np.generic):
        assert ours.dtype == theirs.dtype
        np.testing.assert_array_equal(ours, theirs)
    else:
        assert ours == theirs or (ours != ours and theirs != theirs)


def without_times(infos: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The infos without the wall-clock time that Monitor notes."""
    cleaned = [dict(info) for info in infos]
    for info in cleaned:
        if "episode" in info:
            info["episode"] = {key: value for key, value in info["episode"].items() if key != "t"}
    return cleaned


@pytest.fixture
def pair(request):
    """Our environment and SB3's, with the same in them."""
    name, n_envs = request.param
    environments = [cls([lambda: make_env(name) for _ in range(n_envs)]) for cls in (LeanVecEnv, DummyVecEnv)]
    yield environments
    for env in environments:
        env.close()


def step_side_by_side(ours: VecEnv, theirs: VecEnv, n_steps: int) -> None:
    """Compare all that the two return, from a seeded reset on; at least one episode must end on the way."""
    assert ours.seed(7) == theirs.seed(7)
    assert_same(ours.reset(), theirs.reset())
    assert_same(ours.reset_infos, theirs.reset_infos)
    go_on_side_by_side(ours, theirs, n_steps)


def go_on_side_by_side(ours: VecEnv, theirs: VecEnv, n_steps: int) -> None:
    """The same, from where the two are."""
    theirs.action_space.seed(0)
    n_ended = 0
    for _ in range(n_steps):
        actions = np.array([theirs.action_space.sample() for _ in range(theirs.num_envs)])
        *our_values, our_infos = ours.step(actions)
        *their_values, their_infos = theirs.step(actions)
        assert_same(our_values, their_values)
        assert_same(without_times(our_infos), without_times(their_infos))
        assert_same(ours.reset_infos, theirs.reset_infos)
        n_ended += their_values[2].sum()
    assert n_ended > 0


both = pytest.mark.parametrize(
    "pair",
    [(name, n_envs) for name in ENVIRONMENTS for n_envs in (1, 3)],
    indirect=True,
    ids=lambda pair: f"{pair[0]}-{pair[1]}",
)


class TestSideBySide:
    @both
    def test_every_step(self, pair):
        ours, theirs = pair
        assert (ours.num_envs, ours.observation_space, ours.action_space) == (
            theirs.num_envs,
            theirs.observation_space,
            theirs.action_space,
        )
        step_side_by_side(ours, theirs, 120)

    @both
    def test_seeds_make_a_repetition(self, pair):
        for env in pair:
            first, second = [(env.seed(3), env.reset())[1] for _ in range(2)]
            assert_same(first, second)

    def test_options_reach_the_environment(self):
        given = []

        class Noting(ScriptedEnv):
            def reset(self, *, seed=None, options=None):
                given.append((seed, options))
                return super().reset(seed=seed)

        env = LeanVecEnv([lambda: Noting([Episode(0, [Step(0.0, 0)])])])
        env.seed(5)
        env.set_options({"where": 1})
        env.reset()
        env.reset()
        assert given == [(5, {"where": 1}), (None, None)]


class Halved(gym.RewardWrapper):
    """A wrapper of a user."""

    def reward(self, reward):
        return 0.5 * float(reward)


class Fined(gym.wrappers.TimeLimit):
    """A user's own kind of time limit, with a fine for reaching it."""

    def step(self, action):
        observation, reward, terminated, truncated, info = super().step(action)
        return observation, float(reward) - 10.0 * truncated, terminated, truncated, info


class Doubled(Monitor):
    """A user's own kind of Monitor, which shows twice the reward."""

    def step(self, action):
        observation, reward, terminated, truncated, info = super().step(action)
        return observation, 2.0 * float(reward), terminated, truncated, info


def cart_pole(**arguments):
    return gym.make("CartPole-v1", **arguments)


def discretised(env):
    return DiscretizeObservation(env, 6, [-2.4, -4, -0.2095, -4], [2.4, 4, 0.2095, 4])


ARRANGEMENTS = {
    "nothing around it": lambda: SampledEnv(spaces.Discrete(3), spaces.Discrete(2)),
    "no checks": lambda: Monitor(cart_pole(disable_env_checker=True)),
    "no Monitor": cart_pole,
    "no limit": lambda: Monitor(gym.make("CartPole-v1").unwrapped),
    "limit outside the Monitor": lambda: gym.wrappers.TimeLimit(Monitor(cart_pole()), 9),
    "limit within a limit": lambda: Monitor(gym.wrappers.TimeLimit(cart_pole(), 9)),
    "Monitor within a Monitor": lambda: Monitor(Monitor(cart_pole())),
    "Monitor in the discretisation": lambda: discretised(Monitor(cart_pole())),
    "discretisation in the Monitor": lambda: Monitor(discretised(cart_pole())),
    "limit around the discretisation": lambda: Monitor(gym.wrappers.TimeLimit(discretised(cart_pole().unwrapped), 9)),
    "discretisation around the limit": lambda: Monitor(discretised(gym.wrappers.TimeLimit(cart_pole().unwrapped, 9))),
    "a user's wrapper outermost": lambda: Halved(Monitor(cart_pole())),
    "a user's wrapper in the Monitor": lambda: Monitor(Halved(cart_pole())),
    "a user's wrapper innermost": lambda: Monitor(gym.wrappers.TimeLimit(Halved(cart_pole().unwrapped), 9)),
    "a user's time limit": lambda: Monitor(Fined(cart_pole().unwrapped, 5)),
    "a user's Monitor": lambda: Doubled(cart_pole()),
    "gymnasium's statistics": lambda: Monitor(gym.wrappers.TransformReward(cart_pole(), lambda reward: reward - 0.25)),
    "frames skipped": lambda: Monitor(gym.wrappers.MaxAndSkipObservation(cart_pole(), 2)),
    "Monitor with keywords": lambda: Monitor(gym.make("FrozenLake-v1"), info_keywords=("prob",)),
}


class TestWrappers:
    @pytest.mark.parametrize("name", ARRANGEMENTS)
    def test_any_arrangement_of_them(self, name):
        ours, theirs = (cls([ARRANGEMENTS[name], ARRANGEMENTS[name]]) for cls in (LeanVecEnv, DummyVecEnv))
        step_side_by_side(ours, theirs, 150)
        for our, their in zip(ours.envs, theirs.envs, strict=True):
            if isinstance(their, Monitor):
                assert our.get_episode_rewards() == their.get_episode_rewards()
                assert our.get_episode_lengths() == their.get_episode_lengths()
                assert our.get_total_steps() == their.get_total_steps() == 150
                assert our.rewards == their.rewards

    def test_the_monitors_file_is_written(self, tmp_path):
        tables = []
        for cls in (LeanVecEnv, DummyVecEnv):
            folder = tmp_path / cls.__name__
            env = make_vec_env("FrozenLake-v1", n_envs=2, monitor_dir=str(folder), vec_env_cls=cls)
            env.seed(0)
            env.reset()
            for step in range(200):
                env.step(np.array([step % 4, step % 3]))
            env.close()
            tables.append(load_results(str(folder))[["r", "l", "index"]].sort_values(["index", "l"]).to_numpy())
        assert len(tables[0]) > 10
        assert sorted(map(tuple, tables[0].tolist())) == sorted(map(tuple, tables[1].tolist()))

    def test_a_step_limit_that_is_changed_afterwards(self):
        """Old scripts write into the wrapper to change it."""
        ours, theirs = (cls([lambda: Monitor(gym.make("Taxi-v4"))]) for cls in (LeanVecEnv, DummyVecEnv))
        for env in (ours, theirs):
            env.envs[0].env._max_episode_steps = 11
        step_side_by_side(ours, theirs, 40)

    def test_a_step_before_the_first_reset_is_refused(self):
        env = LeanVecEnv([lambda: gym.make("FrozenLake-v1")])
        for _ in range(2):
            with pytest.raises(gym.error.ResetNeeded):
                env.step(np.array([0]))


def replace_env(vec_env: VecEnv) -> None:
    vec_env.envs[0] = Halved(vec_env.envs[0])


def replace_all(vec_env: VecEnv) -> None:
    vec_env.envs = [Monitor(gym.make("Taxi-v4")) for _ in vec_env.envs]


def wrap_inside_monitor(vec_env: VecEnv) -> None:
    """What people do who forgot the limit."""
    vec_env.envs[0].env = gym.wrappers.TimeLimit(vec_env.envs[0].env, 4)


def replace_limit(vec_env: VecEnv) -> None:
    vec_env.envs[0].env = gym.wrappers.TimeLimit(vec_env.envs[0].env.env, 3)


def take_limit_out(vec_env: VecEnv) -> None:
    vec_env.envs[0].env = vec_env.envs[0].env.env


def wrap_innermost(vec_env: VecEnv) -> None:
    checker = vec_env.envs[0].env.env.env
    assert isinstance(checker, gym.wrappers.PassiveEnvChecker)
    checker.env = Halved(checker.env)


def another_innermost(vec_env: VecEnv) -> None:
    vec_env.envs[0].env.env.env.env = gym.make("Taxi-v4", is_rainy=True).unwrapped


def patch(env: gym.Env) -> None:
    """Put a function in the place of ``step`` that gives ten times the reward."""
    original = env.step

    def step(action):
        observation, reward, terminated, truncated, info = original(action)
        return observation, 10.0 * float(reward), terminated, truncated, info

    env.step = step  # type: ignore[method-assign]


def patch_and_unpatch(vec_env: VecEnv) -> None:
    patch(vec_env.envs[0].env)
    vec_env.step(np.zeros(vec_env.num_envs, int))
    del vec_env.envs[0].env.step


CHANGES = {
    "another environment": replace_env,
    "other environments": replace_all,
    "a wrapper inside the Monitor": wrap_inside_monitor,
    "another limit": replace_limit,
    "no limit any more": take_limit_out,
    "a wrapper innermost": wrap_innermost,
    "another innermost": another_innermost,
    "a patched environment": lambda vec_env: patch(vec_env.envs[0].unwrapped),
}
PATCHES = {
    "Monitor": lambda vec_env: patch(vec_env.envs[0]),
    "limit": lambda vec_env: patch(vec_env.envs[0].env),
    "checks": lambda vec_env: patch(vec_env.envs[0].env.env),
    "a patch and its end": patch_and_unpatch,
}


def taxis_after(n_steps: int) -> tuple[LeanVecEnv, DummyVecEnv]:
    ours, theirs = (cls([lambda: Monitor(gym.make("Taxi-v4")) for _ in range(2)]) for cls in (LeanVecEnv, DummyVecEnv))
    for env in (ours, theirs):
        env.seed(3)
        env.reset()
        for _ in range(n_steps):
            env.step(np.array([0, 1]))
    return ours, theirs


class TestChangedAfterwards:
    """What is in ``envs`` is stepped, as DummyVecEnv does it."""

    @pytest.mark.parametrize("steps_before", [0, 5])
    @pytest.mark.parametrize("name", CHANGES)
    def test_it_counts_from_the_next_step_on(self, name, steps_before):
        ours, theirs = taxis_after(steps_before)
        for vec_env in (ours, theirs):
            CHANGES[name](vec_env)
            for env in vec_env.envs:  # which may be new; a reset of the VecEnv would look at all of them again
                env.reset(seed=7)
        go_on_side_by_side(ours, theirs, 201)

    @pytest.mark.parametrize("depth", range(6))
    def test_a_wrapper_at_any_depth_counts_from_the_next_step_on(self, depth):
        def make():
            checked = gym.wrappers.OrderEnforcing(gym.make("CartPole-v1").env)  # type: ignore[attr-defined]
            return Monitor(discretised(gym.wrappers.TimeLimit(checked, 30)))

        ours, theirs = (cls([make]) for cls in (LeanVecEnv, DummyVecEnv))
        for vec_env in (ours, theirs):
            vec_env.seed(3)
            vec_env.reset()
            vec_env.step(np.array([0]))
            wrapper = vec_env.envs[0]
            for _ in range(depth):
                wrapper = wrapper.env
            wrapper.env = Halved(wrapper.env)
        go_on_side_by_side(ours, theirs, 50)

    @pytest.mark.parametrize("steps_before", [0, 200], ids=["first episode", "second episode"])
    @pytest.mark.parametrize("name", PATCHES)
    def test_the_step_of_a_wrapper_counts_from_the_start_of_an_episode(self, name, steps_before):
        ours, theirs = taxis_after(steps_before)
        for env in (ours, theirs):
            assert steps_before == 0 or env.buf_dones.all()
            PATCHES[name](env)
        go_on_side_by_side(ours, theirs, 201)

    @pytest.mark.parametrize("name", PATCHES)
    def test_the_step_of_a_wrapper_counts_from_a_reset(self, name):
        ours, theirs = taxis_after(1)
        for env in (ours, theirs):
            PATCHES[name](env)
            env.seed(3)
            env.reset()
        step_side_by_side(ours, theirs, 201)

    def test_the_step_of_a_wrapper_that_is_replaced_within_an_episode(self):
        """The environment makes as many steps as it is asked for, and the new function counts once the episode has ended."""
        env = LeanVecEnv([lambda: Monitor(gym.make("Taxi-v4", max_episode_steps=5))])
        env.seed(3)
        env.reset()
        env.step(np.array([0]))
        patch(env.envs[0].env.env)
        patch(env.envs[0])
        rewards = [env.step(np.array([0]))[1].item() for _ in range(6)]
        assert rewards == [-1.0] * 4 + [-100.0] * 2

    def test_the_step_of_another_wrapper_of_the_same_class(self):
        """The outer limit is gone round: so the inner one, of 4 steps, ends the episodes."""
        made = []
        for cls in (LeanVecEnv, DummyVecEnv):
            limits = gym.wrappers.TimeLimit(gym.wrappers.TimeLimit(gym.make("Taxi-v4").unwrapped, 4), 2)
            limits.step = limits.env.step  # type: ignore[method-assign]
            made.append(cls([lambda limits=limits: Monitor(limits)]))
        step_side_by_side(*made, 20)
        assert [made[0].step(np.array([0]))[2].item() for _ in range(4)].count(True) == 1

    def test_the_observation_of_a_discretisation(self):
        ours, theirs = (cls([lambda: Monitor(discretised(cart_pole()))]) for cls in (LeanVecEnv, DummyVecEnv))
        for env in (ours, theirs):
            env.seed(3)
            env.reset()
            env.step(np.array([0]))
            env.envs[0].env.observation = lambda observation: int(observation[0] > 0.0)
        go_on_side_by_side(ours, theirs, 50)
        assert {int(ours.step(np.array([1]))[0][0]) for _ in range(20)} <= {0, 1}

    def test_a_patch_that_is_there_from_the_start(self):
        def make():
            env = Monitor(gym.make("Taxi-v4"))
            patch(env.env)
            return env

        step_side_by_side(LeanVecEnv([make]), DummyVecEnv([make]), 201)

    def test_as_long_as_nothing_changes_the_wrappers_are_passed_by(self, monkeypatch):
        """Otherwise half of the speed would be gone, and no test would tell."""
        env = LeanVecEnv([lambda: Monitor(gym.make("Taxi-v4"))])
        env.reset()
        env.step(np.array([0]))
        env.step(np.array([0]))
        for wrapper in (Monitor, gym.wrappers.OrderEnforcing, gym.wrappers.PassiveEnvChecker, type(env.envs[0].env)):
            monkeypatch.setattr(wrapper, "step", None)
        for _ in range(20):
            env.step(np.array([0]))


class TestChecksOfGymnasium:
    @pytest.mark.parametrize("cls", [LeanVecEnv, DummyVecEnv])
    def test_an_info_that_is_handed_out_twice(self, cls):
        """Found by comparing the second step with the first."""

        class Reusing(ScriptedEnv):
            shared: ClassVar[dict[str, Any]] = {"data": [1]}

            def step(self, action):
                return *super().step(action)[:4], self.shared

        env = cls([lambda: gym.wrappers.PassiveEnvChecker(Reusing([Episode(0, [Step(0.0, 1)] * 9)]))])
        env.reset()
        env.step(np.array([0]))
        with pytest.warns(UserWarning, match="infos returned by `step` and the following `step` share"):
            env.step(np.array([0]))


class TestEndOfAnEpisode:
    @pytest.mark.parametrize("end", ["terminated", "truncated"])
    def test_infos_tell_how_it_ended_and_where(self, end):
        env = LeanVecEnv([lambda: ScriptedEnv([Episode(1, [Step(0.0, 2), Step(3.0, 3, end)])])])
        assert env.reset().tolist() == [1]
        _, _, dones, (info,) = env.step(np.array([0]))
        assert (dones.tolist(), info) == ([False], {"TimeLimit.truncated": False})
        observations, rewards, dones, (info,) = env.step(np.array([1]))
        assert (observations.tolist(), rewards.tolist(), dones.tolist()) == ([1], [3.0], [True])
        assert info == {"terminal_observation": 3, "TimeLimit.truncated": end == "truncated"}

    @pytest.mark.parametrize("end", ["terminated", "truncated"])
    def test_a_vec_env_that_does_not_tell_where_an_episode_ended(self, end):
        """The value of a terminal state is 0 wherever it is, so nothing is missing there."""

        class Silent(VecEnvWrapper):
            def reset(self):
                return self.venv.reset()

            def step_wait(self):
                observations, rewards, dones, infos = self.venv.step_wait()
                for info in infos:
                    info.pop("terminal_observation", None)
                return observations, rewards, dones, infos

        env = DummyVecEnv([lambda: ScriptedEnv([Episode(1, [Step(0.0, 2), Step(3.0, 3, end)])])])
        model = TabularQ("MlpPolicy", Silent(env), learning_rate=0.5, seed=0)
        if end == "truncated":
            with pytest.raises(ValueError, match=r'truncated an episode at step 2 without `info\["terminal_observation"\]`'):
                model.learn(2)
        else:
            assert sorted(model.learn(2).q_table.ravel())[-1] == 1.5

    def test_terminated_and_truncated_at_once_is_terminated(self):
        class Both(ScriptedEnv):
            def step(self, action):
                state, reward, *_, info = super().step(action)
                return state, reward, True, True, info

        env = LeanVecEnv([lambda: Both([Episode(0, [Step(0.0, 1)])])])
        env.reset()
        (info,) = env.step(np.array([0]))[3]
        assert info["TimeLimit.truncated"] is False


class TestWhatWasHandedOut:
    @both
    def test_later_steps_leave_it_alone(self, pair):
        env = pair[0]
        env.seed(0)
        handed_out, copies = [], []

        def copy(value):
            if isinstance(value, dict):
                return {key: copy(item) for key, item in value.items()}
            if isinstance(value, tuple):
                return tuple(copy(item) for item in value)
            return np.array(value)

        def keep(*values):
            handed_out.append(values)
            copies.append(copy(values))

        keep(env.reset())
        env.action_space.seed(0)
        for _ in range(40):
            observations, rewards, dones, _ = env.step(np.array([env.action_space.sample() for _ in range(env.num_envs)]))
            keep(observations, rewards, dones)
        keep(env.reset())
        for kept, copied in zip(handed_out, copies, strict=True):
            assert_same(copy(kept), copied)

    def test_an_environment_that_reuses_its_observation(self):
        """A buffer that the environment writes into again must not show through."""

        class Reusing(gym.Env):
            observation_space = spaces.Box(-np.inf, np.inf, (2,))
            action_space = spaces.Discrete(2)

            def reset(self, *, seed=None, options=None):
                super().reset(seed=seed)
                self.buffer = np.zeros(2, np.float32)
                return self.buffer, {}

            def step(self, action):
                self.buffer += 1.0
                return self.buffer, 0.0, False, False, {}

        env = LeanVecEnv([Reusing, Reusing])
        observations = [env.reset()] + [env.step(np.array([0, 1]))[0] for _ in range(3)]
        assert [observation.tolist() for observation in observations] == [[[n, n], [n, n]] for n in (0.0, 1.0, 2.0, 3.0)]

    def test_infos_of_one_environment_are_its_own(self):
        env = LeanVecEnv([lambda: ScriptedEnv([Episode(0, [Step(0.0, 1, "truncated")])]) for _ in range(2)])
        env.reset()
        first, second = env.step(np.array([0, 0]))[3]
        first["mark"] = 1
        assert "mark" not in second


class TestAsAVecEnv:
    def test_make_vec_env_and_wrappers_take_it(self):
        env = make_vec_env("FrozenLake-v1", n_envs=2, seed=0, vec_env_cls=LeanVecEnv)
        assert type(env) is LeanVecEnv
        env.reset()
        assert env.step(np.array([0, 1]))[1].shape == (2,)
        assert env.get_attr("spec")[0].id == "FrozenLake-v1"
        assert env.env_is_wrapped(Monitor) == [True, True]
        assert len(env.env_method("get_wrapper_attr", "P")) == 2
        env.close()
        env = VecMonitor(LeanVecEnv([lambda: ScriptedEnv([Episode(0, [Step(2.0, 1, "terminated")])])]))
        env.reset()
        assert env.step(np.array([0]))[3][0]["episode"]["r"] == 2.0

    def test_rendering(self):
        env = make_vec_env("FrozenLake-v1", env_kwargs={"render_mode": "rgb_array"}, vec_env_cls=LeanVecEnv)
        env.reset()
        assert env.render().ndim == 3
        env.close()

    def test_an_environment_is_not_used_twice(self):
        env = gym.make("FrozenLake-v1")
        with pytest.raises(ValueError, match="same instance"):
            LeanVecEnv([lambda: env, lambda: env])

    def test_lists_of_actions_will_do(self):
        env = LeanVecEnv([lambda: ScriptedEnv([Episode(0, [Step(1.0, 1)])])])
        env.reset()
        assert env.step([1])[0].tolist() == [1]

    def test_helper_environments_keep_the_rules_of_gymnasium(self):
        """What these tests lean on is sound."""
        check_env(ScriptedEnv([Episode(0, [Step(1.0, 1)] * 100)]), warn=False)


class Chain(gym.Env):
    """Five cells in a row; what it returns is what a test tells it to."""

    observation_space: spaces.Space = spaces.Discrete(5)
    action_space = spaces.Discrete(2)

    def __init__(self, **returned: Any) -> None:
        self.returned = returned

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        return self.returned.get("reset", (self.returned.get("first", 0), {}))

    def step(self, action):
        one_by_one = [self.returned.get(name, sound) for name, sound in SOUND_STEP.items()]
        return self.returned.get("step", tuple(one_by_one))


SOUND_STEP = {"observation": 1, "reward": 0.5, "terminated": False, "truncated": False, "info": {}}

REWARD = "`step` of Chain must return a finite number as the reward, but returned "
STEP = "`step` of Chain must return (observation, reward, terminated, truncated, info), but returned "
OBSERVATION = "The observation of Chain must be one of Discrete(5), but is "

FAULTS = [
    ({"observation": np.array([1])}, OBSERVATION + "array([1]) of shape (1,)"),
    ({"observation": None}, OBSERVATION + "None"),
    ({"observation": np.nan}, OBSERVATION + "nan"),
    ({"observation": 1.5}, OBSERVATION + "1.5"),
    ({"observation": "a"}, OBSERVATION + "'a'"),
    ({"observation": (1, 2)}, OBSERVATION + "(1, 2)"),
    ({"first": np.array([1])}, OBSERVATION + "array([1]) of shape (1,)"),
    ({"first": None}, OBSERVATION + "None"),
    ({"first": 0.5}, OBSERVATION + "0.5"),
    ({"observation": None, "first": None, "terminated": True}, OBSERVATION + "None"),
    ({"reward": np.array([0.5])}, REWARD + "array([0.5]) of shape (1,)"),
    ({"reward": [0.5]}, REWARD + "[0.5]"),
    ({"reward": None}, REWARD + "None"),
    ({"reward": None, "terminated": True}, REWARD + "None"),
    ({"reward": "much"}, REWARD + "'much'"),
    ({"reward": 1j}, REWARD + "1j"),
    ({"reward": 10**400}, REWARD + "1000"),
    (
        {"terminated": np.array([True, False])},
        "`step` of Chain must return True or False as `terminated`, but returned array(",
    ),
    (
        {"truncated": np.array([0, 1])},
        "`step` of Chain must return True or False as `truncated`, but returned array([0, 1]) of",
    ),
    ({"info": None}, "`step` of Chain must return a dict as the info, but returned None"),
    ({"info": []}, "`step` of Chain must return a dict as the info, but returned []"),
    ({"step": (1, 0.5, False, {})}, STEP + "4 values, (1, 0.5, False, {})"),
    ({"step": (1, 0.5, False, False, {}, None)}, STEP + "6 values"),
    ({"step": 1}, STEP + "1"),
    ({"step": None}, STEP + "None"),
    ({"reset": 0}, "`reset` of Chain must return (observation, info) with a dict as the info, but returned 0"),
    ({"reset": None}, "`reset` of Chain must return (observation, info) with a dict as the info, but returned None"),
    ({"reset": (0, 1)}, "`reset` of Chain must return (observation, info) with a dict as the info, but returned (0, 1)"),
    (
        {"reset": np.array([0, 1])},
        "`reset` of Chain must return (observation, info) with a dict as the info, but returned array(",
    ),
]

AROUND = {
    "nothing": lambda env: env,
    "Monitor": Monitor,
    "Monitor and limit": lambda env: Monitor(gym.wrappers.TimeLimit(env, 100)),
}


class TestFaults:
    """An environment that returns what it must not is told so where that enters."""

    @pytest.mark.parametrize("around", AROUND)
    @pytest.mark.parametrize(("returned", "message"), FAULTS, ids=lambda value: str(value)[:60])
    def test_the_culprit_is_named(self, returned, message, around):
        env = LeanVecEnv([lambda: AROUND[around](Chain(**returned))])
        with pytest.raises(ValueError, match=re.escape(message)):
            env.reset()
            env.step(np.array([0]))

    @pytest.mark.parametrize(
        ("space", "observation", "message"),
        [
            (
                spaces.MultiDiscrete([3, 3]),
                np.array([0.0, 0.5]),
                "must be one of MultiDiscrete([3 3]), but is array([0. , 0.5])",
            ),
            (
                spaces.MultiDiscrete([3, 3]),
                np.array([1]),
                "must be one of MultiDiscrete([3 3]), but is array([1]) of shape (1,)",
            ),
            (spaces.MultiDiscrete([3, 3]), 1, "must be one of MultiDiscrete([3 3]), but is 1"),
            (spaces.MultiBinary(2), [0.5, 1], "must be one of MultiBinary(2), but is [0.5, 1]"),
            (spaces.Tuple([spaces.Discrete(3)] * 2), (1, 0.5), "The part [1] of the observation of Chain must be one of Disc"),
            (spaces.Tuple([spaces.Discrete(3)] * 2), (1,), "The observation of Chain must be one of Tuple("),
            (
                spaces.Dict(a=spaces.Discrete(3)),
                {"a": [1]},
                "The part ['a'] of the observation of Chain must be one of Discrete(3)",
            ),
            (spaces.Dict(a=spaces.Discrete(3)), {"b": 1}, "The observation of Chain must be one of Dict("),
            (spaces.Dict(a=spaces.Discrete(3)), None, "The observation of Chain must be one of Dict("),
            (
                spaces.Dict(a=spaces.Box(0, 1, (2,))),
                {"a": [1] * 3},
                "The part ['a'] of the observation of Chain must be one of Box",
            ),
        ],
        ids=str,
    )
    def test_observations_of_other_spaces(self, space, observation, message):
        for name in ("observation", "first"):
            chain = Chain(**{"first": space.sample(), "observation": space.sample(), name: observation})
            chain.observation_space = space
            env = LeanVecEnv([lambda chain=chain: Monitor(chain)])
            with pytest.raises(ValueError, match=re.escape(message)):
                env.reset()
                env.step(np.array([0]))

    @pytest.mark.parametrize("value", [3, 3.0, np.int64(3), np.float32(3), np.array(3), True, np.uint8(3)], ids=repr)
    def test_whole_numbers_of_any_type_are_taken(self, value):
        ours, theirs = (cls([lambda: Chain(observation=value)]) for cls in (LeanVecEnv, DummyVecEnv))
        for env in (ours, theirs):
            env.reset()
        assert_same(ours.step(np.array([0]))[0], theirs.step(np.array([0]))[0])

    def test_wrappers_in_between_that_cannot_read_what_it_returns(self):
        """The error then comes from gymnasium's code, and says nothing of the environment."""
        env = LeanVecEnv([lambda: Monitor(Halved(Chain(step=(1, 0.5, False, {}))))])
        env.reset()
        with pytest.raises(ValueError, match=r"`step` of Chain must return \(observation, reward, .*expected 5, got 4"):
            env.step(np.array([0]))

        class OldCartPole(type(cart_pole().unwrapped)):
            def reset(self, **arguments):
                return super().reset(**arguments)[0]

        env = LeanVecEnv([lambda: discretised(OldCartPole())])
        with pytest.raises(ValueError, match=r"`reset` of OldCartPole must return \(observation, info\).*expected 2"):
            env.reset()

    def test_a_reset_without_arguments(self):
        class Older(Chain):
            def reset(self):  # type: ignore[override]
                return 0

        with pytest.raises(ValueError, match=r"`reset` of Older must take the keyword arguments `seed` and `options`"):
            LeanVecEnv([lambda: Monitor(Older())]).reset()

    @pytest.mark.parametrize(
        "error", [ValueError("not enough values to unpack"), TypeError("of its own"), OverflowError("large")]
    )
    @pytest.mark.parametrize("where", ["reset", "step"])
    def test_errors_of_the_environment_itself_pass(self, where, error):
        class Failing(Chain):
            fails = False

            def step(self, action):
                if self.fails:
                    raise error
                return super().step(action)

            def reset(self, **arguments):
                if self.fails:
                    raise error
                return super().reset(**arguments)

        env = LeanVecEnv([lambda: Monitor(Halved(Failing()))])
        env.reset()
        env.envs[0].unwrapped.fails = True
        with pytest.raises(type(error)) as raised:
            env.step(np.array([0])) if where == "step" else env.reset()
        assert raised.value is error

    def test_errors_of_what_the_environment_calls_pass_too(self):
        """It steps environments of gymnasium's inside its own step, or calls them in a wrong way."""

        class Nested(Chain):
            def step(self, action):
                return Halved(Chain(step=(1, 0.5, False, {}))).step(action)

        class Careless(Chain):
            def step(self, action):
                return gym.make("Taxi-v4").reset(sead=action)

        for kind, error in ((Nested, ValueError), (Careless, TypeError)):
            env = LeanVecEnv([lambda kind=kind: Monitor(kind())])
            env.reset()
            with pytest.raises(error, match=r"unpack|unexpected keyword argument") as raised:
                env.step(np.array([0]))
            assert "must" not in str(raised.value)

    def test_an_error_of_a_reset_is_not_taken_for_one_of_the_step_before(self):
        class Failing(Chain):
            def reset(self, **arguments):
                if arguments:
                    return super().reset(**arguments)
                raise ValueError("of its own")

        env = LeanVecEnv([lambda: Failing(step=(1, np.nan, True, False, {}))])
        env.reset()
        with pytest.raises(ValueError, match=r"^of its own$"):
            env.step(np.array([0]))

    def test_nan_in_a_discretised_observation(self):
        class Blind(type(cart_pole().unwrapped)):
            def step(self, action):
                return np.full(4, np.nan), *super().step(action)[1:]

        env = LeanVecEnv([lambda: Monitor(discretised(Blind()))])
        env.reset()
        with pytest.raises(ValueError, match=r"observation is NaN in dimension\(s\) 0, 1, 2, 3"):
            env.step(np.array([0]))

    @pytest.mark.parametrize(("reward", "is_sound"), [(1, True), (np.float32(1), True), (np.nan, False), (np.inf, False)])
    def test_a_reward_that_is_no_number(self, reward, is_sound):
        """A learning loop asks for this where a reward is not finite."""
        fault = find_fault_of_step(Chain(), (1, reward, False, False, {}))
        assert fault is None if is_sound else str(fault).startswith(REWARD)


class TestOneEnvironment:
    def test_one_is_fine(self):
        for env in (gym.make("FrozenLake-v1"), LeanVecEnv([Chain]), DummyVecEnv([Chain]), Chain()):
            check_is_single_env(env)

    def test_gymnasiums_vectors(self):
        env = gym.make_vec("FrozenLake-v1", num_envs=3)
        with pytest.raises(
            ValueError, match=r"got the SyncVectorEnv of gymnasium, which steps 3 .*make_vec_env\(id, n_envs=3"
        ):
            check_is_single_env(env)

    def test_several_agents(self):
        base = type("ParallelEnv", (), {"__module__": "pettingzoo.utils.env", "step": None, "reset": None})
        with pytest.raises(ValueError, match="environment of one agent, but got Pursuit, a PettingZoo"):
            check_is_single_env(type("Pursuit", (base,), {})())

    @pytest.mark.parametrize("env", [Chain, lambda: Chain()])
    def test_what_makes_one(self, env):
        with pytest.raises(ValueError, match="call it and pass what it returns"):
            check_is_single_env(env)

    @pytest.mark.parametrize("env", [7, None, {}, [Chain()]])
    def test_none(self, env):
        with pytest.raises(ValueError, match=r"Expected a gymnasium environment.*but got .*pass one of these"):
            check_is_single_env(env)


class TestCompiledChangedAfterwards:
    """The compiled path looks again at every call of ``learn``."""

    def model(self):
        return TabularQ("MlpPolicy", CompiledVecEnv([lambda: Monitor(gym.make("FrozenLake-v1"))]), seed=0, learning_rate=0.5)

    def test_another_environment_is_the_one_that_is_learned_from(self):
        model = self.model()

        def make():
            return Monitor(gym.make("FrozenLake-v1", is_slippery=False))

        model.get_env().envs[0] = make()
        model.get_env().seed(0)
        model.learn(2000)
        other = TabularQ("MlpPolicy", LeanVecEnv([make]), seed=0, learning_rate=0.5)
        np.testing.assert_array_equal(model.q_table, other.learn(2000).q_table)

    @pytest.mark.parametrize("change", [replace_env, lambda env: patch(env.envs[0].unwrapped), wrap_inside_monitor])
    def test_what_does_not_compile_is_refused(self, change):
        model = self.model().learn(500)
        change(model.get_env())
        with pytest.raises(ValueError, match=r"CompiledVecEnv c.*LeanVecEnv"):
            model.learn(500)

    def test_an_environment_that_is_new_is_compared(self):
        class Lying(FrozenLakeEnv):
            compile_by_table = True

            def step(self, action):
                observation, reward, *rest = super().step(action)
                return observation, reward + 1.0, *rest

        model = self.model().learn(100)
        model.get_env().envs[0] = Monitor(gym.wrappers.TimeLimit(Lying(), 100))
        with pytest.raises(ValueError, match="Lying does not step as TabularDynamics does"):
            model.learn(100)
