"""Measure the coverage of the 95 % intervals of every parameter, for each shipped program.

`tests/bench/accuracy` simulates runs without causes. docs/accuracy/write.py writes a table of the
results.

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

from tests.bench.accuracy.coverage import (  # noqa: E402 - first limit the threads
    coverage_rows,
    run_program,
    shipped_programs,
    summarise_program,
)

from gyrorig_protocol.errors import GyrorigError  # noqa: E402

Rows = list[dict[str, Any]]
ALL_RUNS, REPORT_INTERVAL, CHUNK_SIZE = 200, 20, 4


def run_job(job: tuple[str, int]) -> dict[str, Any]:
    """Return the result of one run, or the error if the solver refuses it."""
    program, seed = job
    try:
        return run_program(program, seed)
    except GyrorigError as error:
        return {"seed": seed, "failed": str(error)}


def collect_runs(
    program: str, runs: int, earlier_rows: Rows, pool: ProcessPoolExecutor
) -> Iterator[Rows]:
    """Yield the present runs of a program several times, and print the progress to stderr."""
    start_s, rows = time.monotonic(), earlier_rows[:runs]
    jobs = [(program, seed) for seed in range(len(rows), runs)]
    for row in pool.map(run_job, jobs, chunksize=CHUNK_SIZE):
        rows.append(row)
        if len(rows) % REPORT_INTERVAL == 0 or len(rows) == runs:
            took_s = time.monotonic() - start_s
            print(f"{program}: {len(rows)} of {runs}, {took_s:.0f} s", file=sys.stderr)  # noqa: T201
            yield rows
    if not jobs:
        yield rows


def main() -> int:
    """Run the programs, write the results, print the missed goals; return 1 if there are any."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--runs", type=int, default=ALL_RUNS, help="number of runs of each program")
    parser.add_argument("--program", default="", help="only programs whose name contains this")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--out", type=Path, help="write the results; for the page: coverage.json")
    parser.add_argument("--keep", type=Path, help="store every run there, and reuse stored runs")
    options = parser.parse_args()
    earlier_rows: dict[str, Rows] = {}
    if options.keep and options.keep.exists():
        earlier_rows = json.loads(options.keep.read_text(encoding="utf-8"))
    with ProcessPoolExecutor(options.processes) as pool:
        for program in shipped_programs():
            if options.program in program:
                for rows in collect_runs(
                    program, options.runs, earlier_rows.get(program, []), pool
                ):
                    earlier_rows[program] = rows
                    if options.keep:
                        options.keep.write_text(json.dumps(earlier_rows) + "\n", encoding="utf-8")
    results = {program: summarise_program(rows) for program, rows in earlier_rows.items()}
    if options.out:
        options.out.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    goal_rows = list(coverage_rows(results))
    missed = [row for row in goal_rows if row.verdict != "yes"]
    print(f"{len(goal_rows) - len(missed)} of {len(goal_rows)} goals are reached")  # noqa: T201
    for row in missed:
        print(f"| {row.item} | {row.goal} | {row.figure} | {row.verdict} |")  # noqa: T201
    return 1 if any(row.verdict == "NO" for row in goal_rows) else 0


if __name__ == "__main__":
    sys.exit(main())
