"""Solve a board: fit, calibration document, next version in the store, report.

What to use when: `solve_and_store` for one board; `fit_together` first, if boards were on one unit
at the same time; `rebuild_report_data` for the report of a stored calibration.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
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
from gyrorig_solver.calibration.plausibility import (
    add_conflicts,
    find_conflicts,
    widen_by_conflicts,
)
from gyrorig_solver.calibration.provenance import build_provenance
from gyrorig_solver.calibration.total_uncertainty import with_total_uncertainty
from gyrorig_solver.calibration.unexplained_effect import widen_by_clock, widen_by_unexplained
from gyrorig_solver.estimate import GyroFit
from gyrorig_solver.findings import to_yaml as findings_yaml
from gyrorig_solver.findings import unexplained_bias_sigma
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.pipeline.assessed_fit import AssessedFit, add_to_unit, assess_fit
from gyrorig_solver.pipeline.board_data import BoardData, load_board
from gyrorig_solver.pipeline.board_results import BoardExplanation, CriticisedFit
from gyrorig_solver.pipeline.criticised_fit import AUTO, fit_criticised
from gyrorig_solver.pipeline.criticism_verdict import add_criticism, add_findings
from gyrorig_solver.pipeline.explain_board import build_document, findings_page
from gyrorig_solver.pipeline.one_board import compare_with_version
from gyrorig_solver.pipeline.unit_prior import UnitKnowledge
from gyrorig_solver.report import ReportData, render_calibration
from gyrorig_solver.uncertainty import UncertaintyBudget, UncertaintySettings, default_settings

FINDINGS_SUFFIX = ".findings.yaml"


@dataclass(frozen=True, slots=True, eq=False)
class StoredResult:
    """One board's calibration as written to the store."""

    calibration: CalibrationDocument
    path: Path
    report: Path
    stored: StoredVersion
    explanation: BoardExplanation | None = None  # if causes were searched for
    unit_version: int | None = None  # of the unit's posterior, if the solve added one
    other_board: str | None = None  # a remark if the version before is of another board


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
    allow_contradiction: bool = False,
) -> StoredResult:
    """Solve one board, and write its next version and its report.

    Args:
        store: of the versions.
        recordings: at least one, each with the board in it; solved together.
        board: id of the board.
        method: `likelihood` or `paper`.
        extend: causes of the catalogue to fit, `auto` for those that a search names; only for the
            method `likelihood`.
        precomputed: the result of `fit_together` for this board, used instead of a new fit.
        before_writing: called before the version is written; if it raises an error, nothing is
            written.
        uncertainty: prior sizes of the causes and limits of the verdict; by default the shipped
            ones.
        unit_knowledge: source of the unit's posterior, to which the solve adds its information; by
            default none.
        allow_contradiction: solve the recordings together even if their gains differ.

    Raises:
        InputError: the recordings lack data that the method needs, or the stored posterior of the
            unit is damaged.
        UsageError: the recordings cannot be solved together.
        MachineError: the store cannot be written.
    """
    store.check_folder(board)
    fit: GyroFit | None = None
    explanation: BoardExplanation | None = None
    unit_version: int | None = None
    add_unit: Callable[[], int | None] | None = None
    data = load_board(recordings, board, allow_contradiction)
    if method == "paper":
        document = _solve_by_paper(data)
    else:
        criticised = precomputed or fit_criticised(data, extend)
        explanation = criticised.explanation
        settings = default_settings() if uncertainty is None else uncertainty
        knowledge = UnitKnowledge() if unit_knowledge is None else unit_knowledge
        assessed = assess_fit(data, criticised, settings, knowledge)
        fit = assessed.fit
        document = _likelihood_document(data, extend, criticised, assessed)
        add_unit = partial(add_to_unit, data, criticised, assessed, settings, knowledge)

    def text(version: int, previous: str | None) -> str:
        nonlocal document
        document = _as_version(document, version, previous)
        return calibration_as_yaml(document)

    def check_and_add_to_unit() -> None:
        nonlocal unit_version
        before_writing()  # its error prevents both versions
        if add_unit is not None and unit_version is None:
            unit_version = add_unit()

    other_board = compare_with_version(store.latest(board), document.board)
    stored = store.add_version(board, text, check_and_add_to_unit)
    page = render_calibration(_report_data(document, fit))
    report = store.write_companion(stored, ".report.html", page.encode())
    if explanation is not None:  # v0001.findings.yaml and v0001.findings.html
        findings, page = findings_page(explanation)
        store.write_companion(stored, FINDINGS_SUFFIX, findings_yaml(findings).encode())
        store.write_companion(stored, ".findings.html", page.encode())
    return StoredResult(
        document, stored.path, report, stored, explanation, unit_version, other_board
    )


