"""Clock step: the board's clock, or the host's clock, jumps once.

From the event on, samples were taken s earlier than stated: t becomes t - s. A host step, a
re-enumerated USB port (about 16 ms of latency) or a controller that answers later after its echo
was switched on can cause it. If the arrival times step too, the clock has stepped. If they do not,
the unit or the filter has changed.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.link_remedies import CLOCK_STEP
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import EVENT_TIME, BinnedDependence, TermParameter
from gyrorig_solver.model.term_kinds import TimeTerm, event_times, scan_grid

SCAN_TIMES = 40  # in the template bank, over a recording


class ClockStep(TimeTerm):
    """The step, then its time."""

    cause = "clock_step"
    title = "A clock stepped"
    equation = "true time = t - step for t >= time"
    scope = "recording"
    parameters = (
        TermParameter("step", "s", typical_size=2e-3, lower=-1.0, upper=1.0, prior_std=0.1),
        EVENT_TIME,
    )
    confused_with = ("lost_samples", "clock_skew", "lost_steps")
    remedy = (
        "do not suspend the host or set its clock during a recording, and check the host's log "
        "for USB reconnections"
    )
    file_remedy = CLOCK_STEP.file
    covariates = ("move_delay",)
    picture = BinnedDependence("lag", "time")
    reference_alternative = "the step can be in the reference's clock instead"
    excitation = "starts and stops before and after the step, sequence numbers and arrival times"
    effect_if_ignored = (
        "the time offset is valid for only a part of the recording; scale factors and M hardly "
        "change"
    )

    def sampling_delay(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return -s after the event, (instants,)."""
        return -float(values[0]) * instants_after(state, float(values[1]))

    def delay_derivatives(self, state: SignalState, values: FloatArray) -> dict[int, FloatArray]:
        """Return -1 after the event."""
        return {0: -instants_after(state, float(values[1]))}

    def time_offset_ambiguity_s(self, values: FloatArray, duration_s: float) -> float:
        """Return the step size: a later recording can be like the part before or after it."""
        return abs(float(values[0]))

    def template_bank(self, state: SignalState) -> FloatArray:
        """Scan times over the whole recording, for small and for large steps."""
        return scan_grid(
            self, step=np.array([-0.05, 0.0, 0.05]), time=event_times(state, SCAN_TIMES)
        )

    def describe(self, values: FloatArray) -> str:
        return f"the timestamps jump by {values[0] * 1e3:.3g} ms at {values[1]:.1f} s"


def instants_after(state: SignalState, event_s: float) -> FloatArray:
    """Return 0 before an event and 1 after it, (instants,), with a ramp over one period."""
    period_s = state.intervals_per_instant * state.step_s
    return np.clip((state.sample_times_s - event_s) / period_s + 0.5, 0.0, 1.0)


TERM = ClockStep()
