"""One session: a rig, a program, a recording; the same code in real and simulated time.

What to use when: `record_session` for one session on ports that are then done with;
`Session` on a `Rig` that goes on afterwards.

Everything that can refuse refuses before anything moves: first the boards and the unit
say who they are, then the whole program is checked against the unit's limits, then the
file is opened, and only then comes the first move. On every way out the unit is halted,
seen to stand still, and the recording closed.
"""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from gyrorig_daemon.description import (
    SessionOrder,
    check_folder,
    describe_session,
    hello_files,
    make_folder,
)
from gyrorig_daemon.links.board_link import BoardLink
from gyrorig_daemon.links.capture_clock import CaptureClock, HostClocks
from gyrorig_daemon.links.hub import PortHub, PortsGoneError
from gyrorig_daemon.links.pump import StopFlag, Timer
from gyrorig_daemon.motion import (
    Exchange,
    Executor,
    Homing,
    PhaseSink,
    PlannedStep,
    Poller,
    Unit,
    UnitFacts,
    halt_and_confirm,
    identify_unit,
    open_unit,
    plan_duration_s,
    plan_program,
)
from gyrorig_daemon.recorder import Recorder, RecordingPlan
from gyrorig_daemon.recorder.closing import Closing
from gyrorig_daemon.recorder.ptu_log import PtuLog
from gyrorig_daemon.recorder.timers import DiagnosticsTimer, HostClockTimer, WriterTimer
from gyrorig_daemon.rig import Rig
from gyrorig_protocol.errors import DeviceError, GyrorigError, MachineError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.ptu import Axis
from gyrorig_protocol.recording.messages import (
    SESSION_EVENT_TOPIC,
    ClockPing,
    EventKind,
    ImuRaw,
    SessionEvent,
    clock_topic,
    imu_topic,
)

Progress = Callable[[int, int], None]

CLOSE_PATIENCE_S = 60.0
NEWCOMERS_EVERY_NS = 1_000_000_000
CLOSING_LOOK_NS = 20_000_000  # how often it is asked whether a file is closed yet


