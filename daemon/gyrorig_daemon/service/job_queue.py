"""Job queue: a folder with one file per session that waits to run.

    queue/NAME.yaml                      waits; the first name in alphabetical order is next
    queue/running/NAME.yaml              is running
    queue/done/NAME.yaml, .result.json   has finished
    queue/failed/NAME.yaml, .result.json did not finish; the result contains the reason

A job is a document `gyrorig/job/1`, or a `gyrorig/program/1` without further settings. It must
appear in the folder in one step: written under another name and renamed, or moved from the
same disk. Names that begin with a dot are ignored.

What to use when: `enqueue_job` to add a job, `JobQueue` to take jobs. A job that was running
when the service crashed is not started again, because it may be the cause of the crash.
"""

import contextlib
import json
import os
import secrets
import stat
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from gyrorig_daemon.service.state_folder import apply_umask
from gyrorig_protocol.atomic_files import write_atomically
from gyrorig_protocol.documents import convert_document, dump_yaml, parse_yaml
from gyrorig_protocol.errors import GyrorigError, InputError, MachineError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.program import MotionProgram, parse_program

SCHEMA = "gyrorig/job/1"
MAX_JOB_BYTES = 1_000_000
INTERRUPTED = (
    "The daemon ended while the job was running. Check the rig and the log, then enqueue "
    "the job again."
)
MAX_KEPT_RESULTS = 1_000  # in done/ and in failed/ each
FOLDER_MODE = 0o2770  # members of the daemon's group can add jobs
JOB_MODE = 0o660
RESULT_MODE = 0o640

ProgramText = Annotated[str, msgspec.Meta(max_length=MAX_JOB_BYTES)]


