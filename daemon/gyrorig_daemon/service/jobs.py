"""Sessions that wait to be carried out: a folder, one file a job.

    queue/NAME.yaml                      waits; the least name goes first
    queue/running/NAME.yaml              is being carried out
    queue/done/NAME.yaml, .result.json   carried out
    queue/failed/NAME.yaml, .result.json not, or not to the end; the result says why

A job is a document `gyrorig/job/1` (`gyrorig/program/1` will do: a job with nothing but its
program). It has to appear in the folder in one step: written beside and renamed, or moved
here from the same disk. Names that begin with a dot are not looked at.

What to use when: `put` to hand a job in, `JobQueue` to take jobs out. A job that was running
when the daemon died is not begun again: it may be what the daemon died of.
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

from gyrorig_daemon.service.files import write_whole
from gyrorig_protocol.documents import dump_yaml, parse_yaml, read_as
from gyrorig_protocol.errors import GyrorigError, InputError, MachineError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.program import MotionProgram, parse_program

SCHEMA = "gyrorig/job/1"
MAX_JOB_BYTES = 1_000_000
ENDED = "the daemon ended while it ran: look at the rig and the log, then hand it in again"
KEPT_RESULTS = 1_000  # of done and of failed jobs each
FOLDER_MODE = 0o2770  # whoever is in the daemon's group may hand in jobs
JOB_MODE = 0o660

ProgramText = Annotated[str, msgspec.Meta(max_length=MAX_JOB_BYTES)]


class JobDocument(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a job's file holds."""

    program: ProgramText  # a whole `gyrorig/program/1` document, as text
    schema: Literal["gyrorig/job/1"] = "gyrorig/job/1"
    session: str | None = None
    home: bool = False


@dataclass(frozen=True, slots=True)
class Job:
    """A session to be carried out."""

    name: str
    program: MotionProgram
    program_text: bytes
    session: str
    home: bool
    path: Path | None = None  # None: of the schedule


def put(
    queue: Path, program_text: bytes, name: str, session: str | None = None, home: bool = False
) -> Path:
    """Hand in a job; return its file.

    Args:
        queue: the folder.
        program_text: the program's document.
        name: what to call it in an error.
        session: its name in the recording, else one is drawn.
        home: home the unit first.

    Raises:
        UsageError: it is no program, or the name cannot be a session's.
        MachineError: the folder takes no file.
    """
    program = parse_program(program_text, name)
    check_session(session)
    document = {"schema": SCHEMA, "program": program_text.decode("utf-8"), "home": home}
    if session is not None:
        document["session"] = session
    stem = "".join(c if c.isalnum() else "-" for c in program.name)[:32].strip("-") or "job"
    now = datetime.now(UTC)
    path = queue / f"{now:%Y%m%dT%H%M%S%f}Z-{secrets.token_hex(2)}-{stem}.yaml"
    try:
        write_whole(path, dump_yaml(document).encode(), JOB_MODE)
    except OSError as fault:
        raise MachineError(
            f"{queue} takes no job: {fault.strerror}",
            "name the daemon's folder with --state; who is in the daemon's group may write to it",
        ) from fault
    return path


def check_session(session: str | None) -> None:
    """Make sure that a session's name can be part of a file's.

    Raises:
        UsageError: it cannot.
    """
    try:
        if session is not None:
            BoardId(session)
    except InputError as fault:
        raise UsageError(f"{session!r:.50} is no name for a session", fault.remedy) from fault


def read_job(text: bytes, name: str, path: Path | None = None) -> Job:
    """Return the job that a file's text describes.

    Raises:
        UsageError: it is no job.
    """
    document = parse_yaml(text, name)
    if isinstance(document, dict) and str(document.get("schema", "")) != SCHEMA:
        try:  # YAML may be UTF-16 too, and would be read
            told = JobDocument(program=text.decode("utf-8"))
        except UnicodeDecodeError as fault:
            raise UsageError(f"{name} is no UTF-8 text", "write it as UTF-8") from fault
    else:
        told = read_as(document, JobDocument, name)
    check_session(told.session)
    program_text = told.program.encode()
    program = parse_program(program_text, name)
    session = told.session or secrets.token_hex(4)
    return Job(Path(name).stem, program, program_text, session, told.home, path)


