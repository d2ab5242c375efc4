"""CompiledVecEnv as an SB3 VecEnv, what it compiles and what it refuses, and environments and rules of a user."""

import math
import re

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from gymnasium.envs.classic_control.cartpole import CartPoleEnv
from gymnasium.envs.toy_text.frozen_lake import FrozenLakeEnv
from gymnasium.wrappers import RecordEpisodeStatistics, TimeLimit, TransformReward
from helpers.both_paths import CELLS, assert_same, learn, make_model, make_vec, step_alike
from helpers.mountain_car import MountainCarDynamics
from helpers.table_env import TableEnv
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from sb3_adaptive_q import CompiledVecEnv, LeanVecEnv, LearningRateCallback, TabularQ
from sb3_adaptive_q.vec_env import Dynamics, register_dynamics
from wrappers import DiscretizeObservation

LAKE = "slippery lake"
LEAN = "LeanVecEnv"


def compiled(*envs):
    return CompiledVecEnv([lambda env=env: env for env in envs])


def in_cells(env, **cells):
    return DiscretizeObservation(env, **{**CELLS, **cells})


def refused(*parts, error=ValueError):
    """Expect an error whose message holds the parts in this order."""
    return pytest.raises(error, match="(?s)" + ".*".join(re.escape(part) for part in parts))


class TestVecEnv:
    def test_it_is_sb3s(self):
        env = make_vec_env("FrozenLake-v1", n_envs=2, vec_env_cls=CompiledVecEnv)
        assert isinstance(env, DummyVecEnv) and isinstance(env, LeanVecEnv)
        assert env.num_envs == 2
        assert env.get_attr("spec")[0].id == "FrozenLake-v1"
        assert env.env_is_wrapped(Monitor) == [True, True]

    def test_a_step_is_an_ordinary_one(self):
        ours, theirs = make_vec(LAKE, True, 2), make_vec_env("FrozenLake-v1", 2)
        for env in (ours, theirs):
            env.seed(3)
        np.testing.assert_array_equal(ours.reset(), theirs.reset())
        for step in range(60):
            actions = np.array([step % 4, (step + 1) % 4])
            for info, their_info in step_alike(ours, theirs, actions):
                assert {**info, "episode": None} == {**their_info, "episode": None}

    def test_what_it_is_asked_about_is_where_learning_is(self):
        model = make_model(LAKE, True, callback_interval=10)

        def look(locals_, globals_):
            assert model.env.get_attr("s") == locals_["new_obs"].tolist()
            return True

        model.learn(2_000, callback=look)

    def test_rendering(self):
        env = make_vec_env("FrozenLake-v1", env_kwargs={"render_mode": "rgb_array"}, vec_env_cls=CompiledVecEnv)
        model = TabularQ("MlpPolicy", env, seed=0).learn(2_000)
        state = int(model._last_obs[0])
        assert env.envs[0].unwrapped.s == state
        env.envs[0].unwrapped.s = 15 - state
        elsewhere = env.render()
        env.envs[0].unwrapped.s = state
        picture = env.render()
        assert picture.shape == (256, 256, 3) and picture.dtype == np.uint8
        assert (picture != elsewhere).any()

    def test_what_was_rendered_before_compiles_too(self):
        env = gym.make("FrozenLake-v1", render_mode="rgb_array")
        env.reset()
        env.render()
        TabularQ("MlpPolicy", compiled(Monitor(env))).learn(100)

    def test_evaluation(self):
        model = make_model("firm lake", True, method=2, exploration_final_eps=0.2).learn(50_000)
        in_compiled, in_ordinary = (
            evaluate_policy(model, make_vec("firm lake", path), n_eval_episodes=3, return_episode_rewards=True)
            for path in (True, False)
        )
        assert in_compiled == in_ordinary == ([1.0] * 3, [6] * 3)  # the shortest way

    def test_it_is_made_without_stepping_the_environment(self):
        """The comparison with the compiled functions works on a copy."""
        env = gym.make("FrozenLake-v1")
        env.reset(seed=5)
        generator = env.unwrapped.np_random.bit_generator.state
        compiled(env)
        assert env.unwrapped.np_random.bit_generator.state == generator
        assert env.unwrapped.s == 0 and env.unwrapped.lastaction is None


