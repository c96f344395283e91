"""Tables of speed and growth, from the results of bench_solve.py and bench_growth.py."""

import json
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from docs.markdown import Block, show, table

HERE = Path(__file__).resolve().parent


def _read_json(name: str) -> dict[str, Any]:
    measurement: dict[str, Any] = json.loads((HERE / name).read_text(encoding="utf-8"))
    return measurement


def steps() -> str:
    """Return the processor time of each step for a board of 75 s at 800 Hz."""
    measurement = _read_json("speed.json")
    rows = [(step, f"{value:.1f}") for step, value in measurement["ms"].items()]
    rows.append(("all steps", f"{measurement['total_ms']:.1f}"))
    return table(["step", "processor time, ms"], rows)


def boards() -> str:
    """Return the boards per second and core, compared with two other solvers."""
    measurement = _read_json("speed.json")
    lines = [
        f"The recording has {measurement['samples']} samples. The solver processes "
        f"{measurement['boards_s']:.1f} boards per second on one core. The goal for this speed "
        f"is at least 10 boards per second on one core, and 20 boards per second are desirable. "
        f"The peak memory is {measurement['peak_mb']:.0f} MB."
    ]
    for name, text in (
        ("eq. 7", "eq. 7 of the paper, one pseudo-inverse over all samples,"),
        ("imucal", "the Ferraris calibration of imucal"),
    ):
        if name in measurement["peers_ms"]:
            lines.append(
                f"For the same number of samples, {text} takes "
                f"{measurement['peers_ms'][name]:.2f} ms. All steps of our solver except `read` "
                f"together take {measurement['after_reading_to'][name]:.0f} times this time. "
                f"The step `solve` alone takes {measurement['solve_to'][name]:.0f} times this time."
            )
    return "\n".join(lines)


def growth() -> str:
    """Return time and memory for recordings of several lengths."""
    measurement = _read_json("growth.json")
    rows = []
    for row in measurement["rows"]:
        minutes = row["seconds"] / 60.0
        rows.append(
            (
                f"{minutes:.0f} min" if minutes < 60 else f"{minutes / 60:.0f} h",
                f"{row['rate_hz']:.0f}",
                f"{row['samples']}",
                f"{row['megabytes']:.0f}",
                f"{row['cpu_s']:.1f}",
                f"{row['us_per_sample']:.1f}",
                f"{row['peak_mb']:.0f}",
            )
        )
    head = ["length", "samples per second", "samples", "file, MB", "processor time, s"]
    return table([*head, "µs per sample", "peak memory, MB"], rows)


BLOCKS: dict[str, Block] = {
    "speed-steps": steps,
    "speed-boards": boards,
    "speed-growth": growth,
}


if __name__ == "__main__":
    show(BLOCKS)
