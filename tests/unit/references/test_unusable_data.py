"""Imported data that cannot calibrate a gyro: every command states the true reason."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.support.reference_recordings import CAMERA_HZ, GYRO_HZ, HandMotion, SimulatedGyro

from gyrorig_protocol.documents import convert_document
from gyrorig_solver import cli
from gyrorig_solver.importers import ImportMap, import_measurements

Columns = dict[str, np.ndarray]
Captured = pytest.CaptureFixture[str]


def columns() -> Columns:
    """Return 30 s of rates in deg/s, and attitudes."""
    motion = HandMotion(3, 30.0, rest_s=0.0)
    t, qt = np.arange(int(30 * GYRO_HZ)) / GYRO_HZ, np.arange(int(30 * CAMERA_HZ)) / CAMERA_HZ
    rate = motion.rate_rad_s(t)
    reading = SimulatedGyro().measure(t, rate, np.zeros_like(rate), 3)
    return {"t": t, "g": np.degrees(reading), "qt": qt, "q": motion.attitude(qt).as_quat()}


def record(folder: Path, changed: Columns) -> tuple[Path, list[str]]:
    """Return the recording of changed columns, and the remarks of the import."""
    source, path = folder / "log.npz", folder / "r.mcap"
    np.savez(source, **changed)  # type: ignore[arg-type]
    path.unlink(missing_ok=True)
    text = {
        "schema": "gyrorig/import/1",
        "board": "IMU-7",
        "sensor": "MPU-6050",
        "time": {"key": "t"},
        "gyro": {"keys": ["g"], "unit": "deg/s"},
        "attitude": {"keys": ["q"], "order": "xyzw", "time": {"key": "qt"}},
    }
    summary = import_measurements(source, convert_document(text, ImportMap, "map"), path)
    return path, list(summary.notes)


def far_in_time(data: Columns) -> Columns:
    return data | {"qt": data["qt"] + 3000.0}


def all_clipped(data: Columns) -> Columns:
    return data | {"g": np.where(data["g"] > 0.0, 20.0, -20.0)}


def often_clipped(data: Columns) -> Columns:
    limit = np.quantile(np.abs(data["g"]), 0.3)
    return data | {"g": np.clip(data["g"], -limit, limit)}


def often_missing(data: Columns) -> Columns:
    is_missing = (data["t"] % 1.5 > 1.4)[:, None]
    return data | {"g": np.where(is_missing, np.nan, data["g"])}


def one_constant(data: Columns) -> Columns:
    return data | {"g": data["g"] * [1.0, 0.0, 1.0]}


def all_constant(data: Columns) -> Columns:
    return data | {"g": np.ones_like(data["g"])}


CASES: list[tuple[Callable[[Columns], Columns], str, str]] = [
    (far_in_time, "3000.0", "origin_s"),
    (all_clipped, "none of the 6000 samples of board IMU-7 is usable", "larger full scale"),
    (often_clipped, "6000 samples are near the end of the sensor's range", "larger full scale"),
    (often_missing, "have no 2 s in common without a gap or a clipped", "larger full scale"),
    (one_constant, "axis y of board IMU-7 keeps the same value", "original file"),
    (all_constant, "all 6000 samples of board IMU-7", "original file"),
]


@pytest.mark.parametrize(("change", "problem", "remedy"), CASES)
def test_check_and_solve_state_the_true_reason(
    change: Callable[[Columns], Columns],
    problem: str,
    remedy: str,
    tmp_path: Path,
    capsys: Captured,
) -> None:
    """Before: three faults of the program, and axes that "hardly turned"."""
    path, _ = record(tmp_path, change(columns()))
    capsys.readouterr()
    assert cli.run(["check", str(path)]) == 4
    assert cli.run(["solve", str(path), "--out", str(tmp_path / "out")]) == 3
    checked, refused = capsys.readouterr()
    for text in (checked, refused):
        assert problem in text
        assert remedy in text
        assert "hardly turned" not in text
        assert "fault in the program" not in text


def test_check_states_clipped_and_stuck_axes(tmp_path: Path, capsys: Captured) -> None:
    """Before: "sound", with "saturated 0"."""
    for change, text in ((often_clipped, "stays at its extreme"), (one_constant, "(100 %)")):
        path, _ = record(tmp_path, change(columns()))
        cli.run(["check", str(path)])
        out = capsys.readouterr().out
        assert text in out
        assert "usable, with remarks" in out


@pytest.mark.parametrize("factor", [1e3, 1e-3])
def test_times_in_a_wrong_unit_are_named(factor: float, tmp_path: Path, capsys: Captured) -> None:
    """Before: "do not overlap in time", and no word about the unit of the times."""
    data = columns()
    path, remarks = record(tmp_path, data | {k: factor * data[k] for k in ("t", "qt")})
    assert any("samples per second" in text and "unit of the times" in text for text in remarks)
    assert cli.run(["solve", str(path), "--out", str(tmp_path / "out")]) == 3
    refused = capsys.readouterr().err
    assert "unit" in refused
    assert "do not overlap" not in refused


def test_a_constant_gyro_is_not_a_matter_of_units(tmp_path: Path) -> None:
    """Before: "the source probably writes deg/s although rad/s is stated", with deg/s stated."""
    for value in (1.0, 2000.0):
        data = columns()
        _, remarks = record(tmp_path, data | {"g": np.full_like(data["g"], value)})
        assert not any("as fast as" in text for text in remarks)


def test_rates_in_a_wrong_unit_are_named(tmp_path: Path) -> None:
    data = columns()
    _, remarks = record(tmp_path, data | {"g": np.radians(data["g"])})
    assert any("probably writes rad/s although deg/s is stated" in text for text in remarks)
