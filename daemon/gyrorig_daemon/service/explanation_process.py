"""The solver as a child process: `gyrorig explain` on the recordings of an experiment.

The daemon never imports the solver: it starts the program and reads the JSON that it prints.

What to use when: start an `ExplanationProcess`, call `poll` now and then, and `close` it in any
case. The child is limited in memory, processor time and the size of its files, has the lowest
priority, and is the first process that the kernel ends if the memory of the computer is full. A
child that survives the daemon ends by its limit of processor time.
"""

import contextlib
import os
import resource
import signal
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import msgspec

from gyrorig_daemon.service.jobs import MAX_JOB_BYTES
from gyrorig_protocol.child_process import module_command
from gyrorig_protocol.errors import MachineError, UsageError

# `gyrorig explain` of 4 recordings of 130 s needs 0.6 GB of addresses (VmPeak)
MEMORY_BYTES = 2 * 2**30
FILE_BYTES = 256 * 2**20  # of each file that it writes
MAX_REPORT_BYTES = 16 * 2**20
MAX_REASON_CHARACTERS = 500
KILL_AFTER_S = 5  # processor time above the limit
NICENESS = 19
OOM_SCORE_ADJUSTMENT = 500  # the unit of the daemon has -500
END_TIMEOUT_S = 5.0
# Exit codes of `gyrorig explain` with findings: all boards, nothing testable, some boards
CODES_WITH_FINDINGS = (0, 4, 5)
SOLVER_PACKAGES = ("gyrorig_solver", "scipy", "jinja2")
_THREAD_VARIABLES = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


class ExplainedCause(msgspec.Struct, frozen=True):
    """One cause of the findings, with the others of its set."""

    cause: str
    where: str = ""
    one_of: tuple[str, ...] = ()


class ProposedExperiment(msgspec.Struct, frozen=True):
    """The motion program that the solver proposes."""

    program: str | None = None  # its file, beside the findings; None: no program helps
    seconds: float | None = None


class StatedFindings(msgspec.Struct, frozen=True):
    """The part of the findings that an experiment needs."""

    verdict: str
    causes: tuple[ExplainedCause, ...] = ()
    next_experiment: ProposedExperiment | None = None


class ExplainedBoard(msgspec.Struct, frozen=True):
    """The findings of one board."""

    board: str
    file: str
    findings: StatedFindings

    def proposal(self) -> "Proposal | None":
        """Return the proposed program, None if there is none."""
        proposed = self.findings.next_experiment
        if proposed is None or proposed.program is None:
            return None
        path = Path(self.file).with_name(Path(proposed.program).name)
        return Proposal(path, proposed.seconds or 0.0)


@dataclass(frozen=True, slots=True)
class Proposal:
    """A proposed motion program."""

    path: Path
    seconds: float


class FailedBoard(msgspec.Struct, frozen=True):
    """A board or recording that could not be explained."""

    recording: str = ""
    board: str = ""
    error: str = ""


class ExplanationReport(msgspec.Struct, frozen=True):
    """The output of `gyrorig explain --json`."""

    boards: tuple[ExplainedBoard, ...]
    failed: tuple[FailedBoard, ...] = ()


