"""Files that are damaged, foreign or made to do harm: refused, each with a sentence that names it, and nothing of it runs."""

import base64
import copy
import hashlib
import io
import json
import pickle
import random
import struct
import warnings
import zipfile
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest
import torch as th
from gymnasium import spaces
from helpers.environments import SampledEnv
from stable_baselines3 import DQN
from stable_baselines3.common.callbacks import CheckpointCallback
from stable_baselines3.common.monitor import Monitor

from sb3_adaptive_q import CompiledVecEnv, LeanVecEnv, SARSALambda, TabularQ, model_archive
from sb3_adaptive_q.saved_values import decode_schedule, find_class, find_function

LAKE = "FrozenLake-v1"


class Payload:
    """Unpickled, it makes a file."""

    def __init__(self, marker):
        self.marker = marker

    def __reduce__(self):
        return Path.touch, (self.marker,)


@pytest.fixture
def marker(tmp_path):
    path = tmp_path / "executed"
    pickle.loads(pickle.dumps(Payload(path)))
    assert path.exists()  # the payload works
    path.unlink()
    yield path
    assert not path.exists()


@pytest.fixture(scope="module")
def content(tmp_path_factory):
    """A file with all that there can be: a table, memory, a running episode, a rollout with a transition to learn from."""
    folder = tmp_path_factory.mktemp("content")
    model = TabularQ("MlpPolicy", LAKE, seed=0, initial_q=1.0, method="polynomial")
    model.learn(200, callback=CheckpointCallback(150, folder, "x"))
    return (folder / "x_150_steps.zip").read_bytes()


@pytest.fixture
def path(tmp_path, content):
    path = tmp_path / "model.zip"
    path.write_bytes(content)
    return path


def members_of(path):
    with zipfile.ZipFile(path) as file:
        return {name: file.read(name) for name in file.namelist()}


def write(path, members, **options):
    """A file with these members, whose checksums are right."""
    sums = {name: hashlib.sha256(member).hexdigest() for name, member in members.items() if name != "checksums.json"}
    with zipfile.ZipFile(path, "w", **options) as file:
        for name, member in {**members, "checksums.json": json.dumps(sums).encode()}.items():
            file.writestr(name, member)


def forge(path, change):
    """Change the plain data of a file as somebody would who knows the format."""
    members = members_of(path)
    data = json.loads(members["data"])
    change(data)
    write(path, {**members, "data": json.dumps(data).encode()})


def forge_arrays(path, announced=None, prefix="policy.", **arrays):
    """Change arrays of a file, and what it says of them."""
    members = members_of(path)
    data, old = json.loads(members["data"]), dict(np.load(io.BytesIO(members["arrays.npz"])))
    old.update({f"{prefix}{name}": array for name, array in arrays.items()})
    packed = io.BytesIO()
    np.savez(packed, **old)
    data["arrays"] = {name: [array.dtype.str, array.shape] for name, array in old.items()} | (announced or {})
    write(path, {**members, "data": json.dumps(data).encode(), "arrays.npz": packed.getvalue()})


def refuse(path, message, take=TabularQ.load):
    """Check that a file is refused, in one sentence with its name."""
    with pytest.raises(ValueError, match=message) as caught:
        take(path)
    told = str(caught.value)
    assert str(path) in told and told.endswith(".") and len(told) < 800 and "\n" not in told
    return told


