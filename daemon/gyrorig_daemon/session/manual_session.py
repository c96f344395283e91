"""A session in which a person turns the boards, guided and checked step by step.

The program has rests and turns (`program.Turn`). Each step is announced in one line, and a turn is
counted down. Afterwards its samples are checked. A phase that is not good is recorded as aborted,
which the solver ignores, and repeated.

What to use when: `record_by_hand` where `ptu` of the rig file has `driver: manual`. The lines go to
`say`, and to the port of the unit if it exists: an emulated person reads them there.
"""

import json
import math
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.config import PTU_PORT
from gyrorig_daemon.links.boards.board_factory import make_board_links
from gyrorig_daemon.links.boards.sample_stream import BoardSinks
from gyrorig_daemon.links.ports.port_hub import PortHub
from gyrorig_daemon.links.pump import Pump, Timer
from gyrorig_daemon.motion.manual_checks import JudgedPhase, RateWindow, check_rest, check_turn
from gyrorig_daemon.recorder import Recorder
from gyrorig_daemon.recorder.session_timers import DiagnosticsTimer, HostClockTimer, WriterTimer
from gyrorig_daemon.session.session_description import (
    SessionRequest,
    check_folder,
    describe_session,
    make_folder,
)
from gyrorig_daemon.session.session_environment import SessionEnvironment, SessionSummary
from gyrorig_protocol.errors import DeviceError, GyrorigError
from gyrorig_protocol.identity import BoardId
from gyrorig_protocol.program import Rest, Turn, unroll_manual_steps
from gyrorig_protocol.recording.clock_messages import ClockPing, clock_ping_topic
from gyrorig_protocol.recording.messages import (
    SESSION_EVENT_TOPIC,
    EventKind,
    ImuRaw,
    SessionEvent,
    imu_raw_topic,
)

FloatArray = NDArray[np.float64]

MAX_ATTEMPTS = 5  # of one step
COUNTDOWN_S = 3
POSE_S = 6.0  # to place the board in another way
SETTLE_S = 1.0  # from the end of a motion to a rest
LATENCY_S = 0.3  # until the last samples of a phase have arrived
ABORTED = "aborted"  # the solver ignores phases that end with this text


def record_by_hand(hub: PortHub, request: SessionRequest, environment: SessionEnvironment) -> Path:
    """Record one session that a person executes, and return the path of the recording.

    Arguments and errors as in `session.record_session`.
    """
    session = ManualSession(hub, request, environment)
    try:
        session.prepare()
        session.run_program()
    except GyrorigError as fault:
        path = session.close_after_fault(fault.problem)
        path_text = f"The recording up to this time is {path}." if path else ""
        remedy = f"{fault.remedy}. {path_text}" if fault.remedy else path_text
        raise type(fault)(fault.problem, remedy.strip().removesuffix(".")) from fault
    except BaseException as fault:
        session.close_after_fault(type(fault).__name__)
        raise
    path = session.recorder.close()
    environment.on_summary(session.summary(path))
    return path


