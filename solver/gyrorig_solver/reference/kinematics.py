"""The body rate of a pan-tilt stage (contract: frames and signs).

Attitude R = Rz(pan) Rx(tilt), stage to base. In the stage frame
omega = (tilt_rate, pan_rate sin(tilt), pan_rate cos(tilt)).
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import FloatArray


def stage_rate(
    tilt_rad: FloatArray, pan_rate_rad_s: FloatArray, tilt_rate_rad_s: FloatArray
) -> FloatArray:
    """Return the stage's rate in its own frame, shape (n, 3), from arrays of shape (n,)."""
    return np.column_stack(
        [tilt_rate_rad_s, pan_rate_rad_s * np.sin(tilt_rad), pan_rate_rad_s * np.cos(tilt_rad)]
    )


@dataclass(frozen=True, slots=True, eq=False)
class AxisTurn:
    """How a small change of one axis' position changes the stage rate."""

    rad_per_step: tuple[float, float]
    tilt_rad: FloatArray  # (n,), at the intervals' middles
    pan_rate_rad_s: FloatArray  # (n,)
    width_s: FloatArray  # (n,)

    def rate(self, axis: int, change_steps: FloatArray, at: slice) -> FloatArray:
        """Return d(stage rate) over the intervals `at`, from the change at their edges."""
        angle = self.rad_per_step[axis] * change_steps
        speed = np.diff(angle) / self.width_s[at]
        sine, cosine = np.sin(self.tilt_rad[at]), np.cos(self.tilt_rad[at])
        if axis == 0:
            return np.column_stack([np.zeros_like(speed), speed * sine, speed * cosine])
        lean = (angle[:-1] + angle[1:]) / 2.0
        pan = self.pan_rate_rad_s[at]
        return np.column_stack([speed, pan * cosine * lean, -pan * sine * lean])
