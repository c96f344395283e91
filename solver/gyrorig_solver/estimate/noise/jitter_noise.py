"""The noise that jitter of the sample times adds while the stage accelerates.

A sample that is late by d differs by d times the slope of the rate, on all axes. d is white with
the standard deviation s. Block means of m samples at a rate r have, in addition to the density
S(f) of the sensor, that of the jitter, of axis i:

    J_i(t) = 2 s^2 a_i(t)^2 / (m r),   a: slope of the rate

It is equal at all frequencies, because jitter arises after the low-pass. s is estimated from the
upper half of the frequencies, which a low-pass leaves nearly free of rates. Causes at the starts
and stops of moves reach these frequencies, too, but only in some blocks of an acceleration. Jitter
acts in all of them. Therefore the solver compares the median over blocks with the mean. The noise
of the axes counts as independent, although one delay acts on all of them.

What to use when: `estimate_jitter_noise` at a converged fit; `JitterNoise.relative_std` for
the weights.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import dct, idct

from gyrorig_solver.data import BoolArray, FloatArray, IntArray
from gyrorig_solver.estimate.noise.jitter_std import JitterStd
from gyrorig_solver.estimate.noise.motion_noise import MotionNoise, MotionResidual
from gyrorig_solver.estimate.noise.noise_model import NoiseModel, dct_frequencies_hz
from gyrorig_solver.numerics import normal_quantile

BLOCK = 16  # samples; an acceleration lasts some tens of samples
MIN_BLOCKS = 24  # of accelerations
ACCELERATING_SHARE = 0.05  # of a large squared slope
FALSE_ALARM = 1e-4  # probability of jitter noise in a recording without it
MIN_EXCESS = 0.1  # variance that jitter adds to the band, relative to the noise
MIN_MEDIAN_SHARE = 0.5  # of the mean squared jitter over blocks that their median reaches
# Median over mean of chi-square with as many degrees of freedom as a block has in the band.
CHI2_MEDIAN = (1.0 - 2.0 / (9.0 * BLOCK / 2.0)) ** 3
MEDIAN_STD = 1.2533  # of a median, relative to that of a mean
MAD_STD = 1.4826  # standard deviation over the median absolute deviation
BAND_POINTS = 512
GROUPS = 3  # of samples with similar jitter; each is whitened with one density
GROUP_FACTOR = 8.0  # between the variances of two groups
NEIGHBOURS = 2  # samples next to a group that are whitened like it
NEGLIGIBLE_DENSITY = 0.05  # of jitter, relative to the smallest density of the noise


@dataclass(frozen=True, slots=True, eq=False)
class JitterNoise:
    """Jitter of the sample times of a recording, as noise."""

    deviation_s: float
    gain: FloatArray  # G, (3, 3), which transforms stage rates to the sensor
    noise: NoiseModel  # at rest

    def relative_std(
        self,
        rate_rad_s: FloatArray,
        used: BoolArray,
        relative_variance: FloatArray,
        keeps_constant: bool,
    ) -> JitterStd:
        """Return the standard deviation of a part's noise.

        Args:
            rate_rad_s: of the stage, shape (n, 3).
            used: (n,).
            relative_variance: of the sensor's white noise, relative to that at rest, (n, 3).
            keeps_constant: see `RelativeStd`.
        """
        rate_hz = self.noise.sampling.rate_hz
        at_rest = self.noise.dct_variance(used.size).T  # (3, n)
        white = (0.5 * rate_hz * (self.noise.levels[:, 0] + self.noise.flat_density))[:, None]
        jitter = self._variance(rate_rad_s, used).T
        group = _assign_groups(jitter, self._negligible_variance(used.size))
        typical = np.stack([_weighted_mean(jitter * (group == k)) for k in range(GROUPS + 1)])
        typical[0] = 0.0
        of_sample = np.take_along_axis(typical[:, :, 0].T, group, axis=1)
        motion = relative_variance.T
        return JitterStd(
            np.ascontiguousarray(np.sqrt(motion)),
            keeps_constant,
            group,
            np.asarray(np.sqrt((white * motion + jitter) / (white + of_sample))),
            np.asarray(np.sqrt(at_rest / (at_rest + typical))),
            np.asarray(jitter / white),
            np.asarray(jitter / at_rest.mean(axis=1, keepdims=True)),
        )

    def acts(self, rate_rad_s: FloatArray, used: BoolArray) -> BoolArray:
        """Return at which rows the jitter is not negligible, (n,); arguments as above."""
        variance = self._variance(rate_rad_s, used)
        limit = self._negligible_variance(used.size)[:, 0]
        return np.asarray(np.any(variance > limit, axis=1), np.bool_)

    def _negligible_variance(self, count: int) -> FloatArray:
        smallest = self.noise.dct_variance(count).min(axis=0)
        return np.asarray(NEGLIGIBLE_DENSITY * smallest[:, None], np.float64)

    def _variance(self, rate_rad_s: FloatArray, used: BoolArray) -> FloatArray:
        """Return the variance of each block mean by the jitter, (n, 3)."""
        sampling = self.noise.sampling
        slope_rad_s2 = _slopes_rad_s2(rate_rad_s @ self.gain.T, used, sampling.rate_hz)
        return np.asarray(self.deviation_s**2 * slope_rad_s2**2 / sampling.samples_per_block)


@dataclass(frozen=True, slots=True, eq=False)
class _Blocks:
    """Mean squares of the residual along the slope, in a band, in units of the noise."""

    squares: FloatArray  # (b,), mean 1 without jitter
    unit_effects: FloatArray  # (b,), what a squared jitter of 1 s^2 adds to each

    def estimate_square(self) -> float:
        """Return the squared jitter; 0 if it is not significant, or acts in some blocks only."""
        if self.squares.size < MIN_BLOCKS:
            return 0.0
        excess = (self.squares - 1.0) / self.unit_effects
        weights = self.unit_effects**2 / np.sum(self.unit_effects**2)
        by_block = (self.squares / CHI2_MEDIAN - 1.0) / self.unit_effects
        median = float(np.median(by_block))
        std = MEDIAN_STD * MAD_STD * float(np.median(np.abs(by_block - median)))
        is_significant = median > normal_quantile(FALSE_ALARM) * std / np.sqrt(by_block.size)
        is_large = median * float(np.mean(self.unit_effects)) > MIN_EXCESS
        mean = float(weights @ excess)
        is_everywhere = median > MIN_MEDIAN_SHARE * mean
        return mean if is_significant and is_large and is_everywhere else 0.0


def estimate_jitter_noise(
    series: Sequence[MotionResidual],
    gain: FloatArray,
    noise: NoiseModel,
    motion_noise: MotionNoise | None,
) -> JitterNoise | None:
    """Return the jitter of a recording; None if the residual shows none.

    Args:
        series: of one recording.
        gain: G, shape (3, 3).
        noise: at rest.
        motion_noise: None: the sensor's noise is the same in motion.
    """
    square_s2 = _collect_blocks(series, gain, noise, motion_noise).estimate_square()
    return JitterNoise(float(np.sqrt(square_s2)), gain.copy(), noise) if square_s2 else None


def _collect_blocks(
    series: Sequence[MotionResidual],
    gain: FloatArray,
    noise: NoiseModel,
    motion_noise: MotionNoise | None,
) -> _Blocks:
    """Return the blocks of accelerations."""
    sampling = noise.sampling
    middles = np.asarray((np.arange(BAND_POINTS) + 0.5) / (2.0 * BAND_POINTS), np.float64)
    frequency_hz = middles * sampling.rate_hz
    band = _band_gain(frequency_hz, sampling.rate_hz) ** 2
    variance = np.mean(band[:, None] * noise.density(frequency_hz), axis=0) * sampling.rate_hz / 2.0
    squares, unit_effects = [], []
    for each in series:
        slope = _slopes_rad_s2(each.rate_rad_s @ gain.T, each.used, sampling.rate_hz)
        if motion_noise is not None:
            variance_in_motion = variance * motion_noise.relative_variance(each.rate_rad_s)
        else:
            variance_in_motion = np.broadcast_to(variance, slope.shape)
        weights = slope * each.used[:, None] / variance_in_motion
        strengths = np.sum(weights * slope, axis=1)
        for part in each.parts:
            signal = _high_pass(each.residual[part], sampling.rate_hz)
            square = _by_block(np.sum(weights[part] * signal, axis=1) ** 2)
            strength = _by_block(strengths[part])
            second = _by_block(strengths[part] ** 2)
            acts = strength > 0.0
            squares.append(square[acts] / strength[acts])
            unit_effects.append(second[acts] / strength[acts])
    unit = float(np.mean(band)) / sampling.samples_per_block
    return _accelerations(_Blocks(np.concatenate(squares), unit * np.concatenate(unit_effects)))


def _accelerations(blocks: _Blocks) -> _Blocks:
    """Return the blocks whose slope is not small. The largest slopes are those of jumps."""
    effects = blocks.unit_effects
    if effects.size < MIN_BLOCKS:
        return blocks
    large = np.partition(effects, -MIN_BLOCKS)[-MIN_BLOCKS]
    used = effects > ACCELERATING_SHARE * large
    return _Blocks(blocks.squares[used], effects[used])


def _by_block(values: FloatArray) -> FloatArray:
    whole = values.size // BLOCK * BLOCK
    return np.asarray(values[:whole].reshape(-1, BLOCK).sum(axis=1))


def _slopes_rad_s2(rate_rad_s: FloatArray, used: BoolArray, rate_hz: float) -> FloatArray:
    """Return the slopes of uniform rates, (n, 3); rates of unused rows are interpolated."""
    if used.sum() < 2:
        return np.zeros_like(rate_rad_s)
    rows = np.arange(used.size)
    filled = [np.interp(rows, rows[used], rate[used]) for rate in rate_rad_s.T]
    return np.asarray(np.gradient(np.stack(filled), axis=1).T * rate_hz, np.float64)


def _assign_groups(jitter: FloatArray, smallest: FloatArray) -> IntArray:
    """Return the group of each sample, (3, n): 0 for negligible jitter, `GROUPS` for the largest.

    Args:
        jitter: variance, (3, n).
        smallest: variance that is not negligible, (3, 1).
    """
    largest = _weighted_mean(jitter)
    ratio = np.divide(jitter, largest, out=np.zeros_like(jitter), where=largest > 0.0)
    limits = GROUP_FACTOR ** -np.arange(GROUPS - 1.0, 0.0, -1.0)
    group = np.where(jitter > smallest, np.searchsorted(limits, ratio) + 1, 0)
    # The whitening of a group amplifies the larger jitter of the next samples.
    padded = np.pad(group, ((0, 0), (NEIGHBOURS, NEIGHBOURS)))
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * NEIGHBOURS + 1, axis=1)
    return np.asarray(windows.max(axis=-1), np.int64)


def _weighted_mean(variance: FloatArray) -> FloatArray:
    """Return the mean of variances (3, n), each weighted by itself, (3, 1)."""
    total = variance.sum(axis=1, keepdims=True)
    squares = np.sum(variance**2, axis=1, keepdims=True)
    return np.asarray(np.divide(squares, total, out=np.zeros_like(total), where=total > 0.0))


def _high_pass(residual: FloatArray, rate_hz: float) -> FloatArray:
    gain = _band_gain(dct_frequencies_hz(residual.shape[0], rate_hz), rate_hz)
    spectrum = dct(residual, axis=0, norm="ortho") * gain[:, None]
    return np.asarray(idct(spectrum, axis=0, norm="ortho"), dtype=np.float64)


def _band_gain(frequency_hz: FloatArray, rate_hz: float) -> FloatArray:
    """Return the gain of a smooth high-pass at half of the Nyquist frequency."""
    rise = np.clip(4.0 * frequency_hz / rate_hz - 0.5, 0.0, 1.0)
    return np.asarray(np.sin(0.5 * np.pi * rise), dtype=np.float64)
