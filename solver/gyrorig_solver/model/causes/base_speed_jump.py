"""Base speed error: the motors start at a base speed that no command has set.

Below the base speed a stepper starts and stops at once, so the ramp begins at v_b above the
commanded base speed. 57 positions/s, or 2.9 deg/s, is a factory setting (from memory). Nearly all
of the effect is a shorter move, which start delays and the time offset absorb (0.998 of the
energy).
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.causes.acceleration_error import (
    limit_change_error,
    replan_motion,
)
from gyrorig_solver.model.motion_law_term import MotionLawTerm
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import size_parameter
from gyrorig_solver.model.term_kinds import scan_grid
from gyrorig_solver.model.value_format import DEG, PAN_TILT, format_list


class BaseSpeedJump(MotionLawTerm):
    """The excess over the commanded base speed, for pan and tilt."""

    cause = "base_speed_jump"
    title = "The base speed differs from the command"
    equation = "speed at the start and end of a ramp = base speed + speed"
    stage = "profile"
    law_quantity = "base_speed"
    parameters = (
        size_parameter(
            "speed",
            "rad/s",
            PAN_TILT,
            typical=2.9,
            lower=0.0,
            limit=30.0,
            prior_std=10.0,
            factor=DEG,
        ),
    )
    confused_with = ("s_curve", "acceleration_error", "low_pass_lag", "clock_offset")
    remedy = "query the base speed of the unit (commands PB and TB) during the recording"
    excitation = "moves at several speeds, with base speeds that are set and recorded"
    effect_if_ignored = "the time offset absorbs the error; other parameters hardly change"

    def angle_error(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the executed minus the commanded angles, (2, n + 1)."""
        return limit_change_error(state, (0.0, 0.0), (float(values[0]), float(values[1])))

    def propagate(self, state: SignalState, values: FloatArray) -> SignalState:
        """Return the signal with the moves replanned."""
        return replan_motion(state, (0.0, 0.0), (float(values[0]), float(values[1])))

    def template_bank(self, state: SignalState) -> FloatArray:
        """Scan several base speeds."""
        return scan_grid(self, speed=DEG * np.array([0.5, 1.5, 3.0, 6.0]))

    def describe(self, values: FloatArray) -> str:
        return f"the moves start without a ramp at {format_list(values / DEG, PAN_TILT, 'deg/s')}"


TERM = BaseSpeedJump()
