"""The report of a study, in Markdown: what came of it first, what cannot be right in the paper last."""

import shlex
from collections.abc import Mapping, Sequence

from sb3_adaptive_q.experiments.options import options_of
from sb3_adaptive_q.experiments.paper.claims import NOT_JUDGED, Judgement, judge_claims
from sb3_adaptive_q.experiments.paper.comparison import (
    Pair,
    Samples,
    compare_pairs,
    estimate,
    interquartile_mean,
    kruskal_wallis,
    probability_best,
)
from sb3_adaptive_q.experiments.paper.paper_data import read_data
from sb3_adaptive_q.experiments.paper.results import Results
from sb3_adaptive_q.experiments.paper.settings import PAPER_SYSTEMS, PRESETS, StudySettings, title_of
from sb3_adaptive_q.experiments.paper.tables import NOTE, q_value_tables, results_markdown, results_table
from sb3_adaptive_q.experiments.runner import Failure
from sb3_adaptive_q.experiments.text import format_estimate, format_number, join, markdown_table, p_value
from sb3_adaptive_q.experiments.versions import commit, versions

CLAIM_NOTE = (
    "A claim about means *holds* if Mann-Whitney tests of all pairs of methods, corrected after Holm at the 5 % level, set "
    "the method apart from every other one. It *does not hold* if they set another method above it. Otherwise it is "
    "*inconclusive*: with this number of runs the difference is not significant, which does not mean that the methods are "
    "equal. Every run has a seed of its own, so the runs of two methods are independent samples."
)
PAIR_TEST = "Mann-Whitney tests of all pairs, corrected after Holm at the 5 % level"
#: For each system the names of the files of its figures, with their captions
Figures = Mapping[str, Sequence[tuple[str, str]]]


def write_report(
    results: Results,
    settings: StudySettings,
    figures: Mapping[str, Sequence[tuple[str, str]]],
    failures: Sequence[Failure] = (),
) -> str:
    """
    :param results: of a study
    :param settings: its design
    :param figures: for each system the names of the files of its figures, with their captions
    :param failures: the runs that failed
    :return: the report
    """
    judgements = judge_claims(results)
    sections = [_summary(results, settings, judgements), _failures(failures)]
    sections += [_claims(judgements)] if judgements else []
    for system in results.systems:
        sections += [_system(results, system), *(f"![{caption}]({name}.png)" for name, caption in figures.get(system, ()))]
    tables = q_value_tables(results, settings.gamma)
    sections += [f"## Table {number}\n\n{caption}\n\n{text}" for number, (caption, _, text) in tables.items()]
    sections.append(_how_to_repeat(settings))
    if any(system in PAPER_SYSTEMS for system in results.systems):
        sections.append(_inconsistencies())
    return "\n\n".join(section for section in sections if section) + "\n"


def _summary(results: Results, settings: StudySettings, judgements: Sequence[Judgement]) -> str:
    lines = [f"- {title_of(system)}: {best_method(results.samples(system, 'mean_last_100'))}." for system in results.systems]
    judged = [each for each in judgements if each.verdict != NOT_JUDGED]
    lines += [f"- *{each.verdict.capitalize()}:* {each.claim.text}. Here: {each.reason}." for each in judged]
    reasons = dict.fromkeys(each.reason for each in judgements if each.verdict == NOT_JUDGED)
    lines += [f"- *Not judged:* {reason}." for reason in reasons]
    title = "Eight learning-rate methods of Q-learning, compared"
    if len({method for _, method in results.series}) != 8 or not judgements:
        title = "Learning-rate methods, compared"
    what = (
        f"{join([title_of(system) for system in results.systems])}; {settings.runs} runs of {settings.episodes} episodes each."
    )
    return f"# {title}\n\n{what}\n\n" + "\n".join(lines)


def best_method(samples: Samples) -> str:
    """
    :param samples: by method
    :return: the method with the largest mean, and the methods that it is significantly above, in words
    """
    best = max(samples, key=lambda method: samples[method].mean())
    text = f"{best} has the largest mean return of the last 100 episodes, {samples[best].mean():.2f}"
    if len(samples) < 2 or min(map(len, samples.values())) < 2:
        return text
    apart = [pair.worse_and_better for pair in compare_pairs(samples) if pair.is_significant]
    below = [worse for worse, better in apart if better == best]
    return f"{text}, significantly above {join(below) if below else 'no other'}"


