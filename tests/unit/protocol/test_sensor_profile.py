"""Sensor profiles: what is taken, and what is refused with its place."""

from pathlib import Path

import pytest

from gyrorig_protocol.errors import UsageError
from gyrorig_protocol.profile import parse_profile

GOOD = """
schema: gyrorig/sensor/1
sensor: l3g4200d
source: "a data sheet, table 4"
ranges: [{full_scale_dps: 250.0, sensitivity_mdps: 8.75}]
low_pass: [{odr_hz: 100.0, bandwidth_hz: [12.5, 25.0]}]
"""


def test_a_profile() -> None:
    profile = parse_profile(GOOD, "l3g.yaml")
    assert profile.ranges[0].sensitivity_mdps == 8.75
    assert profile.low_pass[0].bandwidth_hz == (12.5, 25.0)
    assert profile.noise_density_dps_rthz is None


def test_the_zero_rate_limit_depends_on_the_full_scale() -> None:
    profile = parse_profile((BOARDS / "L3G4200D.yaml").read_bytes(), "L3G4200D")
    assert [profile.zero_rate_limit_dps(dps) for dps in (250.0, 500.0, 2000.0)] == [
        25.0,
        37.5,
        187.5,
    ]
    assert (
        profile.zero_rate_limit_dps(None) == profile.zero_rate_limit_dps(1000.0) == 25.0
    )  # the part's
    alike = parse_profile((BOARDS / "BMI088.yaml").read_bytes(), "BMI088")
    assert alike.zero_rate_limit_dps(2000.0) == alike.zero_rate_dps == 1.0
    assert parse_profile(GOOD, "l3g.yaml").zero_rate_limit_dps(250.0) is None


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("8.75", "0.0", "sensitivity_mdps"),
        ("8.75", ".inf", "finite"),
        ("8.75", "8.75, zero_rate_dps: -1.0", "zero_rate_dps"),
        ("gyrorig/sensor/1", "gyrorig/sensor/2", "schema"),
        ("low_pass", "lowpass", "unknown key 'lowpass'. Did you mean low_pass"),
        ("[12.5, 25.0]", "12.5", "bandwidth_hz"),
    ],
)
def test_invalid_profiles_are_rejected(old: str, new: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        parse_profile(GOOD.replace(old, new), "l3g.yaml")


BOARDS = Path(__file__).resolve().parents[3] / "config" / "boards"
# the parts that fleets are made of, and what is inside the Nexus 5
PARTS = {
    "ADIS16470", "BMI088", "BMI270", "ICM-20948", "ICM-42688-P", "L3G4200D", "LSM6DSO", "LSM6DSOX",
    "MPU-6050", "MPU-6500", "MPU-6515", "MPU-9250", "x-IMU3",
}  # fmt: skip


def test_every_part_has_a_profile() -> None:
    assert {path.stem for path in BOARDS.glob("*.yaml")} == PARTS


@pytest.mark.parametrize("name", sorted(PARTS))
def test_a_shipped_profile(name: str) -> None:
    profile = parse_profile((BOARDS / f"{name}.yaml").read_bytes(), name)
    assert profile.sensor == name
    assert len(profile.source) > 40  # names its data sheet
    for entry in profile.ranges:  # 16 bits reach the range: a slip of 10 or of 1000 shows
        reach_dps = 32768 * entry.sensitivity_mdps * 1e-3
        if name not in ("ADIS16470", "x-IMU3"):  # which are not full scale / 32768
            assert 0.99 < reach_dps / entry.full_scale_dps < 1.16
    sizes = [entry.full_scale_dps for entry in profile.ranges]
    assert sizes == sorted(set(sizes))
    assert all(max(index.bandwidth_hz) < 2.0 * index.odr_hz for index in profile.low_pass)
