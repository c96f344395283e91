"""The daemon's loop on one opened rig: halt, be ready, carry out what waits, for ever.

What to use when: `Daemon(rig, parts).run()`; it returns when the process has to end or the
rig has to be opened anew (another configuration). Everything happens in the pump's thread,
between chunks; what others want of it is in `Parts.orders`.

Theory of operation. Between sessions the unit stands, and is asked whether it is there
(`unit_watch`). A session begins when nothing stands against it (`_obstacle`): a hold, a unit
that is not known, a disk without room, boards that are missing. How it is held, `running`
knows. What ends one:

    the program's end      closed, put aside as done
    refused before it      a person has to mend the job: put aside as failed
    a fault of the motion  halted, the recording goes on for as long as was planned, failed,
                           and a hold: nothing moves until `gyrorigd clear`
    an operator's halt     halted, closed, and a hold
    SIGTERM, SIGINT        halted, closed, and the loop ends

A hold outlives the process (`memory`): a restart after a fault has not looked.
"""

import time
from enum import Enum

from gyrorig_daemon.links.pump import StopRequestedError
from gyrorig_daemon.recorder import RecorderState
from gyrorig_daemon.rig import Rig
from gyrorig_daemon.service.jobs import Job
from gyrorig_daemon.service.parts import Parts
from gyrorig_daemon.service.present import missing_boards
from gyrorig_daemon.service.running import Glance, Runner, Scene
from gyrorig_daemon.service.status import StatusTimer
from gyrorig_daemon.service.unit_watch import UnitState, UnitWatch, first_halt
from gyrorig_daemon.service.wall_clock import WallClockTimer
from gyrorig_daemon.service.watchdog import WatchdogTimer
from gyrorig_protocol.errors import DeviceError, UsageError
from gyrorig_protocol.program import parse_program

IDLE_NS = 200_000_000
WRITER_LIMIT_S = 20.0  # so long may one turn of the writer's loop take
WRITING = (RecorderState.RECORDING, RecorderState.DEGRADED)


class Ending(Enum):
    """Why the loop ended."""

    END = "the process has to end"
    REOPEN = "the rig has to be opened anew"


