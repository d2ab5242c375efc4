"""Finite observation spaces of every kind: their rows, learning on them, and the actions asked for their observations."""

import itertools
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from helpers.environments import Episode, RenumberObservation, SampledEnv, ScriptedEnv, Step
from hypothesis import given
from hypothesis import strategies as st
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import DummyVecEnv

from sb3_adaptive_q import CompiledVecEnv, LeanVecEnv, TabularQ
from sb3_adaptive_q.policies import TabularQPolicy
from sb3_adaptive_q.random_numbers import random_float
from sb3_adaptive_q.state_index import is_finite, make_state_index
from sb3_adaptive_q.vec_env import Dynamics, register_dynamics

CARDS = spaces.Tuple([spaces.Discrete(32), spaces.Discrete(11), spaces.Discrete(2)])
ROOM = spaces.Dict({"place": spaces.MultiDiscrete([2, 3], start=[1, -1]), "door": spaces.Discrete(2, start=5)})


def flat_spaces() -> st.SearchStrategy[spaces.Space[Any]]:
    sizes = st.lists(st.integers(1, 3), min_size=1, max_size=3)
    return st.one_of(
        st.builds(lambda n, start: spaces.Discrete(n, start=start), st.integers(1, 4), st.integers(-3, 3)),
        st.builds(lambda nvec: spaces.MultiDiscrete(nvec, start=[2] * len(nvec)), sizes),
        st.builds(spaces.MultiBinary, st.integers(1, 2)),
        st.just(spaces.MultiDiscrete([[2, 1], [1, 2]])),
        st.just(spaces.Discrete(3, dtype=np.int32)),
    )


def finite_spaces() -> st.SearchStrategy[spaces.Space[Any]]:
    def composite(parts: Any) -> Any:
        listed = st.lists(parts, min_size=1, max_size=2)
        return st.one_of(listed.map(spaces.Tuple), listed.map(lambda inner: spaces.Dict(dict(zip("ba", inner, strict=False)))))

    return st.recursive(flat_spaces(), composite, max_leaves=3)


def every_observation(space: Any) -> list[Any]:
    """All observations of a space, the last component changing fastest."""
    if isinstance(space, spaces.Discrete):
        return [int(space.start + k) for k in range(space.n)]
    if isinstance(space, spaces.MultiBinary):
        return [np.array(bits, np.int8).reshape(space.shape) for bits in itertools.product((0, 1), repeat=space.n)]
    if isinstance(space, spaces.MultiDiscrete):
        ranges = [range(start, start + size) for start, size in zip(space.start.ravel(), space.nvec.ravel(), strict=True)]
        return [np.array(values).reshape(space.shape) for values in itertools.product(*ranges)]
    if isinstance(space, spaces.Tuple):
        return list(itertools.product(*map(every_observation, space.spaces)))
    parts = [every_observation(part) for part in space.spaces.values()]
    return [dict(zip(space.spaces, values, strict=True)) for values in itertools.product(*parts)]


def assert_equal(ours: Any, theirs: Any) -> None:
    if isinstance(theirs, dict):
        assert list(ours) == list(theirs)
        for key, value in theirs.items():
            assert_equal(ours[key], value)
    elif isinstance(theirs, tuple):
        assert isinstance(ours, tuple) and len(ours) == len(theirs)
        for one, other in zip(ours, theirs, strict=True):
            assert_equal(one, other)
    else:
        np.testing.assert_array_equal(ours, theirs)
        assert np.shape(ours) == np.shape(theirs)


def stacked(space: Any, observations: list[Any]) -> Any:
    """Observations as a VecEnv hands them on."""
    if isinstance(space, spaces.Tuple):
        return tuple(stacked(part, [one[k] for one in observations]) for k, part in enumerate(space.spaces))
    if isinstance(space, spaces.Dict):
        return {key: stacked(part, [one[key] for one in observations]) for key, part in space.spaces.items()}
    return np.array(observations).astype(space.dtype)


