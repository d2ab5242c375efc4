"""The table of what every argument has to be: values that pass, values that do not, and the words for it."""

import inspect
import math
from dataclasses import fields
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import torch as th
from stable_baselines3.common.callbacks import BaseCallback, CallbackList, EveryNTimesteps
from stable_baselines3.common.env_util import make_vec_env

from sb3_adaptive_q import ALGORITHMS, CompiledVecEnv, TabularQ, learn_many, method
from sb3_adaptive_q.checks import ATTRIBUTES, CHECKS, CONSTRUCTOR, EXECUTION, LEAGUE, LOAD, STUDY, check
from sb3_adaptive_q.experiments.errors import DesignError
from sb3_adaptive_q.experiments.league.settings import LeagueSettings
from sb3_adaptive_q.experiments.paper.settings import StudySettings
from sb3_adaptive_q.experiments.runner import Execution


class Silent(BaseCallback):
    def _on_step(self):
        return True


def constant(progress_remaining):
    return 0.5


SILENT = Silent()
ALL = CallbackList([Silent()])

NO_NUMBERS = ("abc", "1", None, [1], {}, 1j, math.nan, np.nan, np.array([1.0]), b"1", object())
INFINITE = (math.inf, -math.inf, np.inf)

RATE_GOOD = [(0, 0.0), (1, 1.0), (0.25, 0.25), (np.float64(0.5), 0.5), (np.float32(0.5), 0.5), (np.int64(1), 1.0)]
RATE_GOOD += [(np.array(0.5), 0.5), (th.tensor(0.5), 0.5), (Fraction(1, 4), 0.25)]
RATE_BAD = (*NO_NUMBERS, *INFINITE, -0.001, 1.001, 7, True, False)
RATE = (RATE_GOOD, RATE_BAD, "a number from 0 to 1")

FINITE = ([*RATE_GOOD, (-3, -3.0), (1e300, 1e300)], (*NO_NUMBERS, *INFINITE, True, 10**400), "a finite number")

WHOLE_GOOD = [(1, 1), (300, 300), (1e6, 1_000_000), (np.int64(5), 5), (np.uint8(5), 5), (np.float32(4), 4), (np.array(3), 3)]
WHOLE_BAD = (*NO_NUMBERS, *INFINITE, 0, -1, 1.5, True)

FLAG = ([(True, True), (False, False), (np.True_, True), (0, False), (1, True)], ("abc", "", None, 2, -1, 0.5, [], np.ones(2)),
        "True or False")  # fmt: skip
MAPPING = ([({}, {}), ({"a": 1}, {"a": 1}), (None, None)], ([], "abc", 7, [("a", 1)], True), "a dict of arguments, or None")


def without_none(values):
    return tuple(value for value in values if value is not None)


