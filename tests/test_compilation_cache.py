"""Machine code in memory and on disk: it is found again where nothing has changed, never stale, and no disk does no harm."""

import importlib
import json
import os
import shutil
import subprocess
import sys
import threading
from itertools import combinations_with_replacement
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

import numpy as np
import pytest
from numba import njit, typeof
from stable_baselines3.common.env_util import make_vec_env

import sb3_adaptive_q
from sb3_adaptive_q import CompiledVecEnv, LearningRateCallback, TabularQ
from sb3_adaptive_q.compiled import jit
from sb3_adaptive_q.compiled.freezing import CannotFreeze, freeze
from sb3_adaptive_q.compiled.jit import CannotCompile, machine_code

#: Learns with the rule of a module, and tells the step size it ended with
SCRIPT = """
import json
from stable_baselines3.common.env_util import make_vec_env
import sb3_adaptive_q
from sb3_adaptive_q import CompiledVecEnv, LearningRateCallback, TabularQ

{rule}

model = TabularQ("MlpPolicy", make_vec_env("FrozenLake-v1", vec_env_cls=CompiledVecEnv), seed=0)
model.learn(2_000, callback=Mine(mu_0=0.5), log_interval=None)
print(json.dumps({{"mu": model.mu, "sum": float(model.q_table.sum()), "package": sb3_adaptive_q.__file__}}))
"""
IMPORTED = "from my_rule import Mine"
IN_MAIN = """
class Mine(LearningRateCallback):
    @staticmethod
    def rule(mu, step):
        return {rate}
"""
MY_RULE = """
import my_package.helper
from sb3_adaptive_q import LearningRateCallback

class Mine(LearningRateCallback):
    @staticmethod
    def rule(mu, step):
        return my_package.helper.scale({factor})
"""
MY_HELPER = """
OFFSET = {offset}

def scale(value):
    return value / 2 + OFFSET
"""
NAMED_TUPLE = "from collections import namedtuple\nP = namedtuple('P', '{}')\n"


def in_process(folder, program, **environment):
    """
    Run a program in a process of its own.

    :param folder: where the process is, and imports from first
    :param program: the text of the program
    :param environment: variables to set; None for those to unset
    :return: what ended, with its output
    """
    script = Path(folder) / "script.py"
    script.write_text(program)
    root = str(Path(sb3_adaptive_q.__file__).parents[1])
    variables = {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), root]), **environment}
    variables = {name: value for name, value in variables.items() if value is not None}
    return subprocess.run(
        [sys.executable, str(script)], cwd=folder, env=variables, capture_output=True, text=True, timeout=250, check=False
    )


def run(folder, rule=IMPORTED, **environment):
    """
    Let a process of its own learn.

    :param folder: where the process is, and imports from first
    :param rule: what defines or imports the rule
    :param environment: variables to set; None for those to unset
    :return: what it told, with how many functions came from the disk and how many went there, by Numba's own report
    """
    result = in_process(folder, SCRIPT.format(rule=rule), NUMBA_DEBUG_CACHE="1", **environment)
    assert result.returncode == 0, result.stderr
    told = json.loads(result.stdout.splitlines()[-1])
    return told | {"loaded": result.stdout.count("data loaded from"), "saved": result.stdout.count("data saved to")}


def write_rule(folder, factor, offset):
    (folder / "my_rule.py").write_text(MY_RULE.format(factor=factor))
    (folder / "my_package").mkdir(exist_ok=True)
    (folder / "my_package" / "__init__.py").touch()
    (folder / "my_package" / "helper.py").write_text(MY_HELPER.format(offset=offset))


