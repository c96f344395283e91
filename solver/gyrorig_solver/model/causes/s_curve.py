"""S-curve: the speed ramps have rounded corners, because the jerk is limited.

The angle is the mean over a box of length L about each instant (a jerk-limited profile with jerk =
acceleration/L). The delay of the box, L/2, is left out, because start delays and the time offset
absorb it. 10 to 100 ms. For short L the change is L^2/24 angle'', which grows as L^2, and only its
sign separates it from a compliant base.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.drive_effects import moving_average
from gyrorig_solver.model.motion_law_term import MotionLawTerm
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import size_parameter
from gyrorig_solver.model.term_kinds import scan_grid
from gyrorig_solver.model.value_format import PAN_TILT, format_list


class SCurve(MotionLawTerm):
    """The length L of pan and tilt."""

    cause = "s_curve"
    title = "The controller rounds its speed ramps"
    equation = "angle(t) = mean of the angle over [t - length/2, t + length/2]"
    stage = "motor"
    law_quantity = "corner"
    starts_at_typical_size = True
    parameters = (
        size_parameter("length", "s", PAN_TILT, typical=0.03, lower=0.0, limit=0.5, prior_std=0.1),
    )
    confused_with = ("base_compliance", "base_speed_jump", "low_pass_lag", "acceleration_error")
    remedy = "let `gyrorig solve` fit this cause"
    excitation = "the fastest accelerations, and several boards with different low-pass filters"
    effect_if_ignored = "the time offset absorbs the error; other parameters hardly change"

    def angle_error(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the rounded minus the commanded angles, (2, n + 1)."""
        rounded = [
            moving_average(state.edges_s, angle, float(length))
            for angle, length in zip(state.angle_rad, values, strict=True)
        ]
        return np.stack(rounded) - state.angle_rad

    def template_bank(self, state: SignalState) -> FloatArray:
        """Scan several lengths; there is no derivative at zero."""
        return scan_grid(self, length=np.array([0.01, 0.02, 0.04, 0.08, 0.16]))

    def describe(self, values: FloatArray) -> str:
        return (
            f"the corners of the ramps are rounded over {format_list(values * 1e3, PAN_TILT, 'ms')}"
        )


TERM = SCurve()
