"""How processor time and memory of a solve grow with the length of a recording.

Recordings of 10 min and 1 h, and with --long of 8 h, of one board at 800 Hz on a polled
pan-tilt unit (`long_recording.py`), each solved by `gyrorig solve` in a process of its own,
which also tells where its time went: in reading, clocks, samples, reference, solve, and
the rest (document, report, digest).

Bars: an 8 h recording solves in less than 2 GB, and a sample costs no more processor time
in a long recording than 1.5 times what it costs in 10 min.

Run: python tests/bench/bench_growth.py [--long] [--json FILE]
"""

import argparse
import importlib
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

LEAST_S, LONGER_S, LONGEST_S = 600.0, 3600.0, 28_800.0
MOST_MB, MOST_GROWTH = 2000.0, 1.5
SOLVED = (0, 4)  # exit codes: solved, solved in part
# Where each function's own time is booked, without that of those inside it.
PARTS = {
    "read_recording": "reading",
    "map_clock": "clocks",
    "load_samples": "samples",
    "ptu_reference": "reference",
    "fit_motion": "solve",
    "fit_joint": "solve",
}


class Clock:
    """Books processor time to the innermost of the functions that it watches."""

    def __init__(self) -> None:
        self.parts = dict.fromkeys((*PARTS.values(), "rest"), 0.0)
        self._stack = ["rest"]
        self._since = time.process_time()

    def turn(self) -> None:
        """Book what has passed to what runs now."""
        now = time.process_time()
        self.parts[self._stack[-1]] += now - self._since
        self._since = now

    def watch(self) -> None:
        """Put itself around the functions, wherever the solver has imported them to."""
        for module in [m for name, m in sys.modules.items() if name.startswith("gyrorig_")]:
            for name, part in PARTS.items():
                function = vars(module).get(name)
                if callable(function):
                    setattr(module, name, self._watched(function, part))

    def _watched(self, function: Callable[..., Any], part: str) -> Callable[..., Any]:
        def call(*given: Any, **named: Any) -> Any:
            self.turn()
            self._stack.append(part)
            try:
                return function(*given, **named)
            finally:
                self.turn()
                self._stack.pop()

        return call


def solve_here(path: Path, out: Path) -> dict[str, Any]:
    """Solve in this process, and tell what it took."""
    # Only here: the parent stays small, and the clock finds what is imported.
    importlib.import_module("gyrorig_solver.commands.solve_command")
    from gyrorig_solver.cli import run  # noqa: PLC0415

    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    clock = Clock()
    clock.watch()
    begun = time.monotonic()
    with Path(os.devnull).open("w") as nowhere:
        stdout, sys.stdout = sys.stdout, nowhere
        try:
            code = run(["solve", str(path), "--out", str(out)])
        finally:
            sys.stdout = stdout
    clock.turn()
    return {
        "exit_code": code,
        "cpu_s": {name: round(value, 4) for name, value in clock.parts.items()},
        "total_cpu_s": round(sum(clock.parts.values()), 3),
        "wall_s": round(time.monotonic() - begun, 3),
        "imports_mb": round(before, 1),
        "peak_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3, 1),
    }


def measure(seconds: float, folder: Path) -> dict[str, Any]:
    """Make one recording and solve it, each in its own process."""
    path = folder / f"{seconds:.0f}s.mcap"
    here = Path(__file__)
    maker = [sys.executable, str(here.with_name("long_recording.py")), str(path)]
    made = subprocess.run(
        [*maker, "--seconds", str(seconds)], check=True, capture_output=True, text=True
    )
    solver = [sys.executable, str(here), "--solve", str(path), str(folder / f"{seconds:.0f}s")]
    process = subprocess.run(solver, check=False, capture_output=True, text=True)
    if process.returncode:
        raise SystemExit(f"{path.name}: {process.stderr.strip().rpartition(chr(10))[2]}")
    document: dict[str, Any] = json.loads(process.stdout)
    samples = int(made.stdout.split()[0])
    document |= {
        "seconds": seconds,
        "samples": samples,
        "megabytes": round(path.stat().st_size / 1e6, 1),
        "us_per_sample": round(document["total_cpu_s"] / samples * 1e6, 3),
    }
    path.unlink()
    return document


def table(rows: list[dict[str, Any]]) -> str:
    """The rows as a Markdown table; per-sample ratios are to the first."""
    parts = list(rows[0]["cpu_s"])
    titles = ["length", "samples", "file MB", *(f"{p} s" for p in parts)]
    titles += ["total s", "us/sample", "ratio", "peak MB", "exit"]
    lines = ["| " + " | ".join(titles) + " |", "|" + "---|" * len(titles)]
    for row in rows:
        minutes = row["seconds"] / 60.0
        cells = [f"{minutes:.0f} min" if minutes < 60 else f"{minutes / 60:.0f} h"]
        cells += [str(row["samples"]), f"{row['megabytes']:.0f}"]
        cells += [f"{row['cpu_s'][p]:.2f}" for p in parts]
        cells += [f"{row['total_cpu_s']:.2f}", f"{row['us_per_sample']:.2f}"]
        cells += [f"{row['us_per_sample'] / rows[0]['us_per_sample']:.2f}"]
        cells += [f"{row['peak_mb']:.0f}", str(row["exit_code"])]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> int:
    """Print the table; return 1 where a bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--long", action="store_true", help="8 h too: some ten minutes")
    parser.add_argument("--json", type=Path, help="write the figures there")
    parser.add_argument("--folder", type=Path, help="for the recordings; default: temporary")
    parser.add_argument("--solve", nargs=2, type=Path, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.solve:
        print(json.dumps(solve_here(*given.solve)))  # noqa: T201
        return 0
    lengths = [LEAST_S, LONGER_S, *([LONGEST_S] if given.long else [])]
    with tempfile.TemporaryDirectory(dir=given.folder) as folder:
        rows = [measure(seconds, Path(folder)) for seconds in lengths]
    print(table(rows))  # noqa: T201
    missed = []
    for row in rows:
        growth = row["us_per_sample"] / rows[0]["us_per_sample"]
        row["growth"] = round(growth, 3)
        if row["exit_code"] not in SOLVED:
            missed.append(f"{row['seconds']:.0f} s: gyrorig solve left with {row['exit_code']}")
        if row["peak_mb"] > MOST_MB:
            missed.append(f"{row['seconds']:.0f} s: {row['peak_mb']:.0f} MB > {MOST_MB:.0f}")
        if growth > MOST_GROWTH:
            missed.append(f"{row['seconds']:.0f} s: {growth:.2f} times as much a sample")
    if given.json:
        figures = {"rows": rows, "most_mb": MOST_MB, "most_growth": MOST_GROWTH, "missed": missed}
        given.json.write_text(json.dumps(figures, indent=1) + "\n")
    for text in missed:
        print("MISSED", text)  # noqa: T201
    return int(bool(missed))


if __name__ == "__main__":
    sys.exit(main())
