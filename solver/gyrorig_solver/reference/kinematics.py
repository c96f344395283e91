"""The body rate of a pan-tilt stage (contract: frames and signs).

Attitude R = Rz(pan) Rx(tilt), stage to base. In the stage frame
omega = (tilt_rate, pan_rate sin(tilt), pan_rate cos(tilt)).
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray


def stage_rate(
    tilt_rad: FloatArray, pan_rate_rad_s: FloatArray, tilt_rate_rad_s: FloatArray
) -> FloatArray:
    """Return the stage's rate in its own frame, shape (n, 3), from arrays of shape (n,)."""
    return np.column_stack(
        [tilt_rate_rad_s, pan_rate_rad_s * np.sin(tilt_rad), pan_rate_rad_s * np.cos(tilt_rad)]
    )
