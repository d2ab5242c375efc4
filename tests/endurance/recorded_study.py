"""
The page of the study has the numbers and verdicts that its command gives.

Run with ``python -m pytest tests/endurance/recorded_study.py``; it takes a minute.
"""

import re
from pathlib import Path

import pytest

from sb3_adaptive_q.experiments.paper.claims import COLUMNS, judge_claims
from sb3_adaptive_q.experiments.paper.results import read_results
from sb3_adaptive_q.experiments.paper.settings import StudySettings
from sb3_adaptive_q.experiments.paper.study import run_study
from sb3_adaptive_q.experiments.runner import Execution
from sb3_adaptive_q.experiments.storage import ResultFolder

PAGE = Path(__file__).resolve().parents[2] / "docs" / "study.md"
ROW = re.compile(r"^\| (?:Frozen Lake|Cart Pole) \| (.+?) \| (.+?) \|$", flags=re.MULTILINE)


@pytest.mark.timeout(600)
def test_the_page_of_the_study_has_what_the_study_gives(tmp_path: Path) -> None:
    settings = StudySettings()
    run_study(settings, Execution(output=tmp_path, progress=False))
    results = read_results(ResultFolder(tmp_path), settings.design().cells())
    rows = ROW.findall(PAGE.read_text(encoding="utf-8"))
    judgements = judge_claims(results)
    assert [verdict.partition(":")[0] for _, verdict in rows] == [each.verdict for each in judgements]
    for (_, verdict), judgement in zip(rows, judgements, strict=True):
        samples = results.samples(judgement.claim.system, COLUMNS[judgement.claim.measure])
        printed = [float(number) for number in re.findall(r"\d\.\d+|\d+\.\d\d", verdict)]
        means = [samples[method].mean() for method in judgement.claim.methods]
        assert printed == [] or printed == pytest.approx(means, abs=0.0051)
        for finding in re.findall(r"(?:not )?significantly .*", verdict):
            assert finding in judgement.reason
