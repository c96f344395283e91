"""The motion of one stepper axis between two rests, as the controller computes it.

Below the base speed the speed changes at once; between base and upper speed it ramps
with a constant acceleration, symmetric at both ends (command reference manual v3.00D,
section 5). All in steps and seconds; the sign of the move is kept apart.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class Trapezoid:
    """One move of `distance_steps` (positive) from rest to rest."""

    distance_steps: float
    speed_steps_s: float
    acceleration_steps_s2: float
    base_speed_steps_s: float

    @property
    def peak_steps_s(self) -> float:
        """The highest speed reached: the set speed, less where the move is too short."""
        v, vb = self.speed_steps_s, self.base_speed_steps_s
        if v <= vb:
            return v
        reach = float(np.sqrt(vb**2 + self.acceleration_steps_s2 * self.distance_steps))
        return min(v, reach)

    @property
    def ramp_s(self) -> float:
        """How long each ramp lasts; 0 where the whole move is below the base speed."""
        excess = self.peak_steps_s - self.base_speed_steps_s
        return max(0.0, excess / self.acceleration_steps_s2)

    @property
    def duration_s(self) -> float:
        """From the first step to the last."""
        return 2.0 * self.ramp_s + self._cruise_s

    @property
    def _start_steps_s(self) -> float:
        return min(self.peak_steps_s, self.base_speed_steps_s)

    @property
    def _ramp_steps(self) -> float:
        return (self._start_steps_s + self.peak_steps_s) / 2.0 * self.ramp_s

    @property
    def _cruise_s(self) -> float:
        return max(0.0, self.distance_steps - 2.0 * self._ramp_steps) / self.peak_steps_s

    def position_steps(self, since_start_s: FloatArray) -> FloatArray:
        """Return how far the axis has come at times since the start, any shape."""
        ramp, cruise = self.ramp_s, self._cruise_s
        t = np.clip(since_start_s, 0.0, self.duration_s)
        up = np.minimum(t, ramp)
        flat = np.clip(t - ramp, 0.0, cruise)
        down = np.maximum(t - ramp - cruise, 0.0)
        a = self.acceleration_steps_s2 if ramp > 0.0 else 0.0
        return np.asarray(
            self._start_steps_s * up
            + a * up**2 / 2.0
            + self.peak_steps_s * (flat + down)
            - a * down**2 / 2.0,
            dtype=np.float64,
        )

    def speed_at_steps_s(self, since_start_s: FloatArray) -> FloatArray:
        """Return the speed at times since the start, any shape; 0 at rest."""
        t = since_start_s
        ramp, end = self.ramp_s, self.duration_s
        a = self.acceleration_steps_s2
        edge = np.minimum(t, end - t)
        speed = np.where(
            edge < ramp, self._start_steps_s + a * np.maximum(edge, 0.0), self.peak_steps_s
        )
        return np.where((t < 0.0) | (t > end), 0.0, speed)
