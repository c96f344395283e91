"""Jitter of the sample times: a cause that changes the variance of the residual, not its mean.

If a sample is late by d, it differs by d times the slope of the rate, on all axes at once. The
delays d are white with the standard deviation s. The whitened residual is divided into short
blocks, and each block is transformed (DCT-II). Coefficient j of block b is a vector over the axes
with the covariance

    I + s^2 A,   A_ik = M_ik a_i a_k,   M: mean of slope_i slope_k over the block,
    a_i = (S_i(f_j) r/2)^(-1/2)

Here, S is the density of the sensor's noise, which the low-pass shapes, and r is the sampling rate.
The low-pass does not shape white jitter. 1/S is averaged over frequency as a coefficient of a short
block does, with its leakage. Along the eigenvectors of A, the coefficients are independent.
Therefore the likelihood, the estimate (Fisher scoring in s^2) and the uncertainty of s are sums.

Errors of the mean model at starts and stops are smooth, but jitter is not. Therefore slow and fast
coefficients must agree on s.

What to use when: `estimate_jitter` at a fit; `jitter_cause` names the cause.

Source: Whittle's likelihood for a locally stationary process, Dahlhaus, Ann. Statist. 25
(1997) 1.
"""

from dataclasses import dataclass

import numpy as np
from scipy.fft import dct

from gyrorig_solver.data import BoolArray, FloatArray, IntArray
from gyrorig_solver.discover.cause_findings import DependenceTest, SignificanceTest
from gyrorig_solver.discover.checks.jitter_modulation import BlockMotion, find_modulation
from gyrorig_solver.discover.checks.variance_trend import (
    fit_variance_trend,
    speed_shapes,
)
from gyrorig_solver.discover.score_tests import DETECTION_POWER, FALSE_ALARM_RATE
from gyrorig_solver.estimate import NoiseModel, NuisanceProjector
from gyrorig_solver.model.causes.sample_jitter import SampleJitter
from gyrorig_solver.numerics import chi2_upper_tail, normal_quantile

BLOCK_LENGTH = 16  # samples; an acceleration lasts some tens of samples
STILL_SHARE = 1e-3  # share of the largest squared slope below which a block has no acceleration
MIN_STILL_BLOCKS = 16  # blocks without acceleration that are necessary for the noise level
MIN_LEAD_NATS = 3.0  # lead over another shape of the variance: a probability of 95 %
MIN_AGREEMENT_P = 1e-3  # p-value below which slow and fast coefficients contradict each other
MAX_SIZE_RATIO = 2.0  # a contradiction also needs this factor between their values of s^2
FREQUENCY_COUNT = 512  # frequencies over which the noise density is averaged
MAX_ITERATIONS = 40
RELATIVE_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class JitterEstimate:
    """The maximum-likelihood estimate of sample-time jitter."""

    deviation_s: float
    std_s: float  # inf for a deviation of zero
    statistic: float  # twice the log-likelihood that the model loses without jitter
    p_value: float  # of a single test
    rival_nats: tuple[float, ...]  # gain of other shapes of the variance, relative to jitter
    is_consistent: bool  # slow and fast coefficients agree
    detectable_s: float  # smallest detectable deviation, for the number of tests
    remaining_trend: SignificanceTest  # of the variance without the jitter, by motion and speed
    modulation: DependenceTest | None  # of its size, by the most significant covariate

    @property
    def is_distinct(self) -> bool:
        """Whether no alternative variance model fits as well."""
        return self.is_consistent and all(nats < -MIN_LEAD_NATS for nats in self.rival_nats)


@dataclass(frozen=True, slots=True, eq=False)
class _VarianceModel:
    """Independent coefficients with a variance of 1 by noise plus a multiple of a shape."""

    squares: FloatArray  # (m,), squares of the coefficients
    shape: FloatArray  # (m,), variance that a unit of the cause adds

    def log_likelihood(self, size: float) -> float:
        variance = 1.0 + size * self.shape
        return -0.5 * float(np.sum(np.log(variance) + self.squares / variance))

    def information(self, size: float) -> float:
        return 0.5 * float(np.sum((self.shape / (1.0 + size * self.shape)) ** 2))

    def most_likely_size(self) -> float:
        """Return the maximum-likelihood size, at least zero."""
        if not self.shape.any():
            return 0.0
        size = 0.0
        for _ in range(MAX_ITERATIONS):
            variance = 1.0 + size * self.shape
            slope = 0.5 * float(np.sum(self.shape * (self.squares - variance) / variance**2))
            after = max(size + slope / self.information(size), 0.0)
            if abs(after - size) <= RELATIVE_TOLERANCE * max(after, size):
                return after
            size = after
        return size

    def log_likelihood_gain(self, size: float) -> float:
        return self.log_likelihood(size) - self.log_likelihood(0.0)

    def subset(self, mask: BoolArray) -> "_VarianceModel":
        return _VarianceModel(self.squares[mask], self.shape[mask])


