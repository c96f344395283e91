"""Jitter of the samples' instants: a cause that shows in the scatter, not in the mean.

A sample taken d late differs by d times the slope of the rate, on all axes at once; d is
white with deviation s. The whitened residual is cut into short blocks and each transformed
(DCT-II); coefficient j of block b is a vector over the axes with the covariance

    I + s^2 A,   A_ik = M_ik a_i a_k,   M the block's mean of slope_i slope_k,
    a_i = (S_i(f_j) r/2)^(-1/2)

since white times are not shaped by the sensor's low-pass while its noise, S, is (1/S as a
short block's coefficient sees it, leakage and all). Along the eigenvectors of A the
coefficients are independent, so that likelihood, estimate (Fisher scoring in s^2) and
deviation of s are sums.

What the mean model lacks at starts and stops is smooth, jitter is not: slow and fast
coefficients must agree on s.

What to use when: `find_jitter` beside a fit; `scatter_names` makes a cause of it.

Source: Whittle's likelihood for a locally stationary process, Dahlhaus, Ann. Statist. 25
(1997) 1.
"""

from dataclasses import dataclass

import numpy as np
from scipy.fft import dct

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.chance import chi2_tail, normal_limit
from gyrorig_solver.discover.growth import Growth, by_speed, grown
from gyrorig_solver.discover.jitter_swells import Swell, Where, against
from gyrorig_solver.estimate.noise import NoiseModel
from gyrorig_solver.estimate.projection import Projection
from gyrorig_solver.model.terms.sample_jitter import SampleJitter

BLOCK = 16  # samples; an acceleration lasts some tens
STILL = 1e-3  # of the largest slope squared: slower changes count as none
FEWEST = 16  # blocks without acceleration that the noise's level is judged by
CLEARLY = 3.0  # nats that another shape must be behind by: a belief of 95 %
DISAGREE = 1e-3  # chance below which slow and fast coefficients contradict each other
ALIKE = 2.0  # and the factor of s^2 that they must differ by, too
FREQUENCIES = 512  # over which the noise's density is averaged
ROUNDS = 40
SETTLED = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Jitter:
    """What a residual says of jitter."""

    deviation_s: float
    std_s: float
    statistic: float  # twice the log likelihood that leaving it out would cost
    p_value: float  # one test
    rivals: tuple[tuple[str, float], ...]  # other shapes of scatter, nats beside jitter's
    agree: bool  # slow and fast coefficients say the same
    detectable_s: float  # deviation that shows 4 times in 5, of as many tests as were given
    beside: Growth  # whether the scatter grows with motion, and how fast, beside it
    swell: Swell | None  # what its size hangs on most, which jitter's must not

    @property
    def named(self) -> bool:
        """Whether nothing but jitter looks like that."""
        return self.agree and all(nats < -CLEARLY for _, nats in self.rivals)


@dataclass(frozen=True, slots=True, eq=False)
class _Scatter:
    """Independent values of unit variance where there is only noise, and what may add to it."""

    value: FloatArray  # (m,), squared
    shape: FloatArray  # (m,), what a unit of the cause adds

    def likelihood(self, size: float) -> float:
        variance = 1.0 + size * self.shape
        return -0.5 * float(np.sum(np.log(variance) + self.value / variance))

    def information(self, size: float) -> float:
        return 0.5 * float(np.sum((self.shape / (1.0 + size * self.shape)) ** 2))

    def best(self) -> float:
        """Return the likeliest size, not below zero."""
        if not self.shape.any():
            return 0.0
        size = 0.0
        for _ in range(ROUNDS):
            variance = 1.0 + size * self.shape
            slope = 0.5 * float(np.sum(self.shape * (self.value - variance) / variance**2))
            after = max(size + slope / self.information(size), 0.0)
            if abs(after - size) <= SETTLED * max(after, size):
                return after
            size = after
        return size

    def won(self, size: float) -> float:
        return self.likelihood(size) - self.likelihood(0.0)

    def some(self, which: BoolArray) -> "_Scatter":
        return _Scatter(self.value[which], self.shape[which])


def find_jitter(projection: Projection, tests: int, alpha: float, power: float) -> Jitter | None:
    """Return what a fit's residual says of jitter, None where nothing is accelerated.

    Args:
        projection: the space beside the fit.
        tests: how many share the false alarms, for the detectable size.
        alpha: rate of false alarms of all of them.
        power: share of cases in which a detectable size shows.
    """
    blocks = _blocks(projection)
    if blocks is None:
        return None
    values, slopes, speeds, weights, places = blocks
    rises = speeds[0]
    covariance = slopes[:, None] * weights[None, :, :, None] * weights[None, :, None, :]
    strength, along = np.linalg.eigh(covariance)
    turned = np.einsum("bjik,bji->bjk", along, values.transpose(0, 2, 1))
    jitter = _Scatter((turned**2).ravel(), np.clip(strength, 0.0, None).ravel())
    size = jitter.best()
    won = jitter.won(size)
    flat = np.broadcast_to(np.mean(weights**2, axis=0), weights.shape)
    like_noise = np.einsum("bii,ji->bji", slopes, flat)
    rivals = {
        "a scatter that grows with the acceleration as the noise's own spectrum": like_noise,
        "a scatter that is there while the stage moves": np.broadcast_to(
            rises[:, None, None], like_noise.shape
        ),
    }
    squares = values.transpose(0, 2, 1) ** 2
    others = []
    for words, shape in rivals.items():
        other = _Scatter(squares.ravel(), np.ascontiguousarray(shape).ravel())
        others.append((words, other.won(other.best()) - won))
    information = jitter.information(0.0)
    needed = normal_limit(alpha / tests) + normal_limit(1.0 - power)
    return Jitter(
        deviation_s=float(np.sqrt(size)),
        std_s=_std(size, jitter.information(size)),
        statistic=2.0 * max(won, 0.0),
        p_value=0.5 * chi2_tail(2.0 * max(won, 0.0), 1.0),
        rivals=tuple(others),
        agree=_agree(jitter, size, strength.shape),
        detectable_s=float(np.sqrt(needed / np.sqrt(information))),
        beside=_beside(jitter, size, speeds, turned.shape),
        swell=against(turned.reshape(len(turned), -1) ** 2, jitter.shape.reshape(len(turned), -1),
                      size, places),
    )  # fmt: skip