class TestNothingRuns:
    def test_a_pickle_among_the_data_is_a_text(self, path, marker):
        pickled = {":type:": "x", ":serialized:": base64.b64encode(pickle.dumps(Payload(marker))).decode()}

        def change(data):
            data["attributes"].update(gamma=0.5, notes=pickled)

        forge(path, change)
        assert TabularQ.load(path).notes == pickled

    @pytest.mark.parametrize("place", ["data", "policy.pth", "pytorch_variables.pth"])
    def test_files_of_stable_baselines_are_refused_unread(self, path, marker, place):
        pickled = base64.b64encode(pickle.dumps(Payload(marker))).decode()
        buffer = io.BytesIO()
        th.save(Payload(marker), buffer)
        with zipfile.ZipFile(path, "w") as file:
            file.writestr("data", json.dumps({"gamma": {":type:": "x", ":serialized:": pickled if place == "data" else ""}}))
            file.writestr("policy.pth" if place == "data" else place, buffer.getvalue())
        refuse(path, "holds pickled objects")
        with pytest.raises(ValueError, match="holds pickled objects"):
            TabularQ("MlpPolicy", LAKE).set_parameters(path)

    def test_arrays_of_objects_are_refused_unread(self, path, marker):
        content, objects = path.read_bytes(), np.array([Payload(marker)] * 64).reshape(16, 4)
        forge_arrays(path, q_table=objects)
        refuse(path, r"the array 'policy.q_table' is not of object")
        path.write_bytes(content)
        forge_arrays(path, {"policy.q_table": ["<f8", [16, 4]]}, q_table=objects)
        refuse(path, r"the array 'policy.q_table' is not of float64")

    @pytest.mark.parametrize(
        "name",
        ["os:system", "posix:system", "builtins:exec", "subprocess:run", "os:_exit", "shutil:rmtree", "nowhere:f", "x", ""],
    )
    def test_functions_of_python_itself_are_not_found(self, path, name):
        assert find_function(name) is None
        forge(path, lambda data: data["attributes"].update(learning_rate={":kind:": "function", "path": name}))
        TabularQ.load(path, env=LAKE).predict(0)

    def test_classes_are_no_functions(self):
        assert find_function("sb3_adaptive_q.base:TabularAlgorithm") is None
        assert find_function("gymnasium.envs.registration:make") is not None  # one that is imported, for comparison

    @pytest.mark.parametrize("name", ["builtins:object", "os:PathLike", "sb3_adaptive_q:TabularQ", "gymnasium:Env"])
    def test_only_methods_are_methods(self, path, name):
        forge(path, lambda data: data["method"].update(owner=name))
        with pytest.warns(UserWarning, match=f"The class of the saved method, {name}, is not imported"):
            TabularQ.load(path)
        with pytest.raises(LookupError):
            find_class(name, th.optim.Optimizer)

    def test_a_name_does_not_import_anything(self, path, tmp_path, monkeypatch):
        (tmp_path / "module_of_a_stranger.py").write_text("raise SystemExit")
        monkeypatch.syspath_prepend(tmp_path)
        name = "module_of_a_stranger:f"
        forge(path, lambda data: data["attributes"].update(learning_rate={":kind:": "function", "path": name}))
        forge(path, lambda data: data["method"].update(owner=name))
        with pytest.warns(UserWarning, match="not imported"):
            TabularQ.load(path)
        forge(path, lambda data: data["attributes"].update(policy_class=name))
        refuse(path, "not imported here")

    @pytest.mark.parametrize(
        "name", ["learn", "predict", "q_table", "mu", "__class__", "env", "policy", "training", "choices"]
    )
    def test_no_method_is_replaced(self, path, name):
        forge(path, lambda data: data["attributes"].update({name: 1}))
        refuse(path, f"it has the attribute '{name}', which a file must not set")

    @pytest.mark.parametrize("label", ["../../x", "a/b", "", "C:x", "a b"])
    def test_no_folder_is_named(self, path, label):
        """A method's label becomes the name of a folder for TensorBoard's files."""
        forge(path, lambda data: data["method"].update(label=label))
        refuse(path, "which is not an identifier")