class TestSavedModels:
    def test_they_play_in_the_ordinary_environment(self, tmp_path):
        model = make_model("firm lake", True, method=2, exploration_final_eps=0.2).learn(50_000)
        model.save(tmp_path / "lake")
        loaded = TabularQ.load(tmp_path / "lake", env=gym.make("FrozenLake-v1", is_slippery=False))
        np.testing.assert_array_equal(loaded.q_table, model.q_table)
        assert evaluate_policy(loaded, loaded.get_env(), n_eval_episodes=3)[0] == 1.0

    @pytest.mark.parametrize("path", [False, True])
    def test_they_learn_on_in_either(self, tmp_path, path):
        outcomes = []
        for first in (False, True):
            make_model(LAKE, first, method=7, initial_q=0.5).learn(3_000).save(tmp_path / "lake")
            loaded = TabularQ.load(tmp_path / "lake", env=make_vec(LAKE, path))
            loaded.set_random_seed(9)
            outcomes.append(learn(loaded, 2_000, reset_num_timesteps=False))
        assert_same(*outcomes)


class Acrobat(CartPoleEnv):
    """A subclass, which may step as it likes."""


def semi_implicit():
    env = CartPoleEnv()
    env.kinematics_integrator = "semi-implicit euler"
    return in_cells(env)


class TestEnvironmentsThatDoNotCompile:
    @pytest.mark.parametrize("env_id", ["Acrobot-v1", "Blackjack-v1", "Pendulum-v1"])
    def test_no_dynamics(self, env_id):
        env = gym.make(env_id)
        with refused(type(env.unwrapped).__name__, "compile_by_table", "CartPoleEnv", "CartPoleFrictionEnv", "register", LEAN):
            compiled(env)

    def test_a_subclass_of_what_compiles(self):
        with refused("Acrobat", "CartPoleEnv", LEAN):
            compiled(in_cells(Acrobat()))

    @pytest.mark.parametrize("env_id", ["CartPole-v1", "CartPoleFriction-v0"])
    def test_cart_pole_without_cells(self, env_id):
        with refused("CartPole", "DiscretizeObservation"):
            compiled(gym.make(env_id))

    def test_cart_pole_with_another_integrator(self):
        with refused("euler", "semi-implicit euler", LEAN):
            compiled(semi_implicit())

    def test_a_fickle_passenger(self):
        with refused("TaxiEnv", "more than draw from it", LEAN):
            compiled(gym.make("Taxi-v4", fickle_passenger=True))

    def test_what_is_to_be_watched(self):
        with refused("human", LEAN):
            compiled(FrozenLakeEnv(render_mode="human"))

    @pytest.mark.parametrize(
        "wrapper, name",
        [
            (lambda env: TransformReward(env, lambda reward: 2 * reward), "TransformReward"),
            (RecordEpisodeStatistics, "RecordEpisodeStatistics"),
            (lambda env: TimeLimit(env, 5), "TimeLimit"),
            (lambda env: Monitor(Monitor(env)), "Monitor"),
        ],
    )
    def test_wrappers(self, wrapper, name):
        with refused(name, "Monitor", "DiscretizeObservation", "TimeLimit", LEAN):
            compiled(wrapper(gym.make("FrozenLake-v1")))

    @pytest.mark.parametrize(
        "make",
        [
            lambda: gym.make("Acrobot-v1"),
            lambda: TransformReward(gym.make("FrozenLake-v1"), lambda reward: 2 * reward),
            lambda: gym.make("Taxi-v4", fickle_passenger=True),
            semi_implicit,
        ],
    )
    def test_the_lean_one_takes_them(self, make):
        env = LeanVecEnv([make])
        env.reset()
        env.step(np.array([0]))

    @pytest.mark.parametrize(
        "first, second",
        [
            (lambda: gym.make("FrozenLake-v1"), lambda: gym.make("FrozenLake-v1", is_slippery=False)),
            (lambda: gym.make("FrozenLake-v1"), lambda: gym.make("FrozenLake8x8-v1")),
            (lambda: gym.make("FrozenLake-v1"), lambda: gym.make("FrozenLake-v1", max_episode_steps=7)),
            (lambda: in_cells(CartPoleEnv()), lambda: in_cells(CartPoleEnv(), n_edges=9)),
            (lambda: in_cells(CartPoleEnv()), lambda: in_cells(CartPoleEnv(), high=[2.0, 4.0, 0.2, 4.0])),
            (lambda: in_cells(CartPoleEnv()), lambda: in_cells(CartPoleEnv(sutton_barto_reward=True))),
            (lambda: in_cells(CartPoleEnv()), lambda: in_cells(gym.make("CartPoleFriction-v0"))),
        ],
    )
    def test_environments_that_differ(self, first, second):
        with refused("alike", "environment 2", LEAN):
            CompiledVecEnv([first, first, second])

    def test_environments_that_differ_later(self):
        model = make_model("CartPoleFriction", True, 2)
        model.env.envs[1].unwrapped.gravity = 1.6
        with refused("alike", "environment 1"):
            model.learn(100)

    def test_constants_that_were_changed_are_learned_with(self):
        models = [make_model("CartPoleFriction", path, 2, method=2) for path in (False, True)]
        for model in models:
            for env in model.env.envs:
                env.unwrapped.gravity = 1.6
        assert_same(*(learn(model, 5_000) for model in models))


