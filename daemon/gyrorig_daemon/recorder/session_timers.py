"""Timers of a session: host clocks and diagnostics, recorded once per second."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields

from gyrorig_daemon.clocks import ClockReport, OnlineClock
from gyrorig_daemon.clocks.capture_clock import CaptureClock, HostClocks
from gyrorig_daemon.links.boards.board_link import BoardLink
from gyrorig_daemon.motion import PanTiltDriver
from gyrorig_daemon.recorder.recorder import Recorder
from gyrorig_protocol.recording.clock_messages import HOST_CLOCK_TOPIC, HostClock
from gyrorig_protocol.recording.messages import DIAGNOSTICS_TOPIC
from gyrorig_protocol.recording.standard_messages import (
    DiagnosticLevel,
    Diagnostics,
    DiagnosticStatus,
)

PERIOD_NS = 1_000_000_000
TICK_NS = 200_000_000
_NOT_COUNTERS = ("reply_wait_max_ns", "poll_wait_max_ns")
_CLOCK_COUNTERS = ("windows", "late_windows", "early_windows", "steps", "restarts")


class HostClockTimer:
    """Records `/host/clock` once per second."""

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
    """Drives the writer if it has no thread, and raises its errors."""

    def __init__(self, recorder: Recorder, start_ns: int) -> None:
        self._recorder = recorder
        self.due_ns = start_ns

    def fire(self, now_ns: int) -> None:
        """Let the writer work."""
        self.due_ns = now_ns + TICK_NS
        if self._recorder.is_open:
            self._recorder.tick(now_ns)


class DiagnosticsTimer:
    """Records `/diagnostics` once per second: losses by cause, clocks, queues.

    A rig is used for several sessions, and its counters continue; the counts of this session are
    recorded.
    """

    def __init__(
        self,
        recorder: Recorder,
        capture: CaptureClock,
        start_ns: int,
        *,
        boards: Sequence[BoardLink],
        dropped_bytes: Callable[[], int],
        driver: PanTiltDriver | None = None,
        controller_clock: Callable[[], OnlineClock | None] = lambda: None,
    ) -> None:
        """Start at the begin of a session; earlier counts are subtracted.

        Args:
            recorder: of the session.
            capture: the clock of the receive times.
            start_ns: begin of the session.
            boards: of the rig.
            dropped_bytes: how many bytes the acquisition has dropped.
            driver: of the pan-tilt unit; None: a person turns the boards.
            controller_clock: the map of the unit's clock.
        """
        self._recorder = recorder
        self._capture = capture
        self._driver = driver
        self._controller_clock = controller_clock
        self._boards = boards
        self._dropped_bytes = dropped_bytes
        self._initial_counts: dict[str, dict[str, int]] = {}
        self.due_ns = start_ns
        self._statuses()  # stores the initial values

    def fire(self, now_ns: int) -> None:
        """Record the diagnostics."""
        self.due_ns = now_ns + PERIOD_NS
        stamp_ns = self._capture.utc_ns(now_ns)
        statuses = tuple(self._statuses())
        self._recorder.put(DIAGNOSTICS_TOPIC, Diagnostics(stamp_ns, statuses), stamp_ns)

    def _statuses(self) -> list[DiagnosticStatus]:
        statuses = [self._recorder_status()]
        if self._driver is not None:
            statuses.append(self._ptu_status(self._driver))
        controller = self._controller_clock()
        if controller is not None:
            statuses.append(self._clock_status("clock/ptu", controller.report()))
        for board in self._boards:
            statuses.append(self._board_status(board))
            statuses.append(self._clock_status(f"clock/{board.board_id}", board.clock_report()))
        return statuses

    def _growth(self, name: str, counts: Mapping[str, int]) -> dict[str, int]:
        """Return the increase of counters since the start of the session."""
        initial = self._initial_counts.setdefault(name, dict(counts))
        growth = {key: count - initial.get(key, 0) for key, count in counts.items()}
        # The counters of a new clock map start at 0.
        return {key: counts[key] if increase < 0 else increase for key, increase in growth.items()}

    def _recorder_status(self) -> DiagnosticStatus:
        recorder = self._recorder
        dropped = self._growth("recorder", {"bytes": self._dropped_bytes()})["bytes"]
        level, text = DiagnosticLevel.OK, "nothing lost"
        if recorder.counts.lost + dropped:
            level, text = DiagnosticLevel.ERROR, "data were lost between the ports and the file"
        if recorder.degraded_reason:
            level, text = DiagnosticLevel.ERROR, recorder.degraded_reason
        values = {
            "messages_dropped": recorder.counts.lost,
            "messages_written": recorder.counts.written,
            "acquisition_bytes_dropped": dropped,
        } | recorder.counts.values()
        return DiagnosticStatus(level, "recorder", text, values=_as_text(values))

    def _ptu_status(self, driver: PanTiltDriver) -> DiagnosticStatus:
        counts = driver.counts
        names = [field.name for field in fields(counts) if field.name not in _NOT_COUNTERS]
        values = self._growth("ptu", {name: getattr(counts, name) for name in names})
        lost_synchrony = driver.lost_synchrony
        level, text = DiagnosticLevel.OK, "answers"
        if values["timeouts"] + values["garbled"] + values["frame_errors"] + values["hung_up"]:
            level, text = DiagnosticLevel.WARN, "some answers were lost or garbled"
        if lost_synchrony is not None:
            level, text = (
                DiagnosticLevel.ERROR,
                f"the unit no longer knows its position: {lost_synchrony}",
            )
        texts = _as_text(values) | {
            "reply_wait_max_ms": f"{counts.reply_wait_max_ns * 1e-6:.3f}",
            "poll_wait_max_ms": f"{counts.poll_wait_max_ns * 1e-6:.3f}",
        }
        return DiagnosticStatus(level, "ptu", text, driver.location, texts)

    def _board_status(self, board: BoardLink) -> DiagnosticStatus:
        name, faults = f"board/{board.board_id}", board.faults()
        link_counts = {
            field.name: getattr(board.counts, field.name) for field in fields(board.counts)
        }
        link_counts |= {f"fault_{cause}": count for cause, count in faults.items()}
        counts = self._growth(name, link_counts)
        damaged = sum(counts[f"fault_{cause}"] for cause in faults)
        level, text = DiagnosticLevel.OK, board.state.value
        if counts["missing"] or counts["restarts"] or counts["hung_up"] or damaged:
            level, text = DiagnosticLevel.WARN, "samples were lost or frames damaged"
        if not board.is_known:
            level, text = DiagnosticLevel.ERROR, board.state.value
        values = board.values() | _as_text(counts)
        return DiagnosticStatus(level, name, text, str(board.board_id), values)

    def _clock_status(self, name: str, report: ClockReport) -> DiagnosticStatus:
        counts = self._growth(name, {key: getattr(report, key) for key in _CLOCK_COUNTERS})
        level, text = DiagnosticLevel.OK, "mapped"
        if not report.mapped:
            level, text = (
                DiagnosticLevel.WARN,
                ("the clock is not mapped yet, so publish_time is the arrival time"),
            )
        elif counts["early_windows"] or counts["steps"] or counts["restarts"]:
            level, text = DiagnosticLevel.WARN, "the clock is mapped, but it had faults"
        values = {
            "offset_s": _number(report.offset_s),
            "skew_ppm": f"{report.skew_ppm:.6f}",
            "sigma_s": _number(report.sigma_s),
        } | _as_text(counts)
        if report.two_way_low_s is not None and report.two_way_high_s is not None:
            values["two_way_low_s"] = _number(report.two_way_low_s)
            values["two_way_high_s"] = _number(report.two_way_high_s)
            values["correction_s"] = _number(report.correction_s)
        return DiagnosticStatus(level, name, text, values=values)


def _as_text(values: Mapping[str, int]) -> dict[str, str]:
    return {name: str(value) for name, value in values.items()}


def _number(value: float) -> str:
    return f"{value:.9f}" if math.isfinite(value) else "unknown"
