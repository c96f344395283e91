"""What was named beside what was hidden: each outcome in words, and the seal that binds it."""

from dataclasses import replace
from typing import Any

import msgspec
import pytest

from gyrorig_daemon.emulator.truth_commitment import TruthCommitment
from gyrorig_protocol.errors import InputError
from gyrorig_solver.check import score_causes
from gyrorig_solver.check.injected_causes import score_text, verify_commitment
from gyrorig_solver.discover import CauseFindings
from gyrorig_solver.findings import FindingsDocument, build_findings_document
from gyrorig_solver.findings.findings_builder import FindingsOrigin


@pytest.fixture
def document(findings: CauseFindings, origin: FindingsOrigin) -> FindingsDocument:
    return build_findings_document(findings, [], origin)


def truth(*causes: tuple[str, float, str], board: str | None = None) -> dict[str, Any]:
    return {
        "hidden": {
            "causes": [
                {"cause": c, "where": "tilt", "board": board, "size": {"value": v, "unit": u}}
                for c, v, u in causes
            ]
        }
    }


def scores(document: FindingsDocument, hidden: dict[str, Any]) -> list[tuple[str, str]]:
    return [
        (score_cause.cause, score_cause.score) for score_cause in score_causes(document, hidden)
    ]


def test_a_named_cause_is_right(document: FindingsDocument) -> None:
    scored = score_causes(document, truth(("backlash", 0.00105, "rad")))
    assert [(score.cause, score.score) for score in scored] == [("backlash", "right")]
    assert (
        "size 0.0602 deg, and the answer names it, with an estimated size of 0.0573 deg"
        in score_text(document, scored)
    )


def test_a_stated_set_counts_as_that(findings: CauseFindings, origin: FindingsOrigin) -> None:
    named_set = replace(findings.causes[0], one_of=("lost_steps",))
    document = build_findings_document(replace(findings, causes=(named_set,)), [], origin)
    assert scores(document, truth(("lost_steps", 0.01, "rad"))) == [("lost_steps", "among")]


def test_below_what_shows_is_rightly_not_named(document: FindingsDocument) -> None:
    hidden = truth(("tilt_sag", -0.001, "rad"), ("backlash", 0.001, "rad"))
    assert ("tilt_sag", "unseen") in scores(document, hidden)
    hidden = truth(("tilt_sag", 0.01, "rad"), ("backlash", 0.001, "rad"))
    assert ("tilt_sag", "missed") in scores(document, hidden)


def test_what_was_said_not_to_show_is_no_miss(document: FindingsDocument) -> None:
    hidden = truth(("thermal_bias", 0.001, "rad/s/K"), ("backlash", 0.001, "rad"))
    assert ("thermal_bias", "unseen") in scores(document, hidden)


def test_a_name_for_nothing_is_wrong(document: FindingsDocument) -> None:
    assert scores(document, {}) == [("backlash", "wrong")]
    assert scores(document, truth(("ringing", 0.05, "1"))) == [
        ("ringing", "missed"),
        ("backlash", "wrong"),
    ]


def test_another_boards_cause_is_not_this_ones(document: FindingsDocument) -> None:
    hidden = truth(("bias_step", 0.001, "rad/s"), board="another")
    assert scores(document, hidden) == [("backlash", "wrong")]


def test_nothing_hidden_and_nothing_named_is_said(document: FindingsDocument) -> None:
    clean = msgspec.structs.replace(document, causes=[])
    assert "right: the rig had no cause" in score_text(clean, score_causes(clean, {}))


def test_the_seal_of_the_emulator_opens_and_another_does_not() -> None:
    """The emulator seals, the desk opens: two programs, one recipe."""
    hidden = truth(("backlash", 0.001, "rad"))
    seal = TruthCommitment(hidden)
    opened = seal.revealed_document(hidden)
    verify_commitment(opened, seal.sha256)
    verify_commitment(hidden, None)
    opened["hidden"]["causes"][0]["size"]["value"] = 0.002
    with pytest.raises(InputError, match="differs from the one that the daemon printed"):
        verify_commitment(opened, seal.sha256)


def test_a_truth_that_makes_no_sense_is_refused(document: FindingsDocument) -> None:
    with pytest.raises(InputError):
        score_causes(document, {"hidden": {"causes": [{"cause": "backlash"}]}})