SOUND = [[[(1.0, 0, 0.0, False)]]]


def table_with(*outcomes, initial=(1.0,)):
    return TableEnv([[list(outcomes)]], list(initial))


class TestTransitionTables:
    @pytest.mark.parametrize(
        "env, parts",
        [
            (table_with((0.5, 0, 0.0, False), (0.4, 0, 0.0, False)), ["P[0][0]", "sum to 1", "[0.5, 0.4]"]),
            (table_with((0.5, 0, 0.0, False), (0.6, 0, 0.0, False)), ["P[0][0]", "sum to 1", "[0.5, 0.6]"]),
            (table_with((1.5, 0, 0.0, False), (-0.5, 0, 0.0, False)), ["P[0][0]", "sum to 1", "[1.5, -0.5]"]),
            (table_with((math.nan, 0, 0.0, False)), ["P[0][0]", "sum to 1", "[nan]"]),
            (table_with((1.0, 1, 0.0, False)), ["next states of P[0][0]", "0 to 0", "1"]),
            (table_with((1.0, -1, 0.0, False)), ["next states of P[0][0]", "0 to 0", "-1"]),
            (table_with((1.0, 0.5, 0.0, False)), ["next states of P[0][0]", "0.5"]),
            (table_with((1.0, math.nan, 0.0, False)), ["next states of P[0][0]", "nan"]),
            (table_with((1.0, 0, math.nan, False)), ["rewards of P[0][0]", "finite", "nan"]),
            (table_with((1.0, 0, -math.inf, False)), ["rewards of P[0][0]", "finite", "-inf"]),
            (table_with((1.0, 0, 1e300, False)), ["rewards of P[0][0]", "float32", "1e+300"]),
            (table_with((1.0, 0, 0.0)), ["outcomes of P[0][0]", "(probability, next state, reward, terminated)"]),
            (table_with(), ["P[0][0]", "at least one outcome"]),
            (table_with((1.0, None, 0.0, False)), ["P[0][0]", "(probability, next state, reward, terminated)", "None"]),
            (table_with((1.0, 0, 1j, False)), ["P[0][0]", "(probability, next state, reward, terminated)", "1j"]),
            (table_with((1.0, 0, [0.0, 1.0], False)), ["P[0][0]", "(probability, next state, reward, terminated)"]),
            (table_with((1.0, "0", 0.0, False)), ["P[0][0]", "(probability, next state, reward, terminated)", "'0'"]),
            (table_with(None), ["P[0][0]", "(probability, next state, reward, terminated)", "None"]),
            (TableEnv([[None]], [1.0]), ["a list P[0][0]", "missing"]),
            (TableEnv([[[(1.0, 0, 0.0, False)], []]], [1.0]), ["P[0][1]", "at least one outcome"]),
            (TableEnv(SOUND, [0.5]), ["initial_state_distrib", "sum to 1", "[0.5]"]),
            (TableEnv(SOUND, [0.5, 0.5]), ["initial_state_distrib", "1 states", "2"]),
            (TableEnv(SOUND, []), ["initial_state_distrib", "1 states", "0"]),
        ],
    )
    def test_what_is_wrong_is_named(self, env, parts):
        with refused(*parts):
            compiled(env)

    def test_an_action_that_is_missing(self):
        env = TableEnv(SOUND, [1.0])
        del env.P[0][0]
        with refused("P[0][0]", "missing"):
            compiled(env)

    def test_a_table_that_was_spoilt_later(self):
        env = TableEnv(SOUND, [1.0])
        model = TabularQ("MlpPolicy", compiled(env))
        env.P[0][0] = [(0.9, 0, 0.0, False)]
        with refused("P[0][0]", "sum to 1"):
            model.learn(10)
        assert model.num_timesteps == 0

    @pytest.mark.parametrize("space", [spaces.MultiDiscrete([1]), spaces.Discrete(1, start=3)])
    def test_spaces_that_do_not_count_from_0(self, space):
        env = TableEnv(SOUND, [1.0])
        env.observation_space = space
        with refused("observation_space", str(space), LEAN):
            compiled(env)

    def test_a_state_of_another_name(self):
        class Elsewhere(TableEnv):
            def reset(self, *, seed=None, options=None):
                state, info = super().reset(seed=seed)
                self.place = self.__dict__.pop("s")
                return state, info

        with refused("Elsewhere", "`s`"):
            compiled(Elsewhere(SOUND, [1.0]))


