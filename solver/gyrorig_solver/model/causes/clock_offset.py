"""Time offset: all samples are late or early relative to the motion by one time.

y(t) = omega(t - tau): the time offset of the base model, which contains filter delay and transport
(1 to 50 ms). To first order the effect is -tau d(G omega)/dt, which the fit absorbs completely.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import BinnedDependence, TermParameter
from gyrorig_solver.model.term_kinds import LinearTerm


class ClockOffset(LinearTerm):
    """The delay of the samples."""

    cause = "clock_offset"
    title = "The samples have a time offset"
    equation = "y(t) = omega(t - offset)"
    part = "clock"
    stage = "clock"
    kind = "gauge"
    scope = "recording"
    parameters = (
        TermParameter("offset", "s", typical_size=5e-3, lower=-0.5, upper=0.5, prior_std=0.1),
    )
    confused_with = ("low_pass_lag", "clock_step", "s_curve")
    remedy = "do nothing, because the calibration estimates the time offset"
    covariates = None
    picture = BinnedDependence("lag", "time")
    excitation = (
        "fast starts and stops, and pings and known filters to separate the components of the "
        "offset"
    )
    effect_if_ignored = "none, because the time offset is a parameter of every calibration"

    def basis_signals(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return minus the time derivative, (1, blocks, 3)."""
        return -state.sample_output(state.filtered_slope_rad_s2)[None]

    def propagate(self, state: SignalState, values: FloatArray) -> SignalState:
        """Return the signal sampled earlier."""
        return state.with_delay(np.full(state.used_instants.size, -float(values[0])))

    def describe(self, values: FloatArray) -> str:
        return f"the samples are {values[0] * 1e3:.3g} ms late relative to the motion"


TERM = ClockOffset()
