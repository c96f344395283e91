"""One session: a rig, a program, a recording; the same code in real and simulated time.

Everything that can refuse refuses before anything moves: first the boards and the unit
say who they are, then the whole program is checked against the unit's limits, then the
file is opened, and only then comes the first move. On every way out the unit is halted,
seen to stand still, and the recording closed.
"""

import contextlib
import random
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from gyrorig_daemon.config import PTU_PORT
from gyrorig_daemon.description import (
    SessionOrder,
    check_folder,
    describe_session,
    make_folder,
)
from gyrorig_daemon.links.board_link import BoardLink
from gyrorig_daemon.links.board_samples import BoardSinks
from gyrorig_daemon.links.capture_clock import CaptureClock, HostClocks
from gyrorig_daemon.links.hub import PortHub, PortsGoneError
from gyrorig_daemon.links.pump import Pump, StopFlag
from gyrorig_daemon.motion import (
    Executor,
    Homing,
    PhaseSink,
    PlannedStep,
    Poller,
    PtuClient,
    Unit,
    halt_and_confirm,
    identify_unit,
    open_unit,
    plan_program,
)
from gyrorig_daemon.recorder import Recorder, RecordingPlan
from gyrorig_daemon.recorder.ptu_log import PtuLog
from gyrorig_daemon.recorder.timers import DiagnosticsTimer, HostClockTimer, WriterTimer
from gyrorig_protocol.errors import DeviceError, GyrorigError, MachineError
from gyrorig_protocol.identity import BoardId
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
    session = _Session(hub, order, around)
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


class _Session:
    """The parts of one session and the order in which they come and go."""

    def __init__(self, hub: PortHub, order: SessionOrder, around: Surroundings) -> None:
        self._order = order
        self._around = around
        self._pump = Pump(hub, around.stop)
        self._recorder = Recorder(around.threaded_writer)
        self._log = PtuLog(self._recorder, around.capture)
        self._unit: Unit | None = None
        self._poller: Poller | None = None
        self._steps: list[PlannedStep] = []
        self._phases: list[str] = []
        config = order.config
        self._client = PtuClient(
            self._pump,
            PTU_PORT,
            where=around.paths.get(PTU_PORT, config.ptu.port),
            baud=config.ptu.baud,
            on_exchange=self._log.take_exchange,
            timeout_s=config.ptu.poll.timeout_s,
        )
        sinks = BoardSinks(self._take_sample, self._take_ping, self._note, self._fault)
        rng = random.Random(around.seed)  # noqa: S311 - moments, not secrets
        self._boards = [
            BoardLink(self._pump, board, around.capture, sinks, random.Random(rng.random()))  # noqa: S311
            for board in config.boards
        ]

    def prepare(self) -> None:
        """Get to know boards and unit, check the program, open the recording."""
        order = self._order
        check_folder(order.out_dir)
        version = identify_unit(self._client)  # first of all: it may be turning yet
        for board in self._boards:
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
        self._recorder.open(self._describe(unit))
        self._start_timers()

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
        return self._recorder.close()

    def give_up(self, why: str, can_halt: bool = True) -> list[str]:
        """Halt whatever moves and keep what was recorded; return what to tell."""
        self._pump.ignore_stop()
        told: list[str] = []
        try:
            self._recorder.check()
            self._event(EventKind.FAULT, "", why)
            for phase in reversed(self._phases):
                self._event(EventKind.PHASE_END, phase, "aborted")
        except MachineError:
            self._recorder.mute()
        if self._client.identified and can_halt:
            told.append(self._halt())
        if self._recorder.is_open:
            with contextlib.suppress(GyrorigError):
                self._recorder.close()
            told.append(f"recorded so far: {self._recorder.path}")
        return told

    def complain_of_lost_boards(self, path: Path) -> None:
        """Say which boards went away meanwhile.

        Raises:
            DeviceError: any did.
        """
        lost = [str(board.board_id) for board in self._boards if board.gone]
        if lost:
            raise DeviceError(
                f"the program ended, but without board {', '.join(lost)}: hung up",
                f"check the cable; the recording is kept: {path}",
            )

    def _halt(self) -> str:
        try:
            if self._unit is not None and self._poller is not None:
                halt_and_confirm(self._pump, self._unit, self._poller)
            else:
                self._client.halt()
        except GyrorigError as fault:
            return f"the unit could not be seen to halt ({fault.what})"
        return "the unit is halted"

    def _describe(self, unit: Unit) -> RecordingPlan:
        order, around = self._order, self._around
        make_folder(order.out_dir)
        now_ns = self._pump.now_ns()
        return describe_session(
            order, around.capture, around.host, unit.facts, self._boards, now_ns
        )

    def _start_timers(self) -> None:
        now_ns = self._pump.now_ns()
        recorder, around = self._recorder, self._around
        self._pump.add_timer(WriterTimer(recorder, now_ns))
        self._pump.add_timer(HostClockTimer(recorder, around.capture, around.read_host, now_ns))
        self._pump.add_timer(
            DiagnosticsTimer(
                recorder,
                around.capture,
                now_ns,
                client=self._client,
                controller_clock=lambda: self._log.controller_clock,
                boards=self._boards,
                dropped_bytes=around.dropped_bytes,
            )
        )

    def _take_sample(self, board_id: BoardId, message: ImuRaw, publish_ns: int) -> None:
        self._recorder.put(imu_topic(board_id), message, message.host_time_ns, publish_ns)

    def _take_ping(self, board_id: BoardId, message: ClockPing) -> None:
        self._recorder.put(clock_topic(board_id), message, message.host_receive_ns)

    def _begin_phase(self, phase: str, text: str) -> None:
        self._phases.append(phase)
        self._event(EventKind.PHASE_BEGIN, phase, text)

    def _end_phase(self, phase: str, text: str) -> None:
        self._phases.remove(phase)
        self._event(EventKind.PHASE_END, phase, text)

    def _note(self, text: str) -> None:
        self._event(EventKind.NOTE, "", text)

    def _fault(self, text: str) -> None:
        self._event(EventKind.FAULT, "", text)

    def _event(self, kind: EventKind, phase: str, text: str) -> None:
        now_ns = self._around.capture.utc_ns(self._pump.now_ns())
        event = SessionEvent(now_ns, int(kind), phase, text)
        self._recorder.hold(SESSION_EVENT_TOPIC, event, now_ns)