class TestDisk:
    def test_later_processes_find_it_and_edits_are_seen(self, tmp_path):
        cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
        write_rule(tmp_path, 0.5, 0.0)
        first = run(tmp_path, **cache)
        files = sorted((tmp_path / "cache").rglob("*.nbc"))
        assert first["mu"] == 0.25 and first["saved"] == len(files) > 0
        second = run(tmp_path, PYTHONHASHSEED="7", **cache)
        assert (second["loaded"], second["saved"]) == (len(files), 0)
        assert (second["mu"], second["sum"]) == (first["mu"], first["sum"])

        files[0].write_bytes(files[0].read_bytes()[:10])  # a file that is cut off harms its own function alone
        third = run(tmp_path, **cache)
        assert third["loaded"] >= len(files) - 1
        assert (third["mu"], third["sum"]) == (first["mu"], first["sum"])

        write_rule(tmp_path, 0.75, 0.125)
        edited = run(tmp_path, **cache)
        assert edited["mu"] == 0.5 and edited["saved"] > 0

    def test_an_installation_that_cannot_be_written_to_and_no_home(self, tmp_path):
        """A file where the cache's folder would be: not even the superuser, who may write anywhere, can make it a folder."""
        installation = tmp_path / "installation"
        for package in ("sb3_adaptive_q", "wrappers"):
            source = Path(sb3_adaptive_q.__file__).parents[1] / package
            shutil.copytree(source, installation / package, ignore=shutil.ignore_patterns("__pycache__", "study", "data"))
            for folder in [installation / package, *(path for path in (installation / package).rglob("*") if path.is_dir())]:
                (folder / "__pycache__").touch()
                folder.chmod(0o555)
        nowhere = {"HOME": os.devnull, "NUMBA_CACHE_DIR": None, "XDG_CACHE_HOME": None, "PYTHONPATH": str(installation)}
        try:
            told = run(tmp_path, IN_MAIN.format(rate=0.25), **nowhere)
        finally:
            for folder in (path for path in (installation, *installation.rglob("*")) if path.is_dir()):
                folder.chmod(0o755)
        assert Path(told["package"]).is_relative_to(installation)
        assert (told["mu"], told["loaded"]) == (0.25, 0)
        assert told["saved"] == 1  # the rule by itself, whose own folder can be written to

    def test_checks_of_indices_are_compiled_where_they_are_asked_for(self, tmp_path):
        program = """
import numpy as np
from sb3_adaptive_q.compiled.jit import machine_code

def item(values, index):
    return values[index]

arguments = np.zeros(3), 3
machine_code(item, arguments)(*arguments)
"""
        cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
        assert in_process(tmp_path, program, NUMBA_BOUNDSCHECK=None, **cache).returncode == 0
        checked = in_process(tmp_path, program, NUMBA_BOUNDSCHECK="1", **cache)
        assert checked.returncode == 1 and "IndexError: index is out of bounds" in checked.stderr


