"""The report of a study, in Markdown."""

import numpy as np

from sb3_adaptive_q.study import paper_data
from sb3_adaptive_q.study.claims import Judgement, judge_claims
from sb3_adaptive_q.study.markdown import format_estimate, format_number, markdown_table
from sb3_adaptive_q.study.q_tables import q_value_tables
from sb3_adaptive_q.study.results import Results
from sb3_adaptive_q.study.settings import PRESETS, StudySettings
from sb3_adaptive_q.study.statistics import Pair, compare_pairs, friedman, interquartile_mean, probability_best
from sb3_adaptive_q.study.systems import PAPER_SYSTEMS, title_of
from sb3_adaptive_q.study.tables import NOTE, results_markdown, results_table

METHOD_NOTE = (
    "A claim about means holds if Mann-Whitney tests of all pairs, corrected after Holm at the 5% level, set the method "
    "apart from every other one; it fails if they set another one above it; otherwise it is tied: so many runs cannot tell. "
    "Every run has a seed of its own, so that the runs of two methods are independent samples."
)


def write_report(results: Results, settings: StudySettings) -> str:
    """
    :param results: of a study
    :param settings: its design
    :return: the report
    """
    sections = [_introduction(settings)]
    judgements = judge_claims(results)
    if judgements:
        sections.append(_claims_section(judgements))
    sections += [_system_section(results, system) for system in results.systems]
    sections.append(_q_values_section(results, settings))
    sections.append(_inconsistencies_section())
    return "\n\n".join(section for section in sections if section) + "\n"


def table_heading(system: str) -> str:
    """
    :param system: a system of the study
    :return: what its table of results is called
    """
    return f"Table {PAPER_SYSTEMS[system].results_table}" if system in PAPER_SYSTEMS else "Results"


def _introduction(settings: StudySettings) -> str:
    systems = ", ".join(title_of(system) for system in settings.systems)
    methods = ", ".join(map(str, settings.methods))
    return (
        f"# Eight learning-rate methods of Q-learning, compared\n\n"
        f"{systems}; methods {methods}; {settings.runs} runs of {settings.episodes} episodes each; seed {settings.seed}; "
        f"γ = {settings.gamma:g}; ε from {settings.exploration_initial_eps:g} to {settings.exploration_final_eps:g}.\n"
        f"Preset `{settings.preset}`: {PRESETS[settings.preset]}."
    )


def _claims_section(judgements: list[Judgement]) -> str:
    rows = [
        [
            each.claim.name,
            title_of(each.claim.system),
            each.verdict,
            format_estimate(*each.effect),
            format_number(each.probability),
        ]
        for each in judgements
    ]
    table = markdown_table(["claim", "system", "verdict", "effect [95% interval]", "P(best)"], rows)
    lines = "\n".join(_claim_line(each) for each in judgements)
    return f"## The claims\n\n{table}\n\n{lines}\n\n{METHOD_NOTE}"


def _claim_line(judgement: Judgement) -> str:
    claim, verdict, _, effect_text, _, reason = judgement
    effect = f" Effect: {effect_text}." if effect_text else ""
    return f"- **{claim.name}**: {claim.text}. **{verdict.capitalize()}**: {reason}.{effect}"


def _system_section(results: Results, system: str) -> str:
    table = results_markdown(results_table(results, system))
    parts = [f"## {title_of(system)}\n\n### {table_heading(system)}\n\n{table}\n\n{NOTE}"]
    measures = (("avg", "last_return", "return of the last episode"), ("avg_100", "mean_last_100", "mean of the last 100"))
    for name, column, meaning in measures:
        parts.append(_comparison(results.samples(system, column), f"{name} ({meaning})"))
    return "\n\n".join(parts)


def _comparison(samples: dict[int, np.ndarray], measure: str) -> str:
    best = probability_best(samples)
    rows = [
        [f"Method {number}", format_estimate(*interquartile_mean(values)), format_number(best[number])]
        for number, values in samples.items()
    ]
    table = markdown_table(["", "interquartile mean", "P(best)"], rows)
    return f"### Comparison by {measure}\n\n{table}\n\n{_tests(samples)}"


def _tests(samples: dict[int, np.ndarray]) -> str:
    if len(samples) < 2 or min(len(values) for values in samples.values()) < 2:
        return "No tests: they need two methods and two runs."
    pairs = [pair for pair in compare_pairs(samples) if pair.is_significant]
    text = f"Friedman's test: {_p_value(friedman(samples))}. " if len(samples) > 2 else ""
    if not pairs:
        return f"{text}No two methods are told apart (Mann-Whitney, Holm)."
    rows = [_pair_row(pair) for pair in pairs]
    header = ["better", "worse", "difference of means", "p (Holm)", "P(a run beats one of the other)"]
    return f"{text}The pairs that are told apart (Mann-Whitney, Holm):\n\n{markdown_table(header, rows)}"


def _pair_row(pair: Pair) -> list[str]:
    first, second, difference, p_value, improvement = pair
    if difference < 0:
        first, second, difference, improvement = second, first, -difference, 1.0 - improvement
    numbers = [f"{difference:.3g}", _p_value(p_value).removeprefix("p ").removeprefix("= "), f"{improvement:.2f}"]
    return [f"Method {first}", f"Method {second}", *numbers]


def _p_value(value: float) -> str:
    return "p < 0.0001" if value < 1e-4 else f"p = {value:.4f}"


def _q_values_section(results: Results, settings: StudySettings) -> str:
    tables = q_value_tables(results, settings.gamma)
    return "\n\n".join(f"## Table {number}\n\n{caption}\n\n{text}" for number, (caption, _, text) in tables.items())


def _inconsistencies_section() -> str:
    rows = paper_data.inconsistencies().itertuples(index=False)
    lines = [f"- **{row.place}** ({row.printed}). {row.why}" for row in rows]
    return "## What in the paper cannot be right\n\n" + "\n".join(lines)