class TestRows:
    @given(space=finite_spaces(), seed=st.integers(0, 100))
    def test_they_count_the_observations_in_order(self, space, seed):
        index, every = make_state_index(space), every_observation(space)
        rows = np.arange(len(every))
        assert index.n_states == len(every)
        assert [index.of(observation) for observation in every] == rows.tolist()
        assert index.of_vec(stacked(space, every)) == rows.tolist()
        np.testing.assert_array_equal(index.of_batch(stacked(space, every)), rows)
        np.testing.assert_array_equal(index.of_several(every), rows)
        assert_equal(index.observations(rows), stacked(space, every))
        for row in rows:
            assert_equal(index.observation(int(row)), every[row])
            assert space.contains(index.observation(int(row)))
        space.seed(seed)
        sample = space.sample()
        assert index.is_single(sample)
        assert not index.is_single(stacked(space, [sample, sample]))
        assert_equal(index.observation(index.of(sample)), sample)

    def test_rows_are_pythons_numbers(self):
        for space, observation in (
            (CARDS, (3, 2, 1)),
            (spaces.Discrete(5), np.int64(3)),
            (ROOM, {"place": [2, 0], "door": 6}),
        ):
            assert type(make_state_index(space).of(observation)) is int

    def test_the_keys_of_a_dict_come_in_the_order_of_the_space(self):
        """gymnasium sorts the keys of a plain dict, and leaves those of pairs as they are."""
        sizes = [("b", spaces.Discrete(2)), ("a", spaces.Discrete(5))]
        assert make_state_index(spaces.Dict(sizes)).of({"a": 3, "b": 1}) == 1 * 5 + 3
        assert make_state_index(spaces.Dict(dict(sizes))).of({"b": 1, "a": 3}) == 3 * 2 + 1

    def test_whole_numbers_may_be_floats(self):
        index = make_state_index(CARDS)
        assert index.of((3.0, np.float32(2), np.array(1.0))) == (3 * 11 + 2) * 2 + 1
        assert index.of_vec((np.array([3.0]), np.array([2.0]), np.array([True]))) == [(3 * 11 + 2) * 2 + 1]
        assert make_state_index(spaces.MultiDiscrete([4, 3])).of_vec(np.array([[2.0, 1.0]])) == [7]