RULE = "def rule(mu, step): return "
#: A rule's files, and the ones that an edit changes
EDITS = {
    "the formula": ({"m": RULE + "2 * mu"}, {"m": RULE + "3 * mu"}),
    "a comparison": ({"m": RULE + "float(mu < 1)"}, {"m": RULE + "float(mu > 1)"}),
    "another function of a library": (
        {"m": "import math\n" + RULE + "math.sin(mu)"},
        {"m": "import math\n" + RULE + "math.cos(mu)"},
    ),
    "a constant": ({"m": "A = 1\n" + RULE + "A"}, {"m": "A = 2\n" + RULE + "A"}),
    "the name of a constant": ({"m": "A = 1\nB = 2\n" + RULE + "A"}, {"m": "A = 1\nB = 2\n" + RULE + "B"}),
    "two constants exchanged": ({"m": "A = 1\nB = 2\n" + RULE + "A - B"}, {"m": "A = 2\nB = 1\n" + RULE + "A - B"}),
    "a constant of NumPy's": (
        {"m": "import numpy as np\nA = np.int64(1)\n" + RULE + "A"},
        {"m": "import numpy as np\nA = np.int64(2)\n" + RULE + "A"},
    ),
    "an array": (
        {"m": "import numpy as np\nA = np.array([1.0])\n" + RULE + "A[0]"},
        {"m": "import numpy as np\nA = np.array([2.0])\n" + RULE + "A[0]"},
    ),
    "a tuple of arrays": (
        {"m": "import numpy as np\nA = (np.arange(5000),)\n" + RULE + "A[0][2000]"},
        {"m": "import numpy as np\nA = (np.arange(5000) + (np.arange(5000) == 2000),)\n" + RULE + "A[0][2000]"},
    ),
    "an enumeration": (
        {"m": "from enum import IntEnum\nclass K(IntEnum): A = 1\n" + RULE + "K.A"},
        {"m": "from enum import IntEnum\nclass K(IntEnum): A = 2\n" + RULE + "K.A"},
    ),
    "a helper": ({"m": "def h(x): return x\n" + RULE + "h(mu)"}, {"m": "def h(x): return -x\n" + RULE + "h(mu)"}),
    "a default": ({"m": "def h(x, y=1): return y\n" + RULE + "h(mu)"}, {"m": "def h(x, y=2): return y\n" + RULE + "h(mu)"}),
    "a default by name": (
        {"m": "def h(x, *, y=1): return y\n" + RULE + "h(mu)"},
        {"m": "def h(x, *, y=2): return y\n" + RULE + "h(mu)"},
    ),
    "a helper inside a comprehension": (
        {"m": "def h(x): return x\n" + RULE + "sum([h(x) for x in (mu, mu)])"},
        {"m": "def h(x): return -x\n" + RULE + "sum([h(x) for x in (mu, mu)])"},
    ),
    "a helper of another module": (
        {"m": "from n import h\n" + RULE + "h(mu)", "n": "def h(x): return x"},
        {"n": "def h(x): return -x"},
    ),
    "a helper through another module": (
        {"m": "import n\n" + RULE + "n.h(mu)", "n": "def h(x): return x"},
        {"n": "def h(x): return -x"},
    ),
    "a helper's helper": (
        {"m": "from n import h\n" + RULE + "h(mu)", "n": "import o\ndef h(x): return o.g(x)", "o": "def g(x): return x"},
        {"o": "def g(x): return -x"},
    ),
    "a helper of a module of its name": (
        {"m": "import n\n" + RULE + "n.n(mu)", "n": "def n(x): return x"},
        {"n": "def n(x): return -x"},
    ),
    "a constant of another module": ({"m": "import n\n" + RULE + "n.A", "n": "A = 1"}, {"n": "A = 2"}),
    "a helper of a package's module": (
        {"m": "import p.n\n" + RULE + "p.n.h(mu)", "p/__init__": "", "p/n": "def h(x): return x"},
        {"p/n": "def h(x): return -x"},
    ),
    "a constant of a package's module": (
        {"m": "import p.n\n" + RULE + "p.n.A", "p/__init__": "", "p/n": "A = 1"},
        {"p/n": "A = 2"},
    ),
    "a helper that is compiled already": (
        {"m": "from n import h\n" + RULE + "h(mu)", "n": "import numba\n@numba.njit\ndef h(x): return x"},
        {"n": "import numba\n@numba.njit\ndef h(x): return -x"},
    ),
    "how a helper is compiled": (
        {"m": "from n import h\n" + RULE + "h(mu)", "n": "import numba\n@numba.njit\ndef h(x): return x + x + x"},
        {"n": "import numba\n@numba.njit(fastmath=True)\ndef h(x): return x + x + x"},
    ),
    "what a function was made with": (
        {"m": "def make(a):\n    " + RULE + "a\n    return rule\nrule = make(1)"},
        {"m": "def make(a):\n    " + RULE + "a\n    return rule\nrule = make(2)"},
    ),
    "the function that a function was made with": (
        {"m": "def make(a):\n    " + RULE + "a(mu)\n    return rule\nrule = make(lambda x: x)"},
        {"m": "def make(a):\n    " + RULE + "a(mu)\n    return rule\nrule = make(lambda x: -x)"},
    ),
    "another function under the same name": (
        {"m": "from math import tanh as f\n" + RULE + "f(mu)"},
        {"m": "from math import atan as f\n" + RULE + "f(mu)"},
    ),
    "another function of NumPy's under the same name": (
        {"m": "from numpy import sin as f\n" + RULE + "f(mu)"},
        {"m": "from numpy import cos as f\n" + RULE + "f(mu)"},
    ),
    "another module under the same name": (
        {"m": "import math as l\n" + RULE + "l.log(mu)"},
        {"m": "import cmath as l\n" + RULE + "l.log(mu)"},
    ),
    "the lesser and the greater": (
        {"m": "import numpy as np\n" + RULE + "np.minimum(mu, 1.0)"},
        {"m": "import numpy as np\n" + RULE + "np.maximum(mu, 1.0)"},
    ),
    "a type under the same name": (
        {"m": "from numpy import float64 as t\n" + RULE + "t(mu)"},
        {"m": "from numpy import float32 as t\n" + RULE + "t(mu)"},
    ),
    "a type of Numba's under the same name": (
        {"m": "from numba import float64 as t\n" + RULE + "t(mu)"},
        {"m": "from numba import float32 as t\n" + RULE + "t(mu)"},
    ),
    "the type of an array": (
        {"m": "import numpy as np\nA = np.zeros(2, np.int64)\n" + RULE + "A[0]"},
        {"m": "import numpy as np\nA = np.zeros(2, np.float64)\n" + RULE + "A[0]"},
    ),
    "a whole number and a float": ({"m": "A = 1\n" + RULE + "A"}, {"m": "A = 1.0\n" + RULE + "A"}),
    "the sign of zero": ({"m": "A = 0.0\n" + RULE + "A"}, {"m": "A = -0.0\n" + RULE + "A"}),
    "the body of what NumPy calls for every item": (
        {"m": "from numba import vectorize\n@vectorize\ndef f(x): return x + 1.0\n" + RULE + "f(mu)"},
        {"m": "from numba import vectorize\n@vectorize\ndef f(x): return x + 2.0\n" + RULE + "f(mu)"},
    ),
    "the fields of a named tuple": (
        {"m": NAMED_TUPLE.format("a, b") + RULE + "P(mu, 2.0).a"},
        {"m": NAMED_TUPLE.format("b, a") + RULE + "P(mu, 2.0).a"},
    ),
    "the fields of a named tuple that is a constant": (
        {"m": NAMED_TUPLE.format("a, b") + "A = P(1.0, 2.0)\n" + RULE + "A.a"},
        {"m": NAMED_TUPLE.format("b, a") + "A = P(1.0, 2.0)\n" + RULE + "A.a"},
    ),
}


