"""Table of coverage with noise in motion, from the results of bench_motor_noise.py."""

import json
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from docs.markdown import Block, show, table

RESULTS = Path(__file__).resolve().parent / "motor_noise.json"


def coverage() -> str:
    """Return the coverage of 95 % intervals: all parameters, the lowest and the highest."""
    results: dict[str, Any] = json.loads(RESULTS.read_text(encoding="utf-8"))
    rows = []
    for case in results["cases"]:
        pooled = case["cover_95"]
        # The constant of the replies is uniform: see the section about the time offset.
        of_axes = {name: share for name, share in case["parameters"].items() if "." in name}
        lowest, highest = (choose(of_axes, key=lambda name: of_axes[name]) for choose in (min, max))
        rows.append(
            (
                case["reference"],
                case["motor_noise"],
                str(case["runs"]),
                f"{100 * pooled['value']:.1f} %",
                f"{100 * pooled['low']:.1f} to {100 * pooled['high']:.1f} %",
                f"{100 * of_axes[lowest]:.1f} %, `{lowest}`",
                f"{100 * of_axes[highest]:.1f} %, `{highest}`",
                f"{case['noise_ratio']:.2f}",
                f"{100 * case['found']:.0f} %",
                f"{100 * case['widened']:.0f} %",
            )
        )
    head = (
        "reference",
        "added noise / white noise",
        "runs",
        "95 % coverage, pooled; 93 to 97 %",
        "its 95 % interval",
        "lowest parameter",
        "highest parameter",
        "noise in motion / at rest, median",
        "estimated in",
        "covariance multiplied in",
    )
    return table(head, rows)


BLOCKS: dict[str, Block] = {"motor-noise": coverage}


if __name__ == "__main__":
    show(BLOCKS)
