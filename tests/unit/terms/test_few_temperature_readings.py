"""A recording of a second or two has too few temperature readings for a curve."""

import numpy as np
import pytest

from gyrorig_solver.model import board_temperature


@pytest.mark.parametrize("duration_s", [0.0, 0.2, 1.0, 2.0, 5.0])
def test_few_readings_give_finite_temperatures(duration_s: float) -> None:
    time_s = np.linspace(10.0, 10.0 + duration_s, 3)
    degc = np.array([30.0, 30.5, 30.0])
    grid_s, smoothed = board_temperature._smooth_readings(time_s, degc)
    assert grid_s.shape == smoothed.shape
    assert np.all((smoothed > 29.0) & (smoothed < 31.5))
