"""What a fleet's statistics find, how late, and what they raise for nothing.

Synthetic fleets (`synthetic_fleet`), each asked night after night by the functions that `gyrorig
fleet` asks: some with a rig that drifts, some with a bad lot, some with a constant that is wrong
on every unit, some with nothing. Beside them Shewhart's charts with the usual limits. Then one
fleet of many boards with nothing in it, for what is raised in a night.

Run: python tests/bench/bench_fleet_statistics.py [--fleets 200] [--boards 100000] [--json FILE]
"""

import argparse
import json
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from scipy.special import ndtri
from tests.bench.fleet.parts import ERROR, SCATTER, SPREAD
from tests.bench.fleet.shewhart import LIMIT, beyond, group_means
from tests.bench.synthetic_fleet import FleetPlan, column_of, rooms_of

from gyrorig_solver.fleet.drift.common_offsets import NOMINAL_VALUES
from gyrorig_solver.fleet.drift.ewma_charts import (
    GROUP_FALSE_ALARM_RATE,
    Grouping,
    ParameterHistory,
    benjamini_hochberg,
    board_p_values,
    detect_drift,
    ewma_chart,
    shifted_groups,
)
from gyrorig_solver.fleet.drift.fleet_overview import compare_groups
from gyrorig_solver.fleet.drift.latest_calibrations import PARAMETER_COLUMNS, LatestCalibrations

BOARDS, NIGHTS, RIGS, LOTS, BEGIN = 400, 40, 8, 4, 20
TEMPERATURE = {"bias_x": 1e-4, "bias_y": -6e-5, "bias_z": 3e-5}
# boards' own slopes differ by half of that: a tenth of the data sheet's limit (0.03 dps/K)
SLOPE_SPREAD = dict.fromkeys(TEMPERATURE, 5e-5)
# a night's drift, in the deviations of one board's night
RIG_SIZES = (0.02, 0.05, 0.1, 0.2, 0.5)
# in what boards of one kind differ by
LOT_SIZES = (0.2, 0.3, 0.5, 0.75, 1.0)
CONSTANT_SIZES = (0.5, 1.0, 2.0, 4.0, 8.0)
KINDS = {"nothing": (0.0,), "rig": RIG_SIZES, "lot": LOT_SIZES, "constant": CONSTANT_SIZES}


@dataclass(frozen=True)
class AlertRecord:
    """What one way of asking said of one fleet."""

    delay: int | None  # nights from its begin until what is hidden was told, None: never
    wrong: int  # other groups or constants told, on any night
    board_nights: int  # boards and parameters told, over all nights asked


@dataclass(frozen=True)
class Case:
    """One fleet."""

    kind: str
    size: float
    ours: AlertRecord
    usual: AlertRecord
    wide: AlertRecord  # Shewhart's, the limits so wide that groups raise as little as ours


def family(parameter: str) -> str:
    """Return which family a parameter is of."""
    return parameter.split("_", maxsplit=1)[0]


def plan_of(seed: int, kind: str, size: float) -> FleetPlan:
    """Return a fleet with something of that size hidden in it."""
    rng = np.random.default_rng([seed, 7])
    plan = FleetPlan(
        boards=BOARDS,
        nights=NIGHTS,
        rigs=RIGS,
        lots=LOTS,
        seed=seed,
        temperature_per_c=TEMPERATURE,
        slope_spread=SLOPE_SPREAD,
    )
    name = str(rng.choice([*NOMINAL_VALUES] if kind == "constant" else PARAMETER_COLUMNS))
    f, sign = family(name), float(rng.choice((-1.0, 1.0)))
    if kind == "rig":
        a_night = sign * size * float(np.hypot(SCATTER[f], ERROR[f]))
        return replace(plan, rig_drift=(int(rng.integers(RIGS)), name, BEGIN, a_night))
    if kind == "lot":
        return replace(plan, bad_lot=(int(rng.integers(LOTS)), name, sign * size * SPREAD[f]))
    if kind == "constant":
        return replace(plan, constant=(name, sign * size * SPREAD[f]))
    return plan