class TestDigest:
    """What the cache knows an edited function by."""

    @pytest.fixture
    def digest(self, tmp_path, monkeypatch):
        monkeypatch.setattr(sys, "dont_write_bytecode", True)
        monkeypatch.syspath_prepend(str(tmp_path))

        def digest(files):
            for name, text in files.items():
                path = tmp_path / f"{name}.py"
                path.parent.mkdir(exist_ok=True)
                path.write_text(text + "\n")
            importlib.invalidate_caches()
            for name in ("m", "n", "o", "p", "p.n"):
                sys.modules.pop(name, None)
            return freeze(importlib.import_module("m").rule).__name__

        yield digest
        for name in ("m", "n", "o", "p", "p.n"):
            sys.modules.pop(name, None)

    @pytest.mark.parametrize("files, edit", EDITS.values(), ids=EDITS)
    def test_an_edit_changes_it(self, digest, files, edit):
        before = digest(files)
        assert digest(files) == before
        assert digest({**files, **edit}) != before

    def test_it_is_the_same_in_every_process(self, tmp_path):
        program = """
from enum import IntEnum
import numpy as np
from sb3_adaptive_q.compiled.freezing import freeze

class Kind(IntEnum):
    FIRST = 1

NAMES, TABLE = frozenset({"a", "b", "c", "d"}), np.arange(3.0)

def rule(mu, step):
    return mu if step in NAMES or step in {"e", "f", "g"} else np.minimum(TABLE[Kind.FIRST], mu)

print(freeze(rule).__name__)
"""
        digests = {in_process(tmp_path, program, PYTHONHASHSEED=seed).stdout for seed in ("0", "7", "12")}
        assert len(digests) == 1 and len(digests.pop().strip()) == len("rule_") + 20

    @pytest.mark.parametrize(
        "held", [object(), [1.0], threading.Lock(), {1: object()}], ids=["object", "list", "lock", "dict"]
    )
    def test_a_global_of_another_kind_is_refused(self, held):
        scope = {"HELD": held}
        exec("def rule(mu, step): return HELD", scope)
        with pytest.raises(
            CannotFreeze, match=r"it uses `HELD`, which is a .*: machine code can hold numbers, arrays, tuples"
        ):
            freeze(scope["rule"])
        with pytest.raises(CannotCompile, match="it uses `HELD`"):
            machine_code(scope["rule"], (0.0, 0.0))

    def test_a_value_of_another_module_is_named_with_it(self):
        module = ModuleType("mine")
        module.HELD = [1.0]
        scope = {"mine": module}
        exec("def rule(mu, step): return mine.HELD", scope)
        with pytest.raises(CannotFreeze, match=r"it uses `mine\.HELD`, which is a list"):
            freeze(scope["rule"])


