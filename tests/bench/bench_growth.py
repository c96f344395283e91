"""How processor time and memory of `gyrorig solve` grow with the length of a recording.

`long_recording.py` makes recordings of one board on a polled pan-tilt unit: 10 min and 1 h at 800
Hz, and with --long 8 h at 100 Hz and at 800 Hz. `gyrorig solve` solves each in a process of its
own, with the search for causes, and writes calibration, findings and report.

Bars: 8 h at 100 Hz need at most 60 s of the processor and 800 MB, and a sample of a long recording
costs at most as much time as one of 10 min.

Run: python tests/bench/bench_growth.py [--long] [--json FILE]
"""

# ruff: noqa: T201 - its output is its table
import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

MAKER = Path(__file__).with_name("long_recording.py")
LENGTHS = ((600.0, 800.0), (3600.0, 800.0))  # s, Hz
LONG_LENGTHS = ((28_800.0, 100.0), (28_800.0, 800.0))
NIGHT = (28_800.0, 100.0)
NIGHT_CPU_S, NIGHT_MB = 60.0, 800.0
SOLVED = (0, 4)  # exit codes: solved, solved in part


def measure(seconds: float, rate_hz: float, folder: Path) -> dict[str, Any]:
    """Make a recording, solve it in its own process, and return time and memory."""
    path = folder / f"{seconds:.0f}s-{rate_hz:.0f}Hz.mcap"
    options = ["--seconds", str(seconds), "--rate", str(rate_hz)]
    made = subprocess.run(
        [sys.executable, MAKER, path, *options], check=True, capture_output=True, text=True
    )
    command = [sys.executable, "-m", "gyrorig_solver", "solve", str(path), "--out", str(folder)]
    started_s = time.monotonic()
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.STDOUT)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    samples, cpu_s = int(made.stdout.split()[0]), usage.ru_utime + usage.ru_stime
    size = path.stat().st_size
    path.unlink()
    return {
        "seconds": seconds,
        "rate_hz": rate_hz,
        "samples": samples,
        "megabytes": round(size / 1e6, 1),
        "exit_code": process.returncode,
        "cpu_s": round(cpu_s, 2),
        "wall_s": round(time.monotonic() - started_s, 2),
        "us_per_sample": round(cpu_s / samples * 1e6, 2),
        "peak_mb": round(usage.ru_maxrss / 1e3, 1),
    }


def missed_bars(rows: list[dict[str, Any]]) -> list[str]:
    """Return the bars that the rows miss."""
    missed = []
    for row in rows:
        name = f"{row['seconds']:.0f} s at {row['rate_hz']:.0f} Hz"
        if row["exit_code"] not in SOLVED:
            missed.append(f"{name}: exit status {row['exit_code']}")
        if row["us_per_sample"] > rows[0]["us_per_sample"]:
            missed.append(f"{name}: {row['us_per_sample']} us per sample")
        if (row["seconds"], row["rate_hz"]) == NIGHT:
            if row["cpu_s"] > NIGHT_CPU_S:
                missed.append(f"{name}: {row['cpu_s']} s of the processor")
            if row["peak_mb"] > NIGHT_MB:
                missed.append(f"{name}: {row['peak_mb']} MB")
    return missed


def main() -> int:
    """Print a row for each recording; exit status 1 if a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--long", action="store_true", help="8 h too: ten minutes")
    parser.add_argument("--json", type=Path, help="write the figures there")
    parser.add_argument("--folder", type=Path, help="for the recordings; default: temporary")
    given = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory(dir=given.folder) as folder:
        for seconds, rate_hz in (*LENGTHS, *(LONG_LENGTHS if given.long else ())):
            rows.append(measure(seconds, rate_hz, Path(folder)))
            print(rows[-1], flush=True)
    missed = missed_bars(rows)
    if given.json:
        given.json.write_text(json.dumps({"rows": rows, "missed": missed}, indent=1) + "\n")
    for text in missed:
        print("MISSED", text)
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())
