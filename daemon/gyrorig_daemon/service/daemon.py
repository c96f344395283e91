"""The daemon's loop on one opened rig: halt, be ready, carry out what waits, for ever.

What to use when: `Daemon(rig, parts).run()`; it returns when the process has to end or the
rig has to be opened anew (another configuration). Everything happens in the pump's thread,
between chunks; what others want of it is in `Parts.orders`.

Theory of operation. Between sessions the unit stands, and is asked whether it is there
(`unit_watch`). A session begins when nothing stands against it (`_obstacle`): a hold, a unit
that is not known, boards that are missing, a disk without room. What ends a session:

    the program's end      closed, put aside as done
    refused before it      a person has to mend the job: put aside as failed
    a fault of the motion  halted, the recording goes on for as long as was planned, failed,
                           and a hold: nothing moves until `gyrorigd clear`
    an operator's halt     as a fault of the motion, but the recording is closed at once
    SIGTERM, SIGINT        halted, closed, and the loop ends

A hold does not outlive the process: whoever starts the daemon again has looked.
"""

from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from gyrorig_daemon.description import SessionOrder
from gyrorig_daemon.links.hub import PortsGoneError
from gyrorig_daemon.links.pump import StopRequestedError
from gyrorig_daemon.rig import Rig
from gyrorig_daemon.service.jobs import Job
from gyrorig_daemon.service.parts import Parts
from gyrorig_daemon.service.present import missing_boards, present_boards
from gyrorig_daemon.service.status import Glance, StatusTimer
from gyrorig_daemon.service.unit_watch import UnitState, UnitWatch, first_halt
from gyrorig_daemon.service.wall_clock import WallClockTimer
from gyrorig_daemon.service.watchdog import WatchdogTimer
from gyrorig_daemon.session import Session, Surroundings
from gyrorig_protocol.errors import DeviceError, GyrorigError, UsageError
from gyrorig_protocol.program import parse_program

IDLE_NS = 200_000_000
LEAST_AFTERMATH_S = 5.0


class Ending(Enum):
    """Why the loop ended."""

    END = "the process has to end"
    REOPEN = "the rig has to be opened anew"


@dataclass(frozen=True, slots=True)
class Hold:
    """Why nothing moves until somebody has looked."""

    reason: str
    since_utc_s: float


