"""Quadratic scale-factor non-linearity: the error is even in the rate.

y_i += q_i (G omega)_i^2. Data sheets give only the total non-linearity (0.1 to 0.2 % of full
scale); 0.1 deg/s at 100 deg/s is a fifth of that at 250.
"""

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.cause_categories import RATE_COVARIATES
from gyrorig_solver.model.signal_arrays import split_axes
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import BinnedDependence, size_parameter
from gyrorig_solver.model.term_kinds import LinearTerm
from gyrorig_solver.model.value_format import DEG, XYZ, format_list

_DESCRIBED_AT_RAD_S = 100.0 * DEG  # sizes are described at this rate
_PER_DPS = DEG / _DESCRIBED_AT_RAD_S**2


class ScaleQuadratic(LinearTerm):
    """The coefficient q for x, y, z."""

    cause = "scale_quadratic"
    title = "The rate error grows with the square of the rate"
    equation = "y_i = y_i + coefficient_i (G omega)_i^2"
    part = "sensor"
    parameters = (
        size_parameter(
            "coefficient", "s/rad", XYZ, typical=0.1, limit=3.0, prior_std=1.0, factor=_PER_DPS
        ),
    )
    confused_with = (
        "vibration_rectification",
        "scale_asymmetry",
        "motor_coupling",
        "scale_cubic",
    )
    remedy = "compare with a second board of this type, or let `gyrorig solve` fit this cause"
    scale_rate_power = 1
    covariates = RATE_COVARIATES
    picture = BinnedDependence("mean", "own_rate")
    excitation = "both directions at four or more speeds, the fastest near full scale"
    effect_if_ignored = "scale factors and biases are valid at the speeds of the recording only"

    def basis_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the squared rate of each axis, (3, blocks, 3)."""
        return split_axes(state.measure_sensor_rate(state.sensor_rate_rad_s**2))

    def describe(self, values: FloatArray) -> str:
        text = format_list(values / _PER_DPS, XYZ, "deg/s at 100 deg/s")
        return f"the scale factor has an even non-linearity: {text}"


TERM = ScaleQuadratic()
