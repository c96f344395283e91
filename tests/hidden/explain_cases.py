"""Explain every case of a corpus and write what was said, before any answer is opened.

Each case is one line of RESULTS, written and flushed as soon as it is known, with the seal of
the answer that nobody has looked at yet; a run goes on where it was stopped. Answers are opened
by score_cases.py. What a second recording tells (CASE/held.mcap) needs the truth for its oracle:
its line goes to RESULTS with the ending .held.jsonl, after the case's own line is written.

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

from tests.hidden.scoring.answers import HELD, cases, opened, sealed
from tests.hidden.scoring.bound import bound_of
from tests.hidden.scoring.oracle import gap_of
from tests.hidden.scoring.stated import explained, line_of
from tests.hidden.scoring.variants import REAL, VARIANTS
from tests.support.next_step import next_step

Row = dict[str, Any]


def results_of(path: Path) -> dict[int, Row]:
    """Return the lines of a results file by seed; a line cut off by a stop is left out."""
    results: dict[int, Row] = {}
    if path.exists():
        for text in path.read_text(encoding="utf-8").splitlines():
            try:
                row = json.loads(text)
            except json.JSONDecodeError:
                continue
            results[int(row["seed"])] = row
    return results


def held_path(out: Path) -> Path:
    """Return where the lines of second recordings go."""
    return out.with_suffix(".held.jsonl")


def bounds_path(out: Path) -> Path:
    """Return where the lines of how near rivals come go."""
    return out.with_suffix(".bounds.jsonl")


def answer_line(case: Path, variant: str, out: Path) -> Row:
    """Explain one case and write its line; then what needs the truth, where there is such."""
    seed, seal = int(case.name), sealed(case)
    look = VARIANTS[variant]
    try:
        stated = explained(case / "recording.mcap", look.explain)
        line = look.line_of(line_of(seed, variant, stated), stated)
        line["next_step"] = next_step(stated.explained.solution_extended)
    except Exception as fault:  # a crash is an outcome: it is counted
        line = {"seed": seed, "variant": variant, "crashed": f"{type(fault).__name__}: {fault}"}
        _write(out, {**line, "seal": seal})
        return line
    _write(out, {**line, "seal": seal})
    if (case / HELD).exists() and stated.explained.findings.causes:
        gap = gap_of(case, stated.explained, seal)
        if gap is not None:
            _write(held_path(out), {"seed": seed, **gap})
    if variant == REAL:
        bound = bound_of(case, opened(case, seal))
        if bound is not None:
            _write(bounds_path(out), asdict(bound))
    return line


def _write(out: Path, row: Row) -> None:
    """Add a line in one piece: two processes may write."""
    text = json.dumps(row, separators=(",", ":")) + "\n"
    file = os.open(out, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o644)
    try:
        os.write(file, text.encode())
    finally:
        os.close(file)


def end_cut_line(path: Path) -> None:
    """End a line that a stop cut off, so that the next one begins anew."""
    content = path.read_bytes() if path.exists() else b""
    if content and not content.endswith(b"\n"):
        with path.open("ab") as file:
            file.write(b"\n")


def explain_all(todo: Sequence[Path], variant: str, out: Path, workers: int) -> Iterator[Row]:
    """Yield each case's line as it is done."""
    if workers <= 1:
        for case in todo:
            yield answer_line(case, variant, out)
        return
    with ProcessPoolExecutor(workers) as pool:
        waiting = [pool.submit(answer_line, case, variant, out) for case in todo]
        for future in as_completed(waiting):
            yield future.result()


def main() -> None:
    """Explain what is not explained yet."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("corpus", type=Path, nargs="+")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--variant", choices=sorted(VARIANTS), default="real")
    parser.add_argument("--most", type=int, default=None, help="stop after so many cases")
    arguments = parser.parse_args()
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    for path in (arguments.out, held_path(arguments.out), bounds_path(arguments.out)):
        end_cut_line(path)
    finished = results_of(arguments.out)
    every = [case for corpus in arguments.corpus for case in cases(corpus)]
    todo = [case for case in every if int(case.name) not in finished][: arguments.most]
    sys.stderr.write(f"{len(every)} cases, {len(every) - len(todo)} done or left for later\n")
    begin = time.monotonic()
    for k, line in enumerate(
        explain_all(todo, arguments.variant, arguments.out, arguments.workers), 1
    ):
        each = (time.monotonic() - begin) / k
        left = each * (len(todo) - k)
        names = line.get("crashed") or [entry["set"] for entry in (*line["causes"], *line["raw"])]
        sys.stderr.write(
            f"{k}/{len(todo)} {each:.1f} s each, {left / 60.0:.0f} min left: "
            f"{line['seed']} {line.get('verdict', '')} {names}\n"
        )


if __name__ == "__main__":
    main()
