"""Scale-factor asymmetry: the scale factor differs between the two directions.

y_i += a_i |(G omega)_i|: even in the rate, with a corner at zero; (1 + a) forward, (1 - a)
backward. 0.1 to 0.5 % (from memory). One BMI270 was wrong by 2 deg in ten turns each way, 0.06 %.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.cause_categories import RATE_COVARIATES
from gyrorig_solver.model.signal_arrays import split_axes
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import BinnedDependence, size_parameter
from gyrorig_solver.model.term_kinds import LinearTerm
from gyrorig_solver.model.value_format import XYZ, format_list


class ScaleAsymmetry(LinearTerm):
    """The share a for x, y, z."""

    cause = "scale_asymmetry"
    title = "The two directions have different scale factors"
    equation = "y_i = y_i + share_i |(G omega)_i|"
    part = "sensor"
    parameters = (size_parameter("share", "1", XYZ, typical=2e-3, limit=0.05, prior_std=0.02),)
    confused_with = ("scale_quadratic", "vibration_rectification", "motor_coupling")
    remedy = "let `gyrorig solve` fit this cause, because it is a property of the sensor"
    scale_rate_power = 0
    covariates = RATE_COVARIATES
    picture = BinnedDependence("mean", "own_rate")
    excitation = "both directions at four or more speeds, including slow ones"
    effect_if_ignored = "scale factors and biases are valid for motion in both directions only"

    def basis_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the speed of each axis, (3, blocks, 3)."""
        return split_axes(state.measure_sensor_rate(np.abs(state.sensor_rate_rad_s)))

    def describe(self, values: FloatArray) -> str:
        text = format_list(values * 100.0, XYZ, "%")
        return f"the scale factors of positive and negative rates differ: ±{text}"


TERM = ScaleAsymmetry()