class Shaped(FrozenLakeEnv):
    """Rewards one cell that the table knows nothing of."""

    def step(self, action):
        state, reward, terminated, truncated, info = super().step(action)
        return state, reward + (1.0 if state == 14 else 0.0), terminated, truncated, info


class Mirrored(FrozenLakeEnv):
    """Shows another state than it is in."""

    def step(self, action):
        state, *rest = super().step(action)
        return 15 - state, *rest

    def reset(self, *, seed=None, options=None):
        state, info = super().reset(seed=seed)
        return 15 - state, info


class Impatient(FrozenLakeEnv):
    """Cuts an episode short by itself."""

    def step(self, action):
        state, reward, terminated, _, info = super().step(action)
        return state, reward, terminated, state == 13, info


class ElsewhereFirst(FrozenLakeEnv):
    """Begins where the distribution of the first state does not allow it."""

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.s = 4
        return 4, {}


class Endless(FrozenLakeEnv):
    """Does not end at the goal."""

    def step(self, action):
        state, reward, terminated, truncated, info = super().step(action)
        return state, reward, terminated and state != 15, truncated, info


class TestEnvironmentsThatDoMoreThanTheirTable:
    """No difference goes unnoticed, however seldom one would meet it by chance."""

    @pytest.mark.parametrize(
        "kind, what",
        [
            (Shaped, "reward is 1.0"),
            (Mirrored, "row of the table is 15"),
            (Impatient, "truncated is True"),
            (ElsewhereFirst, "state is 4"),
            (Endless, "terminated is False"),
        ],
    )
    @pytest.mark.parametrize("is_slippery", [False, True])
    def test_they_are_refused(self, kind, what, is_slippery):
        with refused(kind.__name__, "does not step as", what, LEAN):
            compiled(type(kind.__name__, (kind,), {"compile_by_table": True})(is_slippery=is_slippery))

    @pytest.mark.parametrize("kind", [Shaped, Mirrored, Impatient, ElsewhereFirst, Endless])
    def test_a_class_that_says_nothing_is_refused(self, kind):
        with refused(kind.__name__, "more than draw from it", "compile_by_table", "register_dynamics", LEAN):
            compiled(kind())

    def test_a_step_put_on_the_environment_itself_is_refused(self):
        env = gym.make("FrozenLake-v1")
        env.unwrapped.step = lambda action: (0, 0.0, False, False, {})
        with refused("`step` of this environment was replaced", LEAN):
            compiled(env)