class TestOutside:
    OUTSIDE = (
        (spaces.Discrete(4), 4, r"observation 4 lies outside .*Discrete\(4\)"),
        (spaces.Discrete(4, start=2), 1, r"observation 1 lies outside"),
        (spaces.Discrete(4), 1.5, r"observation 1\.5 lies outside"),
        (spaces.Discrete(4), np.nan, r"observation nan lies outside"),
        (spaces.Discrete(4), np.inf, r"observation inf lies outside"),
        (spaces.Discrete(4), None, r"observation None lies outside"),
        (spaces.Discrete(4), "1", r"observation 1 lies outside"),
        (spaces.Discrete(4), 2**70, r"lies outside"),
        (spaces.MultiDiscrete([3, 2]), [0, 2], r"observation \[0 2\] lies outside"),
        (spaces.MultiDiscrete([3, 2]), [0.5, 1], r"observation \[0\.5 1\. ?\] lies outside"),
        (spaces.MultiDiscrete([3, 2]), [0, -1], r"lies outside"),
        (spaces.MultiDiscrete([3, 2]), [1], r"has the shape \(2,\), .*but got \[1\]"),
        (spaces.MultiBinary(2), [0, 2], r"lies outside"),
        (CARDS, (1, 11, 0), r"part \[1\] of the observation, 11, lies outside .*Discrete\(11\)"),
        (CARDS, (1, 1), r"tuple of 3 parts, but got \(1, 1\)"),
        (CARDS, None, r"tuple of 3 parts, but got None"),
        (ROOM, {"door": 5}, r"dict with the keys \['door', 'place'\], but got \{'door': 5\}"),
        (ROOM, {"door": 5, "place": [1, 2]}, r"part \['place'\] of the observation, \[1 2\], lies outside"),
        (spaces.Dict(a=spaces.Tuple([CARDS])), {"a": ((1, 2, 3),)}, r"part \['a'\]\[0\]\[2\] of the observation, 3, "),
    )

    @pytest.mark.parametrize(("space", "observation", "message"), OUTSIDE)
    def test_one_observation(self, space, observation, message):
        with pytest.raises(ValueError, match=message):
            make_state_index(space).of(observation)

    @pytest.mark.parametrize(
        ("space", "observations", "message"),
        [
            (spaces.Discrete(4), np.array([0, 4]), "observation 4 lies outside"),
            (spaces.Discrete(4), np.array([-1, 0]), "observation -1 lies outside"),
            (spaces.Discrete(4, start=2), np.array([2, 1]), "observation 1 lies outside"),
            (spaces.Discrete(4), np.array([0, 1.5]), r"observation 1\.5 lies outside"),
            (spaces.Discrete(4), np.array([0, np.nan]), "observation nan lies outside"),
            (spaces.Discrete(4), np.array([0, np.inf]), "observation inf lies outside"),
            (spaces.Discrete(4), np.array([0, None]), "lies outside"),
            (spaces.Discrete(4), np.array([2**64 - 1, 0], np.uint64), "lies outside"),
            (spaces.Discrete(4), np.array([[1], [2]]), r"but got array\(\[\[1\],"),
            (spaces.MultiDiscrete([3, 2]), np.array([[0, 0], [0, 2]]), r"observation \[0 2\] lies outside"),
            (spaces.MultiDiscrete([3, 2]), np.array([[0, -1], [0, 0]]), r"observation \[ 0 -1\] lies outside"),
            (spaces.MultiDiscrete([3, 2]), np.array([[0, 0], [0.5, 1]]), r"observation \[0\.5 1\. \] lies outside"),
            (spaces.MultiDiscrete([3, 2]), np.array([[1], [1]]), r"has the shape \(2,\), .*but got"),
            (spaces.MultiBinary(2), np.array([[0, 1], [2, 0]]), r"observation \[2 0\] lies outside"),
            (
                CARDS,
                (np.array([1, 2]), np.array([3, 11]), np.array([0, 0])),
                r"part \[1\] of the observation, 11, lies outside",
            ),
            (
                ROOM,
                {"door": np.array([7]), "place": np.array([[1, 1]])},
                r"part \['door'\] of the observation, 7, lies outside",
            ),
        ],
        ids=str,
    )
    def test_one_of_several(self, space, observations, message):
        index = make_state_index(space)
        for rows_of in (index.of_vec, index.of_batch):
            with pytest.raises(ValueError, match=message):
                rows_of(observations)

    def test_parts_of_different_lengths(self):
        with pytest.raises(ValueError, match=r"must have as many observations as the others, but got \[2, 1, 2\]"):
            make_state_index(CARDS).of_batch((np.array([1, 2]), np.array([1]), np.array([0, 0])))


class TestRefusedSpaces:
    @pytest.mark.parametrize(
        ("space", "message"),
        [
            (spaces.Box(-1.0, 1.0, (2,)), r"but got Box.*wrappers\.DiscretizeObservation"),
            (spaces.Text(5), r"but got Text.*gymnasium\.ObservationWrapper"),
            (spaces.Tuple([]), r"but got Tuple\(\)"),
            (spaces.Dict(name=spaces.Text(5), n=spaces.Discrete(2)), r"its part \['name'\] is Text.*ObservationWrapper"),
            (spaces.Tuple([spaces.Discrete(2), spaces.Box(0.0, 1.0)]), r"its part \[1\] is Box.*FlattenObservation"),
            (spaces.Dict(a=spaces.Tuple([spaces.Graph(spaces.Discrete(2), None)])), r"its part \['a'\]\[0\] is Graph"),
        ],
        ids=str,
    )
    def test_the_part_is_named(self, space, message):
        with pytest.raises(ValueError, match=r"needs a Discrete, MultiDiscrete or MultiBinary .*Tuple or Dict of these"):
            make_state_index(space)
        with pytest.raises(ValueError, match=message):
            TabularQ("MlpPolicy", SampledEnv(spaces.Discrete(2), spaces.Discrete(2))).policy_class(
                space, spaces.Discrete(2), lambda _: 0.1
            )
        assert not is_finite(space)

    def test_a_space_of_ones_own(self):
        class Colours(spaces.Space):
            pass

        with pytest.raises(ValueError, match=r"its part \['sky'\] is .*Colours"):
            make_state_index(spaces.Dict(sky=Colours(), n=spaces.Discrete(2)))

    def test_finite_ones(self):
        assert is_finite(CARDS) and is_finite(ROOM) and is_finite(spaces.Discrete(3))


