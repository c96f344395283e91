"""Whether 95 % intervals hold on rigs with causes, seen and unseen.

Each rig is drawn from prior sizes: board, unit, program, and 0 to 4 causes of any size
(`rigs/prior_sizes.py`). The simulator shares nothing with the solver or the emulator. Each row of
the output is one rig; rows that are there are not run again.

Run: python tests/bench/bench_rigs.py --rigs 60 --seed 1 --out rows.jsonl [--jobs 2]
     [--program GYRORIG] [--extend auto] [--persistent] [--matched-prior] [--table FILE]

The shipped prior expects most causes in every rig, but these rigs have 0 to 4. Its intervals are
therefore wider than needed. `--matched-prior` tells the solver how probable each cause is here;
with it, 95 % intervals should hold in 95 %. With `--persistent`, the shipped prior fits.
"""

import argparse
import json
import multiprocessing
import os
import resource
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

for library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")
ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from tests.bench.rigs.coverage import is_missed, table_text  # noqa: E402 - after the number of threads
from tests.bench.rigs.matched_prior import write_matched_prior  # noqa: E402
from tests.bench.rigs.trial import run_trial, solve_by_program, solve_in_process  # noqa: E402

MEMORY_BYTES = 4 << 30  # of one process
RIGS_PER_PROCESS = 50
SEEDS_PER_RUN = 1_000_000
TOLD_EVERY = 10
DEFAULT_RIGS = 20


@dataclass(frozen=True, slots=True)
class TrialOptions:
    """What every trial of a run has in common."""

    is_persistent: bool
    program: str | None
    options: tuple[str, ...]


def run_seed(seed: int, asked: TrialOptions) -> dict[str, Any]:
    """Return the row of one seed; a fault of the program is a row, too."""
    solver = (
        solve_in_process(asked.options)
        if asked.program is None
        else solve_by_program(asked.program, asked.options)
    )
    try:
        return run_trial(seed, asked.is_persistent, solver)
    except (ArithmeticError, MemoryError, ValueError, OSError) as fault:
        return {"seed": seed, "causes": {}, "failed": [f"{type(fault).__name__}: {fault}"]}


def limit_memory() -> None:
    """Let a process that needs too much memory fail alone."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))


def read_rows(path: Path) -> list[dict[str, Any]]:
    """Return the complete rows of a file; a torn last line is left out."""
    rows = []
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else []:
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return rows


def new_rows(seeds: list[int], asked: TrialOptions, jobs: int) -> Iterator[dict[str, Any]]:
    """Yield the rows of the seeds as they are ready."""
    # A ProcessPoolExecutor with a limit of tasks per process waits forever in Python 3.11.
    context = multiprocessing.get_context("spawn")
    with context.Pool(jobs, limit_memory, maxtasksperchild=RIGS_PER_PROCESS) as pool:
        yield from pool.imap_unordered(partial(run_seed, asked=asked), seeds)


def main() -> int:
    """Run the rigs and print the tables; 1 where the coverage misses its goal beyond chance."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("--rigs", type=int, default=DEFAULT_RIGS)
    parser.add_argument("--seed", type=int, default=1, help="another seed is another set of rigs")
    parser.add_argument("--out", type=Path, help="JSON lines, one per rig; finished rigs are kept")
    parser.add_argument("--program", help="a gyrorig program; default: this tree, in process")
    parser.add_argument("--extend", help="passed to `gyrorig solve`")
    parser.add_argument(
        "--persistent", action="store_true", help="every persistent cause in every rig"
    )
    parser.add_argument(
        "--matched-prior",
        action="store_true",
        help="give `gyrorig solve` the probability with which a rig has a cause",
    )
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--table", type=Path, help="write the tables there, too")
    given = parser.parse_args()
    options: tuple[str, ...] = ("--extend", given.extend) if given.extend else ()
    out = given.out or Path(tempfile.mkdtemp(), "rows.jsonl")
    if given.matched_prior:
        prior = out.with_name(f"{out.stem}-prior.yaml").resolve()
        write_matched_prior(prior)
        options += ("--uncertainty", str(prior))
    asked = TrialOptions(given.persistent, given.program, options)
    wanted = [given.seed * SEEDS_PER_RUN + k for k in range(given.rigs)]
    finished = {row["seed"] for row in read_rows(out)}
    missing = [seed for seed in wanted if seed not in finished]
    begun = time.monotonic()
    with out.open("a", encoding="utf-8") as file:
        for k, row in enumerate(new_rows(missing, asked, given.jobs), start=1):
            file.write(json.dumps(row) + "\n")
            file.flush()
            if k % TOLD_EVERY == 0 or k == len(missing):
                spent_s = time.monotonic() - begun
                print(f"{k} of {len(missing)} rigs, {spent_s:.0f} s", file=sys.stderr)  # noqa: T201
    rows = [row for row in read_rows(out) if row["seed"] in set(wanted)]
    text = table_text(sorted(rows, key=lambda row: row["seed"]))
    print(text)  # noqa: T201
    if given.table is not None:
        given.table.write_text(text, encoding="utf-8")
    return 1 if is_missed(rows) else 0


if __name__ == "__main__":
    sys.exit(main())
