"""Sampling jitter: each sample is taken a little before or after its timestamp, at random.

y(t + d), d white with standard deviation s: noise of variance s^2 (dy/dt)^2, which exists only
while the stage accelerates. Polled gyroscopes and arrival timestamps have 1 to 20 ms; interrupts
have 5 to 50 us. The mean shows only smoothing of order s^2.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import TermParameter
from gyrorig_solver.model.term_kinds import ZeroMeanTerm


class SampleJitter(ZeroMeanTerm):
    """The standard deviation of the sampling time."""

    cause = "sample_jitter"
    title = "The sampling times are irregular"
    equation = "y(t + d), d random with the standard deviation `deviation`"
    part = "clock"
    kind = "stochastic"
    scope = "recording"
    parameters = (
        TermParameter("deviation", "s", typical_size=5e-4, lower=0.0, upper=0.05, prior_std=0.01),
    )
    confused_with = ("acceleration_error", "repeated_samples")
    remedy = "timestamp the samples in the board's data-ready interrupt"
    file_remedy = (
        "use the times of the sensor instead of those of the arrival if the file has them "
        "(`time` in the import map)"
    )
    covariates = None
    picture = None
    similar_in_draws = "any other noise that is larger during acceleration"
    excitation = "long accelerations next to rests, with timestamps from the board"
    effect_if_ignored = (
        "the uncertainties are too small, because the fit gives accelerations too much weight"
    )

    def added_variance(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the variance that it adds to each block mean, (blocks, 3)."""
        slope = state.filtered_slope_rad_s2
        return np.asarray(
            values[0] ** 2 * state.sample_output(slope**2) / self._samples_per_block(state),
            np.float64,
        )

    def unit_effect(self, state: SignalState) -> FloatArray:
        """Return the effect of a unit of jitter on each block mean, (blocks, 3).

        One random number per block applies to all axes, because a sample is early or late on all of
        them.
        """
        slope = state.sample_output(state.filtered_slope_rad_s2)
        return np.asarray(slope / np.sqrt(self._samples_per_block(state)), dtype=np.float64)

    def _samples_per_block(self, state: SignalState) -> FloatArray:
        """Return the number of samples in each block mean, (blocks, 1)."""
        used = state.used_instants.reshape(state.block_count, state.instants_per_block).sum(axis=1)
        period_s = state.context.sample_period_s
        instant_s = state.intervals_per_instant * state.step_s
        samples_per_instant = 1.0 if period_s is None else max(1.0, instant_s / period_s)
        return np.asarray(np.maximum(used * samples_per_instant, 1.0)[:, None], dtype=np.float64)

    def describe(self, values: FloatArray) -> str:
        return f"the sampling times scatter by {values[0] * 1e3:.3g} ms about their timestamps"


TERM = SampleJitter()
