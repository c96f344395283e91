"""One board, all the way: fit, document, next version, report."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any

import msgspec

from gyrorig_protocol.errors import GyrorigError, InputError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.calibration.build import calibration_of, settings_sha256
from gyrorig_solver.calibration.document import Calibration, Findings, to_yaml
from gyrorig_solver.calibration.origin import provenance
from gyrorig_solver.calibration.paper import paper_calibration_of, solve_as_printed
from gyrorig_solver.calibration.profiles import find_profile
from gyrorig_solver.calibration.store import CalibrationStore, StoredVersion
from gyrorig_solver.calibration.trust import with_findings
from gyrorig_solver.estimate.result import GyroFit
from gyrorig_solver.findings.document import FindingsDocument
from gyrorig_solver.findings.document import to_yaml as findings_yaml
from gyrorig_solver.findings.explaining import (
    Explanation,
    document_of_found,
    explain_board,
    explain_unit,
    page_of_found,
)
from gyrorig_solver.model.terms.catalogue import catalogue
from gyrorig_solver.report.data import ReportData
from gyrorig_solver.report.html import render
from gyrorig_solver.samples import load_samples
from gyrorig_solver.solve import solve_recordings
from gyrorig_solver.together import are_on_one_unit, solve_on_one_unit

AUTO = "auto"
FINDINGS_SUFFIX = ".findings.yaml"


@dataclass(frozen=True, slots=True, eq=False)
class Solved:
    """One board's result, as it lies in the store."""

    calibration: Calibration
    path: Path
    report: Path
    stored: StoredVersion
    found: Explanation | None = None  # where causes were searched for


@dataclass(frozen=True, slots=True, eq=False)
class Ready:
    """One board's fit, made together with the boards beside it."""

    fit: GyroFit
    found: Explanation | None = None  # where causes were searched for


# (version, digest of the version before, created) to the document
Document = Callable[[int, str | None, str], Calibration]


def solve_into(
    store: CalibrationStore,
    recordings: Sequence[Recording],
    board: BoardId,
    method: str = "likelihood",
    extend: Sequence[str] = (),
    ready: Ready | None = None,
    before: Callable[[], None] = lambda: None,
) -> Solved:
    """Solve one board, and write its next version and its report.

    Args:
        store: where the versions are.
        recordings: at least one, each with the board in it; solved together.
        board: which one.
        method: `likelihood` or `paper`.
        extend: causes of the catalogue to fit too, `auto` for those that a search names;
            `likelihood` only.
        ready: what `fits_together` has of this board; then nothing is solved anew.
        before: called when the version is to be written; what it raises ends this.

    Raises:
        InputError: the recordings do not hold what the method needs.
        UsageError: recordings that cannot be solved together.
        MachineError: the store cannot be written.
    """
    store.prepare(board)
    ordered = sorted(recordings, key=lambda recording: recording.start_ns)
    found: Explanation | None = None
    if method == "paper":
        document, data_of = _by_paper(ordered, board)
    else:
        document, data_of, found = _by_likelihood(ordered, board, extend, ready)
    created = datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    written: list[Calibration] = []

    def text(version: int, previous: str | None) -> str:
        written.append(document(version, previous, created))
        return to_yaml(written[-1])

    stored = store.add(board, text, before)
    report = store.beside(stored, ".report.html", render(data_of(written[-1])).encode())
    if found is not None:
        _write_findings(store, stored, found)
    return Solved(written[-1], stored.path, report, stored, found)


def fits_together(
    recordings: Sequence[Recording],
    boards: Sequence[BoardId],
    method: str = "likelihood",
    extend: Sequence[str] = (),
) -> dict[str, Ready | GyrorigError]:
    """Return the fits of boards that were on one unit at once, or why a board has none.

    Empty where boards are to be solved one by one: another reference, the paper's method, or
    more data than one look should take. Causes that are searched for are searched for in all
    boards; what is the unit's has one size.
    """
    if method != "likelihood" or not are_on_one_unit(recordings, boards):
        return {}
    asked = tuple(cause for cause in extend if cause != AUTO)
    searched = explain_unit(recordings, boards) if AUTO in extend else {}
    failed = {str(b): one for b, one in searched.items() if isinstance(one, GyrorigError)}
    found = {str(b): one for b, one in searched.items() if isinstance(one, Explanation)}
    named = {board: one.findings.extensions for board, one in found.items()}
    fits = solve_on_one_unit(recordings, [b for b in boards if b not in failed], asked, named)
    ready: dict[str, Ready | GyrorigError] = dict(failed)
    for board, fit in fits.items():
        ready[board] = fit if isinstance(fit, GyrorigError) else Ready(fit, found.get(board))
    return ready


def _write_findings(store: CalibrationStore, stored: StoredVersion, found: Explanation) -> None:
    """Write what was found beside its version: v0001.findings.yaml and v0001.findings.html."""
    document, page = page_of_found(found)
    store.beside(stored, FINDINGS_SUFFIX, findings_yaml(document).encode())
    store.beside(stored, ".findings.html", page.encode())


