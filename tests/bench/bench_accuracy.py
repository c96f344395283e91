"""How near the estimator comes to the bound, and whether what it claims of itself is true.

Simulated runs of the shipped programs: board, noise, unit, start delays, and where in an
exchange a count is taken are drawn anew in each. Cases whose names begin alike have the
same boards. Goals are in `accuracy/goals.py`; docs/accuracy/write.py makes a page of what
this writes.

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

from gyrorig_protocol.errors import GyrorigError  # noqa: E402 - the line above makes threads few

Rows = list[dict[str, Any]]
RESULTS = ROOT / "docs" / "accuracy" / "results.json"
PROCESSES, LEAST_RUNS, QUICK_RUNS, ALL_RUNS = 2, 8, 20, 200
DRAWN_TOGETHER, TOLD_EVERY = 4, 20


def run_job(job: tuple[Case, int]) -> dict[str, Any]:
    """Return one run, or why there is none: a refusal is a figure, too."""
    case, seed = job
    try:
        return run(case, seed)
    except GyrorigError as error:
        return {"seed": seed, "failed": str(error)}


def collect(case: Case, runs: int, earlier_rows: Rows, pool: ProcessPoolExecutor) -> Rows:
    """Return the runs of a case, those that are kept and others; progress goes to stderr."""
    begun = time.monotonic()
    rows = earlier_rows[:runs]
    jobs = [(case, seed) for seed in range(len(rows), runs)]
    for row in pool.map(run_job, jobs, chunksize=DRAWN_TOGETHER):
        rows.append(row)
        if len(rows) % TOLD_EVERY == 0 or len(rows) == runs:
            took_s = time.monotonic() - begun
            print(f"{case.name}: {len(rows)} of {runs}, {took_s:.0f} s", file=sys.stderr)  # noqa: T201
    return rows


def earlier_runs(path: Path | None) -> dict[str, Rows]:
    """Return the runs of an earlier call, so that more can be added."""
    if path is None or not path.exists():
        return {}
    rows: dict[str, Rows] = json.loads(path.read_text(encoding="utf-8"))
    return rows


def written(path: Path | None, content: object, indent: int | None = None) -> None:
    """Write a file where one is wanted."""
    if path is not None:
        path.write_text(json.dumps(content, indent=indent) + "\n", encoding="utf-8")


def main() -> int:
    """Run the cases, write the results, print the table; 1 where a goal is missed."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--runs", type=int, default=ALL_RUNS, help="of each case")
    parser.add_argument("--quick", action="store_true", help=f"{QUICK_RUNS} runs of each")
    parser.add_argument("--case", default="", help="only cases whose name holds these words")
    parser.add_argument("--out", type=Path, help="write the figures; for the page: " + RESULTS.name)
    parser.add_argument(
        "--keep", type=Path, help="keep every single run there, and begin with those (same code!)"
    )
    asked = parser.parse_args()
    count = QUICK_RUNS if asked.quick else asked.runs
    runs = earlier_runs(asked.keep)
    with ProcessPoolExecutor(PROCESSES) as pool:
        for case in CASES:
            if asked.case in case.name:
                wanted = max(LEAST_RUNS, round(count * case.share))
                runs[case.name] = collect(case, wanted, runs.get(case.name, []), pool)
                written(asked.keep, runs)
    results = {
        "runs": count,
        "cases": {name: summarise(rows) for name, rows in runs.items()},
        "outliers": {
            name: outlier_cost(runs[name], runs[f"{name}, spikes"])
            for name in runs
            if f"{name}, spikes" in runs
        },
    }
    written(asked.out, results, indent=1)
    missed = 0
    print("| item | goal | measured (95 % interval) | |\n|---|---|---|---|")  # noqa: T201
    for row in judged(results):
        print(f"| {row.item} | {row.goal} | {row.figure} | {row.verdict} |")  # noqa: T201
        missed += row.verdict == "NO"
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