class TestArguments:
    @pytest.mark.parametrize("interval", [0, -1])
    def test_callback_interval(self, interval):
        with refused("callback_interval", "from 1 to", str(interval)):
            make_model(LAKE, True, callback_interval=interval)

    def test_a_schedule_is_a_python_function(self):
        """One that Numba compiles runs on both paths; one that it does not compile on the ordinary path only."""
        plain, text = (lambda remaining: 0.1 * remaining), (lambda remaining: {"a": [remaining, ""]}["a"][0])
        assert_same(*(learn(make_model(LAKE, path, learning_rate=plain), 5_000) for path in (True, False)))
        model = make_model(LAKE, True, learning_rate=text)
        with refused("learning_rate", "not compile", LEAN):
            model.learn(100)
        assert model.num_timesteps == 0 and not model.q_table.any()
        with pytest.warns(UserWarning, match="`learning_rate` runs as Python"):
            make_model(LAKE, False, learning_rate=text).learn(100)

    def test_the_same_schedule_as_a_rule(self):
        class Linear(LearningRateCallback):
            @staticmethod
            def rule(mu, transition, start):
                return start * (1.0 - transition.progress)

        scheduled = learn(make_model(LAKE, False, learning_rate=lambda remaining: 0.1 * remaining), 5_000)
        assert_same(learn(make_model(LAKE, True), 5_000, Linear(start=0.1)), scheduled)


class TestRulesOfAUser:
    def test_one_that_does_not_compile(self):
        class Texts(LearningRateCallback):
            @staticmethod
            def rule(mu, transition):
                return {"mu": [mu, "text"]}["mu"][0]

        model = make_model(LAKE, True)
        with refused("Texts", "not compile", LEAN):
            model.learn(100, callback=Texts(mu_0=0.1))
        assert not model.q_table.any()
        with pytest.warns(UserWarning, match="Texts runs as Python, which is slower: "):
            make_model(LAKE, False).learn(100, callback=Texts(mu_0=0.1))

    @pytest.mark.parametrize("path", [False, True])
    @pytest.mark.parametrize("late, given", [(None, "none"), (0.1, "OptionalType"), ("text", "unicode_type")])
    def test_one_that_gives_no_number(self, path, late, given):
        """Never, sometimes, or something else: in one sentence, before anything is learned."""

        class Forgetful(LearningRateCallback):
            @staticmethod
            def rule(mu, transition):
                return None

        class Seldom(LearningRateCallback):
            @staticmethod
            def rule(mu, transition):
                if transition.progress > 0.5:
                    return 0.1

        class Wordy(LearningRateCallback):
            @staticmethod
            def rule(mu, transition):
                return "0.1"

        rule = {None: Forgetful, 0.1: Seldom, "text": Wordy}[late]
        model = make_model(LAKE, path)
        with refused(f"`rule` of {__name__}", rule.__name__, "must return a number in every case", given):
            model.learn(1_000, callback=rule(mu_0=0.1))
        assert model.num_timesteps == 0 and not model.q_table.any()

    def test_one_that_fails_as_python(self):
        """The table is as it was before the update that the rule failed after."""

        class Failing(LearningRateCallback):
            @staticmethod
            def rule(mu, transition):
                if transition.value != 0.0:
                    raise OSError("no such file")
                return {"mu": [mu, "text"]}["mu"][0]

        model = make_model(LAKE, False, initial_q=1.0)
        before = model.q_table.copy()
        with pytest.warns(UserWarning, match="Failing runs as Python"), pytest.raises(OSError, match="no such file"):
            model.learn(1_000, callback=Failing(mu_0=0.1))
        np.testing.assert_array_equal(model.q_table, before)
        assert model.num_timesteps == 1

    @pytest.mark.parametrize("path", [False, True])
    def test_one_that_leaves_the_range(self, path):
        class Doubling(LearningRateCallback):
            @staticmethod
            def rule(mu, transition):
                return 2.0 * mu

        with refused("Doubling", "0 to 1", "1.6"):
            make_model(LAKE, path).learn(1_000, callback=Doubling(mu_0=0.1))

    def test_one_that_calls_functions(self):
        class Chained(LearningRateCallback):
            @staticmethod
            def rule(mu, transition, floor):
                return keep_above(floor, half_of(mu))

        outcomes = [learn(make_model(LAKE, path), 3_000, Chained(mu_0=0.8, floor=0.01)) for path in (False, True)]
        assert_same(outcomes[1], outcomes[0])
        assert outcomes[0].mu == 0.01

    def test_one_of_each_that_differ_in_their_parameters_alone(self):
        class Steady(LearningRateCallback):
            @staticmethod
            def rule(mu, transition, beta):
                return beta

        for beta in (0.1, 0.2):
            assert make_model(LAKE, True).learn(500, callback=Steady(beta=beta)).mu == beta

    def test_two_of_the_same_name(self):
        def make(factor):
            class Scaled(LearningRateCallback):
                @staticmethod
                def rule(mu, transition):
                    return factor

            return Scaled()

        for factor in (0.25, 0.5):
            assert make_model(LAKE, True).learn(500, callback=make(factor)).mu == factor