def build_fit_document(
    fit: GyroFit, data: BoardData, extend: Sequence[str] = (AUTO,)
) -> CalibrationDocument:
    """Build the document of a fit, as a first version."""
    lost = [fit.lost] if len(data.samples) == 1 else [samples.lost for samples in data.samples]
    software = installed_version("gyrorig")
    settings = likelihood_settings(extend)
    origin = build_provenance(data.recordings, BoardId(data.board), lost, software, settings)
    return build_calibration(fit, origin, find_profile(origin.board.sensor))


def likelihood_settings(extend: Sequence[str]) -> dict[str, Any]:
    """Return the settings of `likelihood` whose digest a calibration stores."""
    return {"method": "likelihood", **({"extend": list(extend)} if extend else {})}


def _likelihood_document(
    data: BoardData, extend: Sequence[str], criticised: CriticisedFit, assessed: AssessedFit
) -> CalibrationDocument:
    document = msgspec.structs.replace(
        build_fit_document(assessed.fit, data, extend), unit_prior=assessed.unit_prior
    )
    profile = find_profile(document.board.sensor)
    full_scale_dps = document.board.config.gyro_full_scale_dps
    conflicts = find_conflicts(assessed.fit, profile, full_scale_dps)
    trust = add_conflicts(document.trust, conflicts, profile)
    document = msgspec.structs.replace(document, trust=trust)
    if assessed.budget is not None:
        budget = _widened_budget(assessed.budget, criticised, assessed.fit)
        budget = widen_by_clock(widen_by_conflicts(budget, conflicts), assessed.fit)
        document = with_total_uncertainty(document, budget)
    if criticised.explanation is not None:
        return with_search_findings(document, criticised.explanation)
    if criticised.criticism is not None:
        return add_criticism(document, criticised.criticism)
    return document


def _widened_budget(
    budget: UncertaintyBudget, criticised: CriticisedFit, fit: GyroFit
) -> UncertaintyBudget:
    """Return the budget with the effect of a reference by others that no cause explains."""
    explanation = criticised.explanation
    if explanation is None or criticised.attitude_space is None:
        return budget
    unexplained = explanation.findings.unexplained
    if unexplained is None:
        return budget
    return widen_by_unexplained(budget, fit, unexplained_bias_sigma(unexplained))


def _as_version(
    calibration: CalibrationDocument, version: int, previous: str | None
) -> CalibrationDocument:
    findings = calibration.findings
    if findings is not None:
        findings = msgspec.structs.replace(findings, file=f"v{version:04d}{FINDINGS_SUFFIX}")
    return msgspec.structs.replace(
        calibration, version=version, previous=previous, findings=findings
    )


def _report_data(calibration: CalibrationDocument, fit: GyroFit | None) -> ReportData:
    profile = find_profile(calibration.board.sensor)
    if fit is None:
        return ReportData(calibration, profile=profile)
    return ReportData(calibration, fit.diagnostics, fit.clock, profile, fit.reference)


def rebuild_report_data(
    calibration: CalibrationDocument, recordings: Sequence[Recording]
) -> ReportData:
    """Return the data of a stored calibration's report, with newly computed arrays.

    Raises:
        InputError: the recordings differ from those of the calibration, or the settings of the
            solve are not known.
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
        return _report_data(calibration, None)
    data = load_board(recordings, calibration.board.id, allow_contradiction=True)
    return _report_data(calibration, fit_criticised(data, _requested_causes(calibration)).fit)


def _requested_causes(calibration: CalibrationDocument) -> tuple[str, ...]:
    """Return the requested causes: those whose settings have the document's digest."""
    causes = tuple(t for t in calibration.solver.terms if t in catalogue())
    # Known causes are part of every fit at a known site; requested ones follow those of a search.
    effects = tuple(cause for cause in causes if catalogue()[cause].kind != "known")
    lists = [named[:k] for named in (causes, effects) for k in range(1, len(named) + 1)]
    searches = [(AUTO, *effects[k:]) for k in range(len(effects))]
    for extend in ((), (AUTO,), *lists, *searches):
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
    # The search on a unit fits the causes that it names, or the unknowns of the motion contain
    # them.
    is_fitted = explanation.fit_explanation is not None
    named = [] if is_fitted else [cause.term for cause in explanation.findings.causes]
    return msgspec.structs.replace(
        add_findings(calibration, findings, named, explanation.link),
        findings=FindingsReference(
            verdict=findings.verdict,
            causes=[cause.cause for cause in findings.causes],
            file="",  # filled in by `_as_version`
        ),
    )


def _solve_by_paper(data: BoardData) -> CalibrationDocument:
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
    rates = samples.rate_rad_s[samples.usable]
    return build_paper_calibration(result, (float(rates.min()), float(rates.max())), origin)
