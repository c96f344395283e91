"""What a twin states of the noise of a board."""

import numpy as np
import pytest

from gyrorig_solver.estimate import Spectrum
from gyrorig_solver.twin.board_measurement import mean_white_factor


def test_more_noise_in_motion_is_in_the_mean_noise() -> None:
    """Nine times the power in a quarter of the spectrum is three times the power of all."""
    frequency_hz, density = np.array([1.0, 2.0]), np.ones((2, 3))
    count = np.array([75.0, 25.0])
    assert mean_white_factor(Spectrum(frequency_hz, density, count)) == pytest.approx(np.ones(3))
    white_power = np.array([[1.0, 1.0, 1.0], [1.0, 1.0, 9.0]])
    factor = mean_white_factor(Spectrum(frequency_hz, density, count, white_power))
    assert factor == pytest.approx([1.0, 1.0, np.sqrt(3.0)])
