"""The entry of ``python -m sb3_adaptive_q.experiments.league``."""

import sys

from sb3_adaptive_q.experiments.league.command import main

# A spawned worker imports this module under another name
if __name__ == "__main__":
    sys.exit(main())
