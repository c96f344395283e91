"""Session job: solve one session in a worker; recordings in, new versions and index rows out.

What to use when: `run_job` is sent to an executor. It never raises for the contents of a
recording. What it raises is an error of the machine or of the store, and the job is then
deferred, not done.
"""

import time
import traceback
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import PurePosixPath

import msgspec

from gyrorig_protocol.errors import GyrorigError, InputError, MachineError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.recording.reader import read_recording
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.calibration import (
    CalibrationDocument,
    CalibrationStore,
    StoredVersion,
    parse_calibration,
)
from gyrorig_solver.calibration.calibration_builder import settings_sha256
from gyrorig_solver.calibration.unit_document import UnitPosteriorDocument
from gyrorig_solver.calibration.unit_store import UnitStore
from gyrorig_solver.data.utc_time import utc_text_now
from gyrorig_solver.fleet.jobs.resource_limits import DeadlineExceededError, deadline, memory_limit
from gyrorig_solver.fleet.store import IndexRow
from gyrorig_solver.fleet.store.index_rows import (
    MAX_TRACE_CHARS,
    WorkStatus,
    calibration_row,
)
from gyrorig_solver.pipeline import (
    AUTO,
    CriticisedFit,
    UnitKnowledge,
    fit_together,
    solve_and_store,
)
from gyrorig_solver.pipeline.one_board import check_stored_board
from gyrorig_solver.pipeline.solve_board import likelihood_settings
from gyrorig_solver.storage import (
    Storage,
    fit_memory_bound_bytes,
    limit_fit_memory,
    limit_input,
    size_of_inputs,
)

VERSIONS_CHECKED = 3  # latest versions that are checked for this job's result


@dataclass(frozen=True, slots=True)
class SolveSettings:
    """How every session of a batch is solved."""

    solver_version: str
    extend: tuple[str, ...] = (AUTO,)
    deadline_s: float = 300.0
    memory_bytes: int = 4 << 30
    uses_unit_store: bool = True  # the posteriors of units in the store are read and extended
    unit_document: UnitPosteriorDocument | None = None  # the prior of every unit instead

    @property
    def config_sha256(self) -> str:
        """Hash of the settings, as in the calibrations."""
        return settings_sha256(likelihood_settings(self.extend))


@dataclass(frozen=True, slots=True)
class Job:
    """The work on one session."""

    key: str
    batch: str
    store: Storage
    spool: Storage
    paths: tuple[PurePosixPath, ...]  # below the spool
    digests: tuple[str, ...]
    settings: SolveSettings
    rejection: str = ""  # why it must not be solved
    remedy: str = ""  # of the rejection
    input_bytes: int = 0  # of all recordings

    @property
    def unit_knowledge(self) -> UnitKnowledge:
        """Where its solves read what is known of the unit."""
        store = UnitStore(self.store) if self.settings.uses_unit_store else None
        return UnitKnowledge(store, self.settings.unit_document)


@dataclass(frozen=True, slots=True)
class JobResult:
    """Result of a job: at least one row."""

    key: str
    rows: tuple[IndexRow, ...]


def run_job(job: Job) -> JobResult:
    """Solve every board of one session.

    Raises:
        MachineError: the store or the machine refuses; nothing is recorded.
    """
    started_s = time.process_time()
    rows: list[IndexRow] = []
    unfinished: list[str] = []  # boards of the session that have no row yet

    def add_failure(status: WorkStatus, reason: str, trace: str = "") -> None:
        # A board that is in the store keeps its row: without one, its version is lost.
        boards = [board for board in unfinished if board not in {row.board for row in rows}]
        rows.extend(
            failure_row(job, status, reason=reason, trace=trace, board=board)
            for board in (boards if rows else [""])
        )

    try:
        with deadline(job.settings.deadline_s):
            for row in _solve_boards(job, unfinished):
                rows.append(row)  # an error keeps the rows before it
    except MachineError:
        raise
    except GyrorigError as fault:
        add_failure("rejected", str(fault))
    except DeadlineExceededError:
        reason = (
            f"the session took longer than {job.settings.deadline_s:g} s. Repeat it with "
            "--retry failed and a larger --deadline."
        )
        add_failure("failed", reason, traceback.format_exc())
    except MemoryError:
        reason = (
            f"the session needs more than {job.settings.memory_bytes >> 20} MB of memory. "
            "Repeat it with --retry failed and a larger --memory."
        )
        add_failure("failed", reason)
    except Exception as fault:  # an error of this program must not stop the batch
        reason = _program_error_text(fault)
        add_failure("failed", reason, traceback.format_exc())
    cpu_time_s = time.process_time() - started_s
    return JobResult(
        job.key, tuple(msgspec.structs.replace(row, seconds=cpu_time_s) for row in rows)
    )


