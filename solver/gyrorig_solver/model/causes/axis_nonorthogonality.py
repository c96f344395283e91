"""Non-perpendicular axes: the pan axis is not at a right angle to the tilt axis.

In the frame of the tilt axis the pan axis is (sin e, 0, cos e). A pan motion therefore also turns
the stage about its tilt axis:

    omega = (tilt_rate + pan_rate sin e, pan_rate cos e sin t, pan_rate cos e cos t).

Machined units have 0.1 to 0.3 deg (from memory; no data sheet states it). At one or two tilts the
gain absorbs the effect completely. Gravity does not show it either: on a level rig it adds the same
amount to every reading of an accelerometer, like its bias.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import BinnedDependence, size_parameter
from gyrorig_solver.model.term_kinds import NonlinearTerm
from gyrorig_solver.model.value_format import DEG


class AxisNonOrthogonality(NonlinearTerm):
    """The deviation e from the right angle; a positive e tilts the pan axis towards +x."""

    cause = "axis_nonorthogonality"
    title = "The pan and tilt axes are not perpendicular"
    equation = "pan axis in the frame of the tilt axis = (sin angle, 0, cos angle)"
    part = "ptu"
    stage = "axes"
    scope = "unit"
    parameters = (
        size_parameter("angle", "rad", typical=0.15, limit=2.0, prior_std=0.5, factor=DEG),
    )
    confused_with = ("board_slip", "tilt_sag")
    remedy = "have the tilt axis shimmed, or let `gyrorig solve` fit this cause"
    covariates = ("tilt_angle",)
    picture = BinnedDependence("gain", "tilt", 10)
    needs_angles = True
    excitation = "pan sweeps at three or more tilts that are far apart"
    effect_if_ignored = (
        "row x of the gain and M absorb this cause; their errors reach 46 standard uncertainties "
        "before a search detects it"
    )
    is_persistent = True

    def effect(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the exact change of the rate, (blocks, 3)."""
        return self._measured_rate(state, float(np.sin(values[0])), float(np.cos(values[0])) - 1.0)

    def jacobian(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the derivative, (1, blocks, 3)."""
        return self._measured_rate(state, float(np.cos(values[0])), -float(np.sin(values[0])))[None]

    def describe(self, values: FloatArray) -> str:
        error_deg = abs(values[0]) / DEG
        return f"the pan and tilt axes are {error_deg:.3f} deg away from perpendicular"

    def _measured_rate(self, state: SignalState, x_share: float, yz_share: float) -> FloatArray:
        pan, tilt = state.pan_rate_rad_s, state.tilt_rad
        rate = np.column_stack(
            [pan * x_share, pan * yz_share * np.sin(tilt), pan * yz_share * np.cos(tilt)]
        )
        return state.measure_stage_rate(rate)


TERM = AxisNonOrthogonality()
