"""Board slip: the board rotates on its mount.

omega becomes R(r)^T omega from the event on, where R(r) is the small rotation of the board on the
stage. A loose screw causes 0.1 to 1 deg. M changes in a step; bias and scale factors stay the same.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.gain_matrix import cross_matrix, rotation_matrix
from gyrorig_solver.model.signal_arrays import axis_rows
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import EVENT_TIME, BinnedDependence, size_parameter
from gyrorig_solver.model.term_kinds import NonlinearTerm, event_times, scan_grid, step_signal
from gyrorig_solver.model.value_format import DEG, XYZ, format_list

SCAN_TIMES = 60  # in the template bank, over a recording


class BoardSlip(NonlinearTerm):
    """The rotation about the stage's x, y, z, then its time."""

    cause = "board_slip"
    title = "The board slipped on its mount"
    equation = "omega = R(turn)^T omega for t >= time"
    part = "mount"
    stage = "mount"
    scope = "recording"
    parameters = (
        size_parameter("turn", "rad", XYZ, typical=0.3, limit=10.0, prior_std=2.0, factor=DEG),
        EVENT_TIME,
    )
    confused_with = ("thermal_scale", "axis_nonorthogonality", "lost_steps")
    remedy = (
        "fasten the board and record again, because the calibration needs a mount that does "
        "not move"
    )
    file_remedy = "solve the data before and after the slip separately"
    covariates = ("time",)
    picture = BinnedDependence("gain", "time", 12)
    reference_alternative = "the markers on the board can have moved instead"
    excitation = "the first poses and sweeps, repeated at the end of the recording"
    effect_if_ignored = "the misalignment M is a mean of two mount angles"

    @property
    def is_brief(self) -> bool:
        """Return True: only the pulse of a lost step of tilt separates the two causes."""
        return True

    def effect(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the change of the measured rate, (blocks, 3)."""
        rotation_change = state.rate_rad_s @ rotation_matrix(values[:3]) - state.rate_rad_s
        return state.measure_stage_rate(
            step_signal(state, float(values[3]))[:, None] * rotation_change
        )

    def tangent_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the derivative at no rotation, -(e x omega) after the event, (3, blocks, 3)."""
        after = step_signal(state, float(values[3]))[:, None]
        # The low-pass acts on each component separately, so the rotation can be applied after it.
        measured_rate = state.measure_sensor_rate(after * state.rate_rad_s)
        rows = axis_rows(measured_rate)
        rotations = np.stack([state.gain @ cross_matrix(unit).T for unit in np.eye(3)])
        return np.swapaxes(rotations @ rows, -1, -2)

    def template_bank(self, state: SignalState) -> FloatArray:
        """Scan times over the whole recording."""
        return scan_grid(self, time=event_times(state, SCAN_TIMES))

    def describe(self, values: FloatArray) -> str:
        return (
            f"the board turns on its mount at {values[3]:.1f} s by "
            f"{format_list(values[:3] / DEG, XYZ, 'deg')}"
        )


TERM = BoardSlip()
