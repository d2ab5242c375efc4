"""The entry of ``python -m sb3_adaptive_q.study``."""

import signal
import sys

from sb3_adaptive_q.study.command_line import main

# A spawned worker imports this module under another name
if __name__ == "__main__":
    # Cluster managers end a job this way: it deserves the care of an interrupt from the keyboard
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    sys.exit(main())
