"""Tables and verdicts, from results made up so that the right answer is known."""

import numpy as np
import pandas as pd
import pytest

from sb3_adaptive_q import METHODS
from sb3_adaptive_q.study import StudySettings
from sb3_adaptive_q.study.claims import Claim, judge, judge_claims, paper_claims
from sb3_adaptive_q.study.paper_data import inconsistencies, paper_table
from sb3_adaptive_q.study.q_tables import lake_table
from sb3_adaptive_q.study.report import write_report
from sb3_adaptive_q.study.results import Results, _Sums
from sb3_adaptive_q.study.tables import results_markdown, results_table, table_files

POLE, LAKE = "CartPoleFriction-v0", "FrozenLake-v1"
RUNS = 20


def made_up(last: dict[int, list[float]], mean_last: dict[int, list[float]] | None = None, system: str = POLE) -> Results:
    """Results with these last returns, and these means of the last 100 (the same where not given), by method."""
    mean_last = mean_last or last
    rows = [
        {"system": system, "method": number, "run": run, "seed": 0, "episodes": 1, "steps": 1}
        | {"last_return": float(value), "mean_last_100": float(mean_last[number][run])}
        for number, values in last.items()
        for run, value in enumerate(values)
    ]
    series = {}
    for number in last:
        sums = _Sums(1)
        sums.add(np.zeros(1), np.zeros(1))
        series[system, number] = sums.series()
    shape = (16, 4) if system == LAKE else (11**4, 2)
    return Results(pd.DataFrame(rows), series, {(system, number): np.zeros(shape) for number in last})


def around(center: float, seed: int = 0) -> list[float]:
    return (center + np.random.default_rng(seed).normal(size=RUNS)).tolist()


def claim(kind: str, measure: str, *methods: int, system: str = POLE) -> Claim:
    return Claim("X", system, kind, measure, methods, "something")


def verdict(results: Results, kind: str, measure: str, *methods: int, system: str = POLE) -> str:
    return judge(claim(kind, measure, *methods, system=system), results).verdict


def test_best_by_far_holds() -> None:
    results = made_up({number: around(50.0 if number == 7 else 10.0, number) for number in METHODS})
    judgement = judge(claim("best", "avg", 7), results)
    assert judgement.verdict == "holds" and judgement.probability == 1.0
    assert judgement.effect.value == pytest.approx(40.0, abs=2.0)
    assert judgement.effect.low < judgement.effect.value < judgement.effect.high


def test_best_among_equals_is_tied() -> None:
    results = made_up({number: around(50.0 if number in (2, 7) else 10.0, number) for number in METHODS})
    judgement = judge(claim("best", "avg", 7), results)
    assert judgement.verdict == "tied" and judgement.reason == "not told apart from Method 2"
    assert 0.0 < judgement.probability < 1.0


def test_best_that_is_beaten_fails() -> None:
    results = made_up({number: around(50.0 if number == 2 else 10.0, number) for number in METHODS})
    judgement = judge(claim("best", "avg", 7), results)
    assert judgement.verdict == "does not hold" and judgement.reason == "significantly below Method 2"
    assert judgement.effect.high < 0.0


def test_measures_look_at_different_columns() -> None:
    last = {number: around(50.0 if number == 2 else 10.0, number) for number in METHODS}
    mean_last = {number: around(50.0 if number == 7 else 10.0, number) for number in METHODS}
    results = made_up(last, mean_last)
    assert verdict(results, "best", "avg", 7) == "does not hold"
    assert verdict(results, "best", "avg_100", 7) == "holds"


@pytest.mark.parametrize(("rival", "expected"), [(150, "holds"), (200, "tied"), (201, "does not hold")])
def test_best_maximum(rival: float, expected: str) -> None:
    last = {number: [100.0] * 19 + [200.0 if number == 7 else 150.0] for number in METHODS}
    last[3][0] = rival
    judgement = judge(claim("best", "max", 7), made_up(last))
    assert judgement.verdict == expected
    assert judgement.effect.value == (0.05 if rival <= 200 else 0.0)


@pytest.mark.parametrize(
    ("reaching", "expected"),
    [((1, 2, 7), "holds"), ((1, 2), "does not hold"), ((1, 2, 5, 7), "does not hold")],
)
def test_reaching_the_limit(reaching: tuple[int, ...], expected: str) -> None:
    last = {number: [100.0] * 19 + [200.0 if number in reaching else 199.0] for number in METHODS}
    assert verdict(made_up(last), "reach", "max", 1, 2, 7) == expected


