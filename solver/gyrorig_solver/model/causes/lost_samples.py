"""Lost samples: uncounted samples are missing, so that later timestamps are too early.

If timestamps come from counting samples, n lost samples shift all later timestamps by n periods:
the true time is t + n Ts from the event on. It is a clock step of a whole number of periods. The
board's own timestamps or sequence numbers separate the two.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.link_remedies import LOST_SAMPLES
from gyrorig_solver.model.causes.clock_step import SCAN_TIMES, instants_after
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import EVENT_TIME, BinnedDependence, TermParameter
from gyrorig_solver.model.term_kinds import TimeTerm, event_times, scan_grid


class LostSamples(TimeTerm):
    """The count, then the time."""

    cause = "lost_samples"
    title = "Samples are missing"
    equation = "true time = t + count x sample period for t >= time"
    scope = "recording"
    parameters = (
        TermParameter(
            "count",
            "samples",
            typical_size=3.0,
            lower=0.0,
            upper=1000.0,
            prior_std=100.0,
            is_integer=True,
        ),
        EVENT_TIME,
    )
    confused_with = ("clock_step", "clock_skew")
    remedy = "send and store a sequence number with every sample, or lower the output rate"
    file_remedy = LOST_SAMPLES.file
    covariates = ("move_delay",)
    picture = BinnedDependence("lag", "time")
    first_order_equivalent = "clock_step"
    excitation = "sequence numbers, or else starts and stops before and after the loss"
    effect_if_ignored = "the time offset is valid for only a part of the recording"

    def missing_data(self, state: SignalState) -> str | None:
        """Return why the sample period is unknown, or None."""
        if state.context.sample_period_s is None:
            return "the recording has no sample period; record the board's odr_hz"
        return None

    def sampling_delay(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return n periods after the event, (instants,)."""
        return float(values[0]) * self._period(state) * instants_after(state, float(values[1]))

    def delay_derivatives(self, state: SignalState, values: FloatArray) -> dict[int, FloatArray]:
        """Return one period after the event."""
        return {0: self._period(state) * instants_after(state, float(values[1]))}

    def template_bank(self, state: SignalState) -> FloatArray:
        """Scan times over the whole recording, for a few and for many samples."""
        return scan_grid(self, count=np.array([0.0, 20.0]), time=event_times(state, SCAN_TIMES))

    def describe(self, values: FloatArray) -> str:
        return f"{values[0]:.3g} uncounted samples are missing at {values[1]:.1f} s"

    def _period(self, state: SignalState) -> float:
        return state.context.sample_period_s or 0.0


TERM = LostSamples()
