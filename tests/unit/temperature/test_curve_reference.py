"""The temperature that belongs to the bias of a calibration."""

from pathlib import Path

import msgspec
import numpy as np
import pytest

from gyrorig_solver.calibration import CalibrationDocument, Parameter, parse_calibration
from gyrorig_solver.fleet.store.index_rows import calibration_row
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


def calibration_with_thermometer(mean_degc: float, reference_degc: float) -> CalibrationDocument:
    """Return a calibration with the cause `thermal_bias`, whose last recording has this mean."""
    document = parse_calibration(GOOD.read_bytes(), "good")
    return msgspec.structs.replace(
        document,
        quality=msgspec.structs.replace(document.quality, mean_temperature_degc=mean_degc),
        validity=msgspec.structs.replace(document.validity, temperature_degc=[9.0, 33.0]),
        parameters={
            **document.parameters,
            "thermal_bias": Parameter([1e-4] * 3, [1e-5] * 3, "rad/s/K"),
            "thermal_bias.reference": Parameter([reference_degc], [0.0], "degC"),
        },
    )


def test_the_bias_beside_a_thermal_bias_is_at_the_mean_of_all_recordings() -> None:
    """Before, it had the mean of the last recording, from which the mean of all can differ."""
    document = calibration_with_thermometer(mean_degc=15.2, reference_degc=21.4)
    assert _calibration_row(document, "v1")["temperature_degc"] == 21.4
    indexed = calibration_row(
        document, key="k", batch="b", session="s", rig="r", file="f", file_sha256="d"
    )
    assert indexed.temperature_degc == 21.4


def test_the_bias_without_a_thermal_cause_is_at_the_mean_of_its_recording() -> None:
    document = calibration_with_thermometer(mean_degc=15.2, reference_degc=21.4)
    parameters = {k: v for k, v in document.parameters.items() if "thermal" not in k}
    document = msgspec.structs.replace(document, parameters=parameters)
    assert _calibration_row(document, "v1")["temperature_degc"] == 15.2
