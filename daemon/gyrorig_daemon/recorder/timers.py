"""What a session records once a second: the host's clocks, and how everything does."""

import math
from collections.abc import Callable, Sequence

from gyrorig_daemon.clocks import ClockReport, OnlineClock
from gyrorig_daemon.links.board_link import BoardLink
from gyrorig_daemon.links.capture_clock import CaptureClock, HostClocks
from gyrorig_daemon.motion import PtuClient
from gyrorig_daemon.recorder.recorder import Recorder
from gyrorig_protocol.recording.messages import DIAGNOSTICS_TOPIC, HOST_CLOCK_TOPIC, HostClock
from gyrorig_protocol.recording.standard_messages import (
    DiagnosticLevel,
    Diagnostics,
    DiagnosticStatus,
)

PERIOD_NS = 1_000_000_000
TICK_NS = 200_000_000


class HostClockTimer:
    """`/host/clock`, once a second."""

    def __init__(
        self,
        recorder: Recorder,
        capture: CaptureClock,
        read: Callable[[], HostClocks],
        start_ns: int,
    ) -> None:
        self._recorder = recorder
        self._capture = capture
        self._read = read
        self.due_ns = start_ns

    def fire(self, now_ns: int) -> None:
        """Read the clocks and record them."""
        self.due_ns = now_ns + PERIOD_NS
        clocks = self._read()
        self._recorder.put(
            HOST_CLOCK_TOPIC,
            HostClock(
                monotonic_raw_ns=clocks.raw_ns,
                monotonic_ns=clocks.monotonic_ns,
                realtime_ns=clocks.realtime_ns,
                frequency_ppm=clocks.frequency_ppm,
                estimated_error_s=clocks.estimated_error_s,
                ntp_status=clocks.ntp_status,
            ),
            self._capture.utc_ns(now_ns),
        )


class WriterTimer:
    """Gives the writer its turn where it has no thread, and looks for its faults."""

    def __init__(self, recorder: Recorder, start_ns: int) -> None:
        self._recorder = recorder
        self.due_ns = start_ns

    def fire(self, now_ns: int) -> None:
        """Flush what is due."""
        self.due_ns = now_ns + TICK_NS
        if self._recorder.is_open:
            self._recorder.tick(now_ns)


class DiagnosticsTimer:
    """`/diagnostics`, once a second: losses by cause, clocks, queues."""

    def __init__(
        self,
        recorder: Recorder,
        capture: CaptureClock,
        start_ns: int,
        *,
        client: PtuClient,
        controller_clock: Callable[[], OnlineClock | None],
        boards: Sequence[BoardLink],
        dropped_bytes: Callable[[], int],
    ) -> None:
        self._recorder = recorder
        self._capture = capture
        self._client = client
        self._controller_clock = controller_clock
        self._boards = boards
        self._dropped_bytes = dropped_bytes
        self.due_ns = start_ns

    def fire(self, now_ns: int) -> None:
        """Look at everything and record it."""
        self.due_ns = now_ns + PERIOD_NS
        stamp_ns = self._capture.utc_ns(now_ns)
        status = [self._recorder_status(), self._ptu_status()]
        controller = self._controller_clock()
        if controller is not None:
            status.append(_clock_status("clock/ptu", controller.report()))
        for board in self._boards:
            status.append(_board_status(board))
            status.append(_clock_status(f"clock/{board.board_id}", board.clock_report()))
        self._recorder.put(DIAGNOSTICS_TOPIC, Diagnostics(stamp_ns, tuple(status)), stamp_ns)

    def _recorder_status(self) -> DiagnosticStatus:
        lost = self._recorder.dropped + self._dropped_bytes()
        return DiagnosticStatus(
            DiagnosticLevel.ERROR if lost else DiagnosticLevel.OK,
            "recorder",
            "data were lost between the ports and the file" if lost else "nothing lost",
            values={
                "queue_high_water": str(self._recorder.high_water),
                "messages_dropped": str(self._recorder.dropped),
                "messages_written": str(self._recorder.written),
                "acquisition_bytes_dropped": str(self._dropped_bytes()),
            },
        )

    def _ptu_status(self) -> DiagnosticStatus:
        counts = self._client.counts
        lost = self._client.lost_synchrony
        level, text = DiagnosticLevel.OK, "answers"
        if counts.timeouts + counts.garbled + counts.frame_errors:
            level, text = DiagnosticLevel.WARN, "some answers were lost or garbled"
        if lost is not None:
            level, text = DiagnosticLevel.ERROR, f"synchrony lost: {lost}"
        values = {
            name: str(getattr(counts, name))
            for name in (
                "exchanges",
                "polls",
                "timeouts",
                "garbled",
                "stale",
                "frame_errors",
                "refused",
                "limit_flags",
                "hung_up",
            )
        }
        values["reply_wait_max_ms"] = f"{counts.reply_wait_max_ns * 1e-6:.3f}"
        return DiagnosticStatus(level, "ptu", text, self._client.where, values)


def _board_status(board: BoardLink) -> DiagnosticStatus:
    counts, faults = board.counts, board.faults()
    level, text = DiagnosticLevel.OK, board.state.value
    if counts.missing or counts.restarts or counts.hung_up or sum(faults.values()):
        level, text = DiagnosticLevel.WARN, "samples were lost or frames damaged"
    if not board.known:
        level, text = DiagnosticLevel.ERROR, board.state.value
    values = board.values()
    return DiagnosticStatus(level, f"board/{board.board_id}", text, str(board.board_id), values)


def _clock_status(name: str, report: ClockReport) -> DiagnosticStatus:
    level, text = DiagnosticLevel.OK, "mapped"
    if not report.mapped:
        level, text = DiagnosticLevel.WARN, "no map yet: publish_time is the arrival"
    elif report.early_windows or report.steps or report.restarts:
        level, text = DiagnosticLevel.WARN, "mapped, after faults of the clock"
    values = {
        "offset_s": _number(report.offset_s),
        "skew_ppm": f"{report.skew_ppm:.6f}",
        "sigma_s": _number(report.sigma_s),
        "windows": str(report.windows),
        "late_windows": str(report.late_windows),
        "early_windows": str(report.early_windows),
        "steps": str(report.steps),
        "restarts": str(report.restarts),
    }
    if report.two_way_low_s is not None and report.two_way_high_s is not None:
        values["two_way_low_s"] = _number(report.two_way_low_s)
        values["two_way_high_s"] = _number(report.two_way_high_s)
        values["correction_s"] = _number(report.correction_s)
    return DiagnosticStatus(level, name, text, values=values)


def _number(value: float) -> str:
    return f"{value:.9f}" if math.isfinite(value) else "unknown"
