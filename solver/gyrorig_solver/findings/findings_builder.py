"""Build the findings document from the checks of the raw stream and the search for causes.

Nothing here reads a clock or a file, therefore the same findings give the same document.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from gyrorig_protocol.documents import document_part, finite_values
from gyrorig_solver.data.stream.count_stream import CheckResult, StreamFinding
from gyrorig_solver.discover import CauseFindings, NamedCause
from gyrorig_solver.discover import HeldOutGain as FoundGain
from gyrorig_solver.discover.cause_findings import ConfidenceInterval
from gyrorig_solver.discover.cause_findings import UnexplainedResidual as FoundUnexplained
from gyrorig_solver.findings.findings_document import (
    BaseModelEntry,
    BoardEntry,
    CauseEntry,
    ChangeEntry,
    DependenceEntry,
    DetectableEntry,
    FindingsDocument,
    GainEntry,
    InputEntry,
    NextExperimentEntry,
    NextPairEntry,
    RawCheckEntry,
    RivalEntry,
    SizeEntry,
    TestStatistics,
    UnexplainedEntry,
    UntestableEntry,
)
from gyrorig_solver.findings.findings_wording import cause_remedy
from gyrorig_solver.model import recording_index_of
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.plan import NextExperiment

UNEXPLAINED_FIGURE = "unexplained"  # key of the figure
NEXT_PROGRAM_NAME = "next-program.yaml"


@dataclass(frozen=True, slots=True)
class RawChecks:
    """The results of the checks of one recording's raw stream."""

    recording: str
    checks: tuple[CheckResult, ...]


@dataclass(frozen=True, slots=True)
class FindingsOrigin:
    """The board and the recordings of findings, and the program that made them."""

    board: BoardEntry
    recordings: Sequence[InputEntry]
    created: str  # UTC, as 2026-01-31T02:30:00Z
    software: str
    link: str = "serial"  # on which the samples arrived, for the remedies


def build_findings_document(
    findings: CauseFindings,
    raw: Sequence[RawChecks],
    origin: FindingsOrigin,
    figures: Mapping[str, str] | None = None,
    remarks: Sequence[str] = (),
    next_experiment: NextExperiment | None = None,
    program_file: str = NEXT_PROGRAM_NAME,
) -> FindingsDocument:
    """Return the document of one board."""
    figure_files = figures or {}
    causes = _cause_entries(findings, raw, figure_files, origin.link)
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
        base=BaseModelEntry(
            list(findings.base_terms),
            finite_values(findings.base_reduced_chi2),
            finite_values(findings.base_whiteness_p),
        ),
        causes=causes,
        not_testable=_untestable_entries(findings, raw),
        minimal_detectable=[
            document_part(
                DetectableEntry,
                limit,
                would_move=limit.biased_parameter,
                by_sigma=limit.parameter_bias_sigma,
            )
            for limit in findings.detection_limits
        ],
        raw=[
            RawCheckEntry(check.check, checks.recording, bool(check.findings), check.summary)
            for checks in raw
            for check in checks.checks
        ],
        unexplained=_unexplained_entry(findings.unexplained, figure_files),
        gain=_gain_entry(findings.gain),
        elsewhere=_gain_entry(findings.other_recording_gain),
        effect_on_calibration=[document_part(ChangeEntry, change) for change in findings.changes],
        remarks=list(remarks),
        next_experiment=_next_experiment_entry(next_experiment, program_file),
    )


def _next_experiment_entry(
    proposed: NextExperiment | None, program_file: str
) -> NextExperimentEntry | None:
    if proposed is None:
        return None
    pairs = [
        NextPairEntry(
            list(outlook.causes), finite_values(outlook.nats), finite_values(outlook.probability)
        )
        for outlook in proposed.outlooks
    ]
    longest_s = proposed.max_duration_s
    if proposed.program is None:
        return NextExperimentEntry(pairs, longest_s=longest_s)
    return NextExperimentEntry(pairs, program_file, round(proposed.duration_s, 1), longest_s)


def unexplained_bias_sigma(residual: FoundUnexplained) -> float:
    """Return the parameter bias, in standard uncertainties, that an unexplained residual allows.

    The base parameters absorb an unknown part of the signal. If they absorb as much as they
    leave, a parameter along the signal is biased by the square root of its energy, which is the
    statistic in excess of its degrees of freedom. A single spectral line biases no parameter.
    """
    if residual.leading.covariate == "line":
        return 0.0
    return math.sqrt(max(0.0, residual.leading.excess))


def figure_key(cause: NamedCause) -> str:
    """Return the key of a cause's figure; it is part of a file name."""
    index = recording_index_of(cause.term)
    number = None if index is None else index + 1
    return figure_key_at(cause.cause, cause.where, number, cause.term.occurrence)


def figure_key_at(
    cause: str, where: Sequence[str], recording_number: int | None, occurrence: int
) -> str:
    """Return the key of a figure; causes of one name and place differ in the other arguments."""
    recording = [] if recording_number is None else [str(recording_number)]
    again = [] if occurrence == 1 else [f"again{occurrence}"]
    return "-".join((cause, *where, *recording, *again))


def _untestable_entries(findings: CauseFindings, raw: Sequence[RawChecks]) -> list[UntestableEntry]:
    """Return the causes that the search could not test, without those that the checks tested."""
    results = [result for checks in raw for result in checks.checks]
    tested = {cause for result in results for cause in result.testable_causes}
    tested |= {finding.cause for result in results for finding in result.findings}
    return [
        document_part(UntestableEntry, untestable)
        for untestable in findings.untestable
        if untestable.cause not in tested
    ]


