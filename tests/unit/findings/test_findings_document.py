"""The findings document: the contract's shape, whole files, numbers that read back."""

import math
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.unit.findings.conftest import CHANGES

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.identity import BoardId
from gyrorig_solver.calibration.calibration_document import Trust
from gyrorig_solver.data.stream.count_stream import StreamFinding
from gyrorig_solver.data.stream.gain_checks import check_gain
from gyrorig_solver.discover import CauseFindings
from gyrorig_solver.discover.attitude.attitude_terms import ReferenceSmoothing
from gyrorig_solver.discover.cause_findings import UntestableCause
from gyrorig_solver.findings import (
    build_findings_document,
    findings_summary,
    to_yaml,
    write_findings,
)
from gyrorig_solver.findings.findings_builder import FindingsOrigin, RawChecks
from gyrorig_solver.findings.findings_document import parse_findings
from gyrorig_solver.findings.findings_wording import cause_remedy, cause_title
from gyrorig_solver.model import find_term
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.pipeline.criticism_verdict import judge_findings
from gyrorig_solver.report.findings_view import findings_view


def test_it_reads_back_as_it_was_written(
    findings: CauseFindings, raw: list[RawChecks], origin: FindingsOrigin
) -> None:
    document = build_findings_document(
        findings, raw, origin, {"backlash-tilt": "figures/backlash-tilt.svg"}
    )
    assert parse_findings(to_yaml(document), "findings.yaml") == document


def test_the_independent_judge_accepts_it(
    findings: CauseFindings,
    raw: list[RawChecks],
    origin: FindingsOrigin,
    contract_judge: Path,
    tmp_path: Path,
) -> None:
    text = to_yaml(build_findings_document(findings, raw, origin))
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
    findings: CauseFindings, raw: list[RawChecks], origin: FindingsOrigin
) -> None:
    document = build_findings_document(findings, raw, origin)
    assert [(cause.cause, cause.where) for cause in document.causes] == [
        ("backlash", "tilt"),
        ("repeated_samples", "all"),
        ("repeated_samples", "all"),
    ]
    play, again, later = document.causes
    assert play.harm_sigma == pytest.approx(2.5)
    assert play.gain is not None
    assert play.gain.held_out_log_likelihood == 37.5
    assert again.gain is None
    assert [again.recording, later.recording] == ["monday.mcap", "friday.mcap"]
    assert again.parameters["share"].std == pytest.approx(math.sqrt(0.005 * 0.995 / 12_000))


def test_each_recording_has_its_share(
    findings: CauseFindings, raw: list[RawChecks], origin: FindingsOrigin
) -> None:
    """Before, the share of the first recording was stated for all of them."""
    check = raw[1].checks[0]
    more = replace(check.findings[0], count=600, size=0.05)
    friday = replace(raw[1], checks=(replace(check, findings=(more,)),))
    document = build_findings_document(findings, [raw[0], friday], origin)
    shares = {c.recording: c.parameters["share"].value for c in document.causes if c.recording}
    assert shares == {"monday.mcap": 0.005, "friday.mcap": 0.05}


def test_several_groups_of_checks_of_one_recording_name_no_recording(
    findings: CauseFindings, raw: list[RawChecks], origin: FindingsOrigin
) -> None:
    document = build_findings_document(findings, [raw[0], replace(raw[0], checks=())], origin)
    assert [cause.recording for cause in document.causes] == [None, None]


def test_a_faulty_stream_is_explained_not_adequate(
    findings: CauseFindings, raw: list[RawChecks], origin: FindingsOrigin
) -> None:
    clean = replace(findings, verdict="adequate", causes=(), unexplained=None, gain=None)
    assert build_findings_document(clean, raw, origin).verdict == "explained"
    assert build_findings_document(clean, [], origin).verdict == "adequate"


def test_swapped_axes_come_first(
    findings: CauseFindings, raw: list[RawChecks], origin: FindingsOrigin
) -> None:
    swapped = StreamFinding(
        "axis_swap", "link", ("x", "y"), 1, 1, 0.0, "exchanged", 1.0, "1", "x and y", "mend it"
    )
    look = replace(raw[0].checks[0], findings=(swapped,))
    document = build_findings_document(findings, [RawChecks("a.mcap", (look,))], origin)
    assert [cause.cause for cause in document.causes] == ["axis_swap", "backlash"]


def test_what_the_search_named_is_not_named_twice(
    findings: CauseFindings, raw: list[RawChecks], origin: FindingsOrigin
) -> None:
    finding = StreamFinding("backlash", "ptu", (), 1, 1, 0.0, "share", 0.0, "1", "twice", "")
    look = replace(raw[0].checks[0], findings=(finding,))
    document = build_findings_document(findings, [RawChecks("a.mcap", (look,))], origin)
    assert [cause.cause for cause in document.causes] == ["backlash"]


