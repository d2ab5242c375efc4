"""The paper's claims, judged by the runs of a study."""

from typing import NamedTuple

import numpy as np

from sb3_adaptive_q.experiments.text import join
from sb3_adaptive_q.experiments.paper.comparison import (
    Samples,
    compare_pairs,
    difference_of_means,
    estimate,
    probability_best,
    share,
)
from sb3_adaptive_q.experiments.paper.paper_data import read_data
from sb3_adaptive_q.experiments.paper.results import Results
from sb3_adaptive_q.experiments.paper.settings import PAPER_METHODS, PAPER_SYSTEMS
from sb3_adaptive_q.experiments.statistics import Estimate

HOLDS, INCONCLUSIVE, FAILS, NOT_JUDGED = "holds", "inconclusive", "does not hold", "not judged"

#: The column of a run's value that a measure of the tables is made of, and what the measure is
COLUMNS = {"max": "last_return", "avg": "last_return", "avg_100": "mean_last_100"}
MEANINGS = {"avg": "return of the last episode", "avg_100": "mean return of the last 100 episodes"}


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
    methods: tuple[str, ...]
    text: str


class Judgement(NamedTuple):
    """
    :param claim: a claim of the paper
    :param verdict: ``holds``, ``inconclusive``, ``does not hold`` or ``not judged``
    :param reason: what the verdict rests on
    :param effect: its size, with a 95% interval
    :param unit: what the effect is, with its unit
    :param probability: that the method is the best, for a claim that it is; NaN for others
    """

    claim: Claim
    verdict: str
    reason: str
    effect: Estimate = Estimate(np.nan, np.nan, np.nan)
    unit: str = ""
    probability: float = np.nan


def paper_claims() -> list[Claim]:
    """
    :return: the claims of the paper
    """
    rows = read_data("claims").astype(str).to_numpy().tolist()
    return [
        Claim(name, system, kind, measure, tuple(f"Method {number}" for number in methods.split()), text)
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
    if not set(samples) >= set(PAPER_METHODS):
        return Judgement(claim, NOT_JUDGED, "it compares all eight methods, with one setting each")
    samples = {method: samples[method] for method in PAPER_METHODS}
    if min(map(len, samples.values())) < 2:
        return Judgement(claim, NOT_JUDGED, "one run does not say how much the next one differs")
    if claim.kind == "reach":
        return _judge_reach(claim, samples)
    if claim.kind == "behind":
        return _judge_behind(claim, samples)
    return _judge_maximum(claim, samples) if claim.measure == "max" else _judge_best(claim, samples)


def _judge_reach(claim: Claim, samples: Samples) -> Judgement:
    limit = PAPER_SYSTEMS[claim.system].limit
    reaching = {method: int((values >= limit).sum()) for method, values in samples.items()}
    missed = [method for method in claim.methods if not reaching[method]]
    uncalled = [method for method in samples if method not in claim.methods and reaching[method]]
    reasons = [f"no run of {join(missed)} ends with a return of {limit:g}"] if missed else []
    reasons += [f"runs of {join(uncalled)} do so as well"] if uncalled else []
    weakest = min(claim.methods, key=lambda method: reaching[method] / len(samples[method]))
    return Judgement(
        claim,
        FAILS if reasons else HOLDS,
        "; ".join(reasons) or f"at least one run of each of these methods ends with a return of {limit:g}, and no other does",
        share(reaching[weakest], len(samples[weakest])),
        f"share of the runs of {weakest} (the lowest of these methods) that end with a return of {limit:g}",
    )


def _judge_maximum(claim: Claim, samples: Samples) -> Judgement:
    (method,) = claim.methods
    largest = {other: float(values.max()) for other, values in samples.items()}
    rival = max(value for other, value in largest.items() if other != method)
    equals = [other for other, value in largest.items() if other != method and value == largest[method]]
    verdict = HOLDS if largest[method] > rival else INCONCLUSIVE if largest[method] == rival else FAILS
    return Judgement(
        claim,
        verdict,
        f"{join(equals)} reach the same maximum of {rival:g}"
        if verdict == INCONCLUSIVE
        else f"its maximum is {largest[method]:g}, that of the others {rival:g}",
        share(int((samples[method] >= max(largest.values())).sum()), len(samples[method])),
        f"share of the runs of {method} whose last episode has the largest return of all",
    )


def _judge_best(claim: Claim, samples: Samples) -> Judgement:
    (method,) = claim.methods
    rival = max((other for other in samples if other != method), key=lambda other: samples[other].mean())
    below = _significantly_below(samples)
    better = [other for other in samples if (method, other) in below]
    equals = [other for other in samples if other != method and (other, method) not in below]
    if better:
        verdict, reason = FAILS, f"significantly below {join(better)}"
    elif equals:
        verdict = INCONCLUSIVE
        reason = f"{samples[method].mean():.2f}, not significantly different from {_some(equals, samples)}"
    else:
        verdict, reason = HOLDS, "significantly above every other method"
    return Judgement(
        claim,
        verdict,
        reason,
        _difference(samples[method], samples[rival]),
        f"{MEANINGS[claim.measure]}: {method} minus {rival} (the best of the others)",
        probability_best(samples)[method],
    )


def _judge_behind(claim: Claim, samples: Samples) -> Judgement:
    others = [method for method in samples if method not in claim.methods]
    below = _significantly_below(samples)
    reversed_ = [f"{behind} above {other}" for behind in claim.methods for other in others if (other, behind) in below]
    equals = {behind: [other for other in others if (behind, other) not in below] for behind in claim.methods}
    if reversed_:
        verdict, reason = FAILS, f"significantly the other way round: {join(reversed_)}"
    elif any(equals.values()):
        reasons = [f"{behind} is not significantly below {join(found)}" for behind, found in equals.items() if found]
        verdict, reason = INCONCLUSIVE, "; ".join(reasons)
    else:
        verdict, reason = HOLDS, "each is significantly below every other method"
    front = max(claim.methods, key=lambda method: samples[method].mean())
    last = min(others, key=lambda method: samples[method].mean())
    return Judgement(
        claim,
        verdict,
        reason,
        _difference(samples[front], samples[last]),
        f"{MEANINGS[claim.measure]}: {front} (the better of these) minus {last} (the worst of the others)",
    )


def _difference(first: np.ndarray, second: np.ndarray) -> Estimate:
    return estimate(difference_of_means, first, second)


def _significantly_below(samples: Samples) -> set[tuple[str, str]]:
    """The pairs of methods that the test tells apart, the worse one first."""
    return {pair.worse_and_better for pair in compare_pairs(samples) if pair.is_significant}


def _some(methods: list[str], samples: Samples) -> str:
    return "any other method" if len(methods) == len(samples) - 1 else join(methods)
