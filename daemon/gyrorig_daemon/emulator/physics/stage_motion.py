"""Motion of the stage: body rate, and gravity in the stage frame.

Attitude of the stage in the base, with the tilt axis deviating by `tilt_axis_error_rad` from a
right angle to the pan axis (0 on an ideal unit): R = Rz(pan) Ry(error) Rx(tilt). The body rate in
the stage frame is then

    omega = (tilt_rate - pan_rate sin e, pan_rate cos e sin t, pan_rate cos e cos t).

Frames and signs: docs/conventions.md.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.physics.stepper_axis import StepperAxis

FloatArray = NDArray[np.float64]

STANDARD_GRAVITY_M_S2 = 9.80665  # ISO 80000-3


@dataclass(frozen=True, slots=True, eq=False)
class StageMotion:
    """Motion of the stage in a row of short intervals."""

    pan_rad: FloatArray  # at the middle of each, (n,)
    tilt_rad: FloatArray  # (n,)
    pan_rate_rad_s: FloatArray  # mean over each, (n,)
    tilt_rate_rad_s: FloatArray  # (n,)
    body_rate_rad_s: FloatArray  # of the stage in inertial space, stage frame, (n, 3)


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """Two axes that carry a platform."""

    pan: StepperAxis
    tilt: StepperAxis
    tilt_axis_error_rad: float = 0.0
    gravity_m_s2: float = STANDARD_GRAVITY_M_S2
    ground_rate_rad_s: FloatArray | None = None  # of the base in inertial space, (3,)

    @property
    def revision(self) -> int:
        """Increases with every command that changes the motion of the stage."""
        return self.pan.revision + self.tilt.revision

    def motion(self, start_s: float, period_s: float, count: int) -> StageMotion:
        """Return the motion of the stage in each of `count` intervals.

        The rates are differences of exact angles, so that an edge within an interval keeps its
        area.

        Args:
            start_s: start of the first interval.
            period_s: length of each; the angles are those at its middle.
            count: number of intervals.
        """
        pan = self.pan.angles_rad(start_s, period_s, count + 1)
        tilt = self.tilt.angles_rad(start_s, period_s, count + 1)
        pan_rate, tilt_rate = (pan[1:] - pan[:-1]) / period_s, (tilt[1:] - tilt[:-1]) / period_s
        tilt_middle = 0.5 * (tilt[1:] + tilt[:-1])
        pan_component = np.cos(self.tilt_axis_error_rad) * pan_rate
        rates = np.empty((count, 3))
        rates[:, 0] = tilt_rate - np.sin(self.tilt_axis_error_rad) * pan_rate
        rates[:, 1] = pan_component * np.sin(tilt_middle)
        rates[:, 2] = pan_component * np.cos(tilt_middle)
        pan_middle = 0.5 * (pan[1:] + pan[:-1])
        if self.ground_rate_rad_s is not None:
            rates += self._ground_in_stage(self.ground_rate_rad_s, pan_middle, tilt_middle)
        return StageMotion(pan_middle, tilt_middle, pan_rate, tilt_rate, rates)

    def body_rates_rad_s(self, start_s: float, period_s: float, count: int) -> FloatArray:
        """Return the mean body rate in each of `count` intervals, stage frame, (count, 3)."""
        return self.motion(start_s, period_s, count).body_rate_rad_s

    def gravity_stage_m_s2(self, start_s: float, period_s: float, count: int) -> FloatArray:
        """Return the specific force at rest in the stage frame, shape (count, 3)."""
        return self.gravity_at_tilt_m_s2(self.tilt.angles_rad(start_s, period_s, count))

    def gravity_during(self, motion: StageMotion) -> FloatArray:
        """Return the specific force at rest during a motion of this stage, (n, 3)."""
        return self.gravity_at_tilt_m_s2(motion.tilt_rad)

    def gravity_at_tilt_m_s2(self, tilt: FloatArray) -> FloatArray:
        """Return the specific force at rest, stage frame, for tilt angles in rad, (n, 3)."""
        in_plane = self.gravity_m_s2 * np.cos(self.tilt_axis_error_rad)
        force = np.empty((len(tilt), 3))
        force[:, 0] = -self.gravity_m_s2 * np.sin(self.tilt_axis_error_rad)
        force[:, 1] = in_plane * np.sin(tilt)
        force[:, 2] = in_plane * np.cos(tilt)
        return force

    def _ground_in_stage(self, ground: FloatArray, pan: FloatArray, tilt: FloatArray) -> FloatArray:
        """Return the rotation of the ground in the stage frame, R^T ground, (n, 3)."""
        x = np.cos(pan) * ground[0] + np.sin(pan) * ground[1]
        y = np.cos(pan) * ground[1] - np.sin(pan) * ground[0]
        c, s = np.cos(self.tilt_axis_error_rad), np.sin(self.tilt_axis_error_rad)
        x, z = c * x - s * ground[2], s * x + c * ground[2]
        return np.stack(
            [x, np.cos(tilt) * y + np.sin(tilt) * z, np.cos(tilt) * z - np.sin(tilt) * y], axis=1
        )