#: For each argument: values with what they become, values that are refused, and the words of the message
TABLE = {
    "learning_rate": (
        [*RATE_GOOD, (constant, constant)],
        RATE_BAD,
        "a number from 0 to 1, or a function of the remaining pro",
    ),
    "gamma": RATE,
    "method_kwargs": MAPPING,
    "exploration_fraction": RATE,
    "exploration_initial_eps": RATE,
    "exploration_final_eps": RATE,
    "initial_q": (
        FINITE[0],
        ("abc", None, {}, 1j, math.nan, *INFINITE, True, [[1.0, math.nan]], [[1], [1, 2]], np.array(["a"]), np.ones(2, bool)),
        "a finite number or an array of finite numbers",
    ),
    "total_episodes": (
        [*WHOLE_GOOD, (None, None)],
        without_none((*WHOLE_BAD, 2**63)),
        "a whole number from 1 to 4611686018427387904",
    ),
    "callback_interval": (
        [*WHOLE_GOOD, (None, None), (10**8, 10**8)],
        without_none((*WHOLE_BAD, 10**12, 10**8 + 1)),
        "a whole number from 1 to 100000000, or None for",
    ),
    "stats_window_size": (WHOLE_GOOD, (*WHOLE_BAD, 10**12), "a whole number from 1 to 100000000"),
    "tensorboard_log": (
        [("logs", "logs"), (Path("a"), "a"), (None, None)],
        (7, ["logs"], True),
        "the path of a folder, or None for no log",
    ),
    "policy_kwargs": MAPPING,
    "verbose": (
        [(0, 0), (2, 2), (True, 1), (False, 0), (np.int64(1), 1)],
        (*NO_NUMBERS, -1, 0.5),
        "a whole number of at least 0",
    ),
    "seed": (
        [*WHOLE_GOOD, (0, 0), (2**32 - 1, 2**32 - 1), (None, None)],
        without_none((*NO_NUMBERS, *INFINITE, -1, 1.5, True, 2**32, 10**30)),
        "a whole number from 0 to 4294967295, or None for a new one every time",
    ),
    "total_timesteps": (
        [*WHOLE_GOOD, (0, 0), (2**62, 2**62), (2**63 - 1, 2**62), (1e300, 2**62), (10**5000, 2**62)],
        (*NO_NUMBERS, *INFINITE, -1, 1.5, True),
        "a whole number of at least 0, but got",
    ),
    "callback": (
        [(SILENT, SILENT), (ALL, ALL), (constant, constant), (None, None), ([], [])],
        (7, "abc", (SILENT,), [SILENT, constant], [7], Silent, EveryNTimesteps),
        "a callback, a list of callbacks, or a function of two arguments, or None",
    ),
    "log_interval": (
        [*WHOLE_GOOD, (None, None), (10**30, 10**30)],
        without_none(WHOLE_BAD),
        "a whole number of at least 1, or None for no log",
    ),
    "tb_log_name": ([("run", "run"), ("", ""), (None, None)], (7, ["run"], b"run"), "the name of a run, or None for"),
    "reset_num_timesteps": FLAG,
    "progress_bar": FLAG,
    "workers": (
        [*WHOLE_GOOD[:2], (1024, 1024), (None, None)],
        without_none((*WHOLE_BAD, 1025, 10**9)),
        "a whole number from 1 to 1024, or None for the number of cores",
    ),
    "mu": RATE,
    "mu_0": ([*RATE_GOOD, (None, None)], without_none(RATE_BAD), "a number from 0 to 1, or None for what the functions give"),
    "beta": RATE,
    "beta_1": RATE,
    "beta_3": FINITE,
    "scope": ([("pair", "pair"), ("shared", "shared")], ("all", None, 1), "one of pair, state, shared"),
    "memory": (
        [({"visits": 1}, {"visits": 1.0}), ({}, {}), (None, None)],
        (7, ["visits"], {"visits": "0"}, {"visits": math.nan}, {1: 1.0}),
        "a dict of finite numbers by name, or None",
    ),
    "exploration": ([("boltzmann", "boltzmann")], ("softmax", None, 1, ["boltzmann"]), "one of epsilon_greedy, boltzmann"),
    "ties": ([("first", "first")], ("last", None), "one of random, first"),
    "exploration_schedule": (
        [("linear", "linear"), (constant, constant)],
        ("cosine", None, 0.5, np.array(["linear"])),
        "one of linear, exponential, constant, or a function of the progress",
    ),
    "use_masking": FLAG,
    "custom_objects": MAPPING,
    "print_system_info": FLAG,
    "force_reset": FLAG,
    "allow_pickle": FLAG,
    "lower": RATE,
    "upper": RATE,
    "gain": FINITE,
    "step": FINITE,
    "next_action": (
        [("same", "same"), (np.str_("max"), "max")],
        ("Same", "mean", None, 1, ["max"], ""),
        "one of same, next, max",
    ),
    "reset_each_episode": FLAG,
}


def test_every_argument_has_its_line_here():
    assert TABLE.keys() == CHECKS.keys()


