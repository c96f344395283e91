"""Publisher of the service's status: one document per second for people, programs and metrics.

What to use when: `StatusPublisher` as a timer of the pump. It passes the document to
`ServiceContext.publish`. Losses are cumulative and sorted by cause; docs/service.md explains them.
"""

import math
import os
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any

from gyrorig_daemon.links.boards.board_link import BoardLink
from gyrorig_daemon.service.service_context import ServiceContext
from gyrorig_daemon.service.session_runner import ServiceState
from gyrorig_daemon.service.system_clock_monitor import SystemClockMonitor
from gyrorig_daemon.service.unit_monitor import UnitMonitor
from gyrorig_daemon.session.connected_rig import Rig
from gyrorig_protocol.recording.writer import software_version

SCHEMA = "gyrorig/status/1"
PUBLISH_PERIOD_NS = 1_000_000_000
MAX_LISTED_JOBS = 20


class StatusPublisher:
    """Publishes the status once per second."""

    def __init__(
        self,
        rig: Rig,
        context: ServiceContext,
        state: ServiceState,
        unit_monitor: UnitMonitor,
        clock_monitor: SystemClockMonitor,
        now_ns: int,
    ) -> None:
        """Start to publish the status of a rig."""
        self._rig = rig
        self._context = context
        self._state = state
        self._unit_monitor = unit_monitor
        self._clock_monitor = clock_monitor
        self._started_s = context.clocks.monotonic_s()
        self._samples: dict[str, tuple[int, int]] = {}
        self.due_ns = now_ns

    def fire(self, now_ns: int) -> None:
        """Collect the status and publish it."""
        if now_ns - self.due_ns > PUBLISH_PERIOD_NS:
            self._context.counts.late_turns += 1
        self.due_ns = now_ns + PUBLISH_PERIOD_NS
        self._write_pending_state()
        document = self.document(now_ns)
        self._context.publish(document)
        reason = f": {document['reason']}" if document["reason"] else ""
        self._context.notifier.send_status(f"{document['state']}{reason}")

    def _write_pending_state(self) -> None:
        """Write the state files again that the disk has not accepted; count the failures.

        Not while a unit may move: a failing disk can need seconds to refuse a write.
        """
        context = self._context
        if self._state.summary.state == "running":
            return
        for file in (context.persistent.file, context.schedule.file):
            file.write_pending()
            context.counts.state_write_failures += file.take_failures()

    def document(self, now_ns: int) -> dict[str, Any]:
        """Return the status as of now."""
        context, summary, clock_monitor = self._context, self._state.summary, self._clock_monitor
        pump = self._rig.pump
        return {
            "schema": SCHEMA,
            "software": software_version(),
            "rig": self._rig.config.rig,
            "pid": os.getpid(),
            "utc": _utc(context.clocks.utc_s()),
            "uptime_s": round(context.clocks.monotonic_s() - self._started_s, 1),
            "state": summary.state,
            "reason": summary.reason,
            "session": self._session(),
            "last_session": self._state.last_session,
            "experiment": self._state.experiment(),
            "unit": self._unit(),
            "boards": [self._board(board, now_ns) for board in self._rig.boards],
            "recorder": self._recorder(),
            "queue": self._queue(),
            "schedule": self._schedule(),
            "disk": {"free_bytes": context.state_folder.free_bytes()},
            "clock": {
                "synchronised": clock_monitor.is_synchronised,
                "frequency_ppm": _finite_or_none(
                    None
                    if clock_monitor.last_reading is None
                    else clock_monitor.last_reading.frequency_ppm
                ),
                "estimated_error_s": _finite_or_none(
                    None
                    if clock_monitor.last_reading is None
                    else clock_monitor.last_reading.estimated_error_s
                ),
            },
            "kept": asdict(context.housekeeping.counts),
            "stalls": {"daemon": pump.stalls, "acquisition": pump.late_stalls},
            "acquisition_dropped_bytes": context.dropped_bytes(),
            "counts": asdict(context.counts),
        }

    def _session(self) -> dict[str, Any] | None:
        state = self._state
        session_summary, session = state.summary.session, state.session
        if session_summary is None:
            return None
        document = dict(session_summary)
        if session is not None and "step" in session_summary:
            now_s = self._context.clocks.monotonic_s()
            left_s = session.remaining_s(session_summary["step"]) - (now_s - state.step_start_s)
            # a step can take longer than planned: then only the other steps remain
            left_s = max(left_s, session.remaining_s(session_summary["step"] + 1), 0.0)
            document["elapsed_s"] = round(now_s - state.motion_start_s, 1)
            document["left_s"] = round(left_s, 1)
        return document

    def _unit(self) -> dict[str, Any]:
        driver, monitor = self._rig.driver, self._unit_monitor
        counts = driver.counts
        line_counts = asdict(counts)
        reply_wait_max_ns = line_counts.pop("reply_wait_max_ns")
        poll_wait_max_ns = line_counts.pop("poll_wait_max_ns")
        session = self._state.session
        angles = monitor.angles_rad if session is None else session.angles_rad
        angles_deg = (None, None) if angles is None else [round(math.degrees(a), 4) for a in angles]
        return {
            "state": monitor.state.name.lower(),
            "text": monitor.reason or monitor.state.value,
            "port": driver.location,
            "steps_are_sure": self._context.persistent.steps_are_sure,
            "pan_deg": angles_deg[0],
            "tilt_deg": angles_deg[1],
            "counts": line_counts,
            "reply_wait_max_ms": round(reply_wait_max_ns * 1e-6, 3),
            "poll_wait_max_ms": round(poll_wait_max_ns * 1e-6, 3),
        }

    def _board(self, board: BoardLink, now_ns: int) -> dict[str, Any]:
        name, counts = str(board.board_id), board.counts
        earlier_ns, earlier_samples = self._samples.get(name, (now_ns, counts.samples))
        rate_hz = None
        if now_ns > earlier_ns:
            rate_hz = round((counts.samples - earlier_samples) / ((now_ns - earlier_ns) * 1e-9), 1)
        self._samples[name] = now_ns, counts.samples
        clock = board.clock_report()
        latencies_ns = board.latencies_ns()
        return {
            "id": name,
            "state": board.state.name.lower(),
            "text": board.state.value,
            "rate_hz": rate_hz,
            "latency_ms": None if latencies_ns is None else round(latencies_ns[0] * 1e-6, 3),
            "latency_max_ms": None if latencies_ns is None else round(latencies_ns[1] * 1e-6, 3),
            "counts": {key: getattr(counts, key) for key in counts.__dataclass_fields__},
            "faults": board.faults(),
            "own": _counters_with_prefix(board, "board_"),
            "bus": _counters_with_prefix(board, "bus_"),
            "clock": {
                "mapped": clock.mapped,
                "skew_ppm": _finite_or_none(clock.skew_ppm),
                "sigma_s": _finite_or_none(clock.sigma_s),
            },
        }

    def _recorder(self) -> dict[str, Any]:
        session, totals = self._state.session, self._context.recorder_totals
        if session is None:
            return {"state": "idle", "path": None, "degraded": "", "counts": totals.total(None)}
        recorder = session.recorder
        return {
            "state": recorder.state.value,
            "path": None if recorder.path is None else str(recorder.path),
            "degraded": recorder.degraded_reason,
            "counts": totals.total(recorder.counts.values()),
        }

    def _queue(self) -> dict[str, Any]:
        waiting = self._context.queue.waiting_jobs()
        return {
            "waiting": len(waiting),
            "next": waiting[:MAX_LISTED_JOBS],
            "refused": self._context.queue.rejected_count,
        }

    def _schedule(self) -> list[dict[str, Any]]:
        clocks, schedule = self._context.clocks, self._context.schedule
        now_s, utc_s = clocks.monotonic_s(), clocks.utc_s()
        return [
            {"name": entry.name, "due_in_s": round(schedule.seconds_until_due(entry, now_s, utc_s))}
            for entry in schedule.entries
        ]


def _counters_with_prefix(board: BoardLink, prefix: str) -> dict[str, int]:
    """Return the counters of a board or its bus, by their prefix in the link's values."""
    return {
        key.removeprefix(prefix): int(value)
        for key, value in board.values().items()
        if key.startswith(prefix)
    }


def _utc(utc_s: float) -> str:
    return datetime.fromtimestamp(utc_s, UTC).isoformat(timespec="seconds")


def _finite_or_none(value: float | None) -> float | None:
    """Return a number that JSON can represent, otherwise None."""
    return value if value is not None and abs(value) < 1e300 else None