def half_of(value):
    return value / 2.0


def keep_above(floor, value):
    return max(floor, value)


ROAD = {"n_edges": [12, 8]}


def mountain_car(kind, n_envs=1, **arguments):
    env = make_vec_env("MountainCar-v0", n_envs, wrapper_class=DiscretizeObservation, wrapper_kwargs=ROAD, vec_env_cls=kind)
    return TabularQ("MlpPolicy", env, **{"seed": 0, "gamma": 1.0, "learning_rate": 0.2, **arguments})


class TestEnvironmentOfAUser:
    @pytest.mark.parametrize("n_envs", [1, 3])
    def test_both_paths_are_the_same_to_the_bit(self, n_envs):
        ordinary, compiled_ = (learn(mountain_car(kind, n_envs), 30_000) for kind in (LeanVecEnv, CompiledVecEnv))
        assert len(np.unique(ordinary.table)) > 100
        assert_same(compiled_, ordinary)

    def test_it_learns_to_reach_the_top(self):
        """With a constant step size of 0.2, the last policy is so noisy that half of the seeds never arrive (-200)."""
        model = mountain_car(CompiledVecEnv, learning_rate=lambda left: 0.2 * left).learn(3_000_000, log_interval=None)
        ordinary = mountain_car(LeanVecEnv).env
        assert evaluate_policy(model, ordinary, n_eval_episodes=20)[0] > -180.0

    def test_its_own_refusals_are_heard(self):
        with refused("DiscretizeObservation"):
            compiled(gym.make("MountainCar-v0"))

    def test_it_is_named_among_what_compiles(self):
        with refused("MountainCarEnv"):
            compiled(gym.make("Acrobot-v1"))


class Walk(gym.Env):
    """A walk along a line, each step of which is uphill or downhill by chance."""

    def __init__(self, n_states=5):
        self.observation_space = spaces.Discrete(n_states)
        self.action_space = spaces.Discrete(2, start=1)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.state = 2
        return self.state, {}

    def step(self, action):
        assert action in self.action_space
        forward = (self.np_random.random() < 0.75) == (action == 2)
        self.state = max(self.state + (1 if forward else -1), 0)
        return self.state, float(self.state == 4), self.state == 4, False, {}


class WalkDynamics(Dynamics):
    """State and parameters as plain as they can be: a number, and no parameters at all."""

    parameters = ()

    def read_state(self):
        return self.env.state

    def write_state(self, state):
        self.env.state = int(state)

    @staticmethod
    def reset(parameters, generator):
        return 2

    @staticmethod
    def step(parameters, state, action, generator):
        forward = (generator.random() < 0.75) == (action == 1)
        state = max(state + (1 if forward else -1), 0)
        return state, 1.0 if state == 4 else 0.0, state == 4

    @staticmethod
    def index(parameters, state):
        return state


