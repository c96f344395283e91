"""The rows of many rigs as tables: coverage, verdicts, names, and the worst calibration."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy import stats
from tests.bench.accuracy.board import NAMES
from tests.bench.accuracy.profile import FloatArray
from tests.bench.rigs.trial import K_95, sigmas, with_base_bias

Row = Mapping[str, Any]
GOAL = (0.93, 0.97)  # of 95 % intervals, set before the first run
LEVEL = 0.95
BOOTSTRAPS = 2000
# The simulator gives every rig a small one: `LOG_SPEED_STD` of `serial_session` also acts on ramps.
IN_EVERY_RIG = ("acceleration_error",)


def solved(rows: Iterable[Row]) -> list[Row]:
    """Return the rows with a calibration."""
    return [row for row in rows if "value" in row]


def table_text(rows: Sequence[Row]) -> str:
    """Return all tables as markdown."""
    usable = solved(rows)
    good = [row for row in usable if row["verdict"] == "good"]
    parts = [_outcomes(rows, usable)]
    for title, chosen in (("all calibrations", usable), ("verdict good", good)):
        parts.append(f"## Coverage of 95 % intervals, {title}: {len(chosen)}\n")
        if chosen:
            parts.append("\n".join(_coverage_lines(chosen)))
    parts.append(_worst(good))
    parts.append("\n".join(_cause_lines(usable)))
    return "\n\n".join(parts) + "\n"


def clopper_pearson(inside: int, count: int) -> tuple[float, float]:
    """Return the exact 95 % limits of a share."""
    limits = stats.binomtest(inside, count).proportion_ci(LEVEL)
    return float(limits.low), float(limits.high)


def clustered(by_rig: Sequence[FloatArray]) -> tuple[float, float]:
    """Return 95 % limits of a pooled share by resampling rigs: their parameters are dependent.

    Args:
        by_rig: 0 or 1 for each parameter of each rig; nan is not counted.
    """
    table = np.array([[np.nansum(row), np.sum(np.isfinite(row))] for row in by_rig])
    rng = np.random.default_rng(1)
    chosen = rng.integers(len(by_rig), size=(BOOTSTRAPS, len(by_rig)))
    sums = table[chosen].sum(axis=1)
    low, high = np.quantile(sums[:, 0] / np.maximum(sums[:, 1], 1.0), [0.025, 0.975])
    return float(low), float(high)


def is_missed(rows: Sequence[Row]) -> bool:
    """Return whether the coverage misses its goal beyond chance: its limits by rig exclude it.

    It is that of the total uncertainty; of type A where no calibration states a total.
    """
    usable = solved(rows)
    stated = "total" if any(row["total"] for row in usable) else "std"
    inside = covered(usable, stated) if usable else np.zeros((0, 0))
    if not np.any(np.isfinite(inside)):
        return True
    low, high = clustered(list(inside))
    return low > GOAL[1] or high < GOAL[0]


def covered(rows: Sequence[Row], stated: str, base_bias: bool = False) -> FloatArray:
    """Return 1 where the interval contains the truth, 0 where not, nan where null: (rows, 13).

    Args:
        rows: with a calibration.
        stated: `std` for type A, `total` for the stated intervals of the total uncertainty.
        base_bias: the truth has the bias without the causes that add to it.
    """
    return np.array(
        [_inside(row, stated, with_base_bias(row) if base_bias else None) for row in rows]
    )


def _inside(row: Row, stated: str, truth: FloatArray | None) -> FloatArray:
    intervals = row.get("interval") if stated == "total" else None
    if intervals is None:
        z = sigmas(row, stated, truth)
        return np.where(np.isfinite(z), (np.abs(z) <= K_95).astype(np.float64), np.nan)
    true = row["truth"] if truth is None else truth
    return np.array(
        [
            np.nan if limits is None else float(limits[0] <= value <= limits[1])
            for limits, value in zip(intervals, true, strict=True)
        ]
    )


def _outcomes(rows: Sequence[Row], usable: Sequence[Row]) -> str:
    verdicts = Counter(row["verdict"] for row in usable)
    lines = [
        "## Outcomes\n",
        f"- rigs: {len(rows)}; calibrations: {len(usable)}; refused by the program: "
        f"{len(rows) - len(usable)}",
        "- verdicts: " + ", ".join(f"{name} {count}" for name, count in verdicts.most_common()),
    ]
    reasons = Counter(_kind(row["failed"][0]) for row in rows if "failed" in row)
    lines += [f"- {count} x {reason}" for reason, count in reasons.most_common()]
    if usable:
        lines.append(f"- CPU time of a solve: median {np.median([r['cpu_s'] for r in usable])} s")
    return "\n".join(lines)


def _kind(text: str) -> str:
    return text.split(". ", maxsplit=1)[0][-120:]


def _share(column: FloatArray) -> str:
    known = column[np.isfinite(column)]
    if known.size == 0:
        return "-"
    inside = int(known.sum())
    low, high = clopper_pearson(inside, known.size)
    return f"{inside} of {known.size} = {inside / known.size:.1%} ({low:.1%} to {high:.1%})"


def _coverage_lines(rows: Sequence[Row]) -> list[str]:
    """Return the table of coverage by parameter, with the pooled share of both kinds."""
    kinds = {kind: covered(rows, kind) for kind in ("std", "total")}
    lines = ["| parameter | type A | total | null |", "| --- | --- | --- | --- |"]
    nulls = np.array([[value is None for value in row["value"]] for row in rows])
    for k, name in enumerate(NAMES):
        shares = " | ".join(_share(kinds[kind][:, k]) for kind in kinds)
        lines.append(f"| `{name}` | {shares} | {int(nulls[:, k].sum())} |")
    lines.append("| pooled | " + " | ".join(_pooled(kinds[k]) for k in kinds) + " | |")
    apart = [_share(kinds[kind][:, 3:12].ravel()) for kind in kinds]
    lines.append("| sensor matrix only | " + " | ".join(apart) + " | |")
    whole = [_whole_rigs(kinds[kind]) for kind in kinds]
    lines.append("| all 13 of a rig | " + " | ".join(whole) + " | |")
    other = [_share(covered(rows, kind, base_bias=True)[:, :3].ravel()) for kind in kinds]
    lines.append("| bias without its causes | " + " | ".join(other) + " | |")
    return lines


def _pooled(inside: FloatArray) -> str:
    if not np.any(np.isfinite(inside)):
        return "-"
    low, high = clustered(list(inside))
    met = "met" if GOAL[0] <= np.nanmean(inside) <= GOAL[1] else "missed"
    return f"{np.nanmean(inside):.1%}, by rig {low:.1%} to {high:.1%}; goal {met}"


def _whole_rigs(inside: FloatArray) -> str:
    known = np.any(np.isfinite(inside), axis=1)
    whole = np.array([np.all(row[np.isfinite(row)] == 1.0) for row in inside[known]], dtype=float)
    return _share(whole)


def _worst(good: Sequence[Row]) -> str:
    lines = [
        "## The worst good calibrations\n",
        "| seed | parameter | type A sd | total sd | causes |",
    ]
    lines.append("| --- | --- | --- | --- | --- |")
    ranked = []
    for row in good:
        z = np.abs(sigmas(row, "std"))
        if np.any(np.isfinite(z)):
            ranked.append((float(np.nanmax(z)), int(np.nanargmax(z)), row))
    ranked.sort(key=lambda item: -item[0])
    for size, k, row in ranked[:5]:
        z_total = np.abs(sigmas(row, "total"))
        total = f"{np.nanmax(z_total):.1f}" if np.any(np.isfinite(z_total)) else "-"
        lines.append(
            f"| {row['seed']} | `{NAMES[k]}` | {size:.1f} | {total} | {_causes_text(row)} |"
        )
    return "\n".join(lines)


def _causes_text(row: Row) -> str:
    return "; ".join(
        f"{name} " + ", ".join(f"{key} {value:.3g}" for key, value in sizes.items())
        for name, sizes in row["causes"].items()
    )


def _cause_lines(rows: Sequence[Row]) -> list[str]:
    """Return how each cause was treated: verdicts, names, largest error of good calibrations."""
    lines = ["## By cause\n", "| cause | rigs | good | named | largest type A sd of a good one |"]
    lines.append("| --- | --- | --- | --- | --- |")
    for name in [*sorted({cause for row in rows for cause in row["causes"]}), ""]:
        chosen = [row for row in rows if name in row["causes"] or (not name and not row["causes"])]
        good = [row for row in chosen if row["verdict"] == "good"]
        named = sum(name in {*row["named"], *row["terms"]} for row in chosen)
        worst = max((float(np.nanmax(np.abs(sigmas(row, "std")))) for row in good), default=None)
        shown = "-" if worst is None else f"{worst:.1f}"
        text = f"`{name}`" if name else "none"
        lines.append(f"| {text} | {len(chosen)} | {len(good)} | {named} | {shown} |")
    wrong = Counter(
        cause
        for row in rows
        for cause in {*row["named"], *row["terms"]} - {*row["causes"], *IN_EVERY_RIG}
    )
    lines.append(
        "\nNamed but not there: " + (", ".join(f"{c} {n}" for c, n in wrong.items()) or "none")
    )
    return lines