def policy_for(space: spaces.Space[Any], seed: int = 0) -> TabularQPolicy:
    """A policy with other best actions in neighbouring rows."""
    policy = TabularQPolicy(space, spaces.Discrete(3, start=4), lambda _: 0.1)
    policy.q_table[:] = th.from_numpy(np.random.default_rng(seed).random(policy.q_table.shape))
    return policy


class TestPredict:
    ONE = (
        (spaces.Discrete(5, start=1), 4, [4, 4.0, np.int64(4), np.int32(4), np.array(4), np.array(4.0)]),
        (spaces.MultiDiscrete([4, 3]), (2, 1), [(2, 1), [2, 1], np.array([2, 1]), np.array([2.0, 1.0]), (np.int64(2), 1)]),
        (spaces.MultiBinary(2), (1, 0), [(1, 0), [1, 0], np.array([1, 0], np.int8), np.array([True, False])]),
        (CARDS, (14, 10, 0), [(14, 10, 0), [14, 10, 0], np.array([14, 10, 0]), (np.int64(14), np.array(10), 0.0)]),
        (
            ROOM,
            {"place": [2, 0], "door": 6},
            [{"door": np.array(6), "place": np.array([2, 0])}, {"place": (2, 0), "door": np.int64(6)}],
        ),
        (spaces.Tuple([ROOM, spaces.Discrete(2)]), ({"place": [2, 0], "door": 6}, 1), [[{"place": (2, 0), "door": 6}, 1]]),
        (spaces.Tuple([spaces.Discrete(2), ROOM]), (1, {"place": [2, 0], "door": 6}), [(1, {"place": (2, 0), "door": 6})]),
    )

    @pytest.mark.parametrize(("space", "observation", "forms"), ONE, ids=str)
    def test_one_observation_gives_a_number(self, space, observation, forms):
        policy = policy_for(space)
        expected = 4 + int(policy.q_table[make_state_index(space).of(observation)].argmax())
        for form in forms:
            action, state = policy.predict(form, state=(np.ones(1),))
            assert type(action) is np.int64
            assert {expected: "found"}[action] == "found"
            assert state == (np.ones(1),)

    SEVERAL = (
        (spaces.Discrete(5, start=1), [4, 1, 2], [np.array([4, 1, 2]), (4, 1, 2), np.array([4.0, 1.0, 2.0])]),
        (spaces.MultiDiscrete([4, 3]), [(2, 1), (0, 0)], [np.array([[2, 1], [0, 0]]), [[2, 1], [0, 0]], ((2, 1), (0, 0))]),
        (spaces.MultiBinary(2), [(1, 0)], [np.array([[1, 0]], np.int8)]),
        (
            CARDS,
            [(14, 10, 0), (4, 1, 1), (21, 3, 0)],
            [
                (np.array([14, 4, 21]), np.array([10, 1, 3]), np.array([0, 1, 0])),
                np.array([(14, 10, 0), (4, 1, 1), (21, 3, 0)]),
                [[14, 10, 0], (4, 1, 1), np.array([21, 3, 0])],
            ],
        ),
        (
            ROOM,
            [{"place": [2, 0], "door": 6}, {"place": [1, -1], "door": 5}],
            [{"place": np.array([[2, 0], [1, -1]]), "door": np.array([6, 5])}],
        ),
        (
            spaces.Tuple([spaces.Discrete(2), ROOM]),
            [(1, {"place": [2, 0], "door": 6}), (0, {"place": [1, 1], "door": 5})],
            [(np.array([1, 0]), {"place": np.array([[2, 0], [1, 1]]), "door": np.array([6, 5])})],
        ),
    )

    @pytest.mark.parametrize(("space", "observations", "forms"), SEVERAL, ids=str)
    def test_several_observations_give_an_array(self, space, observations, forms):
        policy = policy_for(space)
        rows = [make_state_index(space).of(observation) for observation in observations]
        expected = 4 + policy.q_table.numpy()[rows].argmax(axis=1)
        for form in [observations, *forms]:
            actions, _ = policy.predict(form)
            assert isinstance(actions, np.ndarray) and actions.shape == (len(observations),)
            np.testing.assert_array_equal(actions, expected)

    def test_none_of_them(self):
        assert policy_for(spaces.Discrete(3)).predict(np.zeros(0, int))[0].shape == (0,)
        assert policy_for(CARDS).predict([])[0].shape == (0,)

    @pytest.mark.parametrize(
        ("space", "observation"), [(spaces.Discrete(5), 3), (CARDS, (14, 10, 0)), (spaces.MultiBinary(2), np.array([1, 0]))]
    )
    def test_what_a_reset_returns(self, space, observation):
        with pytest.raises(ValueError, match=r"a tuple of an observation and a dict.*env\.reset"):
            policy_for(space).predict((observation, {}))

    @pytest.mark.parametrize(
        ("space", "observation"),
        [(spaces.Discrete(5), [[1, 2]]), (spaces.Discrete(5), [[1], [2, 3]]), (spaces.MultiDiscrete([2, 2]), [[1], [1, 1]]),
         (spaces.MultiDiscrete([2, 2]), 1), (CARDS, [1, 2]), (CARDS, {}), (ROOM, (1, 2)), (ROOM, {"door": np.array([5, 6])})],
        ids=str,
    )  # fmt: skip
    def test_other_forms_are_refused(self, space, observation):
        with pytest.raises(ValueError, match=r"An observation of .*but got"):
            policy_for(space).predict(observation)

    @pytest.mark.parametrize("space", [spaces.Discrete(5), CARDS, ROOM, spaces.MultiDiscrete([4, 3])], ids=str)
    def test_tensors(self, space):
        """What SB3's own code hands to a policy."""
        policy = policy_for(space)
        several = stacked(space, [make_state_index(space).observation(row) for row in (3, 0)])
        if isinstance(several, tuple):
            tensors: Any = tuple(map(th.as_tensor, several))
        else:
            tensors = {k: th.as_tensor(v) for k, v in several.items()} if isinstance(several, dict) else th.as_tensor(several)
        np.testing.assert_array_equal(policy(tensors).numpy(), policy.predict(several)[0])

    def test_the_model_explores_for_all_of_them(self):
        model = TabularQ("MlpPolicy", "Blackjack-v1", seed=0, exploration_final_eps=1.0).learn(1)
        for observation, shape in (((14, 10, 0), ()), ([(14, 10, 0)] * 50, (50,))):
            actions, _ = model.predict(observation)
            assert np.shape(actions) == shape
        assert set(actions.tolist()) == {0, 1}
        assert type(model.predict((14, 10, 0))[0]) is np.int64


