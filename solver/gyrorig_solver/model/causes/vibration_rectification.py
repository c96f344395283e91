"""Vibration rectification: vibration of the running motors shifts the bias.

y_i += v_i (pan_rate^2 + tilt_rate^2). Steppers vibrate more at higher speeds, and a gyroscope turns
the square of an acceleration into a rate (the g^2 term of IEEE Std 1431), also on axes that do not
turn. No data sheet of these parts states it; 5 mdeg/s at 1000 (deg/s)^2 has been observed.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.cause_categories import RATE_COVARIATES
from gyrorig_solver.model.signal_arrays import on_all_axes, split_axes
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import BinnedDependence, size_parameter
from gyrorig_solver.model.term_kinds import LinearTerm
from gyrorig_solver.model.value_format import DEG, XYZ, format_list

_PER_DPS = DEG / (1000.0 * DEG**2)  # 1 deg/s at 1000 (deg/s)^2


class VibrationRectification(LinearTerm):
    """The coefficient v for x, y, z."""

    cause = "vibration_rectification"
    title = "Vibration changes the bias"
    equation = "y_i = y_i + coefficient_i ((d pan/dt)^2 + (d tilt/dt)^2)"
    part = "sensor"
    parameters = (
        size_parameter(
            "coefficient", "s/rad", XYZ, typical=5e-3, limit=0.2, prior_std=0.1, factor=_PER_DPS
        ),
    )
    confused_with = ("scale_quadratic", "scale_asymmetry", "motor_coupling", "g_sensitivity")
    remedy = "mount the board on a stiffer plate, away from the motor, and use half steps"
    covariates = RATE_COVARIATES
    picture = BinnedDependence("mean", "speed")
    needs_angles = True
    excitation = "four or more speeds, each at several tilts"
    effect_if_ignored = "the bias in motion differs from the bias at rest"

    def basis_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the squared speeds of the motors on each axis, (3, blocks, 3)."""
        squared_speed = state.pan_rate_rad_s**2 + state.tilt_rate_rad_s**2
        known_speed = np.where(state.motion_known, squared_speed, 0.0)
        return split_axes(state.measure_sensor_rate(on_all_axes(known_speed)))

    def describe(self, values: FloatArray) -> str:
        text = format_list(values / _PER_DPS, XYZ, "deg/s at 32 deg/s")
        return f"the vibration of the motors shifts the bias with the square of the speed: {text}"


TERM = VibrationRectification()
