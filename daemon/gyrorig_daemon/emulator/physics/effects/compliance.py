"""Base compliance: the tripod twists under the torque that turns the head.

Turning a load of inertia I with acceleration a needs the torque I a; a base of torsional
stiffness k gives way by I a / k against it. With c = I / k in s^2 the stage turns by

    x - c x''

and its rate shows a double pulse at each edge of the speed. This is the limit of a base
much stiffer than the sensor's band; a softer one swings, which is `ringing`. Source: rig
discovery survey, section 2.
"""

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.physics.effects.motor import Motor

FloatArray = NDArray[np.float64]

# A jump of speed takes the rotor some time; far below what the low-pass lets through.
_RISE_S = 0.125e-3


class Compliance:
    """A base that gives way in proportion to the acceleration."""

    def __init__(self, compliance_s2: float) -> None:
        """Take inertia over stiffness."""
        self._compliance_s2 = compliance_s2

    def added_rad(
        self, motor: Motor, start_s: float, offsets_s: FloatArray, _angle_rad: FloatArray
    ) -> FloatArray:
        """See `motor.AngleEffect`; what a command has done is never felt before it."""
        now, before, earlier = (
            motor.driven_steps(start_s - late * _RISE_S, offsets_s) for late in range(3)
        )
        acceleration = (now - 2.0 * before + earlier) / _RISE_S**2
        return np.asarray(-self._compliance_s2 * motor.step_rad * acceleration)

    def forget(self, time_s: float) -> None:
        """See `motor.AngleEffect`: nothing is remembered."""