def _failures(failures: Sequence[Failure]) -> str:
    if not failures:
        return ""
    lines = "\n".join(f"- {failure.cell}: {failure.reason}" for failure in failures)
    return f"## Runs that failed\n\n{len(failures)} runs failed, and are missing from all that follows:\n\n{lines}"


def _claims(judgements: Sequence[Judgement]) -> str:
    rows = [
        [
            each.claim.name,
            title_of(each.claim.system),
            each.claim.text,
            each.verdict,
            format_estimate(*each.effect),
            each.unit,
            format_number(each.probability),
        ]
        for each in judgements
    ]
    header = [
        "claim",
        "system",
        "what the paper says",
        "verdict",
        "effect [95 % interval]",
        "what the effect is, and its unit",
    ]
    table = markdown_table([*header, "probability of being the best (bootstrap)"], rows)
    return f"## The paper's claims\n\n{CLAIM_NOTE}\n\n{table}"


def _system(results: Results, system: str) -> str:
    heading = f"{title_of(system)}" + (f" (Table {PAPER_SYSTEMS[system].results_table})" if system in PAPER_SYSTEMS else "")
    parts = [f"## {heading}\n\n{results_markdown(results_table(results, system))}\n\n{NOTE}"]
    measures = {"last_return": "return of the last episode", "mean_last_100": "mean return of the last 100 episodes"}
    return "\n\n".join([*parts, *(_comparison(results.samples(system, column), text) for column, text in measures.items())])


def _comparison(samples: Samples, measure: str) -> str:
    best = probability_best(samples)
    rows = [
        [method, format_estimate(*estimate(interquartile_mean, values)), format_number(best[method])]
        for method, values in samples.items()
    ]
    table = markdown_table(["method", "interquartile mean (return)", "probability of being the best (bootstrap)"], rows)
    return f"### Comparison by the {measure}\n\n{table}\n\n{_tests(samples)}"


def _tests(samples: Samples) -> str:
    if len(samples) < 2 or min(map(len, samples.values())) < 2:
        return "No tests: they need two methods and two runs."
    pairs = [pair for pair in compare_pairs(samples) if pair.is_significant]
    text = (
        f"Kruskal-Wallis test of no difference between the methods: {p_value(kruskal_wallis(samples))}. "
        if len(samples) > 2
        else ""
    )
    if not pairs:
        return f"{text}Inconclusive: no two methods differ significantly with this number of runs ({PAIR_TEST})."
    header = [
        "better",
        "worse",
        "difference of the means (return)",
        "p value (Holm)",
        "probability that a run of the better one has the larger return",
    ]
    table = markdown_table(header, [_pair_row(pair) for pair in pairs])
    return f"{text}The pairs that differ significantly ({PAIR_TEST}):\n\n{table}"


def _pair_row(pair: Pair) -> list[str]:
    first, second, difference, p, improvement = pair
    if difference < 0:
        first, second, difference, improvement = second, first, -difference, 1.0 - improvement
    return [first, second, f"{difference:.3g}", p_value(p).removeprefix("p ").removeprefix("= "), f"{improvement:.2f}"]


def _how_to_repeat(settings: StudySettings) -> str:
    default = StudySettings().as_data()
    options = options_of({name: value for name, value in settings.as_data().items() if value != default[name]})
    rows = [[name, f"`{value}`"] for name, value in settings.as_data().items()]
    rows += [[name, number] for name, number in {**versions(), "commit": commit() or "unknown"}.items()]
    return (
        f"## What was run, and how to repeat it\n\n`{shlex.join(['python', '-m', 'sb3_adaptive_q', 'study', *options])}` "
        "repeats it: with the same versions every number is the same.\n\n"
        f"Preset `{settings.preset}`: {PRESETS[settings.preset]}.\n\n{markdown_table(['setting or version', 'value'], rows)}"
    )


def _inconsistencies() -> str:
    rows = read_data("inconsistencies").itertuples(index=False)
    lines = [f"- **{row.place}** ({row.printed}). {row.why}" for row in rows]
    return "## What in the paper cannot be right\n\n" + "\n".join(lines)
