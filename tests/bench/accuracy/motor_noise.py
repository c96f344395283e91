"""White noise that the motors add while they move, before the sensor's low-pass."""

from dataclasses import dataclass

import numpy as np
from tests.bench.accuracy.profile import FloatArray, Path


@dataclass(frozen=True, slots=True)
class MotorNoise:
    """The amplitude of the added noise, relative to the sensor's white noise."""

    ratio: float  # 0: none
    grows: bool = False  # with each axis' speed, up to `ratio` at its fastest; or while one moves

    def amplitude(self, path: Path, time_s: FloatArray) -> FloatArray:
        """Return the relative amplitude at increasing times, shape (n,)."""
        power = np.zeros(time_s.size)
        for axis in (0, 1):
            speed = np.zeros(time_s.size)
            for move in path.of_axis(axis):
                first, last = np.searchsorted(time_s, [move.start_s, move.end_s])
                speed[first:last] = np.abs(move.speed_at_steps_s(time_s[first:last]))
            share = speed / max(float(speed.max(initial=0.0)), 1.0)
            power += share**2
        if not self.grows:
            power = (power > 0.0).astype(np.float64)
        return np.asarray(self.ratio * np.sqrt(power), dtype=np.float64)
