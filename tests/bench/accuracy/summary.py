"""The runs of all cases in numbers that a file can keep, and their judgement.

What to use when: `summarise` for one case, `outlier_cost` for a pair of cases with and
without spikes, `judged` for the rows of the table of goals.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from tests.bench.accuracy import goals
from tests.bench.accuracy.board import NAMES
from tests.bench.accuracy.figures import (
    ALL_GROUPS,
    OFFSET,
    SIGMA_68,
    SIGMA_95,
    Figure,
    Runs,
    chi2_p_value,
    covered,
    covered_together,
    efficiency,
    gather,
    mean_error,
    mean_of,
    members,
    paired_efficiency,
    ratio,
    stated_over_bound,
)

Summary = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Row:
    """One line of the table of goals."""

    item: str
    goal: str
    figure: str
    verdict: str  # yes; no, but chance could do it; NO


def summarise(rows: Sequence[dict[str, Any]]) -> Summary:
    """Return the figures of one case."""
    runs = gather(rows)
    apart = runs.apart()
    return {
        "runs": runs.count,
        "failed": runs.failed,
        "duration_s": float(np.median([row["duration_s"] for row in rows if "duration_s" in row])),
        "parameters": {name: _parameter(runs, k) for k, name in enumerate(NAMES)},
        "offset_apart": _parameter(apart, OFFSET)
        | {"bound_us": 1e6 * float(np.median(apart.bound[:, OFFSET]))},
        "groups": {group: _covers(runs, members(group)) for group in ALL_GROUPS},
        "together": _covers(runs, range(len(NAMES))),
        "chi2": {
            "mean": asdict(mean_of(runs.chi2)),
            "p_value": chi2_p_value(runs.chi2, len(NAMES)),
            "best_mean": asdict(mean_of(runs.best_chi2)),
        },
        "bias_at_begin": [
            float(np.sqrt(np.mean((runs.begin[:, k] / runs.std[:, k]) ** 2))) for k in range(3)
        ],
    }


def _parameter(runs: Runs, k: int) -> Summary:
    return {
        "efficiency": asdict(efficiency(runs, k)),
        "paired": asdict(paired_efficiency(runs, k)),
        "stated": stated_over_bound(runs, k),
        "mean": asdict(mean_error(runs, k)),
        "cover_68": asdict(covered(runs, k, SIGMA_68)),
        "cover_95": asdict(covered(runs, k, SIGMA_95)),
        "cover_2sigma": asdict(covered(runs, k, 2.0)),
        "bound": float(np.median(runs.bound[:, k])),
    }


def _covers(runs: Runs, parameters: Sequence[int]) -> Summary:
    return {
        "cover_68": asdict(covered_together(runs, parameters, SIGMA_68)),
        "cover_95": asdict(covered_together(runs, parameters, SIGMA_95)),
    }


def outlier_cost(clean: Sequence[dict[str, Any]], hit: Sequence[dict[str, Any]]) -> Summary:
    """Return the efficiency with outliers over that without, of the same runs, by group."""
    seeds = {row["seed"] for row in hit if row.get("shown") == len(NAMES)}
    seeds &= {row["seed"] for row in clean if row.get("shown") == len(NAMES)}
    clean_runs = gather([row for row in clean if row["seed"] in seeds])
    two = gather([row for row in hit if row["seed"] in seeds])
    cost = {}
    for group in ALL_GROUPS:
        at = members(group)
        upper, lower = (
            np.mean((runs.error[:, at] / runs.bound[:, at]) ** 2, axis=1)
            for runs in (clean_runs, two)
        )
        cost[group] = asdict(ratio(upper, lower))
    everything = [np.mean((runs.error / runs.bound) ** 2, axis=1) for runs in (clean_runs, two)]
    cost["all"] = asdict(ratio(*everything))
    return cost


def judged(results: Summary) -> Iterator[Row]:
    """Yield the table of goals."""
    for case in goals.CASES:
        result = results["cases"].get(case.name)
        if result is None or case.spikes:
            continue
        known = case.baud is None
        goal = goals.KNOWN_EFFICIENCY if known else goals.ANSWERS_EFFICIENCY
        for group in ALL_GROUPS:
            if group == "time_offset":
                continue
            worst = min(
                (result["parameters"][NAMES[k]]["paired"] for k in members(group)),
                key=lambda figure: float(figure["value"]),
            )
            yield _at_least(f"{case.name}: efficiency, {group}, the worst axis", goal, worst)
        yield from _offset(case.name, result, known)
        for what, limits in (("68", goals.COVER_68), ("95", goals.COVER_95)):
            for group in ALL_GROUPS:
                figure = result["groups"][group][f"cover_{what}"]
                yield _between(f"{case.name}: {what} % intervals, {group}", limits, figure)
            figure = result["together"][f"cover_{what}"]
            yield _between(f"{case.name}: {what} % intervals, all", limits, figure)
        p_value = result["chi2"]["p_value"]
        yield Row(
            f"{case.name}: joint chi-squared of 13",
            f"p >= {goals.CHI2_P}",
            f"mean {_figure_text(result['chi2']['mean'])}, p {p_value:.2g}",
            "yes" if p_value >= goals.CHI2_P else "NO",
        )
    for name, cost in results["outliers"].items():
        for group, figure in cost.items():
            least = 1.0 - goals.OUTLIER_LOSS
            yield _at_least(f"{name}: with outliers over without, {group}", least, figure)


def _offset(name: str, summary: Summary, known: bool) -> Iterator[Row]:
    """The time offset; from answers with and without what no answer can show."""
    parts = [("time offset", summary["parameters"]["time_offset"])]
    if not known:
        parts.append(("time offset without the constant", summary["offset_apart"]))
    for words, figures in parts:
        achieved = figures["efficiency"]
        value, low, high = (1.0 / achieved[k] for k in ("value", "high", "low"))
        yield _at_most(
            f"{name}: {words}, std / bound", goals.OFFSET_RATIO, asdict(Figure(value, low, high))
        )
        yield _between(
            f"{name}: {words}, 2 sigma coverage", goals.OFFSET_COVER, figures["cover_2sigma"]
        )


def _figure_text(figure: Summary) -> str:
    return f"{figure['value']:.3f} ({figure['low']:.3f} to {figure['high']:.3f})"


def _at_least(item: str, goal: float, figure: Summary) -> Row:
    reached, chance = figure["value"] >= goal, figure["high"] >= goal
    return Row(item, f">= {goal:.2f}", _figure_text(figure), _verdict(reached, chance))


def _at_most(item: str, goal: float, figure: Summary) -> Row:
    reached, chance = figure["value"] <= goal, figure["low"] <= goal
    return Row(item, f"<= {goal:.2f}", _figure_text(figure), _verdict(reached, chance))


def _between(item: str, goal: tuple[float, float], figure: Summary) -> Row:
    reached = goal[0] <= figure["value"] <= goal[1]
    chance = figure["low"] <= goal[1] and figure["high"] >= goal[0]
    return Row(
        item, f"{goal[0]:.2f} to {goal[1]:.2f}", _figure_text(figure), _verdict(reached, chance)
    )


def _verdict(reached: bool, chance: bool) -> str:
    return "yes" if reached else ("no, within chance" if chance else "NO")
