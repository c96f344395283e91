"""The noise of a recording in which blocks can be missing.

The density of the received blocks is that of all blocks, integrated over the missing ones. With the
covariance S of all blocks, which is diagonal in the DCT, and the rows m of the missing blocks

    log |S_received| = log |S| + log |(S^-1)_mm|

and the whitened power of the received blocks is that of all blocks, with the most likely values in
the missing ones (see `estimate.linear.gap_fill`). A zero in a missing block would have the power of
noise that the low-pass of the sensor makes impossible: at 400 Hz behind 60 Hz, with 10 % of the
blocks missing, the power was 1.5 times the right one. The determinant is the product of the
conditional variances of the missing rows. Those that precede a row closely are sufficient: with 16
of them, the logarithm has an error of up to 1.1 for 2000 received blocks.

What to use when: `ReceivedNoise.of` for a recording; `ReceivedDensity.of` if unknown signals
add to its noise; `estimate_noise` for simulated sessions.

Source: C. Rasmussen, C. Williams, Gaussian Processes for Machine Learning, MIT Press 2006, appendix
A.2 and A.3; A. Vecchia, Journal of the Royal Statistical Society B 50 (1988), for the conditions.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from scipy.fft import dct, idct, irfft
from scipy.linalg import cho_factor, cho_solve

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.estimate import (
    NoiseModel,
    Periodogram,
    Sampling,
    bin_spectrum,
    fit_noise_levels,
)
from gyrorig_solver.estimate.linear.gap_fill import GapFill, gap_fill
from gyrorig_solver.estimate.noise.missing_samples import expected_densities, incomplete_densities

PRECEDING = 16  # missing rows that condition the next missing one
BATCH = 2048  # missing rows whose conditional variances are computed together


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedNoise:
    """The noise of a simulation."""

    model: NoiseModel
    bias_std_rad_s: FloatArray  # (3,), scatter of a session's mean


def estimate_noise(
    noises: Sequence[FloatArray], used_samples: Sequence[BoolArray], sampling: Sampling
) -> SimulatedNoise:
    """Return the noise of a simulation from pure noise of several sessions.

    Args:
        noises: of each session, zero where no sample is used, (n, 3).
        used_samples: which samples of each block are used, (n, m) for each session.
        sampling: of the blocks.
    """
    shares = [used.any(axis=1).mean() for used in used_samples]
    pieces = [
        Periodogram.of(
            noise,
            sampling.rate_hz,
            float(share),
            unit_density=expected_densities(used, sampling),
        )
        for noise, used, share in zip(noises, used_samples, shares, strict=True)
    ]
    model = fit_noise_levels(bin_spectrum(pieces, sampling), sampling)
    means = np.stack([noise.mean(axis=0) / s for noise, s in zip(noises, shares, strict=True)])
    return SimulatedNoise(model, np.sqrt((means**2).mean(axis=0)))


@dataclass(frozen=True, eq=False)
class ReceivedNoise:
    """The noise of the received blocks of one recording. Signals are zero in missing blocks."""

    used_samples: BoolArray  # (n, m)
    used: BoolArray  # (n,), blocks with a used sample
    model: NoiseModel
    variance: FloatArray  # (3, n), of the DCT of all blocks
    fill: GapFill | None  # None: nothing is missing

    @classmethod
    def of(cls, noise: SimulatedNoise, used_samples: BoolArray) -> Self:
        """Return the noise of a recording.

        Args:
            noise: of the simulation.
            used_samples: which samples of each block are used, (n, m).
        """
        used = np.asarray(used_samples.any(axis=1), dtype=np.bool_)
        incomplete = incomplete_densities(used_samples, noise.model.sampling)
        model = replace(noise.model, incomplete=incomplete)
        variance = model.dct_variance(used.size).T
        return cls(used_samples, used, model, variance, gap_fill(used, model))

    def whiten(self, signals: FloatArray) -> FloatArray:
        """Return the DCT of signals (..., 3, n) in units of its standard deviation."""
        return self.spectrum(signals) / np.sqrt(self.variance)

    def spectrum(self, signals: FloatArray) -> FloatArray:
        """Return the DCT of signals (..., n), with their most likely values in missing blocks."""
        filled = signals if self.fill is None else self.fill.fill(signals)
        return np.asarray(dct(filled, axis=-1, norm="ortho"), dtype=np.float64)

    @cached_property
    def log_normalisation(self) -> float:
        """The log density of received blocks that have no noise, nats."""
        log_determinant = float(np.log(self.variance).sum())
        log_determinant += sum(_missing_log_determinant(self.used, row) for row in self.variance)
        return -0.5 * (3.0 * float(self.used.sum()) * float(np.log(2.0 * np.pi)) + log_determinant)

    def completed(self, residual: FloatArray) -> FloatArray:
        """Return a residual (n, 3) with the spectrum that it would have with all samples, (n, 3).

        Missing samples reduce its power and spread it over the frequencies. Both are corrected for
        the noise of the model.
        """
        model = self.model
        unit_density = expected_densities(self.used_samples, model.sampling)
        if unit_density is None:
            return residual
        levels = np.column_stack([model.levels, model.floor_and_rounding])
        expected = levels @ unit_density * self.used.mean()  # (3, n - 1)
        complete = replace(model, incomplete=np.zeros_like(model.incomplete))
        variance = complete.dct_variance(self.used.size)[1:] * 2.0 / model.sampling.rate_hz
        spectrum = dct(residual, axis=0, norm="ortho")
        spectrum[1:] *= np.sqrt(variance / expected.T)
        return np.asarray(idct(spectrum, axis=0, norm="ortho"), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class ReceivedDensity:
    """The density of noise and of signals with independent normal factors, which are unknown."""

    noise: ReceivedNoise
    std: FloatArray  # (j,), of the factors
    whitened: FloatArray  # (j, 3 n), the signals
    factor: tuple[FloatArray, bool]  # of the covariance of the factors, for `cho_solve`

    @classmethod
    def of(cls, noise: ReceivedNoise, signals: FloatArray, std: FloatArray) -> Self:
        """Return the density of noise and signals.

        Args:
            noise: of the recording.
            signals: shape (j, 3, n).
            std: of their factors, shape (j,).
        """
        whitened = noise.whiten(signals).reshape(len(signals), -1)
        scaled = whitened * std[:, None]
        return cls(noise, std, whitened, cho_factor(np.eye(len(std)) + scaled @ scaled.T))

    @property
    def mean(self) -> float:
        """The mean of the log density, nats. It depends on which blocks are received."""
        log_determinant = float(np.log(np.diag(self.factor[0])).sum())
        return self.noise.log_normalisation - log_determinant - 0.5 * self._freedom

    def excess(self, residual: FloatArray) -> float:
        """Return the log density of a residual (3, n) minus the mean, nats."""
        white = self.noise.whiten(residual).reshape(-1)
        score = self.std * (self.whitened @ white)
        power = float(white @ white) - float(score @ cho_solve(self.factor, score))
        return 0.5 * (self._freedom - power)

    @property
    def _freedom(self) -> float:
        return 3.0 * float(self.noise.used.sum())


def constant_signals(used: BoolArray) -> FloatArray:
    """Return a constant of each axis, zero in blocks that are not used, shape (3, 3, n)."""
    return np.eye(3)[:, :, None] * used


def _missing_log_determinant(used: BoolArray, variance: FloatArray) -> float:
    """Return log |(S^-1)_mm| of the missing rows m.

    Args:
        used: which rows are not missing, (n,).
        variance: of the DCT of all rows, (n,); the eigenvalues of S.
    """
    rows = np.flatnonzero(~used)
    inverse = irfft(np.append(1.0 / variance, 1.0 / variance[-1]))[: used.size]
    count = min(PRECEDING, max(rows.size - 1, 1))
    total = 0.0
    for begin in range(0, rows.size, BATCH):
        places = np.arange(begin, min(begin + BATCH, rows.size))
        before = places[:, None] - np.arange(1, count + 1)
        exists = before >= 0
        preceding = rows[np.maximum(before, 0)]
        between = inverse[np.abs(preceding[:, :, None] - preceding[:, None, :])]
        between = np.where(exists[:, :, None] & exists[:, None, :], between, np.eye(count))
        to_row = np.where(exists, inverse[np.abs(preceding - rows[places, None])], 0.0)
        weights = np.linalg.solve(between, to_row[:, :, None])[:, :, 0]
        total += float(np.log(inverse[0] - (weights * to_row).sum(axis=1)).sum())
    return total