class Daemon:
    """One opened rig in service."""

    def __init__(self, rig: Rig, parts: Parts) -> None:
        """Prepare; nothing is said to any device yet.

        Args:
            rig: just opened.
            parts: what outlives it.
        """
        self._rig = rig
        self._pump = rig.pump
        self._parts = parts
        self._missing_since_s: float | None = None
        self._reopen = False
        self.scene = Scene(Glance("starting"))
        self.unit = UnitWatch(rig, parts.memory, parts.counts, parts.seed)
        self._runner = Runner(rig, parts, self.unit, self.scene)
        now_ns = self._pump.now_ns()
        self.wall = WallClockTimer(parts.clocks.read_host, now_ns, self._take_clock_step)
        status = StatusTimer(rig, parts, self.scene, self.unit, self.wall, now_ns)
        watchdog = WatchdogTimer(parts.notifier, self._hanging, now_ns, parts.log)
        for timer in (self.wall, status, watchdog, _ReloadTimer(self, now_ns)):
            self._pump.add_timer(timer)

    def run(self) -> Ending:
        """Serve until the process has to end or the rig has to be opened anew.

        Raises:
            PortsGoneError: the acquisition process is gone; the unit was told to halt.
        """
        self._pump.heed_stop()
        first_halt(self._rig)
        begin = self._greet
        while True:
            try:
                begin()
                begin = self._turn
                if self._reopen:
                    return Ending.REOPEN
            except StopRequestedError as stop:
                if self._parts.orders.heard():
                    return Ending.END
                self._take_operators_halt(str(stop))

    def take_reload_order(self) -> None:
        """Read the configuration again if that was asked for; a sound one is used when idle."""
        parts = self._parts
        if not parts.orders.reload.is_set():
            return
        parts.orders.reload.clear()
        parts.notifier.reloading()
        refused = parts.reread()
        if refused:
            parts.counts.reloads_refused += 1
            parts.log(f"the configuration stays as it was: {refused}")
        else:
            parts.counts.reloads += 1
            parts.log("the configuration is sound and will be used as soon as nothing runs")
            self._reopen = True
        parts.notifier.ready()

    def _greet(self) -> None:
        """See the unit stand, if it is there, and say that the start is over."""
        self.unit.look()
        self._parts.notifier.ready()
        self._parts.log(f"ready; the unit: {self.unit.why or self.unit.state.value}")

    def _turn(self) -> None:
        """Do one thing."""
        if lost := self._parts.lost_rig():
            self._parts.log(f"{lost}; it is started again")
            self._reopen = True
            return
        self._take_clear()
        self.unit.look()
        obstacle = self._obstacle()
        if not obstacle:
            job = self._next_job()
            if job is not None:
                self._runner.carry_out(job)
                return
        idle = "fault" if self._parts.memory.hold else "waiting" if obstacle else "ready"
        self.scene.glance = Glance(idle, obstacle)
        self._pump.run_until(self._pump.now_ns() + IDLE_NS)

    def _obstacle(self) -> str:
        """Return why no session may begin now, "" where one may."""
        hold = self._parts.memory.hold
        if hold is not None:
            return f"{hold.reason}; look at the rig, then: gyrorigd clear"
        if self.unit.state is not UnitState.STANDS:
            return (
                f"the unit: {self.unit.why or self.unit.state.value}: check its cable and its power"
            )
        lack = self._parts.keeper.lack()
        if lack:
            return lack
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
        return f"no word from board {', '.join(missing)}: check its cable and its power"

    def _next_job(self) -> Job | None:
        """Return what is to be carried out now: what people asked for goes first."""
        parts, clocks = self._parts, self._parts.clocks
        job = parts.queue.take()
        if job is not None:
            return job
        entry = parts.schedule.due(clocks.monotonic_s(), clocks.utc_s())
        if entry is None:
            return None
        parts.schedule.begun(entry.name, clocks.monotonic_s(), clocks.utc_s())
        try:
            text = parts.read_program(entry.program)
            program = parse_program(text, entry.program)
        except UsageError as fault:
            parts.counts.sessions_failed += 1
            parts.log(f"{entry.name} of the schedule is left out this time: {fault}")
            return None
        session = f"{entry.name[:20]}-{int(clocks.utc_s()):x}"[:32]
        return Job(entry.name, program, text, session, entry.home)

    def _take_clock_step(self, step_s: float) -> None:
        self._parts.counts.clock_steps += 1
        text = f"the wall clock was set by {step_s:+.3f} s"
        self._parts.log(text)
        if self.scene.session is not None:
            self.scene.session.note(text)

    def _take_clear(self) -> None:
        if not self._parts.orders.clear.is_set():
            return
        self._parts.orders.clear.clear()
        memory = self._parts.memory
        if memory.hold is not None:
            self._parts.log(f"cleared: {memory.hold.reason}")
            memory.hold = None

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
        self._runner.set_hold(why)

    def _hanging(self) -> list[str]:
        """Return the loops that make no progress, the pump's own aside: it looks."""
        hanging = self._parts.hanging()
        session = self.scene.session
        if session is not None and self._parts.threaded_writer:
            recorder = session.recorder
            turn_s = (time.monotonic_ns() - recorder.progress_ns) * 1e-9
            if recorder.state in WRITING and turn_s > WRITER_LIMIT_S:
                hanging.append("writer")
        return hanging


class _ReloadTimer:
    """Looks for a request to read the configuration again, also while a session runs."""

    def __init__(self, daemon: Daemon, now_ns: int) -> None:
        self._daemon = daemon
        self.due_ns = now_ns

    def fire(self, now_ns: int) -> None:
        """Look."""
        self.due_ns = now_ns + IDLE_NS
        self._daemon.take_reload_order()