def estimate_jitter(
    projection: NuisanceProjector,
    tests: int,
    with_motion_noise: bool = False,
) -> JitterEstimate | None:
    """Estimate the jitter in a fit's residual; None without accelerations.

    Args:
        projection: the nuisance projector at the fit.
        tests: how many share the false alarms, for the detectable size.
        with_motion_noise: in addition to the noise in motion of the fit. Otherwise the noise is
            that at rest, and jitter and noise in motion both compete for the whole scatter.
    """
    blocks = _block_coefficients(projection, with_motion_noise)
    if blocks is None:
        return None
    values, slopes, speeds, weights, motion = blocks
    rises = speeds[0]
    covariance = slopes[:, None] * weights[:, :, :, None] * weights[:, :, None, :]
    eigenvalues, eigenvectors = np.linalg.eigh(covariance)
    rotated = np.einsum("bjik,bji->bjk", eigenvectors, values.transpose(0, 2, 1))
    jitter = _VarianceModel((rotated**2).ravel(), np.clip(eigenvalues, 0.0, None).ravel())
    size = jitter.most_likely_size()
    gain_nats = jitter.log_likelihood_gain(size)
    # Two other shapes: scatter that grows with the acceleration but has the spectrum of the noise,
    # and scatter in motion.
    flat = np.broadcast_to(np.mean(weights**2, axis=1, keepdims=True), weights.shape)
    like_noise = np.einsum("bii,bji->bji", slopes, flat)
    in_motion = np.broadcast_to(rises[:, None, None], like_noise.shape)
    squares = values.transpose(0, 2, 1) ** 2
    rival_nats = []
    for shape in (like_noise, in_motion):
        other = _VarianceModel(squares.ravel(), np.ascontiguousarray(shape).ravel())
        rival_nats.append(other.log_likelihood_gain(other.most_likely_size()) - gain_nats)
    information = jitter.information(0.0)
    needed = normal_quantile(FALSE_ALARM_RATE / tests) + normal_quantile(1.0 - DETECTION_POWER)
    return JitterEstimate(
        deviation_s=float(np.sqrt(size)),
        std_s=0.5 / float(np.sqrt(size * jitter.information(size))) if size > 0.0 else np.inf,
        statistic=2.0 * max(gain_nats, 0.0),
        p_value=0.5 * chi2_upper_tail(2.0 * max(gain_nats, 0.0), 1.0),
        rival_nats=tuple(rival_nats),
        is_consistent=_bands_agree(jitter, size, eigenvalues.shape),
        detectable_s=float(np.sqrt(needed / np.sqrt(information))),
        remaining_trend=_remaining_trend(jitter, size, speeds, rotated.shape),
        modulation=find_modulation(
            rotated.reshape(len(rotated), -1) ** 2,
            jitter.shape.reshape(len(rotated), -1),
            size,
            motion,
        ),
    )


def _remaining_trend(
    jitter: _VarianceModel, size: float, speeds: FloatArray, shape: tuple[int, ...]
) -> SignificanceTest:
    """Test whether the variance without that of the jitter still grows with motion and speed.

    Args:
        jitter: the coefficients.
        size: squared jitter.
        speeds: shapes of a variance in each block, (k, b).
        shape: shape of the array of coefficients, (b, BLOCK, 3).
    """
    excess = jitter.squares / (1.0 + size * jitter.shape) - 1.0
    shapes = [np.broadcast_to(speed_shape[:, None, None], shape).ravel() for speed_shape in speeds]
    return fit_variance_trend(np.stack(shapes), excess, two_sided=True)


