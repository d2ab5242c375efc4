"""
Fifty SIGKILLs at random moments, over both paths, all algorithms, three methods, and one and three environments.

Every training is killed twice, each time in another process, and then ends as the uninterrupted one, bit for bit. Run with
``python -m pytest tests/endurance/killed_trainings.py``; it takes about ten minutes.
"""

import itertools
import random

import pytest
from helpers.algorithms import algorithms
from helpers.interrupted import (
    Training,
    assert_goes_on,
    checkpoints,
    kill_at_random,
    outcome_in,
    run_in_process,
    train,
    was_killed,
)

N_TRAININGS = 25
#: Steps of a training and between two checkpoints of one environment, by the path
LENGTHS = {False: (90_000, 500), True: (9_000_000, 25_000)}


def make_trainings() -> list[Training]:
    choices = random.Random(0)
    kinds = itertools.cycle(algorithms())
    combinations = list(itertools.product((False, True), (3, 7, "autostep"), (1, 3), ("slippery lake", "Taxi", "CartPole")))
    choices.shuffle(combinations)
    return [
        Training(env, compiled, n_envs, *LENGTHS[compiled], {"seed": i, "method": method}, next(kinds))
        for i, (compiled, method, n_envs, env) in enumerate(combinations[:N_TRAININGS])
    ]


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("training", make_trainings(), ids=str)
def test_two_kills_change_nothing(tmp_path, training):
    moments, checkpoint, step = random.Random(str(training)), None, 0
    for _ in range(2):
        process = run_in_process(training, tmp_path, checkpoint)
        kill_at_random(process, tmp_path, training, moments)
        assert was_killed(process)
        step, checkpoint = checkpoints(tmp_path)[-1]
    process = run_in_process(training, tmp_path, checkpoint)
    whole = train(training, tmp_path / "whole")
    process.join()
    assert_goes_on(outcome_in(tmp_path), whole, step)
