"""Solve a board: fit, calibration document, next version in the store, report.

What to use when: `solve_and_store` for one board; `fit_together` first where boards were on one
unit at the same time; `rebuild_report_data` for the report of a stored calibration.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any

import msgspec

from gyrorig_protocol.errors import InputError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.calibration import (
    CalibrationDocument,
    CalibrationStore,
    StoredVersion,
    find_profile,
)
from gyrorig_solver.calibration.calibration_builder import build_calibration, settings_sha256
from gyrorig_solver.calibration.calibration_document import FindingsReference, calibration_as_yaml
from gyrorig_solver.calibration.paper_calibration import (
    build_paper_calibration,
    solve_with_paper_method,
)
from gyrorig_solver.calibration.provenance import build_provenance
from gyrorig_solver.calibration.total_uncertainty import with_total_uncertainty
from gyrorig_solver.estimate import GyroFit
from gyrorig_solver.findings import to_yaml as findings_yaml
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.pipeline.assessed_fit import AssessedFit, add_to_unit, assess_fit
from gyrorig_solver.pipeline.board_data import BoardData, load_board
from gyrorig_solver.pipeline.criticised_fit import AUTO, CriticisedFit, fit_criticised
from gyrorig_solver.pipeline.criticism_verdict import add_criticism, add_findings
from gyrorig_solver.pipeline.explain_board import (
    BoardExplanation,
    build_document,
    findings_page,
)
from gyrorig_solver.pipeline.unit_prior import UnitKnowledge
from gyrorig_solver.report import ReportData, render_calibration
from gyrorig_solver.uncertainty import UncertaintySettings, default_settings

FINDINGS_SUFFIX = ".findings.yaml"


@dataclass(frozen=True, slots=True, eq=False)
class StoredResult:
    """One board's calibration as it was written to the store."""

    calibration: CalibrationDocument
    path: Path
    report: Path
    stored: StoredVersion
    explanation: BoardExplanation | None = None  # where causes were searched for
    unit_version: int | None = None  # of the unit's posterior, if the solve added one


# (version, digest of the version before, created) to the document
DocumentBuilder = Callable[[int, str | None, str], CalibrationDocument]


def solve_and_store(
    store: CalibrationStore,
    recordings: Sequence[Recording],
    board: BoardId,
    method: str = "likelihood",
    extend: Sequence[str] = (AUTO,),
    precomputed: CriticisedFit | None = None,
    before_writing: Callable[[], None] = lambda: None,
    uncertainty: UncertaintySettings | None = None,
    unit_knowledge: UnitKnowledge | None = None,
) -> StoredResult:
    """Solve one board, and write its next version and its report.

    Args:
        store: of the versions.
        recordings: at least one, each with the board in it; solved together.
        board: which one.
        method: `likelihood` or `paper`.
        extend: causes of the catalogue to fit, `auto` for those that a search names; used by
            `likelihood` only.
        precomputed: the result of `fit_together` for this board, used instead of a new fit.
        before_writing: called before the version is written; an error that it raises prevents
            the writing.
        uncertainty: prior sizes of the causes and limits of the verdict; by default the shipped
            ones.
        unit_knowledge: what is known of the unit, and where the solve adds to it; by default
            nothing.

    Raises:
        InputError: the recordings lack something that the method needs, or the stored posterior
            of the unit is damaged.
        UsageError: the recordings cannot be solved together.
        MachineError: the store cannot be written.
    """
    store.prepare_folder(board)
    explanation: BoardExplanation | None = None
    unit_version: int | None = None
    data = load_board(recordings, board)
    if method == "paper":
        document, report_data_of = _solve_by_paper(data)
    else:
        criticised = precomputed or fit_criticised(data, extend)
        explanation = criticised.explanation
        settings = default_settings() if uncertainty is None else uncertainty
        knowledge = UnitKnowledge() if unit_knowledge is None else unit_knowledge
        assessed = assess_fit(data, criticised, settings, knowledge)
        unit_version = add_to_unit(data, criticised, assessed, settings, knowledge)
        document, report_data_of = _solve_by_likelihood(data, extend, criticised, assessed)
    created = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    written: list[CalibrationDocument] = []

    def text(version: int, previous: str | None) -> str:
        written.append(document(version, previous, created))
        return calibration_as_yaml(written[-1])

    stored = store.add_version(board, text, before_writing)
    report = store.write_companion(
        stored, ".report.html", render_calibration(report_data_of(written[-1])).encode()
    )
    if explanation is not None:  # v0001.findings.yaml and v0001.findings.html
        findings, page = findings_page(explanation)
        store.write_companion(stored, FINDINGS_SUFFIX, findings_yaml(findings).encode())
        store.write_companion(stored, ".findings.html", page.encode())
    return StoredResult(written[-1], stored.path, report, stored, explanation, unit_version)


def document_builder(
    fit: GyroFit, data: BoardData, extend: Sequence[str] = (AUTO,)
) -> DocumentBuilder:
    """Return a function that builds a fit's document for a version.

    Args:
        fit: of these recordings.
        data: the board's recordings.
        extend: causes that were requested.
    """
    lost = [fit.lost] if len(data.samples) == 1 else [samples.lost for samples in data.samples]
    software = installed_version("gyrorig")
    settings = likelihood_settings(extend)
    origin = build_provenance(data.recordings, BoardId(data.board), lost, software, settings)
    profile = find_profile(origin.board.sensor)

    def document(version: int, previous: str | None, created: str) -> CalibrationDocument:
        return build_calibration(
            fit, origin, version=version, previous=previous, created=created, profile=profile
        )

    return document