class JobQueue:
    """The folder as the daemon sees it; nothing here raises because of what is in a file."""

    def __init__(self, folder: Path) -> None:
        """Make the folders that are missing, and put aside what was running.

        Raises:
            MachineError: they cannot be made.
        """
        self._folder = folder
        self.refused = 0
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with contextlib.suppress(PermissionError):  # somebody else's folder: as it is
                folder.chmod(FOLDER_MODE)
            for name in ("running", "done", "failed"):
                (folder / name).mkdir(exist_ok=True)
        except OSError as fault:
            raise MachineError(
                f"{folder} cannot be used: {fault.strerror}", "name another folder with --state"
            ) from fault
        for path in self._files(folder / "running"):
            self._end(path, "failed", {"reason": ENDED})

    def waiting(self) -> list[str]:
        """Return the names of the jobs that wait, the next one first."""
        return [path.stem for path in self._files(self._folder)]

    def take(self) -> Job | None:
        """Return the next job, now running, None where none waits.

        What is no job goes to `failed`, and the next is looked at.
        """
        for path in self._files(self._folder):
            running = self._folder / "running" / path.name
            try:
                path.rename(running)
                text = _read_regular(running)
                return read_job(text, path.name, running)
            except GyrorigError as fault:
                self.refused += 1
                self._end(running, "failed", {"reason": str(fault)})
            except (OSError, ValueError) as fault:
                self.refused += 1
                words = getattr(fault, "strerror", None) or fault
                remedy = "let the daemon's group read it, and hand it in again"
                self._end(running, "failed", {"reason": f"it cannot be read, {words}: {remedy}"})
        return None

    def finish(self, job: Job, done: bool, result: Mapping[str, Any]) -> None:
        """Put a job aside with what became of it."""
        if job.path is not None:
            self._end(job.path, "done" if done else "failed", result)

    def give_back(self, job: Job) -> None:
        """Let a job wait again: nothing of it was done."""
        if job.path is not None:
            with contextlib.suppress(OSError):
                job.path.rename(self._folder / job.path.name)

    def _end(self, path: Path, folder: str, result: Mapping[str, Any]) -> None:
        there = self._folder / folder
        document = {"schema": "gyrorig/job-result/1", "job": path.stem, "result": folder, **result}
        with contextlib.suppress(OSError):  # a full disk: the job is put aside if that much works
            write_whole(there / f"{path.stem}.result.json", json.dumps(document).encode())
        with contextlib.suppress(OSError):
            path.rename(there / path.name)
        self._thin_out(there)

    def _thin_out(self, folder: Path) -> None:
        files = self._files(folder)
        for path in files[: max(0, len(files) - KEPT_RESULTS)]:
            with contextlib.suppress(OSError):
                path.unlink()
                path.with_name(f"{path.stem}.result.json").unlink(missing_ok=True)

    @staticmethod
    def _files(folder: Path) -> list[Path]:
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
    """Return a file's bytes; no pipe, device or link is opened, and nothing large is read.

    Raises:
        UsageError: it is one of these.
        OSError: it cannot be read.
    """
    handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        status = os.fstat(handle)
        if not stat.S_ISREG(status.st_mode):
            raise UsageError(
                f"{path.name} is no regular file", "hand a program in with `gyrorigd enqueue`"
            )
        if status.st_size > MAX_JOB_BYTES:
            raise UsageError(
                f"{path.name} is larger than 1 MB, and no job is",
                "hand a program in with `gyrorigd enqueue`",
            )
        data = bytearray()
        while piece := os.read(handle, MAX_JOB_BYTES + 1 - len(data)):
            data += piece
        return bytes(data)
    finally:
        os.close(handle)
