"""Units in the headers of phone logs."""

from pathlib import Path

import numpy as np
import pytest

from gyrorig_protocol.errors import InputError
from gyrorig_solver.importers.phone_log import PhoneLog, read_phone_log

GRAVITY_M_S2 = 9.80665


def read(folder: Path, gyro: str, accel: str = "Acc {} (m/s^2)") -> PhoneLog:
    names = ["time (s)", *(gyro.format(a) for a in "XYZ"), *(accel.format(a) for a in "XYZ")]
    rows = [f"{k / 100:.2f},1.0,2.0,3.0,0.5,0.25,1.0" for k in range(50)]
    (folder / "gyroscope.csv").write_text("\n".join([",".join(names), *rows]), encoding="utf-8")
    return read_phone_log(folder / "gyroscope.csv")


def unit_notes(log: PhoneLog) -> list[str]:
    return [note for note in log.notes if "no known unit" in note]


@pytest.mark.parametrize(
    "gyro",
    [
        "Gyro {} (Deg/s)", "Gyro {} (DPS)", "gyro_{}_dps", "Gyro {} [°/s]", "gyro{} (deg/sec)",
        "GYRO_{}_DEG_S", "Gyro {} degrees per second",
    ],
)  # fmt: skip
def test_degrees_in_any_spelling(tmp_path: Path, gyro: str) -> None:
    """Before, most of these were rad/s, 57.3 times too large, without a remark."""
    log = read(tmp_path, gyro)
    np.testing.assert_allclose(log.rate_rad_s[0], np.radians([1.0, 2.0, 3.0]))
    assert unit_notes(log) == []


@pytest.mark.parametrize(
    ("gyro", "factor"),
    [
        ("Gyro {} (rad/s)", 1.0), ("gyro_{}_rad_s", 1.0), ("Gyro {} (RAD/S)", 1.0),
        ("gyro_{}_mdps", np.radians(1e-3)), ("Gyro {} (mrad/s)", 1e-3),
    ],
)  # fmt: skip
def test_other_units_of_rates(tmp_path: Path, gyro: str, factor: float) -> None:
    log = read(tmp_path, gyro)
    np.testing.assert_allclose(log.rate_rad_s[0], factor * np.array([1.0, 2.0, 3.0]))
    assert unit_notes(log) == []


@pytest.mark.parametrize(
    ("accel", "factor"),
    [
        ("Acc {} (g)", GRAVITY_M_S2), ("Acc {} [G]", GRAVITY_M_S2), ("acc_{}_g", GRAVITY_M_S2),
        ("Acc {} (mg)", 1e-3 * GRAVITY_M_S2), ("acc_{}_m_s2", 1.0), ("Acc {} (m/s²)", 1.0),
        ("Acc {} (M/S^2)", 1.0),
    ],
)  # fmt: skip
def test_units_of_accelerations(tmp_path: Path, accel: str, factor: float) -> None:
    log = read(tmp_path, "Gyro {} (rad/s)", accel)
    assert log.accel_m_s2 is not None
    np.testing.assert_allclose(log.accel_m_s2[0], factor * np.array([0.5, 0.25, 1.0]))
    assert unit_notes(log) == []


def test_a_header_without_a_unit_gets_a_remark(tmp_path: Path) -> None:
    log = read(tmp_path, "Gyro {}", "Acc {}")
    np.testing.assert_allclose(log.rate_rad_s[0], [1.0, 2.0, 3.0])
    rates, accelerations = unit_notes(log)
    assert "the rates, so they are taken as rad/s" in rates
    assert "the accelerations, so they are taken as m/s^2" in accelerations


def test_different_units_are_refused(tmp_path: Path) -> None:
    text = "time (s),gx (deg/s),gy (rad/s),gz (deg/s)\n" + "0.01,1,2,3\n" * 20
    (tmp_path / "log.csv").write_text(text)
    with pytest.raises(InputError, match="have different units"):
        read_phone_log(tmp_path / "log.csv")
