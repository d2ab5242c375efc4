"""Train a tabular agent, for example ``python train.py --env FrozenLake-v1 --method 7 -P``; ``--help`` lists the options."""

import sys

try:
    from sb3_adaptive_q.zoo import main
except ModuleNotFoundError as error:
    if error.name is None or error.name.startswith("sb3_adaptive_q"):
        raise
    sys.exit(
        f"train.py: error: the package {error.name} is not installed. Install it with  pip install -e '.[zoo]'  or run "
        "train.py with .venv/bin/python."
    )

if __name__ == "__main__":
    main()