def _bands_agree(jitter: _VarianceModel, size: float, shape: tuple[int, ...]) -> bool:
    """Return whether low and high frequencies give the same size of the jitter."""
    fast = np.zeros(shape, dtype=np.bool_)
    fast[:, shape[1] // 2 :] = True
    bands = [jitter.subset(band) for band in (fast.ravel(), ~fast.ravel())]
    sizes = [band.most_likely_size() for band in bands]
    gain_nats = sum(
        h.log_likelihood(s) - h.log_likelihood(size) for h, s in zip(bands, sizes, strict=True)
    )
    if chi2_upper_tail(2.0 * max(gain_nats, 0.0), 1.0) > MIN_AGREEMENT_P:
        return True
    return max(sizes) < MAX_SIZE_RATIO * min(sizes)


def _noise_weights(noise: NoiseModel) -> FloatArray:
    """Return a_i of each coefficient, (BLOCK_LENGTH, 3): the root of a whitened unit variance."""
    rate_hz = noise.sampling.rate_hz
    frequency = (np.arange(FREQUENCY_COUNT) + 0.5) * rate_hz / (2.0 * FREQUENCY_COUNT)
    power = 2.0 / (noise.density(np.asarray(frequency, np.float64)) * rate_hz)
    lag = np.arange(BLOCK_LENGTH)
    wave = np.cos(np.pi * np.outer(lag, np.arange(FREQUENCY_COUNT) + 0.5) / FREQUENCY_COUNT)
    correlation = wave @ power / FREQUENCY_COUNT
    between = correlation[np.abs(lag[:, None] - lag[None, :])]
    basis = dct(np.eye(BLOCK_LENGTH), axis=0, norm="ortho")
    return np.asarray(np.sqrt(np.einsum("jt,tui,ju->ji", basis, between, basis)), np.float64)


def _block_coefficients(
    projection: NuisanceProjector, with_motion_noise: bool
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, BlockMotion] | None:
    """Return coefficients, slopes, motion shapes, weights and motion of blocks.

    Returns:
        (b, 3, BLOCK) in units of the noise, (b, 3, 3), (k, b), (b, BLOCK, 3), motion of b blocks;
        None without accelerations.
    """
    left = projection.orthogonal_component(projection.residual)
    values, slopes, moving, weights, recordings, places = [], [], [], [], [], []
    rates = [model.rate for segment in projection.segments for model in segment.models]
    fastest = max(float(np.linalg.norm(rate, axis=1).max(initial=0.0)) for rate in rates)
    for scene, (segment, model, white) in zip(
        projection.states, projection.split_parts(left), strict=True
    ):
        unit_effect, values_at_rest = SampleJitter().unit_effect(scene), white
        if model.relative_std is not None:
            values_at_rest = model.relative_std.multiply_signals(white)
            if with_motion_noise:
                unit_effect = unit_effect / model.relative_std.values.T
                values_at_rest = values_at_rest / model.relative_std.values
        whole = white.shape[1] // BLOCK_LENGTH
        inside = slice(0, whole * BLOCK_LENGTH)
        used: BoolArray = np.all(model.used[inside].reshape(whole, BLOCK_LENGTH), axis=1)
        cut = values_at_rest[:, inside].reshape(3, whole, BLOCK_LENGTH).transpose(1, 0, 2)[used]
        shape = unit_effect[inside].reshape(whole, BLOCK_LENGTH, 3)[used]
        values.append(dct(cut, axis=-1, norm="ortho"))
        slopes.append(np.einsum("bti,btk->bik", shape, shape) / BLOCK_LENGTH)
        rate = np.linalg.norm(model.rate, axis=1)
        weight = _noise_weights(segment.noise)
        weights.append(np.broadcast_to(weight, (len(cut), *weight.shape)))
        recordings.append(np.full(len(cut), scene.context.recording_index))
        places.append(BlockMotion.of(scene, rate, BLOCK_LENGTH, used))
        speed = speed_shapes(rate[inside], fastest)
        moving.append(speed.reshape(-1, whole, BLOCK_LENGTH).mean(axis=2)[:, used])
    value, slope = np.concatenate(values), np.concatenate(slopes)
    strength = np.einsum("bii->b", slope)
    if not strength.size or strength.max() <= 0.0:
        return None
    still = strength < STILL_SHARE * strength.max()
    level = _noise_levels(value, still, np.concatenate(recordings))
    slope = np.where(still[:, None, None], 0.0, slope)
    moved = np.concatenate(moving, axis=1)
    relative_weights = np.concatenate(weights) / level[:, None]
    motion = BlockMotion.concatenate(places)
    return value / level[:, :, None], slope, moved, relative_weights, motion


def _noise_levels(values: FloatArray, still: BoolArray, recordings: IntArray) -> FloatArray:
    """Return the noise of the still blocks of each recording, relative to the fitted noise, (b, 3).

    Noise levels that were fitted to the whole residual of a recording contain its jitter.

    Args:
        values: coefficients, (b, 3, BLOCK).
        still: whether a block has no acceleration, (b,).
        recordings: index of the recording of each block, (b,).
    """
    levels = np.ones(values.shape[:2])
    for index in np.unique(recordings):
        of_recording = recordings == index
        still_values = values[of_recording & still]
        if len(still_values) >= MIN_STILL_BLOCKS:
            levels[of_recording] = np.sqrt(np.mean(still_values**2, axis=(0, 2)))
    return levels
