"""From what was found to the document: raw stream, gain and search for causes put together.

What to use when: `document_of`. Nothing here reads a clock or a file, so the same findings give
the same document.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from gyrorig_solver.discover.result import (
    CalibrationChange,
    Findings,
    Interval,
    NamedCause,
)
from gyrorig_solver.discover.result import Gain as FoundGain
from gyrorig_solver.discover.result import Unexplained as FoundUnexplained
from gyrorig_solver.findings.document import (
    Base,
    Cause,
    Change,
    Dependence,
    Detectable,
    Evidence,
    FindingsDocument,
    Gain,
    Input,
    NotTestable,
    RawLook,
    Rival,
    Size,
    Subject,
    Unexplained,
)
from gyrorig_solver.findings.remedies import remedy
from gyrorig_solver.raw.result import Look, RawFinding

GAUGE = ("axis_swap", "sign_flip", "wrong_full_scale")  # whoever trusts the counts is far off
UNEXPLAINED = "unexplained"  # the key of its figure


@dataclass(frozen=True, slots=True)
class RawEvidence:
    """What the looks at one recording's raw stream said."""

    recording: str
    looks: tuple[Look, ...]


@dataclass(frozen=True, slots=True)
class Origin:
    """What the findings are of."""

    board: Subject
    recordings: Sequence[Input]
    created: str  # UTC, as 2026-01-31T02:30:00Z
    software: str


def document_of(
    findings: Findings,
    raw: Sequence[RawEvidence],
    origin: Origin,
    figures: Mapping[str, str] | None = None,
    remarks: Sequence[str] = (),
) -> FindingsDocument:
    """Return the document of one board.

    Args:
        findings: of the search for causes.
        raw: the looks at each recording's raw stream, and at the gain.
        origin: the board and the recordings.
        figures: names of the figures' files by `figure_key`.
        remarks: what else is to be said.
    """
    drawn = figures or {}
    causes = _causes(findings, raw, drawn)
    verdict = findings.verdict
    if verdict == "adequate" and causes:
        verdict = "explained"
    return FindingsDocument(
        schema="gyrorig/findings/1",
        board=origin.board,
        created=origin.created,
        software=origin.software,
        recording=list(origin.recordings),
        verdict=verdict,
        base=Base(
            list(findings.base_terms),
            _number(findings.base_reduced_chi2),
            _number(findings.base_whiteness_p),
        ),
        causes=causes,
        not_testable=_not_testable(findings, raw),
        minimal_detectable=[
            Detectable(
                a.cause,
                _number(a.size),
                a.unit,
                a.where,
                _number(a.typical),
                a.moves,
                _number(a.harm_sigma),
            )
            for a in findings.absent
        ],
        raw=[
            RawLook(look.check, one.recording, bool(look.findings), look.said)
            for one in raw
            for look in one.looks
        ],
        unexplained=_unexplained(findings.unexplained, drawn),
        gain=_gain(findings.gain),
        elsewhere=_gain(findings.elsewhere),
        effect_on_calibration=_changes(findings.changes),
        remarks=list(remarks),
    )


def rest_harm_sigma(rest: FoundUnexplained) -> float:
    """Return by how many standard deviations an unexplained rest might bias the calibration.

    A signal of which the base parameters take as much as they leave moves a parameter that
    lies along it by the square root of its energy, which is what its statistic is beyond
    its degrees of freedom. How much they do take nobody knows without a name for it. No
    parameter follows a single line.
    """
    if rest.best.covariate == "line":
        return 0.0
    return math.sqrt(max(0.0, rest.best.statistic - rest.best.degrees_of_freedom))


def figure_key(cause: str, where: Sequence[str]) -> str:
    """Return the key of a cause's figure, fit for a file's name."""
    return "-".join((cause, *where))


def _not_testable(findings: Findings, raw: Sequence[RawEvidence]) -> list[NotTestable]:
    """Return what cannot be shown, without what the looks at stream and gain have settled."""
    looks = [look for one in raw for look in one.looks]
    settled = {cause for look in looks for cause in look.decides}
    settled |= {one.cause for look in looks for one in look.findings}
    return [
        NotTestable(one.cause, one.reason, one.where)
        for one in findings.not_testable
        if one.cause not in settled
    ]


def _goes_with(one: RawFinding, ranges: Sequence[RawFinding]) -> bool:
    """Return whether tops are cut off because the range is a smaller one than configured.

    A sensor of half the range ends at half the rate: that is no second cause, and its remedy
    is none either before the range is read back.
    """
    return one.cause == "saturation" and any(other.size > 0.0 for other in ranges)


