"""The entry of ``python -m sb3_adaptive_q.experiments.paper``."""

import sys

from sb3_adaptive_q.experiments.paper.command import main

# A spawned worker imports this module under another name
if __name__ == "__main__":
    sys.exit(main())
