"""Write the index rows of a synthetic fleet: boards from lots, on rigs, night after night.

What to use when: `write_fleet` for tests of the fleet statistics and for the speed of the index,
which need a million index rows but no calibration documents. Each value is the sum of the true
value of the board, a random variation per night and the error of the calibration.
"""

from dataclasses import dataclass, field
from pathlib import Path

import duckdb
import numpy as np
from tests.bench.fleet.parts import ERROR, SCATTER, SPREAD

from gyrorig_solver.calibration import create_store
from gyrorig_solver.fleet.drift import PARAMETER_COLUMNS
from gyrorig_solver.fleet.store.index_rows import sql_columns


@dataclass(frozen=True, slots=True)
class FleetPlan:
    """The size of a fleet and its hidden faults, in the unit of the parameter."""

    boards: int = 200
    nights: int = 30
    rigs: int = 8
    lots: int = 4
    seed: int = 1
    measured: float = 0.8  # share of the boards that are measured in a night
    rig_drift: tuple[int, str, int, float] | None = (
        None  # rig, parameter, first night, drift per night
    )
    bad_lot: tuple[int, str, float] | None = None
    constant: tuple[str, float] | None = None  # parameter, error on every unit
    board_drift: tuple[int, str, int, float] | None = None
    odd_board: tuple[int, str, float] | None = None
    refused_board: int | None = None  # its calibrations of the last five nights are refused
    temperature_per_c: dict[str, float] = field(default_factory=dict)
    slope_spread: dict[str, float] = field(
        default_factory=dict
    )  # standard deviation between boards
    count_rad_s: float | None = None  # size of a count
    truncated: bool = False  # counts are truncated: the bias is half a count too low
    clock_ppm: float | None = None  # standard deviation of the board clocks
    host_ppm: dict[int, float] = field(default_factory=dict)  # by rig, error of the host clock
    tick_ppm: float = 0.0  # error of the tick rate in the profile


