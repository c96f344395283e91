"""Bias step: the bias jumps once.

y_i += s_i from the event on: 10 to 50 mdeg/s. A knock, a changed supply, or a part that repeats its
trimming can cause it (up to 0.4 rad/s in a flight log).
"""

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.signal_arrays import on_all_axes, split_axes
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import EVENT_TIME, BinnedDependence, size_parameter
from gyrorig_solver.model.term_kinds import LinearTerm, event_times, scan_grid, step_signal
from gyrorig_solver.model.value_format import DEG, XYZ, format_list

SCAN_TIMES = 60  # in the template bank, over a recording


class BiasStep(LinearTerm):
    """The step s for x, y, z, then its time."""

    cause = "bias_step"
    title = "The bias stepped"
    equation = "y = y + step for t >= time"
    part = "sensor"
    stage = "bias"
    scope = "recording"
    parameters = (
        size_parameter("step", "rad/s", XYZ, typical=0.03, limit=25.0, prior_std=2.0, factor=DEG),
        EVENT_TIME,
    )
    confused_with = ("bias_ramp", "thermal_bias", "warm_up", "bias_random_walk")
    remedy = "check the board's supply, load and light at that moment, and record again"
    file_remedy = (
        "solve the data before and after the step separately, or ask the person who recorded "
        "the file what happened at that moment"
    )
    covariates = ("bias_time",)
    picture = BinnedDependence("mean", "time")
    excitation = "rests before and after the step, and a second recording without a step"
    effect_if_ignored = "the stated bias is a mean of two values"

    def basis_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the step on each axis, (3, blocks, 3)."""
        share = step_signal(state, float(values[3]))
        return split_axes(state.measure_sensor_rate(on_all_axes(share)))

    def template_bank(self, state: SignalState) -> FloatArray:
        """Scan times over the whole recording."""
        return scan_grid(self, time=event_times(state, SCAN_TIMES))

    def describe(self, values: FloatArray) -> str:
        text = format_list(values[:3] / DEG, XYZ, "deg/s")
        return f"the bias changes suddenly at {values[3]:.1f} s: {text}"


TERM = BiasStep()