class TestDynamicsOfAUser:
    @pytest.fixture
    def register(self, monkeypatch):
        registered = {}
        monkeypatch.setattr("sb3_adaptive_q.vec_env.dynamics._registered", registered)

        def register(dynamics):
            register_dynamics(Walk)(dynamics)
            return [lambda: Monitor(TimeLimit(Walk(), 20))]

        return register

    @pytest.mark.parametrize("n_envs", [1, 3])
    def test_numbers_as_states_and_actions_that_count_from_1(self, register, n_envs):
        env_fns = register(WalkDynamics) * n_envs
        ordinary, compiled_ = (
            learn(TabularQ("MlpPolicy", kind(env_fns), seed=1, method=7), 9_000) for kind in (LeanVecEnv, CompiledVecEnv)
        )
        assert len(set(ordinary.lengths.tolist())) > 5
        assert_same(compiled_, ordinary)

    def test_a_step_that_differs(self, register):
        class Backward(WalkDynamics):
            @staticmethod
            def step(parameters, state, action, generator):
                forward = (generator.random() < 0.75) == (action == 0)
                state = max(state + (1 if forward else -1), 0)
                return state, 1.0 if state == 4 else 0.0, state == 4

        with refused("Walk", "does not step as Backward", "state", LEAN):
            CompiledVecEnv(register(Backward))

    def test_a_reset_that_differs(self, register):
        class FromTheEdge(WalkDynamics):
            @staticmethod
            def reset(parameters, generator):
                return 0

        with refused("after a reset", "state", LEAN):
            CompiledVecEnv(register(FromTheEdge))

    def test_an_index_that_differs(self, register):
        class Backward(WalkDynamics):
            @staticmethod
            def index(parameters, state):
                return 4 - state

        class Beyond(WalkDynamics):
            @staticmethod
            def index(parameters, state):
                return state + 1000

        for dynamics in (Backward, Beyond):
            with refused("row of the table", LEAN):
                CompiledVecEnv(register(dynamics))

    def test_an_index_that_leaves_the_table(self, register, monkeypatch):
        """Where the comparison at the start did not meet it."""

        class Leaving(WalkDynamics):
            @staticmethod
            def index(parameters, state):
                return state + 5 if state == 4 else state

        monkeypatch.setattr("sb3_adaptive_q.vec_env.compiled_vec_env.compare_with_environment", lambda twin: None)
        model = TabularQ("MlpPolicy", CompiledVecEnv(register(Leaving)), seed=0)
        with refused("index", "0 to 4", "gave 9"):
            model.learn(10_000)

    @pytest.mark.parametrize("reward", ["float('nan')", "1e300"])
    def test_a_reward_that_is_not_finite(self, register, monkeypatch, reward):
        class Broken(WalkDynamics):
            @staticmethod
            def step(parameters, state, action, generator):
                state = state + 1
                return state, np.inf if state == 4 else 0.0, state == 4

        class Huge(WalkDynamics):
            @staticmethod
            def step(parameters, state, action, generator):
                state = state + 1
                return state, 1e300 if state == 4 else 0.0, state == 4

        monkeypatch.setattr("sb3_adaptive_q.vec_env.compiled_vec_env.compare_with_environment", lambda twin: None)
        model = TabularQ("MlpPolicy", CompiledVecEnv(register(Huge if reward == "1e300" else Broken)), seed=0)
        with refused("finite", "step 2", "inf", "state 3"):
            model.learn(10_000)
        assert not model.q_table.any()

    def test_what_does_not_compile(self, register):
        class Texts(WalkDynamics):
            @staticmethod
            def index(parameters, state):
                return {"state": [state, ""]}["state"][0]

        model = TabularQ("MlpPolicy", CompiledVecEnv(register(Texts)))
        with refused("Texts", "not compile", LEAN):
            model.learn(100)


def test_mountain_car_is_registered_by_its_module():
    assert MountainCarDynamics.__module__ == "helpers.mountain_car"