class JobDocument(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The content of a job file."""

    program: ProgramText  # a whole `gyrorig/program/1` document, as text
    schema: Literal["gyrorig/job/1"] = "gyrorig/job/1"
    session: str | None = None
    home: bool = False


@dataclass(frozen=True, slots=True)
class SessionJob:
    """A session that is to run."""

    name: str
    program: MotionProgram
    program_text: bytes
    session: str
    home: bool
    path: Path | None = None  # None: from the schedule


def enqueue_job(
    queue: Path, program_text: bytes, name: str, session: str | None = None, home: bool = False
) -> Path:
    """Add a job to the queue; return its file.

    Args:
        queue: the folder.
        program_text: the program document.
        name: name of the program in error messages.
        session: name of the session in the recording; random if it is None.
        home: home the unit first.

    Raises:
        UsageError: the program or the session name is invalid.
        MachineError: the file cannot be written.
    """
    program = parse_program(program_text, name)
    validate_session_name(session)
    document = {"schema": SCHEMA, "program": program_text.decode("utf-8"), "home": home}
    if session is not None:
        document["session"] = session
    stem = "".join(c if c.isalnum() else "-" for c in program.name)[:32].strip("-") or "job"
    submitted_at = datetime.now(UTC)
    path = queue / f"{submitted_at:%Y%m%dT%H%M%S%f}Z-{secrets.token_hex(2)}-{stem}.yaml"
    try:
        write_atomically(path, dump_yaml(document).encode(), mode=apply_umask(JOB_MODE))
    except OSError as error:
        raise MachineError(
            f"the job cannot be written to the queue {queue} ({error.strerror})",
            "give the folder of the daemon with --state, or join the daemon's group, whose "
            "members can write to the queue",
        ) from error
    return path


def validate_session_name(session: str | None) -> None:
    """Check that a session name can be part of a file name.

    Raises:
        UsageError: it cannot.
    """
    try:
        if session is not None:
            BoardId(session)
    except InputError as error:
        raise UsageError(f"the session name {session!r:.50} is not valid", error.remedy) from error


def parse_job(text: bytes, name: str, path: Path | None = None) -> SessionJob:
    """Return the job that a document describes.

    Raises:
        UsageError: the document is not a valid job.
    """
    document = parse_yaml(text, name, schema=SCHEMA)
    if isinstance(document, dict) and str(document.get("schema", "")) != SCHEMA:
        try:  # YAML also permits UTF-16, which the program text cannot be
            job_document = JobDocument(program=text.decode("utf-8"))
        except UnicodeDecodeError as error:
            raise UsageError(
                f"the motion program {name} is not a text in UTF-8", "save the file as UTF-8"
            ) from error
    else:
        job_document = convert_document(document, JobDocument, name)
    validate_session_name(job_document.session)
    program_text = job_document.program.encode()
    program = parse_program(program_text, name)
    session = job_document.session or secrets.token_hex(4)
    return SessionJob(Path(name).stem, program, program_text, session, job_document.home, path)


class JobQueue:
    """The queue as the service uses it; the content of a file never raises an exception here."""

    def __init__(self, folder: Path) -> None:
        """Create missing folders, and move jobs that were running to `failed`.

        Raises:
            MachineError: the folders cannot be created.
        """
        self._folder = folder
        self.rejected_count = 0
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with contextlib.suppress(PermissionError):  # another user owns the folder
                folder.chmod(FOLDER_MODE)
            for name in ("running", "done", "failed"):
                (folder / name).mkdir(exist_ok=True)
        except OSError as error:
            raise MachineError(
                f"the folder {folder} cannot be used for the queue ({error.strerror})",
                "choose another folder with --state",
            ) from error
        for path in self._job_files(folder / "running"):
            self._archive(path, "failed", {"reason": INTERRUPTED})

    def waiting_jobs(self) -> list[str]:
        """Return the names of the waiting jobs, the next one first."""
        return [path.stem for path in self._job_files(self._folder)]

    def take_next(self) -> SessionJob | None:
        """Take the next job, which is running from now on; None if no job waits.

        A file that is not a valid job is moved to `failed`, and the next one is read.
        """
        for path in self._job_files(self._folder):
            running = self._folder / "running" / path.name
            try:
                path.rename(running)
                text = _read_regular(running)
                return parse_job(text, path.name, running)
            except GyrorigError as error:
                self.rejected_count += 1
                self._archive(running, "failed", {"reason": str(error)})
            except (OSError, ValueError) as error:
                self.rejected_count += 1
                error_text = getattr(error, "strerror", None) or error
                remedy = (
                    "Give the group of the daemon permission to read the file, and enqueue the "
                    "job again."
                )
                self._archive(
                    running,
                    "failed",
                    {"reason": f"The file of the job cannot be read ({error_text}). {remedy}"},
                )
        return None

    def finish(self, job: SessionJob, succeeded: bool, result: Mapping[str, Any]) -> None:
        """Move a job to `done` or `failed`, with its result."""
        if job.path is not None:
            self._archive(job.path, "done" if succeeded else "failed", result)

    def requeue(self, job: SessionJob) -> None:
        """Put a job back that was not started."""
        if job.path is not None:
            with contextlib.suppress(OSError):
                job.path.rename(self._folder / job.path.name)

    def _archive(self, path: Path, outcome: str, result: Mapping[str, Any]) -> None:
        target = self._folder / outcome
        document = {"schema": "gyrorig/job-result/1", "job": path.stem, "result": outcome, **result}
        with contextlib.suppress(OSError):  # on a full disk the job is moved at least
            write_atomically(
                target / f"{path.stem}.result.json", json.dumps(document).encode(), mode=RESULT_MODE
            )
        with contextlib.suppress(OSError):
            path.rename(target / path.name)
        self._prune_results(target)

    def _prune_results(self, folder: Path) -> None:
        files = self._job_files(folder)
        for path in files[: max(0, len(files) - MAX_KEPT_RESULTS)]:
            with contextlib.suppress(OSError):
                path.unlink()
                path.with_name(f"{path.stem}.result.json").unlink(missing_ok=True)

    @staticmethod
    def _job_files(folder: Path) -> list[Path]:
        try:
            names = sorted(
                entry.name
                for entry in os.scandir(folder)
                if entry.name.endswith(".yaml") and not entry.name.startswith(".")
            )
        except OSError:
            return []
        return [folder / name for name in names]


def _read_regular(path: Path) -> bytes:
    """Return the bytes of a regular file; pipes, devices, links and large files are rejected.

    Raises:
        UsageError: the file is one of these.
        OSError: the file cannot be read.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise UsageError(
                f"the job {path.name} in the queue is not a regular file",
                "remove the file, and add a motion program with `gyrorigd enqueue`",
            )
        if status.st_size > MAX_JOB_BYTES:
            raise UsageError(
                f"the job {path.name} in the queue is larger than 1 MB",
                "remove the file, and add a motion program with `gyrorigd enqueue`",
            )
        data = bytearray()
        while chunk := os.read(descriptor, MAX_JOB_BYTES + 1 - len(data)):
            data += chunk
        return bytes(data)
    finally:
        os.close(descriptor)
