"""One move of a board between two rests, with gravity at both.

What to use when: `GravityMove` for the moves of `gravity_fit`.
"""

from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.reference import path_product, turn_vectors

# A smaller rotation has no information and can be a knock at rest.
MIN_TURN_RAD = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class GravityMove:
    """One move: the gyro between two rests, and gravity at both."""

    step_s: FloatArray  # (n - 1,)
    rate_rad_s: FloatArray  # (n, 3), measured, minus the bias of the two rests
    gravity_before: FloatArray  # (3,), unit vector up
    gravity_after: FloatArray
    variance_rad2: float  # predicted, of the residual in each direction
    # (3, 9), derivatives of both by the unknowns of the accelerometer.
    change_before: FloatArray
    change_after: FloatArray

    @property
    def is_large(self) -> bool:
        """Whether the gyro turned enough for the move to have information."""
        speed_rad_s = np.linalg.norm(self.rate_rad_s[1:], axis=1)
        return float(np.sum(speed_rad_s * self.step_s)) >= MIN_TURN_RAD

    def corrected(self, correction: FloatArray) -> "GravityMove":
        """Return the move with each rate multiplied by a matrix, (3, 3)."""
        return replace(self, rate_rad_s=self.rate_rad_s @ correction.T)

    def accelerometer_change(self, inverse_gain: FloatArray) -> FloatArray:
        """Return the derivative of the residual by the unknowns of the accelerometer, (3, 9).

        Args:
            inverse_gain: from the gyro to the accelerometer's frame, (3, 3).
        """
        end = path_product(turn_vectors(self.rate_rad_s @ inverse_gain.T, self.step_s))
        return np.asarray(self.change_after - end.T @ self.change_before, dtype=np.float64)
