"""What is shipped: the content and metadata of the wheel, the pins, and what an import pulls in."""

import ast
import graphlib
import importlib
import importlib.metadata
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Mapping
from email.message import Message
from email.parser import HeaderParser
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

PROJECT = Path(__file__).resolve().parent.parent
# Tests and benchmarks are copied too: that they stay out of the wheel is one of the things to be shown.
SOURCES = ["pyproject.toml", "README.md", "LICENSE", "train.py", "sb3_adaptive_q", "wrappers", "tests", "benchmarks"]
EXTRAS = {"zoo", "zoo-plots", "study", "plots", "dask", "docs", "dev"}
HEAVY = {
    "arch",
    "dask",
    "distributed",
    "matplotlib",
    "moviepy",
    "optuna",
    "pandas",
    "pyarrow",
    "rl_zoo3",
    "rliable",
    "scipy",
    "seaborn",
}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> zipfile.ZipFile:
    """The wheel, built from a copy, so that nothing left behind in the checkout can slip in."""
    source = tmp_path_factory.mktemp("source")
    for name in SOURCES:
        if (PROJECT / name).is_dir():
            shutil.copytree(PROJECT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(PROJECT / name, source / name)
    target = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(target), str(source)]
    built = subprocess.run(command, capture_output=True, text=True)
    assert built.returncode == 0, built.stdout + built.stderr
    (path,) = target.glob("*.whl")
    return zipfile.ZipFile(path)


@pytest.fixture(scope="module")
def metadata(wheel: zipfile.ZipFile) -> Message:
    return HeaderParser().parsestr(read_info(wheel, "METADATA"))


def read_info(wheel: zipfile.ZipFile, name: str) -> str:
    (path,) = (path for path in wheel.namelist() if path.endswith(f".dist-info/{name}"))
    return wheel.read(path).decode()


def pins() -> dict[str, Requirement]:
    """The lines of the constraints file that hold for this interpreter and platform, by normalised name."""
    lines = (PROJECT / "constraints.txt").read_text().splitlines()
    requirements = [Requirement(line) for line in lines if line and not line.startswith("#")]
    in_force = [requirement for requirement in requirements if requirement.marker is None or requirement.marker.evaluate()]
    by_name = {canonicalize_name(requirement.name): requirement for requirement in in_force}
    assert len(by_name) == len(in_force), "a distribution is pinned twice"
    return by_name


def needed(requirements: list[str], extras: set[str]) -> list[Requirement]:
    """Those of the requirements that apply here with any of the extras."""
    parsed = [Requirement(requirement) for requirement in requirements]
    return [
        requirement
        for requirement in parsed
        if requirement.marker is None or any(requirement.marker.evaluate({"extra": extra}) for extra in extras | {""})
    ]


def test_wheel_holds_every_module_of_the_two_packages(wheel: zipfile.ZipFile) -> None:
    expected = {
        path.relative_to(PROJECT).as_posix()
        for package in ("sb3_adaptive_q", "wrappers")
        for path in (PROJECT / package).rglob("*.py")
    }
    assert {name for name in wheel.namelist() if name.endswith(".py")} == expected


def test_wheel_holds_the_package_data(wheel: zipfile.ZipFile) -> None:
    data = {
        "sb3_adaptive_q/py.typed",
        "wrappers/py.typed",
        "sb3_adaptive_q/version.txt",
        "sb3_adaptive_q/hyperparams/tabular.yml",
    }
    data |= {
        path.relative_to(PROJECT).as_posix()
        for pattern in ("*.csv", "*.css", "*.js", "*.yml")
        for path in (PROJECT / "sb3_adaptive_q" / "experiments").rglob(pattern)
    }
    assert data <= set(wheel.namelist())


def test_wheel_installs_only_the_two_packages(wheel: zipfile.ZipFile) -> None:
    top_level = {name.split("/")[0] for name in wheel.namelist()}
    assert {name for name in top_level if not name.endswith(".dist-info")} == {"sb3_adaptive_q", "wrappers"}


