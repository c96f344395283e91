"""Explain every case of a corpus and write the result, before any program opens an answer.

The program writes one line of RESULTS per case immediately after the explanation. The line contains
the seal of the closed answer. A stopped run can continue. score_cases.py opens the answers. The
comparison with an oracle on a second recording (CASE/held.mcap) needs the truth. The program writes
its line to RESULTS with the suffix .held.jsonl, after the line of the case.

Run: python tests/hidden/explain_cases.py CORPUS... --out RESULTS.jsonl [--workers 2]
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.hidden.scoring.answers import SECOND_RECORDING, list_cases, open_answer, read_seal
from tests.hidden.scoring.bound import compute_bound
from tests.hidden.scoring.oracle import compute_gap
from tests.hidden.scoring.stated import explain_recording, make_line
from tests.hidden.scoring.variants import REAL, VARIANTS
from tests.support.next_step import next_step

Row = dict[str, Any]


def read_rows(path: Path) -> dict[int, Row]:
    """Return the lines of a results file by seed, without an incomplete line."""
    results: dict[int, Row] = {}
    if path.exists():
        for text in path.read_text(encoding="utf-8").splitlines():
            try:
                row = json.loads(text)
            except json.JSONDecodeError:
                continue
            results[int(row["seed"])] = row
    return results


def gaps_path(out: Path) -> Path:
    """Return the path of the lines of second recordings."""
    return out.with_suffix(".held.jsonl")


def bounds_path(out: Path) -> Path:
    """Return the path of the lines of bounds from rivals."""
    return out.with_suffix(".bounds.jsonl")


def explain_case(case: Path, variant: str, out: Path) -> Row:
    """Explain one case and write its line; then write the lines that need the truth."""
    seed, seal = int(case.name), read_seal(case)
    solver_variant = VARIANTS[variant]
    try:
        stated = explain_recording(case / "recording.mcap", solver_variant.explain)
        line = solver_variant.change_line(make_line(seed, variant, stated), stated)
        line["next_step"] = next_step(stated.explanation.solution_extended)
    except Exception as fault:  # the score counts a crash as an outcome
        line = {"seed": seed, "variant": variant, "crashed": f"{type(fault).__name__}: {fault}"}
        _append_row(out, {**line, "seal": seal})
        return line
    _append_row(out, {**line, "seal": seal})
    if (case / SECOND_RECORDING).exists() and stated.explanation.findings.causes:
        gap = compute_gap(case, stated.explanation, seal)
        if gap is not None:
            _append_row(gaps_path(out), {"seed": seed, **gap})
    if variant == REAL:
        bound = compute_bound(case, open_answer(case, seal))
        if bound is not None:
            _append_row(bounds_path(out), asdict(bound))
    return line


def _append_row(out: Path, row: Row) -> None:
    """Append a line with one write, because two processes may write."""
    text = json.dumps(row, separators=(",", ":")) + "\n"
    file = os.open(out, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    try:
        os.write(file, text.encode())
    finally:
        os.close(file)


def end_cut_line(path: Path) -> None:
    """End an incomplete line, so that the next row starts on a new line."""
    content = path.read_bytes() if path.exists() else b""
    if content and not content.endswith(b"\n"):
        with path.open("ab") as file:
            file.write(b"\n")


def explain_all(open_cases: Sequence[Path], variant: str, out: Path, workers: int) -> Iterator[Row]:
    """Yield the line of each case after its explanation."""
    if workers <= 1:
        for case in open_cases:
            yield explain_case(case, variant, out)
        return
    with ProcessPoolExecutor(workers) as pool:
        futures = [pool.submit(explain_case, case, variant, out) for case in open_cases]
        for future in as_completed(futures):
            yield future.result()


def main() -> None:
    """Explain the cases without a line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("corpus", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--variant", choices=sorted(VARIANTS), default="real")
    parser.add_argument(
        "--most", type=int, default=None, help="largest number of cases in this run"
    )
    arguments = parser.parse_args()
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    for path in (arguments.out, gaps_path(arguments.out), bounds_path(arguments.out)):
        end_cut_line(path)
    finished_rows = read_rows(arguments.out)
    all_cases = [case for corpus in arguments.corpus for case in list_cases(corpus)]
    open_cases = [case for case in all_cases if int(case.name) not in finished_rows][
        : arguments.most
    ]
    sys.stderr.write(
        f"{len(all_cases)} cases, {len(all_cases) - len(open_cases)} done or postponed\n"
    )
    start_s = time.monotonic()
    for k, line in enumerate(
        explain_all(open_cases, arguments.variant, arguments.out, arguments.workers), 1
    ):
        each_s = (time.monotonic() - start_s) / k
        left_s = each_s * (len(open_cases) - k)
        names = line.get("crashed") or [entry["set"] for entry in (*line["causes"], *line["raw"])]
        sys.stderr.write(
            f"{k}/{len(open_cases)} {each_s:.1f} s each, {left_s / 60.0:.0f} min left: "
            f"{line['seed']} {line.get('verdict', '')} {names}\n"
        )


if __name__ == "__main__":
    main()