@pytest.mark.parametrize("function", [TabularQ.__init__, TabularQ.learn, TabularQ.load, learn_many])
def test_every_argument_of_the_public_functions_is_in_the_table(function):
    """Apart from those that other modules look after."""
    elsewhere = {"self", "policy", "env", "method", "device", "_init_setup_model", "models", "path", "kwargs"}
    assert set(inspect.signature(function).parameters) - elsewhere <= CHECKS.keys()


@pytest.mark.parametrize("algorithm", ALGORITHMS.values())
def test_every_argument_of_an_algorithm_is_checked(algorithm):
    further = set(inspect.signature(algorithm.__init__).parameters) - {"self", "policy", "env", "args", "kwargs"}
    further -= {"method", "device", "_init_setup_model"}
    assert further <= algorithm("MlpPolicy", "FrozenLake-v1").argument_checks().keys()


@pytest.mark.parametrize(("options", "table"), [(StudySettings, STUDY), (LeagueSettings, LEAGUE), (Execution, EXECUTION)])
def test_every_number_of_an_experiment_is_in_the_table(options, table):
    """Names are looked up elsewhere, each among others of its kind."""
    numbers = {each.name for each in fields(options) if isinstance(each.default, int | float | None)}
    assert numbers - {"dask", "tracks"} <= table.keys()
    for name in numbers - {"dask", "tracks"}:
        for value in ("abc", math.nan, 10**23 if name in ("runs", "workers") else [1]):
            with pytest.raises(DesignError, match=f"`{name}` must be "):
                options(**{name: value})
    name = "workers" if options is Execution else "runs"
    assert type(getattr(options(**{name: np.int64(7)}), name)) is int


@pytest.mark.parametrize("name", TABLE)
def test_what_passes_becomes_a_plain_type(name):
    for value, expected in TABLE[name][0]:
        converted = check(name, value)
        assert converted == expected
        assert type(converted) is type(expected)


@pytest.mark.parametrize("name", TABLE)
def test_what_does_not_pass_is_told_what_was_expected(name):
    _, bad, words = TABLE[name]
    for value in bad:
        with pytest.raises(ValueError, match="but got ") as raised:
            check(name, value)
        assert str(raised.value).startswith(f"`{name}` must be {words}")


def test_the_message():
    with pytest.raises(ValueError) as raised:
        check("log_interval", "abc")
    assert str(raised.value) == "`log_interval` must be a whole number of at least 1, or None for no log, but got 'abc'."


def test_long_values_are_cut_short():
    for value in (["a"] * 10**6, "a" * 10**6, 10**5000, np.zeros(10**6)):
        with pytest.raises(ValueError) as raised:
            check("gamma", value)
        assert len(str(raised.value)) < 400


def test_arrays_of_values_to_start_from():
    for given in ([[1, 2], [3, 4]], np.array([[1, 2], [3, 4]], np.float32), ((1, 2), (3, 4))):
        values = check("initial_q", given)
        assert values.dtype == np.float64
        np.testing.assert_array_equal(values, [[1, 2], [3, 4]])
    given = np.ones((2, 2))
    assert check("initial_q", given) is not given


def test_errors_of_the_users_own_functions_are_not_hidden():
    """A schedule is not called here."""

    def failing(progress_remaining):
        raise RuntimeError

    assert check("learning_rate", failing) is failing