def document_of(
    fit: GyroFit, recordings: Sequence[Recording], board: BoardId, extend: Sequence[str] = ()
) -> Document:
    """Return what makes a fit's document, given version, digest of the one before, time.

    Args:
        fit: of those recordings.
        recordings: in the order of time.
        board: in each of them.
        extend: causes that were asked for.
    """
    lost = [fit.lost] if len(recordings) == 1 else [load_samples(r, board).lost for r in recordings]
    software = installed_version("gyrorig")
    origin = provenance(recordings, board, lost, software, likelihood_settings(extend))
    profile = find_profile(origin.board.sensor)

    def document(version: int, previous: str | None, created: str) -> Calibration:
        return calibration_of(
            fit, origin, version=version, previous=previous, created=created, profile=profile
        )

    return document


def likelihood_settings(extend: Sequence[str]) -> dict[str, Any]:
    """Return the settings that a calibration of `likelihood` carries the digest of."""
    return {"method": "likelihood", **({"extend": list(extend)} if extend else {})}


def _by_likelihood(
    recordings: Sequence[Recording],
    board: BoardId,
    extend: Sequence[str],
    ready: Ready | None = None,
) -> tuple[Document, Callable[[Calibration], ReportData], Explanation | None]:
    if ready is None:
        found = explain_board(recordings, board) if AUTO in extend else None
        asked = tuple(cause for cause in extend if cause != AUTO)
        named = () if found is None else found.findings.extensions
        ready = Ready(solve_recordings(recordings, board, asked, named), found)
    fit, found = ready.fit, ready.found
    plain = document_of(fit, recordings, board, extend)

    def document(version: int, previous: str | None, created: str) -> Calibration:
        made = plain(version, previous, created)
        return made if found is None else explained(made, document_of_found(found))

    def data_of(calibration: Calibration) -> ReportData:
        profile = find_profile(calibration.board.sensor)
        return ReportData(calibration, fit.diagnostics, fit.clock, profile, fit.reference)

    return document, data_of, found


def shown_again(calibration: Calibration, recordings: Sequence[Recording]) -> ReportData:
    """Return what a stored calibration's report shows, its arrays worked out anew.

    Args:
        calibration: from a store; its numbers stay what they are.
        recordings: those that it was solved from.

    Raises:
        InputError: they are others, or it was solved with settings that are not known here.
    """
    there = {recording.sha256: recording.path.name for recording in recordings}
    wanted = {row.sha256: row.name for row in calibration.inputs}
    for missing in wanted.keys() - there.keys():
        raise InputError(
            f"{wanted[missing]}, which {calibration.board.id} was solved from, is not there",
            "name every recording of the calibration",
        )
    for other in there.keys() - wanted.keys():
        raise InputError(
            f"{calibration.board.id} was not solved from {there[other]}", "leave it out"
        )
    if calibration.solver.method == "paper":
        return ReportData(calibration, profile=find_profile(calibration.board.sensor))
    ordered = sorted(recordings, key=lambda recording: recording.start_ns)
    board = BoardId(calibration.board.id)
    _, data_of, _ = _by_likelihood(ordered, board, _asked(calibration))
    return data_of(calibration)


def _asked(calibration: Calibration) -> tuple[str, ...]:
    """Return the causes that were asked for: those whose settings have the document's digest.

    Raises:
        InputError: none that could have been.
    """
    causes = tuple(t for t in calibration.solver.terms if t in catalogue())
    for extend in ((), (AUTO,), *(causes[:k] for k in range(1, len(causes) + 1))):
        if settings_sha256(likelihood_settings(extend)) == calibration.solver.config_sha256:
            return extend
    raise InputError(
        f"the settings that {calibration.board.id} was solved with are not known",
        "leave the recordings out: the page has the numbers, or solve again for the figures",
    )


def explained(calibration: Calibration, findings: FindingsDocument) -> Calibration:
    """Return a calibration with what a search for causes found, and what that does to trust."""
    return msgspec.structs.replace(
        calibration,
        trust=with_findings(calibration.trust, findings),
        findings=Findings(
            verdict=findings.verdict,
            causes=[one.cause for one in findings.causes],
            file=f"v{calibration.version:04d}{FINDINGS_SUFFIX}",
        ),
    )


def _by_paper(
    recordings: Sequence[Recording], board: BoardId
) -> tuple[Document, Callable[[Calibration], ReportData]]:
    if len(recordings) > 1:
        raise UsageError(
            f"the paper's method takes one recording, not {len(recordings)}", "name one"
        )
    (recording,) = recordings
    samples = load_samples(recording, board)
    result = solve_as_printed(recording, board, samples)
    software = installed_version("gyrorig")
    origin = provenance([recording], board, [samples.lost], software, {"method": "paper"})
    profile = find_profile(origin.board.sensor)
    rates = samples.rate_rad_s[samples.good]
    span = (float(rates.min()), float(rates.max()))

    def document(version: int, previous: str | None, created: str) -> Calibration:
        return paper_calibration_of(
            result, span, origin, version=version, previous=previous, created=created
        )

    def data_of(calibration: Calibration) -> ReportData:
        return ReportData(calibration, profile=profile)

    return document, data_of
