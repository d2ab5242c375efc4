"""Tables and verdicts, from results made up so that the right answer is known."""

import numpy as np
import pandas as pd
import pytest

from sb3_adaptive_q.experiments.cells import Cell
from sb3_adaptive_q.experiments.paper.claims import Claim, judge, judge_claims, paper_claims
from sb3_adaptive_q.experiments.paper.paper_data import paper_table, read_data
from sb3_adaptive_q.experiments.paper.report import write_report
from sb3_adaptive_q.experiments.paper.results import Results, make_series
from sb3_adaptive_q.experiments.paper.settings import StudySettings
from sb3_adaptive_q.experiments.paper.tables import q_value_tables, results_markdown, results_table
from sb3_adaptive_q.experiments.runner import Failure

POLE, LAKE = "CartPoleFriction-v0", "FrozenLake-v1"
RUNS = 20
ALL = range(1, 9)


def made_up(last: dict[int, list[float]], mean_last: dict[int, list[float]] | None = None, system: str = POLE) -> Results:
    """Results with these last returns, and these means of the last 100 (the same where not given), by number of the method."""
    mean_last = mean_last or last
    rows = [
        {"system": system, "method": f"Method {number}", "run": run, "seed": 0, "episodes": 1, "steps": 1}
        | {"last_return": float(value), "mean_last_100": float(mean_last[number][run])}
        for number, values in last.items()
        for run, value in enumerate(values)
    ]
    series = make_series([np.zeros(1)], [np.zeros(1)])
    shape = (16, 4) if system == LAKE else (11**4, 2)
    keys = [(system, f"Method {number}") for number in last]
    return Results(
        pd.DataFrame(rows), dict.fromkeys(keys, series), {key: np.arange(float(np.prod(shape))).reshape(shape) for key in keys}
    )


def around(center: float, seed: int = 0) -> list[float]:
    return (center + np.random.default_rng(seed).normal(size=RUNS)).tolist()


def claim(kind: str, measure: str, *methods: int, system: str = POLE) -> Claim:
    return Claim("X", system, kind, measure, tuple(f"Method {number}" for number in methods), "something")


def verdict(results: Results, kind: str, measure: str, *methods: int, system: str = POLE) -> str:
    return judge(claim(kind, measure, *methods, system=system), results).verdict


def test_best_by_far_holds() -> None:
    results = made_up({number: around(50.0 if number == 7 else 10.0, number) for number in ALL})
    judgement = judge(claim("best", "avg", 7), results)
    assert judgement.verdict == "holds" and judgement.probability == 1.0
    assert judgement.effect.value == pytest.approx(40.0, abs=2.0)
    assert judgement.effect.low < judgement.effect.value < judgement.effect.high


def test_best_among_equals_is_inconclusive() -> None:
    results = made_up({number: around(50.0 if number in (2, 7) else 10.0, number) for number in ALL})
    judgement = judge(claim("best", "avg", 7), results)
    assert judgement.verdict == "inconclusive" and "not significantly different from Method 2" in judgement.reason
    assert 0.0 < judgement.probability < 1.0


def test_best_that_is_beaten_fails() -> None:
    results = made_up({number: around(50.0 if number == 2 else 10.0, number) for number in ALL})
    judgement = judge(claim("best", "avg", 7), results)
    assert judgement.verdict == "does not hold" and judgement.reason == "significantly below Method 2"
    assert judgement.effect.high < 0.0


def test_measures_look_at_different_columns() -> None:
    last = {number: around(50.0 if number == 2 else 10.0, number) for number in ALL}
    mean_last = {number: around(50.0 if number == 7 else 10.0, number) for number in ALL}
    results = made_up(last, mean_last)
    assert verdict(results, "best", "avg", 7) == "does not hold"
    assert verdict(results, "best", "avg_100", 7) == "holds"


