"""What the daemon says of itself once a second: one document for people, programs and meters.

What to use when: `StatusTimer` in the pump; it hands the document to `Parts.publish`. The
losses in it are by cause and only grow; docs/service.md says what each means.
"""

import math
import os
from dataclasses import asdict
from datetime import UTC, datetime
from typing import Any

from gyrorig_daemon.links.board_link import BoardLink
from gyrorig_daemon.rig import Rig
from gyrorig_daemon.service.parts import Parts
from gyrorig_daemon.service.running import Scene
from gyrorig_daemon.service.unit_watch import UnitWatch
from gyrorig_daemon.service.wall_clock import WallClockTimer
from gyrorig_protocol.recording.writer import software

SCHEMA = "gyrorig/status/1"
PERIOD_NS = 1_000_000_000
MAX_NEXT = 20  # entries of the queue that are named


class StatusTimer:
    """Writes the status once a second."""

    def __init__(
        self,
        rig: Rig,
        parts: Parts,
        scene: Scene,
        unit: UnitWatch,
        wall: WallClockTimer,
        now_ns: int,
    ) -> None:
        """Begin to tell of a rig."""
        self._rig = rig
        self._parts = parts
        self._scene = scene
        self._unit_watch = unit
        self._wall = wall
        self._started_s = parts.clocks.monotonic_s()
        self._samples: dict[str, tuple[int, int]] = {}
        self._due_before_ns = now_ns
        self.due_ns = now_ns

    def fire(self, now_ns: int) -> None:
        """Look at everything and publish it."""
        if now_ns - self.due_ns > PERIOD_NS:
            self._parts.counts.late_turns += 1
        self.due_ns = now_ns + PERIOD_NS
        document = self.document(now_ns)
        self._parts.publish(document)
        reason = f": {document['reason']}" if document["reason"] else ""
        self._parts.notifier.status(f"{document['state']}{reason}")

    def document(self, now_ns: int) -> dict[str, Any]:
        """Return the status as of now."""
        parts, glance, wall = self._parts, self._scene.glance, self._wall
        pump = self._rig.pump
        return {
            "schema": SCHEMA,
            "software": software(),
            "rig": self._rig.config.rig,
            "pid": os.getpid(),
            "utc": _utc(parts.clocks.utc_s()),
            "uptime_s": round(parts.clocks.monotonic_s() - self._started_s, 1),
            "state": glance.state,
            "reason": glance.reason,
            "session": self._session(),
            "last_session": self._scene.last,
            "unit": self._unit(),
            "boards": [self._board(board, now_ns) for board in self._rig.boards],
            "recorder": self._recorder(),
            "queue": self._queue(),
            "schedule": self._schedule(),
            "disk": {"free_bytes": parts.state.free_bytes()},
            "clock": {
                "synchronised": wall.synchronised,
                "frequency_ppm": _number(None if wall.last is None else wall.last.frequency_ppm),
                "estimated_error_s": _number(
                    None if wall.last is None else wall.last.estimated_error_s
                ),
            },
            "kept": asdict(parts.keeper.counts),
            "stalls": {"daemon": pump.stalls, "acquisition": pump.late_stalls},
            "acquisition_dropped_bytes": parts.dropped_bytes(),
            "counts": asdict(parts.counts),
        }

    def _session(self) -> dict[str, Any] | None:
        scene = self._scene
        told, session = scene.glance.session, scene.session
        if told is None:
            return None
        document = dict(told)
        if session is not None and "step" in told:
            now_s = self._parts.clocks.monotonic_s()
            left_s = session.left_s(told["step"]) - (now_s - scene.step_begun_s)
            # a step may take longer than planned: what is left is that of the others then
            left_s = max(left_s, session.left_s(told["step"] + 1), 0.0)
            document["elapsed_s"] = round(now_s - scene.begun_s, 1)
            document["left_s"] = round(left_s, 1)
        return document

    def _unit(self) -> dict[str, Any]:
        client, unit = self._rig.client, self._unit_watch
        counts = client.counts
        counted = asdict(counts)
        reply_wait_max_ns = counted.pop("reply_wait_max_ns")
        poll_wait_max_ns = counted.pop("poll_wait_max_ns")
        session = self._scene.session
        angles = unit.angles_rad if session is None else session.angles_rad
        where = (None, None) if angles is None else [round(math.degrees(a), 4) for a in angles]
        return {
            "state": unit.state.name.lower(),
            "text": unit.why or unit.state.value,
            "port": client.where,
            "steps_are_sure": self._parts.memory.steps_are_sure,
            "pan_deg": where[0],
            "tilt_deg": where[1],
            "counts": counted,
            "reply_wait_max_ms": round(reply_wait_max_ns * 1e-6, 3),
            "poll_wait_max_ms": round(poll_wait_max_ns * 1e-6, 3),
        }

    def _board(self, board: BoardLink, now_ns: int) -> dict[str, Any]:
        name, counts = str(board.board_id), board.counts
        before_ns, before = self._samples.get(name, (now_ns, counts.samples))
        rate_hz = None
        if now_ns > before_ns:
            rate_hz = round((counts.samples - before) / ((now_ns - before_ns) * 1e-9), 1)
        self._samples[name] = now_ns, counts.samples
        clock = board.clock_report()
        late = board.latencies_ns()
        return {
            "id": name,
            "state": board.state.name.lower(),
            "text": board.state.value,
            "rate_hz": rate_hz,
            "latency_ms": None if late is None else round(late[0] * 1e-6, 3),
            "latency_max_ms": None if late is None else round(late[1] * 1e-6, 3),
            "counts": {key: getattr(counts, key) for key in counts.__dataclass_fields__},
            "faults": board.faults(),
            "own": _numbers(board, "board_"),
            "bus": _numbers(board, "bus_"),
            "clock": {
                "mapped": clock.mapped,
                "skew_ppm": _number(clock.skew_ppm),
                "sigma_s": _number(clock.sigma_s),
            },
        }

    def _recorder(self) -> dict[str, Any]:
        session, account = self._scene.session, self._parts.account
        if session is None:
            return {"state": "idle", "path": None, "degraded": "", "counts": account.total(None)}
        recorder = session.recorder
        return {
            "state": recorder.state.value,
            "path": None if recorder.path is None else str(recorder.path),
            "degraded": recorder.degraded,
            "counts": account.total(recorder.counts.values()),
        }

    def _queue(self) -> dict[str, Any]:
        waiting = self._parts.queue.waiting()
        return {
            "waiting": len(waiting),
            "next": waiting[:MAX_NEXT],
            "refused": self._parts.queue.refused,
        }

    def _schedule(self) -> list[dict[str, Any]]:
        clocks, schedule = self._parts.clocks, self._parts.schedule
        now_s, utc_s = clocks.monotonic_s(), clocks.utc_s()
        return [
            {"name": entry.name, "due_in_s": round(schedule.next_s(entry, now_s, utc_s))}
            for entry in schedule.entries
        ]


def _numbers(board: BoardLink, prefix: str) -> dict[str, int]:
    """Return what a board counts itself, or its bus, out of its link's values."""
    return {
        key.removeprefix(prefix): int(value)
        for key, value in board.values().items()
        if key.startswith(prefix)
    }


def _utc(utc_s: float) -> str:
    return datetime.fromtimestamp(utc_s, UTC).isoformat(timespec="seconds")


def _number(value: float | None) -> float | None:
    """Return a number that JSON has, None for what is none."""
    return value if value is not None and abs(value) < 1e300 else None
