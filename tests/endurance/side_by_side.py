"""Trainings side by side, in threads and in processes, on both paths: each ends as it would alone, in every bit."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from helpers.algorithms import algorithms
from helpers.interrupted import Training, assert_goes_on, outcome_in, run_in_process, train

LENGTHS = {False: 30_000, True: 3_000_000}


def make_trainings(compiled: bool) -> list[Training]:
    """One of every algorithm, on all kinds of environments."""
    total, names = LENGTHS[compiled], ("slippery lake", "Taxi", "CartPole")
    return [
        Training(names[i % 3], compiled, 1 + i % 2, total, total, {"seed": i, "method": 7}, kind)
        for i, kind in enumerate(algorithms())
    ]


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("compiled", [False, True])
@pytest.mark.parametrize("where", ["threads", "processes"])
def test_each_as_alone(tmp_path: Path, where: str, compiled: bool) -> None:
    trainings = make_trainings(compiled)
    folders = [tmp_path / str(i) for i in range(len(trainings))]
    for folder in folders:
        folder.mkdir()
    if where == "threads":
        with ThreadPoolExecutor(len(trainings)) as executor:
            together = list(executor.map(train, trainings, folders))
    else:
        processes = [run_in_process(*each) for each in zip(trainings, folders, strict=True)]
        for process in processes:
            process.join()
        together = [outcome_in(folder) for folder in folders]
    for training, outcome in zip(trainings, together, strict=True):
        assert_goes_on(outcome, train(training, tmp_path / "alone"), 0)
