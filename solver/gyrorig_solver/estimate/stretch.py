"""One series of one recording at a fit, and signals of it in units of the noise.

What to use when: `Stretch.whitened` for signals as the series would show them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.fft import dct, idct

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.estimate.noise import NoiseModel, frequencies
from gyrorig_solver.estimate.whitening import PartModel
from gyrorig_solver.model.terms.scene import Scene

AT_ONCE = 8  # signals: what is worked on stays small, whatever their number


@dataclass(frozen=True, eq=False)
class Stretch:
    """One series of one recording, its parts' state at a fit."""

    session: int
    used: tuple[BoolArray, ...]  # of each part
    scenes: tuple[Scene, ...]
    exact: tuple[Scene, ...]  # the same on the samples' own grid
    models: tuple[PartModel, ...]
    residuals: tuple[FloatArray, ...]  # (n, 3) each
    noise: NoiseModel

    def whitened(self, parts: Sequence[FloatArray]) -> FloatArray:
        """Return signals (k, n, 3) of each part in units of the noise, (k, 3 blocks)."""
        count = len(parts[0])
        if count <= AT_ONCE:
            return self._whitened(parts)
        found = np.empty((count, 3 * sum(used.size for used in self.used)))
        for at in range(0, count, AT_ONCE):
            some = slice(at, at + AT_ONCE)
            found[some] = self._whitened([signal[some] for signal in parts])
        return found

    def _whitened(self, parts: Sequence[FloatArray]) -> FloatArray:
        along = [_by_axis(signal, used) for signal, used in zip(parts, self.used, strict=True)]
        # Many causes act on one axis at a time: what is zero stays zero.
        live = np.any([[np.count_nonzero(row) > 0 for row in one] for one in along], axis=0)
        every = bool(live.all())
        axis = np.flatnonzero(live) % 3
        spectra = [dct(one if every else one[live], axis=-1, norm="ortho") for one in along]
        constants = np.stack([spectrum[:, 0] for spectrum in spectra], axis=-1)
        for k, weight in enumerate(self._weights):
            # Shape (signals, 3, n) where all are there: weights need no copies then.
            shape = (-1, *weight.shape) if every else spectra[k].shape
            spectra[k].reshape(shape)[...] *= weight if every else weight[axis]
        if len(parts) > 1:
            # A long series' parts share its lowest frequencies; see `normal`.
            blocks = sum(used.size for used in self.used)
            rate_hz = self.noise.sampling.rate_hz
            density = self.noise.density(frequencies(blocks, rate_hz)[: len(parts)])
            weighed = dct(constants, axis=-1, norm="ortho")
            weighed /= np.sqrt(density * rate_hz / 2.0).T[axis]
            for k, spectrum in enumerate(spectra):
                spectrum[:, 0] = weighed[:, k]
        signals = []
        for one, spectrum in zip(along, spectra, strict=True):
            white = idct(spectrum, axis=-1, norm="ortho", overwrite_x=True)
            if not every:
                found = np.zeros_like(one)
                found[live] = white
                white = found
            signals.append(white.reshape(len(one) // 3, -1))
        return signals[0] if len(signals) == 1 else np.concatenate(signals, axis=1)

    @cached_property
    def _weights(self) -> tuple[FloatArray, ...]:
        """One over the deviation of each part's coefficients, (3, n) each."""
        return tuple(
            np.ascontiguousarray(self.noise.variance(used.size).T) ** -0.5 for used in self.used
        )


def _by_axis(signal: FloatArray, used: BoolArray) -> FloatArray:
    """Return signals (k, n, 3) as rows (3 k, n), zero where a block is not used."""
    own = signal if used.all() else np.where(used[:, None], signal, 0.0)
    return np.ascontiguousarray(own.transpose(0, 2, 1)).reshape(-1, used.size)
