"""Every algorithm against Q-learning, on both paths, and eligibility traces on tables of all sizes."""

from collections.abc import Callable
from typing import Any

import numpy as np
from gymnasium.wrappers import TimeLimit
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.monitor import Monitor

from benchmarks.measure import Contestant, Row, Times, measure, print_rows, speed_ratio
from benchmarks.table_size import EPISODE_STEPS, RandomTableEnv
from sb3_adaptive_q import ALGORITHMS, CompiledVecEnv, LeanVecEnv

ENV_ID = "FrozenLake-v1"
COMPILED_STEPS, ORDINARY_STEPS, TABLE_STEPS = 2_000_000, 30_000, 300_000
N_ROUNDS = 9
#: By title: the algorithm, its arguments, and at least how much of Q-learning's speed it shall have when compiled
VARIANTS: dict[str, tuple[str, dict[str, Any], float]] = {
    "SARSA": ("sarsa", {}, 0.9),
    "Expected SARSA": ("expected_sarsa", {}, 0.9),
    "Double Q-learning": ("double_q", {}, 0.75),
    "SARSA(0.9)": ("sarsa_lambda", {"trace_decay": 0.9}, 0.4),
    "Watkins's Q(0.9)": ("q_lambda", {"trace_decay": 0.9}, 0.4),
    "4-step SARSA": ("n_step", {"n": 4}, 0.6),
}
#: Of every algorithm on the ordinary path
ORDINARY_ASKED = 0.9
SMALL, LARGE = 1_000, 1_000_000


def main() -> None:
    """Print the ratios."""
    for title, kind, n_steps, asked in (
        ("compiled", CompiledVecEnv, COMPILED_STEPS, None),
        ("one step at a time", LeanVecEnv, ORDINARY_STEPS, ORDINARY_ASKED),
    ):
        runs = {name: _on_lake(kind, n_steps, key, arguments) for name, (key, arguments, _) in VARIANTS.items()}
        times = measure({"Q-learning": _on_lake(kind, n_steps, "tabular_q", {}), **runs}, N_ROUNDS)
        own = times.pop("Q-learning")
        rows = [
            speed_ratio(f"speed of {name} / of Q-learning", each, own, f"at least {asked or VARIANTS[name][2]}")
            for name, each in times.items()
        ]
        print_rows(f"{ENV_ID}, {title}: Q-learning {own.steps_per_second()}", rows)
    print_rows("SARSA(0.9) on random tables with 2 actions", [_table_row()])


def _on_lake(kind: type[LeanVecEnv], n_steps: int, algorithm: str, arguments: dict[str, Any]) -> Contestant:
    def prepare() -> Callable[[], Any]:
        env = make_vec_env(ENV_ID, vec_env_cls=kind)
        model = ALGORITHMS[algorithm]("MlpPolicy", env, method=1, seed=0, **arguments)
        return lambda: model.learn(n_steps)

    return Contestant(n_steps, prepare)


def _table_row() -> Row:
    """Nearly every step visits another state there, so that as many pairs are eligible as can be."""
    contestants = {}
    for n_states in (SMALL, LARGE):
        env = RandomTableEnv(n_states)
        for algorithm in ("sarsa", "sarsa_lambda"):
            vec_env = CompiledVecEnv([lambda env=env: Monitor(TimeLimit(env, EPISODE_STEPS))])
            model = ALGORITHMS[algorithm]("MlpPolicy", vec_env, method=1, seed=0)
            contestants[algorithm, n_states] = Contestant(TABLE_STEPS, lambda model=model: lambda: model.learn(TABLE_STEPS))
    times = measure(contestants, N_ROUNDS)
    added = {
        n_states: Times(
            *(np.subtract(*pair) for pair in zip(times["sarsa_lambda", n_states], times["sarsa", n_states], strict=True))
        )
        for n_states in (SMALL, LARGE)
    }
    speeds = f"{times['sarsa_lambda', SMALL].steps_per_second()} and {times['sarsa_lambda', LARGE].steps_per_second()}"
    what = f"time that the traces add, {LARGE:,} states / {SMALL:,} ({speeds})"
    return speed_ratio(what, added[SMALL], added[LARGE], f"far below {LARGE // SMALL}")


if __name__ == "__main__":
    main()
