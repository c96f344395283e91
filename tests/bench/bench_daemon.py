"""What the daemon takes and loses: 16 boards at 800 Hz and a unit polled at its own limit.

Eight boards on serial ports (pseudo-terminals, the real firmware) and eight on two CAN buses
(python-can's multicast), an emulated PTU-E46 in motion all the time, for half an hour by
`gyrorigd record` as a person calls it. Told are losses by the boards' own counters, processor
time and memory of the daemon's two processes, how late arrival stamps are, and bytes to the disk.
The boards' clocks are the host's raw monotonic one, so lateness needs no model.

    --slow-disk      every fsync takes 200 ms more
    --busy           a program that never waits keeps the second core
    --plain          the same load recorded by python-can's Logger and pyserial into mcap, without
                     the daemon and the unit, beside it
    --pause SECONDS  the recording program is stopped (SIGSTOP) so long every 20 s: what a slow host
                     does to it
    --folder DIR     where the recording goes meanwhile: the disk that is measured
    --realtime       load and recorder go before all else (SCHED_RR, root): for figures from a
                     machine that others use too; nothing else changes

Bar: nothing lost, less than one core. Run: python tests/bench/bench_daemon.py [--minutes 30]
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
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import yaml

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.bench.daemon_load import load as boards
from tests.bench.daemon_load.plain_told import tell_plain
from tests.bench.daemon_load.tell import tell
from tests.bench.daemon_load.watch import Watcher

RATE_HZ = 800
PLAIN = "tests.bench.daemon_load.plain"
SLOW_DISK_MS = "200"
PAUSE_EVERY_S = 20.0
CYCLE_S = 6.6  # about what a repetition of the motion takes


def rig_document(load: boards.Load) -> dict[str, Any]:
    """Return the rig: every board has a port or a bus, the unit is emulated."""
    listed: list[dict[str, Any]] = [
        {"id": f"S{at}", "port": path, "baud": 460800} for at, path in enumerate(load.serial_paths)
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
    """Return a motion that goes on for about so long."""
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
def busy(wanted: bool) -> Iterator[None]:
    """Keep one core busy meanwhile."""
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
def paused(pid: int, seconds: float) -> Iterator[None]:
    """Stop a process now and then."""
    over = threading.Event()

    def stop_and_go() -> None:
        while not over.wait(PAUSE_EVERY_S):
            os.kill(pid, signal.SIGSTOP)
            over.wait(seconds)
            os.kill(pid, signal.SIGCONT)

    thread = threading.Thread(target=stop_and_go, daemon=True)
    if seconds:
        thread.start()
    try:
        yield
    finally:
        over.set()
        if seconds:
            thread.join()


@contextmanager
def ended_with_us(process: "subprocess.Popen[Any]") -> Iterator[None]:
    """Let no process outlive this one: under SCHED_RR it would starve everything."""
    try:
        yield
    finally:
        if process.poll() is None:
            process.terminate()  # it halts, and ends what it has started
            process.wait()


def first(options: argparse.Namespace) -> list[str]:
    """Return what to put before a command."""
    return ["chrt", "-r", "1"] if options.realtime else []


def record(folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Record the load with the daemon and return what can be said of it."""
    program, disk = boards.build(folder)
    seconds = options.minutes * 60.0
    with boards.Load(program, RATE_HZ, first(options)) as load, busy(options.busy):
        (folder / "rig.yaml").write_text(yaml.safe_dump(rig_document(load)))
        (folder / "program.yaml").write_text(yaml.safe_dump(program_document(seconds)))
        load.start(seconds + 120.0)
        environment = dict(os.environ)
        if options.slow_disk:
            environment |= {"LD_PRELOAD": str(disk), "SLOW_DISK_MS": SLOW_DISK_MS}
        words = ["--config", str(folder / "rig.yaml"), "--program", str(folder / "program.yaml")]
        words += ["--out", str(folder / "out")]
        process = subprocess.Popen(
            [*first(options), sys.executable, "-m", "gyrorig_daemon", "record", *words],
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        watcher = Watcher(process.pid)
        with ended_with_us(process), paused(process.pid, options.pause):
            out, err = process.communicate()
        watcher.stop()
        taken = load.stop()
    if process.returncode:
        raise SystemExit(f"gyrorigd record failed: {err.strip()[-500:]}")
    figures = tell(Path(out.strip().splitlines()[-1]))
    late_ms = np.concatenate([board.late_ms for board in figures.boards])
    result: dict[str, Any] = {
        "seconds": figures.seconds,
        "samples": sum(board.samples for board in figures.boards),
        "samples_hz": sum(board.samples for board in figures.boards) / figures.seconds,
        "positions_hz": figures.positions / figures.seconds,
        "missing": sum(board.missing for board in figures.boards),
        "unordered": sum(board.unordered for board in figures.boards),
        "dropped_by_boards": sum(board.dropped for board in taken.values()),
        "lost_before_sending": sum(board.lost for board in taken.values()),
        "boards_with_loss": [board.board for board in figures.boards if board.missing],
        "late_ms": quantiles(late_ms),
        "late_ms_serial": quantiles(
            np.concatenate([b.late_ms for b in figures.boards if b.link == "serial"])
        ),
        "late_ms_can": quantiles(
            np.concatenate([b.late_ms for b in figures.boards if b.link == "can"])
        ),
        "late_ms_of_the_load": dict(
            zip(("p50", "p99", "max"), (us / 1000.0 for us in load.late_us), strict=True)
        ),
        "bytes_s": figures.size / figures.seconds,
        "processes": {},
    }
    for seen in watcher.seen.values():
        result["processes"][seen.name] = {
            "cpu_percent": 100.0 * seen.cpu_s / watcher.lasted_s,
            "rss_mb_start": seen.rss_kb[min(5, len(seen.rss_kb) - 1)] / 1024,
            **{
                f"rss_mb_at_{part}_quarters": seen.rss_kb[len(seen.rss_kb) * part // 4] / 1024
                for part in (1, 2, 3)
            },
            "rss_mb_end": seen.rss_kb[-1] / 1024,
            "rss_mb_max": max(seen.rss_kb) / 1024,
        }
    return result


def plain(folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Record the load with libraries alone."""
    program, _ = boards.build(folder)
    seconds = options.minutes * 60.0
    with boards.Load(program, RATE_HZ, first(options)) as load, busy(options.busy):
        load.start(seconds + 60.0, "0.0.0.0")  # noqa: S104 - the system's choice
        ports = [str(port) for port in load.bus_ports]
        words = [str(folder), str(seconds), *load.serial_paths, "--", *ports]
        process = subprocess.Popen(
            [*first(options), sys.executable, "-m", PLAIN, *words],
            cwd=Path(__file__).resolve().parents[2],
            stdout=subprocess.PIPE,
        )
        watcher = Watcher(process.pid)
        with ended_with_us(process), paused(process.pid, options.pause):
            process.communicate()
        watcher.stop()
        load.stop()
    result = tell_plain(folder)
    seen = next(iter(watcher.seen.values()))
    result["cpu_percent"] = 100.0 * seen.cpu_s / watcher.lasted_s
    result["rss_mb_end"] = seen.rss_kb[-1] / 1024
    return result


def quantiles(late_ms: np.ndarray[Any, np.dtype[np.float64]]) -> dict[str, float]:
    """Return the middle, the 99th percentile and the worst."""
    return {
        "p50": float(np.percentile(late_ms, 50)),
        "p99": float(np.percentile(late_ms, 99)),
        "max": float(late_ms.max()),
    }


def say(result: dict[str, Any], indent: str = "") -> None:
    """Print a result, one figure a line."""
    for name, value in result.items():
        if isinstance(value, dict):
            print(f"{indent}{name}")  # noqa: T201
            say(value, indent + "  ")
        else:
            shown = f"{value:.3f}" if isinstance(value, float) else value
            print(f"{indent}{name:<20} {shown}")  # noqa: T201


def main() -> int:
    """Run as asked."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--slow-disk", action="store_true")
    parser.add_argument("--busy", action="store_true")
    parser.add_argument("--plain", action="store_true")
    parser.add_argument("--pause", type=float, default=0.0)
    parser.add_argument("--realtime", action="store_true")
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="bench-daemon-", dir=options.folder) as folder:
        result = (plain if options.plain else record)(Path(folder), options)
    result["load_average"] = os.getloadavg()[1]
    say(result)
    if options.json:
        options.json.write_text(json.dumps(result, indent=1) + "\n")
    if options.plain:
        return 0
    cpu = sum(
        part["cpu_percent"] for name, part in result["processes"].items() if "unit" not in name
    )
    lost = result["missing"] - result["lost_before_sending"]
    print(f"lost {lost}, {cpu:.0f} % of a core, {time.monotonic() - began:.0f} s")  # noqa: T201
    return 0 if lost == 0 and cpu < 100.0 else 1


if __name__ == "__main__":
    sys.exit(main())
