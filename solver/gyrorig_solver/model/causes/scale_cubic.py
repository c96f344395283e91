"""Cubic scale-factor non-linearity: the scale factor changes with the rate, odd in the rate.

y_i += c_i (G omega)_i^3. 0.2 % of a full scale of 250 deg/s at its end (L3G4200D) is 0.03 deg/s at
100 deg/s.
"""

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.cause_categories import RATE_COVARIATES
from gyrorig_solver.model.signal_arrays import split_axes
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import BinnedDependence, size_parameter
from gyrorig_solver.model.term_kinds import LinearTerm
from gyrorig_solver.model.value_format import DEG, XYZ, format_list

_DESCRIBED_AT_RAD_S = 100.0 * DEG  # sizes are described at this rate
_PER_DPS = DEG / _DESCRIBED_AT_RAD_S**3


class ScaleCubic(LinearTerm):
    """The coefficient c for x, y, z."""

    cause = "scale_cubic"
    title = "The rate error grows with the cube of the rate"
    equation = "y_i = y_i + coefficient_i (G omega)_i^3"
    part = "sensor"
    parameters = (
        size_parameter(
            "coefficient", "s^2/rad^2", XYZ, typical=0.03, limit=3.0, prior_std=1.0, factor=_PER_DPS
        ),
    )
    confused_with = ("scale_quadratic", "saturation", "scale_asymmetry")
    remedy = "use a larger full scale, or let `gyrorig solve` fit this cause"
    scale_rate_power = 2
    covariates = RATE_COVARIATES
    picture = BinnedDependence("mean", "own_rate")
    excitation = "four or more speeds, the fastest above 200 deg/s"
    effect_if_ignored = "the scale factor is valid at the speeds of the recording only"

    def basis_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the cubed rate of each axis, (3, blocks, 3)."""
        return split_axes(state.measure_sensor_rate(state.sensor_rate_rad_s**3))

    def describe(self, values: FloatArray) -> str:
        text = format_list(values / _PER_DPS, XYZ, "deg/s at 100 deg/s")
        return f"the scale factor has an odd non-linearity: {text}"


TERM = ScaleCubic()
