"""Tilt sag: the payload bends the tilt axis, by its lever arm in gravity.

tilt + c cos(tilt) + s sin(tilt): the torque of a weight at any angle to the stage; 0.05 to 0.3 deg
(from memory). An eccentric tilt wheel is the same function. The constant part is a tilt zero, and
over few tilts it looks like a wrong step size on tilt (correlation 0.99).
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import BinnedDependence, TermParameter, size_parameter
from gyrorig_solver.model.term_kinds import LinearAngleTerm
from gyrorig_solver.model.value_format import DEG


def _parameter(name: str) -> TermParameter:
    return size_parameter(name, "rad", ("tilt",), typical=0.1, limit=2.0, prior_std=0.5, factor=DEG)


class TiltSag(LinearAngleTerm):
    """c and s."""

    cause = "tilt_sag"
    title = "The payload bends the tilt axis"
    equation = "tilt = tilt + cosine cos(tilt) + sine sin(tilt)"
    parameters = (_parameter("cosine"), _parameter("sine"))
    confused_with = ("step_resolution", "axis_nonorthogonality", "board_slip")
    remedy = "balance the payload over the tilt axis"
    covariates = ("tilt_angle",)
    picture = BinnedDependence("gain", "tilt", 10)
    equivalent_causes = ("eccentricity",)
    excitation = "pan sweeps at five tilts over the whole range"
    effect_if_ignored = (
        "M and the scale factors absorb this cause; their errors reach tens of standard "
        "uncertainties before a search detects it"
    )
    is_persistent = True

    def angle_shapes(self, state: SignalState, values: FloatArray) -> list[tuple[int, FloatArray]]:
        """Return cosine and sine of the tilt angle."""
        tilt = state.angle_rad[1]
        return [(1, np.cos(tilt)), (1, np.sin(tilt))]

    def describe(self, values: FloatArray) -> str:
        size = float(np.hypot(values[0], values[1])) / DEG
        return f"the payload's weight bends the tilt axis by up to {size:.3g} deg"


TERM = TiltSag()
