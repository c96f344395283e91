"""Low-pass error: the sensor's low-pass is not the recorded one, or no low-pass is recorded.

The cut-off is f_c e^v. A register that selects 12.5 instead of 25 Hz has v = -0.69; between parts
of one type the cut-off varies by about 10 %. Nearly all of the effect is a lag, which the time
offset absorbs (0.998 of the energy). The rest is the shape of fast edges, equal on all axes and for
both motors. The term leaves the lag to the time offset permanently: its effect is the other filter
without the additional delay, so that a fit does not need to move the offset by milliseconds.

If a recording has no bandwidth, the model has no low-pass. A real low-pass then rounds the edges
of all moves, as an s-curve or a compliant base does. The other form of the term has the period
1/f_c of an unknown low-pass. A period of zero is no low-pass. For short periods, the shape of the
edges changes with the third power of the period.
"""

from dataclasses import replace

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.cause_categories import EDGE_COVARIATES
from gyrorig_solver.model.low_pass import LowPass
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import LONG_RECORDING, TermParameter
from gyrorig_solver.model.term_kinds import NonlinearTerm, scan_grid

MAX_CUTOFF_SHARE = 0.45  # of the grid rate: a digital filter cannot have a higher cut-off
# Scanned periods of an unknown low-pass, in periods of the block means: at 100 Hz from 4 to 45 Hz.
SCANNED_PERIODS = np.array([2.2, 3.2, 4.5, 6.5, 10.0, 16.0, 25.0])
MEAN_RATIO = 1.5  # from this ratio of an instant's interval to the sample period on, it is a mean


class LowPassLag(NonlinearTerm):
    """The logarithm of the true cut-off over the recorded one."""

    cause = "low_pass_lag"
    title = "The low-pass filter of the sensor is not that of the model"
    equation = "cut-off frequency = recorded bandwidth x exp(log_cutoff)"
    part = "sensor"
    stage = "low_pass"
    parameters: tuple[TermParameter, ...] = (
        TermParameter("log_cutoff", "1", typical_size=0.3, lower=-1.6, upper=1.6, prior_std=1.0),
    )
    confused_with = ("base_compliance", "s_curve", "base_speed_jump", "clock_offset")
    remedy = (
        "read the bandwidth register of the sensor and set bandwidth_hz to that value in the rig "
        "file or the column map; if you cannot read the register, let `gyrorig solve` fit this "
        "cause"
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
        return _output_difference(changed_state, state)

    def propagate(self, state: SignalState, values: FloatArray) -> SignalState:
        """Return the signal after the other filter, without its additional delay."""
        other = self._actual_filter(state, values)
        if other is None or state.low_pass is None:
            return state
        return _with_filter(state, other, other.delay_s - state.low_pass.delay_s)

    def _actual_filter(self, state: SignalState, values: FloatArray) -> LowPass | None:
        if state.low_pass is None or values[0] == 0.0:
            return None
        highest = MAX_CUTOFF_SHARE * state.low_pass.rate_hz
        cutoff = min(state.low_pass.bandwidth_hz * float(np.exp(values[0])), highest)
        return replace(state.low_pass, bandwidth_hz=cutoff)

    def noise_bandwidth_hz(self, values: FloatArray, bandwidth_hz: float | None) -> float | None:
        """Return the true cut-off, which also applies to the noise, in Hz."""
        return None if bandwidth_hz is None else bandwidth_hz * float(np.exp(values[0]))

    def template_bank(self, state: SignalState) -> FloatArray:
        """Scan both directions, because the effect is strongly nonlinear."""
        return scan_grid(self, log_cutoff=np.array([-0.7, -0.35, -0.1, 0.1, 0.35, 0.7]))

    def missing_data(self, state: SignalState) -> str | None:
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
            "recorded bandwidth"
        )


class UnrecordedLowPass(LowPassLag):
    """The period 1/f_c of the cut-off of a low-pass whose bandwidth is not recorded."""

    equation = "cut-off frequency = 1/period; the recording has no bandwidth"
    starts_at_typical_size = True
    is_always_present = True  # every sensor has a low-pass
    parameters = (
        TermParameter("period", "s", typical_size=0.02, lower=0.0, upper=0.5, prior_std=0.1),
    )

    def effect(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the output of the filter minus that without a filter, (blocks, 3)."""
        other = self._actual_filter(state, values)
        if other is None:
            return np.zeros((state.block_count, 3))
        changed_state = self.propagate(state, values)
        if _has_means(state):
            # `SignalState` converts means into instants before the filter, but here the instants
            # represent means before and after the filter.
            rate = state.sensor_rate_rad_s
            changed_state = replace(changed_state, low_pass=None)
            changed_state = changed_state.with_sensor(other.apply(rate) - rate)
        return _output_difference(changed_state, state)

    def propagate(self, state: SignalState, values: FloatArray) -> SignalState:
        """Return the signal after the filter, without its delay."""
        other = self._actual_filter(state, values)
        return state if other is None else _with_filter(state, other, other.delay_s)

    def _actual_filter(self, state: SignalState, values: FloatArray) -> LowPass | None:
        period_s = float(values[0])
        return None if period_s <= 0.0 else LowPass(1.0 / period_s, 1.0 / state.step_s)

    def noise_bandwidth_hz(self, values: FloatArray, bandwidth_hz: float | None) -> float | None:
        """Return the cut-off, which also applies to the noise, in Hz."""
        return bandwidth_hz if values[0] <= 0.0 else 1.0 / float(values[0])

    def template_bank(self, state: SignalState) -> FloatArray:
        """Scan the cut-offs that block means show; there is no derivative at zero."""
        instants = state.instants_per_block * state.intervals_per_instant
        return scan_grid(self, period=SCANNED_PERIODS * state.step_s * instants)

    def missing_data(self, state: SignalState) -> str | None:
        """Return why the motion does not show the filter, or None.

        Attitudes have another bandwidth, and no other cause of a reference without angles rounds
        the edges.
        """
        if not state.has_angles:
            return super().missing_data(state)
        if state.low_pass is not None:
            return (
                "only some of the recordings have a bandwidth of the low-pass filter; record the "
                "board's bandwidth_hz in all of them"
            )
        if state.context.mean_duration_s > 0.0:
            return LONG_RECORDING.format(state.context.mean_duration_s)
        return None

    def describe(self, values: FloatArray) -> str:
        if values[0] <= 0.0:
            return "the sensor has no low-pass filter that the recording shows"
        return (
            f"the low-pass filter of the sensor has a cut-off frequency of {1.0 / values[0]:.3g} "
            "Hz; the recording has no bandwidth"
        )


def _with_filter(state: SignalState, low_pass: LowPass, added_delay_s: float) -> SignalState:
    """Return the signal after a low-pass, sampled later by its additional delay."""
    changed_state = replace(state, low_pass=low_pass)
    return changed_state.with_delay(np.full(state.used_instants.size, added_delay_s))


def _output_difference(changed_state: SignalState, state: SignalState) -> FloatArray:
    """Return the output of a changed state minus that of another, (blocks, 3)."""
    return state.block_means(
        changed_state.sampled_output.undelayed - state.sampled_output.undelayed
    )


def _has_means(state: SignalState) -> bool:
    """Return whether each instant of a state represents the mean of several samples."""
    sample_period_s = state.context.sample_period_s
    instant_s = state.step_s * state.intervals_per_instant
    return sample_period_s is not None and instant_s > MEAN_RATIO * sample_period_s


LowPassLag.form_without_bandwidth = UnrecordedLowPass()
TERM = LowPassLag()