class Reordered(gym.ObservationWrapper):
    """Blackjack in another finite space; the rows are the same."""

    def __init__(self, env: gym.Env, space: spaces.Space[Any]) -> None:
        super().__init__(env)
        self.observation_space = space

    def observation(self, observation: Any) -> Any:
        if isinstance(self.observation_space, spaces.Discrete):
            return int(np.ravel_multi_index(observation, (32, 11, 2)))
        if isinstance(self.observation_space, spaces.MultiDiscrete):
            return np.array(observation)
        if isinstance(self.observation_space, spaces.Tuple):
            return int(observation[0]), np.array(observation[1:])
        return {"sum": int(observation[0]), "others": observation[1:]}


class TestLearning:
    SPACES = (
        CARDS,
        spaces.Discrete(704),
        spaces.Tuple([spaces.Discrete(32), spaces.MultiDiscrete([11, 2])]),
        spaces.Dict([("sum", spaces.Discrete(32)), ("others", spaces.MultiDiscrete([11, 2]))]),
    )

    @pytest.mark.parametrize("space", SPACES, ids=str)
    @pytest.mark.parametrize("vec_env_class", [None, DummyVecEnv])
    def test_blackjack_is_learned_alike_in_every_space(self, space, vec_env_class):
        def make(inner: spaces.Space[Any]) -> gym.Env:
            env = gym.make("Blackjack-v1")
            return env if inner is CARDS else Reordered(env, inner)

        reference = TabularQ("MlpPolicy", make(spaces.MultiDiscrete([32, 11, 2])), method=7, seed=3).learn(400)
        env: Any = make(space) if vec_env_class is None else vec_env_class([lambda: make(space)])
        model = TabularQ("MlpPolicy", env, method=7, seed=3).learn(400)
        assert np.count_nonzero(model.q_table) > 100
        np.testing.assert_array_equal(model.q_table, reference.q_table)

    def test_several_environments(self):
        """Each transition is learned from by itself, whatever the form of the observations."""
        models = [
            TabularQ("MlpPolicy", LeanVecEnv([make] * 3), seed=0).learn(300)
            for make in (lambda: gym.make("Blackjack-v1"), lambda: Reordered(gym.make("Blackjack-v1"), self.SPACES[1]))
        ]
        assert np.count_nonzero(models[0].q_table) > 50
        np.testing.assert_array_equal(models[0].q_table, models[1].q_table)

    def test_saved_and_learned_on(self, tmp_path):
        model = TabularQ("MlpPolicy", "Blackjack-v1", seed=0).learn(100)
        model.save(tmp_path / "model")
        loaded = TabularQ.load(tmp_path / "model", env="Blackjack-v1")
        np.testing.assert_array_equal(loaded.q_table, model.q_table)
        loaded.learn(100, reset_num_timesteps=False)
        assert loaded.num_timesteps == 200

    @pytest.mark.filterwarnings("ignore:Evaluation environment is not wrapped")
    def test_it_plays(self):
        model = TabularQ("MlpPolicy", "Blackjack-v1", seed=0).learn(100)
        for env in (model.get_env(), gym.make("Blackjack-v1")):
            returns, lengths = evaluate_policy(model, env, 5, return_episode_rewards=True)
            assert len(returns) == 5 and set(returns) <= {-1.0, 0.0, 1.0, 1.5} and min(lengths) >= 1

    def test_a_start_and_a_type_of_its_own(self):
        """The kinds that were there before Tuple and Dict, on the lake."""
        tables = [
            TabularQ("MlpPolicy", RenumberObservation(gym.make("FrozenLake-v1"), space), initial_q=1.0, seed=0)
            .learn(200)
            .q_table
            for space in (
                spaces.Discrete(16, start=-5, dtype=np.int32),
                spaces.MultiDiscrete([4, 4], start=[1, 2]),
                spaces.MultiBinary([2, 2]),
                spaces.Discrete(16),
            )
        ]
        for table in tables[:-1]:
            np.testing.assert_array_equal(table, tables[-1])


