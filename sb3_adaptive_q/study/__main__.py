"""The entry of ``python -m sb3_adaptive_q.study``."""

import signal
import sys

try:
    from sb3_adaptive_q.study.command_line import main
except ModuleNotFoundError as error:
    if error.name is None or error.name.startswith("sb3_adaptive_q"):
        raise
    sys.exit(f"Error: The module {error.name} is missing: please install sb3-adaptive-q[study], or use .venv/bin/python.")

# A spawned worker imports this module under another name
if __name__ == "__main__":
    # Cluster managers end a job this way: it deserves the care of an interrupt from the keyboard
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    sys.exit(main())
