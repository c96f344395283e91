"""Earth rotation: a gyro feels the turning of the planet under the rig.

In the base frame (x right, y forward, z up) at latitude L, with y pointing to the compass
heading h (clockwise from north),

    w = W (-sin h cos L, cos h cos L, sin L),    W = 7.292115e-5 rad/s (IERS conventions)

and the stage feels R^T w, with R its attitude in the base.
"""

import math

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

EARTH_RATE_RAD_S = 7.292115e-5


def earth_rate_base_rad_s(rate_rad_s: float, latitude_rad: float, heading_rad: float) -> FloatArray:
    """Return the rotation of the ground in the base frame, (3,)."""
    level = rate_rad_s * math.cos(latitude_rad)
    return np.array(
        [
            -level * math.sin(heading_rad),
            level * math.cos(heading_rad),
            rate_rad_s * math.sin(latitude_rad),
        ]
    )
