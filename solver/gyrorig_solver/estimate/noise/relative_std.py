"""Relative standard deviation, in the whitening, of noise that is larger in motion.

A signal is first whitened by the stationary noise at rest, and then divided by the relative
standard deviation of the noise at its time. For white noise this is exact. The stationary whitening
removes slow noise (flicker, random walk), so slow noise stays the same at rest and in motion.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import dct, idct

from gyrorig_solver.data import FloatArray, IntArray, RealArray

MAX_LOG_WEIGHT_CHANGE = 0.03  # of a variance; smaller changes keep the old weights


@dataclass(frozen=True, slots=True, eq=False)
class RelativeStd:
    """The standard deviation of one part's noise, relative to that at rest.

    The constants of a series with several parts are weighted together and are not divided.
    """

    values: FloatArray  # (3, n)
    keeps_constant: bool  # True if the series has several parts

    def divide_spectra(self, spectra: FloatArray, axis: int | IntArray | None = None) -> FloatArray:
        """Return white spectra after the division of their signals.

        Args:
            spectra: shape (k, n) of one sensor axis, or (..., 3, n).
            axis: the sensor axis, of all rows or of each; None for all three.
        """
        return self._scale(spectra, 1.0 / (self.values if axis is None else self.values[axis]))

    @property
    def white_variance(self) -> FloatArray:
        """The variance of white noise below the bandwidth, relative to that at rest, (3, n)."""
        return np.asarray(self.values**2, np.float64)

    @property
    def sample_values(self) -> FloatArray:
        """The standard deviation of a sample, not whitened, relative to that at rest, (3, n)."""
        return self.values

    def divide_adjoint(self, spectra: FloatArray) -> FloatArray:
        """Return the adjoint of `divide_spectra` for all axes, shape (..., 3, n)."""
        return self.divide_spectra(spectra)

    def divide_signals(self, signals: RealArray, axis: int) -> RealArray:
        """Return white signals of one sensor axis, (k, n), divided; see `divide_spectra`."""
        std = self.values[axis].astype(signals.dtype)
        constant = signals.mean(axis=-1, keepdims=True) if self.keeps_constant else 0.0
        divided: RealArray = np.divide(signals - constant, std)
        if self.keeps_constant:
            divided += constant - divided.mean(axis=-1, keepdims=True)
        return divided

    def divide_local(self, signals: FloatArray) -> FloatArray:
        """Return white signals (3, k, n) that act at few samples, divided."""
        return np.asarray(signals / self.values[:, None], np.float64)

    def multiply_spectra(self, spectra: FloatArray) -> FloatArray:
        """Return the inverse of `divide_spectra` for all axes, shape (..., 3, n)."""
        return self._scale(spectra, self.values)

    def multiply_signals(self, signals: FloatArray) -> FloatArray:
        """Return white signals (3, n) before their division; see `multiply_spectra`."""
        spectra = self.multiply_spectra(orthonormal_dct(signals))
        return np.asarray(idct(spectra, axis=-1, norm="ortho"), np.float64)

    def _scale(self, spectra: FloatArray, factor: FloatArray) -> FloatArray:
        signals = idct(self._without_constant(spectra), axis=-1, norm="ortho")
        return self._with_constant(orthonormal_dct(signals * factor), spectra)

    def _without_constant(self, spectra: FloatArray) -> FloatArray:
        if not self.keeps_constant:
            return spectra
        work = spectra.copy()
        work[..., 0] = 0.0
        return work

    def _with_constant(self, scaled: FloatArray, spectra: FloatArray) -> FloatArray:
        if self.keeps_constant:
            scaled[..., 0] = spectra[..., 0]
        return scaled


def mean_white_power(parts: Sequence[RelativeStd | None]) -> FloatArray | None:
    """Return the mean variance of a series' noise relative to that at rest, (3,); None: 1."""
    means = [np.mean(part.white_variance, axis=1) for part in parts if part is not None]
    return np.mean(means, axis=0) if means else None


def orthonormal_dct(signals: FloatArray) -> FloatArray:
    """Return the orthonormal DCT along the last axis."""
    return np.asarray(dct(signals, axis=-1, norm="ortho"), dtype=np.float64)
