"""The runs that RL Zoo has stored: which of them to show, and a picture of how they learned."""

import argparse
import sys
import warnings
from pathlib import Path

from huggingface_sb3 import EnvironmentName  # type: ignore[import-untyped]

from sb3_adaptive_q.output import locate

#: Where runs are, unless the command line says otherwise
FOLDER = "logs"


def with_latest_model(arguments: list[str]) -> list[str]:
    """
    Choose the latest run that has a model. RL Zoo itself takes the latest run, which has none after ``--optimize``.

    :param arguments: the command line of RL Zoo's ``enjoy`` or ``record_video``, with ``--algo``, ``--env`` and ``-f``
    :return: the command line with that run, if it did not name one
    """
    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("--algo")
    parser.add_argument("--env", type=EnvironmentName)
    parser.add_argument("-f", "--folder")
    parser.add_argument("--exp-id", type=int, default=0)
    known, _ = parser.parse_known_args(arguments)
    if known.exp_id != 0:
        return arguments
    runs = {path.parent.name.removeprefix(f"{known.env}_") for path in Path(known.folder, known.algo).glob("*/*.zip")}
    numbers = [int(number) for number in runs if number.isdecimal()]
    return [*arguments, "--exp-id", str(max(numbers))] if numbers else arguments


def plot_training(arguments: list[str]) -> None:
    """
    Run RL Zoo's ``plot_train``, which plots the returns of trainings, and save the picture where a file is named.

    :param arguments: its command line, and ``-o FILE``
    :raises SystemExit: if there is nothing to plot, no file is named and no window can be opened, or a library is missing
    """
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("-o", "--output", type=Path)
    ours, rest = parser.parse_known_args(arguments)
    try:
        import matplotlib.pyplot as plt
        from rl_zoo3.plots.plot_train import plot_train
    except ModuleNotFoundError as error:
        sys.exit(f"error: plot needs {error.name}: install it with  pip install 'sb3-adaptive-q[zoo-plots]'")
    if ours.output:
        plt.switch_backend("agg")
    elif plt.get_backend().lower() == "agg" and not {"-h", "--help"} & set(rest):
        sys.exit("error: no window can be opened here: name a picture file with -o, such as -o training.png")
    sys.argv[1:] = rest
    with warnings.catch_warnings():
        # That nothing is shown; and that there is no curve, which is said below
        warnings.filterwarnings("ignore", "FigureCanvasAgg|No artists", UserWarning)
        try:
            plot_train()
        except OSError as error:
            sys.exit(f"error: {error}")
        except (AssertionError, LookupError, TypeError, ValueError) as error:
            sys.exit(f"error: nothing can be plotted with these options and monitor files: {locate(error)}")
    if not plt.gca().lines:
        sys.exit("error: no training there has as many episodes as a point is the mean of: train longer, or give -w a number")
    if ours.output:
        try:
            picture = ours.output if ours.output.suffix else ours.output.with_suffix(".png")
            plt.savefig(picture)
        except (OSError, ValueError) as error:
            sys.exit(f"error: the picture cannot be written: {error}")
        print(f"The picture is in {picture}.")
    plt.close()
