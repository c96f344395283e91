"""Whether `good` is right on six recordings with one cause each, made by the emulator.

Each line of the table has the verdict, the largest error in stated standard uncertainties (type A,
and the total where the solver states it), and the named causes. With --tree, the program of
another source tree solves the same recordings.

Run: python tests/bench/bench_good.py [--folder DIR] [--tree DIR] [--extend auto] [--case WORDS]
"""

import argparse
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

for library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")
ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

import numpy as np  # noqa: E402 - after the number of threads
from tests.bench.rigs.emulated_cases import CASES, case_line, judge_case  # noqa: E402
from tests.bench.rigs.trial import sigmas  # noqa: E402

HEADER = (
    "| case | verdict | largest error, type A sd | outside 95 % | by total sd | named causes |\n"
    "| --- | --- | --- | --- | --- | --- |"
)
LIMIT_SD = 4.5  # a good calibration with an error above it is wrong with confidence


def main() -> int:
    """Print the table; 1 where a good calibration is far off by its total, or by type A."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--folder", type=Path, help="keeps the recordings and the calibrations")
    parser.add_argument("--tree", type=Path, help="solve with DIR/.venv/bin/gyrorig")
    parser.add_argument("--extend", help="passed to `gyrorig solve`")
    parser.add_argument("--case", default="", help="only cases whose name holds these words")
    given = parser.parse_args()
    program = Path(sys.executable).with_name("gyrorig")
    if given.tree is not None:
        program = given.tree / ".venv" / "bin" / "gyrorig"
    options = ("--extend", given.extend) if given.extend else ()
    folder = given.folder or Path(tempfile.mkdtemp())
    print(HEADER)  # noqa: T201
    wrong = 0
    for case in CASES:
        if given.case in case.name:
            row = judge_case(case, folder, str(program), options)
            print(case_line(row), flush=True)  # noqa: T201
            wrong += is_wrong(row)
    return 1 if wrong else 0


def is_wrong(row: dict[str, Any]) -> bool:
    """Return whether a calibration is called good and is far off by what it states."""
    if row.get("verdict") != "good":
        return False
    stated = "total" if row["total"] else "std"
    return bool(np.nanmax(np.abs(sigmas(row, stated))) > LIMIT_SD)


if __name__ == "__main__":
    sys.exit(main())
