"""The commands of the package: ``python -m sb3_adaptive_q COMMAND``, or ``sb3-adaptive-q COMMAND`` once it is installed."""

import importlib
import os
import sys

#: For each command: its module, its function, the extra that installs what it needs, and what it does
COMMANDS = {
    "train": ("sb3_adaptive_q.zoo", "main", "zoo", "train an agent with RL Zoo"),
    "enjoy": ("sb3_adaptive_q.zoo", "main", "zoo", "show a trained agent"),
    "record-video": ("sb3_adaptive_q.zoo", "main", "zoo", "record a video of a trained agent"),
    "plot": ("sb3_adaptive_q.zoo", "main", "zoo-plots", "plot the returns of trainings"),
    "study": ("sb3_adaptive_q.experiments.paper.command", "main", "study", "repeat the paper's experiment"),
    "league": ("sb3_adaptive_q.experiments.league.command", "main", "study", "compare step sizes in many environments"),
    "methods": ("sb3_adaptive_q.listing", "main", "", "list all methods with formulas and parameters"),
}


def main(arguments: list[str] | None = None) -> None:
    """
    Run a command.

    :param arguments: the command line; ``None`` for that of the process
    :raises SystemExit: with the exit status of the command, or with a message if there is no such command, or what it needs is
        not installed
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    if not arguments or arguments[0] in ("-h", "--help"):
        print(_usage())
        return
    if arguments[0] not in COMMANDS:
        sys.exit(f"error: there is no command {arguments[0]!r}.\n{_usage()}")
    module, function, extra, _ = COMMANDS[arguments[0]]
    try:
        command = getattr(importlib.import_module(module), function)
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if missing == "sb3_adaptive_q" or not extra:
            raise
        sys.exit(
            f"error: `{arguments[0]}` needs the package {missing}, which is not installed. Install it with\n"
            f"  pip install 'sb3-adaptive-q[{extra}]'"
        )
    try:
        status = command(arguments if module == "sb3_adaptive_q.zoo" else arguments[1:])
        sys.stdout.flush()
    except BrokenPipeError:  # its reader, such as `head`, has seen enough; nothing is left to write when Python ends
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        status = 1
    sys.exit(status)


def _usage() -> str:
    listed = "\n".join(f"  {name:<14}{what}" for name, (_, _, _, what) in COMMANDS.items())
    return f"usage: python -m sb3_adaptive_q COMMAND [option ...]\n\n{listed}\n\nCOMMAND --help lists its options."


if __name__ == "__main__":
    main()
