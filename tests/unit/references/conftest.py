"""Samples made from a known truth, without a recording in between."""

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.support.simulated_samples import plain_samples

from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples

# The scripts of docs are run from the checkout, where a reader finds them.
ROOT = Path(__file__).resolve().parents[3]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

GAIN = np.array([[1.021, 0.013, -0.006], [-0.009, 0.984, 0.017], [0.004, -0.011, 1.008]])
BIAS_RAD_S = np.array([0.011, -0.024, 0.006])


@dataclass(frozen=True, slots=True, eq=False)
class Tumble:
    """A smooth tumbling about all axes: attitude and body rate in closed form.

    Attitude = Rz(a) Ry(b) Rx(c), each a sum of sines; the body rate follows from the
    angles' rates by the textbook matrix of z-y-x Euler angles.
    """

    seed: int

    def _angles(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        rng = np.random.default_rng(self.seed)
        angle, rate = np.zeros((time_s.size, 3)), np.zeros((time_s.size, 3))
        for axis in range(3):
            for _ in range(4):
                f, p = rng.uniform(0.05, 1.2), rng.uniform(0.0, 2 * np.pi)
                size = rng.uniform(0.1, 0.4) * (0.7 if axis == 1 else 1.5)
                angle[:, axis] += size * np.sin(2 * np.pi * f * time_s + p)
                rate[:, axis] += size * 2 * np.pi * f * np.cos(2 * np.pi * f * time_s + p)
        return angle, rate

    def attitude(self, time_s: FloatArray) -> Rotation:
        """Return body into world."""
        return Rotation.from_euler("ZYX", self._angles(time_s)[0])

    def rate_rad_s(self, time_s: FloatArray) -> FloatArray:
        """Return the body rate, shape (n, 3)."""
        angle, rate = self._angles(time_s)
        (da, db, dc), b, c = rate.T, angle[:, 1], angle[:, 2]
        return np.stack(
            [
                dc - np.sin(b) * da,
                np.cos(c) * db + np.sin(c) * np.cos(b) * da,
                -np.sin(c) * db + np.cos(c) * np.cos(b) * da,
            ],
            axis=1,
        )


@pytest.fixture
def samples_of() -> Callable[..., GyroSamples]:
    return plain_samples


@pytest.fixture
def tumble() -> Callable[[int], Tumble]:
    return Tumble


@pytest.fixture
def true_gain() -> FloatArray:
    return GAIN


@pytest.fixture
def true_bias_rad_s() -> FloatArray:
    return BIAS_RAD_S
