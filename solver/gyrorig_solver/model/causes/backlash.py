"""Backlash: after a reversal the motor turns and the stage does not.

A play operator on the angle of each axis: the stage follows once the motor has crossed the gap g.
The rate is lost for g/speed after each reversal and never after a restart in the same direction.
The maker's FAQ states 0.02 to 0.1 deg, growing with wear; 0.2 deg is a worn worm. On the tilt axis
the payload can press on one side of the gap at all times. Then there is no backlash, and the side
changes at the tilt where the payload is balanced.

The output of the operator is centred on the input, but the zero of the unit is not. Homing ended
with the wheel in contact with one face. The stage is therefore at the commanded angle when it comes
from that side, and a whole gap short of it from the other side. No motion shows which face it was.
Half the gap is a tilt zero, which is a rotation of the misalignment about x. It is not fitted, but
the covariance of the gain includes it.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.cause_categories import EDGE_COVARIATES
from gyrorig_solver.model.drive_effects import apply_play
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import shape_parameter, size_parameter
from gyrorig_solver.model.term_kinds import AngleTerm, scan_grid
from gyrorig_solver.model.value_format import DEG, PAN_TILT, format_list


class Backlash(AngleTerm):
    """The gap, then the initial contact (1: pushing up), for pan and tilt."""

    cause = "backlash"
    title = "The gears have backlash"
    equation = (
        "stage angle = play(motor angle; gap, begin): the stage follows after the motor crossed gap"
    )
    stage = "play"
    parameters = (
        size_parameter(
            "gap", "rad", PAN_TILT, typical=0.05, lower=0.0, limit=1.0, prior_std=0.3, factor=DEG
        ),
        shape_parameter("begin", "1", PAN_TILT, typical=1.0, lower=-1.0, upper=1.0, prior_std=1.0),
    )
    confused_with = ("base_compliance", "lost_steps", "clock_offset", "dead_zone")
    remedy = (
        "have the worm adjusted and approach every rest from the same side, or let `gyrorig "
        "solve` fit this cause"
    )
    covariates = EDGE_COVARIATES
    picture = None
    excitation = (
        "moves that reverse and moves that continue in the same direction, at two or more speeds"
    )
    derivative_step = 0.02  # the contact moves by whole intervals
    effect_if_ignored = "small for the rates; the angles between rests are wrong by the backlash"
    is_persistent = True

    def angle_error(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the part of the angle that is lost in the gap, (2, n + 1)."""
        error = np.zeros_like(state.angle_rad)
        for axis in (0, 1):
            if values[axis] != 0.0:
                # The motion before this part of the series determines the contact, if it is known.
                start_face = _direction_before(state, axis) or float(values[2 + axis])
                commanded = state.angle_rad[axis]
                error[axis] = apply_play(commanded, float(values[axis]), start_face) - commanded
        return error

    def tilt_zero_std_rad(self, values: FloatArray) -> float:
        """Return half the gap of tilt, because homing ended at one of the two faces."""
        return 0.5 * float(values[1])

    def template_bank(self, state: SignalState) -> FloatArray:
        """Scan gaps a factor of two apart, for each initial contact."""
        return scan_grid(
            self,
            gap=DEG * 0.002 * 2.0 ** np.arange(10.0),
            begin=np.array([-1.0, 0.0, 1.0]),
        )

    def describe(self, values: FloatArray) -> str:
        return f"the gears have backlash: {format_list(values[:2] / DEG, PAN_TILT, 'deg')}"


def _direction_before(state: SignalState, axis: int) -> float:
    """Return the direction of an axis' last motion before this part, 0 if unknown."""
    earlier_profiles = [
        profile
        for moved_axis, profile in state.context.motion_profiles
        if moved_axis == axis and profile.start_s[0] < state.edges_s[0]
    ]
    if state.previous_direction[axis] or not earlier_profiles:
        return state.previous_direction[axis]
    last = max(earlier_profiles, key=lambda profile: float(profile.start_s[0]))
    segment_count = np.searchsorted(last.start_s, state.edges_s[0], side="right")
    displacement = (
        last.start_speed_steps_s[:segment_count] + 0.5 * last.acceleration_steps_s2[:segment_count]
    )
    nonzero = np.flatnonzero(displacement)
    step_sign = 1.0 if state.context.rad_per_step is None else state.context.rad_per_step[axis]
    return float(np.sign(displacement[nonzero[-1]] * step_sign)) if nonzero.size else 0.0


TERM = Backlash()
