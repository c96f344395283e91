"""The findings document: the contract's shape, whole files, numbers that read back."""

import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.identity import BoardId
from gyrorig_solver.calibration.document import Trust
from gyrorig_solver.calibration.trust import with_findings
from gyrorig_solver.discover.attitude_terms import ReferenceSmoothing
from gyrorig_solver.discover.result import Findings, NotTestable
from gyrorig_solver.findings.build import Origin, RawEvidence, document_of
from gyrorig_solver.findings.document import parse_findings, to_yaml
from gyrorig_solver.findings.remedies import REMEDIES
from gyrorig_solver.findings.wording import TITLES, summary
from gyrorig_solver.findings.writing import write_findings
from gyrorig_solver.model.terms.catalogue import catalogue
from gyrorig_solver.raw.gain import look_at_gain
from gyrorig_solver.raw.result import RawFinding


def test_it_reads_back_as_it_was_written(
    findings: Findings, raw: list[RawEvidence], origin: Origin
) -> None:
    document = document_of(findings, raw, origin, {"backlash-tilt": "figures/backlash-tilt.svg"})
    assert parse_findings(to_yaml(document), "findings.yaml") == document


def test_the_independent_judge_accepts_it(
    findings: Findings,
    raw: list[RawEvidence],
    origin: Origin,
    contract_judge: Path,
    tmp_path: Path,
) -> None:
    text = to_yaml(document_of(findings, raw, origin))
    path = write_findings(tmp_path, BoardId("GY80-0007"), text, "<html>", {"a": "<svg>"})
    judged = subprocess.run(
        [sys.executable, str(contract_judge), str(path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert judged.returncode == 0, judged.stdout
    names = sorted(p.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("*.*"))
    assert names == [
        "GY80-0007/figures/a.svg",
        "GY80-0007/findings.yaml",
        "GY80-0007/report.html",
    ]


def test_the_search_and_the_stream_stand_together(
    findings: Findings, raw: list[RawEvidence], origin: Origin
) -> None:
    document = document_of(findings, raw, origin)
    assert [(one.cause, one.where) for one in document.causes] == [
        ("backlash", "tilt"),
        ("repeated_samples", "all"),
    ]
    play, again = document.causes
    assert play.harm_sigma == pytest.approx(2.5)
    assert play.gain is not None
    assert play.gain.held_out_log_likelihood == 37.5
    assert again.gain is None
    assert again.evidence.seen_as.endswith("in monday.mcap, friday.mcap")
    assert again.parameters["share"].std == pytest.approx(math.sqrt(0.005 * 0.995 / 12_000))


def test_a_faulty_stream_is_explained_not_adequate(
    findings: Findings, raw: list[RawEvidence], origin: Origin
) -> None:
    clean = replace(findings, verdict="adequate", causes=(), unexplained=None, gain=None)
    assert document_of(clean, raw, origin).verdict == "explained"
    assert document_of(clean, [], origin).verdict == "adequate"


def test_swapped_axes_come_first(
    findings: Findings, raw: list[RawEvidence], origin: Origin
) -> None:
    swapped = RawFinding(
        "axis_swap", "link", ("x", "y"), 1, 1, 0.0, "exchanged", 1.0, "1", "x and y", "mend it"
    )
    look = replace(raw[0].looks[0], findings=(swapped,))
    document = document_of(findings, [RawEvidence("a.mcap", (look,))], origin)
    assert [one.cause for one in document.causes] == ["axis_swap", "backlash"]


def test_what_the_search_named_is_not_named_twice(
    findings: Findings, raw: list[RawEvidence], origin: Origin
) -> None:
    own = RawFinding("backlash", "ptu", (), 1, 1, 0.0, "share", 0.0, "1", "twice", "")
    look = replace(raw[0].looks[0], findings=(own,))
    document = document_of(findings, [RawEvidence("a.mcap", (look,))], origin)
    assert [one.cause for one in document.causes] == ["backlash"]


def test_numbers_that_are_none_are_null(findings: Findings, origin: Origin) -> None:
    (one,) = findings.causes
    odd = replace(one, values=(replace(one.values[0], std=math.inf),), statistic=math.nan)
    text = to_yaml(document_of(replace(findings, causes=(odd,)), [], origin))
    (back,) = parse_findings(text, "findings.yaml").causes
    assert back.parameters["gap.tilt"].std is None
    assert back.evidence.statistic is None


@pytest.mark.parametrize(
    "text", ["schema: gyrorig/calibration/1\n", "schema: gyrorig/findings/1\n", "[1", "3\n"]
)
def test_other_documents_are_refused(text: str) -> None:
    with pytest.raises(InputError):
        parse_findings(text, "other.yaml")


def test_a_person_reads_verdict_cause_size_and_remedy(
    findings: Findings, raw: list[RawEvidence], origin: Origin
) -> None:
    said = summary(document_of(findings, raw, origin))
    lines = said.splitlines()
    assert lines[0] == "GY80-0007 (L3G4200D): not all explained"
    assert "backlash, on tilt: the gears have play" in lines[1]
    assert "gap.tilt +57.3 ± 5.7 mdeg" in lines[2]
    assert "have the worm adjusted" in lines[3]
    assert "depends on pan, as a gain" in said
    assert "tilt_sag up to 80.2 mdeg: scale.z off by 36.0 sd" in said


def test_every_cause_has_a_title_and_a_remedy() -> None:
    assert set(catalogue()) <= set(TITLES)
    assert {*catalogue(), ReferenceSmoothing.cause} == set(REMEDIES)


def test_what_a_look_has_settled_is_not_called_invisible(
    findings: Findings, origin: Origin
) -> None:
    blind = tuple(NotTestable(c, None, "the gain takes it") for c in ("axis_swap", "tilt_zero"))
    upright = RawEvidence("a.mcap", look_at_gain(np.eye(3)))
    hidden = RawEvidence("a.mcap", look_at_gain(np.full((3, 3), np.nan)))
    without = replace(findings, not_testable=blind)
    names = [n.cause for n in document_of(without, [upright], origin).not_testable]
    assert names == ["tilt_zero"]
    assert len(document_of(without, [hidden], origin).not_testable) == 2


def test_a_harmful_rest_limits_the_trust(findings: Findings, origin: Origin) -> None:
    """60 beyond 24 degrees of freedom: a parameter along it would move by six deviations."""
    good = Trust(verdict="good", reasons=[])
    limited = with_findings(good, document_of(findings, [], origin))
    assert limited.verdict == "limited"
    assert "depends on pan, as a gain" in limited.reasons[0]
    assert "up to about 6 of its std" in limited.reasons[0]
    clean = document_of(replace(findings, unexplained=None), [], origin)
    assert with_findings(good, clean) == good
    refused = Trust(verdict="refused", reasons=["no"])
    assert with_findings(refused, document_of(findings, [], origin)).verdict == "refused"