class TestDamage:
    def test_random_flips_never_give_a_wrong_table(self, path, content):
        expected, numbers, refused = TabularQ.load(path), random.Random(0), 0
        for _ in range(200):
            place = numbers.randrange(8 * len(content))
            damaged = bytearray(content)
            damaged[place // 8] ^= 1 << place % 8
            path.write_bytes(damaged)
            try:
                loaded = TabularQ.load(path)
            except ValueError as error:
                assert str(path) in str(error)
                refused += 1
            else:  # a bit that says nothing, such as one of a date
                np.testing.assert_array_equal(loaded.q_table, expected.q_table)
                np.testing.assert_array_equal(loaded.memory["visits"], expected.memory["visits"])
                assert (loaded.mu, loaded.gamma, loaded.training.as_data()) == (
                    expected.mu, expected.gamma, expected.training.as_data()
                )  # fmt: skip
        assert refused > 180

    def test_flips_that_repair_the_zips_own_sum_are_found(self, path):
        members = members_of(path)
        sums = json.loads(members["checksums.json"])
        table = bytearray(members["arrays.npz"])
        table[table.index(struct.pack("<d", 1.0))] ^= 1
        with zipfile.ZipFile(path, "w") as file:
            for name, member in {**members, "arrays.npz": bytes(table), "checksums.json": json.dumps(sums).encode()}.items():
                file.writestr(name, member)
        refuse(path, "the checksum of 'arrays.npz' does not match its contents")

    @pytest.mark.parametrize("part", [0.0, 0.1, 0.5, 0.9, 0.99, 0.999])
    def test_files_that_are_cut_off(self, path, content, part):
        path.write_bytes(content[: int(part * len(content))])
        refuse(path, "is damaged, or is not a saved model")

    @pytest.mark.parametrize("content", [b"", b"PK", b"text " * 100, bytes(1000), b"PK\5\6" + bytes(18)])
    def test_files_that_are_no_zip(self, path, content):
        path.write_bytes(content)
        refuse(path, "not a saved model")

    @pytest.mark.parametrize(
        "damage",
        [
            lambda path: path.write_bytes(path.read_bytes()[:-30]),
            lambda path: forge_arrays(path, q_table=np.full((16, 4), np.nan)),
            lambda path: forge_arrays(path, memory_visits=np.full((1, 16, 4), np.nan)),
            lambda path: forge_arrays(path, mu=np.array([2.0])),
        ],
        ids=["cut off", "NaN", "memory", "step size"],
    )
    def test_a_refused_file_changes_nothing(self, path, damage):
        damage(path)
        model = TabularQ("MlpPolicy", LAKE, method="polynomial", initial_q=0.5)
        env = model.get_env()
        env.seed(7)
        seeds, state = list(env._seeds), copy.deepcopy(np.random.get_state())
        for take in (model.set_parameters, lambda path: TabularQ.load(path, env=env), lambda path: TabularQ.resume(path, env)):
            refuse(path, "damaged|must be|must hold", take)
        assert (model.q_table == 0.5).all() and model.mu != 2.0
        assert env._seeds == seeds and np.random.get_state()[1].tolist() == state[1].tolist()


class TestForeignFiles:
    def test_another_algorithms(self, path):
        DQN("MlpPolicy", "CartPole-v1", policy_kwargs={"net_arch": [2]}, buffer_size=10).save(path)
        refuse(path, "holds pickled objects, as files of Stable-Baselines3")
        refuse(path, "no table: it holds a model of another algorithm", lambda path: TabularQ.load(path, allow_pickle=True))

    @pytest.mark.parametrize("names", [["word/document.xml"], [], ["data"]])
    def test_other_zips(self, path, names):
        write(path, {name: b"{}" for name in names})
        refuse(path, "not a saved model: its members are")

    @pytest.mark.parametrize(
        ("version", "message"),
        [
            (3, "format version 3, but this package reads versions up to 2: please update"),
            ("1", "format version must be a whole number of at least 1, but is '1'"),
            (None, "format version must be a whole number of at least 1, but is None"),
            (True, "format version must be a whole number of at least 1, but is True"),
            (0, "format version must be a whole number of at least 1, but is 0"),
            (1, "format version 1, but the members of version 2"),
        ],
    )
    def test_versions(self, path, version, message):
        forge(path, lambda data: data.update(format_version=version))
        refuse(path, message)
        forge(path, lambda data: data.pop("format_version"))
        refuse(path, "it has no 'format_version'")

    def test_a_file_of_another_algorithm_of_ours_is_not_resumed(self, path):
        forge(path, lambda data: data.update(algorithm="Other"))
        with pytest.raises(ValueError, match="holds a model of Other, not of TabularQ"):
            TabularQ.resume(path, LAKE)


class TestBombs:
    def test_members_that_unfold(self, path):
        members = members_of(path)
        write(path, {**members, "data": members["data"] + b" " * 10**7}, compression=zipfile.ZIP_DEFLATED)
        assert path.stat().st_size < 10**5
        refuse(path, "its members are larger than the file itself")

    def test_arrays_that_unfold(self, path):
        members = members_of(path)
        packed = io.BytesIO()
        np.savez_compressed(packed, **{"policy.q_table": np.zeros((10**6, 4))})
        data = json.loads(members["data"]) | {"arrays": {"policy.q_table": ["<f8", [10**6, 4]]}}
        write(path, {**members, "data": json.dumps(data).encode(), "arrays.npz": packed.getvalue()})
        refuse(path, "its arrays are larger than the file itself")

    def test_shapes_that_nothing_stands_behind(self, path):
        header = io.BytesIO()
        np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": (10**12, 4)})
        members, packed = members_of(path), io.BytesIO()
        with zipfile.ZipFile(packed, "w") as file:
            file.writestr("policy.q_table.npy", header.getvalue())
        data = json.loads(members["data"]) | {"arrays": {"policy.q_table": ["<f8", [10**12, 4]]}}
        write(path, {**members, "data": json.dumps(data).encode(), "arrays.npz": packed.getvalue()})
        refuse(path, "the array 'policy.q_table' is not of float64 and the shape")

    @pytest.mark.parametrize(
        "space",
        [
            {"name": "Discrete", "n": 10**12, "start": 0, "dtype": "<i8"},
            {"name": "Discrete", "n": 10**30, "start": 0, "dtype": "<i8"},
            {"name": "Discrete", "n": -1, "start": 0, "dtype": "<i8"},
            {"name": "Discrete", "n": 16, "start": 0, "dtype": "O"},
            {"name": "MultiDiscrete", "nvec": [2] * 20_000, "start": [0] * 20_000, "dtype": "<i8"},
            {"name": "MultiDiscrete", "nvec": [10**9] * 9_000, "start": [0] * 9_000, "dtype": "<i8"},
            {"name": "MultiBinary", "n": [10**9]},
            {"name": "MultiBinary", "n": [10**5, 10**5]},
            {"name": "Text", "n": 1},
        ],
        ids=lambda space: space["name"],
    )
    def test_spaces_that_ask_for_more_than_the_file_has(self, path, space):
        forge(path, lambda data: data["attributes"].update(observation_space={":kind:": "space", **space}))
        refuse(path, "not a saved model of this package|cannot be loaded")

    def test_more_plain_data_than_a_model_has(self, path, monkeypatch):
        monkeypatch.setattr(model_archive, "MOST_DATA", 1000)
        refuse(path, "it has more than 1000 bytes of plain data")
        with pytest.raises(ValueError, match=r"may have 1000 bytes of plain data, but .*: `exclude` some"):
            TabularQ("MlpPolicy", LAKE).save(path)

    def test_nested_without_end(self, path):
        members = members_of(path)
        write(path, {**members, "data": b"[" * 10**6})
        refuse(path, "not a saved model of this package")

    @pytest.mark.parametrize("name", ["../evil", "/evil", "a/../../evil"])
    def test_names_that_leave_the_folder(self, path, tmp_path, name):
        write(path, {**members_of(path), name: b""})
        refuse(path, r"its members are .*evil")
        assert not (tmp_path.parent / "evil").exists()

    def test_a_member_twice(self, path):
        members = members_of(path)
        with warnings.catch_warnings(), zipfile.ZipFile(path, "a") as file:
            warnings.simplefilter("ignore")
            file.writestr("data", members["data"])
        refuse(path, "its members are")


class TestNumbers:
    @pytest.mark.parametrize(
        "table",
        [np.zeros((16, 3)), np.zeros((15, 4)), np.zeros(64), np.zeros((16, 4), np.float32), np.zeros((16, 4), np.int64)],
    )
    def test_tables_of_another_shape_or_type(self, path, table):
        forge_arrays(path, q_table=table)
        refuse(path, "`q_table`")

    @pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
    def test_tables_that_are_not_finite(self, path, value):
        forge_arrays(path, q_table=np.full((16, 4), value))
        refuse(path, "`q_table` must hold finite numbers, but has NaN or infinities: 64 of them")

    @pytest.mark.parametrize("memory", [np.zeros((1, 16, 3)), np.zeros((16, 4)), np.full((1, 16, 4), np.nan)])
    def test_memory_that_is_not_the_methods(self, path, memory):
        forge_arrays(path, memory_visits=memory)
        refuse(path, "`memory_visits`")

    def test_arrays_that_are_missing(self, path):
        forge(path, lambda data: data["arrays"].pop("policy.memory_visits"))
        refuse(path, "its arrays are not those that `data` lists")

    @pytest.mark.parametrize(
        ("name", "value"),
        [
            ("mu", 2.0), ("mu", -0.1), ("mu", "0.5"), ("mu", None), ("mu", {":kind:": "float", "value": "nan"}),
            ("epsilon", -1.0),
            ("progress", 1.5), ("num_timesteps", -1), ("num_timesteps", 2**63), ("n_updates", 1.5), ("counter", 2**64),
            ("counter", True), ("total_episodes", []),
        ],
    )  # fmt: skip
    def test_the_state_of_the_training(self, path, name, value):
        forge(path, lambda data: data["training"].update({name: value}))
        refuse(path, f"`{name}` must be")

    @pytest.mark.parametrize(
        ("name", "value"),
        [
            ("gamma", 2.0),
            ("gamma", "x"),
            ("exploration", "x"),
            ("total_episodes", -1),
            ("learning_rate", 7),
            ("n_envs", 10**12),
        ],
    )
    def test_arguments(self, path, name, value):
        forge(path, lambda data: data["attributes"].update({name: value}))
        refuse(path, f"`{name}` must be")

    @pytest.mark.parametrize(
        "change",
        [
            {"parameters": {"omega": -1.0}}, {"parameters": {}}, {"parameters": {"omega": "x"}}, {"scope": "x"},
            {"next_action": "x"}, {"mu_0": 7.0}, {"memory": {"a": 1.0}}, {"owner": 7}, {"unknown": 1}, {"bounds": 3},
        ],
        ids=str,
    )  # fmt: skip
    def test_methods(self, path, change):
        forge(path, lambda data: data["method"].update(change))
        refuse(path, "cannot be loaded|not a saved model of this package")

    @pytest.mark.parametrize("entry", ["attributes", "training", "method", "running", "generator", "arrays", "algorithm"])
    @pytest.mark.parametrize("value", [None, 7, "x", [], [[]], {"x": 1}, {":kind:": "array", "name": "x"}], ids=str)
    def test_entries_of_another_kind(self, path, entry, value):
        """Refused, or not needed; other errors than a ValueError would be let through."""
        forge(path, lambda data: data.update({entry: value}))
        for take in (TabularQ.load, lambda path: TabularQ.resume(path, LAKE)):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                try:
                    model = take(path)
                except ValueError as error:
                    assert str(path) in str(error)
                else:
                    assert model.q_table.shape == (16, 4)

    @pytest.mark.parametrize("value", [7, ["x"], {":kind:": "x"}, {":kind:": "schedule", "name": "x"}])
    def test_schedules(self, path, value):
        forge(path, lambda data: data["attributes"].update(learning_rate=value))
        with pytest.raises(ValueError, match=r"model\.zip"):
            TabularQ.load(path)

    def test_a_schedule_that_stands_alone(self):
        assert decode_schedule(0.5) == 0.5


class TestRollouts:
    """What machine code looks up in a table is looked at before: a wrong number would be read beside the table."""

    @pytest.mark.parametrize("kind", [LeanVecEnv, CompiledVecEnv])
    @pytest.mark.parametrize(
        "transition",
        [
            [16, 0, 0.0, 0, False, False, 0], [-1, 0, 0.0, 0, False, False, 0], [0, 4, 0.0, 0, False, False, 0],
            [0, 0, 0.0, 10**12, False, False, 0], [0, 0, 0.0, 0, False, True, 99], [0, 0, 0.0, 0, False, False, 0.5],
            [0, 0, {":kind:": "float", "value": "nan"}, 0, False, False, 0], [0, 0], "x", None,
        ],
        ids=str,
    )  # fmt: skip
    def test_transitions(self, path, transition, kind):
        forge(path, lambda data: data["running"]["rollout"].update(transitions=[transition]))
        refuse(path, "cannot be resumed|not a saved model", lambda path: TabularQ.resume(path, kind([make_lake])))

    @pytest.mark.parametrize("actions", [[4], [-1], [0, 0], ["x"], [0.5], 7])
    def test_actions(self, path, actions):
        forge(path, lambda data: data["running"].update(next_actions=actions))
        refuse(path, "cannot be loaded", lambda path: TabularQ.resume(path, LAKE))

    @pytest.mark.parametrize("kind", [LeanVecEnv, CompiledVecEnv])
    @pytest.mark.parametrize("state", [16, -1, 10**12])
    def test_states_of_environments(self, path, state, kind):
        forge(path, lambda data: data["running"]["environments"][0]["layers"][-1]["state"].update(s=state))
        model = TabularQ.resume(path, kind([make_lake]))
        with pytest.raises((KeyError, ValueError)):  # a KeyError from FrozenLake itself
            model.finish()

    def test_arrays_of_the_algorithm(self, path):
        """Places in a list, of which machine code trusts every one."""
        folder = path.parent
        model = SARSALambda("MlpPolicy", LAKE, seed=0, method=7)
        model.learn(100, callback=CheckpointCallback(50, folder, "x"))
        path = folder / "x_50_steps.zip"
        content = path.read_bytes()
        for name, value in (("n_pairs", 10**6), ("n_pairs", -1), ("places", 10**6), ("pairs", 99)):
            path.write_bytes(content)
            array = dict(np.load(io.BytesIO(members_of(path)["arrays.npz"])))[f"working.{name}"]
            forge_arrays(path, prefix="working.", **{name: np.full_like(array, value)})
            refuse(path, "cannot be loaded", lambda path: SARSALambda.resume(path, LAKE))

    @pytest.mark.parametrize("shape", [(1, 16, 3), (2, 16, 4), (0,)])
    def test_arrays_of_the_algorithm_of_another_shape(self, path, shape):
        SARSALambda("MlpPolicy", LAKE, seed=0, method=7).learn(100).save(path)
        forge_arrays(path, prefix="working.", places=np.zeros(shape, np.int64))
        refuse(path, "the working arrays of SARSALambda do not fit this table", SARSALambda.load)

    def test_masks_that_forbid_everything(self, path):
        folder = path.parent
        TabularQ("MlpPolicy", "Taxi-v4", use_masking=True).learn(60, callback=CheckpointCallback(50, folder, "x"))
        path = folder / "x_50_steps.zip"
        forge_arrays(path, allowed=np.zeros((500, 6)))
        refuse(path, "forbids every action", lambda path: TabularQ.resume(path, "Taxi-v4"))

    def test_other_environments(self, path):
        env = SampledEnv(spaces.Discrete(16), spaces.Discrete(4))
        refuse(path, "the state of SampledEnv cannot be read", lambda path: TabularQ.resume(path, env))
        env.get_state, env.set_state = dict, print
        message = "environment was Monitor around TimeLimit around FrozenLakeEnv, but got Monitor around SampledEnv"
        refuse(path, message, lambda path: TabularQ.resume(path, env))
        forge(path, lambda data: data["running"]["environments"].append({}))
        refuse(path, "the training had 2 environments, but got 1", lambda path: TabularQ.resume(path, LAKE))


def make_lake():
    return Monitor(gym.make(LAKE))
