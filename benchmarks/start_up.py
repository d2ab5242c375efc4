"""How much later a process begins to learn on the compiled path than on the per-step path."""

import os
import subprocess
import sys
import tempfile
import time

import numpy as np

from benchmarks.measure import Row, print_rows

N_ROUNDS = 3
PER_STEP = """
from benchmarks.models import discretize
import gymnasium, sb3_adaptive_q
env = gymnasium.make("{env_id}")
env = discretize(env) if "{env_id}".startswith("CartPole") else env
sb3_adaptive_q.TabularQ("MlpPolicy", env, method={method}).learn(100)
"""
COMPILED = """
from benchmarks.models import compiled_model
compiled_model("{env_id}", {method}).learn(100)
"""
#: The time that the interpreter needs to take itself apart is not meant
STOP = """
import os
os._exit(0)
"""


def main() -> None:
    """Print the seconds of the first processes with an empty cache, and of the next ones."""
    for env_id, method in (("FrozenLake-v1", 1), ("CartPoleFriction-v0", 7)):
        _start(PER_STEP, env_id, method, "")  # reads the libraries from the disk
        rounds = np.array([_measure_round(env_id, method) for _ in range(N_ROUNDS)])
        compiled_first, per_step_first, compiled_later = rounds.transpose(1, 2, 0)
        print_rows(
            f"{env_id}, method {method}: seconds until a process has learned a little, over a later one on the per-step path",
            [
                Row("first process on the compiled path", *compiled_first, asked="at most 3"),
                Row("first process on the per-step path", *per_step_first),
                Row("later processes on the compiled path", *compiled_later, asked="at most 0.2"),
            ],
        )


def _measure_round(env_id: str, method: int) -> np.ndarray:
    """Seconds over a later process on the per-step path: a row for each of the other processes, by CPU time and the clock."""
    with tempfile.TemporaryDirectory() as ours, tempfile.TemporaryDirectory() as theirs:
        runs = ((COMPILED, ours), (PER_STEP, theirs), (COMPILED, ours), (PER_STEP, theirs))
        *others, per_step = [_start(program, env_id, method, cache) for program, cache in runs]
        return np.array(others) - per_step


def _start(program: str, env_id: str, method: int, cache: str) -> np.ndarray:
    """Processor time and seconds of a process with this cache of compiled code."""
    environment = {**os.environ, "NUMBA_CACHE_DIR": cache}
    command = [sys.executable, "-c", program.format(env_id=env_id, method=method) + STOP]
    before, wall = os.times(), time.perf_counter()
    subprocess.run(command, env=environment, check=True)
    after = os.times()
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    return np.array([cpu, time.perf_counter() - wall])
