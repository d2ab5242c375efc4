"""What the numbers of an experiment depend on beside its design: versions of libraries, and the package's own source."""

import ast
import hashlib
import platform
import subprocess
from collections.abc import Iterable, Mapping
from functools import cache
from importlib.metadata import version
from pathlib import Path

import sb3_adaptive_q
from sb3_adaptive_q.experiments.errors import DesignError, ExperimentError
from sb3_adaptive_q.experiments.names import source_digests

PACKAGE = Path(sb3_adaptive_q.__file__).parent
LIBRARIES = ("stable_baselines3", "gymnasium", "numpy", "numba", "torch", "scipy", "pandas", "pyarrow")
#: Modules beside ``experiments`` that take no part in a run
OF_NO_RUN = ("__main__", "listing", "plots/", "table_image", "zoo")
#: What may have a docstring
DOCUMENTED = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
#: The modules of ``experiments`` that take part in a run; the others come after it, and may change without any effect on it
OF_A_RUN = ("cells", "environments", "episodes", "learners", "judges", "greedy_episodes", "names", "measures")


@cache
def versions() -> dict[str, str]:
    """
    :return: the versions of Python, the libraries and the package, and a digest of the package's source
    """
    found = {"python": platform.python_version(), **{name: version(name) for name in LIBRARIES}}
    return {**found, "sb3_adaptive_q": sb3_adaptive_q.__version__, "source": package_digest()}


def package_digest() -> str:
    """
    :return: a digest of the source of all that a run goes through, whatever its comments and docstrings say
    """
    digest = hashlib.sha256()
    for path in sorted(PACKAGE.rglob("*.py")):
        name = path.relative_to(PACKAGE).as_posix()
        if path.stem in OF_A_RUN if name.startswith("experiments/") else not name.startswith(OF_NO_RUN):
            digest.update(f"{name}\0{code_of(path.read_text(encoding='utf-8'))}".encode())
    return digest.hexdigest()


def code_of(source: str) -> str:
    """
    :param source: of a module
    :return: what of it is executed, as text: without comments and docstrings
    """
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, DOCUMENTED) and ast.get_docstring(node, clean=False) is not None:
            del node.body[0]
    return ast.dump(tree)


def check_worker(wanted: Mapping[str, str], names: Iterable[str]) -> None:
    """
    Refuse to work for somebody who has another version of something: the results would differ without a word.

    :param wanted: what :func:`everything_of` gave where the work comes from
    :param names: the names in the work's design
    :raises ExperimentError: if anything differs here
    """
    try:
        here = everything_of(names)
    except (DesignError, ImportError) as error:
        raise ExperimentError(f"A worker on {platform.node()} cannot find what the design names ({error}).") from error
    differences = [
        f"{name} is {_short(here.get(name))} there, {_short(wanted.get(name))} here"
        for name in sorted({*here, *wanted})
        if here.get(name) != wanted.get(name)
    ]
    if differences:
        raise ExperimentError(
            f"A worker on {platform.node()} has other versions: {'; '.join(differences)}. Install the same on every worker, "
            "and start the command again to continue."
        )


def everything_of(names: Iterable[str]) -> dict[str, str]:
    """
    :param names: the names in a design
    :return: :func:`versions`, and a digest of every module of the user's that the names come from
    """
    return {**versions(), **{f"source of {module}": digest for module, digest in source_digests(names).items()}}


def commit() -> str:
    """
    :return: the commit of the package's source, where it is a git repository, with ``-dirty`` where files differ from it; else
        an empty text
    """
    command = ["git", "-C", str(PACKAGE), "describe", "--always", "--dirty", "--exclude", "*"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return ""


def _short(text: str | None) -> str:
    return "missing" if text is None else text[:12]