def test_numbers_that_are_none_are_null(findings: CauseFindings, origin: FindingsOrigin) -> None:
    (named_cause,) = findings.causes
    odd = replace(
        named_cause, values=(replace(named_cause.values[0], std=math.inf),), statistic=math.nan
    )
    text = to_yaml(build_findings_document(replace(findings, causes=(odd,)), [], origin))
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
    findings: CauseFindings, raw: list[RawChecks], origin: FindingsOrigin
) -> None:
    summary = findings_summary(build_findings_document(findings, raw, origin))
    lines = summary.splitlines()
    assert lines[0] == (
        "GY80-0007 (L3G4200D): not fully explained: the gears have backlash, on tilt, "
        "0.0573 ± 0.0057 deg; samples are repeated, in monday.mcap, 0.500 ± 0.064 %; "
        "samples are repeated, in friday.mcap, 0.500 ± 0.064 %"
    )
    assert "backlash, on tilt: the gears have backlash" in lines[1]
    assert "gap.tilt +0.0573 ± 0.0057 deg" in lines[2]
    assert "have the worm adjusted" in lines[3]
    assert "depends on pan (the gain changes)" in summary
    assert "tilt_sag below 0.0802 deg; a smaller size would bias scale.z by up to 36.0 " in summary


def test_a_heading_names_three_causes_and_counts_the_others(
    findings: CauseFindings, origin: FindingsOrigin
) -> None:
    (cause,) = findings.causes

    def heading(count: int) -> str:
        many = replace(findings, causes=(cause,) * count)
        return findings_summary(build_findings_document(many, [], origin)).splitlines()[0]

    assert heading(3).count("backlash") == 3
    assert heading(3).endswith("deg")
    assert heading(4).count("backlash") == 3
    assert heading(4).endswith("; and 1 other cause")
    assert heading(11).endswith("; and 8 other causes")


def test_every_cause_has_a_title_and_a_remedy() -> None:
    for cause in (*catalogue(), ReferenceSmoothing.cause):
        assert cause_title(cause)
        assert cause_remedy(cause)


def test_what_a_look_has_settled_is_not_called_invisible(
    findings: CauseFindings, origin: FindingsOrigin
) -> None:
    blind = tuple(UntestableCause(c, None, "the gain takes it") for c in ("axis_swap", "tilt_zero"))
    upright = RawChecks("a.mcap", check_gain(np.eye(3)))
    hidden = RawChecks("a.mcap", check_gain(np.full((3, 3), np.nan)))
    without = replace(findings, untestable=blind)
    names = [n.cause for n in build_findings_document(without, [upright], origin).not_testable]
    assert names == ["tilt_zero"]
    assert len(build_findings_document(without, [hidden], origin).not_testable) == 2


def test_a_harmful_rest_limits_the_trust(findings: CauseFindings, origin: FindingsOrigin) -> None:
    """60 beyond 24 degrees of freedom: a parameter along it would move by six deviations."""
    good = Trust(verdict="good", reasons=[])
    limited = judge_findings(good, build_findings_document(findings, [], origin), [])
    assert limited.verdict == "limited"
    assert "depends on pan (the gain changes)" in limited.reasons[0]
    assert "up to about 6 times its uncertainty" in limited.reasons[0]
    clean = build_findings_document(replace(findings, unexplained=None), [], origin)
    assert judge_findings(good, clean, []) == good
    unfitted = judge_findings(good, clean, ["scale_cubic"])
    assert unfitted.verdict == "limited"
    assert "this fit does not include" in unfitted.reasons[0]
    refused = Trust(verdict="refused", reasons=["no"])
    assert (
        judge_findings(refused, build_findings_document(findings, [], origin), []).verdict
        == "refused"
    )


def test_earlier_findings_are_kept_under_a_number(tmp_path: Path) -> None:
    board = BoardId("GY80-0007")
    for text in ("first", "second", "third"):
        path = write_findings(tmp_path, board, text, f"<{text}>", {"a": f"<svg {text}>"})
    assert path.read_text() == "third"
    assert (path.parent / "findings-0001.yaml").read_text() == "first"
    assert (path.parent / "findings-0002.yaml").read_text() == "second"
    assert (path.parent / "report-0001.html").read_text() == "<first>"
    assert (path.parent / "figures-0002" / "a.svg").read_text() == "<svg second>"


def test_a_cause_outside_the_fit_has_no_effect_of_zero(
    findings: CauseFindings, origin: FindingsOrigin
) -> None:
    """Before: "without this cause in the fit, a parameter is wrong by up to 0 ..."."""
    unchanged = tuple(replace(change, after=change.before) for change in CHANGES)
    without = replace(findings, causes=(), unexplained=None, changes=unchanged)
    flipped = RawChecks("a.mcap", check_gain(np.diag([1.0, 1.0, -1.0])))
    document = build_findings_document(without, [flipped], origin)
    assert [cause.cause for cause in document.causes] == ["sign_flip"]
    assert "without this cause in the fit" not in findings_summary(document)
    view = findings_view(document, {})
    assert view["summaries"][0]["effect"].startswith("None, because the calibration is valid")


def test_remedies_fit_the_link_of_the_recordings(
    findings: CauseFindings, origin: FindingsOrigin
) -> None:
    step = find_term("bias_step")
    named = replace(findings.causes[0], term=step)
    for link, words in (("serial", "check the board's supply"), ("file", "solve the data before")):
        of_link = replace(origin, link=link)
        document = build_findings_document(replace(findings, causes=(named,)), [], of_link)
        assert document.causes[0].remedy.startswith(words)
        good = Trust(verdict="good", reasons=[])
        (reason,) = judge_findings(good, document, [], link).reasons
        assert ("fix the rig" in reason) == (link == "serial")
