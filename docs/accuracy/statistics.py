"""Tables of simulated runs and the bound, from the results of bench_accuracy.py."""

import json
import sys
from functools import cache
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from docs.markdown import Block, show, table
from tests.bench.accuracy.board import NAMES
from tests.bench.accuracy.goals import (
    ANSWERS_EFFICIENCY,
    CASES,
    COVER_68,
    COVER_95,
    KNOWN_EFFICIENCY,
    OFFSET_COVER,
    OFFSET_RATIO,
    OUTLIER_LOSS,
)
from tests.bench.accuracy.summary import Row, judged
from tests.bench.accuracy.trial import Case

RESULTS = Path(__file__).resolve().parent / "results.json"


@cache
def read_results() -> dict[str, Any]:
    """Return the latest results of the benchmark."""
    document: dict[str, Any] = json.loads(RESULTS.read_text(encoding="utf-8"))
    return document


def _read_cases() -> list[tuple[Case, dict[str, Any]]]:
    """Return the cases without spikes that have results."""
    by_case = read_results()["cases"]
    return [
        (case, by_case[case.name]) for case in CASES if case.name in by_case and not case.spikes
    ]


def _format_interval(figure: dict[str, float], digits: int = 2) -> str:
    return (
        f"{figure['value']:.{digits}f} ({figure['low']:.{digits}f} to {figure['high']:.{digits}f})"
    )


def cases() -> str:
    """Return the table of the simulated cases."""
    rows = [
        (
            case.name,
            f"`{case.program}`, {result['duration_s']:.0f} s",
            f"{case.rate_hz:.0f} Hz, {case.bandwidth_hz:.0f} Hz",
            _describe_reference(case),
            str(result["runs"]),
            str(result["failed"]),
        )
        for case, result in _read_cases()
    ]
    return table(
        (
            "case",
            "motion program, duration",
            "sample rate, low-pass",
            "reference",
            "runs",
            "rejected runs",
        ),
        rows,
    )


def _describe_reference(case: Case) -> str:
    if case.baud is None:
        return "known exactly"
    replies = "BT with counter" if case.counter else "PP and TP alternately"
    return f"{replies}, {case.baud:.0f} baud"


def efficiencies() -> str:
    """Return the efficiency of every parameter and case, with the noise of the best estimate."""
    by_case = _read_cases()
    rows = []
    for name in NAMES:
        cells = [f"{result['parameters'][name]['paired']['value']:.3f}" for _, result in by_case]
        rows.append((f"`{name}`", *cells))
    return table(("parameter", *(case.name for case, _ in by_case)), rows)


def goals() -> str:
    """Return for each case the worst parameter, the coverage, and the joint chi-squared."""
    rows = []
    for case, result in _read_cases():
        goal = KNOWN_EFFICIENCY if case.baud is None else ANSWERS_EFFICIENCY
        of_axes = {name: result["parameters"][name]["paired"] for name in NAMES if "." in name}
        worst = min(of_axes, key=lambda name: float(of_axes[name]["value"]))
        rows.append(
            (
                case.name,
                f"{_format_interval(of_axes[worst])}, `{worst}`; ≥ {goal:.2f}",
                f"{100 * result['together']['cover_68']['value']:.1f} %",
                f"{100 * result['together']['cover_95']['value']:.1f} %",
                f"{_format_interval(result['chi2']['mean'], 1)}; "
                f"{result['chi2']['best_mean']['value']:.1f}",
                f"{result['chi2']['p_value']:.2f}",
            )
        )
    head = (
        "case",
        "lowest efficiency (95 % interval), its parameter; goal",
        f"coverage of 68 % intervals; goal {100 * COVER_68[0]:.0f} to {100 * COVER_68[1]:.0f} %",
        f"coverage of 95 % intervals; goal {100 * COVER_95[0]:.0f} to {100 * COVER_95[1]:.0f} %",
        "mean joint χ²; mean of the best estimate",
        "p-value of the χ² distribution",
    )
    return table(head, rows)


def offsets() -> str:
    """Return the errors of the time offset, with and without the constant of the replies."""
    rows = []
    for case, result in _read_cases():
        parts = [("whole offset", result["parameters"]["time_offset"])]
        if case.baud is not None:
            parts = [parts[0], ("without the constant", result["offset_apart"])]
        for words, figures in parts:
            bound_us = figures.get("bound_us", 1e6 * figures["bound"])
            achieved = figures["efficiency"]
            ratio = {
                k: 1.0 / achieved[j]
                for k, j in zip(("value", "low", "high"), ("value", "high", "low"), strict=True)
            }
            rows.append(
                (
                    case.name,
                    words,
                    f"{bound_us:.1f} µs",
                    _format_interval(ratio),
                    f"{figures['stated']:.2f}",
                    f"{100 * figures['cover_2sigma']['value']:.1f} %",
                )
            )
    head = (
        "case",
        "part",
        "bound",
        f"achieved std / bound; goal ≤ {OFFSET_RATIO}",
        "stated std / bound",
        "coverage of 2 sigma intervals; "
        f"goal {100 * OFFSET_COVER[0]:.0f} to {100 * OFFSET_COVER[1]:.0f} %",
    )
    return table(head, rows)


def outliers() -> str:
    """Return the efficiency with outliers."""
    rows = []
    for name, cost in read_results()["outliers"].items():
        rows.append((name, *(_format_interval(cost[group], 3) for group in cost)))
    groups: dict[str, Any] = next(iter(read_results()["outliers"].values()), {})
    goal = 1 - OUTLIER_LOSS
    head = (f"case (goal for each ratio ≥ {goal:.2f})", *groups)
    return table(head, rows)


def misses() -> str:
    """Return the number of met goals, and the table of the others."""
    rows = list(judged(read_results()))
    missed = [row for row in rows if row.verdict != "yes"]
    summary = f"The solver meets {len(rows) - len(missed)} of {len(rows)} goals."
    if not missed:
        return summary
    return f"{summary}\n\n" + table(
        ("case and quantity", "goal", "measured (95 % interval)", "met"),
        [_format_row(row) for row in missed],
    )


def _format_row(row: Row) -> tuple[str, str, str, str]:
    goal = row.goal.replace(">=", "≥").replace("<=", "≤")
    return row.item, goal, row.figure, row.verdict


BLOCKS: dict[str, Block] = {
    "statistics-cases": cases,
    "statistics-goals": goals,
    "statistics-efficiencies": efficiencies,
    "statistics-offsets": offsets,
    "statistics-outliers": outliers,
    "statistics-misses": misses,
}


if __name__ == "__main__":
    show(BLOCKS)
