"""Whitening of a part whose samples have jitter while the stage accelerates.

Jitter adds a density J(t) that is equal at all frequencies; see `jitter_noise`. The samples are
divided into groups of similar J. Those of group g are whitened as if the noise had everywhere the
density S(f) + F_g, with F_g the typical J of the group, and are then divided by the standard
deviation relative to it. F_0 is zero.

What to use when: `JitterStd` in place of a `RelativeStd`.
"""

from dataclasses import dataclass

import numpy as np
from scipy.fft import idct
from scipy.sparse.linalg import LinearOperator, gmres

from gyrorig_solver.data import FloatArray, IntArray, RealArray
from gyrorig_solver.estimate.noise.relative_std import RelativeStd, orthonormal_dct

INVERSION_TOLERANCE = 1e-4  # relative
INVERSION_STEPS = 40


@dataclass(frozen=True, slots=True, eq=False)
class JitterStd(RelativeStd):
    """The standard deviation of one part's noise that contains jitter, relative to that at rest.

    `values` are those of the white noise in motion, as without jitter.
    """

    group: IntArray  # (3, n), g of each sample
    group_values: FloatArray  # (3, n), std relative to that of S(f) + F_g
    spectral_ratios: FloatArray  # (groups, 3, n), square root of S / (S + F_g) of each coefficient
    added_variance: FloatArray  # (3, n), J / S of white noise
    added_sample_variance: FloatArray  # (3, n), variance by jitter / that of a sample at rest

    @property
    def white_variance(self) -> FloatArray:
        """The variance of white noise in the bandwidth, with jitter, relative to rest, (3, n)."""
        return np.asarray(self.values**2 + self.added_variance, np.float64)

    @property
    def sample_values(self) -> FloatArray:
        """The standard deviation of a sample, with jitter, relative to that at rest, (3, n)."""
        return np.asarray(np.sqrt(self.values**2 + self.added_sample_variance), np.float64)

    def divide_spectra(self, spectra: FloatArray, axis: int | IntArray | None = None) -> FloatArray:
        """Return white spectra of samples, each divided as those of its group.

        Args:
            spectra: shape (k, n) of one sensor axis, or (..., 3, n).
            axis: the sensor axis, of all rows or of each; None for all three.
        """
        rows = slice(None) if axis is None else axis
        return self._divide(spectra, self.spectral_ratios[:, rows], rows)

    def divide_adjoint(self, spectra: FloatArray) -> FloatArray:
        """Return the adjoint of `divide_spectra` for all axes, shape (..., 3, n)."""
        signals = idct(self._without_constant(spectra), axis=-1, norm="ortho") / self.group_values
        total = np.zeros_like(signals)
        for k, ratio in enumerate(self.spectral_ratios):
            total += orthonormal_dct(np.where(self.group == k, signals, 0.0)) * ratio
        return self._with_constant(total, spectra)

    def divide_signals(self, signals: RealArray, axis: int) -> RealArray:
        """Return white signals of one sensor axis, (k, n), divided; see `divide_spectra`."""
        spectra = self.divide_spectra(orthonormal_dct(signals.astype(np.float64)), axis)
        divided = np.asarray(idct(spectra, axis=-1, norm="ortho"), signals.dtype)
        return divided

    def divide_local(self, signals: FloatArray) -> FloatArray:
        """Return white signals (3, k, n) that act at few samples, divided."""
        divided = np.empty_like(signals)
        for axis in range(3):
            spectra = orthonormal_dct(signals[axis])
            divided[axis] = self._mix(spectra, self.spectral_ratios[:, axis], axis)
        return divided

    def multiply_spectra(self, spectra: FloatArray) -> FloatArray:
        """Return the inverse of `divide_spectra` for all axes, shape (..., 3, n)."""
        divided = idct(self._without_constant(spectra), axis=-1, norm="ortho")
        signals = np.empty_like(divided)
        for index in np.ndindex(*divided.shape[:-1]):
            signals[index] = self._multiply(divided[index], index[-1])
        return self._with_constant(orthonormal_dct(signals), spectra)

    def _divide(
        self, spectra: FloatArray, ratios: FloatArray, rows: int | slice | IntArray
    ) -> FloatArray:
        mixed = self._mix(self._without_constant(spectra), ratios, rows)
        return self._with_constant(orthonormal_dct(mixed), spectra)

    def _mix(
        self, spectra: FloatArray, ratios: FloatArray, rows: int | slice | IntArray
    ) -> FloatArray:
        """Return signals of spectra, each sample with the whitening of its group."""
        group = self.group[rows]
        mixed = idct(spectra, axis=-1, norm="ortho")
        for k in range(1, len(ratios)):
            if (group == k).any():
                of_group = idct(spectra * ratios[k], axis=-1, norm="ortho")
                mixed = np.where(group == k, of_group, mixed)
        return np.asarray(mixed / self.group_values[rows], np.float64)

    def _multiply(self, divided: FloatArray, axis: int) -> FloatArray:
        """Return the signal (n,) whose division gives this one, of one sensor axis."""
        if not self.group[axis].any():
            return np.asarray(divided * self.group_values[axis], np.float64)
        ratios = self.spectral_ratios[:, axis]
        operator = LinearOperator(
            (divided.size, divided.size),
            matvec=lambda signal: self._mix(orthonormal_dct(signal.ravel()), ratios, axis),
            dtype=np.float64,
        )
        start = divided * self.group_values[axis]
        return np.asarray(
            gmres(
                operator,
                divided,
                x0=start,
                rtol=INVERSION_TOLERANCE,
                restart=INVERSION_STEPS,
                maxiter=1,
            )[0],
            np.float64,
        )
