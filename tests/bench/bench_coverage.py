"""Whether the 95 % intervals of every parameter hold, for each shipped program apart.

Runs without causes, simulated by `tests/bench/accuracy`. docs/accuracy/write.py makes a table of
what this writes.

Run: python tests/bench/bench_coverage.py [--runs 200] [--program NAME] [--out FILE] [--keep FILE]
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from tests.bench.accuracy.coverage import (  # noqa: E402 - the line above makes threads few
    coverage_rows,
    run_program,
    shipped_programs,
    summarise_program,
)

from gyrorig_protocol.errors import GyrorigError  # noqa: E402

Rows = list[dict[str, Any]]
ALL_RUNS, TOLD_EVERY, CHUNK = 200, 20, 4


def run_job(job: tuple[str, int]) -> dict[str, Any]:
    """Return one run, or why there is none."""
    program, seed = job
    try:
        return run_program(program, seed)
    except GyrorigError as error:
        return {"seed": seed, "failed": str(error)}


def collect(
    program: str, runs: int, earlier_rows: Rows, pool: ProcessPoolExecutor
) -> Iterator[Rows]:
    """Yield the runs of a program so far; progress goes to stderr."""
    begun, rows = time.monotonic(), earlier_rows[:runs]
    jobs = [(program, seed) for seed in range(len(rows), runs)]
    for row in pool.map(run_job, jobs, chunksize=CHUNK):
        rows.append(row)
        if len(rows) % TOLD_EVERY == 0 or len(rows) == runs:
            took_s = time.monotonic() - begun
            print(f"{program}: {len(rows)} of {runs}, {took_s:.0f} s", file=sys.stderr)  # noqa: T201
            yield rows
    if not jobs:
        yield rows


def main() -> int:
    """Run the programs, write the results, print what misses the goal; 1 if any does."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--runs", type=int, default=ALL_RUNS, help="of each program")
    parser.add_argument("--program", default="", help="only programs whose name contains this")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--out", type=Path, help="write the figures; for the page: coverage.json")
    parser.add_argument("--keep", type=Path, help="keep every run there, and begin with those")
    asked = parser.parse_args()
    earlier_rows: dict[str, Rows] = {}
    if asked.keep and asked.keep.exists():
        earlier_rows = json.loads(asked.keep.read_text(encoding="utf-8"))
    with ProcessPoolExecutor(asked.processes) as pool:
        for program in shipped_programs():
            if asked.program in program:
                for rows in collect(program, asked.runs, earlier_rows.get(program, []), pool):
                    earlier_rows[program] = rows
                    if asked.keep:
                        asked.keep.write_text(json.dumps(earlier_rows) + "\n", encoding="utf-8")
    results = {program: summarise_program(rows) for program, rows in earlier_rows.items()}
    if asked.out:
        asked.out.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    judged = list(coverage_rows(results))
    missed = [row for row in judged if row.verdict != "yes"]
    print(f"{len(judged) - len(missed)} of {len(judged)} are within the goal")  # noqa: T201
    for row in missed:
        print(f"| {row.item} | {row.goal} | {row.figure} | {row.verdict} |")  # noqa: T201
    return 1 if any(row.verdict == "NO" for row in judged) else 0


if __name__ == "__main__":
    sys.exit(main())
