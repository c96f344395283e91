"""Compare the estimator with the Cramer-Rao bound, and its stated uncertainties with its errors.

The bench simulates runs of the shipped programs. Each run has a new random board, noise, unit,
start delays, and moments in an exchange at which the unit reads a count. Cases whose names begin
with the same words have the same boards. `accuracy/goals.py` contains the goals.
docs/accuracy/write.py writes a page from the results.

Run: python tests/bench/bench_accuracy.py [--runs 200 | --quick] [--case WORDS] [--out FILE]
"""

import argparse
import json
import os
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from tests.bench.accuracy.goals import CASES  # noqa: E402
from tests.bench.accuracy.summary import judged, outlier_cost, summarise  # noqa: E402
from tests.bench.accuracy.trial import Case, run  # noqa: E402

from gyrorig_protocol.errors import GyrorigError  # noqa: E402 - first limit the threads

Rows = list[dict[str, Any]]
RESULTS = ROOT / "docs" / "accuracy" / "results.json"
PROCESSES, LEAST_RUNS, QUICK_RUNS, ALL_RUNS = 2, 8, 20, 200
CHUNK_SIZE, REPORT_INTERVAL = 4, 20  # runs


def run_job(job: tuple[Case, int]) -> dict[str, Any]:
    """Return the result of one run, or the error if the solver refuses it."""
    case, seed = job
    try:
        return run(case, seed)
    except GyrorigError as error:
        return {"seed": seed, "failed": str(error)}


def collect_runs(case: Case, runs: int, earlier_rows: Rows, pool: ProcessPoolExecutor) -> Rows:
    """Return earlier and new runs of a case, and print the progress to stderr."""
    start_s = time.monotonic()
    rows = earlier_rows[:runs]
    jobs = [(case, seed) for seed in range(len(rows), runs)]
    for row in pool.map(run_job, jobs, chunksize=CHUNK_SIZE):
        rows.append(row)
        if len(rows) % REPORT_INTERVAL == 0 or len(rows) == runs:
            took_s = time.monotonic() - start_s
            print(f"{case.name}: {len(rows)} of {runs}, {took_s:.0f} s", file=sys.stderr)  # noqa: T201
    return rows


def read_earlier_runs(path: Path | None) -> dict[str, Rows]:
    """Return the runs of an earlier call, to which this call adds runs."""
    if path is None or not path.exists():
        return {}
    rows: dict[str, Rows] = json.loads(path.read_text(encoding="utf-8"))
    return rows


def write_json(path: Path | None, content: object, indent: int | None = None) -> None:
    """Write a file if a path is given."""
    if path is not None:
        path.write_text(json.dumps(content, indent=indent) + "\n", encoding="utf-8")


def main() -> int:
    """Run the cases, write the results, print the table; return 1 if a goal is missed."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--runs", type=int, default=ALL_RUNS, help="number of runs of each case")
    parser.add_argument("--quick", action="store_true", help=f"{QUICK_RUNS} runs of each case")
    parser.add_argument("--case", default="", help="only cases whose name contains these words")
    parser.add_argument("--out", type=Path, help="write the results; for the page: " + RESULTS.name)
    parser.add_argument(
        "--keep", type=Path, help="store every run there, and reuse stored runs of the same code"
    )
    options = parser.parse_args()
    count = QUICK_RUNS if options.quick else options.runs
    runs = read_earlier_runs(options.keep)
    with ProcessPoolExecutor(PROCESSES) as pool:
        for case in CASES:
            if options.case in case.name:
                wanted = max(LEAST_RUNS, round(count * case.share))
                runs[case.name] = collect_runs(case, wanted, runs.get(case.name, []), pool)
                write_json(options.keep, runs)
    results = {
        "runs": count,
        "cases": {name: summarise(rows) for name, rows in runs.items()},
        "outliers": {
            name: outlier_cost(runs[name], runs[f"{name}, spikes"])
            for name in runs
            if f"{name}, spikes" in runs
        },
    }
    write_json(options.out, results, indent=1)
    missed = 0
    print("| item | goal | measured (95 % interval) | |\n|---|---|---|---|")  # noqa: T201
    for row in judged(results):
        print(f"| {row.item} | {row.goal} | {row.figure} | {row.verdict} |")  # noqa: T201
        missed += row.verdict == "NO"
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