def draw_conditions(plan: FleetPlan, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw which boards are measured in each night, and their temperatures."""
    shape = (plan.nights, plan.boards)
    measured = rng.random(shape) < plan.measured
    season = 4.0 * np.sin(np.arange(plan.nights) / 4.0)[:, None]
    return measured, 25.0 + season + rng.normal(0.0, 0.5, shape)


def draw_parameter(
    plan: FleetPlan, name: str, rng: np.random.Generator, temperature_c: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Draw the values and standard deviations of one parameter, (nights, boards)."""
    family = name.split("_", maxsplit=1)[0]
    night = np.arange(plan.nights)[:, None]
    board = np.arange(plan.boards)
    truth = rng.normal(1.0 if family == "scale" else 0.0, SPREAD[family], plan.boards)
    std = ERROR[family] * rng.uniform(0.7, 1.5, (plan.nights, plan.boards))
    value = truth + rng.normal(0.0, SCATTER[family], std.shape) + rng.normal(0.0, std)
    value += plan.temperature_per_c.get(name, 0.0) * (temperature_c - 25.0)
    if name in plan.slope_spread:
        value += rng.normal(0.0, plan.slope_spread[name], plan.boards) * (temperature_c - 25.0)
    if plan.truncated and family == "bias":
        value -= 0.5 * (plan.count_rad_s or 0.0)
    if plan.constant is not None and plan.constant[0] == name:
        value += plan.constant[1]
    if plan.bad_lot is not None and plan.bad_lot[1] == name:
        value += plan.bad_lot[2] * (board % plan.lots == plan.bad_lot[0])
    if plan.odd_board is not None and plan.odd_board[1] == name:
        value += plan.odd_board[2] * (board == plan.odd_board[0])
    for drift, number in ((plan.rig_drift, board % plan.rigs), (plan.board_drift, board)):
        if drift is not None and drift[1] == name:
            value += np.maximum(night - drift[2] + 1, 0) * drift[3] * (number == drift[0])
    return value, std


def draw_skew_ppm(plan: FleetPlan) -> np.ndarray:
    """Draw the skew of each board clock to its host clock, ppm; NaN without a clock."""
    if plan.clock_ppm is None:
        return np.full(plan.boards, np.nan)
    board_ppm = np.random.default_rng([plan.seed, 2]).normal(0.0, plan.clock_ppm, plan.boards)
    host_ppm = [plan.host_ppm.get(board % plan.rigs, 0.0) for board in range(plan.boards)]
    skew_ppm: np.ndarray = board_ppm + plan.tick_ppm - np.array(host_ppm)
    return skew_ppm


def write_fleet(store: Path, plan: FleetPlan) -> Path:
    """Write the index of a store, and return the path of a table with the lots and sites."""
    create_store(store)
    (store / "index").mkdir(exist_ok=True)
    rng = np.random.default_rng(plan.seed)
    measured, temperature = draw_conditions(plan, rng)
    night, board = np.nonzero(measured)
    version = (np.cumsum(measured, axis=0))[measured]
    columns: dict[str, np.ndarray] = {
        "n_board": board,
        "n_night": night,
        "n_version": version,
        "temperature": temperature[measured],
        "skew": draw_skew_ppm(plan)[board],
    }
    for name in PARAMETER_COLUMNS:
        value, std = draw_parameter(plan, name, rng, temperature)
        columns[name], columns[f"{name}_std"] = value[measured], std[measured]
    expressions = {
        "key": "'synthetic-' || n_board || '-' || n_version",
        "status": "'ok'",
        "created": "TIMESTAMP '2026-01-01 03:00:00' + to_days(n_night::INTEGER)",
        "batch": "'synthetic'",
        "inputs": "[md5(n_board || '/' || n_version)]",
        "names": "['n' || n_board || '-' || n_version || '.mcap']",
        "rig": f"'rig-' || (n_board % {plan.rigs})",
        "board": "'B' || lpad(n_board::VARCHAR, 6, '0')",
        "uid": "'U' || n_board",
        "sensor": "'L3G4200D'",
        "start": "TIMESTAMP '2026-01-01 02:00:00' + to_days(n_night::INTEGER)",
        "duration_s": "75.0",
        "temperature_degc": "temperature",
        "version": "n_version",
        "file": "'calib/00/00/B' || lpad(n_board::VARCHAR, 6, '0') || '/v' || "
        "lpad(n_version::VARCHAR, 4, '0') || '.yaml'",
        "file_sha256": "sha256(n_board || '/' || n_version)",
        "trust": f"CASE WHEN n_board = {-1 if plan.refused_board is None else plan.refused_board} "
        f"AND n_night >= {plan.nights - 5} THEN 'refused' "
        "WHEN n_board % 50 = 7 THEN 'limited' ELSE 'good' END",
        "reduced_chi2": "1.0",
        "clock_skew_ppm": "CASE WHEN isfinite(skew) THEN skew END",
        "gyro_scale_rad_s": "NULL" if plan.count_rad_s is None else repr(float(plan.count_rad_s)),
    }
    fields = ", ".join(
        f"({expressions.get(name, name if name in columns else 'NULL')})::{kind} AS {name}"
        for name, kind in sql_columns().items()
    )
    with duckdb.connect() as database:
        database.register("drawn", columns)
        path = store / "index" / "synthetic-0000.parquet"
        database.execute(
            f"COPY (SELECT {fields} FROM drawn) TO '{path}' (FORMAT parquet, COMPRESSION zstd)"  # noqa: S608 - internal names
        )
    table = store.parent / f"{store.name}-boards.csv"
    lines = [
        f"B{n:06d},lot-{n % plan.lots},{'north' if n % plan.rigs < plan.rigs // 2 else 'south'}"
        for n in range(plan.boards)
    ]
    table.write_text("\n".join(["board,lot,site", *lines]) + "\n", encoding="utf-8")
    return table
