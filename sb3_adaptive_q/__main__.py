"""The commands of the package: ``python -m sb3_adaptive_q``, or ``sb3-adaptive-q`` once it is installed."""

import importlib
import sys

#: By the word that selects them: module, function, extra of the package, and what they do
COMMANDS = {
    "train": ("sb3_adaptive_q.zoo", "main", "zoo", "train an agent with RL Zoo"),
    "enjoy": ("sb3_adaptive_q.zoo", "main", "zoo", "show a trained agent"),
    "record-video": ("sb3_adaptive_q.zoo", "main", "zoo", "record a video of a trained agent"),
    "plot": ("sb3_adaptive_q.zoo", "main", "zoo", "plot how agents learned"),
    "study": ("sb3_adaptive_q.experiments.paper.command", "main", "study", "repeat the paper's experiment"),
    "league": ("sb3_adaptive_q.experiments.league.command", "main", "study", "compare step sizes on many environments"),
    "methods": ("sb3_adaptive_q.listing", "main", "", "list the methods with formulas and parameters"),
}


def main(arguments: list[str] | None = None) -> None:
    """
    Run a command.

    :param arguments: the command line; ``None`` for that of the process
    :raises SystemExit: if there is no such command, or what it needs is not installed
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    if not arguments or arguments[0] not in COMMANDS:
        listed = "\n".join(f"  {name:<14}{what}" for name, (_, _, _, what) in COMMANDS.items())
        wanted = arguments[:1] in ([], ["-h"], ["--help"])
        sys.exit(f"{'' if wanted else f'error: there is no command {arguments[0]!r}.{chr(10)}'}The commands are\n{listed}")
    module, function, extra, _ = COMMANDS[arguments[0]]
    try:
        command = getattr(importlib.import_module(module), function)
    except ModuleNotFoundError as error:
        if (error.name or "").startswith("sb3_adaptive_q") or not extra:
            raise
        sys.exit(f"error: this command needs {error.name}: install it with  pip install 'sb3-adaptive-q[{extra}]'")
    sys.exit(command(arguments if module == "sb3_adaptive_q.zoo" else arguments[1:]))


if __name__ == "__main__":
    main()
