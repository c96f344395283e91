"""Experiment: record, explain, record what the solver proposes, until the cause has one name.

What to use when: one `Experiment` per opened rig. `begin` takes a job with `until_named`, and
`next_round` gives the sessions one after the other. `end_round` takes the outcome of each session,
and `watch` looks after the solver between them.

Theory of operation. The job stays in `queue/running` until the experiment ends, so an experiment
that a crash interrupts is not repeated. Each round is a session of the rig with all its checks, and
one run of `gyrorig explain` on the recordings of all rounds. While an experiment runs, no other
session starts. It ends if

    every stated cause has one name, or none is stated     done
    no program separates the causes                        done
    the rounds or the minutes are used                     done
    a session fails, is halted, or the solver fails        failed
    the unit is locked, or the rig is opened again         failed

The time is bounded: no session begins that would end after the minutes, and the last run of the
solver ends at most `GRACE_S` later.
"""

import contextlib
import itertools
import os
import shutil
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import msgspec

from gyrorig_daemon.config import EMULATED, RigConfig
from gyrorig_daemon.config.rig_document import SCHEMA as RIG_SCHEMA
from gyrorig_daemon.config.rig_document import CommandLimits
from gyrorig_daemon.service.explanation_process import (
    ExplainedBoard,
    ExplanationProcess,
    ExplanationReport,
    read_program,
    require_solver,
)
from gyrorig_daemon.service.jobs import SessionJob, UntilNamed, parse_safe_program
from gyrorig_daemon.service.service_context import ServiceContext
from gyrorig_protocol.documents import dump_yaml
from gyrorig_protocol.errors import GyrorigError, UsageError, sentence

PREPARATION_S = 15.0  # of a session: the unit and the boards are identified
GRACE_S = 600.0  # for the last run of the solver, after the minutes
MAX_KEPT_FOLDERS = 50  # the results of the queue name them; older ones are deleted
MAX_SESSION_NAME = 32  # characters


@dataclass(frozen=True, slots=True)
class RoundOutcome:
    """Result of the session of a round, as of every session."""

    result: str  # done, failed, stopped or waits
    reason: str
    parts: tuple[Path, ...]


@dataclass(slots=True)
class _Progress:
    """The experiment that is running."""

    job: SessionJob
    limits: UntilNamed
    folder: Path
    begin_s: float  # monotonic
    begin_utc_s: float
    next_job: SessionJob | None
    round: int = 1
    recordings: list[Path] = field(default_factory=list)
    process: ExplanationProcess | None = None
    boards: tuple[ExplainedBoard, ...] = ()  # findings of the last explanation
    rounds: list[dict[str, Any]] = field(default_factory=list)

    @property
    def deadline_s(self) -> float:
        return self.begin_s + 60.0 * self.limits.minutes


