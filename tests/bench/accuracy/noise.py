"""The noise of a simulated gyroscope: its processes, their samples, their covariance.

White noise enters before the sensor's low-pass; flicker and a random walk of the bias are
added behind it. One-sided densities: N^2 |H|^2, B^2/(pi f), 2 K^2/(2 pi f)^2 (IEEE Std 952,
annex C, has them two-sided).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct, idct, irfft, next_fast_len, rfft, rfftfreq

FloatArray = NDArray[np.float64]
ALIASES = 6
ACCURATE, MOST_ROUNDS, TINY = 1e-5, 60, 1e-300  # of the conjugate gradients


def low_pass(frequency_hz: FloatArray, bandwidth_hz: float) -> NDArray[np.complex128]:
    """Return H of the analogue second-order Butterworth."""
    s = 1j * frequency_hz / bandwidth_hz
    return np.asarray(1.0 / (s**2 + np.sqrt(2.0) * s + 1.0), dtype=np.complex128)


@dataclass(frozen=True, slots=True)
class Levels:
    """One axis' noise."""

    white: float  # N, rad/s/sqrt(Hz), one-sided
    flicker: float  # B, rad/s
    walk: float  # K, rad/s/sqrt(s)
    quantum_rad_s: float


@dataclass(frozen=True, slots=True, eq=False)
class Covariance:
    """The covariance of one axis' samples about the mean of the bias, as an operator.

    The bias is what the flicker and the walk are about on average over the recording: its
    mean is a parameter, so both have their mean over the samples taken out.
    """

    levels: Levels
    bandwidth_hz: float
    rate_hz: float
    size: int

    def white_density(self, frequency_hz: FloatArray) -> FloatArray:
        """Return what sampling makes of the filtered white noise, with the quantum's error."""
        total = np.zeros_like(frequency_hz)
        for alias in range(-ALIASES, ALIASES + 1):
            shifted = np.abs(frequency_hz + alias * self.rate_hz)
            total += np.abs(low_pass(shifted, self.bandwidth_hz)) ** 2
        quantum = self.levels.quantum_rad_s**2 / 6.0 / self.rate_hz
        return np.asarray(self.levels.white**2 * total + quantum, dtype=np.float64)

    def density(self, frequency_hz: FloatArray) -> FloatArray:
        """Return the one-sided density of everything; infinite at 0."""
        with np.errstate(divide="ignore"):
            slow = self.levels.flicker**2 / (np.pi * frequency_hz)
            slow = slow + 2.0 * self.levels.walk**2 / (2.0 * np.pi * frequency_hz) ** 2
        return np.asarray(self.white_density(frequency_hz) + slow, dtype=np.float64)

    def times(self, columns: FloatArray) -> FloatArray:
        """Return the covariance times columns, shape (n, k)."""
        n, half, ring = self.size, self.rate_hz / 2.0, ring_size(self.size)
        f = rfftfreq(ring, 1.0 / self.rate_hz)
        white = (self.white_density(f) * half)[:, None]
        flicker = (flicker_density(self.levels.flicker, f) * half)[:, None]
        mean = columns.mean(axis=0)
        centred = columns - mean
        window = rfft(np.ones(n), ring)[:, None]
        of_one = irfft(window[:, 0] * flicker[:, 0], ring)[:n]
        spectrum = rfft(columns, ring, axis=0)
        spectrum = spectrum * (white + flicker) - flicker * window * mean
        product = irfft(spectrum, ring, axis=0)[:n]
        # A walk is the running sum of steps: K^2 dt L L'.
        walk = np.cumsum(np.cumsum(centred[::-1], axis=0)[::-1], axis=0)
        walk *= self.levels.walk**2 / self.rate_hz
        product += walk - walk.mean(axis=0) - of_one @ centred / n
        return np.asarray(product, dtype=np.float64)

    def weigh(self, columns: FloatArray) -> FloatArray:
        """Return the inverse of the covariance times columns, by conjugate gradients."""
        weighed, left = np.zeros_like(columns), columns.copy()
        near = self._nearly(left)
        way = near.copy()
        strength = np.sum(left * near, axis=0)
        goal = ACCURATE**2 * strength
        for _ in range(MOST_ROUNDS):
            if np.all(strength <= goal):
                return weighed
            moved = self.times(way)
            step = strength / np.maximum(np.sum(way * moved, axis=0), TINY)
            weighed += step * way
            left -= step * moved
            near = self._nearly(left)
            before, strength = strength, np.sum(left * near, axis=0)
            way = near + strength / np.maximum(before, TINY) * way
        raise ArithmeticError(f"no inverse of the covariance after {MOST_ROUNDS} rounds")

    def weigh_short(self, columns: FloatArray) -> FloatArray:
        """Return nearly the same for columns that are zero near both ends, shape (m, k)."""
        m = next_fast_len(columns.shape[0], real=True)
        f = rfftfreq(m, 1.0 / self.rate_hz)
        # The constant of so short a piece stands for all that is slower.
        f[0] = 0.25 * self.rate_hz / m
        weight = 1.0 / (self.density(f) * self.rate_hz / 2.0)
        return _filtered(columns, weight, m)[: columns.shape[0]]

    def _nearly(self, columns: FloatArray) -> FloatArray:
        """The preconditioner: the inverse density over half-cosines, the mean apart."""
        f: FloatArray = np.arange(self.size, dtype=np.float64) * self.rate_hz / (2.0 * self.size)
        density = self.density(f)
        density[0] = self.white_density(f[:1])[0]
        spectrum = dct(columns, axis=0, norm="ortho")
        spectrum /= (density * self.rate_hz / 2.0)[:, None]
        return np.asarray(idct(spectrum, axis=0, norm="ortho"), dtype=np.float64)


def ring_size(size: int) -> int:
    """Return the length of the circle for so many samples."""
    return int(next_fast_len(2 * size, real=True))


def flicker_density(level: float, frequency_hz: FloatArray) -> FloatArray:
    """Return the density of flicker on a circle: nothing slower than the circle."""
    safe = np.where(frequency_hz > 0.0, frequency_hz, np.inf)
    return np.asarray(level**2 / (np.pi * safe), dtype=np.float64)


def wander(levels: Levels, size: int, rate_hz: float, rng: np.random.Generator) -> FloatArray:
    """Return flicker plus a random walk from zero, shape (size,)."""
    ring = ring_size(size)
    f = rfftfreq(ring, 1.0 / rate_hz)
    shape = np.sqrt(flicker_density(levels.flicker, f) * rate_hz / 2.0)
    flicker = irfft(rfft(rng.normal(size=ring)) * shape, ring)[:size]
    steps = rng.normal(scale=levels.walk / np.sqrt(rate_hz), size=size)
    return np.asarray(flicker + np.cumsum(steps), dtype=np.float64)


def _filtered(columns: FloatArray, power: FloatArray, size: int) -> FloatArray:
    spectrum = rfft(columns, size, axis=0)
    spectrum *= power[:, None]
    return np.asarray(irfft(spectrum, size, axis=0), dtype=np.float64)
