"""Acceleration-sensitive drift (g-sensitivity): the bias depends on the specific force.

y += K f, where f = (0, g sin t, g cos t) on a level rig at tilt t (docs/conventions.md). K refers
to the stage's axes; relative to the sensor's axes it is K M^T. Typical 0.1 dps/g (MPU-6050 data
sheet; other parts less), or 1.8e-4 rad/s per m/s^2; 1 dps/g is a bad part. A pan-tilt unit cannot
bring gravity onto the stage's x axis, so K's x column is unobservable. At one tilt K is part of the
bias.
"""

import numpy as np

from gyrorig_protocol.profile import SensorProfile
from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.recording_context import STANDARD_GRAVITY_M_S2
from gyrorig_solver.model.signal_arrays import on_all_axes, split_axes, zero_signals
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import NO_ANGLES, BinnedDependence, size_parameter
from gyrorig_solver.model.term_kinds import LinearTerm
from gyrorig_solver.model.value_format import DEG, XYZ, format_list

_DPS_PER_G = DEG / STANDARD_GRAVITY_M_S2
MIN_FORCE_SPAN_M_S2 = 3.0  # of every component: a third of gravity
_MIN_TILT_RANGE_RAD = 0.05  # a smaller range changes the force by less than 5 %


class GSensitivity(LinearTerm):
    """K row by row: sensor axis, then stage axis of the force."""

    cause = "g_sensitivity"
    title = "Gravity changes the bias (g-sensitivity)"
    equation = "y = y + sensitivity f, f = (0, g sin tilt, g cos tilt)"
    part = "sensor"
    parameters = (
        size_parameter(
            "sensitivity",
            "rad/s/(m/s^2)",
            tuple(row + column for row in XYZ for column in XYZ),
            typical=0.1,
            limit=2.0,
            prior_std=1.0,
            factor=_DPS_PER_G,
        ),
    )
    confused_with = ("earth_rotation", "vibration_rectification", "thermal_bias")
    remedy = "let `gyrorig solve` fit this cause, because it is a property of the sensor"
    covariates = ("bias_tilt",)
    picture = BinnedDependence("mean", "tilt")
    excitation = "rests at four or more tilts that are far apart"
    effect_if_ignored = "the stated bias is valid at the tilts of the recording only"

    def basis_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return each component of the force on each axis, (9, blocks, 3)."""
        signals = zero_signals(9, state.block_count)
        force = state.measure_sensor_rate(
            np.where(state.motion_known[:, None], state.specific_force_m_s2, 0.0)
        )
        for column in (1, 2):
            signals[column::3] = split_axes(on_all_axes(force[:, column]))
        return signals

    def missing_data(self, state: SignalState) -> str | None:
        """Return that the direction of gravity is unknown, or None."""
        return NO_ANGLES if state.lacks_angles else None

    def missing_excitation(self, state: SignalState) -> str | None:
        """Return why one tilt cannot separate it from a bias, or None."""
        if not state.has_angles:
            return NO_ANGLES
        tilt = state.tilt_rad[state.motion_known]
        if tilt.size == 0 or float(np.ptp(tilt)) < _MIN_TILT_RANGE_RAD:
            return "the board rested at one tilt only; rest at four tilts that are far apart"
        return None

    def data_sheet_limit(self, parameter: str, profile: SensorProfile) -> float | None:
        """Return the sensitivity to acceleration, deg/s per g."""
        return None if parameter else profile.g_sensitivity_dps_g

    def describe(self, values: FloatArray) -> str:
        worst = np.abs(values.reshape(3, 3)).max(axis=1) / _DPS_PER_G
        return f"the bias depends on gravity: up to {format_list(worst, XYZ, 'deg/s per g')}"


class ForceSensitivity(GSensitivity):
    """K for all three components of the reading of the board's accelerometer."""

    excitation = "an accelerometer in the recording, and poses in all orientations"

    def basis_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return each component of the force on each axis, (9, blocks, 3)."""
        del values
        signals = np.zeros((9, state.block_count, 3))
        force = state.measure_sensor_rate(state.specific_force_m_s2)
        for column in range(3):
            signals[column::3] = split_axes(np.repeat(force[:, column : column + 1], 3, axis=1))
        return signals

    def missing_data(self, state: SignalState) -> str | None:
        """Return that the recording has no accelerometer data, or None."""
        if np.any(state.specific_force_m_s2):
            return None
        return "the recording has no accelerometer data; record the accelerometer too"

    def missing_excitation(self, state: SignalState) -> str | None:
        """Return that the specific force hardly changes its direction, or None."""
        if float(np.ptp(state.specific_force_m_s2, axis=0).min()) < MIN_FORCE_SPAN_M_S2:
            return "the board was never turned over; hold the board in poses of all orientations"
        return None


GSensitivity.attitude_form = ForceSensitivity()
TERM = GSensitivity()
