"""Clock saw-tooth: a clock runs fast or slow and is corrected at regular intervals.

Timestamp t belongs to true time t - e P (f - 1/2), where P is the period of the corrections and f
the elapsed share of the period. The clock gains e per second, and each correction sets it back by e
P. A daemon that corrects a host's clock in steps does this, and so does a firmware that restarts
its sample timer at each message of a time server. A recording with one correction cannot show the
period: its causes are `clock_skew` and `clock_step`. Therefore the search starts with periods for
which the recording contains two corrections, each with moves before and after it.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.cause_categories import TemplateSearch
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import EVENT_TIME, BinnedDependence, TermParameter, shape_parameter
from gyrorig_solver.model.term_kinds import TimeTerm

MIN_PERIOD_S = 2.0
MAX_TEETH = 20.0  # in a recording
MIN_TEETH = 1.0  # a longer period has at most one correction in the recording
TEETH_STEP = 0.05  # in the template bank: a correction is wrong by a twentieth of a period
PHASES = 24
EDGE_SHARE = 0.2  # of the period of a sample, over which a correction acts gradually


class ClockSawtooth(TimeTerm):
    """The relative frequency offset e, the period, and the time of one correction."""

    cause = "clock_sawtooth"
    title = "A clock drifts and is set right at regular intervals"
    equation = "true time = t - rate x period x (share of the period since a correction - 1/2)"
    scope = "recording"
    template_search: TemplateSearch = "lag_series"
    holds_shapes: bool = True
    first_order_equivalent = "clock_step"
    parameters = (
        TermParameter("rate", "1", typical_size=1e-4, lower=-0.1, upper=0.1, prior_std=0.02),
        shape_parameter(
            "period",
            "s",
            typical=10.0,
            lower=MIN_PERIOD_S,
            upper=36000.0,
            prior_std=36000.0,
            start=60.0,
        ),
        EVENT_TIME,
    )
    confused_with = ("clock_step", "clock_skew", "lost_samples")
    remedy = (
        "let the time service slew the clock instead of setting it, or timestamp the samples with "
        "a clock that nothing corrects"
    )
    file_remedy = "use times that nothing corrects if the file has them (`time` in the import map)"
    covariates = ("move_delay",)
    picture = BinnedDependence("lag", "time")
    reference_alternative = "the saw-tooth can be in the reference's clock instead"
    excitation = "starts and stops during the whole recording, several in each period"
    effect_if_ignored = (
        "the time offset is a mean over the recording, and the residual after each start and stop "
        "imitates other causes"
    )

    def sampling_delay(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return -e P (f - 1/2), (instants,)."""
        return float(values[0]) * self._delay_per_rate(state, values)

    def delay_derivatives(self, state: SignalState, values: FloatArray) -> dict[int, FloatArray]:
        """Return -P (f - 1/2)."""
        return {0: self._delay_per_rate(state, values)}

    def time_offset_ambiguity_s(self, values: FloatArray, duration_s: float) -> float:
        """Return half of a correction, because a later recording can begin anywhere in a period."""
        return 0.5 * abs(float(values[0] * values[1]))

    def template_bank(self, state: SignalState) -> FloatArray:
        """Return periods with two corrections between moves, each at several phases."""
        begin_s, end_s = _seen_span_s(state)
        length_s = end_s - begin_s
        most = min(MAX_TEETH, length_s / MIN_PERIOD_S)
        periods_s = length_s / np.arange(MIN_TEETH, max(most, MIN_TEETH) + TEETH_STEP, TEETH_STEP)
        period_s, phase = np.meshgrid(periods_s, np.arange(PHASES) / PHASES, indexing="ij")
        bank = np.zeros((period_s.size, 3))
        bank[:, 1] = period_s.ravel()
        # The correction nearest to the middle; its time hardly depends on the period.
        bank[:, 2] = 0.5 * (begin_s + end_s) + (period_s * (phase - 0.5)).ravel()
        last = np.floor((end_s - bank[:, 2]) / bank[:, 1])
        first = np.ceil((begin_s - bank[:, 2]) / bank[:, 1])
        return bank[last > first]

    def lag_shape(self, time_s: FloatArray, values: FloatArray) -> FloatArray:
        """Return the delay per unit of rate at some times, (n,)."""
        period_s = float(values[1])
        turns = (time_s - float(values[2])) / period_s
        return np.asarray(-period_s * (turns - np.floor(turns) - 0.5), dtype=np.float64)

    def describe(self, values: FloatArray) -> str:
        direction = "fast" if values[0] > 0.0 else "slow"
        step_ms = 1e3 * abs(float(values[0] * values[1]))
        return (
            f"the clock runs {abs(values[0]) * 1e6:.3g} ppm {direction} and is set right by "
            f"{step_ms:.3g} ms every {values[1]:.4g} s"
        )

    def _delay_per_rate(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the mean of -P (f - 1/2) over a short time about each sample, (instants,).

        The mean makes the likelihood a continuous function of the time offset, which decides
        whether a sample is before a correction or after it.
        """
        period_s, event_s = float(values[1]), float(values[2])
        half_s = 0.5 * EDGE_SHARE * state.intervals_per_instant * state.step_s
        middle = state.sample_times_s - event_s
        turns = ((middle - half_s) / period_s, (middle + half_s) / period_s)
        before, after = (0.5 * np.floor(x) + 0.5 * (x - np.floor(x)) ** 2 for x in turns)
        mean = (after - before) * period_s / (2.0 * half_s)
        return np.asarray(-period_s * (mean - 0.5), dtype=np.float64)


def _seen_span_s(state: SignalState) -> tuple[float, float]:
    """Return the time span in which moves of a recording show a correction."""
    begin_s, end_s = state.context.begin_s, state.context.end_s
    moving_s = state.time_s[state.moving.any(axis=0)]
    if not moving_s.size:
        return begin_s, end_s
    # The recording has moves before or after a part that begins or ends within it.
    if state.time_s[0] <= begin_s:
        begin_s = float(moving_s[0])
    if state.time_s[-1] >= end_s - state.step_s:
        end_s = float(moving_s[-1])
    return begin_s, end_s


TERM = ClockSawtooth()