def test_wheel_metadata(wheel: zipfile.ZipFile, metadata: Message) -> None:
    assert metadata["Name"] == "sb3-adaptive-q"
    assert metadata["Version"] == (PROJECT / "sb3_adaptive_q" / "version.txt").read_text().strip()
    assert metadata["Requires-Python"] == ">=3.10"
    assert metadata["License-Expression"] == "MIT"
    assert "MIT License" in read_info(wheel, "licenses/LICENSE")
    assert set(metadata.get_all("Provides-Extra", [])) == EXTRAS


def test_public_version_is_that_of_the_wheel(metadata: Message) -> None:
    assert importlib.import_module("sb3_adaptive_q").__version__ == metadata["Version"]


def test_everything_needed_is_pinned(metadata: Message) -> None:
    """Follow the requirements of the package and all extras through the installed distributions to the end."""
    pinned = pins()
    pending = needed(metadata.get_all("Requires-Dist", []), EXTRAS)
    seen: set[tuple[str, frozenset[str]]] = set()
    while pending:
        requirement = pending.pop()
        name, extras = canonicalize_name(requirement.name), frozenset(requirement.extras)
        if name == "sb3-adaptive-q" or (name, extras) in seen:
            continue
        seen.add((name, extras))
        assert name in pinned, f"{requirement} has no pin in constraints.txt"
        (pin,) = pinned[name].specifier
        assert pin.operator == "==" and requirement.specifier.contains(pin.version), (
            f"{pinned[name]} does not meet {requirement}"
        )
        pending += needed(importlib.metadata.requires(name) or [], set(extras))
    assert len(seen) > 100


def test_constraints_serve_any_machine() -> None:
    """No address, no path, no local version: only names, exact versions and markers."""
    for requirement in pins().values():
        (pin,) = requirement.specifier
        assert requirement.url is None and not requirement.extras
        assert "+" not in pin.version and "*" not in pin.version


def top_level_modules(statement: str) -> set[str]:
    """The top-level modules that a fresh interpreter holds after the statement."""
    program = f"{statement}\nimport sys\nprint(' '.join({{name.split('.')[0] for name in sys.modules}}))"
    finished = subprocess.run([sys.executable, "-c", program], cwd=PROJECT, capture_output=True, text=True)
    assert finished.returncode == 0, finished.stderr
    return set(finished.stdout.splitlines()[-1].split())


def test_import_brings_no_heavy_library_of_its_own() -> None:
    brought_by_dependencies = top_level_modules("import stable_baselines3, gymnasium, numba")
    ours = top_level_modules("import sb3_adaptive_q, wrappers")
    assert {"sb3_adaptive_q", "wrappers"} <= ours
    assert not (ours - brought_by_dependencies) & HEAVY


def test_a_folder_of_the_same_name_does_not_hide_the_package(tmp_path: Path) -> None:
    """A clone in the working directory, for instance."""
    (tmp_path / "sb3_adaptive_q").mkdir()
    program = "import sb3_adaptive_q\nprint(sb3_adaptive_q.TabularQ.__name__)"
    finished = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True)
    assert finished.stdout.strip() == "TabularQ", finished.stderr


def imports_of(path: Path, modules: Mapping[str, Path]) -> set[str]:
    """The modules of ours that a file imports anywhere: at its top, in a function, or for the type checker alone."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            assert node.level == 0, path
            parts = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= parts if parts <= modules.keys() else parts | {node.module}
    return found & modules.keys()


def test_no_module_imports_itself_by_way_of_others() -> None:
    modules = {}
    for path in (path for package in ("sb3_adaptive_q", "wrappers") for path in (PROJECT / package).rglob("*.py")):
        parts = path.relative_to(PROJECT).with_suffix("").parts
        modules[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    assert len(modules) > 100
    graph = {name: imports_of(path, modules) - {name} for name, path in modules.items()}
    graphlib.TopologicalSorter(graph).prepare()  # raises CycleError, with the circle


@pytest.mark.parametrize("path", sorted((PROJECT / "benchmarks").glob("[!_]*.py")), ids=lambda path: path.stem)
def test_a_benchmark_finds_what_it_measures(path: Path) -> None:
    assert importlib.import_module(f"benchmarks.{path.stem}").__doc__