def _causes(
    findings: Findings, raw: Sequence[RawEvidence], figures: Mapping[str, str]
) -> list[Cause]:
    """Return what is named: axes and ranges first, then by harm, then the stream's faults."""
    named = {one.cause for one in findings.causes}
    seen: dict[tuple[str, tuple[str, ...]], tuple[RawFinding, list[str]]] = {}
    ranges = [
        one for evidence in raw for look in evidence.looks for one in look.findings
        if one.cause == "wrong_full_scale"
    ]  # fmt: skip
    for evidence in raw:
        for look in evidence.looks:
            for one in look.findings:
                if one.cause in named or _goes_with(one, ranges):
                    continue  # the search has named it, with a size
                _, names = seen.setdefault((one.cause, one.where), (one, []))
                names.append(evidence.recording)
    said = [(one, _from_raw(one, names, figures)) for one, names in seen.values()]
    gauge = [cause for one, cause in said if one.cause in GAUGE]
    rest = [cause for one, cause in said if one.cause not in GAUGE]
    return [*gauge, *(_from_search(one, findings, figures) for one in findings.causes), *rest]


def _from_search(one: NamedCause, findings: Findings, figures: Mapping[str, str]) -> Cause:
    alone = len(findings.causes) == 1  # what all are worth is what it is worth
    return Cause(
        cause=one.cause,
        part=one.part,
        where=", ".join(one.where) or "all",
        parameters={
            v.name: Size(_number(v.value), _number(v.std), v.unit)
            for v in one.values
            if not one.where or "." not in v.name or v.name.rpartition(".")[2] in one.where
        },
        evidence=Evidence(
            statistic=_number(one.statistic),
            degrees_of_freedom=one.degrees_of_freedom,
            p_value=_number(one.p_value),
            seen_as=one.sentence,
            figure=figures.get(figure_key(one.cause, one.where)),
            posterior=_number(one.posterior),
        ),
        gain=_gain(one.gain or (findings.gain if alone else None)),
        one_of=list(one.one_of),
        rivals=[Rival(r.cause, _number(r.delta_log_likelihood), r.reason) for r in one.rivals],
        effect_on_calibration=_changes(one.changes),
        harm_sigma=_number(one.harm_sigma),
        remedy=remedy(one.cause),
        recording=one.recording,
    )


def _from_raw(one: RawFinding, recordings: Sequence[str], figures: Mapping[str, str]) -> Cause:
    many = f", in {', '.join(recordings)}" if len(recordings) > 1 else ""
    std = math.sqrt(one.share * (1.0 - one.share) / one.total) if one.name == "share" else None
    return Cause(
        cause=one.cause,
        part=one.part,
        where=", ".join(one.where) or "all",
        parameters={one.name: Size(_number(one.size), std, one.unit)},
        evidence=Evidence(
            statistic=float(one.count),
            degrees_of_freedom=1,
            p_value=_number(one.p_value),
            seen_as=one.seen_as + many,
            figure=figures.get(figure_key(one.cause, one.where)),
        ),
        gain=None,
        remedy=one.remedy,
    )


def _gain(gain: FoundGain | None) -> Gain | None:
    if gain is None:
        return None
    own = gain.log_likelihood
    return Gain(
        held_out_log_likelihood=_number(own.value),
        residual_rms_before=_number(gain.rms_before),
        residual_rms_after=_number(gain.rms_after),
        interval=[_number(own.low), _number(own.high)],
        turn_error_before=_number(gain.turn_error_before_rad),
        turn_error_after=_number(gain.turn_error_after_rad),
        rms_change=_limits(gain.rms_change),
        turn_change=_limits(gain.turn_change),
        how=gain.how,
    )


def _limits(interval: Interval | None) -> list[float | None] | None:
    return None if interval is None else [_number(interval.low), _number(interval.high)]


def _changes(changes: Sequence[CalibrationChange]) -> list[Change]:
    return [
        Change(c.parameter, _number(c.before), _number(c.after), _number(c.std), c.unit)
        for c in changes
    ]


def _unexplained(rest: FoundUnexplained | None, figures: Mapping[str, str]) -> Unexplained | None:
    if rest is None:
        return None
    harm_sigma = rest_harm_sigma(rest)
    return Unexplained(
        statistic=_number(rest.best.statistic),
        p_value=_number(rest.best.p_value),
        best_covariate=rest.best.words,
        figure=figures.get(UNEXPLAINED),
        harm=(
            f"If the calibration took in as much of it as is left to see, a parameter would be "
            f"off by up to {harm_sigma:.1f} standard deviations."
            if harm_sigma
            else "It moves no parameter of the calibration; the noise looks larger."
        ),
        harm_sigma=harm_sigma,
        others=[
            Dependence(one.words, _number(one.statistic), _number(one.p_value))
            for one in rest.others
        ],
    )


def _number(value: float) -> float | None:
    """Return a plain float, None for what is not a finite number."""
    return float(value) if math.isfinite(value) else None