@pytest.mark.parametrize(("rival", "expected"), [(150, "holds"), (200, "inconclusive"), (201, "does not hold")])
def test_best_maximum(rival: float, expected: str) -> None:
    last = {number: [100.0] * 19 + [200.0 if number == 7 else 150.0] for number in ALL}
    last[3][0] = rival
    judgement = judge(claim("best", "max", 7), made_up(last))
    assert judgement.verdict == expected
    assert judgement.effect.value == (0.05 if rival <= 200 else 0.0)


@pytest.mark.parametrize(
    ("reaching", "expected"),
    [((1, 2, 7), "holds"), ((1, 2), "does not hold"), ((1, 2, 5, 7), "does not hold")],
)
def test_reaching_the_limit(reaching: tuple[int, ...], expected: str) -> None:
    last = {number: [100.0] * 19 + [200.0 if number in reaching else 199.0] for number in ALL}
    assert verdict(made_up(last), "reach", "max", 1, 2, 7) == expected


@pytest.mark.parametrize(("behind", "expected"), [(0.0, "holds"), (10.0, "inconclusive"), (20.0, "does not hold")])
def test_falling_behind(behind: float, expected: str) -> None:
    last = {number: around(behind if number == 8 else 0.0 if number == 6 else 10.0, number) for number in ALL}
    assert verdict(made_up(last), "behind", "avg", 6, 8) == expected


def test_no_verdict_without_all_methods_or_from_one_run() -> None:
    some = made_up({number: around(1.0) for number in (1, 7)})
    single = made_up({number: [1.0] for number in ALL})
    for results in (some, single):
        judgement = judge(claim("best", "avg", 7), results)
        assert judgement.verdict == "not judged" and judgement.reason


def test_only_claims_about_the_systems_of_the_study_are_judged() -> None:
    results = made_up({number: around(0.5, number) for number in ALL}, system=LAKE)
    assert [judgement.claim.name for judgement in judge_claims(results)] == ["FL1", "FL2", "FL3", "FL4", "FL5"]


def test_claims_are_those_of_the_paper() -> None:
    """Each claim that a method is the best is true of the paper's printed column, but for avg_100 of Table 8."""
    for each in paper_claims():
        table = paper_table(7 if each.system == LAKE else 8)
        table.index = [f"Method {number}" for number in table["method"]]
        named = list(each.methods)
        if each.kind == "best":
            is_best = table.loc[named[0], each.measure] == table[each.measure].max()
            assert is_best == (each.name != "CP4")
        elif each.kind == "reach":
            limit = 1 if each.system == LAKE else 200
            assert set(table.index[table["max"] == limit]) == set(named)
        else:
            assert table.loc[named, each.measure].max() < table.drop(named)[each.measure].min()


def test_effects_name_their_units() -> None:
    results = made_up({number: around(50.0 if number == 7 else 10.0, number) for number in ALL})
    units = {each.name: judge(each, results).unit for each in paper_claims() if each.system == POLE}
    assert units["CP3"].startswith("return of the last episode: Method 7 minus ")
    assert units["CP4"].startswith("mean return of the last 100 episodes: Method 7 minus ")
    assert units["CP2"].startswith("share of the runs of Method 7")
    assert units["CP1"] == "share of the runs of Method 1 (the lowest of these methods) that end with a return of 200"


def test_columns_are_as_the_paper_defines_them() -> None:
    """Table 7: min, max, avg, std over the last episodes; avg_100 over the runs' means."""
    last = {1: [1.0] * 7 + [0.0] * 13}
    table = results_table(made_up(last, {1: [0.5, 0.6] * 10}, system=LAKE), LAKE).set_index("statistic")
    assert table["value"].to_dict() == pytest.approx(
        {"min": 0.0, "max": 1.0, "avg": 0.35, "avg_100": 0.55, "std": 0.35**0.5 * 0.65**0.5}
    )
    assert table["paper"].to_dict() == {"min": 0.0, "max": 1.0, "avg": 0.35, "avg_100": 0.55, "std": 0.47}
    assert table["difference"].to_dict() == pytest.approx(
        {"min": 0.0, "max": 0.0, "avg": 0.0, "avg_100": 0.0, "std": 0.00697}, abs=1e-5
    )
    assert table.loc["avg", "low"] == pytest.approx(0.15, abs=0.051)
    assert table.loc["avg", "high"] == pytest.approx(0.55, abs=0.051)
    assert table.loc[["min", "max"], ["low", "high"]].isna().all(axis=None)


