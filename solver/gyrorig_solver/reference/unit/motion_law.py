"""Motion law of the unit: its differences from the recorded settings.

A unit can ramp with another acceleration, start at another base speed, or round the corners of its
ramps. The position replies follow the motion that it executes, so a model with such a difference
compares the replies with that motion.

What to use when: `MotionLaw` for values in steps and seconds; `law_values` and `LAW_QUANTITIES` for
the order of the values in a fit.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from gyrorig_solver.data import FloatArray

LawQuantity = Literal["acceleration", "base_speed", "corner"]
# The values of a law are pan and tilt of each quantity, in this order.
LAW_QUANTITIES: tuple[LawQuantity, ...] = ("acceleration", "base_speed", "corner")
LAW_VALUES = 2 * len(LAW_QUANTITIES)


@dataclass(frozen=True, slots=True)
class MotionLaw:
    """Differences from the recorded settings, for pan and tilt; zero means as recorded."""

    acceleration_share: tuple[float, float] = (0.0, 0.0)  # added to 1
    base_speed_steps_s: tuple[float, float] = (0.0, 0.0)  # added
    corner_s: tuple[float, float] = (0.0, 0.0)  # duration of the mean over the positions
    # Axes whose acceleration is given by the law and is not an additional unknown of the moves.
    has_known_acceleration: tuple[bool, bool] = (False, False)
    is_recorded: bool = False  # no difference is possible: the law is that of the settings

    @classmethod
    def of_values(
        cls,
        values: FloatArray,
        has_known_acceleration: tuple[bool, bool],
        rad_per_step: tuple[float, float],
    ) -> "MotionLaw":
        """Return the law with these values, shape (6,), in the order of `LAW_QUANTITIES`.

        The units are 1, rad/s and s.
        """
        acceleration_share, base_rad_s, corner_s = values.reshape(-1, 2)
        base_steps_s = base_rad_s / np.abs(rad_per_step)
        return cls(
            (float(acceleration_share[0]), float(acceleration_share[1])),
            (float(base_steps_s[0]), float(base_steps_s[1])),
            (float(corner_s[0]), float(corner_s[1])),
            has_known_acceleration,
        )


RECORDED_LAW = MotionLaw(is_recorded=True)


def law_scale(rad_per_step: tuple[float, float]) -> FloatArray:
    """Return the derivative of each value in steps by the value in SI units, shape (6,)."""
    steps_per_rad = 1.0 / np.abs(rad_per_step)
    return np.array([1.0, 1.0, *steps_per_rad, 1.0, 1.0])
