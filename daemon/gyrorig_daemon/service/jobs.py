"""Jobs of the queue: their documents, and how to add one.

What to use when: `enqueue_job` to add a job, `parse_job` to read its file. A job with `until_named`
is an experiment: `experiment` adds further sessions until the cause of the errors has a name.
"""

import re
import secrets
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from gyrorig_daemon.service.state_folder import apply_umask
from gyrorig_protocol.atomic_files import write_atomically
from gyrorig_protocol.documents import convert_document, dump_yaml, parse_yaml
from gyrorig_protocol.errors import InputError, MachineError, UsageError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.program import MotionProgram, Step, parse_program

SCHEMA = "gyrorig/job/1"
# The main loop reads and plans a job, and may be late by at most 3 s: then the acquisition process
# halts the unit. Measured on a computer of 2026: 952 kB take 3.75 s to read, 100,000 steps 1.9 s
# to plan. The limits leave room for a computer that is four times slower.
MAX_JOB_BYTES = 64_000
MAX_JOB_STEPS = 20_000  # with all repeats
JOB_MODE = 0o660
DEFAULT_MINUTES = 30.0
MAX_MINUTES = 1_440.0
MAX_ROUNDS = 20

# C0 and C1 controls, and the separators of lines and paragraphs: a log or a terminal obeys them
_CONTROLS = re.compile(r"[\x00-\x1f\x7f-\x9f\u2028\u2029]")

ProgramText = Annotated[str, msgspec.Meta(max_length=MAX_JOB_BYTES)]


class UntilNamed(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Limits of an experiment: it records and explains until the cause has one name."""

    # From the start of the first session. No session begins that would end later.
    minutes: Annotated[float, msgspec.Meta(ge=1.0, le=MAX_MINUTES)] = DEFAULT_MINUTES
    # Number of sessions, including the first one.
    rounds: Annotated[int, msgspec.Meta(ge=1, le=MAX_ROUNDS)] = 5
    # Longest motion program that the solver may propose, as `gyrorig explain --next-seconds`.
    next_seconds: Annotated[float, msgspec.Meta(ge=1.0, le=3_600.0)] = 120.0


class JobDocument(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The content of a job file."""

    program: ProgramText  # a whole `gyrorig/program/1` document, as text
    schema: Literal["gyrorig/job/1"] = "gyrorig/job/1"
    session: str | None = None
    home: bool = False
    until_named: UntilNamed | None = None


@dataclass(frozen=True, slots=True)
class SessionJob:
    """A session that is to run."""

    name: str
    program: MotionProgram
    program_text: bytes
    session: str
    home: bool
    path: Path | None = None  # in the queue; None: from the schedule, or a round
    until_named: UntilNamed | None = None
    is_round: bool = False  # of an experiment, which archives its job itself
    limit_s: float | None = None  # that the program may last


def enqueue_job(
    queue: Path,
    program_text: bytes,
    name: str,
    session: str | None = None,
    home: bool = False,
    until_named: UntilNamed | None = None,
) -> Path:
    """Add a job to the queue; return its file.

    Args:
        queue: the folder.
        program_text: the program document.
        name: name of the program in error messages.
        session: name of the session in the recording; random if it is None.
        home: home the unit first.
        until_named: make the job an experiment.

    Raises:
        UsageError: the program or the session name is invalid.
        MachineError: the file cannot be written.
    """
    program = parse_safe_program(program_text, name)
    validate_session_name(session)
    program_source = _decode_program(program_text, name)
    document: dict[str, Any] = {"schema": SCHEMA, "program": program_source, "home": home}
    if session is not None:
        document["session"] = session
    if until_named is not None:
        document["until_named"] = msgspec.to_builtins(until_named)
    stem = "".join(c if c.isalnum() else "-" for c in program.name)[:32].strip("-") or "job"
    submitted_at = datetime.now(UTC)
    job_text = dump_yaml(document).encode()
    _check_size(job_text, name)
    path = queue / f"{submitted_at:%Y%m%dT%H%M%S%f}Z-{secrets.token_hex(2)}-{stem}.yaml"
    try:
        write_atomically(path, job_text, mode=apply_umask(JOB_MODE))
    except OSError as error:
        raise MachineError(
            f"the job cannot be written to the queue {queue} ({error.strerror})",
            "give the folder of the daemon with --state, or join the daemon's group, whose "
            "members can write to the queue",
        ) from error
    return path


def _decode_program(text: bytes, name: str) -> str:
    """Return the text of a program; YAML also permits UTF-16, which it cannot be."""
    try:
        return text.decode("utf-8")
    except UnicodeDecodeError as error:
        raise UsageError(
            f"the motion program {name} is not a text in UTF-8", "save the file as UTF-8"
        ) from error


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


def parse_safe_program(text: bytes, name: str) -> MotionProgram:
    """Return a program that the main loop can plan in time, and whose name can be logged.

    Raises:
        UsageError: the program is invalid or too long, or its name has control characters.
    """
    _check_size(text, name)
    program = parse_program(text, name)
    steps = _count_steps(program.steps)
    if steps > MAX_JOB_STEPS:
        raise UsageError(
            f"the motion program {name} has {steps} steps with all repeats, and the daemon takes "
            f"at most {MAX_JOB_STEPS}",
            "divide the program into several jobs",
        )
    if _CONTROLS.search(program.name):
        raise UsageError(
            f"the name in the motion program {name} has control characters",
            "write a name of letters, digits, spaces and dashes",
        )
    return program


def _check_size(text: bytes, name: str) -> None:
    if len(text) > MAX_JOB_BYTES:
        raise UsageError(
            f"{name} makes a job that is too long, because the daemon takes at most "
            f"{MAX_JOB_BYTES} bytes",
            "write repeated steps with `repeat`, or divide the program into several jobs",
        )


def _count_steps(steps: tuple[Step, ...]) -> int:
    """Return the number of steps with all repeats."""
    return sum(
        1 if step.repeat is None else step.repeat.times * _count_steps(step.repeat.steps)
        for step in steps
    )


def parse_job(text: bytes, name: str, path: Path | None = None) -> SessionJob:
    """Return the job that a document describes.

    Raises:
        UsageError: the document is not a valid job.
    """
    _check_size(text, name)
    document = parse_yaml(text, name, schema=SCHEMA)
    if isinstance(document, dict) and str(document.get("schema", "")) != SCHEMA:
        job_document = JobDocument(program=_decode_program(text, name))
    else:
        job_document = convert_document(document, JobDocument, name)
    validate_session_name(job_document.session)
    program_text = job_document.program.encode()
    program = parse_safe_program(program_text, name)
    session = job_document.session or secrets.token_hex(4)
    return SessionJob(
        Path(name).stem,
        program,
        program_text,
        session,
        job_document.home,
        path,
        job_document.until_named,
    )