def test_markdown_has_ours_the_papers_and_the_difference() -> None:
    text = results_markdown(results_table(made_up({7: [200.0] * 10 + [100.0] * 10}), POLE))
    ours, paper, difference = text.splitlines()[2:]
    assert [cell.strip() for cell in paper.split("|")[1:-1]] == ["Method 7", "paper", "200", "200", "200", "187.65", "0"]
    assert [cell.strip() for cell in difference.split("|")[3:-1]] == ["-100.00", "+0.00", "-50.00", "-37.65", "+50.00"]
    assert "150.00 [" in ours and "50.00 [" in ours


def test_lake_table_sets_three_values_side_by_side() -> None:
    _, table, _ = q_value_tables(made_up({1: [0.0]}, system=LAKE), 0.99)[1]
    by_entry = table.set_index(["state", "action"])
    assert by_entry.loc[(1, 3), "learned"] == 7.0
    assert by_entry.loc[(14, 1), "optimal"] == pytest.approx(0.863, abs=5e-4)
    assert by_entry.loc[(1, 3), "paper"] == 0.48
    assert np.isnan(by_entry.loc[(5, 0), "paper"])


def test_cart_pole_table_has_the_rows_of_the_paper() -> None:
    _, table, text = q_value_tables(made_up({7: [0.0]}), 0.99)[6]
    assert table["state"].tolist() == [0, 0, 1, 1742, 1743, 14640, 14641]
    assert table["learned_1"].tolist()[:-1] == [1, 1, 3, 3485, 3487, 29281]
    assert text.splitlines()[-1].count("no such state") == 2


def report(results: Results, **settings: object) -> str:
    return write_report(results, StudySettings(**settings), {})  # type: ignore[arg-type]


def test_report_has_the_summary_first_and_the_errata_last() -> None:
    text = report(made_up({number: around(50.0 if number == 7 else 10.0, number) for number in ALL}), systems=(POLE,))
    headings = [line for line in text.splitlines() if line.startswith("## ")]
    assert headings[0] == "## The paper's claims" and headings[-1] == "## What in the paper cannot be right"
    summary = text.partition("\n## ")[0]
    assert "*Holds:* Method 7 has the best avg (Table 8: 200)" in summary
    assert "significantly above every other method" in summary
    assert all(row.why in text for row in read_data("inconsistencies").itertuples())


def test_report_on_other_systems_leaves_the_paper_alone() -> None:
    text = report(made_up({1: around(5.0), 2: around(6.0)}, system="Taxi-v4"), systems=("Taxi-v4",))
    assert "paper" not in text.lower().replace("paper's eight", "")


def test_report_of_a_single_run_of_a_single_method_has_no_numbers_that_are_none() -> None:
    text = report(made_up({3: [150.0]}), systems=(POLE,), methods=("3",), runs=1)
    assert "No tests" in text and "not judged" in text.lower() and "nan" not in text


def test_report_names_the_runs_that_failed() -> None:
    cell = Cell("", {}, labels={"system": POLE, "method": "Method 3", "run": 4})
    text = write_report(made_up({3: [150.0]}), StudySettings(), {}, [Failure(cell, "ValueError: not a number")])
    assert f"system {POLE}, method Method 3, run 4: ValueError: not a number" in text


def test_report_tells_how_to_repeat_it() -> None:
    text = report(made_up({3: [150.0]}), systems=(POLE,), methods=("3",), beta_1=0.02, sweep=("gamma=0.9,0.99", "beta_3=0.1"))
    command = (
        "python -m sb3_adaptive_q study --systems CartPoleFriction-v0 --methods 3 --sweep gamma=0.9,0.99 --sweep beta_3=0.1"
    )
    assert f"`{command} --beta-1 0.02`" in text
