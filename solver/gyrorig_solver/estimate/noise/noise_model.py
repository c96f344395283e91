"""The noise density of a gyroscope over frequency.

One-sided density of one axis, (rad/s)^2/Hz:

    S(f) = N^2 W(f) + B^2/(pi f) + 2 K^2/(2 pi f)^2 + D^2 (2 pi f)^2 + F + q

N is the noise density as in data sheets (rms = N sqrt(bandwidth)), W the sensor's low-pass
including all aliases of sampling and block means, B the bias instability (Allan floor 0.664 B) and
K the rate random walk (variance grows as K^2 t). B and K are defined as in IEEE Std 952, annex C,
whose densities are two-sided. D is the white angle noise of a differentiated attitude reference, F
a noise floor that arises after the low-pass (see `noise_floor`), and q the quantisation density
LSB^2/6 over the sample rate. In the orthonormal DCT-II of a uniform series at rate r, coefficient k
belongs to f = k r/(2n) and has variance S(f) r/2. The transform makes a random walk nearly
diagonal, so weighting by 1/variance whitens it.
"""

from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.low_pass import power_gain

ALIAS_ORDER = 4
PROCESSES = 5  # N, B, K, D, and noise that is equal at all frequencies


@dataclass(frozen=True, slots=True)
class Sampling:
    """The sampling of the uniform series."""

    rate_hz: float  # of the series (of block means)
    samples_per_block: int  # samples per block mean
    bandwidth_hz: float | None
    quantum_rad_s: float
    differentiated: bool  # the reference is a differentiated attitude
    has_several_series: bool = False  # with one bias: a reset or a long gap separates them


def dct_frequencies_hz(n: int, rate_hz: float) -> FloatArray:
    """Return the frequency of each DCT coefficient of a series of n, shape (n,)."""
    return np.asarray(np.arange(n) * rate_hz / (2.0 * n), dtype=np.float64)


def unit_densities(frequency_hz: FloatArray, sampling: Sampling) -> FloatArray:
    """Return the density of each process at unit level, shape (4, k): N, B, K, D."""
    omega = 2.0 * np.pi * frequency_hz
    # The constant has no 1/f part, because the bias is the mean over the recording.
    inverse = np.divide(1.0, omega, out=np.zeros_like(omega), where=omega > 0.0)
    return np.stack(
        [
            aliased_low_pass(frequency_hz, sampling),
            2.0 * inverse,
            2.0 * inverse**2,
            omega**2 * float(sampling.differentiated),
        ]
    )


def process_densities(frequency_hz: FloatArray, sampling: Sampling) -> FloatArray:
    """Return `unit_densities`, and equal noise at all frequencies, shape (5, k)."""
    return np.vstack([unit_densities(frequency_hz, sampling), np.ones_like(frequency_hz)])


def aliased_low_pass(frequency_hz: FloatArray, sampling: Sampling) -> FloatArray:
    """Return W(f): |H|^2 of the low-pass, aliased by sampling and averaged over blocks."""
    raw_hz = sampling.rate_hz * sampling.samples_per_block
    total = np.zeros_like(frequency_hz)
    for fold in range(sampling.samples_per_block):
        f = frequency_hz + fold * sampling.rate_hz
        raw = np.zeros_like(f)
        for alias in range(-ALIAS_ORDER, ALIAS_ORDER + 1):
            raw += power_gain(np.abs(f + alias * raw_hz), sampling.bandwidth_hz)
        if sampling.bandwidth_hz is None:
            raw = np.ones_like(f)
        mean = np.ones_like(f)
        if sampling.samples_per_block > 1:
            mean = (np.sinc(sampling.samples_per_block * f / raw_hz) / np.sinc(f / raw_hz)) ** 2
        total += raw * mean
    return total


def quantum_density(sampling: Sampling) -> float:
    """Return q, the density of the quantisation error after block means."""
    raw_hz = sampling.rate_hz * sampling.samples_per_block
    return sampling.quantum_rad_s**2 / 6.0 / raw_hz


@dataclass(frozen=True, slots=True, eq=False)
class NoiseModel:
    """The levels of the four processes per axis, and their density."""

    levels: FloatArray  # (3, 4), squares: N^2, B^2, K^2, D^2
    sampling: Sampling
    floor: FloatArray = field(default_factory=lambda: np.zeros(3))  # (3,), F
    # (5,), density that blocks with missing samples add by N, B, K, D and F + q at unit level
    incomplete: FloatArray = field(default_factory=lambda: np.zeros(PROCESSES))

    @property
    def flat_density(self) -> FloatArray:
        """The density that is equal at all frequencies, shape (3,).

        It is F + q, and what blocks with missing samples add.
        """
        added = np.column_stack([self.levels, self.floor_and_rounding]) @ self.incomplete
        return np.asarray(self.floor_and_rounding + added, dtype=np.float64)

    @property
    def floor_and_rounding(self) -> FloatArray:
        """F + q, shape (3,)."""
        return self.floor + quantum_density(self.sampling)

    def with_flat_density(self, density: FloatArray) -> "NoiseModel":
        """Return the noise with another density that is equal at all frequencies, shape (3,)."""
        return replace(
            self,
            sampling=replace(self.sampling, quantum_rad_s=0.0),
            floor=density,
            incomplete=np.zeros(PROCESSES),
        )

    def density(self, frequency_hz: FloatArray) -> FloatArray:
        """Return S(f) per axis, shape (k, 3)."""
        unit_density = unit_densities(frequency_hz, self.sampling)
        return np.asarray(unit_density.T @ self.levels.T + self.flat_density)

    def density_with(self, frequency_hz: FloatArray, white_power: FloatArray | None) -> FloatArray:
        """Return S(f) per axis with more white noise than at rest, shape (k, 3).

        Args:
            frequency_hz: shape (k,).
            white_power: relative to that at rest, shape (3,) or (k, 3); None: 1.
        """
        density = self.density(frequency_hz)
        if white_power is None:
            return density
        white = aliased_low_pass(frequency_hz, self.sampling)[:, None] * self.levels[:, 0]
        return np.asarray(density + white * (white_power - 1.0), dtype=np.float64)

    def dct_variance(self, n: int) -> FloatArray:
        """Return the variance of each DCT coefficient of a series of n, shape (n, 3)."""
        unit_density = _dct_unit_densities(n, self.sampling)
        density = unit_density.T @ self.levels.T + self.flat_density
        return np.asarray(density * self.sampling.rate_hz / 2.0, dtype=np.float64)


@lru_cache(maxsize=16)
def _dct_unit_densities(n: int, sampling: Sampling) -> FloatArray:
    """Return the unit densities at a series' DCT frequencies, cached for all iterations."""
    frequency_hz = dct_frequencies_hz(n, sampling.rate_hz)
    if sampling.has_several_series:
        # The constants of the series differ by the slow noise between them. Half of the lowest
        # frequency of a series represents it.
        frequency_hz[0] = 0.5 * frequency_hz[1] if n > 1 else sampling.rate_hz / 4.0
    densities = unit_densities(frequency_hz, sampling)
    densities.flags.writeable = False
    return densities
