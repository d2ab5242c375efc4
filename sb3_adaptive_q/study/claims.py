"""The paper's claims, judged by the runs of a study."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from sb3_adaptive_q.callbacks import METHODS
from sb3_adaptive_q.study import paper_data
from sb3_adaptive_q.study.results import Results
from sb3_adaptive_q.study.statistics import Estimate, Pair, compare_pairs, estimate, probability_best, share
from sb3_adaptive_q.study.systems import PAPER_SYSTEMS

HOLDS, TIED, FAILS, NOT_JUDGED = "holds", "tied", "does not hold", "not judged"

#: The column of a run's value that a measure of the tables is made of
COLUMNS = {"max": "last_return", "avg": "last_return", "avg_100": "mean_last_100"}


class Claim(NamedTuple):
    """
    :param name: a short one
    :param system: the system that it is about
    :param kind: ``reach``: these methods, and no others, reach the limit; ``best``: the method has the largest mean (or
        maximum); ``behind``: these methods have smaller means than all others
    :param measure: ``max``, ``avg`` or ``avg_100``
    :param methods: the methods that it is about
    :param text: the claim in words
    """

    name: str
    system: str
    kind: str
    measure: str
    methods: tuple[int, ...]
    text: str


class Judgement(NamedTuple):
    """
    :param claim: a claim of the paper
    :param verdict: ``holds``, ``tied``, ``does not hold`` or ``not judged``
    :param effect: its size, with a 95% interval
    :param effect_text: what the effect is
    :param probability: that the method is the best, for a claim that it is; NaN for others
    :param reason: what the verdict rests on
    """

    claim: Claim
    verdict: str
    effect: Estimate
    effect_text: str
    probability: float
    reason: str


def paper_claims() -> list[Claim]:
    """
    :return: the claims of the paper
    """
    rows = paper_data.claims().astype(str).to_numpy().tolist()
    return [
        Claim(name, system, kind, measure, tuple(map(int, methods.split())), text)
        for name, system, kind, measure, methods, text in rows
    ]


def judge_claims(results: Results) -> list[Judgement]:
    """
    :param results: of a study
    :return: a judgement of every claim about one of its systems
    """
    return [judge(claim, results) for claim in paper_claims() if claim.system in results.systems]


def judge(claim: Claim, results: Results) -> Judgement:
    """
    :param claim: a claim about a system of the study
    :param results: of the study
    :return: the judgement
    """
    samples = results.samples(claim.system, COLUMNS[claim.measure])
    nothing = Estimate(np.nan, np.nan, np.nan)
    if set(samples) != set(METHODS):
        return Judgement(claim, NOT_JUDGED, nothing, "", np.nan, "it compares all eight methods")
    if len(samples[1]) < 2:
        return Judgement(claim, NOT_JUDGED, nothing, "", np.nan, "one run tells nothing of the next")
    judges: dict[str, Callable[[Claim, dict[int, np.ndarray]], Judgement]] = {
        "reach": _judge_reach,
        "best": _judge_maximum if claim.measure == "max" else _judge_best,
        "behind": _judge_behind,
    }
    return judges[claim.kind](claim, samples)


def _judge_reach(claim: Claim, samples: dict[int, np.ndarray]) -> Judgement:
    limit = PAPER_SYSTEMS[claim.system].limit
    reaching = {number: int((values >= limit).sum()) for number, values in samples.items()}
    missed = [number for number in claim.methods if not reaching[number]]
    uncalled = [number for number in samples if number not in claim.methods and reaching[number]]
    reasons = [f"no run of {_names(missed)} does"] if missed else []
    reasons += [f"runs of {_names(uncalled)} do so too"] if uncalled else []
    weakest = min(claim.methods, key=lambda number: reaching[number])
    return Judgement(
        claim,
        FAILS if reasons else HOLDS,
        share(reaching[weakest], len(samples[weakest])),
        f"share of runs whose last episode does, in Method {weakest}, the least of those named",
        np.nan,
        "; ".join(reasons) or "runs of just these methods do",
    )


def _judge_maximum(claim: Claim, samples: dict[int, np.ndarray]) -> Judgement:
    (number,) = claim.methods
    largest = {other: float(values.max()) for other, values in samples.items()}
    rival = max(value for other, value in largest.items() if other != number)
    equals = [other for other, value in largest.items() if other != number and value == largest[number]]
    verdict = HOLDS if largest[number] > rival else TIED if largest[number] == rival else FAILS
    return Judgement(
        claim,
        verdict,
        share(int((samples[number] >= max(largest.values())).sum()), len(samples[number])),
        f"share of runs of Method {number} whose last episode has the largest return of all",
        np.nan,
        f"{_names(equals)} reach the same"
        if verdict == TIED
        else f"its maximum is {largest[number]:g}, the others' {rival:g}",
    )


def _judge_best(claim: Claim, samples: dict[int, np.ndarray]) -> Judgement:
    (number,) = claim.methods
    rival = max((other for other in samples if other != number), key=lambda other: samples[other].mean())
    pairs = compare_pairs(samples)
    better = [other for other in samples if _is_below(number, other, pairs)]
    beaten = [other for other in samples if _is_below(other, number, pairs)]
    if len(beaten) == len(samples) - 1:
        verdict, reason = HOLDS, "significantly above every other method"
    elif better:
        verdict, reason = FAILS, f"significantly below {_names(better)}"
    else:
        equals = [other for other in samples if other not in (number, *beaten)]
        verdict, reason = TIED, f"not told apart from {_names(equals)}"
    return Judgement(
        claim,
        verdict,
        _difference(samples[number], samples[rival]),
        f"Method {number} less Method {rival}, the best of the others",
        probability_best(samples)[number],
        reason,
    )


def _judge_behind(claim: Claim, samples: dict[int, np.ndarray]) -> Judgement:
    others = [number for number in samples if number not in claim.methods]
    pairs = compare_pairs(samples)
    reversed_ = [f"{behind} above {other}" for behind in claim.methods for other in others if _is_below(other, behind, pairs)]
    equals = {behind: [other for other in others if not _is_below(behind, other, pairs)] for behind in claim.methods}
    if reversed_:
        verdict, reason = FAILS, f"the other way round, significantly: {', '.join(reversed_)}"
    elif any(equals.values()):
        reasons = [f"Method {behind} not told apart from {_names(found)}" for behind, found in equals.items() if found]
        verdict, reason = TIED, "; ".join(reasons)
    else:
        verdict, reason = HOLDS, "each significantly below every other method"
    front = max(claim.methods, key=lambda number: samples[number].mean())
    last = min(others, key=lambda number: samples[number].mean())
    return Judgement(
        claim,
        verdict,
        _difference(samples[front], samples[last]),
        f"Method {front}, the better of these, less Method {last}, the worst of the others",
        np.nan,
        reason,
    )


def _difference(first: np.ndarray, second: np.ndarray) -> Estimate:
    return estimate(lambda x, y, axis: x.mean(axis=axis) - y.mean(axis=axis), first, second)


def _is_below(number: int, other: int, pairs: list[Pair]) -> bool:
    """Whether the mean of a method is smaller than another's, and the test tells the two apart."""
    for pair in pairs:
        if {pair.first, pair.second} == {number, other}:
            difference = pair.difference if pair.first == number else -pair.difference
            return pair.is_significant and difference < 0
    return False


def _names(numbers: list[int]) -> str:
    return f"Method{'s' if len(numbers) > 1 else ''} {', '.join(map(str, numbers))}"