class TestOneProcess:
    """A function that was compiled already, and something it uses that changes."""

    def test_nothing_has_changed(self):
        assert freeze(double) is freeze(double)
        assert machine_code(double, (1.0,)) is machine_code(double, (2.0,)) is not machine_code(double, (1,))

    def test_functions_that_call_themselves_are_refused(self):
        with pytest.raises(CannotCompile, match="it uses `is_even`, which calls itself"):
            machine_code(is_even, (1,))

    def test_what_a_user_has_compiled_may_call_itself(self):
        scope = {"njit": njit}
        exec("@njit(fastmath=False)\ndef factorial(n): return 1 if n < 2 else n * factorial(n - 1)", scope)
        exec("def rule(n): return factorial(n)", scope)
        assert machine_code(scope["rule"], (5,))(5) == 120

    @pytest.mark.parametrize("hold", [lambda value: value, lambda value: (value,), lambda value: {"a": value}])
    def test_values_that_are_equal_but_not_the_same_are_told_apart(self, hold):
        scope = {}
        exec("def rule(mu, step): return HELD", scope)
        copies = []
        for value in (0, 0.0, -0.0, False, np.float32(0.0), 0j):
            scope["HELD"] = hold(value)
            copies.append(freeze(scope["rule"]))
            assert copies[-1].__globals__["HELD"] == scope["HELD"]
        assert len(set(copies)) == 6

    def test_values_of_before_stay_in_what_was_compiled_before(self):
        scope = {"RATE": 0.25}
        exec("def rule(mu, step): return RATE", scope)
        before = machine_code(scope["rule"], (0.0, 0.0))
        scope["RATE"] = 0.5
        assert machine_code(scope["rule"], (0.0, 0.0))(0.0, 0.0) == 0.5
        assert before(0.0, 0.0) == 0.25

    @pytest.mark.parametrize("compiled", [False, True])
    @pytest.mark.parametrize("change", ["a global", "an array", "a helper"])
    def test_the_next_training_sees_it(self, compiled, change):
        scope = {"RATE": 0.25, "RATES": np.array([0.25]), "helper": lambda: 0.25}
        exec("def rule(mu, step): return min(RATE, RATES[0], helper())", scope)

        class Mine(LearningRateCallback):
            rule = staticmethod(scope["rule"])

        env = make_vec_env("FrozenLake-v1", vec_env_cls=CompiledVecEnv) if compiled else "FrozenLake-v1"
        model = TabularQ("MlpPolicy", env, seed=0).learn(10, callback=Mine(mu_0=0.5))
        assert model.mu == 0.25
        if change == "a global":
            scope["RATE"] = 0.125
        elif change == "an array":
            scope["RATES"][0] = 0.125
        else:
            scope["helper"] = lambda: 0.125
        model.learn(10, callback=Mine(mu_0=0.5))
        assert model.mu == 0.125


def double(number):
    return number + number


def is_even(number):
    return number == 0 or is_odd(number - 1)


def is_odd(number):
    return number != 0 and is_even(number - 1)


class Pair(NamedTuple):
    first: int
    second: float


def test_arguments_of_one_kind_have_one_type() -> None:
    """The compiler's type is what machine code is made for, and the kind is what it is found again by."""
    table = np.arange(12.0).reshape(3, 4)
    frozen_table = table.copy()
    frozen_table.flags.writeable = False
    plain, aligned = (np.zeros(2, np.dtype([("a", np.int8), ("b", np.float64)], align=align)) for align in (False, True))
    as_if_aligned = np.zeros(2, np.dtype({"names": ["a", "b"], "formats": [np.int8, np.float64], "offsets": [0, 8]}))
    moved = np.frombuffer(b" " * 33, np.uint8)[1:].view(np.float64)
    arrays = [
        table, table.T, table[:, ::2], table[0], table[:, :1], table.astype(np.float32), frozen_table,
        plain, aligned, as_if_aligned, moved, np.zeros((0, 2)), np.zeros(()), np.zeros(3, bool),
    ]  # fmt: skip
    others = [1, 2**63, -1, 1.0, True, np.int64(1), np.uint64(1), np.float32(1.0), (), (1, 1.0), (1.0, 1), Pair(1, 1.0)]
    values = [*arrays, *others, *((array, 0) for array in arrays), *((array,) for array in arrays)]
    for first, second in combinations_with_replacement(values, 2):
        assert (jit._kind(first) == jit._kind(second)) == (typeof(first) == typeof(second)), (first, second)
