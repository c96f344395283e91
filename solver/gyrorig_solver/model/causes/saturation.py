"""Saturation: the output stops below the full scale, which cuts off the peaks.

y_i is clipped at +-L, L = full scale (1 - s), after the low-pass and with the bias included. A part
clips near 32767 counts, 15 % above its nominal range; the supply or the firmware can clip earlier.
Samples that are flagged as saturated are excluded before; this term is for samples without a flag.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.cause_categories import RATE_COVARIATES
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import BinnedDependence, TermParameter
from gyrorig_solver.model.term_kinds import NonlinearTerm, scan_grid

SMALLEST_LIMIT, LARGEST_LIMIT = 0.02, 0.98  # of the scanned limits, relative to the full scale
FINE_STEP = 1e-3  # relative step between the scanned limits below the peaks
FINE_STEPS_BELOW = np.array([0.0, 1.0, 3.0, 6.0, 10.0, 15.0, 22.0, 32.0, 48.0, 70.0])


class Saturation(NonlinearTerm):
    """The shortfall from the full scale, as a share of it."""

    cause = "saturation"
    title = "The output saturates"
    equation = "|y| <= full scale x (1 - shortfall)"
    part = "sensor"
    stage = "limit"
    depends_on_upstream = True
    parameters = (
        TermParameter("shortfall", "1", typical_size=0.2, lower=0.0, upper=0.98, prior_std=1.0),
    )
    confused_with = ("scale_cubic", "low_pass_lag")
    implied_by = "wrong_full_scale"  # a sensor with half the range saturates at half the rate
    remedy = "use a larger full scale, or turn more slowly"
    covariates = RATE_COVARIATES
    template_search = "full_grid"
    picture = BinnedDependence("mean", "own_rate")
    excitation = "moves faster than the suspected limit, for half a second each"
    effect_if_ignored = "the scale factor is too small"

    def effect(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return the clipped part, (blocks, 3)."""
        full_scale_rad_s = state.context.full_scale_rad_s
        if full_scale_rad_s is None or values[0] == 0.0:
            return np.zeros((state.block_count, 3))
        limit_rad_s = full_scale_rad_s * (1.0 - float(values[0]))
        rate = state.filtered_rad_s + state.bias_rad_s
        return state.sample_output(np.clip(rate, -limit_rad_s, limit_rad_s) - rate)

    def incremental_gain(self, state: SignalState, values: FloatArray) -> FloatArray | None:
        """Return 1 if the rate is inside the limits, else 0, (n, 3)."""
        full_scale_rad_s = state.context.full_scale_rad_s
        if full_scale_rad_s is None or values[0] == 0.0:
            return None
        limit_rad_s = full_scale_rad_s * (1.0 - float(values[0]))
        return np.asarray(np.abs(state.filtered_rad_s + state.bias_rad_s) < limit_rad_s, np.float64)

    def template_bank(self, state: SignalState) -> FloatArray:
        """Scan limits an eighth apart, down to a fiftieth of the range, and some below each peak.

        A limit just below a peak has little in common with a limit an eighth lower. The limits
        below the peaks are on a fixed grid, so that parts with the same moves have the same limits.
        """
        limits = np.geomspace(SMALLEST_LIMIT, LARGEST_LIMIT, 30)
        full_scale_rad_s = state.context.full_scale_rad_s
        if full_scale_rad_s is not None:
            peaks = np.abs(state.filtered_rad_s + state.bias_rad_s).max(axis=0) / full_scale_rad_s
            peaks = np.clip(peaks, SMALLEST_LIMIT, LARGEST_LIMIT)
            first_steps = np.ceil(-np.log(peaks) / np.log1p(FINE_STEP))
            steps = (first_steps[:, None] + FINE_STEPS_BELOW).ravel()
            limits = np.unique(np.concatenate([limits, (1.0 + FINE_STEP) ** -steps]))
        return scan_grid(self, shortfall=1.0 - limits)

    def missing_data(self, state: SignalState) -> str | None:
        """Return why the range is unknown, or None."""
        if state.context.full_scale_rad_s is None:
            return "the recording has no full scale; record the board's gyro_full_scale_dps"
        return None

    def describe(self, values: FloatArray) -> str:
        return f"rates are clipped at {(1.0 - values[0]) * 100.0:.3g} % of the full scale"


TERM = Saturation()
