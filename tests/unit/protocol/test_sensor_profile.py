"""Sensor profiles: what is taken, and what is refused with its place."""

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


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("8.75", "0.0", "sensitivity_mdps"),
        ("8.75", ".inf", "finite"),
        ("gyrorig/sensor/1", "gyrorig/sensor/2", "schema"),
        ("low_pass", "lowpass", "unknown field"),
        ("[12.5, 25.0]", "12.5", "bandwidth_hz"),
    ],
)
def test_what_is_no_profile(old: str, new: str, says: str) -> None:
    with pytest.raises(UsageError, match=says):
        parse_profile(GOOD.replace(old, new), "l3g.yaml")