def no_progress(done: int, total: int) -> None:
    """Tell nobody."""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What differs between real and simulated time."""

    capture: CaptureClock
    read_host: Callable[[], HostClocks]
    threaded_writer: bool
    host: str
    seed: int = 0  # of the moments at which the boards are asked for their clocks
    paths: dict[str, str] = field(default_factory=dict)  # of ports that are not as configured
    dropped_bytes: Callable[[], int] = lambda: 0
    stop: StopFlag = field(default_factory=StopFlag)
    progress: Progress = no_progress
    new_recorder: Callable[[], Recorder] | None = None  # None: one file, told when a disk fails
    close_patience_s: float = CLOSE_PATIENCE_S


def record_session(hub: PortHub, order: SessionOrder, around: Surroundings) -> Path:
    """Record one session and return the recording's path.

    Args:
        hub: the rig's ports: `config.ports()` names them.
        order: what to do.
        around: clocks, writer, signals.

    Raises:
        GyrorigError: of the class of whoever must act. The unit is halted then, and what
            was recorded is kept; the text says where.
    """
    rig = Rig(
        hub, order.config, around.capture, stop=around.stop, seed=around.seed, paths=around.paths
    )
    session = Session(rig, order, around, rig.boards)
    try:
        session.prepare()
        session.carry_out()
        path = session.finish()
    except GyrorigError as fault:
        can_halt = not isinstance(fault, PortsGoneError)
        words = [fault.remedy, *session.give_up(fault.what, can_halt)]
        raise type(fault)(fault.what, "; ".join(word for word in words if word)) from fault
    except BaseException as fault:
        session.give_up(f"{type(fault).__name__}")
        raise
    session.complain_of_lost_boards(path)
    return path


class Session:
    """The parts of one session and the order in which they come and go."""

    def __init__(
        self, rig: Rig, order: SessionOrder, around: Surroundings, boards: Sequence[BoardLink]
    ) -> None:
        """Listen to the rig from here on.

        Args:
            rig: what to record, and what to move.
            order: what to do.
            around: clocks, writer.
            boards: those of the rig that must take part.
        """
        self._rig = rig
        self._order = order
        self._around = around
        self.boards = list(boards)
        self._named = {board.board_id for board in boards}
        self._unfit: list[BoardLink] = []
        self._topics: dict[BoardId, str] = {}
        self._pump = rig.pump
        self._client = rig.client
        new_recorder = around.new_recorder or (lambda: Recorder(around.threaded_writer))
        self.recorder = new_recorder()
        self._log = PtuLog(self.recorder, rig.capture)
        self._unit: Unit | None = None
        self._poller: Poller | None = None
        self._steps: list[PlannedStep] = []
        self._phases: list[str] = []
        self._timers: list[Timer] = []
        rig.listener = self

    def prepare(self) -> None:
        """Get to know boards and unit, check the program, open the recording."""
        order = self._order
        check_folder(order.out_dir)
        version = identify_unit(self._client)  # first of all: it may be turning yet
        for board in self.boards:
            board.identify()
        ptu, settings = order.config.ptu, order.program.settings
        homing = Homing.NEVER
        if order.home:
            homing = Homing.ALWAYS
        elif ptu.home_without_asking:
            homing = Homing.IF_NEEDED
        unit = open_unit(self._client, ptu, settings, version, homing)
        self._unit = unit
        self._log.use_unit(unit.facts)
        poller = Poller(unit, order.config.ptu.poll.rate_hz, self._log.take_position)
        start = poller.where()
        self._poller = poller
        self._steps = plan_program(order.program, unit.facts, order.config.ptu.limits, start)
        self.recorder.open(self._describe(unit))
        self._start_timers()
        for _ in Axis:  # a recording says where both stood before the first order
            poller.poll()

    @property
    def planned_s(self) -> float:
        """How long the program takes at most, 0 before it is known."""
        return plan_duration_s(self._steps)

    @property
    def angles_rad(self) -> tuple[float, float] | None:
        """Where pan and tilt were when the unit last said so, None before."""
        position = self._log.position
        return None if position is None else (position.pan_rad, position.tilt_rad)

    @property
    def facts(self) -> UnitFacts | None:
        """The unit as it described itself, None before."""
        return None if self._unit is None else self._unit.facts

    def left_s(self, done: int) -> float:
        """How long the steps take at most of which `done` are behind."""
        return plan_duration_s(self._steps[done:])

    def carry_out(self) -> None:
        """Run the program."""
        if self._unit is None or self._poller is None:
            raise AssertionError("not prepared")  # a fault of this program
        phases = PhaseSink(self._begin_phase, self._end_phase)
        executor = Executor(self._pump, self._unit, self._poller, phases)
        total = len(self._steps)
        self._around.progress(0, total)
        executor.run(self._steps, lambda done: self._around.progress(done, total))

    def finish(self) -> Path:
        """Halt, see the unit stand still, close the recording."""
        if self._unit is None or self._poller is None:
            raise AssertionError("not prepared")  # a fault of this program
        self._pump.ignore_stop()
        halt_and_confirm(self._pump, self._unit, self._poller)
        return self._close()

    def give_up(self, why: str, can_halt: bool = True) -> list[str]:
        """Halt whatever moves and keep what was recorded; return what to tell."""
        self._pump.ignore_stop()
        told = self.abort(why, can_halt)
        told += self.keep()
        return told

    def abort(self, why: str, can_halt: bool = True) -> list[str]:
        """Halt whatever moves and say why in the recording, which goes on; return what to tell."""
        try:
            self.recorder.check()
            self._event(EventKind.FAULT, "", why)
            for phase in reversed(self._phases):
                self._event(EventKind.PHASE_END, phase, "aborted")
        except MachineError:
            self.recorder.mute()
        self._phases.clear()
        is_ours = self._client.identified or self._unit is not None
        return [self._halt()] if is_ours and can_halt else []

    def keep(self) -> list[str]:
        """Close what was recorded so far, whatever state it is in; return what to tell."""
        if not self.recorder.is_open:
            self._listen_no_more()
            return []
        with contextlib.suppress(GyrorigError):
            self._close()
        return [f"recorded so far: {self.recorder.path}"]

    def complain_of_lost_boards(self, path: Path) -> None:
        """Say which boards were not there any more at the end.

        Raises:
            DeviceError: any were not.
        """
        lost = [f"{b.board_id} ({b.state.value})" for b in self.boards if not b.known]
        if lost:
            raise DeviceError(
                f"the program ended, but without board {', '.join(lost)}",
                f"check its cable and its power; the recording is kept: {path}",
            )

    def take_exchange(self, exchange: Exchange) -> None:
        """Record an exchange with the unit."""
        self._log.take_exchange(exchange)

    def take_sample(self, board_id: BoardId, message: ImuRaw, publish_ns: int) -> None:
        """Record a sample."""
        if board_id in self._named:
            topic = self._topics.get(board_id)
            if topic is None:
                topic = self._topics[board_id] = imu_topic(board_id)
            self.recorder.put(topic, message, message.host_time_ns, publish_ns)

    def take_ping(self, board_id: BoardId, message: ClockPing) -> None:
        """Record a board's answer about its clock."""
        if board_id in self._named:
            self.recorder.put(clock_topic(board_id), message, message.host_receive_ns)

    def note(self, text: str) -> None:
        """Record what happened and is no fault."""
        self._event(EventKind.NOTE, "", text)

    def fault(self, text: str) -> None:
        """Record what went wrong."""
        self._event(EventKind.FAULT, "", text)

    def take_newcomers(self) -> None:
        """Let boards take part that have said who they are only now."""
        for board in self._rig.boards:
            if board.board_id in self._named or board in self._unfit or not board.known:
                continue
            try:
                board.identify()  # it is known: this waits for nothing
                metadata = {f"gyrorig.board.{board.board_id}": board.metadata()}
            except DeviceError as fault:
                self._unfit.append(board)
                self.fault(f"it cannot take part: {fault}")
                continue
            self._named.add(board.board_id)
            self.boards.append(board)
            now_utc_ns = self._rig.capture.utc_ns(self._pump.now_ns())
            self.recorder.add_facts(metadata, hello_files(board, now_utc_ns))
            self.note(f"board {board.board_id} takes part from here on")

    def _halt(self) -> str:
        try:
            if self._unit is not None and self._poller is not None:
                halt_and_confirm(self._pump, self._unit, self._poller)
            else:
                self._client.halt()
        except GyrorigError as fault:
            return f"the unit could not be seen to halt ({fault.what})"
        return "the unit is halted"

    def _close(self) -> Path:
        """Close the recording while everything else goes on: a disk may take its time."""
        self._listen_no_more()
        if not self._around.threaded_writer:
            return self.recorder.close()
        closing = Closing(self.recorder, self._around.close_patience_s)
        with contextlib.suppress(PortsGoneError):
            while closing.is_alive():
                self._pump.run_until(
                    self._pump.now_ns() + CLOSING_LOOK_NS, lambda: not closing.is_alive()
                )
        return closing.path()

    def _listen_no_more(self) -> None:
        for timer in self._timers:
            self._pump.remove_timer(timer)
        self._timers.clear()
        self._rig.listener = None

    def _describe(self, unit: Unit) -> RecordingPlan:
        order, around = self._order, self._around
        make_folder(order.out_dir)
        now_ns = self._pump.now_ns()
        return describe_session(
            order, self._rig.capture, around.host, unit.facts, self.boards, now_ns
        )

    def _start_timers(self) -> None:
        now_ns = self._pump.now_ns()
        recorder, around, capture = self.recorder, self._around, self._rig.capture
        self._timers = [
            WriterTimer(recorder, now_ns),
            HostClockTimer(recorder, capture, around.read_host, now_ns),
            DiagnosticsTimer(
                recorder,
                capture,
                now_ns,
                client=self._client,
                controller_clock=lambda: self._log.controller_clock,
                boards=self.boards,
                dropped_bytes=around.dropped_bytes,
            ),
            _NewcomersTimer(self, now_ns),
        ]
        for timer in self._timers:
            self._pump.add_timer(timer)

    def _begin_phase(self, phase: str, text: str) -> None:
        self._phases.append(phase)
        self._event(EventKind.PHASE_BEGIN, phase, text)

    def _end_phase(self, phase: str, text: str) -> None:
        self._phases.remove(phase)
        self._event(EventKind.PHASE_END, phase, text)

    def _event(self, kind: EventKind, phase: str, text: str) -> None:
        now_ns = self._rig.capture.utc_ns(self._pump.now_ns())
        event = SessionEvent(now_ns, int(kind), phase, text)
        self.recorder.hold(SESSION_EVENT_TOPIC, event, now_ns)


class _NewcomersTimer:
    """Looks once a second for boards that came late."""

    def __init__(self, session: Session, now_ns: int) -> None:
        self._session = session
        self.due_ns = now_ns + NEWCOMERS_EVERY_NS

    def fire(self, now_ns: int) -> None:
        """Look."""
        self.due_ns = now_ns + NEWCOMERS_EVERY_NS
        self._session.take_newcomers()
