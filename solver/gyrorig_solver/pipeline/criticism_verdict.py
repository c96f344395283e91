"""The verdict on a calibration after its criticism.

A calibration is good only if no effect is significant in the residual of its model. A remaining
effect can change every parameter by more than its standard uncertainty.

What to use when: `add_findings` after a search for causes, `add_criticism` after significance tests
only.
"""

from collections.abc import Sequence

import msgspec

from gyrorig_solver.calibration import CalibrationDocument
from gyrorig_solver.calibration.calibration_document import Trust
from gyrorig_solver.calibration.verdict import Verdict
from gyrorig_solver.data.link_remedies import LinkRemedy
from gyrorig_solver.discover import FitCriticism
from gyrorig_solver.findings import FindingsDocument
from gyrorig_solver.model import Term

FILE_REMEDY = "Read the findings report, and use a recording or a reference without this effect"
UNFITTED_REMEDY = LinkRemedy(
    rig="Read the findings report, fix the cause and record again", file=FILE_REMEDY
)
UNEXPLAINED_REMEDY = LinkRemedy(
    rig="Read the findings report, fix the rig and record again", file=FILE_REMEDY
)


def add_findings(
    calibration: CalibrationDocument,
    findings: FindingsDocument,
    named: Sequence[Term],
    link: str = "serial",
) -> CalibrationDocument:
    """Return a calibration with the verdict after a search for causes.

    Args:
        calibration: of the board.
        findings: of the search.
        named: the causes that the search found.
        link: on which the samples arrived, for the remedies.
    """
    fitted = calibration.solver.terms
    unfitted = [
        cause.cause for cause in named if cause.kind == "effect" and cause.cause not in fitted
    ]
    trust = judge_findings(calibration.trust, findings, unfitted, link)
    unexplained = findings.unexplained
    covariates = [unexplained.best_covariate] if unexplained is not None else []
    return _with_effects(calibration, trust, [*unfitted, *covariates])


def add_criticism(calibration: CalibrationDocument, criticism: FitCriticism) -> CalibrationDocument:
    """Return a calibration with the verdict after significance tests of a requested model."""
    if not criticism.test_count:
        return calibration
    effects = [*criticism.leading_causes, *(test.description for test in criticism.dependences)]
    return _with_effects(calibration, judge_criticism(calibration.trust, criticism), effects)


def judge_findings(
    trust: Trust, findings: FindingsDocument, unfitted: Sequence[str], link: str = "serial"
) -> Trust:
    """Return the verdict after a search for causes."""
    reasons = []
    if unfitted:
        reasons.append(
            f"this fit does not include {', '.join(unfitted)}, which the search found, so the "
            f"parameters contain the effect. {UNFITTED_REMEDY.for_link(link)}"
        )
    return _limit(trust, [*reasons, *_unexplained_reasons(findings, link)])


def judge_criticism(trust: Trust, criticism: FitCriticism) -> Trust:
    """Return the verdict after significance tests of a requested model."""
    if criticism.is_adequate:
        return trust
    clauses = []
    if criticism.scores:
        candidates = ", ".join(criticism.leading_causes)
        clauses.append(f"this fit lacks causes that are significant ({candidates})")
    if criticism.dependences:
        leading = criticism.dependences[0]
        clauses.append(f"the residual depends {leading.description} (p = {leading.p_value:.1g})")
    reason = (
        f"{', and '.join(clauses)}, so the errors can be larger than the stated uncertainties. "
        "Solve with `--extend auto`, or run `gyrorig explain`"
    )
    return _limit(trust, [reason])


def _unexplained_reasons(findings: FindingsDocument, link: str) -> list[str]:
    unexplained = findings.unexplained
    if unexplained is None:
        return []
    size_text = (
        ""
        if unexplained.harm_sigma is None
        else f" by up to about {max(unexplained.harm_sigma, 1.0):.0f} times its uncertainty"
    )
    return [
        "no known cause explains a part of the residual, which depends "
        f"{unexplained.best_covariate}. This effect can bias a parameter{size_text}. "
        f"{UNEXPLAINED_REMEDY.for_link(link)}"
    ]


def _limit(trust: Trust, reasons: Sequence[str]) -> Trust:
    if not reasons:
        return trust
    verdict: Verdict = "limited" if trust.verdict == "good" else trust.verdict
    return Trust(verdict=verdict, reasons=[*trust.reasons, *reasons])


def _with_effects(
    calibration: CalibrationDocument, trust: Trust, effects: Sequence[str]
) -> CalibrationDocument:
    quality = msgspec.structs.replace(calibration.quality, remaining_effects=list(effects))
    return msgspec.structs.replace(calibration, trust=trust, quality=quality)