class Fleet:
    """A fleet's whole history, in memory."""

    def __init__(self, plan: FleetPlan) -> None:
        self.plan = plan
        rng = np.random.default_rng(plan.seed)
        measured, self.temperature = rooms_of(plan, rng)
        self.value: dict[str, np.ndarray] = {}
        self.variance: dict[str, np.ndarray] = {}
        for name in PARAMETER_COLUMNS:
            value, std = column_of(plan, name, rng, self.temperature)
            self.value[name] = np.where(measured, value, np.nan)
            self.variance[name] = np.where(measured, std**2, np.nan)
        board = np.arange(plan.boards)
        groups = {"rig": board % plan.rigs, "lot": board % plan.lots, "fleet": board * 0}
        self.groups = groups
        self.groupings = [
            Grouping.by_name(kind, [f"{kind}-{n:05d}" for n in of]) for kind, of in groups.items()
        ]

    def nights(self, name: str, until: int) -> ParameterHistory:
        """Return one parameter's history up to and with a night."""
        upto = slice(0, until + 1)
        return ParameterHistory(
            name, self.value[name][upto], self.variance[name][upto], self.temperature[upto]
        )

    def newest(self, night: int) -> LatestCalibrations:
        """Return what the index would say of the boards after a night."""
        board = np.arange(self.plan.boards)
        last = {}
        for name in PARAMETER_COLUMNS:
            is_known = np.isfinite(self.value[name][: night + 1])
            last[name] = night - np.argmax(is_known[::-1], axis=0)
        none = [""] * len(board)
        return LatestCalibrations(
            board=[str(n) for n in board],
            sensor=["L3G4200D"] * len(board),
            rig=[f"rig-{n:05d}" for n in self.groups["rig"]],
            lot=[f"lot-{n:05d}" for n in self.groups["lot"]],
            site=none,
            trust=none,
            findings=none,
            file=none,
            version=[1] * len(board),
            version_count=[1] * len(board),
            start_s=np.zeros(len(board)),
            reduced_chi2=np.ones(len(board)),
            temperature_c=np.full(len(board), 25.0),
            clock_skew_ppm=np.full(len(board), np.nan),
            count_size_rad_s=np.full(len(board), np.nan),
            value={n: self.value[n][last[n], board] for n in PARAMETER_COLUMNS},
            std={n: np.sqrt(self.variance[n][last[n], board]) for n in PARAMETER_COLUMNS},
        )


def ours(fleet: Fleet, kind: str) -> AlertRecord:
    """Ask a fleet as `gyrorig fleet` does, night after night."""
    delay, wrong, board_nights = None, 0, 0
    for night in range(BEGIN, NIGHTS):
        charts = [ewma_chart(fleet.nights(name, night)) for name in PARAMETER_COLUMNS]
        moved = detect_drift(charts, fleet.groupings)
        alerts = [
            (group_shift.kind, group_shift.group, group_shift.parameter)
            for group_shift in moved.group_shifts
        ]
        _, constants, differing = compare_groups(fleet.newest(night))
        common = [constant.result.parameter for constant in constants if constant.result.is_common]
        alerts += [("constant", "all", name) for name in common]
        alerts += [(k, test.extreme_group, test.parameter) for _, k, test in differing]
        right = hidden_in(fleet.plan, kind)
        if right in alerts and delay is None:
            delay = night - BEGIN + 1
        wrong += sum(alert != right for alert in alerts)
        board_nights += int(moved.drifting.sum())
    return AlertRecord(delay, wrong, board_nights)


def usual(fleet: Fleet, kind: str, limit: float) -> AlertRecord:
    """Ask it by Shewhart's charts: each board, each group, each mean against nominal.

    Args:
        fleet: all of its nights.
        kind: what is hidden in it.
        limit: in deviations; 3 is the usual one.
    """
    delay, wrong, board_nights = None, 0, 0
    right = hidden_in(fleet.plan, kind)
    for name in PARAMETER_COLUMNS:
        value = fleet.value[name]
        board_nights += int(beyond(value, limit)[BEGIN:].sum())
        for grouping in fleet.groupings:
            means = group_means(value, grouping.group_index, len(grouping.names))
            for night, group in zip(*np.nonzero(beyond(means, limit)[BEGIN:]), strict=True):
                if (grouping.kind, grouping.names[group], name) == right and kind == "rig":
                    delay = min(delay or NIGHTS, int(night) + 1)
                else:
                    wrong += 1
    for night in range(BEGIN, NIGHTS):
        for alert in _of_newest(fleet.newest(night), limit):
            if alert == right:
                delay = min(delay or NIGHTS, night - BEGIN + 1)
            else:
                wrong += 1
    return AlertRecord(delay, wrong, board_nights)


def _of_newest(newest: LatestCalibrations, limit: float) -> Iterator[tuple[str, str, str]]:
    """Yield lots, and means against nominal, that far beyond deviations of their mean."""
    lots = np.array(newest.lot)
    for name in PARAMETER_COLUMNS:
        value = newest.value[name]
        sigma, centre = float(np.nanstd(value, ddof=1)), float(np.nanmean(value))
        for lot in sorted(set(newest.lot)):
            here = value[lots == lot]
            if abs(float(np.nanmean(here)) - centre) > limit * sigma / np.sqrt(here.size):
                yield "lot", lot, name
        if name in NOMINAL_VALUES:
            off = abs(centre - NOMINAL_VALUES[name])
            if off > limit * sigma / np.sqrt(value.size):
                yield "constant", "all", name


def hidden_in(plan: FleetPlan, kind: str) -> tuple[str, str, str] | None:
    """Return what has to be told."""
    if kind == "rig" and plan.rig_drift is not None:
        return "rig", f"rig-{plan.rig_drift[0]:05d}", plan.rig_drift[1]
    if kind == "lot" and plan.bad_lot is not None:
        return "lot", f"lot-{plan.bad_lot[0]:05d}", plan.bad_lot[1]
    if kind == "constant" and plan.constant is not None:
        return "constant", "all", plan.constant[0]
    return None