class ExplanationProcess:
    """One run of `gyrorig explain`."""

    def __init__(
        self,
        recordings: Sequence[Path],
        folder: Path,
        limits_text: bytes,
        next_seconds: float,
        limit_s: float,
    ) -> None:
        """Start the child.

        Args:
            recordings: of all rounds.
            folder: a new folder for the findings and the output.
            limits_text: a rig file whose limits the proposed program keeps; empty: those that the
                unit reported.
            next_seconds: longest program to propose; 0: propose none.
            limit_s: of the processor time.

        Raises:
            MachineError: the folder cannot be written, or the child cannot be started.
        """
        self.folder = folder
        self._report_path, self._log_path = folder / "explain.json", folder / "explain.log"
        rig_path = folder / "rig.yaml"
        command = module_command("gyrorig_solver", "explain", "--json", "--out", str(folder))
        command += ["--next-seconds", f"{next_seconds:.0f}"]
        command += ["--rig", str(rig_path)] if limits_text else []
        command += ["--", *map(str, recordings)]
        environment = {**os.environ, **dict.fromkeys(_THREAD_VARIABLES, "1")}
        try:
            folder.mkdir(parents=True, mode=0o750)
            if limits_text:
                rig_path.write_bytes(limits_text)
            with self._report_path.open("wb") as report, self._log_path.open("wb") as log:
                self._process = subprocess.Popen(  # noqa: S603 - our own program
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=report,
                    stderr=log,
                    env=environment,
                    start_new_session=True,
                )
        except OSError as error:
            raise MachineError(
                f"the recordings cannot be explained, because the solver cannot be started in "
                f"{folder} ({error.strerror})",
                "free disk space and memory, then enqueue the experiment again",
            ) from error
        self._limit(limit_s)

    def poll(self) -> bool:
        """Return whether the child has ended."""
        return self._process.poll() is not None

    def report(self) -> ExplanationReport:
        """Return the findings of a child that has ended.

        Raises:
            MachineError: the solver failed, or what it printed is not a report.
        """
        code = self._process.wait()
        if code not in CODES_WITH_FINDINGS:
            raise MachineError(
                f"the recordings could not be explained: {self._failure_reason(code)}",
                f"run `gyrorig explain` with the recordings, or read {self._log_path}",
            )
        try:
            return msgspec.json.decode(
                _read_limited(self._report_path, MAX_REPORT_BYTES), type=ExplanationReport
            )
        except (OSError, ValueError) as error:
            raise MachineError(
                f"the output of the solver cannot be read ({error})",
                "install the same version of the daemon and of the solver",
            ) from error

    def close(self) -> None:
        """End the child, and everything that it has started."""
        if self._process.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(END_TIMEOUT_S)

    def _limit(self, limit_s: float) -> None:
        """Limit the child; it can have ended already."""
        pid, seconds = self._process.pid, max(1, round(limit_s))
        limits = {
            resource.RLIMIT_AS: MEMORY_BYTES,
            resource.RLIMIT_CPU: seconds,
            resource.RLIMIT_FSIZE: FILE_BYTES,
            resource.RLIMIT_CORE: 0,
        }
        with contextlib.suppress(ProcessLookupError):
            for kind, value in limits.items():
                # The soft limit of time ends the child with a signal that tells the reason.
                hard = value + KILL_AFTER_S if kind == resource.RLIMIT_CPU else value
                resource.prlimit(pid, kind, (value, hard))
        with contextlib.suppress(OSError):  # a filter of system calls can forbid it
            os.setpriority(os.PRIO_PROCESS, pid, NICENESS)
        with contextlib.suppress(OSError):
            Path(f"/proc/{pid}/oom_score_adj").write_text(str(OOM_SCORE_ADJUSTMENT))

    def _failure_reason(self, code: int) -> str:
        if code == -signal.SIGXCPU:
            return "it took longer than permitted"
        if code < 0:
            return f"the solver was ended by signal {-code}"
        text = ""
        with contextlib.suppress(OSError):
            text = _read_limited(self._log_path, MAX_REPORT_BYTES).decode("utf-8", "replace")
        last_line = text.strip().rpartition("\n")[2].removeprefix("gyrorig: ")
        printable = "".join(c for c in last_line if c.isprintable())
        return printable[:MAX_REASON_CHARACTERS] or f"the solver ended with status {code}"


def require_solver() -> None:
    """Check that the solver is installed; nothing of it is imported.

    Raises:
        UsageError: it is not.
    """
    if any(find_spec(name) is None for name in SOLVER_PACKAGES):
        raise UsageError(
            "the solver is not installed with the daemon, and an experiment needs it",
            "run `pip install 'gyrorig[solver]'`",
        )


def read_program(path: Path) -> bytes:
    """Return the text of a proposed program.

    Raises:
        MachineError: it cannot be read.
    """
    try:
        return _read_limited(path, MAX_JOB_BYTES)
    except (OSError, ValueError) as error:
        raise MachineError(
            f"the proposed motion program {path} cannot be read ({error})",
            "run `gyrorig explain` with the recordings",
        ) from error


def _read_limited(path: Path, limit_bytes: int) -> bytes:
    """Return the bytes of a file.

    Raises:
        OSError: it cannot be read.
        ValueError: it is too large.
    """
    with path.open("rb") as file:
        data = file.read(limit_bytes + 1)
    if len(data) > limit_bytes:
        raise ValueError(f"it has more than {limit_bytes} bytes")
    return data