def _cause_entries(
    findings: CauseFindings,
    raw_checks: Sequence[RawChecks],
    figures: Mapping[str, str],
    link: str,
) -> list[CauseEntry]:
    """Return configuration errors, then searched causes by bias, then faults of the stream."""
    named_causes = {cause.cause for cause in findings.causes}
    stream_findings = [
        (checks.recording, finding)
        for checks in raw_checks
        for result in checks.checks
        for finding in result.findings
    ]
    of_positive_size = {finding.cause for _, finding in stream_findings if finding.size > 0.0}
    is_single = len({checks.recording for checks in raw_checks}) == 1
    # A configuration error is a property of the board; each recording loses its own samples.
    places: dict[tuple[str, tuple[str, ...], str | None], tuple[StreamFinding, list[str]]] = {}
    for recording, finding in stream_findings:
        term = catalogue().get(finding.cause)
        if finding.cause in named_causes or (term and term.implied_by in of_positive_size):
            continue
        limited = None if is_single or _is_configuration_error(finding) else recording
        _, names = places.setdefault((finding.cause, finding.where, limited), (finding, []))
        names.append(recording)
    configuration: list[CauseEntry] = []
    stream: list[CauseEntry] = []
    for (_, _, limited), (finding, names) in places.items():
        entries = configuration if _is_configuration_error(finding) else stream
        entries.append(_raw_cause(finding, list(dict.fromkeys(names)), limited))
    searched = [_searched_cause(cause, findings, figures, link) for cause in findings.causes]
    return [*configuration, *searched, *stream]


def _is_configuration_error(finding: StreamFinding) -> bool:
    term = catalogue().get(finding.cause)
    return term is not None and term.is_configuration_error


def _searched_cause(
    cause: NamedCause, findings: CauseFindings, figures: Mapping[str, str], link: str
) -> CauseEntry:
    is_only_cause = len(findings.causes) == 1  # then its gain is that of all causes
    return CauseEntry(
        cause=cause.cause,
        part=cause.part,
        where=", ".join(cause.where) or "all",
        parameters={
            value.name: document_part(SizeEntry, value)
            for value in cause.values
            if not cause.where
            or "." not in value.name
            or value.name.rpartition(".")[2] in cause.where
        },
        evidence=document_part(
            TestStatistics,
            cause,
            seen_as=cause.sentence,
            figure=figures.get(figure_key(cause)),
        ),
        gain=_gain_entry(cause.gain or (findings.gain if is_only_cause else None)),
        one_of=list(cause.one_of),
        rivals=[document_part(RivalEntry, rival) for rival in cause.rivals],
        effect_on_calibration=[document_part(ChangeEntry, change) for change in cause.changes],
        harm_sigma=finite_values(cause.parameter_bias_sigma),
        remedy=cause_remedy(cause.cause, link),
        recording=cause.recording,
        occurrence=cause.term.occurrence,
    )


def _raw_cause(
    finding: StreamFinding, recordings: Sequence[str], limited: str | None
) -> CauseEntry:
    place_text = f", in {', '.join(recordings)}" if len(recordings) > 1 else ""
    std = (
        math.sqrt(finding.share * (1.0 - finding.share) / finding.total)
        if finding.quantity == "share"
        else None
    )
    return CauseEntry(
        cause=finding.cause,
        part=finding.part,
        where=", ".join(finding.where) or "all",
        parameters={finding.quantity: SizeEntry(finite_values(finding.size), std, finding.unit)},
        evidence=TestStatistics(
            statistic=float(finding.count),
            degrees_of_freedom=1,
            p_value=finite_values(finding.p_value),
            seen_as=finding.seen_as + place_text,
        ),
        gain=None,
        remedy=finding.remedy,
        recording=limited,
    )


def _gain_entry(gain: FoundGain | None) -> GainEntry | None:
    if gain is None:
        return None
    return document_part(
        GainEntry,
        gain,
        held_out_log_likelihood=gain.log_likelihood.value,
        residual_rms_before=gain.rms_before,
        residual_rms_after=gain.rms_after,
        interval=_limits(gain.log_likelihood),
        turn_error_before=gain.turn_error_before_rad,
        turn_error_after=gain.turn_error_after_rad,
        rms_change=_limits(gain.rms_change),
        turn_change=None if gain.turn_change is None else _limits(gain.turn_change),
    )


def _limits(interval: ConfidenceInterval) -> list[float]:
    return [interval.low, interval.high]


def _unexplained_entry(
    residual: FoundUnexplained | None, figures: Mapping[str, str]
) -> UnexplainedEntry | None:
    if residual is None:
        return None
    harm_sigma = unexplained_bias_sigma(residual)
    return UnexplainedEntry(
        statistic=finite_values(residual.leading.statistic),
        p_value=finite_values(residual.leading.p_value),
        best_covariate=residual.leading.description,
        figure=figures.get(UNEXPLAINED_FIGURE),
        harm=(
            "If the parameters absorbed an effect as large as this residual, one parameter would "
            f"be wrong by up to {harm_sigma:.1f} standard uncertainties."
            if harm_sigma
            else "This residual biases no parameter of the calibration and only adds to the noise."
        ),
        harm_sigma=harm_sigma,
        others=[
            document_part(DependenceEntry, test, covariate=test.description)
            for test in residual.others
        ],
    )
