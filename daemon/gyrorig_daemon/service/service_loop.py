"""Main loop of the service on one opened rig: halt, wait until ready, run jobs.

What to use when: `ServiceLoop(rig, context).run()`. It returns when the process must end, or
when the rig must be opened again, for example with another configuration. Everything runs in
the pump's thread, between chunks. Requests from other threads are in `ServiceContext.requests`.

Theory of operation. Between sessions the unit is at standstill, and is polled (`unit_monitor`).
A session starts when there is no `_blocking_reason`: a motion lock, a unit that is not
identified, a system time that no recording can hold, a disk without space, missing boards.
`session_runner` runs it. It ends by

    the end of the program  closed, moved to done
    a rejection before it   a person must correct the job: moved to failed
    a motion fault          halted, recorded for the rest of the planned time, failed, and a
                            motion lock: nothing moves until `gyrorigd clear`
    an operator's halt      halted, closed, and a motion lock
    SIGTERM, SIGINT         halted, closed, and the loop ends

A job with `until_named` is an experiment (`experiment`): its sessions run one after the other, and
no other session starts between them. A halt, a fault and the end of the loop end the experiment.

A motion lock survives the process (`persistent_state`), because a restart does not check the rig.
"""

import time
from enum import Enum

from gyrorig_daemon.links.pump import StopRequestedError
from gyrorig_daemon.recorder import RecorderState
from gyrorig_daemon.service.experiment import Experiment
from gyrorig_daemon.service.jobs import SessionJob, parse_safe_program
from gyrorig_daemon.service.service_context import ServiceContext
from gyrorig_daemon.service.session_runner import ServiceState, SessionRunner, StatusSummary
from gyrorig_daemon.service.status_publisher import StatusPublisher
from gyrorig_daemon.service.system_clock_monitor import SystemClockMonitor, clock_problem
from gyrorig_daemon.service.unit_monitor import UnitMonitor, UnitPresence, send_initial_halt
from gyrorig_daemon.service.watchdog import WatchdogTimer
from gyrorig_daemon.session.connected_rig import Rig
from gyrorig_protocol.errors import DeviceError, GyrorigError, UsageError, sentence

IDLE_PERIOD_NS = 200_000_000
WRITER_STALL_LIMIT_S = 20.0  # longest cycle of the writer's loop
WRITING_STATES = (RecorderState.RECORDING, RecorderState.DEGRADED)


class LoopExit(Enum):
    """Reason why the loop ended."""

    END = "the process must end"
    REOPEN = "the rig must be opened again"


