"""Run one session; the code is the same in real and in simulated time.

What to use when: `record_session` for one session on ports that are closed afterwards;
`Session` on a `Rig` that is used again.

Everything that can be refused is refused before anything moves. First the unit and the boards
identify themselves, then the whole program is checked against the unit's limits, then the
file is opened, and then the first move starts. However the session ends, the unit is halted,
its standstill is confirmed, and the recording is closed.
"""

import contextlib
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from gyrorig_daemon.links.boards.board_link import BoardLink
from gyrorig_daemon.links.ports.port_hub import PortHub, PortsGoneError
from gyrorig_daemon.links.pump import Timer
from gyrorig_daemon.motion import (
    Exchange,
    Executor,
    Homing,
    PhaseSink,
    PlannedStep,
    PositionPoller,
    RecordedMotion,
    ReplayExecutor,
    Unit,
    UnitFacts,
    halt_and_confirm,
    open_unit,
    plan_duration_s,
    plan_program,
    plan_replay,
)
from gyrorig_daemon.recorder import Recorder, RecordingPlan
from gyrorig_daemon.recorder.disk_worker import call_in_thread
from gyrorig_daemon.recorder.ptu_log import PtuLog
from gyrorig_daemon.recorder.session_timers import DiagnosticsTimer, HostClockTimer, WriterTimer
from gyrorig_daemon.session.connected_rig import Rig
from gyrorig_daemon.session.session_description import (
    SessionRequest,
    check_folder,
    describe_session,
    hello_attachments,
    make_folder,
)
from gyrorig_daemon.session.session_environment import SessionEnvironment, SessionSummary
from gyrorig_protocol.errors import DeviceError, GyrorigError, MachineError, sentence
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.ptu import Axis
from gyrorig_protocol.recording.clock_messages import ClockPing, clock_ping_topic
from gyrorig_protocol.recording.messages import (
    SESSION_EVENT_TOPIC,
    EventKind,
    ImuRaw,
    SessionEvent,
    imu_raw_topic,
)

LATE_BOARD_CHECK_NS = 1_000_000_000
CLOSE_POLL_NS = 20_000_000


def record_session(hub: PortHub, request: SessionRequest, environment: SessionEnvironment) -> Path:
    """Record one session and return the path of the recording.

    Args:
        hub: the rig's ports; `config.ports()` has their names.
        request: what to record.
        environment: clocks, writer, signals.

    Raises:
        GyrorigError: the class says who must act. The unit is halted then, and what was
            recorded is kept; the text has its path.
    """
    rig = Rig(
        hub,
        request.config,
        environment.capture,
        stop=environment.stop,
        seed=environment.seed,
        paths=environment.paths,
    )
    session = Session(rig, request, environment, rig.boards)
    try:
        session.prepare()
        session.run_program()
        path = session.finish()
    except GyrorigError as fault:
        can_halt = not isinstance(fault, PortsGoneError)
        remedies = [fault.remedy, *session.abort_and_close(fault.problem, can_halt)]
        remedy = " ".join(sentence(text) for text in remedies if text)
        raise type(fault)(fault.problem, remedy) from fault
    except BaseException as fault:
        session.abort_and_close(f"{type(fault).__name__}")
        raise
    session.raise_if_boards_lost(path)
    environment.on_summary(session.summary(path))
    return path


