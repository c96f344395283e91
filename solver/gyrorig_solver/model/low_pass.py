"""The low-pass of the sensor: a second-order Butterworth at the configured bandwidth.

Data sheets state a cut-off frequency and no filter type; second order is the usual interpretation.
The time offset absorbs nearly all of a wrong shape: the remaining error of the scale factor is 36,
7, 1 and 0 ppm at 12.5, 25, 50 and 110 Hz (simulated).
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.recursive_filters import (
    filter_from_rest,
    filter_from_steady,
    ramp_invariant,
)

NEGLIGIBLE_DECAY = 40.0  # exponent of the decay of a filter's state; the rest is below rounding
DELAY_COUNT, DELAY_PHASE = 8, 2.0 * np.pi  # number of delays and end of an impulse response
# corrects the difference between means and straight-line interpolation
MEAN_SHARPENING = (-0.125, 1.25, -0.125)


@dataclass(frozen=True, slots=True)
class LowPass:
    """A digital equivalent of the sensor's filter on a grid of `rate_hz`."""

    bandwidth_hz: float
    rate_hz: float

    def coefficients(self) -> tuple[FloatArray, FloatArray]:
        """Return numerator and denominator of the ramp-invariant second-order Butterworth.

        It is exact for rates that are linear between grid points, as those of a trapezoid are. The
        delay at zero frequency therefore equals that of the analogue filter, sqrt(2)/omega. A
        bilinear filter that is exact at the cut-off has 0.8 % less delay at 20 points per period.
        """
        return ramp_invariant(
            2.0 * np.pi * self.bandwidth_hz, float(np.sqrt(0.5)), 1.0 / self.rate_hz
        )

    def apply(self, signal: FloatArray) -> FloatArray:
        """Filter each column of `signal`, shape (n, k), from a steady state."""
        b, a = self.coefficients()
        padded = np.concatenate([np.repeat(signal[:1], self._settling_length(), axis=0), signal])
        return np.asarray(
            filter_from_rest(b, a, padded.T).T[self._settling_length() :], dtype=np.float64
        )

    def apply_to_means(self, means: FloatArray) -> FloatArray:
        """Filter means of a motion between grid edges, shape (..., n), along n.

        A mean over h is x + h^2/24 x'', and straight lines through the means add h^2/12 x''. Both
        are removed first; otherwise a jump of speed is 5 % softer at a tenth of the grid rate. The
        filter starts from a steady state.
        """
        if means.size == 0:
            return means
        numerator, denominator = self._sharpened_coefficients()
        delayed = filter_from_steady(numerator, denominator, means)
        return np.asarray(
            np.concatenate([delayed[..., 1:], delayed[..., -1:]], axis=-1), np.float64
        )

    def apply_to_instants(self, means: FloatArray, step: int) -> FloatArray:
        """Return the middle value of every `step` values of `apply_to_means`, (..., n / step).

        Args:
            means: shape (..., n), n a multiple of the step.
            step: odd.
        """
        if step == 1 or means.size == 0:
            return self.apply_to_means(means)
        return filter_from_steady(*self._sharpened_coefficients(), means, step, step // 2 + 1)

    def apply_to_blocks(self, means: FloatArray, length: int) -> FloatArray:
        """Return the mean of every `length` values of `apply_to_means`, (..., n / length).

        Filter and mean are one filter of which only every n-th output is computed.

        Args:
            means: shape (..., n), n a multiple of the length.
            length: of a block.
        """
        if length == 1 or means.size == 0:
            return self.apply_to_means(means)
        numerator, denominator = self._sharpened_coefficients()
        averaging = np.convolve(numerator, np.full(length, 1.0 / length))
        blocks = filter_from_steady(averaging, denominator, means, length)
        # The output of a block comes with the first value of the next one; none follows the last.
        decay = np.sqrt(2.0) * np.pi * self.bandwidth_hz / self.rate_hz
        tail = self.apply_to_means(means[..., -int(length + np.ceil(NEGLIGIBLE_DECAY / decay)) :])
        last = tail[..., -length:].mean(axis=-1, keepdims=True)
        return np.concatenate([blocks[..., 1:], last], axis=-1)

    def _sharpened_coefficients(self) -> tuple[FloatArray, FloatArray]:
        """Return the filter of means, delayed by one value."""
        b, a = self.coefficients()
        return np.convolve(b, MEAN_SHARPENING), a

    @property
    def delay_s(self) -> float:
        """The group delay at zero frequency, in s."""
        return float(np.sqrt(2.0) / (2.0 * np.pi * self.bandwidth_hz))

    def _settling_length(self) -> int:
        return int(np.ceil(3.0 * self.rate_hz / self.bandwidth_hz))


def power_gain(frequency_hz: FloatArray, bandwidth_hz: float | None) -> FloatArray:
    """Return |H|^2 of the analogue second-order Butterworth; 1 without a filter."""
    if bandwidth_hz is None:
        return np.ones_like(frequency_hz)
    return np.asarray(1.0 / (1.0 + (frequency_hz / bandwidth_hz) ** 4), dtype=np.float64)


def delay_distribution(bandwidth_hz: float) -> tuple[FloatArray, FloatArray]:
    """Return delays about their mean, (k,), and weights, which together act like a low-pass.

    The weights are the impulse response of the second-order Butterworth at equal distances. Their
    sum is one, and their mean delay is zero.
    """
    omega = 2.0 * np.pi * bandwidth_hz
    phase = (np.arange(DELAY_COUNT) + 0.5) * (DELAY_PHASE / DELAY_COUNT)
    weights = np.exp(-phase) * np.sin(phase)
    weights /= weights.sum()
    delays_s = np.sqrt(2.0) * phase / omega
    return (
        np.asarray(delays_s - weights @ delays_s, dtype=np.float64),
        np.asarray(weights, dtype=np.float64),
    )
