"""Load and losses of the daemon with 16 boards at 800 Hz and a unit in motion.

Eight boards are on serial ports (pseudo-terminals, the real firmware), and eight on two CAN buses
(python-can's multicast). An emulated PTU-E46 moves all the time. `gyrorigd record` records for half
an hour, as a user calls it. The bench reports losses by the boards' own counters, processor time
and memory of the daemon's processes, the lateness of arrival stamps, and bytes to the disk. The
boards' clocks are CLOCK_MONOTONIC_RAW of this computer, so that lateness needs no clock model.

    --slow-disk      every fsync takes 200 ms more
    --busy           another program keeps the second core busy
    --flood BYTES    a 17th board on a serial port sends so many meaningless bytes per second too
                     (460800 baud: 46080; USB full speed: 1000000; 0: as many as its line takes)
    --plain          python-can's Logger and pyserial with mcap record the same load instead of the
                     daemon, without a unit
    --pause SECONDS  SIGSTOP stops the recording program for so long every 20 s, as a slow host does
    --folder DIR     the disk for the recording
    --realtime       load and recorder have SCHED_RR (as root), for a machine that others use too

Bar: nothing lost, at most half a core. Run: python tests/bench/bench_daemon.py [--minutes 30]
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import yaml

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.bench.daemon_load import flood
from tests.bench.daemon_load import load as boards
from tests.bench.daemon_load.plain_figures import read_plain_figures
from tests.bench.daemon_load.process_watcher import ProcessWatcher
from tests.bench.daemon_load.recording_figures import RecordingFigures, read_figures

RATE_HZ = 800
PLAIN = "tests.bench.daemon_load.plain"
SLOW_DISK_MS = "200"
PAUSE_EVERY_S = 20.0
CYCLE_S = 6.6  # about the time of a repetition of the motion
MAX_CPU_PERCENT = 50.0
FLOODED_BOARD = f"S{boards.SERIAL_BOARDS}"  # is there only with --flood


def rig_document(load: boards.Load) -> dict[str, Any]:
    """Return the rig: every board has a port or a bus, the unit is emulated."""
    listed: list[dict[str, Any]] = [
        {"id": f"S{k}", "port": path, "baud": 460800} for k, path in enumerate(load.serial_paths)
    ]
    buses = []
    for number, path in enumerate(load.bus_paths):
        buses.append({"id": f"can{number}", "port": path})
        listed += [
            {"id": f"C{number}{node}", "bus": f"can{number}", "node": node}
            for node in range(1, boards.NODES + 1)
        ]
    return {
        "schema": "gyrorig/rig/1",
        "rig": "bench",
        "ptu": {"port": "emulated", "baud": 115200},
        "buses": buses,
        "boards": listed,
        "emulator": {"command_time_ms": 1.0},
    }


def program_document(seconds: float) -> dict[str, Any]:
    """Return a motion that takes about so long."""
    outward = [
        {"move": {"pan_deg": 100.0, "tilt_deg": 20.0, "speed_deg_s": 60.0}},
        {"move": {"pan_deg": -100.0, "tilt_deg": -40.0, "speed_deg_s": 60.0}},
    ]
    times = max(1, round(seconds / CYCLE_S))
    return {
        "schema": "gyrorig/program/1",
        "name": "load",
        "steps": [{"repeat": {"times": times, "steps": outward}}],
    }


@contextmanager
def busy_core(wanted: bool) -> Iterator[None]:
    """Keep one core busy."""
    if not wanted:
        yield
        return
    spinner = subprocess.Popen([sys.executable, "-c", "while True: pass"])
    cores = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(spinner.pid, {cores[-1]})
    try:
        yield
    finally:
        spinner.kill()
        spinner.wait()


@contextmanager
def flooded_line(line_fd: int, bytes_per_s: float | None) -> Iterator[None]:
    """Send meaningless bytes on the line of a board; none without a rate."""
    if bytes_per_s is None:
        yield
        return
    command = [sys.executable, flood.__file__, str(line_fd), str(bytes_per_s)]
    sender = subprocess.Popen(command, pass_fds=[line_fd])
    try:
        yield
    finally:
        sender.kill()
        sender.wait()


@contextmanager
def paused(pid: int, seconds: float) -> Iterator[None]:
    """Stop a process every 20 s for some seconds."""
    ended = threading.Event()

    def stop_and_continue() -> None:
        while not ended.wait(PAUSE_EVERY_S):
            os.kill(pid, signal.SIGSTOP)
            ended.wait(seconds)
            os.kill(pid, signal.SIGCONT)

    thread = threading.Thread(target=stop_and_continue, daemon=True)
    if seconds:
        thread.start()
    try:
        yield
    finally:
        ended.set()
        if seconds:
            thread.join()


@contextmanager
def terminated_at_exit(process: "subprocess.Popen[Any]") -> Iterator[None]:
    """End a process with this one: under SCHED_RR it would starve all other programs."""
    try:
        yield
    finally:
        if process.poll() is None:
            process.terminate()  # it halts the unit and ends its children
            process.wait()


def scheduling_prefix(options: argparse.Namespace) -> list[str]:
    """Return the words before a command."""
    return ["chrt", "-r", "1"] if options.realtime else []


def record(folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Record the load with the daemon and return the figures."""
    program, disk = boards.build(folder)
    seconds = options.minutes * 60.0
    serial_count = boards.SERIAL_BOARDS + (options.flood is not None)
    environment = dict(os.environ)
    if options.slow_disk:
        environment |= {"LD_PRELOAD": str(disk), "SLOW_DISK_MS": SLOW_DISK_MS}
    with (
        boards.Load(program, RATE_HZ, scheduling_prefix(options), serial_count) as load,
        busy_core(options.busy),
    ):
        rig, motion = folder / "rig.yaml", folder / "program.yaml"
        rig.write_text(yaml.safe_dump(rig_document(load)))
        motion.write_text(yaml.safe_dump(program_document(seconds)))
        load.start(seconds + 120.0)
        words = ["--config", str(rig), "--program", str(motion), "--out", str(folder / "out")]
        process = subprocess.Popen(
            [*scheduling_prefix(options), sys.executable, "-m", "gyrorig_daemon", "record", *words],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        watcher = ProcessWatcher(process.pid)
        with (
            terminated_at_exit(process),
            paused(process.pid, options.pause),
            flooded_line(load.serial_lines[-1], options.flood),
        ):
            output, errors = process.communicate()
        watcher.stop()
        counts = load.stop()
    if process.returncode:
        raise SystemExit(f"gyrorigd record failed: {errors.strip()[-500:]}")
    figures = read_figures(Path(output.strip().splitlines()[-1]), FLOODED_BOARD)
    counts.pop(f"serial{boards.SERIAL_BOARDS:02d}", None)  # of the flooded board
    return recorded_result(figures, counts, load.late_us) | {"processes": process_figures(watcher)}


def recorded_result(
    figures: RecordingFigures, counts: dict[str, boards.BoardCounts], late_us: Sequence[int]
) -> dict[str, Any]:
    """Return losses, rates and lateness of a recording."""
    late_ms = {
        link: np.concatenate([b.late_ms for b in figures.boards if b.link in links])
        for link, links in (("", ("serial", "can")), ("_serial", ("serial",)), ("_can", ("can",)))
    }
    sample_count = sum(board.samples for board in figures.boards)
    return {
        "seconds": figures.seconds,
        "samples": sample_count,
        "samples_hz": sample_count / figures.seconds,
        "positions_hz": figures.positions / figures.seconds,
        "missing": sum(board.missing for board in figures.boards),
        "unordered": sum(board.unordered for board in figures.boards),
        "dropped_by_boards": sum(board.dropped for board in counts.values()),
        "lost_before_sending": sum(board.lost for board in counts.values()),
        "boards_with_loss": [board.board for board in figures.boards if board.missing],
        **{f"late_ms{link}": quantiles(values) for link, values in late_ms.items()},
        "late_ms_of_the_load": dict(
            zip(("p50", "p99", "max"), (us / 1000.0 for us in late_us), strict=True)
        ),
        "bytes_s": figures.size / figures.seconds,
    }


def process_figures(watcher: ProcessWatcher) -> dict[str, Any]:
    """Return processor time and memory of each process."""
    return {
        history.name: {
            "cpu_percent": 100.0 * history.cpu_s / watcher.watched_s,
            "rss_mb_start": history.rss_kb[min(5, len(history.rss_kb) - 1)] / 1024,
            **{
                f"rss_mb_at_{part}_quarters": history.rss_kb[len(history.rss_kb) * part // 4] / 1024
                for part in (1, 2, 3)
            },
            "rss_mb_end": history.rss_kb[-1] / 1024,
            "rss_mb_max": max(history.rss_kb) / 1024,
        }
        for history in watcher.histories.values()
    }


def record_plainly(folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Record the load with libraries alone and return the figures."""
    program, _ = boards.build(folder)
    seconds = options.minutes * 60.0
    with (
        boards.Load(program, RATE_HZ, scheduling_prefix(options)) as load,
        busy_core(options.busy),
    ):
        load.start(seconds + 60.0, "0.0.0.0")  # noqa: S104 - the system's choice
        ports = [str(port) for port in load.bus_ports]
        words = [str(folder), str(seconds), *load.serial_paths, "--", *ports]
        process = subprocess.Popen(
            [*scheduling_prefix(options), sys.executable, "-m", PLAIN, *words],
            cwd=Path(__file__).resolve().parents[2],
            stdout=subprocess.PIPE,
        )
        watcher = ProcessWatcher(process.pid)
        with terminated_at_exit(process), paused(process.pid, options.pause):
            process.communicate()
        watcher.stop()
        load.stop()
    result = read_plain_figures(folder)
    history = next(iter(watcher.histories.values()))
    result["cpu_percent"] = 100.0 * history.cpu_s / watcher.watched_s
    result["rss_mb_end"] = history.rss_kb[-1] / 1024
    return result


def quantiles(late_ms: np.ndarray[Any, np.dtype[np.float64]]) -> dict[str, float]:
    """Return the median, the 99th percentile and the maximum."""
    return {
        "p50": float(np.percentile(late_ms, 50)),
        "p99": float(np.percentile(late_ms, 99)),
        "max": float(late_ms.max()),
    }


def print_result(result: dict[str, Any], indent: str = "") -> None:
    """Print a result, one figure in a line."""
    for name, value in result.items():
        if isinstance(value, dict):
            print(f"{indent}{name}")  # noqa: T201
            print_result(value, indent + "  ")
        else:
            shown = f"{value:.3f}" if isinstance(value, float) else value
            print(f"{indent}{name:<20} {shown}")  # noqa: T201


def main() -> int:
    """Run the bench and print its figures; exit status 1 if a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--slow-disk", action="store_true")
    parser.add_argument("--busy", action="store_true")
    parser.add_argument("--flood", type=float)
    parser.add_argument("--plain", action="store_true")
    parser.add_argument("--pause", type=float, default=0.0)
    parser.add_argument("--realtime", action="store_true")
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    began_s = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="bench-daemon-", dir=options.folder) as folder:
        measure = record_plainly if options.plain else record
        result = measure(Path(folder), options)
    result["load_average"] = os.getloadavg()[1]
    print_result(result)
    if options.json:
        options.json.write_text(json.dumps(result, indent=1) + "\n")
    if options.plain:
        return 0
    cpu_percent = sum(
        part["cpu_percent"] for name, part in result["processes"].items() if "unit" not in name
    )
    lost = result["missing"] - result["lost_before_sending"]
    duration_s = time.monotonic() - began_s
    print(f"lost {lost}, {cpu_percent:.0f} % of a core, {duration_s:.0f} s")  # noqa: T201
    return 0 if lost == 0 and cpu_percent <= MAX_CPU_PERCENT else 1


if __name__ == "__main__":
    sys.exit(main())
