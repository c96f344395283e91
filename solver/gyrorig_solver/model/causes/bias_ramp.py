"""Bias drift: the bias changes linearly with time.

y_i += r_i (t - mid), where mid is the middle of the recording. It models slow warming without a
thermometer, or ageing. A board that warms itself by 3 K over 300 s drifts by 0.1 deg/s at the
L3G4200D's 0.03 dps/K, as much as a warm-up.
"""

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.signal_arrays import on_all_axes, split_axes
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import BinnedDependence, size_parameter
from gyrorig_solver.model.term_kinds import LinearTerm
from gyrorig_solver.model.value_format import DEG, XYZ, format_list

_TYPICAL = 0.1 * DEG / 300.0


class BiasRamp(LinearTerm):
    """The slope r for x, y, z."""

    cause = "bias_ramp"
    title = "The bias drifts steadily"
    equation = "y = y + slope x (t - middle of the recording)"
    part = "sensor"
    stage = "bias"
    scope = "recording"
    parameters = (
        size_parameter(
            "slope", "rad/s^2", XYZ, typical=1.0, limit=100.0, prior_std=50.0, factor=_TYPICAL
        ),
    )
    confused_with = ("thermal_bias", "warm_up", "bias_random_walk", "bias_step")
    remedy = "let the board warm up before recording, or record for longer"
    file_remedy = "leave out the data before the board was warm, or use a longer recording"
    covariates = ("bias_time",)
    picture = BinnedDependence("mean", "time")
    excitation = "a longer recording, with the temperature of the board"
    effect_if_ignored = "the stated bias is the value at the middle of the recording"

    def basis_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the time from the middle of the recording on each axis, (3, blocks, 3)."""
        middle = (state.context.begin_s + state.context.end_s) / 2.0
        return split_axes(state.measure_sensor_rate(on_all_axes(state.time_s - middle)))

    def describe(self, values: FloatArray) -> str:
        return f"the bias drifts: {format_list(values / DEG * 60.0, XYZ, 'deg/s per minute')}"


TERM = BiasRamp()
