"""Acceleration error: the speed ramps are steeper or flatter than commanded.

The unit uses acceleration (1 + e) from the same start to the same target. The timer of a stepper
controller quantises the speeds of a ramp (0.1 %), and a unit does not always use the acceleration
that it accepts. In a model with this cause the acceleration is not an unknown of the moves.
"""

from dataclasses import replace

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.motion_law_term import MotionLawTerm
from gyrorig_solver.model.replanned_moves import (
    compound_change,
    compound_moves,
    simple_moves,
)
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import size_parameter
from gyrorig_solver.model.term_kinds import scan_grid
from gyrorig_solver.model.value_format import PAN_TILT, format_list


class AccelerationError(MotionLawTerm):
    """The relative acceleration error e of pan and tilt."""

    cause = "acceleration_error"
    title = "The acceleration differs from the command"
    equation = "acceleration = (1 + share) x commanded acceleration"
    stage = "profile"
    law_quantity = "acceleration"
    parameters = (
        size_parameter("share", "1", PAN_TILT, typical=5e-3, lower=-0.5, limit=1.0, prior_std=0.1),
    )
    confused_with = ("s_curve", "base_speed_jump", "clock_offset")
    remedy = "query the acceleration of the unit (commands PA and TA) during the recording"
    excitation = "moves at several speeds, with ramps of different lengths"
    effect_if_ignored = "small, because the time offset absorbs part of the error"

    def angle_error(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the executed minus the commanded angles, (2, n + 1)."""
        return limit_change_error(state, (float(values[0]), float(values[1])), (0.0, 0.0))

    def propagate(self, state: SignalState, values: FloatArray) -> SignalState:
        """Return the signal with the moves replanned."""
        return replan_motion(state, (float(values[0]), float(values[1])), (0.0, 0.0))

    def template_bank(self, state: SignalState) -> FloatArray:
        """Scan small and large errors."""
        return scan_grid(self, share=np.array([-0.2, -0.05, 0.01, 0.05, 0.2]))

    def describe(self, values: FloatArray) -> str:
        return (
            f"the ramps are steeper than commanded by {format_list(values * 100.0, PAN_TILT, '%')}"
        )


def limit_change_error(
    state: SignalState, acceleration_share: tuple[float, float], base_rad_s: tuple[float, float]
) -> FloatArray:
    """Return the change of the angles, (2, n + 1), when the axes use other limits.

    The change is relative to `state.context.limit_changes`, which earlier causes have applied.
    """
    error = np.zeros_like(state.angle_rad)
    resolution = state.context.rad_per_step
    if resolution is None:
        return error
    profiles = state.context.motion_profiles
    for axis, (share, base) in enumerate(zip(acceleration_share, base_rad_s, strict=True)):
        if (share, base) == (0.0, 0.0):
            continue
        size = resolution[axis]
        previous_share, previous_base = state.context.limit_changes[axis]
        change, previous = (share, base / abs(size)), (previous_share, previous_base / abs(size))
        moves = simple_moves(profiles, axis)
        error[axis] = size * moves.position_change(state.edges_s, change, previous)
        for profile in compound_moves(profiles, axis):
            edges, change_steps = compound_change(profile, state.edges_s, change, previous)
            error[axis, edges] += size * change_steps
    return error


def replan_motion(
    state: SignalState, acceleration_share: tuple[float, float], base_rad_s: tuple[float, float]
) -> SignalState:
    """Return the signal with the moves replanned with other limits of the axes."""
    changed = state.with_angles(limit_change_error(state, acceleration_share, base_rad_s))
    limit_changes = [
        (previous[0] + share, previous[1] + base)
        for previous, share, base in zip(
            state.context.limit_changes, acceleration_share, base_rad_s, strict=True
        )
    ]
    return replace(
        changed,
        context=replace(changed.context, limit_changes=(limit_changes[0], limit_changes[1])),
    )


TERM = AccelerationError()