class Session:
    """The parts of one session, and the order in which they start and end."""

    def __init__(
        self,
        rig: Rig,
        request: SessionRequest,
        environment: SessionEnvironment,
        boards: Sequence[BoardLink],
    ) -> None:
        """Listen to the rig from now on.

        Args:
            rig: what to record and to move.
            request: what to do.
            environment: clocks, writer.
            boards: the boards of the rig that must take part.
        """
        self._rig = rig
        self._request = request
        self._environment = environment
        self.boards = list(boards)
        self._board_ids = {board.board_id for board in boards}
        self._rejected_boards: list[BoardLink] = []
        self._topics: dict[BoardId, str] = {}
        self._sample_counts: Counter[BoardId] = Counter()
        self._pump = rig.pump
        self._driver = rig.driver
        new_recorder = environment.new_recorder or (lambda: Recorder(environment.threaded_writer))
        self.recorder = new_recorder()
        self._log = PtuLog(self.recorder, rig.capture)
        self._unit: Unit | None = None
        self._poller: PositionPoller | None = None
        self._steps: list[PlannedStep] = []
        self._replay: RecordedMotion | None = None
        self._steps_done: int | None = None  # None: the program is not running
        self._phases: list[str] = []
        self._timers: list[Timer] = []
        self._open_ns = self._pump.now_ns()
        rig.listener = self

    def prepare(self) -> None:
        """Identify unit and boards, check the program, open the recording."""
        request = self._request
        check_folder(request.out_dir)
        self._driver.identify()  # first: the unit may still be turning
        for board in self.boards:
            board.identify()
        ptu, settings = request.config.ptu, request.program.settings
        homing = Homing.IF_NEEDED if ptu.home_without_asking else Homing.NEVER
        if request.home:
            homing = Homing.ALWAYS
        unit = open_unit(self._driver, settings, homing)
        self._unit = unit
        self._log.set_unit(unit.facts)
        self._poller = poller = PositionPoller(unit, ptu.poll.rate_hz, self._log.record_position)
        start = poller.read_positions()
        self._steps = plan_program(request.program, unit.facts, ptu.limits, start, request.limit_s)
        self._replay = request.replay and plan_replay(request.replay, unit.facts, ptu.limits)
        ReplayExecutor.wait(self._pump, self._replay, self._environment.program_begin_ns)
        self.recorder.open(self._describe_recording(unit))
        self._open_ns = self._pump.now_ns()
        self._sample_counts.clear()
        self._start_timers()
        for _ in Axis:  # the recording has both positions before the first command
            poller.poll()

    @property
    def planned_s(self) -> float:
        """Longest duration of the program, 0 before it is known."""
        return plan_duration_s(self._steps)

    @property
    def angles_rad(self) -> tuple[float, float] | None:
        """Last reported angles of pan and tilt, None before the first report."""
        position = self._log.position
        return None if position is None else (position.pan_rad, position.tilt_rad)

    @property
    def facts(self) -> UnitFacts | None:
        """Capabilities and settings of the unit, None before it was asked."""
        return None if self._unit is None else self._unit.facts

    def remaining_s(self, done_steps: int) -> float:
        """Return the longest duration of the steps after the first `done_steps`."""
        return plan_duration_s(self._steps[done_steps:])

    def summary(self, path: Path) -> SessionSummary:
        """Return what was recorded."""
        duration_s = (self._pump.now_ns() - self._open_ns) * 1e-9
        return SessionSummary(path, duration_s, dict(self._sample_counts))

    def run_program(self) -> None:
        """Run the motion program."""
        if self._unit is None or self._poller is None:
            raise AssertionError("not prepared")  # a bug of this program
        sink = PhaseSink(self._begin_phase, self._end_phase)
        devices = (self._pump, self._unit, self._poller, sink)
        self._show_progress(0)
        if self._replay is None:
            Executor(*devices).run(self._steps, self._show_progress)
        else:
            ReplayExecutor(*devices).run(self._replay, self._environment.program_begin_ns)
        self._steps_done = None

    def finish(self) -> Path:
        """Halt, confirm the standstill, close the recording."""
        if self._unit is None or self._poller is None:
            raise AssertionError("not prepared")  # a bug of this program
        self._pump.ignore_stop()
        halt_and_confirm(self._pump, self._unit, self._poller)
        return self._close()

    def abort_and_close(self, reason: str, can_halt: bool = True) -> list[str]:
        """Halt what moves and keep what was recorded; return what to report."""
        self._pump.ignore_stop()
        return self.abort(reason, can_halt) + self.close_partial()

    def abort(self, reason: str, can_halt: bool = True) -> list[str]:
        """Halt what moves and record the reason; return what to report.

        The recording stays open.
        """
        self._steps_done = None
        try:
            self.recorder.raise_fault()
            self._record_event(EventKind.FAULT, "", reason)
            for phase in reversed(self._phases):
                self._record_event(EventKind.PHASE_END, phase, "aborted")
        except MachineError:
            self.recorder.mute()
        self._phases.clear()
        is_our_unit = self._driver.is_identified or self._unit is not None
        return [self._halt()] if is_our_unit and can_halt else []

    def close_partial(self) -> list[str]:
        """Close what was recorded so far, in whatever state it is; return what to report."""
        if not self.recorder.is_open:
            self._stop_listening()
            return []
        with contextlib.suppress(GyrorigError):
            self._close()
        return [f"the recording up to this time is {self.recorder.path}"]

    def raise_if_boards_lost(self, path: Path) -> None:
        """Raise an error if a board was missing at the end.

        Raises:
            DeviceError: at least one board was missing.
        """
        lost = [f"{b.board_id} ({b.state.value})" for b in self.boards if not b.is_known]
        if lost:
            raise DeviceError(
                f"the motion program ended, but the connection to board {', '.join(lost)} was lost",
                f"check the cable and the power of the board. The recording {path} is kept",
            )

    def handle_exchange(self, exchange: Exchange) -> None:
        """Record an exchange with the unit."""
        self._log.record_exchange(exchange)

    def handle_sample(self, board_id: BoardId, message: ImuRaw, publish_ns: int) -> None:
        """Record a sample."""
        if board_id in self._board_ids:
            topic = self._topics.get(board_id)
            if topic is None:
                topic = self._topics[board_id] = imu_raw_topic(board_id)
            self._sample_counts[board_id] += 1
            self.recorder.put(topic, message, message.host_time_ns, publish_ns)

    def handle_ping(self, board_id: BoardId, message: ClockPing) -> None:
        """Record a board's reply to a time request."""
        if board_id in self._board_ids:
            self.recorder.put(clock_ping_topic(board_id), message, message.host_receive_ns)

    def note(self, text: str) -> None:
        """Record an event that is not a fault."""
        self._record_event(EventKind.NOTE, "", text)

    def fault(self, text: str) -> None:
        """Record a fault."""
        self._record_event(EventKind.FAULT, "", text)

    def check_once_per_second(self) -> None:
        """Add boards that identified themselves late; show the elapsed time."""
        for board in self._rig.boards:
            is_decided = board.board_id in self._board_ids or board in self._rejected_boards
            if not is_decided and board.is_known:
                self._add_late_board(board)
        if self._steps_done is not None:
            self._show_progress(self._steps_done)

    def _add_late_board(self, board: BoardLink) -> None:
        try:
            board.identify()  # returns at once: the board is known
            metadata = {f"gyrorig.board.{board.board_id}": board.metadata()}
        except PortsGoneError:
            raise
        except GyrorigError as fault:  # the recording of the other boards goes on
            self._rejected_boards.append(board)
            self.fault(f"board {board.board_id} cannot take part. {sentence(str(fault))}")
            return
        self._board_ids.add(board.board_id)
        self.boards.append(board)
        utc_ns = self._rig.capture.utc_ns(self._pump.now_ns())
        self.recorder.add_metadata(metadata, hello_attachments(board, utc_ns))
        self.note(f"board {board.board_id} takes part from now on")

    def _halt(self) -> str:
        try:
            if self._unit is not None and self._poller is not None:
                halt_and_confirm(self._pump, self._unit, self._poller)
            else:
                self._driver.halt()
        except GyrorigError as fault:
            return f"the halt of the unit was not confirmed ({fault.problem})"
        return "the unit is halted"

    def _close(self) -> Path:
        """Close the recording while ports and timers are served; a disk may be slow."""
        self._stop_listening()
        if not self._environment.threaded_writer:
            return self.recorder.close()
        timeout_s = self._environment.close_timeout_s
        closing = call_in_thread(lambda: self.recorder.close(timeout_s), "closing")
        with contextlib.suppress(PortsGoneError):
            while not closing.done():
                self._pump.run_until(self._pump.now_ns() + CLOSE_POLL_NS, closing.done)
        return closing.result()

    def _stop_listening(self) -> None:
        for timer in self._timers:
            self._pump.remove_timer(timer)
        self._timers.clear()
        self._rig.listener = None

    def _describe_recording(self, unit: Unit) -> RecordingPlan:
        make_folder(self._request.out_dir)
        return describe_session(
            self._request,
            self._rig.capture,
            self._environment.host,
            unit.facts,
            self.boards,
            self._pump.now_ns(),
        )

    def _start_timers(self) -> None:
        now_ns = self._pump.now_ns()
        recorder, environment, capture = self.recorder, self._environment, self._rig.capture
        self._timers = [
            WriterTimer(recorder, now_ns),
            HostClockTimer(recorder, capture, environment.read_host, now_ns),
            DiagnosticsTimer(
                recorder,
                capture,
                now_ns,
                driver=self._driver,
                controller_clock=lambda: self._log.controller_clock,
                boards=self.boards,
                dropped_bytes=environment.dropped_bytes,
            ),
            _SessionTimer(self, now_ns),
        ]
        for timer in self._timers:
            self._pump.add_timer(timer)

    def _show_progress(self, step: int) -> None:
        self._steps_done = step
        self._environment.progress(step, len(self._steps))

    def _begin_phase(self, phase: str, text: str) -> None:
        self._phases.append(phase)
        self._record_event(EventKind.PHASE_BEGIN, phase, text)

    def _end_phase(self, phase: str, text: str) -> None:
        self._phases.remove(phase)
        self._record_event(EventKind.PHASE_END, phase, text)

    def _record_event(self, kind: EventKind, phase: str, text: str) -> None:
        now_ns = self._rig.capture.utc_ns(self._pump.now_ns())
        event = SessionEvent(now_ns, int(kind), phase, text)
        self.recorder.put_or_hold(SESSION_EVENT_TOPIC, event, now_ns)
        words = f"{phase} {text}".strip()
        self._environment.on_event(kind.name.lower().replace("_", " "), words)


class _SessionTimer:
    """Calls `Session.check_once_per_second`."""

    def __init__(self, session: Session, now_ns: int) -> None:
        self._session = session
        self.due_ns = now_ns + LATE_BOARD_CHECK_NS

    def fire(self, now_ns: int) -> None:
        """Check."""
        self.due_ns = now_ns + LATE_BOARD_CHECK_NS
        self._session.check_once_per_second()
