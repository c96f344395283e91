"""Tables of coverage per program and parameter, from the results of bench_coverage.py."""

import json
import sys
from functools import cache
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from docs.markdown import Block, show, table
from tests.bench.accuracy.coverage import ALL_NAMES, APART, coverage_rows, verdict

RESULTS = Path(__file__).resolve().parent / "coverage.json"


@cache
def read_results() -> dict[str, Any]:
    """Return the latest results of the benchmark by program; the shortest program first."""
    programs: dict[str, Any] = json.loads(RESULTS.read_text(encoding="utf-8"))
    return dict(sorted(programs.items(), key=lambda item: float(item[1]["duration_s"])))


def coverage() -> str:
    """Return the coverage of 95 % intervals, in percent, per parameter and program."""
    programs = read_results()
    rows = [
        (
            "`time_offset` without the constant" if name == APART else f"`{name}`",
            *(
                _format_cell(program["parameters"][name], program["runs"])
                for program in programs.values()
            ),
        )
        for name in ALL_NAMES
    ]
    head = (
        "parameter",
        *(
            f"`{program.removesuffix('.yaml')}`, {result['runs']}"
            for program, result in programs.items()
        ),
    )
    return table(head, rows)


def _format_cell(figures: dict[str, Any], runs: int) -> str:
    if "value" not in figures:
        return "null"
    value, low, high = (100.0 * figures[key] for key in ("value", "low", "high"))
    text = f"{value:.1f} ({low:.1f} to {high:.1f})"
    if figures["nulls"]:
        text += f", {figures['nulls']} of {runs} null"
    return f"**{text}**" if verdict(figures) == "NO" else text


def misses() -> str:
    """Return the number of coverages that meet the goal, and the table of the others."""
    rows = list(coverage_rows(read_results()))
    missed = [row for row in rows if row.verdict != "yes"]
    beyond = sum(row.verdict == "NO" for row in missed)
    text = (
        f"Of {len(rows)} coverages, {len(rows) - len(missed)} are within the goal. For "
        f"another {len(missed) - beyond} coverages, the value is outside the goal, but a part of "
        f"its 95 % confidence interval is inside. For the other {beyond} coverages, the whole "
        f"95 % confidence interval is outside the goal."
    )
    beyond_rows = [(row.item, row.goal, row.figure) for row in missed if row.verdict == "NO"]
    if not beyond_rows:
        return text
    return f"{text}\n\n" + table(("coverage outside the goal", "goal", "measured"), beyond_rows)


BLOCKS: dict[str, Block] = {"coverage-parameters": coverage, "coverage-misses": misses}


if __name__ == "__main__":
    show(BLOCKS)
