"""One job carried out: its session held, what went wrong lived with, the job put aside.

What to use when: `Runner.carry_out` from the daemon's loop, when nothing stands against a
session. It comes back with the unit halted and the recording closed, whatever happened;
`Scene` is what others see of it meanwhile.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gyrorig_daemon.description import SessionOrder
from gyrorig_daemon.links.hub import PortsGoneError
from gyrorig_daemon.links.pump import StopRequestedError
from gyrorig_daemon.recorder import Recorder
from gyrorig_daemon.rig import Rig
from gyrorig_daemon.service.jobs import Job
from gyrorig_daemon.service.keeping import recorder_settings
from gyrorig_daemon.service.memory import Hold
from gyrorig_daemon.service.parts import Parts
from gyrorig_daemon.service.present import present_boards
from gyrorig_daemon.service.unit_watch import UnitWatch
from gyrorig_daemon.session import Session, Surroundings
from gyrorig_protocol.errors import DeviceError, GyrorigError, UsageError

LEAST_AFTERMATH_S = 5.0
CLOSE_PATIENCE_S = 12.0  # with 10 s to halt within the 30 s that systemd allows
UNSURE = "the unit may have lost steps: clear the rig and hand the job in with --home"


@dataclass(frozen=True, slots=True)
class Glance:
    """What goes on, in the words of the loop itself."""

    state: str  # starting, waiting, ready, running, fault
    reason: str = ""
    session: dict[str, Any] | None = None


@dataclass(slots=True)
class Scene:
    """What goes on, for whoever wants to tell of it."""

    glance: Glance
    session: Session | None = None
    last: dict[str, Any] | None = None  # what became of the last session
    begun_s: float = 0.0  # when the session's first step was, by the clock that nobody sets
    step_begun_s: float = 0.0


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a session: done, failed, stopped, or waits: nothing of it was done."""

    result: str
    reason: str
    recording: Path | None


