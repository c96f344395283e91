"""The status as a text file for Prometheus, by a node exporter's textfile collector.

What to use when: `MetricsWriter` as one of those that a status is published to. The file is
replaced in one step, from a thread of its own: a slow disk holds up nothing. It belongs on
another disk than the recordings, best in memory: one that fails could not say so. Names end
as Prometheus wants them: `_total` only grows, everything else is as of now.
"""

import math
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from gyrorig_daemon.service.files import write_whole
from gyrorig_daemon.service.keeping import is_sum
from gyrorig_protocol.errors import MachineError

FILE_NAME = "gyrorig.prom"
STATES = ("starting", "waiting", "ready", "running", "fault", "stopping")
KEPT_NOW = ("kept_for_calibrations",)
MODE = 0o644  # the node exporter is another user
ENDING_S = 2.0
_ESCAPES = str.maketrans({"\\": r"\\", '"': r"\"", "\n": r"\n"})


class MetricsWriter:
    """Writes the last status that it was given, when it gets to it."""

    def __init__(self, folder: Path, every: int = 15) -> None:
        """Begin to write.

        Args:
            folder: where the file goes; made where it is missing.
            every: each how many-th status is written. They come a second apart, meters are
                read each 15 s or so, and a memory card wears.

        Raises:
            MachineError: the folder cannot be made.
        """
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as fault:
            raise MachineError(
                f"no metrics can be written to {folder}: {fault.strerror}",
                "name another folder with --metrics",
            ) from fault
        self.path = folder / FILE_NAME
        self.failures = 0
        self._every = every
        self._seen = 0
        self._turn = threading.Condition()  # held for a moment, never while the disk is waited for
        self._status: dict[str, Any] | None = None
        self._is_writing = False
        self._ended = False
        self._thread = threading.Thread(target=self._run, name="metrics", daemon=True)
        self._thread.start()

    def publish(self, status: dict[str, Any]) -> None:
        """Take note of a status."""
        self._seen += 1
        if self._seen % self._every == 1 or self._every == 1:
            with self._turn:
                if not self._ended:
                    self._status = status
                self._turn.notify_all()

    def settle(self, limit_s: float) -> bool:
        """Wait until nothing is left to be written; return False where that takes too long."""
        with self._turn:
            return self._turn.wait_for(
                lambda: self._status is None and not self._is_writing, limit_s
            )

    def close(self) -> None:
        """Write what it was given, and no more; the file stays."""
        with self._turn:
            self._ended = True
            self._turn.notify_all()
        self._thread.join(ENDING_S)

    def _run(self) -> None:
        while (status := self._next()) is not None:
            try:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                write_whole(self.path, exposition(status).encode(), MODE, durable=False)
            except OSError:
                self.failures += 1

    def _next(self) -> dict[str, Any] | None:
        """Wait for a status that is to be written; None at the end."""
        with self._turn:
            self._is_writing = False
            self._turn.notify_all()
            self._turn.wait_for(lambda: self._status is not None or self._ended)
            status, self._status = self._status, None
            self._is_writing = status is not None
            return status


def exposition(status: dict[str, Any]) -> str:
    """Return a status in Prometheus' text format 0.0.4."""
    lines: list[str] = []
    known: set[str] = set()
    for name, kind, what, labels, value in _metrics(status):
        if value is None or not math.isfinite(value):
            continue
        full = f"gyrorig_{name}"
        if full not in known:
            known.add(full)
            lines += [f"# HELP {full} {what}", f"# TYPE {full} {kind}"]
        told = ",".join(f'{key}="{text.translate(_ESCAPES)}"' for key, text in labels.items())
        lines.append(f"{full}{{{told}}} {value:g}" if told else f"{full} {value:.17g}")
    return "\n".join(lines) + "\n"


Metric = tuple[str, str, str, dict[str, str], float | None]


def _metrics(status: dict[str, Any]) -> Iterator[Metric]:
    """Yield each metric, those of one name together."""
    for state in STATES:
        yield (
            "state",
            "gauge",
            "1 for the daemon's state",
            {"state": state},
            float(status["state"] == state),
        )
    yield "uptime_seconds", "gauge", "since the daemon began", {}, status["uptime_s"]
    yield (
        "unit_known",
        "gauge",
        "1 while the unit answers",
        {},
        float(status["unit"]["state"] == "stands"),
    )
    for cause, count in status["unit"]["counts"].items():
        labels = {"cause": cause}
        yield "unit_line_total", "counter", "exchanges with the unit, and faults", labels, count
    for name, count in status["counts"].items():
        yield f"{name}_total", "counter", "see docs/service.md", {}, count
    for name, count in status["kept"].items():
        kind = "gauge" if name in KEPT_NOW else "counter"
        full = f"recordings_{name}" if name in KEPT_NOW else f"recordings_{name}_total"
        yield full, kind, "see docs/service.md", {}, count
    for who, count in status["stalls"].items():
        yield "stalls_total", "counter", "a process stood still", {"process": who}, count
    yield "queue_waiting", "gauge", "jobs that wait", {}, status["queue"]["waiting"]
    yield (
        "jobs_refused_total",
        "counter",
        "dropped files that were no jobs",
        {},
        status["queue"]["refused"],
    )
    yield "disk_free_bytes", "gauge", "room for recordings", {}, status["disk"]["free_bytes"]
    yield (
        "acquisition_dropped_bytes_total",
        "counter",
        "the daemon was too slow",
        {},
        status["acquisition_dropped_bytes"],
    )
    synchronised = status["clock"]["synchronised"]
    yield (
        "clock_synchronised",
        "gauge",
        "1 while the wall clock is disciplined",
        {},
        (None if synchronised is None else float(synchronised)),
    )
    yield from _board_metrics(status["boards"])
    yield (
        "recorder_degraded",
        "gauge",
        "1 while the disk takes nothing",
        {},
        float(status["recorder"]["state"] == "degraded"),
    )
    for name, value in status["recorder"]["counts"].items():
        if is_sum(name):
            yield f"recorder_{name}_total", "counter", "see docs/service.md", {}, value
        else:
            yield f"recorder_{name}", "gauge", "see docs/service.md", {}, value


def _board_metrics(boards: list[dict[str, Any]]) -> Iterator[Metric]:
    for board in boards:
        yield (
            "board_known",
            "gauge",
            "1 while the board is there",
            {"board": board["id"]},
            float(board["state"] == "known"),
        )
    for board in boards:
        yield "board_rate_hz", "gauge", "samples a second", {"board": board["id"]}, board["rate_hz"]
    for board in boards:
        for name, value in board["own"].items():
            labels = {"board": board["id"], "name": name}
            yield "board_own", "gauge", "what the board says of itself", labels, value
    for board in boards:
        for cause, count in board["bus"].items():
            labels = {"board": board["id"], "cause": cause}
            yield "board_bus_total", "counter", "what happened on its CAN bus", labels, count
    for board in boards:
        for cause, count in (*board["counts"].items(), *board["faults"].items()):
            labels = {"board": board["id"], "cause": cause}
            yield "board_line_total", "counter", "what came and what was lost", labels, count