class ServiceLoop:
    """Runs jobs on one opened rig."""

    def __init__(self, rig: Rig, context: ServiceContext) -> None:
        """Prepare; nothing is sent to any device yet.

        Args:
            rig: an opened rig.
            context: what outlives the rig.
        """
        self._rig = rig
        self._pump = rig.pump
        self._context = context
        self._boards_missing_since_s: float | None = None
        self._must_reopen = False
        self.state = ServiceState(StatusSummary("starting"))
        self.unit_monitor = UnitMonitor(rig, context.persistent, context.counts, context.seed)
        self._experiment = Experiment(rig.config, context)
        self.state.experiment = self._experiment.status
        self._runner = SessionRunner(
            rig, context, self.unit_monitor, self.state, self._experiment.end_round
        )
        now_ns = self._pump.now_ns()
        self.clock_monitor = SystemClockMonitor(
            context.clocks.read_host, now_ns, self._record_clock_step
        )
        status_timer = StatusPublisher(
            rig, context, self.state, self.unit_monitor, self.clock_monitor, now_ns
        )
        watchdog_timer = WatchdogTimer(context.notifier, self._stalled_loops, now_ns, context.log)
        for timer in (self.clock_monitor, status_timer, watchdog_timer, _ReloadTimer(self, now_ns)):
            self._pump.add_timer(timer)

    def run(self) -> LoopExit:
        """Serve until the process must end or the rig must be opened again.

        Raises:
            PortsGoneError: the acquisition process has ended; a halt was sent to the unit.
        """
        self._pump.obey_stop()
        send_initial_halt(self._rig)
        next_action = self._announce_ready
        try:
            while True:
                try:
                    next_action()
                    next_action = self._run_once
                    if self._must_reopen and not self._experiment.is_active:
                        return LoopExit.REOPEN
                except StopRequestedError as request:
                    self._experiment.abandon(str(request))
                    if self._context.requests.acknowledge_stop():
                        return LoopExit.END
                    self._handle_operator_halt(str(request))
        except GyrorigError as error:
            self._experiment.abandon(error.problem)
            raise
        finally:
            self._experiment.abandon("the daemon ended")  # only after a fault of the program

    def handle_reload_request(self) -> None:
        """Read the configuration again on request; a valid one takes effect when idle."""
        context = self._context
        if not context.requests.reload.is_set():
            return
        context.requests.reload.clear()
        context.notifier.send_reloading()
        error_text = context.reload_config()
        if error_text:
            context.counts.reloads_refused += 1
            context.log(f"The new configuration was rejected. Reason: {error_text}")
        else:
            context.counts.reloads += 1
            context.log("The configuration is valid and takes effect when no session is running.")
            self._must_reopen = True
        context.notifier.send_ready()

    def _announce_ready(self) -> None:
        """Check the unit, if it is present, and report that the start is complete."""
        self.unit_monitor.poll()
        self._context.notifier.send_ready()
        self._context.log(
            f"Ready. Pan-tilt unit: {self.unit_monitor.reason or self.unit_monitor.state.value}."
        )

    def _run_once(self) -> None:
        """Run one job, or wait for one idle period."""
        if reopen_reason := self._context.reopen_reason():
            self._context.log(f"{sentence(reopen_reason)} It is started again.")
            self._experiment.abandon(reopen_reason)
            self._must_reopen = True
            return
        self._handle_clear_request()
        self.unit_monitor.poll()
        blocking_reason = self._blocking_reason()
        self._watch_experiment(blocking_reason)
        if not blocking_reason:
            job = self._next_job()
            if job is not None:
                self._runner.run_job(job)
                return
        self.state.summary = StatusSummary(self._idle_state(blocking_reason), blocking_reason)
        self._pump.run_until(self._pump.now_ns() + IDLE_PERIOD_NS)

    def _idle_state(self, blocking_reason: str) -> str:
        """Return the state of a service that runs no session."""
        if self._context.persistent.motion_lock:
            return "fault"
        if blocking_reason:
            return "waiting"
        return "explaining" if self._experiment.is_active else "ready"

    def _watch_experiment(self, blocking_reason: str) -> None:
        """Let the experiment go on; a motion lock ends it."""
        motion_lock = self._context.persistent.motion_lock
        if motion_lock is not None:
            self._experiment.abandon(motion_lock.reason)
        self._experiment.watch(blocking_reason)

    def _blocking_reason(self) -> str:
        """Return why no session can start now, "" if one can."""
        motion_lock = self._context.persistent.motion_lock
        if motion_lock is not None:
            return f"{motion_lock.reason}. Check the rig, then run: gyrorigd clear"
        if self.unit_monitor.state is not UnitPresence.STANDS:
            reason = self.unit_monitor.reason or self.unit_monitor.state.value
            return f"pan-tilt unit: {reason}. Check its cable and its power"
        problem = (
            clock_problem(self._context.clocks.utc_s())
            or self._context.housekeeping.storage_problem()
        )
        if problem:
            return problem
        missing = [str(board.board_id) for board in self._rig.boards if not board.is_known]
        if not missing:
            self._boards_missing_since_s = None
            return ""
        if self._boards_missing_since_s is None:
            self._boards_missing_since_s = self._context.clocks.monotonic_s()
        waited_s = self._context.clocks.monotonic_s() - self._boards_missing_since_s
        patience_s = self._rig.config.service.board_patience_s
        if len(missing) < len(self._rig.boards) and waited_s >= patience_s:
            return ""
        return f"no data from board {', '.join(missing)}. Check its cable and its power"

    def _next_job(self) -> SessionJob | None:
        """Return the next job: jobs of the queue before those of the schedule."""
        context, clocks = self._context, self._context.clocks
        if self._experiment.is_active:
            return self._experiment.next_round()
        job = context.queue.take_next()
        if job is not None and job.until_named is not None:
            self._experiment.begin(job)
            return self._experiment.next_round()
        if job is not None:
            return job
        entry = context.schedule.due_entry(clocks.monotonic_s(), clocks.utc_s())
        if entry is None:
            return None
        context.schedule.record_start(entry.name, clocks.monotonic_s(), clocks.utc_s())
        try:
            text = context.read_program(entry.program)
            program = parse_safe_program(text, entry.program)
        except UsageError as error:
            context.counts.sessions_failed += 1
            context.log(f"The session {entry.name} of the schedule is skipped this time. {error}")
            return None
        session = f"{entry.name[:20]}-{int(clocks.utc_s()):x}"[:32]
        return SessionJob(entry.name, program, text, session, entry.home)

    def _record_clock_step(self, step_s: float) -> None:
        self._context.counts.clock_steps += 1
        text = f"the system time was changed by {step_s:+.3f} s"
        self._context.log(text)
        if self.state.session is not None:
            self.state.session.note(text)

    def _handle_clear_request(self) -> None:
        if not self._context.requests.clear.is_set():
            return
        self._context.requests.clear.clear()
        persistent = self._context.persistent
        if persistent.motion_lock is not None:
            self._context.log(f"Motion lock released: {persistent.motion_lock.reason}.")
            persistent.motion_lock = None

    def _handle_operator_halt(self, reason: str) -> None:
        """Halt between sessions, when nothing should be moving."""
        self._pump.ignore_stop()
        try:
            send_initial_halt(self._rig)
            if self._rig.driver.is_identified and not self._rig.driver.is_port_gone:
                self._rig.driver.halt()
        except DeviceError as error:
            self.unit_monitor.mark_lost(UnitPresence.SILENT, error.problem)
        self._pump.obey_stop()
        self._runner.lock_motion(reason)

    def _stalled_loops(self) -> list[str]:
        """Return the loops that make no progress, except the pump's own, which runs this."""
        stalled = self._context.stalled_loops()
        session = self.state.session
        if session is not None and self._context.threaded_writer:
            recorder = session.recorder
            idle_s = (time.monotonic_ns() - recorder.progress_ns) * 1e-9
            if recorder.state in WRITING_STATES and idle_s > WRITER_STALL_LIMIT_S:
                stalled.append("writer")
        return stalled


class _ReloadTimer:
    """Handles requests to read the configuration again, also while a session is running."""

    def __init__(self, loop: ServiceLoop, now_ns: int) -> None:
        self._loop = loop
        self.due_ns = now_ns

    def fire(self, now_ns: int) -> None:
        """Check for a request."""
        self.due_ns = now_ns + IDLE_PERIOD_NS
        self._loop.handle_reload_request()