class Daemon:
    """One opened rig in service."""

    def __init__(self, rig: Rig, parts: Parts, hold: Hold | None = None) -> None:
        """Prepare; nothing is said to any device yet.

        Args:
            rig: just opened.
            parts: what outlives it.
            hold: what an earlier rig of this process was left with.
        """
        self._rig = rig
        self._pump = rig.pump
        self._parts = parts
        self.hold = hold
        self.unit = UnitWatch(rig, parts.seed)
        self._since_s = parts.clocks.monotonic_s()
        self._missing_since_s: float | None = None
        self._reopen = False
        self._scheduled = 0
        self.glance = Glance(state="starting", reason="", session=None, last=None)
        now_ns = self._pump.now_ns()
        self.wall = WallClockTimer(parts.clocks.read_host, now_ns, self._take_clock_step)
        self._status = StatusTimer(rig, parts, self, now_ns)
        watchdog = WatchdogTimer(parts.notifier, self._hanging, now_ns, parts.log)
        for timer in (self.wall, self._status, watchdog, _ReloadTimer(self, now_ns)):
            self._pump.add_timer(timer)
        self.session: Session | None = None

    def run(self) -> Ending:
        """Serve until the process has to end or the rig has to be opened anew.

        Raises:
            PortsGoneError: the acquisition process is gone; the unit was told to halt.
        """
        self._pump.heed_stop()
        first_halt(self._rig)
        try:
            self.unit.look()
            self._parts.notifier.ready()
            self._parts.log(f"ready: {self.unit.why or self.unit.state.value}")
        except StopRequestedError:
            if self._parts.orders.heard():
                return Ending.END
        while True:
            try:
                if self._reopen:
                    return Ending.REOPEN
                self._turn()
            except StopRequestedError as stop:
                if self._parts.orders.heard():
                    return Ending.END
                self._take_operators_halt(str(stop))

    def _turn(self) -> None:
        """Do one thing."""
        self._take_clear()
        self.unit.look()
        obstacle = self._obstacle()
        if not obstacle:
            job = self._next_job()
            if job is not None:
                self._carry_out(job)
                return
        self.glance = Glance(
            state="fault" if self.hold else "waiting" if obstacle else "ready",
            reason=obstacle,
            session=None,
            last=self.glance.last,
        )
        self._pump.run_until(self._pump.now_ns() + IDLE_NS)

    def _obstacle(self) -> str:
        """Return why no session may begin now, "" where one may."""
        if self.hold is not None:
            return f"{self.hold.reason}; look at the rig, then: gyrorigd clear"
        if self.unit.state is not UnitState.STANDS:
            return f"the unit: {self.unit.why or self.unit.state.value}"
        missing = missing_boards(self._rig)
        if not missing:
            self._missing_since_s = None
            return ""
        if self._missing_since_s is None:
            self._missing_since_s = self._parts.clocks.monotonic_s()
        waited_s = self._parts.clocks.monotonic_s() - self._missing_since_s
        patience_s = self._rig.config.service.board_patience_s
        if len(missing) < len(self._rig.boards) and waited_s >= patience_s:
            return ""
        return f"no word from board {', '.join(missing)}"

    def _next_job(self) -> Job | None:
        """Return what is to be carried out now: what people asked for goes first."""
        job = self._parts.queue.take()
        if job is not None:
            return job
        clocks = self._parts.clocks
        entry = self._parts.schedule.due(clocks.monotonic_s(), clocks.utc_s())
        if entry is None:
            return None
        self._parts.schedule.begun(entry.name, clocks.monotonic_s(), clocks.utc_s())
        try:
            text = self._parts.read_program(entry.program)
            program = parse_program(text, entry.program)
        except UsageError as fault:
            self._parts.counts.sessions_failed += 1
            self._parts.log(f"{entry.name} of the schedule: {fault}")
            return None
        self._scheduled += 1
        begun = int(clocks.utc_s())
        return Job(entry.name, program, text, f"{entry.name[:20]}-{begun:x}"[:32], entry.home)

    def _carry_out(self, job: Job) -> None:
        """Hold one session and put the job aside."""
        rig, parts = self._rig, self._parts
        begun_s = parts.clocks.utc_s()
        rig.capture.anchor(parts.clocks.anchor())
        home = job.home
        if not self.unit.steps_are_sure and not home:
            if not rig.config.ptu.home_without_asking:
                why = "the unit may have lost steps: clear the rig and hand it in with --home"
                self._put_aside(job, "failed", why, None, begun_s)
                return
            home = True
        order = SessionOrder(
            config=rig.config,
            config_text=parts.config_text,
            program=job.program,
            program_text=job.program_text,
            out_dir=parts.state.recordings,
            session=job.session,
            home=home,
        )
        around = Surroundings(
            capture=rig.capture,
            read_host=parts.clocks.read_host,
            threaded_writer=parts.threaded_writer,
            host=parts.host,
            dropped_bytes=parts.dropped_bytes,
            stop=rig.stop,
            progress=self._take_progress,
        )
        self.unit.session_begins()
        self.session = Session(rig, order, around, present_boards(rig))
        self.glance = Glance(
            "running", "", {"job": job.name, "session": job.session}, self.glance.last
        )
        parts.log(f"session {job.session} begins: {job.program.name}")
        try:
            result, why, path = self._hold_session(self.session)
        except BaseException:
            self._put_aside(job, "failed", "the daemon ended while it ran", None, begun_s)
            raise
        finally:
            self._add_up(self.session)
            self.session = None
            self._pump.heed_stop()
        self.unit.session_ended(homed=home and result == "done")
        self._put_aside(job, result, why, path, begun_s)
        if parts.orders.end.is_set():
            raise StopRequestedError("stopped")

    def _hold_session(self, session: Session) -> tuple[str, str, Path | None]:
        """Return what became of a session: done, failed or stopped; why; the recording."""
        moved = False
        try:
            session.prepare()
            moved = True
            begun_s = self._parts.clocks.monotonic_s()
            session.carry_out()
            path = session.finish()
        except StopRequestedError as stop:
            told = session.give_up(str(stop))
            if not self._parts.orders.heard():
                self._set_hold(str(stop))
            return "stopped", "; ".join([str(stop), *told]), session.recorder.path
        except PortsGoneError as fault:
            session.give_up(fault.what, can_halt=False)
            raise
        except DeviceError as fault:
            if not moved:
                told = session.give_up(fault.what)
                return "failed", "; ".join([str(fault), *told]), session.recorder.path
            spent_s = self._parts.clocks.monotonic_s() - begun_s
            told = self._live_with(session, fault, session.planned_s - spent_s)
            return "failed", "; ".join([str(fault), *told]), session.recorder.path
        except GyrorigError as fault:
            told = session.give_up(fault.what)
            return "failed", "; ".join([str(fault), *told]), session.recorder.path
        except BaseException as fault:
            session.give_up(f"{type(fault).__name__}: {fault}")
            raise
        lost = [str(board.board_id) for board in session.boards if board.gone]
        return "done", f"without board {', '.join(lost)} at the end" if lost else "", path

    def _live_with(self, session: Session, fault: DeviceError, planned_s: float) -> list[str]:
        """Halt after a fault of the motion, and let the recording go on for a while."""
        self._parts.counts.motion_faults += 1
        self._pump.ignore_stop()
        told = session.abort(fault.what)
        self._set_hold(fault.what)
        limit_s = self._rig.config.service.aftermath_s
        aftermath_s = min(max(planned_s, LEAST_AFTERMATH_S), limit_s)
        session.note(f"nothing moves any more; recorded for another {aftermath_s:.0f} s")
        self.glance = Glance(
            "fault", f"{fault.what}; recording goes on", self.glance.session, self.glance.last
        )
        self._pump.heed_stop()
        try:
            self._pump.run_until(
                self._pump.now_ns() + int(aftermath_s * 1e9), self._parts.orders.clear.is_set
            )
        except StopRequestedError:
            self._parts.orders.heard()  # halted already
        self._pump.ignore_stop()
        return told + session.keep()

    def _put_aside(
        self, job: Job, result: str, why: str, path: Path | None, begun_s: float
    ) -> None:
        counts = self._parts.counts
        done = result == "done"
        if done:
            counts.sessions_done += 1
        elif result == "stopped":
            counts.sessions_stopped += 1
        else:
            counts.sessions_failed += 1
        document = {
            "session": job.session,
            "program": job.program.name,
            "reason": why,
            "recording": None if path is None else str(path),
            "begun_utc_s": round(begun_s, 3),
            "ended_utc_s": round(self._parts.clocks.utc_s(), 3),
        }
        self._parts.queue.finish(job, done, document)
        self.glance = Glance("ready", "", None, {"job": job.name, "result": result, **document})
        self._parts.log(f"session {job.session} {result}{': ' if why else ''}{why}")

    def _take_progress(self, done: int, total: int) -> None:
        if self.glance.session is not None:
            self.glance.session.update(step=done, steps=total)

    def _take_clock_step(self, step_s: float) -> None:
        self._parts.counts.clock_steps += 1
        text = f"the wall clock was set by {step_s:+.3f} s"
        self._parts.log(text)
        if self.session is not None:
            self.session.note(text)

    def _take_clear(self) -> None:
        if not self._parts.orders.clear.is_set():
            return
        self._parts.orders.clear.clear()
        if self.hold is not None:
            self._parts.log(f"cleared: {self.hold.reason}")
            self.hold = None

    def _take_operators_halt(self, why: str) -> None:
        """Halt between sessions, where nothing should move anyhow."""
        self._pump.ignore_stop()
        try:
            first_halt(self._rig)
            if self._rig.client.identified and not self._rig.client.gone:
                self._rig.client.halt()
        except DeviceError as fault:
            self.unit.lose(UnitState.SILENT, fault.what)
        self._pump.heed_stop()
        self._set_hold(why)

    def _set_hold(self, why: str) -> None:
        if self.hold is None:
            self._parts.orders.clear.clear()  # an earlier one is not meant for this
            self.hold = Hold(why, self._parts.clocks.utc_s())

    def take_reload(self) -> None:
        """Read the configuration again; a sound one is used as soon as nothing runs."""
        self._parts.notifier.reloading()
        refused = self._parts.reread()
        if refused:
            self._parts.counts.reloads_refused += 1
            self._parts.log(f"the configuration stays as it was: {refused}")
        else:
            self._parts.counts.reloads += 1
            self._reopen = True
        self._parts.notifier.ready()

    def take_reload_order(self) -> None:
        """Look whether a reload was asked for."""
        if self._parts.orders.reload.is_set():
            self._parts.orders.reload.clear()
            self.take_reload()

    def _hanging(self) -> list[str]:
        return self._parts.hanging()

    def _add_up(self, session: Session) -> None:
        counts, recorder = self._parts.counts, session.recorder
        counts.messages_written += recorder.written
        counts.messages_dropped += recorder.dropped


class _ReloadTimer:
    """Looks for a request to read the configuration again, also while a session runs."""

    def __init__(self, daemon: Daemon, now_ns: int) -> None:
        self._daemon = daemon
        self.due_ns = now_ns

    def fire(self, now_ns: int) -> None:
        """Look."""
        self.due_ns = now_ns + IDLE_NS
        self._daemon.take_reload_order()
