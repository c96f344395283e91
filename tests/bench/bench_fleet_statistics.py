"""Measure the detections, the delays and the false alarms of the fleet statistics.

The bench draws synthetic fleets (`synthetic_fleet`). Some fleets have a drifting rig, some a bad
lot, some a constant that is wrong on every unit, and some no fault. The functions of `gyrorig
fleet` test each fleet night after night. The bench compares them with Shewhart charts with the
usual limits. A large fleet without a fault then gives the number of false alarms per night.

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
from tests.bench.synthetic_fleet import FleetPlan, draw_conditions, draw_parameter

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

BOARDS, NIGHTS, RIGS, LOTS, FIRST_NIGHT = 400, 40, 8, 4, 20
TEMPERATURE = {"bias_x": 1e-4, "bias_y": -6e-5, "bias_z": 3e-5}
# Slopes of boards differ by half of that: a tenth of the limit in the data sheet (0.03 dps/K).
SLOPE_SPREAD = dict.fromkeys(TEMPERATURE, 5e-5)
# The drift per night, in standard deviations of one board in one night
RIG_SIZES = (0.02, 0.05, 0.1, 0.2, 0.5)
# In multiples of the spread between boards of one sensor type
LOT_SIZES = (0.2, 0.3, 0.5, 0.75, 1.0)
CONSTANT_SIZES = (0.5, 1.0, 2.0, 4.0, 8.0)
KINDS = {"nothing": (0.0,), "rig": RIG_SIZES, "lot": LOT_SIZES, "constant": CONSTANT_SIZES}


@dataclass(frozen=True)
class AlertRecord:
    """The alarms of one method for one fleet."""

    delay: int | None  # nights until the hidden fault was detected, or None
    wrong: int  # alarms for other groups or constants, on all nights
    board_nights: int  # alarms for parameters of boards, on all tested nights


@dataclass(frozen=True)
class Case:
    """The results of all methods for one fleet."""

    kind: str
    size: float
    ours: AlertRecord
    usual: AlertRecord
    wide: AlertRecord  # Shewhart charts with limits as wide as ours


def family_of(parameter: str) -> str:
    """Return the family of a parameter, for example `scale`."""
    return parameter.split("_", maxsplit=1)[0]


def plan_of(seed: int, kind: str, size: float) -> FleetPlan:
    """Return the plan of a fleet with a hidden fault of a given size."""
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
    family, sign = family_of(name), float(rng.choice((-1.0, 1.0)))
    if kind == "rig":
        drift_per_night = sign * size * float(np.hypot(SCATTER[family], ERROR[family]))
        return replace(
            plan, rig_drift=(int(rng.integers(RIGS)), name, FIRST_NIGHT, drift_per_night)
        )
    if kind == "lot":
        return replace(plan, bad_lot=(int(rng.integers(LOTS)), name, sign * size * SPREAD[family]))
    if kind == "constant":
        return replace(plan, constant=(name, sign * size * SPREAD[family]))
    return plan


class Fleet:
    """The whole history of a fleet, in memory."""

    def __init__(self, plan: FleetPlan) -> None:
        self.plan = plan
        rng = np.random.default_rng(plan.seed)
        measured, self.temperature = draw_conditions(plan, rng)
        self.value: dict[str, np.ndarray] = {}
        self.variance: dict[str, np.ndarray] = {}
        for name in PARAMETER_COLUMNS:
            value, std = draw_parameter(plan, name, rng, self.temperature)
            self.value[name] = np.where(measured, value, np.nan)
            self.variance[name] = np.where(measured, std**2, np.nan)
        board = np.arange(plan.boards)
        groups = {"rig": board % plan.rigs, "lot": board % plan.lots, "fleet": board * 0}
        self.groups = groups
        self.groupings = [
            Grouping.by_name(kind, [f"{kind}-{n:05d}" for n in group])
            for kind, group in groups.items()
        ]

    def get_history(self, name: str, last_night: int) -> ParameterHistory:
        """Return the history of one parameter until a night, including this night."""
        nights_so_far = slice(0, last_night + 1)
        return ParameterHistory(
            name,
            self.value[name][nights_so_far],
            self.variance[name][nights_so_far],
            self.temperature[nights_so_far],
        )

    def get_latest(self, night: int) -> LatestCalibrations:
        """Return the latest calibrations that the index has after a night."""
        board = np.arange(self.plan.boards)
        last = {}
        for name in PARAMETER_COLUMNS:
            is_known = np.isfinite(self.value[name][: night + 1])
            last[name] = night - np.argmax(is_known[::-1], axis=0)
        empty = [""] * len(board)
        return LatestCalibrations(
            board=[str(n) for n in board],
            sensor=["L3G4200D"] * len(board),
            rig=[f"rig-{n:05d}" for n in self.groups["rig"]],
            lot=[f"lot-{n:05d}" for n in self.groups["lot"]],
            site=empty,
            trust=empty,
            findings=empty,
            file=empty,
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
    """Test a fleet as `gyrorig fleet` does, night after night."""
    delay, wrong, board_nights = None, 0, 0
    for night in range(FIRST_NIGHT, NIGHTS):
        charts = [ewma_chart(fleet.get_history(name, night)) for name in PARAMETER_COLUMNS]
        drift = detect_drift(charts, fleet.groupings)
        alerts = [
            (group_shift.kind, group_shift.group, group_shift.parameter)
            for group_shift in drift.group_shifts
        ]
        _, constants, differing = compare_groups(fleet.get_latest(night))
        common = [constant.result.parameter for constant in constants if constant.result.is_common]
        alerts += [("constant", "all", name) for name in common]
        alerts += [(k, test.extreme_group, test.parameter) for _, k, test in differing]
        hidden_fault = hidden_in(fleet.plan, kind)
        if hidden_fault in alerts and delay is None:
            delay = night - FIRST_NIGHT + 1
        wrong += sum(alert != hidden_fault for alert in alerts)
        board_nights += int(drift.drifting.sum())
    return AlertRecord(delay, wrong, board_nights)


def run_shewhart(fleet: Fleet, kind: str, limit: float) -> AlertRecord:
    """Test a fleet with Shewhart charts of each board, each group and each mean.

    Args:
        fleet: the fleet with all its nights.
        kind: the kind of its hidden fault.
        limit: in standard deviations; 3 is the usual limit.
    """
    delay, wrong, board_nights = None, 0, 0
    hidden_fault = hidden_in(fleet.plan, kind)
    for name in PARAMETER_COLUMNS:
        value = fleet.value[name]
        board_nights += int(beyond(value, limit)[FIRST_NIGHT:].sum())
        for grouping in fleet.groupings:
            means = group_means(value, grouping.group_index, len(grouping.names))
            for night, group in zip(*np.nonzero(beyond(means, limit)[FIRST_NIGHT:]), strict=True):
                if (grouping.kind, grouping.names[group], name) == hidden_fault and kind == "rig":
                    delay = min(delay or NIGHTS, int(night) + 1)
                else:
                    wrong += 1
    for night in range(FIRST_NIGHT, NIGHTS):
        for alert in _find_outliers(fleet.get_latest(night), limit):
            if alert == hidden_fault:
                delay = min(delay or NIGHTS, night - FIRST_NIGHT + 1)
            else:
                wrong += 1
    return AlertRecord(delay, wrong, board_nights)


def _find_outliers(latest: LatestCalibrations, limit: float) -> Iterator[tuple[str, str, str]]:
    """Yield the lots and the constants whose mean is beyond the limit."""
    lots = np.array(latest.lot)
    for name in PARAMETER_COLUMNS:
        value = latest.value[name]
        sigma, centre = float(np.nanstd(value, ddof=1)), float(np.nanmean(value))
        for lot in sorted(set(latest.lot)):
            lot_values = value[lots == lot]
            if abs(float(np.nanmean(lot_values)) - centre) > limit * sigma / np.sqrt(
                lot_values.size
            ):
                yield "lot", lot, name
        if name in NOMINAL_VALUES:
            deviation = abs(centre - NOMINAL_VALUES[name])
            if deviation > limit * sigma / np.sqrt(value.size):
                yield "constant", "all", name


def hidden_in(plan: FleetPlan, kind: str) -> tuple[str, str, str] | None:
    """Return kind, name and parameter of the hidden fault, or None."""
    if kind == "rig" and plan.rig_drift is not None:
        return "rig", f"rig-{plan.rig_drift[0]:05d}", plan.rig_drift[1]
    if kind == "lot" and plan.bad_lot is not None:
        return "lot", f"lot-{plan.bad_lot[0]:05d}", plan.bad_lot[1]
    if kind == "constant" and plan.constant is not None:
        return "constant", "all", plan.constant[0]
    return None


def run_cases(fleets: int, first_seed: int) -> Iterator[Case]:
    """Test several fleets, with each kind of fault and each size in turn."""
    kinds = list(KINDS)
    for number in range(fleets):
        kind = kinds[number % len(kinds)]
        sizes = KINDS[kind]
        size = sizes[number // len(kinds) % len(sizes)]
        fleet = Fleet(plan_of(first_seed + number, kind, size))
        tests = len(PARAMETER_COLUMNS) * sum(len(grouping.names) for grouping in fleet.groupings)
        wide_limit = float(-ndtri(0.5 * GROUP_FALSE_ALARM_RATE / tests))
        yield Case(
            kind,
            size,
            ours(fleet, kind),
            run_shewhart(fleet, kind, LIMIT),
            run_shewhart(fleet, kind, wide_limit),
        )
        sys.stderr.write(f"\r{number + 1} of {fleets} ")
    sys.stderr.write("\n")


def count_false_alarms(boards: int, test_nights: int, seed: int) -> dict[str, float]:
    """Return the false alarms per night in a large fleet without a fault, for both methods."""
    nights = 12 + test_nights
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
    measured, temperature = draw_conditions(plan, rng)
    board = np.arange(boards)
    groupings = [
        Grouping.by_name(kind, [f"{kind}-{n:05d}" for n in group])
        for kind, group in (("rig", board % 64), ("lot", board % 20), ("fleet", board * 0))
    ]
    tests = len(PARAMETER_COLUMNS) * sum(len(grouping.names) for grouping in groupings)
    p = np.full((test_nights, boards, len(PARAMETER_COLUMNS)), np.nan, dtype=np.float32)
    groups = usual_boards = usual_groups = 0
    for at, name in enumerate(PARAMETER_COLUMNS):
        value, std = draw_parameter(plan, name, rng, temperature)
        value[~measured] = np.nan
        for night in range(test_nights):
            nights_so_far = slice(0, 12 + night + 1)
            chart = ewma_chart(
                ParameterHistory(
                    name, value[nights_so_far], std[nights_so_far] ** 2, temperature[nights_so_far]
                )
            )
            shifts, rest = shifted_groups(chart, groupings, tests)
            groups += len(shifts)
            p[night, :, at] = board_p_values([rest])[:, 0]
        usual_boards += int(beyond(value)[12:].sum())
        for grouping in groupings:
            means = group_means(value, grouping.group_index, len(grouping.names))
            usual_groups += int(beyond(means)[12:].sum())
        sys.stderr.write(f"\r{name:<24}")
    sys.stderr.write("\n")
    alarms = [int(benjamini_hochberg(night.astype(np.float64)).sum()) for night in p]
    return {
        "boards": boards,
        "nights": test_nights,
        "ours_boards_a_night": float(np.mean(alarms)),
        "ours_groups_a_night": groups / test_nights,
        "usual_boards_a_night": usual_boards / test_nights,
        "usual_groups_a_night": usual_groups / test_nights,
    }


def format_table(cases: Sequence[Case]) -> list[str]:
    """Return the lines of the table of results."""
    lines = [
        "| hidden fault | size | fleets | our method: detected | nights | false reports per night "
        "| Shewhart, 3 sigma: detected | nights | false reports per night "
        "| Shewhart, wide limits: detected | nights | false reports per night |",
        "|" + "---|" * 12,
    ]
    for kind, sizes in KINDS.items():
        for size in sizes:
            selected = [case for case in cases if case.kind == kind and case.size == size]
            if not selected:
                continue
            cells = [f"{len(selected)}"]
            for method in ("ours", "usual", "wide"):
                records: list[AlertRecord] = [getattr(case, method) for case in selected]
                delays = [record.delay for record in records if record.delay is not None]
                delay = f"{np.median(delays):.0f}" if delays else "-"
                share = "-" if kind == "nothing" else f"{len(delays)} of {len(records)}"
                nights = len(records) * (NIGHTS - FIRST_NIGHT)
                cells += [share, delay, f"{sum(record.wrong for record in records) / nights:.3g}"]
            lines.append(f"| {kind} | {size:g} | {' | '.join(cells)} |")
    return lines


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; return 1 if fleets without a fault have too many false alarms."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--fleets", type=int, default=16, help="number of fleets")
    parser.add_argument(
        "--boards", type=int, default=20_000, help="number of boards of the large fleet"
    )
    parser.add_argument(
        "--nights", type=int, default=5, help="number of nights on which the large fleet is tested"
    )
    parser.add_argument("--seed", type=int, default=4_000)
    parser.add_argument("--json", type=Path, help="write the results to this file")
    options = parser.parse_args(arguments)
    results = list(run_cases(options.fleets, options.seed))
    sys.stdout.write("\n".join(format_table(results)) + "\n")
    large = count_false_alarms(options.boards, options.nights, options.seed)
    sys.stdout.write(json.dumps(large, indent=1) + "\n")
    if options.json is not None:
        document = {"cases": [asdict(case) for case in results], "large": large}
        options.json.write_text(json.dumps(document, indent=1))
    false_alarms = [case.ours.wrong for case in results if case.kind == "nothing"]
    nights = max(len(false_alarms), 1) * (NIGHTS - FIRST_NIGHT)
    return int(sum(false_alarms) > 3 + 0.01 * nights)


if __name__ == "__main__":
    sys.exit(main())
