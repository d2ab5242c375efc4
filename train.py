"""Train a tabular agent: ``python train.py --env FrozenLake-v1 --method 7 -P -tb runs``; ``--help`` lists the options."""

import sys

try:
    from sb3_adaptive_q.zoo import main
except ModuleNotFoundError as error:
    if error.name is None or error.name.startswith("sb3_adaptive_q"):
        raise
    sys.exit(
        f"train.py: error: The module {error.name} is missing: please install sb3-adaptive-q[zoo], or use .venv/bin/python."
    )

if __name__ == "__main__":
    main()
