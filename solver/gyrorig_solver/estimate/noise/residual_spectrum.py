"""The spectrum of a residual: periodograms of its pieces, joined in bins.

What to use when: `Periodogram.of` for one piece; `bin_spectrum` for all pieces of a recording.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import dct

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.noise.noise_model import (
    NoiseModel,
    Sampling,
    dct_frequencies_hz,
    process_densities,
)

SPECTRUM_BINS = 60


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """The residual's density in bins of nearly equal log width."""

    frequency_hz: FloatArray  # (k,)
    density: FloatArray  # (k, 3)
    count: FloatArray  # (k,), coefficients in each bin
    white_power: FloatArray | None = None  # (k, 3), white noise relative to that at rest; None: 1
    # (5, k), expected with the gaps for each of `process_densities`; None: there are no gaps
    unit_density: FloatArray | None = None

    def unit_densities(self, sampling: Sampling) -> FloatArray:
        """Return the density of N, B, K, D and of equal noise at all frequencies, (5, k)."""
        if self.unit_density is not None:
            return self.unit_density
        return process_densities(self.frequency_hz, sampling)

    def expected_density(self, noise: NoiseModel) -> FloatArray:
        """Return the density of a noise in the bins, shape (k, 3)."""
        if self.unit_density is None:
            return noise.density_with(self.frequency_hz, self.white_power)
        unit_density = self.unit_densities(noise.sampling)
        levels = np.column_stack([noise.levels, noise.floor_and_rounding])
        density = unit_density.T @ levels.T
        if self.white_power is not None:
            white = unit_density[0][:, None] * noise.levels[:, 0]
            density += white * (self.white_power - 1.0)
        return np.asarray(density, dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Periodogram:
    """The residual's power at single frequencies."""

    frequency_hz: FloatArray  # (m,)
    density: FloatArray  # (m, 3), one-sided
    white_power: FloatArray | None = None  # (3,), white noise relative to that at rest; None: 1
    unit_density: FloatArray | None = None  # (5, m), see `Spectrum`

    @classmethod
    def of(
        cls,
        residual: FloatArray,
        rate_hz: float,
        used_share: float = 1.0,
        white_power: FloatArray | None = None,
        unit_density: FloatArray | None = None,
    ) -> "Periodogram":
        """Return the power of a uniform residual (n, 3), without its constant.

        Args:
            residual: zero where unused.
            rate_hz: of the residual.
            used_share: of the blocks; the power is scaled up for the missing blocks.
            white_power: mean white noise of the blocks relative to that at rest, shape (3,).
            unit_density: of `expected_densities`, shape (5, n - 1); None: no gaps.
        """
        n = residual.shape[0]
        spectrum = dct(residual, axis=0, norm="ortho")[1:]
        return cls(
            dct_frequencies_hz(n, rate_hz)[1:],
            spectrum**2 * (2.0 / rate_hz / max(used_share, 1e-3)),
            white_power,
            unit_density,
        )

    def band(self, low_hz: float, high_hz: float) -> "Periodogram":
        """Return the part with low <= f < high."""
        inside = (self.frequency_hz >= low_hz) & (self.frequency_hz < high_hz)
        return Periodogram(
            self.frequency_hz[inside],
            self.density[inside],
            self.white_power,
            None if self.unit_density is None else self.unit_density[:, inside],
        )


def bin_spectrum(pieces: Sequence[Periodogram], sampling: Sampling | None = None) -> Spectrum:
    """Return the residual's density over all segments, in at most `SPECTRUM_BINS` bins.

    Args:
        pieces: of all segments.
        sampling: of the residual; None: a spectrum without gaps.
    """
    f = np.concatenate([piece.frequency_hz for piece in pieces])
    power = np.concatenate([piece.density for piece in pieces])
    edges = np.geomspace(f.min() * 0.999, f.max() * 1.001, SPECTRUM_BINS + 1)
    bin_index = np.digitize(f, edges) - 1
    count = np.bincount(bin_index, minlength=SPECTRUM_BINS).astype(np.float64)
    occupied = count > 0
    centre = np.exp(np.bincount(bin_index, np.log(f), SPECTRUM_BINS)[occupied] / count[occupied])

    def bin_means(values: FloatArray) -> FloatArray:
        sums = [np.bincount(bin_index, column, SPECTRUM_BINS)[occupied] for column in values.T]
        return np.stack([column_sums / count[occupied] for column_sums in sums], axis=1)

    white_power = None
    if any(piece.white_power is not None for piece in pieces):
        unit_power = np.ones(3)
        white_power = bin_means(
            np.concatenate(
                [
                    np.broadcast_to(
                        unit_power if piece.white_power is None else piece.white_power,
                        piece.density.shape,
                    )
                    for piece in pieces
                ]
            )
        )
    unit_density = None
    if sampling is not None and any(piece.unit_density is not None for piece in pieces):
        unit_density = bin_means(
            np.concatenate(
                [
                    process_densities(piece.frequency_hz, sampling)
                    if piece.unit_density is None
                    else piece.unit_density
                    for piece in pieces
                ],
                axis=1,
            ).T
        ).T
    return Spectrum(centre, bin_means(power), count[occupied], white_power, unit_density)
