"""Base compliance: the base of the unit twists when the motors accelerate.

angle - c angle'' on each axis: the reaction of an accelerated head twists its base immediately,
because the mode is far above the low-pass. 1e-4 s^2 is 0.01 deg at 100 deg/s^2. The rate has a
pulse at each corner of a ramp. Short rounded corners (`s_curve`) have the same shape but the
opposite sign, and both signs are fixed: only a positive c is a compliant base.

If a motor starts at its base speed, two opposite pulses come at almost the same time, and the first
sample after them shows half of their sum. A sample that was taken during the speed jump shows none,
one or both of the pulses. The time of the jump is not known well enough, so the fit leaves that
sample out. The same is true if the motor has crossed a gap and the stage starts at its speed
(`backlash`).
"""

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.model.cause_categories import EDGE_COVARIATES
from gyrorig_solver.model.drive_effects import second_derivative
from gyrorig_solver.model.signal_arrays import zero_signals
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.speed_jumps import angle_of_jumps, find_speed_jumps, jump_responses
from gyrorig_solver.model.term import size_parameter
from gyrorig_solver.model.term_kinds import LinearAngleTerm
from gyrorig_solver.model.value_format import PAN_TILT, format_list


class BaseCompliance(LinearAngleTerm):
    """The compliance c of pan and tilt."""

    cause = "base_compliance"
    title = "The base of the unit is compliant"
    equation = "angle = angle - coefficient x d2 angle/dt2"
    depends_on_upstream = True
    parameters = (
        size_parameter(
            "coefficient", "s^2", PAN_TILT, typical=1e-4, lower=0.0, limit=1e-2, prior_std=5e-3
        ),
    )
    confused_with = ("s_curve", "low_pass_lag", "ringing", "acceleration_error", "backlash")
    remedy = "bolt the base of the unit to something heavy and stiff"
    covariates = EDGE_COVARIATES
    picture = None
    excitation = (
        "the fastest accelerations of pan and tilt, and a recording with the unit bolted down"
    )
    effect_if_ignored = "small, because no angle error remains after a move"
    is_persistent = True

    def angle_shapes(self, state: SignalState, values: FloatArray) -> list[tuple[int, FloatArray]]:
        """Return minus the accelerations."""
        return list(enumerate(-state.angle_acceleration_rad_s2))

    def effect(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the change of the measured rate, (blocks, 3)."""
        return super().effect(state, values) + self.off_grid_effect(state, values)

    def off_grid_effect(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the part of the speed jumps that is sharper than the grid, (blocks, 3)."""
        effect = zero_signals(state.block_count)
        for axis, off_grid_signal in enumerate(self._off_grid_signals(state)):
            if values[axis]:
                effect += values[axis] * off_grid_signal
        return effect

    def timing_sensitive_mask(self, state: SignalState, values: FloatArray) -> BoolArray | None:
        """Return the blocks with a sample at a speed jump, (blocks,), or None."""
        sensitive = np.zeros(state.used_instants.size, dtype=np.bool_)
        sampling_times_s = state.sample_times_s + (
            0.0 if state.sampling_delay_s is None else state.sampling_delay_s
        )
        for axis in np.flatnonzero(values):
            jumps = find_speed_jumps(state, int(axis))
            first, last = np.searchsorted(
                sampling_times_s,
                [jumps.time_s - jumps.time_error_s, jumps.time_s + jumps.time_error_s],
            )
            for k, stop in zip(first, last, strict=True):
                sensitive[k:stop] = True
        block_mask = np.asarray(
            sensitive.reshape(state.block_count, -1).any(axis=1), dtype=np.bool_
        )
        return block_mask if sensitive.any() else None

    def tangent_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the derivatives by the coefficients, (2, blocks, 3)."""
        return super().tangent_signals(state, values) + np.stack(self._off_grid_signals(state))

    def _off_grid_signals(self, state: SignalState) -> list[FloatArray]:
        """Return per axis the exact response to speed jumps minus that on the grid."""
        signals = []
        for axis in (0, 1):
            jumps = find_speed_jumps(state, axis)
            if state.low_pass is None or not jumps.time_s.size:
                signals.append(zero_signals(state.block_count))
                continue
            grid_acceleration = second_derivative(
                state.edges_s, angle_of_jumps(state.edges_s, jumps)
            )
            grid_signal = state.measure_stage_rate(
                state.stage_rate_derivative(axis, -grid_acceleration)
            )
            signals.append(-jump_responses(state, axis, jumps) - grid_signal)
        return signals

    def describe(self, values: FloatArray) -> str:
        deflection = format_list(
            np.degrees(values * np.radians(100.0)), PAN_TILT, "deg at 100 deg/s^2"
        )
        return f"the base twists when the head accelerates: {deflection}"


TERM = BaseCompliance()
