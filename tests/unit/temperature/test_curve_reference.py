"""The temperature that belongs to the bias of a calibration with a curve."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from gyrorig_solver.calibration import parse_calibration
from gyrorig_solver.pipeline.temperature_values import (
    TemperatureValues,
    _calibration_row,
    with_temperature_curves,
)

GOOD = Path(__file__).resolve().parents[1] / "output" / "golden" / "good.yaml"


def test_the_bias_of_a_curve_is_at_its_reference() -> None:
    document = parse_calibration(GOOD.read_bytes(), "good")
    quality = msgspec.structs.replace(document.quality, mean_temperature_degc=30.0)
    document = msgspec.structs.replace(document, quality=quality)
    degc = np.linspace(40.0, 80.0, 21)
    noise = np.random.default_rng(1).normal(0.0, 1e-5, (21, 3))
    bias = 1e-3 * degc[:, None] * np.ones(3) + noise
    values = TemperatureValues("made", degc, bias, np.zeros((21, 3)), None, None, None)
    row = _calibration_row(with_temperature_curves(document, values), "v1")
    assert row["bias_x"] == pytest.approx(1e-3 * row["temperature_degc"], abs=1e-4)