class Experiment:
    """The experiment that is running on an opened rig, if any."""

    def __init__(self, config: RigConfig, context: ServiceContext) -> None:
        self._config = config
        self._context = context
        self._progress: _Progress | None = None

    @property
    def is_active(self) -> bool:
        """Whether an experiment is running; then no other session starts."""
        return self._progress is not None

    def begin(self, job: SessionJob) -> None:
        """Start the experiment of a job; one that is not permitted is archived at once."""
        clocks = self._context.clocks
        limits = job.until_named or UntilNamed()
        self._progress = _Progress(
            job,
            limits,
            _unused_folder(self._context.state_folder.experiments / job.name),
            clocks.monotonic_s(),
            clocks.utc_s(),
            replace(job, path=None, is_round=True),
        )
        try:
            self._check_permission()
            require_solver()
            self._delete_old_folders()
        except GyrorigError as error:
            self._end("failed", str(error))
            return
        self._context.log(
            f"Experiment {job.name} starts: at most {limits.minutes:g} min and {limits.rounds} "
            "sessions."
        )

    def next_round(self) -> SessionJob | None:
        """Return the session that is to run now; None while the solver runs."""
        progress = self._progress
        if progress is None or progress.next_job is None:
            return None
        remaining_s = progress.deadline_s - self._context.clocks.monotonic_s()
        return replace(progress.next_job, limit_s=max(remaining_s, 0.0))

    def end_round(self, outcome: RoundOutcome) -> None:
        """Take the outcome of the session, and start the solver."""
        progress = self._progress
        if progress is None:
            return
        if outcome.result == "waits":
            if not progress.recordings:  # nothing has been recorded: the job waits in the queue
                self._context.queue.requeue(progress.job)
                self._progress = None
            return
        progress.recordings += outcome.parts
        progress.rounds.append({"recordings": [str(path) for path in outcome.parts]})
        if outcome.result != "done":
            self._end("failed", f"round {progress.round}: {outcome.reason}")
            return
        self._context.housekeeping.protected = tuple(progress.recordings)
        progress.next_job = None
        self._start_solver(progress)

    def watch(self, waiting_reason: str) -> None:
        """Look after the solver and the time; call it whenever no session is running.

        Args:
            waiting_reason: why no session can start now, "" if one can.
        """
        progress = self._progress
        if progress is None:
            return
        now_s = self._context.clocks.monotonic_s()
        if progress.process is not None:
            if progress.process.poll():
                self._take_report(progress, progress.process)
            elif now_s > progress.deadline_s + GRACE_S:
                self._end("failed", "the solver did not end in time. Allow more minutes")
        elif now_s > progress.deadline_s:
            result = "done" if progress.recordings else "failed"
            waited = f", and {waiting_reason}" if waiting_reason else ""
            self._end(result, f"the {progress.limits.minutes:g} min are used{waited}", "budget")

    def abandon(self, reason: str) -> None:
        """End the experiment because of a halt, a fault, or the end of the service."""
        if self._progress is not None:
            self._end("failed", f"the experiment was interrupted: {reason}")

    def status(self) -> dict[str, Any] | None:
        """Return the progress for the status, None without an experiment."""
        progress = self._progress
        if progress is None:
            return None
        used_s = self._context.clocks.monotonic_s() - progress.begin_s
        return {
            "job": progress.job.name,
            "step": "recording" if progress.process is None else "explaining",
            "round": progress.round,
            "rounds": progress.limits.rounds,
            "used_s": round(used_s, 1),
            "limit_s": 60.0 * progress.limits.minutes,
            "recordings": len(progress.recordings),
            "causes": _stated_causes(progress.boards),
        }

    def _check_permission(self) -> None:
        """Check that programs of the solver may move this unit.

        Raises:
            UsageError: it is a real unit, and the rig file does not permit it.
        """
        is_emulated = self._config.ptu.port == EMULATED
        if not is_emulated and not self._config.service.run_proposed_programs:
            raise UsageError(
                "the rig file does not permit motion programs that the solver proposes",
                "make sure that nothing is in the range of motion, then set "
                "`run_proposed_programs: true` under `service`",
            )

    def _delete_old_folders(self) -> None:
        """Delete the findings of the oldest experiments."""
        root = self._context.state_folder.experiments
        with contextlib.suppress(OSError):
            folders = sorted(path for path in root.iterdir() if path.is_dir())
            for folder in folders[: max(0, len(folders) - MAX_KEPT_FOLDERS + 1)]:
                shutil.rmtree(folder, ignore_errors=True)

    def _start_solver(self, progress: _Progress) -> None:
        remaining_s = progress.deadline_s - self._context.clocks.monotonic_s()
        is_last = progress.round >= progress.limits.rounds
        longest_s = min(progress.limits.next_seconds, remaining_s - PREPARATION_S)
        next_s = 0.0 if is_last else max(longest_s, 0.0)
        try:
            progress.process = ExplanationProcess(
                progress.recordings,
                progress.folder / f"round-{progress.round}",
                limits_document(self._config),
                next_s,
                max(remaining_s, 0.0) + GRACE_S,
            )
        except GyrorigError as error:
            self._end("failed", str(error))
            return
        self._context.log(
            f"Experiment {progress.job.name}: explaining {len(progress.recordings)} recordings."
        )

    def _take_report(self, progress: _Progress, process: ExplanationProcess) -> None:
        """Judge the findings: end, or prepare the next round."""
        progress.process = None
        try:
            report = process.report()
            progress.boards = report.boards
            progress.rounds[-1] |= {
                "findings": [board.file for board in report.boards],
                "causes": _stated_causes(report.boards),
            }
            self._context.log(
                f"Experiment {progress.job.name}, round {progress.round}: "
                f"{_causes_text(report.boards)}."
            )
            self._judge(progress, report)
        except GyrorigError as error:
            self._end("failed", str(error))

    def _judge(self, progress: _Progress, report: ExplanationReport) -> None:
        """End the experiment, or set the next session.

        Raises:
            GyrorigError: the proposed program cannot be used.
        """
        if report.failed:
            failure = report.failed[0]
            self._end("failed", f"{failure.board or failure.recording}: {failure.error}")
            return
        ambiguous = [board for board in report.boards if _has_set(board)]
        if not ambiguous:
            self._end("done", _causes_text(report.boards), _certain_outcome(report.boards))
            return
        if progress.round >= progress.limits.rounds:
            self._end("done", f"the {progress.limits.rounds} sessions are used", "rounds")
            return
        proposals = [proposal for board in ambiguous if (proposal := board.proposal()) is not None]
        next_s = proposals[0].seconds if proposals else progress.limits.next_seconds
        remaining_s = progress.deadline_s - self._context.clocks.monotonic_s()
        if remaining_s < next_s + PREPARATION_S:
            self._end("done", f"the {progress.limits.minutes:g} min are used", "budget")
        elif not proposals:
            text = "no program of the permitted length separates the causes"
            self._end("done", text, "not_separable")
        else:
            self._set_next_round(progress, proposals[0].path)

    def _set_next_round(self, progress: _Progress, path: Path) -> None:
        text = read_program(path)
        program = parse_safe_program(text, path.name)
        progress.round += 1
        suffix = f"-{progress.round}"
        session = progress.job.session[: MAX_SESSION_NAME - len(suffix)] + suffix
        progress.next_job = replace(
            progress.job,
            program=program,
            program_text=text,
            session=session,
            home=False,
            path=None,
            is_round=True,
        )

    def _end(self, result: str, reason: str, outcome: str = "failed") -> None:
        """Archive the job; the child ends, and the recordings are no longer protected."""
        progress, context = self._progress, self._context
        if progress is None:
            return
        self._progress = None
        if progress.process is not None:
            progress.process.close()
        context.housekeeping.protected = ()
        name = f"experiments_{result}"
        setattr(context.counts, name, getattr(context.counts, name) + 1)
        document = {
            "session": progress.job.session,
            "program": progress.job.program.name,
            "reason": sentence(reason),
            "experiment": {
                "outcome": outcome,
                "causes": _stated_causes(progress.boards),
                "rounds": progress.rounds,
            },
            "begun_utc_s": round(progress.begin_utc_s, 3),
            "ended_utc_s": round(context.clocks.utc_s(), 3),
        }
        context.queue.finish(progress.job, result == "done", document)
        context.log(sentence(f"Experiment {progress.job.name} {result}: {reason}"))


