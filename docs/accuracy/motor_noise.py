"""The table of coverage with noise in motion, from the results of bench_motor_noise.py."""

import json
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from docs.markdown import Block, show, table

RESULTS = Path(__file__).resolve().parent / "motor_noise.json"


def coverage() -> str:
    """Coverage of 95 % intervals, for all parameters and for the lowest and highest."""
    results: dict[str, Any] = json.loads(RESULTS.read_text(encoding="utf-8"))
    rows = []
    for case in results["cases"]:
        pooled = case["cover_95"]
        # The constant of the replies is uniform: see the section about the time offset.
        named = {name: share for name, share in case["parameters"].items() if "." in name}
        lowest, highest = (choose(named, key=lambda name: named[name]) for choose in (min, max))
        rows.append(
            (
                case["reference"],
                case["motor_noise"],
                str(case["runs"]),
                f"{100 * pooled['value']:.1f} %",
                f"{100 * pooled['low']:.1f} to {100 * pooled['high']:.1f} %",
                f"{100 * named[lowest]:.1f} %, `{lowest}`",
                f"{100 * named[highest]:.1f} %, `{highest}`",
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