def likelihood_settings(extend: Sequence[str]) -> dict[str, Any]:
    """Return the settings of `likelihood` whose digest a calibration stores."""
    return {"method": "likelihood", **({"extend": list(extend)} if extend else {})}


def _solve_by_likelihood(
    data: BoardData,
    extend: Sequence[str],
    criticised: CriticisedFit,
    assessed: AssessedFit,
) -> tuple[DocumentBuilder, Callable[[CalibrationDocument], ReportData]]:
    fit, explanation, criticism = assessed.fit, criticised.explanation, criticised.criticism
    build = document_builder(fit, data, extend)

    def document(version: int, previous: str | None, created: str) -> CalibrationDocument:
        built = msgspec.structs.replace(
            build(version, previous, created), unit_prior=assessed.unit_prior
        )
        if assessed.budget is not None:
            built = with_total_uncertainty(built, assessed.budget)
        if explanation is not None:
            return with_search_findings(built, explanation)
        if criticism is not None:
            return add_criticism(built, criticism)
        return built

    def report_data_of(calibration: CalibrationDocument) -> ReportData:
        profile = find_profile(calibration.board.sensor)
        return ReportData(calibration, fit.diagnostics, fit.clock, profile, fit.reference)

    return document, report_data_of


def rebuild_report_data(
    calibration: CalibrationDocument, recordings: Sequence[Recording]
) -> ReportData:
    """Return the data of a stored calibration's report, its arrays computed again.

    Args:
        calibration: from a store; its numbers are not changed.
        recordings: those that it was solved from.

    Raises:
        InputError: the recordings are others, or the settings of the solve are not known.
    """
    given = {recording.sha256: recording.path.name for recording in recordings}
    needed = {row.sha256: row.name for row in calibration.inputs}
    for missing in needed.keys() - given.keys():
        raise InputError(
            f"the calibration of {calibration.board.id} was solved from the recording "
            f"{needed[missing]}, which is not among the given recordings",
            "give all recordings that the calibration was solved from, or give none",
        )
    for other in given.keys() - needed.keys():
        raise InputError(
            f"the calibration of {calibration.board.id} was not solved from the recording "
            f"{given[other]}",
            "give only the recordings that the calibration was solved from",
        )
    if calibration.solver.method == "paper":
        return ReportData(calibration, profile=find_profile(calibration.board.sensor))
    data = load_board(recordings, calibration.board.id)
    extend = _requested_causes(calibration)
    criticised = fit_criticised(data, extend)
    assessed = AssessedFit(criticised.fit)
    _, report_data_of = _solve_by_likelihood(data, extend, criticised, assessed)
    return report_data_of(calibration)


def _requested_causes(calibration: CalibrationDocument) -> tuple[str, ...]:
    """Return the causes that were requested: those whose settings have the document's digest."""
    causes = tuple(t for t in calibration.solver.terms if t in catalogue())
    for extend in ((), (AUTO,), *(causes[:k] for k in range(1, len(causes) + 1))):
        if settings_sha256(likelihood_settings(extend)) == calibration.solver.config_sha256:
            return extend
    raise InputError(
        "the figures of the report cannot be drawn, because the calibration of "
        f"{calibration.board.id} was made with settings that this program does not know",
        "leave out the recordings to get the report without figures, or calibrate from them again "
        "with `gyrorig solve`",
    )


def with_search_findings(
    calibration: CalibrationDocument, explanation: BoardExplanation
) -> CalibrationDocument:
    """Return a calibration with the findings of the search and their effect on the verdict."""
    findings = build_document(explanation)
    # The search on a unit fits what it names, or the motion's own unknowns contain it.
    is_fitted = explanation.fit_explanation is not None
    named = [] if is_fitted else [cause.term for cause in explanation.findings.causes]
    return msgspec.structs.replace(
        add_findings(calibration, findings, named),
        findings=FindingsReference(
            verdict=findings.verdict,
            causes=[cause.cause for cause in findings.causes],
            file=f"v{calibration.version:04d}{FINDINGS_SUFFIX}",
        ),
    )


def _solve_by_paper(
    data: BoardData,
) -> tuple[DocumentBuilder, Callable[[CalibrationDocument], ReportData]]:
    if len(data.recordings) > 1:
        raise UsageError(
            "the option `--method paper` needs exactly one recording, but "
            f"{len(data.recordings)} are given",
            "give one recording, or use `--method likelihood`",
        )
    (recording,), (samples,), board = data.recordings, data.samples, BoardId(data.board)
    result = solve_with_paper_method(recording, board, samples)
    software = installed_version("gyrorig")
    origin = build_provenance([recording], board, [samples.lost], software, {"method": "paper"})
    profile = find_profile(origin.board.sensor)
    rates = samples.rate_rad_s[samples.usable]
    span = (float(rates.min()), float(rates.max()))

    def document(version: int, previous: str | None, created: str) -> CalibrationDocument:
        return build_paper_calibration(
            result, span, origin, version=version, previous=previous, created=created
        )

    def report_data_of(calibration: CalibrationDocument) -> ReportData:
        return ReportData(calibration, profile=profile)

    return document, report_data_of
