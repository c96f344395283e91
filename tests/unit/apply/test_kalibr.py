"""Kalibr's file, held against what Kalibr's own code makes of it."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import yaml

from gyrorig_protocol.errors import InputError
from gyrorig_solver.apply import FRAMES, Frame
from gyrorig_solver.calibration import CalibrationDocument
from gyrorig_solver.estimate import Periodogram, bin_spectrum, unit_densities
from gyrorig_solver.estimate.noise.noise_levels import fit_noise_levels
from gyrorig_solver.estimate.noise.noise_model import Sampling
from gyrorig_solver.export import ExportOptions, ExportSource, export_text

DocumentFactory = Callable[..., CalibrationDocument]


def gain_of(result: CalibrationDocument) -> np.ndarray:
    return np.array(result.matrices.STM, dtype=np.float64)


def kalibr(text: str) -> dict[str, Any]:
    """Check a file as Kalibr's ImuParameters does: keys, types, and that all are above zero."""
    data: dict[str, Any] = yaml.safe_load(text)
    assert isinstance(data["rostopic"], str)
    for key in ("update_rate", "gyroscope_noise_density", "gyroscope_random_walk"):
        assert isinstance(data[key], float), key
        assert data[key] > 0.0
    return data


def test_kalibrs_file_in_its_own_convention(document: DocumentFactory) -> None:
    result = document()
    data = kalibr(export_text(ExportSource.of(result), "kalibr", ExportOptions("/board/imu")))
    assert data["rostopic"] == "/board/imu"
    gyroscopes = data["gyroscopes"]
    low, turn = np.array(gyroscopes["M"]), np.array(gyroscopes["C_gyro_i"])
    assert np.all(np.triu(low, 1) == 0.0)
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    rate = np.random.default_rng(1).normal(size=(40, 3))
    read = rate @ (low @ turn).T + gyroscopes["bias"]
    bias = np.array(result.parameters["bias"].value, dtype=np.float64)
    np.testing.assert_allclose(
        np.linalg.solve(gain_of(result), (read - bias).T).T, rate, atol=1e-12
    )
    assert "accelerometer_noise_density" not in data  # not ours to tell: Kalibr asks for it


def test_kalibrs_density_makes_the_noise_of_the_samples(document: DocumentFactory) -> None:
    """Samples, our estimate of their density, Kalibr's file, Kalibr's own noise of a sample.

    kalibr_common/ConfigReader.py: sigma_d = gyroscope_noise_density / sqrt(1 / update_rate).
    A density of the other side is 41 % off; that of 200000 samples is good to 0.2 %.
    """
    rate_hz, count = 100.0, 200_000  # the golden board's output rate
    for drawn in (0.0005 * math.sqrt(rate_hz / 2.0), 0.02):
        samples = np.random.default_rng(11).normal(0.0, drawn, (count, 3))
        spectrum = bin_spectrum([Periodogram.of(samples, rate_hz)])
        result = fit_noise_levels(spectrum, Sampling(rate_hz, 1, None, 0.0, differentiated=False))
        density = np.sqrt(result.levels[:, 0]).tolist()
        noise = {
            "angle_random_walk": {"value": density, "unit": "rad/s/sqrt(Hz)"},
            "rate_random_walk": {"value": [1e-5] * 3, "unit": "rad/s^2/sqrt(Hz)"},
        }
        output = kalibr(export_text(ExportSource.of(document(noise=noise)), "kalibr"))
        discrete = output["gyroscope_noise_density"] / math.sqrt(1.0 / output["update_rate"])
        assert discrete == pytest.approx(samples.std(axis=0).max(), rel=0.02)


def test_kalibrs_random_walk_is_what_our_noise_means_by_it(document: DocumentFactory) -> None:
    """Its bias takes steps of sigma_b sqrt(dt); the spectrum of such a bias is our K's."""
    output = kalibr(export_text(ExportSource.of(document()), "kalibr"))
    rate_hz, count = output["update_rate"], 40_000
    steps = np.random.default_rng(12).normal(size=(count, 3))
    bias = np.cumsum(output["gyroscope_random_walk"] * math.sqrt(1.0 / rate_hz) * steps, axis=0)
    slow = Periodogram.of(bias, rate_hz).band(0.0, rate_hz / 20.0)
    sampling = Sampling(rate_hz, 1, None, 0.0, differentiated=False)
    of_one = unit_densities(slow.frequency_hz, sampling)[2][:, None]
    assert float(np.mean(slow.density / of_one)) == pytest.approx(1e-5**2, rel=0.1)


@pytest.mark.parametrize("frame", FRAMES)
def test_kalibrs_model_with_a_force(document: DocumentFactory, frame: Frame) -> None:
    """read = M C true + A C accel + bias, both in the frame that was asked for."""
    k = np.random.default_rng(13).normal(0.0, 1e-3, (3, 3))
    force = {"value": k.ravel().tolist(), "std": [0.0] * 9, "unit": "rad/s/(m/s^2)"}
    result = document(parameters={"g_sensitivity": force})
    gyroscopes = kalibr(export_text(ExportSource.of(result, frame), "kalibr"))["gyroscopes"]
    low, turn, a = (np.array(gyroscopes[name]) for name in ("M", "C_gyro_i", "A"))
    rate, accel = np.random.default_rng(14).normal(size=(2, 40, 3))  # in the stage's axes
    read = rate @ gain_of(result).T + accel @ k.T + gyroscopes["bias"]  # docs/conventions.md
    to_frame = np.eye(3) if frame == "stage" else np.array(result.matrices.M, dtype=np.float64)
    seen = (
        (rate @ to_frame.T @ turn.T) @ low.T
        + (accel @ to_frame.T @ turn.T) @ a.T
        + gyroscopes["bias"]
    )
    np.testing.assert_allclose(seen, read, atol=1e-12)


def test_kalibr_takes_the_noise_of_a_calibration_without_a_gain(document: DocumentFactory) -> None:
    data = kalibr(export_text(ExportSource.of(document("limited")), "kalibr"))
    assert "gyroscopes" not in data
    with pytest.raises(InputError, match="requires the noise of the gyro"):
        export_text(ExportSource.of(document(noise={})), "kalibr")
