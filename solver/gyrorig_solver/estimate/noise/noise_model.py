"""The noise density of a gyroscope over frequency, with levels estimated from the residual.

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

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
from scipy.fft import dct

from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.low_pass import power_gain

ALIAS_ORDER = 4
SPECTRUM_BINS = 60
# Priors of the levels' logarithms, and limits of Fisher scoring.
WHITE_PRIOR_LOG_STD, PRIOR_LOG_STD = 10.0, 3.0
LEVEL_ITERATIONS = 50
LEVEL_TOLERANCE = 1e-3
MAX_LOG_STEP, MAX_LOG_LEVEL = 3.0, 30.0


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
    incomplete: FloatArray = field(default_factory=lambda: np.zeros(5))

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
            incomplete=np.zeros(5),
        )

    def density(self, frequency_hz: FloatArray) -> FloatArray:
        """Return S(f) per axis, shape (k, 3)."""
        unit_density = unit_densities(frequency_hz, self.sampling)
        return np.asarray(unit_density.T @ self.levels.T + self.flat_density)

    def density_of_bins(self, spectrum: "Spectrum") -> FloatArray:
        """Return the expected density in a spectrum's bins, shape (k, 3)."""
        if spectrum.unit_density is None:
            return self.density_with(spectrum.frequency_hz, spectrum.white_power)
        unit_density = spectrum.unit_densities(self.sampling)
        levels = np.column_stack([self.levels, self.floor_and_rounding])
        density = unit_density.T @ levels.T
        if spectrum.white_power is not None:
            white = unit_density[0][:, None] * self.levels[:, 0]
            density += white * (spectrum.white_power - 1.0)
        return np.asarray(density, dtype=np.float64)

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


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """The residual's density in bins of nearly equal log width."""

    frequency_hz: FloatArray  # (k,)
    density: FloatArray  # (k, 3)
    count: FloatArray  # (k,), coefficients in each bin
    white_power: FloatArray | None = None  # (k, 3), white noise relative to that at rest; None: 1
    # (5, k), expected for each process at unit level and for equal noise at all frequencies; None:
    # no sample is missing
    unit_density: FloatArray | None = None

    def unit_densities(self, sampling: Sampling) -> FloatArray:
        """Return the density of N, B, K, D and of equal noise at all frequencies, (5, k)."""
        if self.unit_density is not None:
            return self.unit_density
        ones = np.ones_like(self.frequency_hz)
        return np.vstack([unit_densities(self.frequency_hz, sampling), ones])


