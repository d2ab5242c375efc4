"""What the commands of all experiments share."""

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import tyro

from sb3_adaptive_q.experiments.design import read_yaml
from sb3_adaptive_q.experiments.errors import DesignError, ExperimentError
from sb3_adaptive_q.output import spell_out_what_cannot_be_written

Options = TypeVar("Options")


def parse(kind: type[Options], prog: str, arguments: Sequence[str]) -> Options:
    """
    :param kind: a dataclass of options, whose docstring is the help
    :param prog: what the command is called
    :param arguments: of the command line; ``--config FILE`` stands for the options in that file, which the others override
    :return: the options
    :raises DesignError: if the file cannot be read
    :raises SystemExit: if an option is unknown or has no such value, or help was asked for
    """
    arguments = list(arguments)
    given: list[str] = []
    while "--config" in arguments:
        place = arguments.index("--config")
        if place + 1 == len(arguments):
            raise DesignError("--config needs the name of a file.")
        given += options_of(read_yaml(Path(arguments[place + 1])))
        del arguments[place : place + 2]
    return tyro.cli(kind, prog=prog, args=[*given, *arguments])


def options_of(values: Mapping[str, Any]) -> list[str]:
    """
    :param values: of options by name, such as the record that an experiment keeps of its own design
    :return: the options as on a command line
    """
    options = []
    for name, value in values.items():
        option = f"--{str(name).replace('_', '-')}"
        if name == "versions" or value is None:  # what an experiment's own record has beside its design
            continue
        listed = value if isinstance(value, list) else [value]
        if name in ("sweep", "scale"):  # options that are repeated
            options += [part for each in listed for part in (option, str(each))]
        elif isinstance(value, bool):
            options.append(option if value else f"--no-{option[2:]}")
        else:
            options += [option, *map(str, listed)]
    return options


def report_errors(command: Callable[[], Any]) -> int:
    """
    :param command: what to do
    :return: the exit status: 0, 2 where no such experiment can be made, 1 where it could not be finished
    """
    spell_out_what_cannot_be_written()
    try:
        command()
    except DesignError as error:
        return _fail(error, 2)
    except ExperimentError as error:
        return _fail(error, 1)
    except KeyboardInterrupt:
        return _fail("Interrupted. The runs that are done are stored: start the command again to continue.", 1)
    return 0


def _fail(message: object, status: int) -> int:
    print(f"Error: {message}", file=sys.stderr)
    return status