class Corridor(gym.Env):
    """Two rows of three places; action 1 goes on, action 0 to the other row, each with a chance of 3 in 4."""

    action_space = spaces.Discrete(2)
    render_mode = None

    def __init__(self, space):
        self.observation_space = space

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.s = 0
        return self._observe(), {}

    def step(self, action):
        if self.np_random.random() < 0.75:
            self.s = self.s + 1 if action == 1 else (self.s + 3) % 6
        at_end = self.s % 3 == 2
        return self._observe(), float(at_end) * (1 + self.s // 3), at_end, False, {}

    def _observe(self):
        row, place = divmod(self.s, 3)
        return (row, place) if isinstance(self.observation_space, spaces.Tuple) else {"a": row, "b": place}


class _CorridorDynamics(Dynamics):
    draws_from_words = True
    parameters = ()

    def read_state(self):
        return int(self.env.s)

    def write_state(self, state):
        self.env.s = int(state)

    @staticmethod
    def reset(parameters, generator):
        return 0

    @staticmethod
    def step(parameters, state, action, generator):
        if random_float(generator) < 0.75:
            state = state + 1 if action == 1 else (state + 3) % 6
        at_end = state % 3 == 2
        return state, (1.0 + state // 3 if at_end else 0.0), at_end

    @staticmethod
    def index(parameters, state):
        return state


class TestCompiled:
    @pytest.mark.parametrize("kind", [spaces.Tuple, lambda parts: spaces.Dict(dict(zip("ab", parts, strict=True)))])
    @pytest.mark.parametrize("n_envs", [1, 2])
    def test_parts_are_learned_alike_on_both_paths(self, kind, n_envs, tmp_path):
        register_dynamics(Corridor)(_CorridorDynamics)
        space = kind([spaces.Discrete(2), spaces.Discrete(3)])
        models = [
            TabularQ(name, make_vec_env(lambda: Corridor(space), n_envs, vec_env_cls=cls), learning_rate=0.1, seed=0)
            for name, cls in (("MlpPolicy", LeanVecEnv), ("MultiInputPolicy", CompiledVecEnv))
        ]
        for model in models:
            model.learn(600, log_interval=None).learn(400, reset_num_timesteps=False, log_interval=None)
        np.testing.assert_array_equal(models[1].q_table, models[0].q_table)
        assert_equal(models[1]._last_obs, models[0]._last_obs)
        # By Bellman's equation: V(4) = Q(4, 1), V(1) = Q(1, 0)
        value_4 = 0.75 * 2.0 / (1.0 - 0.25 * 0.99)
        value_1 = 0.75 * 0.99 * value_4 / (1.0 - 0.25 * 0.99)
        assert models[0].q_table[[1, 4], 1] == pytest.approx([0.75 + 0.25 * 0.99 * value_1, value_4], abs=0.1)
        models[1].save(tmp_path / "model")
        loaded = TabularQ.load(tmp_path / "model", env=models[1].get_env())
        np.testing.assert_array_equal(loaded.learn(100, reset_num_timesteps=False).q_table.shape, (6, 2))


class TestWhatIsNotInTheSpace:
    def test_a_fraction_is_refused_when_learning_as_when_predicting(self):
        model = TabularQ("MlpPolicy", ScriptedEnv([Episode(0, [Step(1.0, 1.5), Step(1.0, 2)])]))
        with pytest.raises(ValueError, match=r"1\.5"):
            model.learn(5)
        with pytest.raises(ValueError, match=r"1\.5"):
            model.predict(1.5)
        assert not model.q_table.any()

    def test_a_fraction_from_another_vec_env(self):
        """One that hands on what its environments gave."""
        env = DummyVecEnv([lambda: ScriptedEnv([Episode(0, [Step(1.0, 1.5)] * 9)])])
        env.buf_obs = {None: np.zeros(1)}
        with pytest.raises(ValueError, match=r"observation 1\.5 lies outside"):
            TabularQ("MlpPolicy", env).learn(5)

    @pytest.mark.parametrize("end", ["terminated", "truncated"])
    @pytest.mark.parametrize("state", [9, -1, 2.5])
    def test_where_an_episode_ended(self, end, state):
        """Of no effect on the table where it is terminal, but a fault all the same."""
        model = TabularQ("MlpPolicy", ScriptedEnv([Episode(0, [Step(1.0, state, end)])]))
        with pytest.raises(ValueError, match=rf"observation {state} lies outside the observation space Discrete\(4\)"):
            model.learn(5)
        assert not model.q_table.any()


class TestParameters:
    def test_there_are_none(self):
        policy = TabularQ("MlpPolicy", "FrozenLake-v1").policy
        vector = policy.parameters_to_vector()
        assert isinstance(vector, np.ndarray) and vector.shape == (0,)
        policy.load_from_vector(vector)
