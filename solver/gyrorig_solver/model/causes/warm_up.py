"""Warm-up: the turn-on transient of the bias.

y_i += a_i exp(-(t - t_begin)/tau), where t_begin is the beginning of the recording, so that a is
the remaining transient at that time. 0.05 to 0.3 deg/s over 30 to 120 s (from memory); boards need
minutes to reach a steady state.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.signal_arrays import on_all_axes, split_axes
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import BinnedDependence, shape_parameter, size_parameter
from gyrorig_solver.model.term_kinds import LinearTerm, scan_grid
from gyrorig_solver.model.value_format import DEG, XYZ, format_list


class WarmUp(LinearTerm):
    """The amplitude a for x, y, z, then the time constant."""

    cause = "warm_up"
    title = "The board was still warming up"
    equation = "y_i = y_i + begin_i exp(-(t - begin of the recording) / time_constant)"
    part = "sensor"
    stage = "bias"
    scope = "recording"
    parameters = (
        size_parameter("begin", "rad/s", XYZ, typical=0.1, limit=5.0, prior_std=1.0, factor=DEG),
        shape_parameter(
            "time_constant", "s", typical=60.0, lower=5.0, upper=1200.0, prior_std=300.0, start=60.0
        ),
    )
    confused_with = ("thermal_bias", "bias_ramp", "bias_step", "bias_random_walk")
    remedy = "switch the board on ten minutes before recording"
    file_remedy = "leave out the data before the board was warm"
    covariates = ("bias_time",)
    picture = BinnedDependence("mean", "time")
    excitation = "one recording that starts at power-on, and one an hour later"
    effect_if_ignored = "the stated bias is that of a board that is still warming up"

    def basis_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the decay on each axis, (3, blocks, 3)."""
        decay = np.exp(-(state.time_s - state.context.begin_s) / float(values[3]))
        return split_axes(state.measure_sensor_rate(on_all_axes(decay)))

    def template_bank(self, state: SignalState) -> FloatArray:
        """Scan the time constant."""
        return scan_grid(self, time_constant=np.array([8.0, 15.0, 30.0, 60.0, 120.0, 240.0, 600.0]))

    def describe(self, values: FloatArray) -> str:
        text = format_list(values[:3] / DEG, XYZ, "deg/s")
        return f"the bias decays with a time constant of {values[3]:.0f} s, from {text}"


TERM = WarmUp()