def _fit_memory_limit(job: Job, recordings: Sequence[Recording]) -> AbstractContextManager[None]:
    """Return the limit by the number of messages, if it is below that of the settings."""
    message_count = sum(recording.message_count for recording in recordings)
    bound_bytes = fit_memory_bound_bytes(job.input_bytes, message_count)
    if not job.input_bytes or bound_bytes >= job.settings.memory_bytes:
        return nullcontext()
    return limit_fit_memory(job.paths[0].name, job.input_bytes, message_count)


def run_job_memory_limited(job: Job) -> JobResult:
    """Run a job within its memory limit, in a process that another program started.

    Raises:
        MachineError: as `run_job`.
    """
    with memory_limit(job.settings.memory_bytes):
        return run_job(job)


def failure_row(
    job: Job,
    status: WorkStatus,
    *,
    reason: str = "",
    trace: str = "",
    recording: Recording | None = None,
    board: str = "",
) -> IndexRow:
    """Return the row of a job without a calibration."""
    metadata = {} if recording is None else recording.metadata.get("gyrorig", {})
    return IndexRow(
        key=job.key,
        status=status,
        created=utc_text_now(),
        batch=job.batch,
        inputs=list(job.digests),
        names=[_encodable(path.name) for path in job.paths],
        reason=_encodable(" ".join(reason.split())[:MAX_TRACE_CHARS]),
        trace=_encodable(trace[-MAX_TRACE_CHARS:]),
        session=metadata.get("session", ""),
        rig=metadata.get("rig", ""),
        board=str(board),  # BoardId is a subclass of str that msgspec does not encode
        solver_version=job.settings.solver_version,
        config_sha256=job.settings.config_sha256,
    )


def _solve_boards(job: Job, unfinished: list[str]) -> Iterator[IndexRow]:
    if job.rejection:
        raise InputError(job.rejection, job.remedy)
    recordings = _read_recordings(job)
    with _fit_memory_limit(job, recordings):
        yield from _solve_recordings(job, recordings, unfinished)


def _read_recordings(job: Job) -> list[Recording]:
    recordings = []
    for path in job.paths:
        # A recording is memory-mapped: its file can be removed after it is read.
        with (
            job.spool.local_copy(str(path)) as local_path,
            limit_input(path.name, size_of_inputs([local_path])),
        ):
            recordings.append(read_recording(local_path))
    for recording in recordings:
        if recording.sha256 not in job.digests:
            raise InputError(
                f"the recording {recording.path.name} was changed while the batch was running",
                "do not change recordings in the spool. The next batch solves the new content",
            )
    return recordings


def _solve_recordings(
    job: Job, recordings: Sequence[Recording], unfinished: list[str]
) -> Iterator[IndexRow]:
    boards = sorted({board for recording in recordings for board in recording.board_ids})
    if not boards:
        raise InputError(
            f"the recording {job.paths[0].name} contains no samples of a board",
            "check the recording with `gyrorig check`, connect the board, and record again",
        )
    unfinished += boards
    store = CalibrationStore(job.store)
    fits: dict[str, CriticisedFit | GyrorigError] = {}
    failure: _JointFitFailedError | None = None
    try:
        fits = _fit_together(job, store, recordings, boards)
    except _JointFitFailedError as fault:  # the single fits are valid, but the failure is reported
        failure = fault
    for board in boards:
        row = _solve_board(job, store, recordings, board, fits.get(board))
        if failure is not None and row.status == "ok":
            row = msgspec.structs.replace(row, reason=failure.reason, trace=failure.trace)
        yield row


