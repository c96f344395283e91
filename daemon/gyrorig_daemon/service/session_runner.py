"""Runs one job: holds its session, handles its faults, and archives it.

What to use when: `SessionRunner.run_job` from the main loop, when nothing blocks a session. It
returns with the unit halted and the recording closed, whatever has happened. Meanwhile other
parts of the service read `ServiceState`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gyrorig_daemon.links.ports.port_hub import PortsGoneError
from gyrorig_daemon.links.pump import StopRequestedError
from gyrorig_daemon.recorder import Recorder
from gyrorig_daemon.service.experiment import RoundOutcome
from gyrorig_daemon.service.jobs import SessionJob
from gyrorig_daemon.service.persistent_state import MotionLock
from gyrorig_daemon.service.recording_policy import recorder_settings
from gyrorig_daemon.service.service_context import ServiceContext
from gyrorig_daemon.service.unit_monitor import UnitMonitor
from gyrorig_daemon.session.connected_rig import Rig
from gyrorig_daemon.session.session import Session
from gyrorig_daemon.session.session_description import SessionRequest
from gyrorig_daemon.session.session_environment import SessionEnvironment
from gyrorig_protocol.errors import DeviceError, GyrorigError, UsageError, sentence

MIN_AFTERMATH_S = 5.0
CLOSE_TIMEOUT_S = 12.0  # with 10 s for the halt, within the 30 s of systemd
STEPS_UNCERTAIN = (
    "the pan-tilt unit may have lost steps. Remove all objects from its range of motion, and "
    "enqueue the job with --home"
)


@dataclass(frozen=True, slots=True)
class StatusSummary:
    """Summary of what the main loop is doing."""

    state: str  # starting, waiting, ready, running, explaining, fault
    reason: str = ""
    session: dict[str, Any] | None = None


@dataclass(slots=True)
class ServiceState:
    """The present state of the service, for status and metrics."""

    summary: StatusSummary
    session: Session | None = None
    last_session: dict[str, Any] | None = None  # result of the last session
    # progress of the experiment that is running, None without one
    experiment: Callable[[], dict[str, Any] | None] = lambda: None
    motion_start_s: float = 0.0  # start of the first step, monotonic
    step_start_s: float = 0.0


@dataclass(frozen=True, slots=True)
class SessionOutcome:
    """Result of a session: done, failed, stopped, or waits if it was not started."""

    result: str
    reason: str
    recording: Path | None


class SessionRunner:
    """Runs one job after another on one rig."""

    def __init__(
        self,
        rig: Rig,
        context: ServiceContext,
        unit_monitor: UnitMonitor,
        state: ServiceState,
        end_round: Callable[[RoundOutcome], None],
    ) -> None:
        """Prepare.

        Args:
            rig: an opened rig.
            context: what outlives the rig.
            unit_monitor: of the rig.
            state: for the status.
            end_round: takes the outcome of a session that is a round of an experiment.
        """
        self._end_round = end_round
        self._rig = rig
        self._pump = rig.pump
        self._context = context
        self._unit_monitor = unit_monitor
        self._state = state

    def run_job(self, job: SessionJob) -> None:
        """Hold one session and archive the job.

        Raises:
            StopRequestedError: the process must end; the job is archived before.
            PortsGoneError: the acquisition process has ended; the job is archived before.
        """
        start_utc_s = self._context.clocks.utc_s()
        home = job.home or (
            not self._context.persistent.steps_are_sure and self._rig.config.ptu.home_without_asking
        )
        if not self._context.persistent.steps_are_sure and not home:
            is_scheduled = job.path is None and not job.is_round
            result = "waits" if is_scheduled else "failed"
            self._archive_job(job, SessionOutcome(result, STEPS_UNCERTAIN, None), start_utc_s)
            return
        session = self._open_session(job, home)
        outcome = SessionOutcome("failed", "the daemon ended while the session was running", None)
        try:
            is_scheduled = job.path is None and not job.is_round
            outcome = self._run_session(session, is_scheduled)
        except PortsGoneError as error:
            outcome = SessionOutcome("failed", str(error), session.recorder.path)
            raise
        finally:
            for board in self._rig.boards:
                board.unpin_identity()
            self._context.recorder_totals.add_closed(session.recorder.counts.values())
            self._context.housekeeping.recorder = None
            self._state.session = None
            self._pump.obey_stop()
            self._unit_monitor.end_session(home and outcome.result == "done", session.facts)
            self._archive_job(job, outcome, start_utc_s, session.recorder)
        if self._context.requests.terminate.is_set():
            raise StopRequestedError("the process must end")

    def lock_motion(self, reason: str) -> None:
        """Lock motion until a person releases the lock; store a loss of steps with it."""
        persistent = self._context.persistent
        motion_lock = persistent.motion_lock
        if motion_lock is None:
            motion_lock = MotionLock(reason, self._context.clocks.utc_s())
        persistent.store(motion_lock, self._are_steps_sure())

    def _open_session(self, job: SessionJob, home: bool) -> Session:
        rig, context = self._rig, self._context
        rig.capture.copy_anchor(context.clocks.anchor())
        request = SessionRequest(
            config=rig.config,
            config_text=context.config_text,
            program=job.program,
            program_text=job.program_text,
            out_dir=context.state_folder.recordings,
            session=job.session,
            home=home,
            limit_s=job.limit_s,
        )
        environment = SessionEnvironment(
            capture=rig.capture,
            read_host=context.clocks.read_host,
            threaded_writer=context.threaded_writer,
            host=context.host,
            dropped_bytes=context.dropped_bytes,
            stop=rig.stop,
            progress=self._update_progress,
            new_recorder=self._new_recorder,
            close_timeout_s=CLOSE_TIMEOUT_S,
        )
        self._unit_monitor.begin_session()
        boards = [board for board in rig.boards if board.is_known]
        session = Session(rig, request, environment, boards)
        self._state.session = session
        summary = {"job": job.name, "session": job.session, "program": job.program.name}
        self._state.summary = StatusSummary("running", session=summary)
        context.log(f"Session {job.session} starts ({job.program.name}).")
        return session

    def _new_recorder(self) -> Recorder:
        settings = recorder_settings(self._rig.config.service)
        housekeeping = self._context.housekeeping
        housekeeping.recorder = Recorder(
            self._context.threaded_writer,
            settings,
            housekeeping.free_space,
            view=self._context.view,
        )
        return housekeeping.recorder

    def _run_session(self, session: Session, is_scheduled: bool) -> SessionOutcome:
        is_prepared = False
        motion_start_s = self._context.clocks.monotonic_s()
        try:
            session.prepare()
            is_prepared, motion_start_s = True, self._context.clocks.monotonic_s()
            session.run_program()
            path = session.finish()
        except StopRequestedError as request:
            return self._handle_stop(session, str(request))
        except PortsGoneError as error:
            session.abort_and_close(error.problem, can_halt=False)
            raise
        except DeviceError as error:
            if not is_prepared:
                return self._handle_refusal(session, error, is_scheduled)
            spent_s = self._context.clocks.monotonic_s() - motion_start_s
            problems = self._record_aftermath(session, error, session.planned_s - spent_s)
            return SessionOutcome("failed", _join(str(error), *problems), session.recorder.path)
        except GyrorigError as error:
            return self._handle_refusal(session, error, is_scheduled)
        except BaseException as error:
            session.abort_and_close(f"{type(error).__name__}: {error}")
            raise
        return _judge(session, path)

    def _handle_stop(self, session: Session, reason: str) -> SessionOutcome:
        """End a session on request; an operator's halt locks motion before the recording closes."""
        self._pump.ignore_stop()
        problems = session.abort(reason)
        must_end = self._context.requests.acknowledge_stop()
        if not must_end:
            self.lock_motion(reason)
        self._close_early(session)
        if must_end and session.recorder.path is None:
            return SessionOutcome("waits", reason, None)
        return SessionOutcome("stopped", _join(reason, *problems), session.recorder.path)

    def _handle_refusal(
        self, session: Session, fault: GyrorigError, is_scheduled: bool
    ) -> SessionOutcome:
        """End a session that has not reached its motion; decide whether it is tried again."""
        self._pump.ignore_stop()
        problems = session.abort(fault.problem)
        self._close_early(session)
        can_retry = is_scheduled and not isinstance(fault, UsageError)
        can_retry = can_retry or (isinstance(fault, DeviceError) and self._rig.driver.is_port_gone)
        if can_retry and session.recorder.path is None:
            return SessionOutcome("waits", fault.problem, None)
        return SessionOutcome("failed", _join(str(fault), *problems), session.recorder.path)

    def _close_early(self, session: Session) -> None:
        """Close the recording of a halted session; store a loss of steps before that."""
        self._context.persistent.steps_are_sure = self._are_steps_sure()
        session.close_partial()

    def _are_steps_sure(self) -> bool:
        return self._context.persistent.steps_are_sure and not self._unit_monitor.has_lost_steps

    def _record_aftermath(
        self, session: Session, fault: DeviceError, planned_s: float
    ) -> list[str]:
        """Halt after a motion fault, and continue the recording for a while."""
        self._context.counts.motion_faults += 1
        self._pump.ignore_stop()
        problems = session.abort(fault.problem)
        self._context.requests.clear.clear()  # an earlier request does not apply to this fault
        self.lock_motion(fault.problem)
        limit_s = self._rig.config.service.aftermath_s
        aftermath_s = min(max(planned_s, MIN_AFTERMATH_S), limit_s)
        session.note(f"motion has ended; the recording continues for {aftermath_s:.0f} s")
        reason = f"{fault.problem}; the recording continues"
        self._state.summary = StatusSummary("fault", reason, self._state.summary.session)
        self._pump.obey_stop()
        try:
            self._pump.run_until(
                self._pump.now_ns() + int(aftermath_s * 1e9), self._context.requests.clear.is_set
            )
        except StopRequestedError:
            self._context.requests.acknowledge_stop()  # halted already
        finally:
            self._pump.ignore_stop()
            session.close_partial()
        return problems

    def _archive_job(
        self,
        job: SessionJob,
        outcome: SessionOutcome,
        start_utc_s: float,
        recorder: Recorder | None = None,
    ) -> None:
        parts = () if recorder is None else recorder.paths
        if outcome.result == "waits":
            self._postpone(job, outcome.reason)
            return
        counts = self._context.counts
        name = f"sessions_{outcome.result}"
        setattr(counts, name, getattr(counts, name) + 1)
        document = {
            "session": job.session,
            "program": job.program.name,
            "reason": outcome.reason,
            "recording": None if outcome.recording is None else str(outcome.recording),
            "parts": [path.name for path in parts],
            "messages_lost": 0 if recorder is None else recorder.counts.lost,
            "begun_utc_s": round(start_utc_s, 3),
            "ended_utc_s": round(self._context.clocks.utc_s(), 3),
        }
        if not job.is_round:
            self._context.queue.finish(job, outcome.result == "done", document)
        self._state.last_session = {"job": job.name, "result": outcome.result, **document}
        reason_text = f": {outcome.reason}" if outcome.reason else ""
        self._context.log(sentence(f"Session {job.session} {outcome.result}{reason_text}"))
        if job.is_round:
            self._end_round(RoundOutcome(outcome.result, outcome.reason, tuple(parts)))

    def _postpone(self, job: SessionJob, reason: str) -> None:
        """Try a session again that was not started."""
        context, delay_text = self._context, ""
        if job.is_round:
            self._end_round(RoundOutcome("waits", reason, ()))
        elif job.path is None:
            wait_s = context.schedule.postpone(job.name, context.clocks.monotonic_s())
            delay_text = "" if wait_s is None else f" for at least {wait_s:.0f} s"
        else:
            context.queue.requeue(job)
        context.counts.sessions_put_off += 1
        context.log(
            f"Session {job.session} could not start and waits{delay_text}. {sentence(reason)}"
        )

    def _update_progress(self, step: int, total: int) -> None:
        if self._state.summary.session is not None:
            now_s = self._context.clocks.monotonic_s()
            if step == 0:
                self._state.motion_start_s = now_s
            self._state.step_start_s = now_s
            self._state.summary.session.update(step=step, steps=total)


def _judge(session: Session, path: Path) -> SessionOutcome:
    """Return the outcome of a session whose program has ended."""
    counts = session.recorder.counts
    if counts.refused and counts.refused >= counts.written:
        reason = (
            f"the recorder refused {counts.refused} messages and wrote {counts.written}. Check "
            "the clock of the computer, and enqueue the job again"
        )
        return SessionOutcome("failed", reason, path)
    lost_boards = [str(board.board_id) for board in session.boards if not board.is_known]
    return SessionOutcome(
        "done",
        f"board {', '.join(lost_boards)} was missing at the end" if lost_boards else "",
        path,
    )


def _join(*texts: str) -> str:
    return " ".join(sentence(text) for text in texts)