@dataclass(frozen=True, slots=True, eq=False)
class Periodogram:
    """The residual's power at single frequencies."""

    frequency_hz: FloatArray  # (m,)
    density: FloatArray  # (m, 3), one-sided
    white_power: FloatArray | None = None  # (3,), white noise relative to that at rest; None: 1
    unit_density: FloatArray | None = None  # (5, m), see `Spectrum`; None: no sample is missing

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
            unit_density: of `expected_densities`, shape (5, n - 1); None: no sample is missing.
        """
        n = residual.shape[0]
        spectrum = dct(residual, axis=0, norm="ortho")[1:]
        return cls(
            dct_frequencies_hz(n, rate_hz)[1:],
            spectrum**2 * (2.0 / rate_hz / max(used_share, 1e-3)),
            white_power,
            unit_density,
        )

    @property
    def size(self) -> int:
        """The number of frequencies."""
        return int(self.frequency_hz.size)

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
        sampling: of the residual; None: no sample is missing.
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
                    np.vstack([unit_densities(piece.frequency_hz, sampling), np.ones(piece.size)])
                    if piece.unit_density is None
                    else piece.unit_density
                    for piece in pieces
                ],
                axis=1,
            ).T
        ).T
    return Spectrum(centre, bin_means(power), count[occupied], white_power, unit_density)


def fit_noise_levels(
    spectrum: Spectrum, sampling: Sampling, initial_levels: FloatArray | None = None
) -> NoiseModel:
    """Estimate the levels by Whittle's likelihood: sum of count x (log S + P/S)/2 per bin.

    Weak log-normal priors (a factor of e^3) keep processes that a short recording does not show
    near their usual levels, so that no level becomes zero or infinite.

    Args:
        spectrum: of the residual.
        sampling: of the residual.
        initial_levels: (3, 4), from a previous fit.
    """
    *processes, flat = spectrum.unit_densities(sampling)
    unit_density = np.array(processes)
    quantum = quantum_density(sampling)
    active = np.flatnonzero(unit_density.max(axis=1) > 0.0)
    levels = np.zeros((3, 4))
    upper_half = spectrum.frequency_hz > np.median(spectrum.frequency_hz)
    for axis in range(3):
        power = spectrum.density[:, axis]
        axis_unit_density = unit_density
        if spectrum.white_power is not None:
            axis_unit_density = unit_density.copy()
            axis_unit_density[0] *= spectrum.white_power[:, axis]
        white = float(
            np.median(power[upper_half] / np.maximum(axis_unit_density[0][upper_half], 1e-6))
        )
        nominal = nominal_levels(max(white, quantum * 1e-3, 1e-30))
        start = (
            nominal if initial_levels is None else np.maximum(initial_levels[axis], nominal * 1e-12)
        )
        axis_levels = fit_axis_levels(
            power,
            spectrum.count,
            axis_unit_density[active],
            quantum * flat,
            nominal[active],
            start[active],
        )
        levels[axis, active] = axis_levels
    return NoiseModel(levels, sampling)


def nominal_levels(white: float) -> FloatArray:
    """Return N^2, B^2, K^2, D^2 of an ordinary MEMS part with that N^2, shape (4,).

    The processes equal the white noise (L3G4200D: 0.03 dps/sqrt(Hz), 4 mdps, 0.3 mdps/sqrt(s)) at
    0.01 Hz for flicker, at 0.003 Hz for the random walk, and at 30 Hz for a differentiated
    attitude.
    """
    return white * np.array(
        [1.0, np.pi * 0.01, (2 * np.pi * 0.003) ** 2 / 2.0, (2 * np.pi * 30.0) ** -2]
    )


def fit_axis_levels(
    power: FloatArray,
    count: FloatArray,
    unit_density: FloatArray,
    quantum: FloatArray,
    nominal: FloatArray,
    start: FloatArray,
) -> FloatArray:
    """Return the levels of one axis by Fisher scoring in their logarithms.

    Args:
        power: density in each bin, shape (k,).
        count: coefficients in each bin, shape (k,).
        unit_density: of the active processes, shape (a, k).
        quantum: density of the quantisation error in each bin, shape (k,).
        nominal: centre of the priors, shape (a,).
        start: initial levels, shape (a,).
    """
    prior_log_std = np.where(np.arange(nominal.size) == 0, WHITE_PRIOR_LOG_STD, PRIOR_LOG_STD)

    def cost(x: FloatArray) -> float:
        total = (nominal * np.exp(x)) @ unit_density + quantum
        return 0.5 * float(
            count @ (np.log(total) + power / total) + np.sum((x / prior_log_std) ** 2)
        )

    x = np.clip(np.log(start / nominal), -MAX_LOG_LEVEL, MAX_LOG_LEVEL)
    current_cost = cost(x)
    for _ in range(LEVEL_ITERATIONS):
        contributions = (nominal * np.exp(x))[:, None] * unit_density
        total = contributions.sum(axis=0) + quantum
        gradient = (
            0.5 * (contributions @ (count * (total - power) / total**2)) + x / prior_log_std**2
        )
        hessian = 0.5 * (contributions * (count / total**2)) @ contributions.T + np.diag(
            prior_log_std**-2.0
        )
        step = np.clip(-np.linalg.solve(hessian, gradient), -MAX_LOG_STEP, MAX_LOG_STEP)
        new_cost = cost(x + step)
        while new_cost > current_cost and np.abs(step).max() > LEVEL_TOLERANCE:
            step = step / 2.0
            new_cost = cost(x + step)
        x, current_cost = np.clip(x + step, -MAX_LOG_LEVEL, MAX_LOG_LEVEL), new_cost
        if np.abs(step).max() < LEVEL_TOLERANCE:
            break
    return np.asarray(nominal * np.exp(x), dtype=np.float64)