def cases(fleets: int, first_seed: int) -> Iterator[Case]:
    """Ask that many fleets, the kinds in turn and their sizes in turn."""
    kinds = list(KINDS)
    for number in range(fleets):
        kind = kinds[number % len(kinds)]
        sizes = KINDS[kind]
        size = sizes[number // len(kinds) % len(sizes)]
        fleet = Fleet(plan_of(first_seed + number, kind, size))
        tests = len(PARAMETER_COLUMNS) * sum(len(grouping.names) for grouping in fleet.groupings)
        same = float(-ndtri(0.5 * GROUP_FALSE_ALARM_RATE / tests))
        yield Case(
            kind, size, ours(fleet, kind), usual(fleet, kind, LIMIT), usual(fleet, kind, same)
        )
        sys.stderr.write(f"\r{number + 1} of {fleets} ")
    sys.stderr.write("\n")


def raised(boards: int, asked: int, seed: int) -> dict[str, float]:
    """Return what is raised in a night for nothing in a large fleet, by both ways."""
    nights = 12 + asked
    plan = FleetPlan(
        boards=boards,
        nights=nights,
        rigs=64,
        lots=20,
        seed=seed,
        temperature_per_c=TEMPERATURE,
        slope_spread=SLOPE_SPREAD,
    )
    rng = np.random.default_rng(seed)
    measured, temperature = rooms_of(plan, rng)
    board = np.arange(boards)
    groupings = [
        Grouping.by_name(kind, [f"{kind}-{n:05d}" for n in of])
        for kind, of in (("rig", board % 64), ("lot", board % 20), ("fleet", board * 0))
    ]
    tests = len(PARAMETER_COLUMNS) * sum(len(grouping.names) for grouping in groupings)
    p = np.full((asked, boards, len(PARAMETER_COLUMNS)), np.nan, dtype=np.float32)
    groups = usual_boards = usual_groups = 0
    for at, name in enumerate(PARAMETER_COLUMNS):
        value, std = column_of(plan, name, rng, temperature)
        value[~measured] = np.nan
        for night in range(asked):
            upto = slice(0, 12 + night + 1)
            chart = ewma_chart(
                ParameterHistory(name, value[upto], std[upto] ** 2, temperature[upto])
            )
            moves, left = shifted_groups(chart, groupings, tests)
            groups += len(moves)
            p[night, :, at] = board_p_values([left])[:, 0]
        usual_boards += int(beyond(value)[12:].sum())
        for grouping in groupings:
            means = group_means(value, grouping.group_index, len(grouping.names))
            usual_groups += int(beyond(means)[12:].sum())
        sys.stderr.write(f"\r{name:<24}")
    sys.stderr.write("\n")
    alarms = [int(benjamini_hochberg(night.astype(np.float64)).sum()) for night in p]
    return {
        "boards": boards,
        "nights": asked,
        "ours_boards_a_night": float(np.mean(alarms)),
        "ours_groups_a_night": groups / asked,
        "usual_boards_a_night": usual_boards / asked,
        "usual_groups_a_night": usual_groups / asked,
    }


def table(cases: Sequence[Case]) -> list[str]:
    """Return the figures as lines of a table."""
    lines = [
        "| hidden | size | fleets | told | nights until | wrong a night | Shewhart, 3 sigma: told "
        "| nights until | wrong a night | as wide as ours: told | nights until | wrong a night |",
        "|" + "---|" * 12,
    ]
    for kind, sizes in KINDS.items():
        for size in sizes:
            here = [case for case in cases if case.kind == kind and case.size == size]
            if not here:
                continue
            words = [f"{len(here)}"]
            for way in ("ours", "usual", "wide"):
                methods: list[AlertRecord] = [getattr(case, way) for case in here]
                delays = [method.delay for method in methods if method.delay is not None]
                late = f"{np.median(delays):.0f}" if delays else "-"
                share = "-" if kind == "nothing" else f"{len(delays)} of {len(methods)}"
                nights = len(methods) * (NIGHTS - BEGIN)
                words += [share, late, f"{sum(method.wrong for method in methods) / nights:.3g}"]
            lines.append(f"| {kind} | {size:g} | {' | '.join(words)} |")
    return lines


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; return 1 where nothing hidden raises more than it may."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--fleets", type=int, default=16)
    parser.add_argument("--boards", type=int, default=20_000, help="of the large fleet")
    parser.add_argument("--nights", type=int, default=5, help="asked of the large fleet")
    parser.add_argument("--seed", type=int, default=4_000)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args(arguments)
    results = list(cases(options.fleets, options.seed))
    sys.stdout.write("\n".join(table(results)) + "\n")
    large = raised(options.boards, options.nights, options.seed)
    sys.stdout.write(json.dumps(large, indent=1) + "\n")
    if options.json is not None:
        document = {"cases": [asdict(case) for case in results], "large": large}
        options.json.write_text(json.dumps(document, indent=1))
    quiet = [case.ours.wrong for case in results if case.kind == "nothing"]
    nights = max(len(quiet), 1) * (NIGHTS - BEGIN)
    return int(sum(quiet) > 3 + 0.01 * nights)


if __name__ == "__main__":
    sys.exit(main())