class TestWhereTheyEnter:
    """Every argument is checked where it enters, whatever the table says of it, and before anything changes."""

    @pytest.mark.parametrize("name", CONSTRUCTOR)
    def test_the_constructor(self, name):
        bad = TABLE[name][1][0]
        with pytest.raises(ValueError, match=f"`{name}` must be "):
            TabularQ("MlpPolicy", "FrozenLake-v1", **{name: bad})

    @pytest.mark.parametrize("name", sorted(set(CONSTRUCTOR) - {"policy_kwargs"}))
    def test_an_attribute_that_was_set_counts_at_the_next_call_of_learn(self, name):
        model = TabularQ("MlpPolicy", "FrozenLake-v1", seed=0)
        setattr(model, ATTRIBUTES.get(name, name), TABLE[name][1][0])
        with pytest.raises(ValueError, match=f"`{name}` must be "):
            model.learn(10)
        assert model.num_timesteps == 0

    @pytest.mark.parametrize("name", [*inspect.signature(TabularQ.learn).parameters][1:])
    def test_learn(self, name):
        model = TabularQ("MlpPolicy", "FrozenLake-v1", seed=0).learn(30)
        table = model.q_table.copy()
        for bad in TABLE[name][1]:
            with pytest.raises(ValueError, match=f"`{name}` must be "):
                model.learn(**{"total_timesteps": 10, name: bad})
        assert model.num_timesteps == 30
        np.testing.assert_array_equal(model.q_table, table)

    @pytest.mark.parametrize("name", [*inspect.signature(learn_many).parameters][1:])
    def test_learn_many(self, name):
        model = TabularQ("MlpPolicy", make_vec_env("FrozenLake-v1", vec_env_cls=CompiledVecEnv), seed=0)
        for bad in TABLE[name][1]:
            with pytest.raises(ValueError, match=f"`{name}` must be "):
                learn_many([model], **{"total_timesteps": 10, name: bad})
        for models in (7, None, "ab", [7], model):
            with pytest.raises(ValueError, match="`models` must be a list of models"):
                learn_many(models, 10)
        assert model.num_timesteps == 0

    def test_load(self, tmp_path):
        TabularQ("MlpPolicy", "FrozenLake-v1", seed=0).learn(30).save(tmp_path / "model")
        for name in LOAD:
            with pytest.raises(ValueError, match=f"^`{name}` must be "):
                TabularQ.load(tmp_path / "model", **{name: "abc"})
        for name in set(CONSTRUCTOR) - {"policy_kwargs"}:
            with pytest.raises(ValueError, match=f"`{name}` must be "):
                TabularQ.load(tmp_path / "model", **{name: TABLE[name][1][0]})
        with pytest.raises(ValueError, match="`load` got `gama`, but a TabularQ has no such argument: did you mean `gamma`"):
            TabularQ.load(tmp_path / "model", gama=0.9)
        assert TabularQ.load(tmp_path / "model", stats_window_size=7)._stats_window_size == 7

    def test_methods(self):
        for number, names in (
            (1, ["beta"]),
            (3, ["beta_1", "beta_3"]),
            (5, ["gain", "mu_0", "lower"]),
            (7, ["step", "upper"]),
        ):
            for name in names:
                for bad in without_none(TABLE[name][1]):
                    with pytest.raises(ValueError, match=f"`{name}` must be "):
                        method(number, **{name: bad})
        for name in ("next_action", "reset_each_episode"):
            for bad in TABLE[name][1]:
                with pytest.raises(ValueError, match=f"`{name}` must be "):
                    method(5, **{name: bad})
        for bad in TABLE["scope"][1]:
            with pytest.raises(ValueError, match="`scope` must be "):
                method("polynomial", scope=bad)

    def test_numpys_integers_are_as_good_as_pythons(self):
        tables = []
        for kind in (int, np.int64, np.uint8):
            model = TabularQ("MlpPolicy", "FrozenLake-v1", seed=kind(7), stats_window_size=kind(20), total_episodes=kind(9))
            tables.append(model.learn(kind(200), log_interval=kind(3)).q_table)
            assert len(model.ep_info_buffer) == 9
        np.testing.assert_array_equal(tables[0], tables[1])
        np.testing.assert_array_equal(tables[0], tables[2])
        model.set_random_seed(np.int64(3))
        with pytest.raises(ValueError, match="`seed` must be"):
            model.set_random_seed("abc")
