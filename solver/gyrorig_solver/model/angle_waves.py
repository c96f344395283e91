"""Periodic functions of the stage's angles, cached because a fit needs the same ones many times."""

import numpy as np

from gyrorig_solver.data import FloatArray


class AngleWaves:
    """Cosine and sine waves of pan and tilt; each axis caches its latest period."""

    def __init__(self, angle_rad: FloatArray) -> None:
        """Use the angles (2, n)."""
        self._angle_rad = angle_rad
        self._latest: dict[int, tuple[float, tuple[FloatArray, FloatArray]]] = {}

    def cosine_and_sine(self, axis: int, period_rad: float) -> tuple[FloatArray, FloatArray]:
        """Return cosine and sine of an axis' angle, (n,) each; do not write to them.

        Args:
            axis: 0 pan, 1 tilt.
            period_rad: angle of one period.
        """
        if axis not in self._latest or self._latest[axis][0] != period_rad:
            phase = self._angle_rad[axis] * (2.0 * np.pi / period_rad)
            self._latest[axis] = period_rad, (np.cos(phase), np.sin(phase))
        return self._latest[axis][1]
