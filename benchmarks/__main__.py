"""Run ``python -m benchmarks`` for all comparisons, or with some of their names for these."""

import argparse
import importlib

from benchmarks.measure import print_machine

NAMES = ("per_step", "compiled", "algorithms", "start_up", "table_size", "study")


def main() -> None:
    """Run the comparisons that are named on the command line."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="Compare speeds, as ratios within one run.")
    parser.add_argument("names", nargs="*", metavar="name", help=f"which comparisons: {', '.join(NAMES)} (default: all)")
    names = parser.parse_args().names
    unknown = sorted(set(names) - set(NAMES))
    if unknown:
        parser.error(f"there is no comparison {', '.join(unknown)}: choose from {', '.join(NAMES)}")
    print_machine()
    for name in names or NAMES:
        importlib.import_module(f"benchmarks.{name}").main()


if __name__ == "__main__":
    main()