class ManualSession:
    """One session of a person: boards, recording, and the steps of the program."""

    def __init__(
        self, hub: PortHub, request: SessionRequest, environment: SessionEnvironment
    ) -> None:
        self._request, self._environment = request, environment
        self._steps = list(unroll_manual_steps(request.program.steps, request.program.name))
        self._pump = Pump(hub, environment.stop)
        self._capture = environment.capture
        new_recorder = environment.new_recorder or (lambda: Recorder(environment.threaded_writer))
        self.recorder = new_recorder()
        sinks = BoardSinks(self._handle_sample, self._handle_ping, self._note, self._fault)
        self._boards = make_board_links(
            self._pump, request.config, self._capture, sinks, environment.seed
        )
        self._listens = PTU_PORT in request.config.ports()  # an emulated person
        self._windows: dict[BoardId, RateWindow] = {}
        self._scales: dict[BoardId, float] = {}
        self._biases: dict[BoardId, FloatArray] = {}
        self._counts: Counter[BoardId] = Counter()
        self._axis_up: tuple[float, float, float] | None = None
        self._open_phases: list[str] = []
        self._phase_end_ns = 0  # of the last phase, UTC
        self._open_ns = self._pump.now_ns()

    def prepare(self) -> None:
        """Identify the boards and open the recording."""
        check_folder(self._request.out_dir)
        for board in self._boards:
            board.identify()
            self._scales[board.board_id] = float(board.metadata()["gyro_scale_rad_s"])
        make_folder(self._request.out_dir)
        now_ns, environment = self._pump.now_ns(), self._environment
        self.recorder.open(
            describe_session(
                self._request, self._capture, environment.host, None, self._boards, now_ns
            )
        )
        self._open_ns = now_ns
        self._counts.clear()
        timers: list[Timer] = [
            WriterTimer(self.recorder, now_ns),
            HostClockTimer(self.recorder, self._capture, environment.read_host, now_ns),
            DiagnosticsTimer(
                self.recorder,
                self._capture,
                now_ns,
                boards=self._boards,
                dropped_bytes=environment.dropped_bytes,
            ),
        ]
        for timer in timers:
            self._pump.add_timer(timer)

    def run_program(self) -> None:
        """Guide the person through all steps.

        Raises:
            DeviceError: a step was not good after several attempts, or a board is lost.
            StopRequestedError: the process was asked to stop.
        """
        self._begin_phase("program", "")
        for number, step in enumerate(self._steps):
            self._environment.progress(number, len(self._steps))
            self._run_step(step, number + 1)
        self._environment.progress(len(self._steps), len(self._steps))
        self._end_phase("program", "")
        self._say("The program is finished.")

    def summary(self, path: Path) -> SessionSummary:
        """Return what was recorded."""
        duration_s = (self._pump.now_ns() - self._open_ns) * 1e-9
        return SessionSummary(path, duration_s, dict(self._counts))

    def close_after_fault(self, reason: str) -> Path | None:
        """Record the reason and close what was recorded; return its path."""
        self._pump.ignore_stop()
        if not self.recorder.is_open:
            return None
        self.recorder.raise_fault()
        self._record_event(EventKind.FAULT, "", reason)
        for phase in reversed(self._open_phases):
            self._record_event(EventKind.PHASE_END, phase, ABORTED)
        return self.recorder.close()

    # Steps

    def _run_step(self, step: Rest | Turn, number: int) -> None:
        for _ in range(MAX_ATTEMPTS):
            judged = self._turn(step) if isinstance(step, Turn) else self._rest(step)
            reasons = {
                f"{board}: {reason}" if len(judged) > 1 else reason
                for board, phase in judged.items()
                for reason in phase.reasons
            }
            if not reasons:
                return
            text = ", and ".join(sorted(reasons))
            self._note(f"step {number} is repeated: {text}")
            self._say(f"Not good: {text}. Again.")
        raise DeviceError(
            f"step {number} of the motion program was not good in {MAX_ATTEMPTS} attempts",
            "check that the board can be turned freely and that the full scale of its gyroscope "
            "is larger than the rate of the turn, then record again",
        )

    def _rest(self, step: Rest) -> dict[BoardId, JudgedPhase]:
        self._say(f"Keep the board still for {step.seconds:g} s.")
        self._wait(SETTLE_S)
        windows = self._record_phase(step.phase, "", step.seconds)
        judged = {
            board: check_rest(window, self._scales[board]) for board, window in windows.items()
        }
        self._finish_phase(step.phase, judged)
        for board, phase in judged.items():
            if not phase.reasons:
                self._biases[board] = phase.mean_rad_s
        return judged

    def _turn(self, step: Turn) -> dict[BoardId, JudgedPhase]:
        up = step.axis
        if up != self._axis_up:
            self._say(f"Place the board with its {axis_name(up)} axis up.")
            self._axis_up = up
            self._wait(POSE_S)
        self._say(
            f"Turn the board by {step.angle_deg:+g} deg about {axis_name(up)} within "
            f"{step.seconds:g} s."
        )
        for count in range(COUNTDOWN_S, 0, -1):
            self._say(f"{count}")
            self._wait(1.0)
        text = json.dumps(
            {
                "axis": list(step.axis),
                "angle_rad": math.radians(step.angle_deg),
                "std_rad": math.radians(step.std_deg),
            }
        )
        windows = self._record_phase("turn", text, step.seconds, start_line="go")
        judged = {
            board: check_turn(
                window, self._scales[board], step, self._biases.get(board, np.zeros(3))
            )
            for board, window in windows.items()
        }
        self._finish_phase("turn", judged)
        return judged

    def _record_phase(
        self, phase: str, text: str, seconds: float, start_line: str = ""
    ) -> dict[BoardId, RateWindow]:
        """Record a phase, and return its samples by board; `_finish_phase` records its end."""
        self._begin_phase(phase, text)
        begin_ns = self._pump.now_ns()
        end_ns = begin_ns + round(seconds * 1e9)
        span_ns = self._capture.utc_ns(begin_ns), self._capture.utc_ns(end_ns)
        self._windows = {board.board_id: RateWindow(*span_ns) for board in self._boards}
        if start_line:
            self._say(start_line)
        self._pump.run_until(end_ns)
        self._phase_end_ns = self._capture.utc_ns(self._pump.now_ns())
        self._wait(LATENCY_S)
        windows, self._windows = self._windows, {}
        return windows

    def _finish_phase(self, phase: str, judged: dict[BoardId, JudgedPhase]) -> None:
        """Record the end of a phase at the time at which it ended."""
        is_good = not any(other.reasons for other in judged.values())
        self._end_phase(phase, "" if is_good else ABORTED, self._phase_end_ns)

    def _wait(self, seconds: float) -> None:
        self._pump.run_until(self._pump.now_ns() + round(seconds * 1e9))

    def _say(self, line: str) -> None:
        self._environment.say(line)
        if self._listens:
            self._pump.write(PTU_PORT, line.encode() + b"\n")

    # Messages

    def _handle_sample(self, board: BoardId, message: ImuRaw, taken_ns: int) -> None:
        self._counts[board] += 1
        if self._windows:
            self._windows[board].add(message, taken_ns)
        if self.recorder.is_open:
            self.recorder.put(imu_raw_topic(board), message, message.host_time_ns, taken_ns)

    def _handle_ping(self, board: BoardId, message: ClockPing) -> None:
        if self.recorder.is_open:
            self.recorder.put(clock_ping_topic(board), message, message.host_receive_ns)

    def _note(self, text: str) -> None:
        self._record_event(EventKind.NOTE, "", text)

    def _fault(self, text: str) -> None:
        self._record_event(EventKind.FAULT, "", text)

    def _begin_phase(self, phase: str, text: str) -> None:
        self._open_phases.append(phase)
        self._record_event(EventKind.PHASE_BEGIN, phase, text)

    def _end_phase(self, phase: str, text: str, at_utc_ns: int | None = None) -> None:
        self._open_phases.remove(phase)
        self._record_event(EventKind.PHASE_END, phase, text, at_utc_ns)

    def _record_event(
        self, kind: EventKind, phase: str, text: str, at_utc_ns: int | None = None
    ) -> None:
        now_ns = self._capture.utc_ns(self._pump.now_ns())
        event = SessionEvent(at_utc_ns or now_ns, int(kind), phase, text)
        self.recorder.put_or_hold(SESSION_EVENT_TOPIC, event, now_ns)
        self._environment.on_event(kind.name.lower().replace("_", " "), f"{phase} {text}".strip())


def axis_name(axis: Sequence[float]) -> str:
    """Return an axis as words: `+z`, or its components."""
    for name, component in zip("xyz", axis, strict=True):
        if abs(component) > 1.0 - 1e-9:
            return f"{'+' if component > 0 else '-'}{name}"
    return f"[{', '.join(f'{component:g}' for component in axis)}]"
