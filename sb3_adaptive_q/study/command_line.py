"""``python -m sb3_adaptive_q.study``: the paper's experiment, or another of its kind, in one command."""

import argparse
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any

from sb3_adaptive_q.kernels import NEXT_ACTIONS
from sb3_adaptive_q.study.errors import DesignError, StudyError
from sb3_adaptive_q.study.settings import PRESETS, StudySettings, read_design
from sb3_adaptive_q.study.study import run_study

SETTINGS = tuple(field.name for field in fields(StudySettings))
#: How a study is carried out, which makes no difference to what it gives
EXECUTION: dict[str, Any] = {"output": "study-results", "workers": None, "dask": None, "tensorboard": None}


def main(arguments: list[str] | None = None) -> int:
    """
    :param arguments: of the command line; ``None`` for those of this process
    :return: the exit status: 0, 2 where no such study can be made, 1 where it could not be finished
    """
    try:
        settings, execution = read_arguments(arguments)
        output = Path(execution.pop("output"))
        print(run_study(settings, output, **execution))
        print(f"\nThe tables, figures and this report are in {output}.")
    except DesignError as error:
        return _fail(error, 2)
    except StudyError as error:
        return _fail(error, 1)
    except KeyboardInterrupt:
        return _fail("Interrupted. The cells that are done are stored: start again to go on.", 1)
    return 0


def _fail(message: object, status: int) -> int:
    print(f"Error: {message}", file=sys.stderr)
    return status


def read_arguments(arguments: list[str] | None) -> tuple[StudySettings, dict[str, Any]]:
    """
    :param arguments: of the command line
    :return: the design, and how to carry it out, by the names of the parameters of ``run_study``
    :raises DesignError: if there is no such design
    """
    given = vars(_parser().parse_args(arguments))
    config = given.pop("config", None)
    options = {**(_read_config(Path(config)) if config else {}), **given}
    execution = {name: options.pop(name, default) for name, default in EXECUTION.items()}
    settings = StudySettings.from_data(options)
    _check_execution(execution)
    if execution["tensorboard"] is not None:
        execution["tensorboard"] = Path(execution["tensorboard"])
    return settings, execution


def _read_config(path: Path) -> dict[str, Any]:
    data = read_design(path)
    data.pop("versions", None)  # a study's own record of its settings may be handed in
    unknown = [name for name in data if name not in (*SETTINGS, *EXECUTION)]
    if unknown:
        raise DesignError(f"Unknown setting {unknown[0]!r} in {path}: there are {', '.join((*SETTINGS, *EXECUTION))}.")
    return data


def _check_execution(execution: dict[str, Any]) -> None:
    workers = execution["workers"]
    if workers is not None and (not isinstance(workers, int) or isinstance(workers, bool) or workers < 1):
        raise DesignError(f"workers must be a whole number of at least 1, but is {workers!r}.")
    for name in ("output", "dask", "tensorboard"):
        if not isinstance(execution[name], str) and not (execution[name] is None and name != "output"):
            raise DesignError(f"{name} must be a text, but is {execution[name]!r}.")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m sb3_adaptive_q.study",
        description="Repeat the paper's experiment: its tables and figures beside the paper's, and its claims judged.",
        epilog="A study that was interrupted goes on when it is started again with the same output folder.",
        argument_default=argparse.SUPPRESS,
        allow_abbrev=False,
    )
    default = StudySettings()
    design = parser.add_argument_group("design")
    design.add_argument("--config", metavar="FILE", help="a YAML file of these settings; options override it")
    design.add_argument("--systems", nargs="+", metavar="ID", help=f"environments (default: {' '.join(default.systems)})")
    design.add_argument("--methods", nargs="+", type=int, metavar="N", help="numbers of methods (default: 1 to 8)")
    for name in ("runs", "episodes", "seed"):
        design.add_argument(f"--{name}", type=int, metavar="N", help=f"(default: {getattr(default, name)})")
    design.add_argument("--preset", metavar="NAME", help="; ".join(f"{name}: {text}" for name, text in PRESETS.items()))
    design.add_argument("--next-action", metavar="NAME", help=f"whose value Methods 5 to 8 look at: {', '.join(NEXT_ACTIONS)}")
    for field in fields(StudySettings):
        if field.type is float or field.type == "float":
            option = f"--{field.name.replace('_', '-')}"
            design.add_argument(option, type=float, metavar="X", help=f"(default: {field.default:g})")
    execution = parser.add_argument_group("execution")
    execution.add_argument("--output", metavar="FOLDER", help=f"(default: {EXECUTION['output']})")
    execution.add_argument("--workers", type=int, metavar="N", help="processes (default: one for each core)")
    execution.add_argument("--dask", metavar="ADDRESS", help="scheduler of a running Dask cluster to use instead")
    execution.add_argument("--tensorboard", metavar="FOLDER", help="write every run there with its hyperparameters")
    return parser
