"""The noise of a gyroscope as a density over frequency, with levels found in the residual.

One-sided density of one axis, (rad/s)^2/Hz:

    S(f) = N^2 W(f) + B^2/(pi f) + 2 K^2/(2 pi f)^2 + D^2 (2 pi f)^2 + q

N is the noise density as data sheets give it (rms = N sqrt(bandwidth)), W the sensor's
low-pass with everything that sampling and block means fold into it, B the bias
instability (Allan floor 0.664 B) and K the rate random walk (variance grows as K^2 t),
both as in IEEE Std 952, annex C, whose densities are two-sided; D the white angle noise
of a differentiated attitude reference, q the quantum's LSB^2/6 over the sample rate.
In the orthonormal DCT-II of a uniform series at rate r, coefficient k belongs to
f = k r/(2n) and has variance S(f) r/2; the transform makes a random walk nearly
diagonal, so weighing by 1/variance whitens it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.fft import dct

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.low_pass import power_gain

ALIASES = 4
# Priors of the levels' logarithms, and how Fisher scoring goes.
WHITE_SPREAD, SPREAD = 10.0, 3.0
LEVEL_ROUNDS = 50
LEVEL_TOLERANCE = 1e-3
LONGEST, FARTHEST = 3.0, 30.0


@dataclass(frozen=True, slots=True)
class Sampling:
    """How the rates came to be a uniform series."""

    rate_hz: float  # of the series (of block means)
    block: int  # samples in one mean
    bandwidth_hz: float | None
    quantum_rad_s: float
    differentiated: bool  # True where the reference is a differentiated attitude


def frequencies(n: int, rate_hz: float) -> FloatArray:
    """Return the frequency of each DCT coefficient of a series of n, shape (n,)."""
    return np.asarray(np.arange(n) * rate_hz / (2.0 * n), dtype=np.float64)


def shapes(frequency_hz: FloatArray, sampling: Sampling) -> FloatArray:
    """Return the density of each process at unit level, shape (4, k): N, B, K, D."""
    omega = 2.0 * np.pi * frequency_hz
    # What wanders has no part in the constant: the bias is the mean over the recording.
    inverse = np.divide(1.0, omega, out=np.zeros_like(omega), where=omega > 0.0)
    return np.stack(
        [
            folded_low_pass(frequency_hz, sampling),
            2.0 * inverse,
            2.0 * inverse**2,
            omega**2 * float(sampling.differentiated),
        ]
    )


def folded_low_pass(frequency_hz: FloatArray, sampling: Sampling) -> FloatArray:
    """Return W(f): |H|^2 of the low-pass, aliased by sampling, averaged over blocks."""
    raw_hz = sampling.rate_hz * sampling.block
    total = np.zeros_like(frequency_hz)
    for fold in range(sampling.block):
        f = frequency_hz + fold * sampling.rate_hz
        raw = np.zeros_like(f)
        for alias in range(-ALIASES, ALIASES + 1):
            raw += power_gain(np.abs(f + alias * raw_hz), sampling.bandwidth_hz)
        if sampling.bandwidth_hz is None:
            raw = np.ones_like(f)
        mean = np.ones_like(f)
        if sampling.block > 1:
            mean = (np.sinc(sampling.block * f / raw_hz) / np.sinc(f / raw_hz)) ** 2
        total += raw * mean
    return total


def quantum_density(sampling: Sampling) -> float:
    """Return q, the density of a uniform quantum's error after block means."""
    raw_hz = sampling.rate_hz * sampling.block
    return sampling.quantum_rad_s**2 / 6.0 / raw_hz


@dataclass(frozen=True, slots=True, eq=False)
class NoiseModel:
    """Levels of the four processes for each axis, and their density."""

    levels: FloatArray  # (3, 4), squares: N^2, B^2, K^2, D^2
    sampling: Sampling

    def density(self, frequency_hz: FloatArray) -> FloatArray:
        """Return S(f) for each axis, shape (k, 3)."""
        shape = shapes(frequency_hz, self.sampling)
        return np.asarray(shape.T @ self.levels.T + quantum_density(self.sampling))

    def variance(self, n: int) -> FloatArray:
        """Return the variance of each DCT coefficient of a series of n, shape (n, 3)."""
        shape = _series_shapes(n, self.sampling)
        density = shape.T @ self.levels.T + quantum_density(self.sampling)
        return np.asarray(density * self.sampling.rate_hz / 2.0, dtype=np.float64)


@lru_cache(maxsize=16)
def _series_shapes(n: int, sampling: Sampling) -> FloatArray:
    """Return the shapes at a series' own frequencies; every round asks for the same."""
    found = shapes(frequencies(n, sampling.rate_hz), sampling)
    found.flags.writeable = False
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """Residual density in bins of about equal log width."""

    frequency_hz: FloatArray  # (k,)
    density: FloatArray  # (k, 3)
    count: FloatArray  # (k,), coefficients in each bin


