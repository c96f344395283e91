"""Times that repeat: samples, accelerations and temperatures that arrive in bursts."""

from pathlib import Path

import numpy as np
import pytest
from tests.unit.importers.test_import_measurements import BASE, archive, mapped, messages

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.recording.messages import ImuStatus
from gyrorig_solver.importers import import_measurements

RATE_HZ = 200.0
BURST = 8
ARRIVAL = "stamp: arrival, rate_hz: 200.0}"


@pytest.fixture
def bursts(tmp_path: Path) -> Path:
    """Return an archive with the times `t` of 400 samples and the times `ta` of their arrival."""
    number = np.arange(400)
    return archive(
        tmp_path / "in.npz",
        t=1.0 + number / RATE_HZ,
        ta=1.002 + (number // BURST + 1) * BURST / RATE_HZ,
        g=np.zeros((400, 3)),
        a=np.full((400, 3), 9.81),
        w=np.full(400, 30.0),
    )


def imported(source: Path, text: str, out: Path) -> Path:
    return import_measurements(source, mapped(text), out).path


def valid_share(path: Path, bit: ImuStatus) -> float:
    """Return the share of the samples that have a value."""
    samples = messages(path, "/board/B1/imu_raw")
    return float(np.mean([bool(sample.status & bit) for sample in samples]))


def test_arrival_times_of_accelerations_can_repeat(bursts: Path, tmp_path: Path) -> None:
    text = BASE + f"accel: {{keys: [a], unit: m/s2, time: {{key: ta, {ARRIVAL}}}\n"
    text += f"temperature: {{key: w, time: {{key: ta, {ARRIVAL}}}\n"
    dated = imported(bursts, text, tmp_path / "dated.mcap")
    assert valid_share(dated, ImuStatus.ACCEL_VALID) > 0.0
    assert valid_share(dated, ImuStatus.TEMPERATURE_VALID) > 0.0
    together = text.replace("{key: t, unit: s}", f"{{key: ta, unit: s, {ARRIVAL}", 1)
    arrived = imported(bursts, together, tmp_path / "arrived.mcap")
    assert valid_share(arrived, ImuStatus.ACCEL_VALID) == 1.0
    assert valid_share(arrived, ImuStatus.TEMPERATURE_VALID) == 1.0
    with pytest.raises(InputError, match="times of the accel columns do not increase at row 2"):
        imported(bursts, text.replace(ARRIVAL, "}"), tmp_path / "no.mcap")


def test_samples_in_bursts_get_the_values_of_sampled_streams(bursts: Path, tmp_path: Path) -> None:
    text = BASE.replace("{key: t, unit: s}", f"{{key: ta, unit: s, {ARRIVAL}")
    text += "accel: {keys: [a], unit: m/s2, time: {key: t}}\n"
    text += "temperature: {key: w, time: {key: t}}\n"
    path = imported(bursts, text, tmp_path / "out.mcap")
    assert valid_share(path, ImuStatus.ACCEL_VALID) > 0.95
    assert valid_share(path, ImuStatus.TEMPERATURE_VALID) > 0.95
