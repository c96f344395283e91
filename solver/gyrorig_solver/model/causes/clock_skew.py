"""Clock drift: the board's clock and the unit's clock run at different rates.

Timestamp t belongs to true time t - e (t - mid), where mid is the middle of the recording. e > 0
means that the board's clock is fast. Crystals have 20 to 50 ppm and ceramic resonators 640 ppm (an
UNO R3). RC or MEMS oscillators have 0.5 to 8 % if the sample rate itself is used as the clock. The
scale factor of all axes changes with it: a clock that is fast by e makes every rate (1 + e) times
as large.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import BinnedDependence, TermParameter
from gyrorig_solver.model.term_kinds import TimeTerm, scan_grid


class ClockSkew(TimeTerm):
    """The relative frequency offset e."""

    cause = "clock_skew"
    title = "The clocks drift apart"
    equation = "true time = t - rate x (t - middle of the recording)"
    scope = "recording"
    parameters = (
        TermParameter("rate", "1", typical_size=3e-5, lower=-0.1, upper=0.1, prior_std=0.02),
    )
    confused_with = ("clock_step", "lost_samples", "thermal_scale")
    remedy = (
        "timestamp the samples with the board's clock instead of counting them at the nominal "
        "output rate"
    )
    file_remedy = (
        "use the times of the sensor if the file has them, and correct `rate_hz` or `unit` "
        "under `time` in the import map"
    )
    covariates = ("move_delay",)
    picture = BinnedDependence("lag", "time")
    reference_alternative = "the error can be in the reference's clock instead"
    excitation = "starts and stops during the whole recording, and the host's receive times"
    effect_if_ignored = "the scale factors of all axes are wrong by the frequency offset"

    def sampling_delay(self, state: SignalState, values: FloatArray) -> FloatArray:
        """Return -e (t - mid), (instants,)."""
        return float(values[0]) * self._time_to_middle(state)

    def delay_derivatives(self, state: SignalState, values: FloatArray) -> dict[int, FloatArray]:
        """Return -(t - mid)."""
        return {0: self._time_to_middle(state)}

    def time_offset_ambiguity_s(self, values: FloatArray, duration_s: float) -> float:
        """Return half of the drift during the recording; the stated offset is in its middle."""
        return 0.5 * abs(float(values[0])) * duration_s

    def template_bank(self, state: SignalState) -> FloatArray:
        """Scan zero, and the errors of resonators and of sample rates."""
        return scan_grid(self, rate=np.array([0.0, 1e-3, -1e-3, 1e-2, -1e-2]))

    def describe(self, values: FloatArray) -> str:
        direction = "fast" if values[0] > 0.0 else "slow"
        skew_ppm = abs(values[0]) * 1e6
        return f"the board's clock is {skew_ppm:.3g} ppm {direction} relative to the unit's clock"

    def _time_to_middle(self, state: SignalState) -> FloatArray:
        middle = (state.context.begin_s + state.context.end_s) / 2.0
        return np.asarray(middle - state.sample_times_s, dtype=np.float64)


TERM = ClockSkew()
