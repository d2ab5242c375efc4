"""The compiled loop on disk: later processes find it, edited functions never run stale, and no place for it does no harm."""

import importlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import sb3_adaptive_q
from sb3_adaptive_q.compilation import source_digest

#: Learns with the rule of a module, and tells the rate it ended with and what the disk had
SCRIPT = """
import json
import sys
from stable_baselines3.common.env_util import make_vec_env
from sb3_adaptive_q import CompiledVecEnv, LearningRateCallback, TabularQ, fused

{rule}

model = TabularQ("MlpPolicy", make_vec_env("FrozenLake-v1", vec_env_cls=CompiledVecEnv), seed=0)
model.learn(2_000, callback=Mine(mu_0=0.5), log_interval=None)
stats = fused.run_stretch.dispatcher.stats
print(json.dumps({{
    "mu": model.mu,
    "hits": sum(stats.cache_hits.values()),
    "misses": sum(stats.cache_misses.values()),
    "sum": float(model.q_table.sum()),
    "package": fused.__file__,
    "cache": stats.cache_path,
}}))
"""
IMPORTED = "from my_rule import Mine"
IN_MAIN = """
class Mine(LearningRateCallback):
    @staticmethod
    def rule(mu, transition):
        return {rate}
"""
MY_RULE = """
import my_package.helper
from sb3_adaptive_q import LearningRateCallback

class Mine(LearningRateCallback):
    @staticmethod
    def rule(mu, transition):
        return my_package.helper.scale({factor})
"""
MY_HELPER = """
OFFSET = {offset}

def scale(value):
    return value / 2 + OFFSET
"""


def run(folder, rule=IMPORTED, **environment):
    """
    Run the script in a process of its own.

    :param folder: where the process is, and imports from first
    :param rule: what defines or imports the rule
    :param environment: variables to set; None for those to unset
    :return: what it told
    """
    script = Path(folder) / "script.py"
    script.write_text(SCRIPT.format(rule=rule))
    root = str(Path(sb3_adaptive_q.__file__).parents[1])
    variables = {**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), root]), **environment}
    variables = {name: value for name, value in variables.items() if value is not None}
    result = subprocess.run(
        [sys.executable, str(script)], cwd=folder, env=variables, capture_output=True, text=True, timeout=250, check=False
    )
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout.splitlines()[-1])


def write_rule(folder, factor, offset):
    (folder / "my_rule.py").write_text(MY_RULE.format(factor=factor))
    (folder / "my_package").mkdir(exist_ok=True)
    (folder / "my_package" / "__init__.py").touch()
    (folder / "my_package" / "helper.py").write_text(MY_HELPER.format(offset=offset))


def test_later_processes_find_it_and_edits_are_seen(tmp_path):
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    write_rule(tmp_path, 0.5, 0.0)
    first = run(tmp_path, **cache)
    assert (first["mu"], first["hits"], first["misses"]) == (0.25, 0, 1)
    assert Path(first["cache"]).is_relative_to(tmp_path / "cache")
    second = run(tmp_path, **cache)
    assert (second["hits"], second["misses"]) == (1, 0)
    assert (second["mu"], second["sum"]) == (first["mu"], first["sum"])

    write_rule(tmp_path, 0.75, 0.0)
    edited = run(tmp_path, **cache)
    assert (edited["mu"], edited["hits"]) == (0.375, 0)
    write_rule(tmp_path, 0.75, 0.125)
    edited = run(tmp_path, **cache)
    assert (edited["mu"], edited["hits"]) == (0.5, 0)


def test_a_rule_of_the_script_itself(tmp_path):
    cache = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    first, second = (run(tmp_path, IN_MAIN.format(rate=rate), **cache) for rate in (0.25, 0.125))
    assert (first["mu"], second["mu"]) == (0.25, 0.125)


def test_an_installation_that_cannot_be_written_to_and_no_home(tmp_path):
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
    assert (told["mu"], told["cache"]) == (0.25, None)


RULE = "def rule(mu, transition): return "
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
            return source_digest(importlib.import_module("m").rule)

        yield digest
        for name in ("m", "n", "o", "p", "p.n"):
            sys.modules.pop(name, None)

    @pytest.mark.parametrize("files, edit", EDITS.values(), ids=EDITS)
    def test_an_edit_changes_it(self, digest, files, edit):
        before = digest(files)
        assert digest(files) == before
        assert digest({**files, **edit}) != before

    def test_it_is_the_same_in_every_process(self):
        command = "from sb3_adaptive_q import rules, compilation; print(compilation.source_digest(rules.sign_rate))"
        variables = {**os.environ, "PYTHONHASHSEED": "7"}
        result = subprocess.run([sys.executable, "-c", command], env=variables, capture_output=True, text=True, check=True)
        assert result.stdout.strip() == source_digest(sb3_adaptive_q.rules.sign_rate)

    def test_functions_that_call_each_other(self):
        assert source_digest(is_even) != source_digest(is_odd)


def is_even(number):
    return number == 0 or is_odd(number - 1)


def is_odd(number):
    return number != 0 and is_even(number - 1)