def _std(size: float, information: float) -> float:
    """Return the deviation of the root of a size, where that is not zero."""
    return float(0.5 / np.sqrt(size * information)) if size > 0.0 else float("inf")


def _beside(jitter: _Scatter, size: float, speeds: FloatArray, shape: tuple[int, ...]) -> Growth:
    """Return whether the scatter, less the jitter's, grows with motion and how fast it is.

    Args:
        jitter: the coefficients.
        size: of the jitter, squared.
        speeds: shapes of a variance in each block, (k, b).
        shape: of the coefficients, (b, BLOCK, 3).
    """
    excess = jitter.value / (1.0 + size * jitter.shape) - 1.0
    every = [np.broadcast_to(one[:, None, None], shape).ravel() for one in speeds]
    return grown(np.stack(every), excess, either_way=True)


def _agree(jitter: _Scatter, size: float, shape: tuple[int, ...]) -> bool:
    """Return whether slow and fast coefficients tell of the same size."""
    fast = np.zeros(shape, dtype=np.bool_)
    fast[:, shape[1] // 2 :] = True
    halves = [jitter.some(half) for half in (fast.ravel(), ~fast.ravel())]
    sizes = [half.best() for half in halves]
    apart = sum(h.likelihood(s) - h.likelihood(size) for h, s in zip(halves, sizes, strict=True))
    if chi2_tail(2.0 * max(apart, 0.0), 1.0) > DISAGREE:
        return True
    return max(sizes) < ALIKE * min(sizes)


def _weights(noise: NoiseModel) -> FloatArray:
    """Return a_i of each coefficient, (BLOCK, 3): root of what whitening makes of white."""
    rate_hz = noise.sampling.rate_hz
    frequency = (np.arange(FREQUENCIES) + 0.5) * rate_hz / (2.0 * FREQUENCIES)
    power = 2.0 / (noise.density(np.asarray(frequency, np.float64)) * rate_hz)
    lag = np.arange(BLOCK)
    wave = np.cos(np.pi * np.outer(lag, np.arange(FREQUENCIES) + 0.5) / FREQUENCIES)
    correlation = wave @ power / FREQUENCIES
    between = correlation[np.abs(lag[:, None] - lag[None, :])]
    basis = dct(np.eye(BLOCK), axis=0, norm="ortho")
    return np.asarray(np.sqrt(np.einsum("jt,tui,ju->ji", basis, between, basis)), np.float64)


def _blocks(
    projection: Projection,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, Where] | None:
    """Return blocks' coefficients, slopes, shapes of motion, weights, and what moved in them.

    Returns:
        (b, 3, BLOCK) in units of the noise, (b, 3, 3), (k, b), (BLOCK, 3), of b; None without.
    """
    left = projection.left(projection.residual)
    values, slopes, moving, weights, places, start = [], [], [], [], [], 0
    rates = [model.rate for s in projection.stretches for model in s.models]
    fastest = max(float(np.linalg.norm(rate, axis=1).max(initial=0.0)) for rate in rates)
    for s in projection.stretches:
        weights.append(_weights(s.noise))
        for scene, model in zip(s.scenes, s.models, strict=True):
            n = model.used.size
            white = left[start : start + 3 * n].reshape(3, n)
            start += 3 * n
            whole = n // BLOCK
            inside = slice(0, whole * BLOCK)
            used: BoolArray = np.all(model.used[inside].reshape(whole, BLOCK), axis=1)
            cut = white[:, inside].reshape(3, whole, BLOCK).transpose(1, 0, 2)[used]
            shape = SampleJitter().shape(scene)[inside].reshape(whole, BLOCK, 3)[used]
            values.append(dct(cut, axis=-1, norm="ortho"))
            slopes.append(np.einsum("bti,btk->bik", shape, shape) / BLOCK)
            rate = np.linalg.norm(model.rate, axis=1)
            places.append(Where.of(scene, rate, BLOCK, used))
            speed = by_speed(rate[inside], fastest)
            moving.append(speed.reshape(-1, whole, BLOCK).mean(axis=2)[:, used])
    value, slope = np.concatenate(values), np.concatenate(slopes)
    strength = np.einsum("bii->b", slope)
    if not strength.size or strength.max() <= 0.0:
        return None
    still = strength < STILL * strength.max()
    level = np.ones(3)
    if still.sum() >= FEWEST:
        # Levels found in the whole residual have the jitter in them.
        level = np.sqrt(np.mean(value[still] ** 2, axis=(0, 2)))
    slope = np.where(still[:, None, None], 0.0, slope)
    # Recordings of one board are sampled alike; their levels are nearly the same.
    weight = np.mean(weights, axis=0) / level
    moved = np.concatenate(moving, axis=1)
    return value / level[None, :, None], slope, moved, weight, Where.joined(places)