def _fit_together(
    job: Job, store: CalibrationStore, recordings: Sequence[Recording], boards: list[BoardId]
) -> dict[str, CriticisedFit | GyrorigError]:
    """Return the joint fits of boards that were on one unit; empty if they are solved singly.

    Raises:
        _JointFitFailedError: the program failed; the boards can still be solved singly.
    """
    in_all_recordings = [
        candidate
        for candidate in boards
        if all(candidate in recording.board_ids for recording in recordings)
    ]
    try:
        for board in in_all_recordings:
            _check_newest_versions(job, store, recordings, board)
    except _AlreadyDoneError:  # an interrupted batch has solved some of them; few are left
        return {}
    except InputError:  # reported where that board is solved
        pass
    try:
        return fit_together(recordings, in_all_recordings, extend=job.settings.extend)
    except (DeadlineExceededError, MemoryError):
        raise
    except Exception as fault:
        raise _JointFitFailedError(_program_error_text(fault), traceback.format_exc()) from fault


def _solve_board(
    job: Job,
    store: CalibrationStore,
    recordings: Sequence[Recording],
    board: BoardId,
    ready: CriticisedFit | GyrorigError | None,
) -> IndexRow:
    """Solve one board; its errors do not affect the other boards."""
    holding = [recording for recording in recordings if board in recording.board_ids]
    first = holding[0]
    check_newest = partial(_check_newest_versions, job, store, holding, board)
    try:
        check_newest()
        if isinstance(ready, GyrorigError):
            raise ready
        extend = job.settings.extend
        solved = solve_and_store(
            store,
            holding,
            board,
            extend=extend,
            precomputed=ready,
            before_writing=check_newest,
            unit_knowledge=job.unit_knowledge,
        )
        calibration, stored = solved.calibration, solved.stored
    except _AlreadyDoneError as signal:
        calibration, stored = signal.calibration, signal.version
    except MachineError:
        raise
    except GyrorigError as fault:
        return failure_row(job, "rejected", reason=str(fault), recording=first, board=board)
    except (DeadlineExceededError, MemoryError):
        raise
    except Exception as fault:  # see run_job
        reason = _program_error_text(fault)
        trace = traceback.format_exc()
        return failure_row(job, "failed", reason=reason, trace=trace, recording=first, board=board)
    metadata = first.metadata.get("gyrorig", {})
    return calibration_row(
        calibration,
        key=job.key,
        batch=job.batch,
        session=metadata.get("session", ""),
        rig=metadata.get("rig", ""),
        file=stored.name,
        file_sha256=stored.digest().removeprefix("sha256:"),
        companions=store.companion_digests(stored),
    )


def _encodable(text: str) -> str:
    """Return a text with escapes for the bytes of a file name that are not UTF-8."""
    return text.encode("utf-8", "backslashreplace").decode()


def _program_error_text(fault: Exception) -> str:
    return f"an error of the program, {type(fault).__name__}: {fault}"


class _JointFitFailedError(Exception):
    """The joint fit of several boards failed with an error of the program."""

    def __init__(self, error_text: str, trace: str) -> None:
        super().__init__()
        reason = f"the boards were solved singly, because their joint fit failed with {error_text}"
        self.reason = " ".join(reason.split())[:MAX_TRACE_CHARS]
        self.trace = trace[-MAX_TRACE_CHARS:]


class _AlreadyDoneError(Exception):
    """The job has its version already: it was interrupted before its row, or done elsewhere."""

    def __init__(self, calibration: CalibrationDocument, version: StoredVersion) -> None:
        super().__init__()
        self.calibration, self.version = calibration, version


def _check_newest_versions(
    job: Job, store: CalibrationStore, holding: Sequence[Recording], board: BoardId
) -> None:
    """Check the board's latest versions, before the job and before each attempt to write.

    `holding` has all recordings of the job that contain the board. A version of fewer of them was
    made before the others existed, and is not this job's.

    Raises:
        _AlreadyDoneError: one of them is this job's.
        InputError: they belong to another board of the same name.
    """
    newest = store.versions(board)[-VERSIONS_CHECKED:]
    digests = {recording.sha256 for recording in holding}
    config = job.settings.config_sha256
    for stored in reversed(newest):
        calibration = _parse_cached(stored.data(), str(stored.path))
        if stored is newest[-1]:
            check_stored_board(calibration.board, holding)
        same_inputs = {recorded.sha256 for recorded in calibration.inputs} == digests
        same_solver = calibration.solver.version == job.settings.solver_version
        if same_inputs and same_solver and calibration.solver.config_sha256 == config:
            raise _AlreadyDoneError(calibration, stored)


@lru_cache(maxsize=16)  # a job reads the latest versions of a board three times
def _parse_cached(data: bytes, name: str) -> CalibrationDocument:
    return parse_calibration(data, name)
