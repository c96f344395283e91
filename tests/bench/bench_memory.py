# ruff: noqa: T201
"""Memory of a recording in real time: what Python has allocated, and where it rises.

`gyrorigd record` runs with emulated devices on pseudo-terminals. Python's tracemalloc is active in
its process. A first snapshot is taken after `--settle` minutes, when the heap has its shape, and
another one every 10 minutes. The bench prints the slope of the traced memory since the first one,
the lines of code that allocated most of the rise, and the resident memory of every process.

Run: python tests/bench/bench_memory.py [--minutes 180] [--boards 6] [--json OUT.json]
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import yaml

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.bench.daemon_load.process_watcher import ProcessWatcher, usage

EVERY_S = 30.0
COMPARE_EVERY = 20  # readings, 10 minutes
LARGEST = 8  # lines of code that are listed
CYCLE_S = 12.8  # of a repetition of the motion, roughly
MAX_SLOPE_KB_PER_H = 1024.0


def program_document(minutes: float) -> dict[str, Any]:
    """Return a motion that takes about so long."""
    cycle = [
        {"move": {"pan_deg": 90.0, "tilt_deg": 20.0, "speed_deg_s": 40.0}},
        {"rest": {"seconds": 3.0}},
        {"move": {"pan_deg": -90.0, "tilt_deg": -40.0, "speed_deg_s": 60.0}},
        {"rest": {"seconds": 3.0}},
    ]
    count = max(1, round(minutes * 60.0 / CYCLE_S))
    return {
        "schema": "gyrorig/program/1",
        "name": "memory",
        "steps": [{"repeat": {"times": count, "steps": cycle}}],
    }


def rig_document(boards: int) -> dict[str, Any]:
    """Return a rig with emulated devices."""
    return {
        "schema": "gyrorig/rig/1",
        "rig": "memory",
        "ptu": {"port": "emulated", "baud": 115200},
        "boards": [{"id": f"B{k}", "port": "emulated", "baud": 460800} for k in range(boards)],
    }


class MemoryTrace:
    """Traced memory of this process over time, and two snapshots."""

    def __init__(self, path: Path, settle_s: float) -> None:
        self._path, self._settle_s = path, settle_s
        self._first: tracemalloc.Snapshot | None = None
        self._lines: list[dict[str, float]] = []
        self._rises: list[dict[str, Any]] = []
        self._began_s = time.monotonic()
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._ended.wait(EVERY_S):
            minutes = (time.monotonic() - self._began_s) / 60.0
            traced_kb = tracemalloc.get_traced_memory()[0] / 1024.0
            self._lines.append(
                {"minutes": minutes, "traced_kb": traced_kb, "rss_kb": usage(os.getpid())[1]}
            )
            if self._first is None and minutes * 60.0 >= self._settle_s:
                self._first = _take_snapshot()
            elif len(self._lines) % COMPARE_EVERY == 0:
                self.compare()

    def compare(self) -> None:
        """Keep the rises since the first snapshot, and write the trace."""
        if self._first is not None:
            differences = _take_snapshot().compare_to(self._first, "lineno")
            self._rises = [
                {"line": str(change.traceback[0]), "kb": change.size_diff / 1024.0}
                for change in differences[:LARGEST]
            ]
        self.write()

    def write(self) -> None:
        """Write the trace, with the rises of the last comparison."""
        document = {
            "settle_min": self._settle_s / 60.0, "trace": self._lines, "rises": self._rises
        }  # fmt: skip
        self._path.write_text(json.dumps(document), encoding="utf-8")

    def stop(self) -> None:
        """End the thread and write the trace; the recording has freed its memory by now."""
        self._ended.set()
        self._thread.join()
        self.write()


def _take_snapshot() -> tracemalloc.Snapshot:
    ignored = [
        tracemalloc.Filter(inclusive=False, filename_pattern=name)
        for name in (__file__, tracemalloc.__file__)
    ]
    return tracemalloc.take_snapshot().filter_traces(ignored)


def record_traced(trace_path: Path, settle_s: float, words: list[str]) -> None:
    """Run `gyrorigd` with these words in this process, which ends with its status."""
    from gyrorig_daemon.cli import main as run_daemon  # noqa: PLC0415 - only in the traced process

    tracemalloc.start()
    trace = MemoryTrace(trace_path, settle_s)
    sys.argv = ["gyrorigd", *words]
    try:
        run_daemon()
    finally:
        trace.stop()


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Record and return the trace and the resident memory of all processes."""
    with tempfile.TemporaryDirectory(prefix="bench-memory-") as name:
        folder = Path(name)
        rig, program = folder / "rig.yaml", folder / "program.yaml"
        rig.write_text(yaml.safe_dump(rig_document(options.boards)), encoding="utf-8")
        program.write_text(yaml.safe_dump(program_document(options.minutes)), encoding="utf-8")
        trace_path = options.json or folder / "trace.json"
        words = ["record", "--config", str(rig), "--program", str(program), "--out", str(folder)]
        command = [sys.executable, __file__, "--traced", str(trace_path)]
        command += ["--settle", str(options.settle), "--", *words]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
            watcher = ProcessWatcher(process.pid, EVERY_S)
            code = process.wait()
            watcher.stop()
        if code:
            raise SystemExit(f"the recording failed with status {code}")
        document: dict[str, Any] = json.loads(trace_path.read_text("utf-8"))
    document["processes"] = {
        history.name: [round(kb / 1024.0, 1) for kb in history.rss_kb]
        for history in watcher.histories.values()
    }
    return document


def report(document: dict[str, Any]) -> bool:
    """Print the figures; return whether the slope of the traced memory is small enough."""
    rows = [row for row in document["trace"] if row["minutes"] >= document["settle_min"]]
    minutes, traced, resident = (
        np.array([row[key] for row in rows]) for key in ("minutes", "traced_kb", "rss_kb")
    )
    slope, rss_slope = (60.0 * np.polyfit(minutes, values, 1)[0] for values in (traced, resident))
    print(f"from minute {minutes[0]:.0f} to {minutes[-1]:.0f}:")
    print(f"  traced   {traced[0]:.0f} to {traced[-1]:.0f} kB, slope {slope:+.0f} kB per hour")
    print(f"  resident {resident[0]:.0f} to {resident[-1]:.0f} kB, {rss_slope:+.0f} kB per hour")
    for rise in document["rises"]:
        print(f"  {rise['kb']:+8.1f} kB  {rise['line']}")
    for name, megabytes in document["processes"].items():
        print(f"  {name}: {megabytes[0]} MB at the start, {megabytes[-1]} MB at the end")
    return bool(slope <= MAX_SLOPE_KB_PER_H)


def main() -> int:
    """Measure; exit with 1 if the memory rises too fast."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=180.0)
    parser.add_argument("--settle", type=float, default=30.0, help="minutes to the first snapshot")
    parser.add_argument("--boards", type=int, default=6)
    parser.add_argument("--json", type=Path, help="keep the trace")
    parser.add_argument("--traced", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("words", nargs="*", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.traced:
        record_traced(options.traced, options.settle * 60.0, options.words)
    return 0 if report(measure(options)) else 1


if __name__ == "__main__":
    sys.exit(main())