def _unused_folder(folder: Path) -> Path:
    """Return a folder that does not exist; an earlier job can have the same name."""
    numbered = (folder.with_name(f"{folder.name}-{number}") for number in itertools.count(2))
    return next(path for path in itertools.chain((folder,), numbered) if not os.path.lexists(path))


def limits_document(config: RigConfig) -> bytes:
    """Return a rig file with the limits of this rig for the solver; empty if there are none.

    The solver reads fewer keys than the daemon, so it does not get the rig file itself.
    """
    unit, emulator = config.ptu, config.emulator
    if unit.limits == CommandLimits():
        return b""
    plain: dict[str, Any] = {
        "schema": RIG_SCHEMA,
        "rig": config.rig,
        "ptu": {
            "port": unit.port,
            "baud": unit.baud,
            "dialect": unit.dialect,
            "pan_sign": unit.pan_sign,
            "tilt_sign": unit.tilt_sign,
            "limits": msgspec.to_builtins(unit.limits),
        },
        "boards": [{"id": str(config.boards[0].id), "port": EMULATED}],
        "emulator": {"dialect": emulator.dialect},
    }
    return dump_yaml(plain).encode()


def _has_set(board: ExplainedBoard) -> bool:
    """Return whether the findings state a set of causes that the data do not separate."""
    return any(cause.one_of for cause in board.findings.causes)


def _certain_outcome(boards: Sequence[ExplainedBoard]) -> str:
    """Return the outcome if no set of causes is left."""
    if any(board.findings.verdict == "unexplained" for board in boards):
        return "unexplained"
    return "named" if any(board.findings.causes for board in boards) else "no_cause"


def _stated_causes(boards: Sequence[ExplainedBoard]) -> list[dict[str, Any]]:
    return [
        {
            "board": board.board,
            "cause": cause.cause,
            "where": cause.where,
            "one_of": list(cause.one_of),
        }
        for board in boards
        for cause in board.findings.causes
    ]


def _causes_text(boards: Sequence[ExplainedBoard]) -> str:
    """Return the stated causes of all boards as one phrase."""
    texts = []
    for board in boards:
        sets = [" or ".join((c.cause, *c.one_of)) for c in board.findings.causes]
        if board.findings.verdict == "unexplained":
            sets.append("a part that no known cause explains")
        texts.append(f"board {board.board}: {', '.join(sets) or 'no cause'}")
    return "; ".join(texts)