@dataclass(frozen=True, slots=True, eq=False)
class Periodogram:
    """Power of a stretch of residual at single frequencies."""

    frequency_hz: FloatArray  # (m,)
    density: FloatArray  # (m, 3), one-sided

    @classmethod
    def of(cls, residual: FloatArray, rate_hz: float, share: float = 1.0) -> "Periodogram":
        """Return the power of a uniform residual (n, 3), without its constant.

        `share`: of the blocks that are used; the missing ones' power is given back.
        """
        n = residual.shape[0]
        spectrum = dct(residual, axis=0, norm="ortho")[1:]
        return cls(frequencies(n, rate_hz)[1:], spectrum**2 * (2.0 / rate_hz / max(share, 1e-3)))

    def between(self, low_hz: float, high_hz: float) -> "Periodogram":
        """Return the part with low <= f < high."""
        inside = (self.frequency_hz >= low_hz) & (self.frequency_hz < high_hz)
        return Periodogram(self.frequency_hz[inside], self.density[inside])


def binned(pieces: Sequence[Periodogram], bins: int = 60) -> Spectrum:
    """Return the residual's density over all stretches, in at most `bins` bins."""
    f = np.concatenate([piece.frequency_hz for piece in pieces])
    power = np.concatenate([piece.density for piece in pieces])
    edges = np.geomspace(f.min() * 0.999, f.max() * 1.001, bins + 1)
    which = np.digitize(f, edges) - 1
    count = np.bincount(which, minlength=bins).astype(np.float64)
    some = count > 0
    centre = np.exp(np.bincount(which, np.log(f), bins)[some] / count[some])
    mean = np.stack(
        [np.bincount(which, power[:, i], bins)[some] / count[some] for i in range(3)], axis=1
    )
    return Spectrum(centre, mean, count[some])


def fit_levels(
    spectrum: Spectrum, sampling: Sampling, before: FloatArray | None = None
) -> NoiseModel:
    """Find the levels by Whittle's likelihood: sum of count x (log S + P/S)/2 per bin.

    Weak log-normal priors (a factor of e^3) hold the processes that a short recording
    cannot show where an ordinary part has them, so that no level runs to zero or away.

    Args:
        spectrum: of the residual.
        sampling: of the residual.
        before: levels (3, 4) found a moment ago, to begin from.
    """
    shape = shapes(spectrum.frequency_hz, sampling)
    quantum = quantum_density(sampling)
    active = np.flatnonzero(shape.max(axis=1) > 0.0)
    levels = np.zeros((3, 4))
    high = spectrum.frequency_hz > np.median(spectrum.frequency_hz)
    for axis in range(3):
        power = spectrum.density[:, axis]
        white = float(np.median(power[high] / np.maximum(shape[0][high], 1e-6)))
        usual = ordinary_levels(max(white, quantum * 1e-3, 1e-30))
        begin = usual if before is None else np.maximum(before[axis], usual * 1e-12)
        found = _fit_axis(
            power, spectrum.count, shape[active], quantum, usual[active], begin[active]
        )
        levels[axis, active] = found
    return NoiseModel(levels, sampling)


def ordinary_levels(white: float) -> FloatArray:
    """Return N^2, B^2, K^2, D^2 of an ordinary MEMS part with that N^2, shape (4,).

    The processes meet the white noise (L3G4200D: 0.03 dps/sqrt(Hz), 4 mdps,
    0.3 mdps/sqrt(s)) at 0.01 Hz for flicker and 0.003 Hz for the random walk; a
    differentiated attitude at 30 Hz.
    """
    return white * np.array(
        [1.0, np.pi * 0.01, (2 * np.pi * 0.003) ** 2 / 2.0, (2 * np.pi * 30.0) ** -2]
    )


def _fit_axis(
    power: FloatArray,
    count: FloatArray,
    shape: FloatArray,
    quantum: float,
    usual: FloatArray,
    begin: FloatArray,
) -> FloatArray:
    """Return the levels of one axis by Fisher scoring in their logarithms.

    Args:
        power: density in each bin, shape (k,).
        count: coefficients in each bin, shape (k,).
        shape: of the active processes, shape (a, k).
        quantum: its density.
        usual: the priors' middle, shape (a,).
        begin: where to begin, shape (a,).
    """
    spread = np.where(np.arange(usual.size) == 0, WHITE_SPREAD, SPREAD)

    def cost(x: FloatArray) -> float:
        total = (usual * np.exp(x)) @ shape + quantum
        return 0.5 * float(count @ (np.log(total) + power / total) + np.sum((x / spread) ** 2))

    x = np.clip(np.log(begin / usual), -FARTHEST, FARTHEST)
    now = cost(x)
    for _ in range(LEVEL_ROUNDS):
        part = (usual * np.exp(x))[:, None] * shape
        total = part.sum(axis=0) + quantum
        slope = 0.5 * (part @ (count * (total - power) / total**2)) + x / spread**2
        bend = 0.5 * (part * (count / total**2)) @ part.T + np.diag(spread**-2.0)
        step = np.clip(-np.linalg.solve(bend, slope), -LONGEST, LONGEST)
        after = cost(x + step)
        while after > now and np.abs(step).max() > LEVEL_TOLERANCE:
            step = step / 2.0
            after = cost(x + step)
        x, now = np.clip(x + step, -FARTHEST, FARTHEST), after
        if np.abs(step).max() < LEVEL_TOLERANCE:
            break
    return np.asarray(usual * np.exp(x), dtype=np.float64)
