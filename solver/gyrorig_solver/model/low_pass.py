"""The sensor's own low-pass: second-order Butterworth at the configured bandwidth.

The data sheets name a cut-off and no filter; a second order is the usual reading. A
wrong shape is nearly all absorbed by the time offset: 36, 7, 1 and 0 ppm of scale at
12.5, 25, 50 and 110 Hz (reference: simulated, time synchronisation notes section 6).
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.recursive import Thinned, ramp_invariant, recursed, steady

SHARPENED = (-0.125, 1.25, -0.125)  # of means, to what straight lines through them make of it


@dataclass(frozen=True, slots=True)
class LowPass:
    """A digital stand-in for the sensor's filter on a grid of `rate_hz`."""

    bandwidth_hz: float
    rate_hz: float

    def coefficients(self) -> tuple[FloatArray, FloatArray]:
        """Return numerator and denominator of the ramp-invariant second-order Butterworth.

        Exact for rates that are straight between grid points, as a trapezoid's are, so the
        delay at zero frequency is the analogue filter's, sqrt(2)/omega; a bilinear filter
        that is right at the cut-off has 0.8 % less of it at 20 points to a period.
        """
        return ramp_invariant(
            2.0 * np.pi * self.bandwidth_hz, float(np.sqrt(0.5)), 1.0 / self.rate_hz
        )

    def apply(self, signal: FloatArray) -> FloatArray:
        """Filter each column of `signal`, shape (n, k); the start is taken as steady."""
        b, a = self.coefficients()
        padded = np.concatenate([np.repeat(signal[:1], self._settling(), axis=0), signal])
        return np.asarray(recursed(b, a, padded.T).T[self._settling() :], dtype=np.float64)

    def apply_to_means(self, means: FloatArray) -> FloatArray:
        """Filter means of a motion between grid edges, shape (..., n), along n.

        A mean over h is x + h^2/24 x'', straight lines through the means add h^2/12 x'':
        both are taken out first, or a jump of speed comes out 5 % softer at a tenth of the
        grid's rate. The start is taken as steady.
        """
        if means.size == 0:
            return means
        sharp, a = self._sharpened()
        late = steady(sharp, a, means)
        return np.asarray(np.concatenate([late[..., 1:], late[..., -1:]], axis=-1), np.float64)

    def apply_to_instants(self, means: FloatArray, step: int) -> FloatArray:
        """Return the middle of every `step` values of `apply_to_means`, (..., n / step).

        Args:
            means: shape (..., n), n a multiple of the step.
            step: odd.
        """
        if step == 1 or means.size == 0:
            return self.apply_to_means(means)
        return Thinned.of(*self._sharpened(), step, step // 2 + 1).steady(means)

    def _sharpened(self) -> tuple[FloatArray, FloatArray]:
        """Return the filter of means, one value late."""
        b, a = self.coefficients()
        return np.convolve(b, SHARPENED), a

    @property
    def delay_s(self) -> float:
        """Group delay at zero frequency, in s."""
        return float(np.sqrt(2.0) / (2.0 * np.pi * self.bandwidth_hz))

    def _settling(self) -> int:
        return int(np.ceil(3.0 * self.rate_hz / self.bandwidth_hz))


def power_gain(frequency_hz: FloatArray, bandwidth_hz: float | None) -> FloatArray:
    """Return |H|^2 of the analogue second-order Butterworth; 1 where there is none."""
    if bandwidth_hz is None:
        return np.ones_like(frequency_hz)
    return np.asarray(1.0 / (1.0 + (frequency_hz / bandwidth_hz) ** 4), dtype=np.float64)
