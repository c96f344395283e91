"""Whether stated intervals hold when motors add noise while they move.

The same boards and motions as the first case of bench_accuracy.py, with white noise that is added
in motion. docs/accuracy/write.py makes a table of what this writes.

Run: python tests/bench/bench_motor_noise.py [--runs 200] [--out docs/accuracy/motor_noise.json]
"""

import argparse
import json
import os
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402 - the lines above make threads few and find the packages
from tests.bench.accuracy.board import NAMES  # noqa: E402
from tests.bench.accuracy.figures import SIGMA_95, mean_of  # noqa: E402
from tests.bench.accuracy.goals import COVER_95, SHORT  # noqa: E402
from tests.bench.accuracy.motor_noise import MotorNoise  # noqa: E402
from tests.bench.accuracy.trial import Case, run_without_bound  # noqa: E402

ALL_RUNS, PROCESSES = 200, 2
NOISES = {
    "none": None,
    "0.5": MotorNoise(0.5),
    "1": MotorNoise(1.0),
    "2": MotorNoise(2.0),
    "up to 2, proportional to speed": MotorNoise(2.0, grows=True),
}
REFERENCES = {"given exactly": None, "PP and TP in turn, 115200 baud": 115_200.0}


def summarise(rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Return the coverage of 95 % intervals, pooled and per parameter, and what was estimated."""
    error, std = (np.array([row[key] for row in rows]) for key in ("error", "std"))
    inside = np.abs(error) <= SIGMA_95 * std
    pooled = mean_of(inside.mean(axis=1))
    ratio = np.array([row["noise_ratio"] for row in rows])
    return {
        "runs": len(rows),
        "cover_95": {"value": pooled.value, "low": pooled.low, "high": pooled.high},
        "parameters": {name: float(inside[:, k].mean()) for k, name in enumerate(NAMES)},
        "rms_error_over_std": float(
            np.sqrt(np.mean((error / std)[:, : NAMES.index("time_offset")] ** 2))
        ),
        "noise_ratio": float(np.median(ratio)),
        "found": float(np.mean(np.any(ratio > 1.0, axis=1))),
        "widened": float(np.mean([row["widened"] for row in rows])),
        "reduced_chi2": float(np.median([row["reduced_chi2"] for row in rows])),
    }


def main() -> int:
    """Run all cases, write and print the results; 1 if a pooled coverage misses the goal."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--runs", type=int, default=ALL_RUNS, help="of each case")
    parser.add_argument("--out", type=Path, help="write the figures")
    asked = parser.parse_args()
    cases, missed = [], 0
    with ProcessPoolExecutor(PROCESSES) as pool:
        for reference, baud in REFERENCES.items():
            for words, motor_noise in NOISES.items():
                case = Case(words, SHORT, number=1, baud=baud, motor_noise=motor_noise)
                rows = list(
                    pool.map(partial(run_without_bound, case), range(asked.runs), chunksize=8)
                )
                result = {"reference": reference, "motor_noise": words, **summarise(rows)}
                cases.append(result)
                missed += not COVER_95[0] <= result["cover_95"]["value"] <= COVER_95[1]
                print(json.dumps(result), flush=True)  # noqa: T201
                if asked.out is not None:
                    text = json.dumps({"cases": cases}, indent=1)
                    asked.out.write_text(f"{text}\n", encoding="utf-8")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
