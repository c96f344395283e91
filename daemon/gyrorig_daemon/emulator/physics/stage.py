"""The platform on top of the unit: how it turns, and where down is.

Attitude of the stage in the base, with the tilt axis `tilt_axis_error_rad` away from square
to the pan axis (0 on an ideal unit): R = Rz(pan) Ry(error) Rx(tilt). The body rate in the
stage frame is then

    omega = (tilt_rate - pan_rate sin e, pan_rate cos e sin t, pan_rate cos e cos t).

Frames and signs: recording contract, "Frames and signs".
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.physics.axis import StepperAxis

FloatArray = NDArray[np.float64]

STANDARD_GRAVITY_M_S2 = 9.80665  # ISO 80000-3


@dataclass(frozen=True, slots=True, eq=False)
class Stage:
    """Two axes with a platform on them."""

    pan: StepperAxis
    tilt: StepperAxis
    tilt_axis_error_rad: float = 0.0
    gravity_m_s2: float = STANDARD_GRAVITY_M_S2

    @property
    def revision(self) -> int:
        """Grows with every command that changes how the stage moves."""
        return self.pan.revision + self.tilt.revision

    def body_rates_rad_s(self, start_s: float, period_s: float, count: int) -> FloatArray:
        """Return the mean body rate in each of `count` intervals, stage frame.

        Differences of exact angles, so that an edge inside an interval keeps its area.

        Args:
            start_s: begin of the first interval.
            period_s: length of each; the tilt is taken at its middle.
            count: how many.

        Returns:
            Rates in rad/s, shape (count, 3).
        """
        pan = self.pan.angles_rad(start_s, period_s, count + 1)
        tilt = self.tilt.angles_rad(start_s, period_s, count + 1)
        pan_rate = np.diff(pan) / period_s
        middle = 0.5 * (tilt[1:] + tilt[:-1])
        across = np.cos(self.tilt_axis_error_rad) * pan_rate
        rates = np.empty((count, 3))
        rates[:, 0] = np.diff(tilt) / period_s - np.sin(self.tilt_axis_error_rad) * pan_rate
        rates[:, 1] = across * np.sin(middle)
        rates[:, 2] = across * np.cos(middle)
        return rates

    def gravity_stage_m_s2(self, start_s: float, period_s: float, count: int) -> FloatArray:
        """Return what an ideal accelerometer on the stage reads at rest, shape (count, 3)."""
        tilt = self.tilt.angles_rad(start_s, period_s, count)
        across = self.gravity_m_s2 * np.cos(self.tilt_axis_error_rad)
        felt = np.empty((count, 3))
        felt[:, 0] = -self.gravity_m_s2 * np.sin(self.tilt_axis_error_rad)
        felt[:, 1] = across * np.sin(tilt)
        felt[:, 2] = across * np.cos(tilt)
        return felt