@pytest.mark.parametrize(("behind", "expected"), [(0.0, "holds"), (10.0, "tied"), (20.0, "does not hold")])
def test_falling_behind(behind: float, expected: str) -> None:
    last = {number: around(behind if number == 8 else 0.0 if number == 6 else 10.0, number) for number in METHODS}
    assert verdict(made_up(last), "behind", "avg", 6, 8) == expected


def test_no_verdict_without_all_methods_or_from_one_run() -> None:
    some = made_up({number: around(1.0) for number in (1, 7)})
    single = made_up({number: [1.0] for number in METHODS})
    for results in (some, single):
        judgement = judge(claim("best", "avg", 7), results)
        assert judgement.verdict == "not judged" and judgement.reason


def test_only_claims_about_the_systems_of_the_study_are_judged() -> None:
    results = made_up({number: around(0.5, number) for number in METHODS}, system=LAKE)
    assert [judgement.claim.name for judgement in judge_claims(results)] == ["FL1", "FL2", "FL3", "FL4", "FL5"]


def test_claims_are_those_of_the_paper() -> None:
    """Each claim that a method is the best is true of the paper's printed column, but for avg_100 of Table 8."""
    for each in paper_claims():
        table = paper_table(7 if each.system == LAKE else 8).set_index("method")
        if each.kind == "best":
            is_best = table.loc[each.methods[0], each.measure] == table[each.measure].max()
            assert is_best == (each.name != "CP4")
        elif each.kind == "reach":
            limit = 1 if each.system == LAKE else 200
            assert set(table.index[table["max"] == limit]) == set(each.methods)
        else:
            assert table.loc[list(each.methods), each.measure].max() < table.drop(list(each.methods))[each.measure].min()


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
    assert [cell.strip() for cell in paper.split("|")[1:-1]] == ["", "paper", "200", "200", "200", "187.65", "0"]
    assert [cell.strip() for cell in difference.split("|")[3:-1]] == ["-100.00", "+0.00", "-50.00", "-37.65", "+50.00"]
    assert "150.00 [" in ours and "50.00 [" in ours


def test_other_systems_have_no_column_of_the_paper() -> None:
    results = made_up({1: around(5.0), 2: around(6.0)}, system="Taxi-v4")
    files = table_files(results, 0.99)
    assert set(files) == {"results.csv", "table_Taxi-v4.csv", "table_Taxi-v4.md"}
    assert "paper" not in files["table_Taxi-v4.md"]


def test_lake_table_sets_three_values_side_by_side() -> None:
    table = lake_table(np.arange(64.0).reshape(16, 4), 0.99).set_index(["state", "action"])
    assert table.loc[(1, 3), "learned"] == 7.0
    assert table.loc[(14, 1), "optimal"] == pytest.approx(0.863, abs=5e-4)
    assert table.loc[(1, 3), "paper"] == 0.48
    assert np.isnan(table.loc[(5, 0), "paper"])


def test_table_6_has_the_papers_rows() -> None:
    results = made_up({7: around(1.0)})
    results.q_tables[POLE, 7][1743] = [3.0, 4.0]
    rows = [line.split(",") for line in table_files(results, 0.99)["table_6.csv"].splitlines()]
    assert [row[0] for row in rows[1:]] == ["0", "0", "1", "1742", "1743", "14640", "14641"]
    assert rows[5] == ["1743", "3.0", "4.0", "9.14", "12.28"]
    assert rows[7][1:3] == ["", ""]


def test_what_is_said_of_table_8_can_be_reckoned() -> None:
    """Under a limit of 200, how often 20 runs can all end at 75 or less where the last 100 average 187.65."""
    assert any("1e-19" in why for why in inconsistencies()["why"])
    share = (200 - 187.65) / (200 - 75)
    assert share < 0.1 and share**20 < 1e-19


def test_report_tells_the_preset_and_every_claim() -> None:
    results = made_up({number: around(150.0, number) for number in METHODS})
    text = write_report(results, StudySettings(systems=(POLE,), preset="table8"))
    assert "Preset `table8`: fitted" in text
    assert all(f"**CP{number}**" in text for number in (1, 2, 3, 4)) and "FL1" not in text
    assert "Friedman's test: p = " in text and "cannot be right" in text


def test_report_of_little_is_still_a_report() -> None:
    results = made_up({3: [150.0]})
    text = write_report(results, StudySettings(systems=(POLE,), methods=(3,), runs=1))
    assert "No tests" in text and "not judged" in text and "nan" not in text
