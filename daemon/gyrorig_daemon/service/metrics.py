"""Prometheus metrics: the status as a file for a node exporter's textfile collector.

What to use when: `MetricsWriter` as one of the receivers of the status. A separate thread
replaces the file in one step, so that a slow disk delays nothing. The file should be on another
disk than the recordings, best in memory, because a failed disk could not report itself. Names
follow the rules of Prometheus: `_total` for cumulative counters, all others are gauges.
"""

import math
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gyrorig_daemon.service.recording_policy import is_cumulative
from gyrorig_daemon.service.state_folder import apply_umask, tolerate_unwritable_disk
from gyrorig_protocol.atomic_files import write_atomically
from gyrorig_protocol.errors import MachineError

FILE_NAME = "gyrorig.prom"
SERVICE_STATES = (
    "starting",
    "waiting",
    "ready",
    "running",
    "explaining",
    "fault",
    "stopping",
)
HOUSEKEEPING_GAUGES = ("kept_for_calibrations",)
FILE_MODE = 0o644  # the node exporter runs as another user
JOIN_TIMEOUT_S = 2.0
_ESCAPES = str.maketrans({"\\": r"\\", '"': r"\"", "\n": r"\n"})


class MetricsWriter:
    """Writes the latest published status to a file, from a separate thread."""

    def __init__(self, folder: Path, every: int = 15) -> None:
        """Start the thread.

        Args:
            folder: the folder of the file; created if it is missing.
            every: write every n-th status. One is published per second, Prometheus reads about
                every 15 s, and writes wear out a memory card.

        Raises:
            MachineError: the folder cannot be created.
        """
        try:
            with tolerate_unwritable_disk():  # the thread tries again
                folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise MachineError(
                f"the metrics cannot be written to the folder {folder} ({error.strerror})",
                "choose another folder with --metrics",
            ) from error
        self.path = folder / FILE_NAME
        self.write_failures = 0
        self._every = every
        self._published = 0
        self._condition = threading.Condition()  # never held while writing
        self._pending: dict[str, Any] | None = None
        self._is_writing = False
        self._closed = False
        self._thread = threading.Thread(target=self._run, name="metrics", daemon=True)
        self._thread.start()

    def publish(self, status: dict[str, Any]) -> None:
        """Accept a status."""
        self._published += 1
        if self._published % self._every == 1 or self._every == 1:
            with self._condition:
                if not self._closed:
                    self._pending = status
                self._condition.notify_all()

    def wait_until_idle(self, limit_s: float) -> bool:
        """Wait until everything is written; return False after the time limit."""
        with self._condition:
            return self._condition.wait_for(
                lambda: self._pending is None and not self._is_writing, limit_s
            )

    def close(self) -> None:
        """Write the pending status and stop; the file remains."""
        with self._condition:
            self._closed = True
            self._condition.notify_all()
        self._thread.join(JOIN_TIMEOUT_S)

    def _run(self) -> None:
        while (status := self._wait_for_status()) is not None:
            try:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                text = to_prometheus_text(status)
                write_atomically(
                    self.path, text.encode(), mode=apply_umask(FILE_MODE), durable=False
                )
            except OSError:
                self.write_failures += 1

    def _wait_for_status(self) -> dict[str, Any] | None:
        """Wait for a status to write; None after `close`."""
        with self._condition:
            self._is_writing = False
            self._condition.notify_all()
            self._condition.wait_for(lambda: self._pending is not None or self._closed)
            status, self._pending = self._pending, None
            self._is_writing = status is not None
            return status


def to_prometheus_text(status: dict[str, Any]) -> str:
    """Return a status in the Prometheus text format 0.0.4."""
    lines: list[str] = []
    described: set[str] = set()
    for name, kind, help_text, labels, value in _metrics(status):
        if value is None or not math.isfinite(value):
            continue
        full_name = f"gyrorig_{name}"
        if full_name not in described:
            described.add(full_name)
            lines += [f"# HELP {full_name} {help_text}", f"# TYPE {full_name} {kind}"]
        label_text = ",".join(f'{key}="{text.translate(_ESCAPES)}"' for key, text in labels.items())
        label_part = f"{{{label_text}}}" if label_text else ""
        lines.append(f"{full_name}{label_part} {value:.17g}")
    return "\n".join(lines) + "\n"


Metric = tuple[str, str, str, dict[str, str], float | None]
_SEE_DOCS = "see docs/service.md"


def _gauge(name: str, help_text: str, value: float | None, **labels: str) -> Metric:
    return name, "gauge", help_text, labels, value


def _counter(name: str, help_text: str, value: float | None, **labels: str) -> Metric:
    return f"{name}_total", "counter", help_text, labels, value


def _metrics(status: dict[str, Any]) -> Iterator[Metric]:
    """Yield the metrics; those of one name are consecutive."""
    for state in SERVICE_STATES:
        is_present = float(status["state"] == state)
        yield _gauge("state", "1 for the present state of the service", is_present, state=state)
    yield _gauge("uptime_seconds", "time since the start of the service", status["uptime_s"])
    unit, queue = status["unit"], status["queue"]
    is_known = float(unit["state"] == "stands")
    yield _gauge("unit_known", "1 while the pan-tilt unit answers", is_known)
    for cause, count in unit["counts"].items():
        yield _counter("unit_line", "exchanges with the unit, and their faults", count, cause=cause)
    for name, count in status["counts"].items():
        yield _counter(name, _SEE_DOCS, count)
    for name, count in status["kept"].items():
        metric = _gauge if name in HOUSEKEEPING_GAUGES else _counter
        yield metric(f"recordings_{name}", _SEE_DOCS, count)
    for process, count in status["stalls"].items():
        yield _counter("stalls", "times that a process was stalled", count, process=process)
    yield _gauge("queue_waiting", "waiting jobs", queue["waiting"])
    yield _counter("jobs_refused", "files in the queue that were not valid jobs", queue["refused"])
    yield _gauge("disk_free_bytes", "free space for recordings", status["disk"]["free_bytes"])
    dropped = status["acquisition_dropped_bytes"]
    yield _counter("acquisition_dropped_bytes", "the service was too slow to read", dropped)
    is_synchronised = status["clock"]["synchronised"]
    yield _gauge(
        "clock_synchronised",
        "1 while the system time is synchronised",
        None if is_synchronised is None else float(is_synchronised),
    )
    yield from _board_metrics(status["boards"])
    recorder = status["recorder"]
    is_degraded = float(recorder["state"] == "degraded")
    yield _gauge("recorder_degraded", "1 while the disk accepts no data", is_degraded)
    for name, value in recorder["counts"].items():
        metric = _counter if is_cumulative(name) else _gauge
        yield metric(f"recorder_{name}", _SEE_DOCS, value)


def _board_metrics(boards: list[dict[str, Any]]) -> Iterator[Metric]:
    for board in boards:
        is_known = float(board["state"] == "known")
        yield _gauge("board_known", "1 while the board is identified", is_known, board=board["id"])
    for board in boards:
        yield _gauge("board_rate_hz", "samples per second", board["rate_hz"], board=board["id"])
    for board in boards:
        for name, value in board["own"].items():
            labels = {"board": board["id"], "name": name}
            yield "board_own", "gauge", "counters that the board reports", labels, value
    for kind, help_text, sources in (
        ("board_bus", "events on its CAN bus", ("bus",)),
        ("board_line", "received and lost data", ("counts", "faults")),
    ):
        for board in boards:
            for source in sources:
                for cause, count in board[source].items():
                    yield _counter(kind, help_text, count, board=board["id"], cause=cause)