class Runner:
    """Carries out one job after another on one rig."""

    def __init__(self, rig: Rig, parts: Parts, unit: UnitWatch, scene: Scene) -> None:
        self._rig = rig
        self._pump = rig.pump
        self._parts = parts
        self._unit = unit
        self._scene = scene

    def carry_out(self, job: Job) -> None:
        """Hold one session and put the job aside.

        Raises:
            StopRequestedError: the process has to end; the job is put aside then, too.
            PortsGoneError: the acquisition process is gone; as above.
        """
        begun_s = self._parts.clocks.utc_s()
        home = job.home or (
            not self._parts.memory.steps_are_sure and self._rig.config.ptu.home_without_asking
        )
        if not self._parts.memory.steps_are_sure and not home:
            result = "waits" if job.path is None else "failed"
            self._put_aside(job, Outcome(result, UNSURE, None), begun_s)
            return
        session = self._begin(job, home)
        outcome = Outcome("failed", "the daemon ended while it ran", None)
        try:
            outcome = self._hold_session(session, is_scheduled=job.path is None)
        except PortsGoneError as fault:
            outcome = Outcome("failed", str(fault), session.recorder.path)
            raise
        finally:
            for board in self._rig.boards:
                board.unpin()
            self._parts.account.close(session.recorder.counts.values())
            self._parts.keeper.recorder = None
            self._scene.session = None
            self._pump.heed_stop()
            self._unit.session_ended(home and outcome.result == "done", session.facts)
            self._put_aside(job, outcome, begun_s, session.recorder)
        if self._parts.orders.end.is_set():
            raise StopRequestedError("the process has to end")

    def set_hold(self, why: str) -> None:
        """Let nothing move until somebody has looked."""
        if self._parts.memory.hold is None:
            self._parts.orders.clear.clear()  # an earlier one is not meant for this
            self._parts.memory.hold = Hold(why, self._parts.clocks.utc_s())

    def _begin(self, job: Job, home: bool) -> Session:
        rig, parts = self._rig, self._parts
        rig.capture.anchor(parts.clocks.anchor())
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
            new_recorder=self._new_recorder,
            close_patience_s=CLOSE_PATIENCE_S,
        )
        self._unit.session_begins()
        session = Session(rig, order, around, present_boards(rig))
        self._scene.session = session
        told = {"job": job.name, "session": job.session, "program": job.program.name}
        self._scene.glance = Glance("running", session=told)
        parts.log(f"session {job.session} begins: {job.program.name}")
        return session

    def _new_recorder(self) -> Recorder:
        settings = recorder_settings(self._rig.config.service)
        keeper = self._parts.keeper
        keeper.recorder = Recorder(
            self._parts.threaded_writer, settings, keeper.make_room, view=self._parts.view
        )
        return keeper.recorder

    def _hold_session(self, session: Session, is_scheduled: bool) -> Outcome:
        moved = False
        begun_s = self._parts.clocks.monotonic_s()
        try:
            session.prepare()
            moved, begun_s = True, self._parts.clocks.monotonic_s()
            session.carry_out()
            path = session.finish()
        except StopRequestedError as stop:
            told = self._end_early(session, str(stop))
            if not self._parts.orders.heard():
                self.set_hold(str(stop))
            elif session.recorder.path is None:
                return Outcome("waits", str(stop), None)
            return Outcome("stopped", "; ".join([str(stop), *told]), session.recorder.path)
        except PortsGoneError as fault:
            session.give_up(fault.what, can_halt=False)
            raise
        except DeviceError as fault:
            if not moved:
                return self._refused(session, fault, is_scheduled)
            spent_s = self._parts.clocks.monotonic_s() - begun_s
            told = self._live_with(session, fault, session.planned_s - spent_s)
            return Outcome("failed", "; ".join([str(fault), *told]), session.recorder.path)
        except GyrorigError as fault:
            return self._refused(session, fault, is_scheduled)
        except BaseException as fault:
            session.give_up(f"{type(fault).__name__}: {fault}")
            raise
        lost = [str(board.board_id) for board in session.boards if not board.known]
        return Outcome("done", f"without board {', '.join(lost)} at the end" if lost else "", path)

    def _refused(self, session: Session, fault: GyrorigError, is_scheduled: bool) -> Outcome:
        """End a session that did not get to its motion; tell whether it is tried again."""
        told = self._end_early(session, fault.what)
        waits = is_scheduled and not isinstance(fault, UsageError)
        waits = waits or (isinstance(fault, DeviceError) and self._rig.client.gone)
        if waits and session.recorder.path is None:
            return Outcome("waits", fault.what, None)
        return Outcome("failed", "; ".join([str(fault), *told]), session.recorder.path)

    def _end_early(self, session: Session, why: str) -> list[str]:
        """Halt and close; return what to tell."""
        self._pump.ignore_stop()
        told = session.abort(why)
        session.keep()
        return told

    def _live_with(self, session: Session, fault: DeviceError, planned_s: float) -> list[str]:
        """Halt after a fault of the motion, and let the recording go on for a while."""
        self._parts.counts.motion_faults += 1
        self._pump.ignore_stop()
        told = session.abort(fault.what)
        self.set_hold(fault.what)
        limit_s = self._rig.config.service.aftermath_s
        aftermath_s = min(max(planned_s, LEAST_AFTERMATH_S), limit_s)
        session.note(f"nothing moves any more; recorded for another {aftermath_s:.0f} s")
        reason = f"{fault.what}; the recording goes on"
        self._scene.glance = Glance("fault", reason, self._scene.glance.session)
        self._pump.heed_stop()
        try:
            self._pump.run_until(
                self._pump.now_ns() + int(aftermath_s * 1e9), self._parts.orders.clear.is_set
            )
        except StopRequestedError:
            self._parts.orders.heard()  # halted already
        finally:
            self._pump.ignore_stop()
            session.keep()
        return told

    def _put_aside(
        self, job: Job, outcome: Outcome, begun_s: float, recorder: Recorder | None = None
    ) -> None:
        if outcome.result == "waits":
            self._let_wait(job, outcome.reason)
            return
        counts = self._parts.counts
        name = f"sessions_{outcome.result}"
        setattr(counts, name, getattr(counts, name) + 1)
        document = {
            "session": job.session,
            "program": job.program.name,
            "reason": outcome.reason,
            "recording": None if outcome.recording is None else str(outcome.recording),
            "parts": [] if recorder is None else [path.name for path in recorder.paths],
            "messages_lost": 0 if recorder is None else recorder.dropped,
            "begun_utc_s": round(begun_s, 3),
            "ended_utc_s": round(self._parts.clocks.utc_s(), 3),
        }
        self._parts.queue.finish(job, outcome.result == "done", document)
        self._scene.last = {"job": job.name, "result": outcome.result, **document}
        why = f": {outcome.reason}" if outcome.reason else ""
        self._parts.log(f"session {job.session} {outcome.result}{why}")

    def _let_wait(self, job: Job, why: str) -> None:
        """Have a session tried again of which nothing was done."""
        parts, when = self._parts, ""
        if job.path is None:
            wait_s = parts.schedule.put_off(job.name, parts.clocks.monotonic_s())
            when = "" if wait_s is None else f", for {wait_s:.0f} s at least"
        else:
            parts.queue.give_back(job)
        parts.counts.sessions_put_off += 1
        parts.log(f"session {job.session} did not begin and waits{when}: {why}")

    def _take_progress(self, done: int, total: int) -> None:
        if self._scene.glance.session is not None:
            now_s = self._parts.clocks.monotonic_s()
            if done == 0:
                self._scene.begun_s = now_s
            self._scene.step_begun_s = now_s
            self._scene.glance.session.update(step=done, steps=total)
