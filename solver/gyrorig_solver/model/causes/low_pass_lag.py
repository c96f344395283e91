"""Low-pass error: the sensor's low-pass is not the configured one.

The cut-off is f_c e^v. A register that selects 12.5 instead of 25 Hz has v = -0.69; between parts
of one type the cut-off varies by about 10 %. Nearly all of the effect is a lag, which the time
offset absorbs (0.998 of the energy). The rest is the shape of fast edges, equal on all axes and for
both motors. The term leaves the lag to the time offset permanently: its effect is the other filter
without the additional delay, so that a fit does not need to move the offset by milliseconds.
"""

from dataclasses import replace

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.low_pass import LowPass
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import EDGE_COVARIATES, TermParameter
from gyrorig_solver.model.term_kinds import NonlinearTerm, scan_grid

MAX_CUTOFF_SHARE = 0.45  # of the grid rate: a digital filter cannot have a higher cut-off


class LowPassLag(NonlinearTerm):
    """The logarithm of the true cut-off over the configured one."""

    cause = "low_pass_lag"
    title = "The low-pass filter differs from the configuration"
    equation = "cut-off frequency = stated frequency x exp(log_cutoff)"
    part = "sensor"
    stage = "low_pass"
    parameters = (
        TermParameter("log_cutoff", "1", typical_size=0.3, lower=-1.6, upper=1.6, prior_std=1.0),
    )
    confused_with = ("base_compliance", "s_curve", "base_speed_jump", "clock_offset")
    remedy = (
        "read the bandwidth register of the sensor and set bandwidth_hz to that value in the rig "
        "file"
    )
    covariates = (*EDGE_COVARIATES, "speed")
    picture = None
    excitation = "the fastest possible accelerations on both axes"
    effect_if_ignored = (
        "the time offset is valid for this filter only; at a bandwidth of 12.5 Hz the scale "
        "factor is wrong by up to 40 ppm"
    )

    def effect(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the difference of the outputs of the two filters, (blocks, 3)."""
        changed_state = self.propagate(state, values)
        if changed_state is state:
            return np.zeros((state.block_count, 3))
        return state.block_means(
            changed_state.sampled_output.undelayed - state.sampled_output.undelayed
        )

    def propagate(self, state: SignalState, values: FloatArray) -> SignalState:
        """Return the signal after the other filter, without its additional delay."""
        other = self._actual_filter(state, values)
        if other is None or state.low_pass is None:
            return state
        added_delay_s = other.delay_s - state.low_pass.delay_s
        changed_state = replace(state, low_pass=other)
        return changed_state.with_delay(np.full(state.used_instants.size, added_delay_s))

    def _actual_filter(self, state: SignalState, values: FloatArray) -> LowPass | None:
        if state.low_pass is None or values[0] == 0.0:
            return None
        highest = MAX_CUTOFF_SHARE * state.low_pass.rate_hz
        cutoff = min(state.low_pass.bandwidth_hz * float(np.exp(values[0])), highest)
        return replace(state.low_pass, bandwidth_hz=cutoff)

    def bandwidth_ratio(self, values: FloatArray) -> float:
        """Return the true cut-off over the configured one, which also applies to the noise."""
        return float(np.exp(values[0]))

    def template_bank(self, state: SignalState) -> FloatArray:
        """Scan both directions, because the effect is strongly nonlinear."""
        return scan_grid(self, log_cutoff=np.array([-0.7, -0.35, -0.1, 0.1, 0.35, 0.7]))

    def reason_not_testable(self, state: SignalState) -> str | None:
        """Return why no cut-off is known, or None."""
        if state.low_pass is None:
            return (
                "the recording has no bandwidth of the low-pass filter; record the board's "
                "bandwidth_hz"
            )
        return None

    def describe(self, values: FloatArray) -> str:
        return (
            f"the cut-off frequency of the low-pass filter is {np.exp(values[0]):.2f} times the "
            "configured bandwidth"
        )


TERM = LowPassLag()
