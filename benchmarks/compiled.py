"""The compiled path as a whole, against bare loops that do nothing but learn."""

import tempfile
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from benchmarks import bare_loops, fastest_loops
from benchmarks.bare_loops import SIZES, make_memory_loop
from benchmarks.measure import Contestant, Row, Times, measure, print_rows, speed_ratio
from benchmarks.models import PlainCallback, compiled_model
from sb3_adaptive_q import learn_many

SEED = 0
METHODS = (1, 7)
N_ROUNDS = 9
#: Long enough for each kind of episode end, and no multiple of a rollout
CHECKED_STEPS = 300_001


class System(NamedTuple):
    """
    What is learned.

    :param env_id: the environment
    :param n_steps: the steps of a run
    :param bare: makes the bare loop of a method
    :param fastest: makes the fastest loop of a method
    :param asked: by the method, at least how much of the bare loop's speed
    """

    env_id: str
    n_steps: int
    bare: Callable[[int], Callable[[int, int], np.ndarray]]
    fastest: Callable[[int], Callable[[int, int], np.ndarray]]
    asked: dict[int, float]


SYSTEMS = (
    System("FrozenLake-v1", 8_000_000, bare_loops.make_lake_loop, fastest_loops.make_lake_loop, {1: 0.92, 7: 0.9}),
    System("CartPoleFriction-v0", 4_000_000, bare_loops.make_pole_loop, fastest_loops.make_pole_loop, {1: 0.95, 7: 0.95}),
)


def main() -> None:
    """Print the ratios for both systems and methods 1 and 7, for step sizes with memory, and for two learners at a time."""
    with tempfile.TemporaryDirectory() as folder:
        for system in SYSTEMS:
            for method in METHODS:
                _compare(system, method, folder)
    print_rows("FrozenLake-v1, step sizes with memory: speed of TabularQ / of the bare loop", list(map(_with_memory, SIZES)))
    print_rows("two learners on two cores", [_speed_up(system) for system in SYSTEMS])


def check_sameness(env_id: str, method: int | str, bare: Callable[[int, int], np.ndarray]) -> None:
    """
    :param env_id: what is learned
    :param method: how
    :param bare: the bare loop
    :raises AssertionError: if it does not end with TabularQ's table, bit for bit: then it does other work
    """
    model = compiled_model(env_id, method, SEED).learn(CHECKED_STEPS)
    np.testing.assert_array_equal(bare(SEED, CHECKED_STEPS), model.q_table)


def _compare(system: System, method: int, folder: str) -> None:
    bare, fastest = system.bare(method), system.fastest(method)
    check_sameness(system.env_id, method, bare)

    def prepare(**options: Any) -> Callable[[], Any]:
        model = compiled_model(system.env_id, method, SEED, **options)
        return lambda: model.learn(system.n_steps, callback=PlainCallback())

    times = measure(
        {
            "TabularQ": Contestant(system.n_steps, prepare),
            "with TensorBoard": Contestant(system.n_steps, lambda: prepare(tensorboard_log=folder)),
            "ties at random": Contestant(system.n_steps, lambda: prepare(ties="random")),
            "four environments": Contestant(system.n_steps, lambda: prepare(n_envs=4)),
            "bare loop": Contestant(system.n_steps, lambda: lambda: bare(SEED, system.n_steps)),
            "fastest loop": Contestant(system.n_steps, lambda: lambda: fastest(SEED, system.n_steps)),
        },
        N_ROUNDS,
    )
    speeds = ", ".join(f"{name} {each.steps_per_second()}" for name, each in times.items())
    print_rows(f"{system.env_id}, method {method}, compiled: {speeds}", _rows(times, system.asked[method]))


def _rows(times: dict[str, Times], asked: float) -> list[Row]:
    own, bare = times["TabularQ"], times["bare loop"]
    return [
        speed_ratio("speed of TabularQ / of the bare loop", own, bare, f"at least {asked}"),
        speed_ratio("the same with TensorBoard", times["with TensorBoard"], bare, "at least 0.8"),
        speed_ratio("speed with ties broken at random / by the first action", times["ties at random"], own, "at least 0.93"),
        speed_ratio("speed of four environments / of one", times["four environments"], own, "at least 1"),
        speed_ratio("speed of the fastest loop, with other draws / of the bare loop", times["fastest loop"], bare),
    ]


def _with_memory(name: str) -> Row:
    bare, n_steps = make_memory_loop(name), SYSTEMS[0].n_steps
    check_sameness("FrozenLake-v1", name, bare)

    def prepare() -> Callable[[], Any]:
        model = compiled_model("FrozenLake-v1", name, SEED)
        return lambda: model.learn(n_steps)

    contestants = {"own": Contestant(n_steps, prepare), "bare": Contestant(n_steps, lambda: lambda: bare(SEED, n_steps))}
    times = measure(contestants, N_ROUNDS)
    return speed_ratio(f"{name}, {times['own'].steps_per_second()}", times["own"], times["bare"], "at least 0.8")


def _speed_up(system: System) -> Row:
    def prepare(n_models: int) -> Callable[[], Any]:
        models = [compiled_model(system.env_id, 7, seed) for seed in range(n_models)]
        return lambda: learn_many(models, 4 * system.n_steps, workers=n_models)

    times = measure({"one": Contestant(1, lambda: prepare(1)), "two": Contestant(1, lambda: prepare(2))}, N_ROUNDS)
    gain = 2.0 * times["one"].wall / times["two"].wall
    # Processor time tells how much the two hinder each other, whatever else the cores have to do
    hindrance = 2.0 * times["one"].cpu / times["two"].cpu
    return Row(f"{system.env_id}: speed of two / of one", 2.0 * hindrance, gain, "at least 1.85 by the clock")
