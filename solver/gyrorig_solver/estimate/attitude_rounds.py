"""The rounds of the fit against a reference attitude, in the DCT domain.

What to use when: under `attitude.fit_attitude`, whose docstring has the theory.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import dct, idct

from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.estimate.attitude_blocks import SEARCH_S, Stretch, coarse_lag_s
from gyrorig_solver.estimate.conclusion import NAMES
from gyrorig_solver.estimate.noise import Spectrum
from gyrorig_solver.estimate.observability import decide, prior_std

ROUNDS = 15
CONVERGED_SIGMA = 1e-3
# Fewer in a bin, and weights that were found in the residual overfit it: with 12 the true
# errors were 1.2 times the standard deviations over 30 simulated runs, with 80 1.02 to 1.09.
BINS = 10
FEWEST_IN_BIN = 80
# A residual this many robust deviations off in time is a glitch of the reference.
GLITCH_SIGMA = 8.0
# The score's variance is judged over chunks of this length, longer than its correlation.
CHUNK_S = 5.0
FEWEST_CHUNKS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Linearised:
    """One linearisation in the DCT domain, all stretches stacked, band-limited."""

    residual: FloatArray  # (n, 3)
    columns: FloatArray  # (n, 3, 13)
    variance: FloatArray  # (n, 3)
    regressor_noise: FloatArray  # (n, 3), variance left in the estimate of the true rate
    glitches: int

    def information(self) -> FloatArray:
        """Return J' V^-1 J less what the regressor's own noise feigns, (13, 13)."""
        weighed = self.columns / self.variance[:, :, None]
        info = np.einsum("nij,nik->jk", weighed, self.columns)
        for i in range(3):
            for j in range(3):
                feigned = np.sum(self.regressor_noise[:, j] / self.variance[:, i])
                info[3 * i + j, 3 * i + j] -= min(feigned, 0.999 * info[3 * i + j, 3 * i + j])
        return np.asarray(info, dtype=np.float64)

    def score(self) -> FloatArray:
        """Return J' V^-1 r, shape (13,)."""
        return np.asarray(
            np.einsum("nij,ni->j", self.columns, self.residual / self.variance), dtype=np.float64
        )


@dataclass(frozen=True, slots=True, eq=False)
class Cleaned:
    """One stretch in time: the gyro over the reference's steps, and the reference."""

    measured: FloatArray  # (n, 3)
    slope: FloatArray  # (n, 3), of `measured` by the lag
    rate: FloatArray  # (n, 3), body rate, without glitches
    residual: FloatArray  # (n, 3)
    glitches: int


class AttitudeWork:
    """The fit under way."""

    def __init__(self, stretches: list[Stretch], band_hz: float) -> None:
        self.stretches, self.band_hz = stretches, band_hz
        self.gain, self.bias = np.eye(3), np.zeros(3)
        self.lag_s = coarse_lag_s(stretches)
        self.converged = False
        frequency, self.kept = [], []
        for s in stretches:
            n = s.track.begin_s.size
            f = np.arange(n) / (2.0 * n * s.track.step_s)
            self.kept.append(f <= band_hz)
            frequency.append(f[self.kept[-1]])
        self.frequency_hz = np.concatenate(frequency)
        self.bin = _bins(self.frequency_hz)

    @property
    def estimate(self) -> FloatArray:
        """G, b, tau, shape (13,)."""
        return np.concatenate([self.gain.ravel(), self.bias, [self.lag_s]])

    def run(self) -> Linearised:
        """Iterate to convergence and return the last linearisation."""
        self._start()
        for _ in range(ROUNDS):
            now = self.linearised()
            inverse = decide(now.information(), NAMES).inverse
            step = inverse @ now.score()
            self.gain = self.gain + step[:9].reshape(3, 3)
            self.bias = self.bias + step[9:12]
            limit = 0.95 * SEARCH_S
            self.lag_s = float(np.clip(self.lag_s + step[12], -limit, limit))
            sigma = np.sqrt(np.maximum(np.diag(inverse), 1e-30))
            if float(np.max(np.abs(step) / sigma)) < CONVERGED_SIGMA:
                self.converged = True
                break
        return self.linearised()

    def _start(self) -> None:
        """Begin at plain least squares on the band, held at nominal where nothing turned."""
        rate = np.concatenate([s.track.rate_rad_s for s in self.stretches])
        measured = np.concatenate([s.measured(self.lag_s)[0] for s in self.stretches])
        design = np.column_stack([rate, np.ones(rate.shape[0])])
        held = prior_std(("gain", "gain", "gain", "bias")) ** -2.0
        ridge = np.diag(held * float(np.var(measured - rate)))
        nominal = np.vstack([np.eye(3), np.zeros((1, 3))])
        found = np.linalg.solve(design.T @ design + ridge, design.T @ measured + ridge @ nominal)
        self.gain, self.bias = found[:3].T.copy(), found[3].copy()
        if abs(np.linalg.det(self.gain)) < 1e-3:
            self.gain = np.eye(3)

    def linearised(self) -> Linearised:
        """Return residual, derivatives and noise at the current parameters."""
        rates, slopes, ones, residuals, totals = [], [], [], [], []
        glitches = 0
        inverse = np.linalg.inv(self.gain)
        for k, kept in enumerate(self.kept):
            now = self.cleaned(k)
            glitches += now.glitches
            one = np.zeros(now.rate.shape[0])
            one[0] = np.sqrt(now.rate.shape[0])
            rates.append(dct(now.rate, axis=0, norm="ortho")[kept])
            slopes.append(dct(now.slope, axis=0, norm="ortho")[kept])
            residuals.append(dct(now.residual, axis=0, norm="ortho")[kept])
            totals.append(dct(now.measured, axis=0, norm="ortho")[1:])
            ones.append(one[kept])
        residual = np.concatenate(residuals)
        variance = _by_bin(residual**2, self.bin, self.frequency_hz)
        gyro_noise = np.minimum(_floor(totals), variance)
        share = 1.0 - gyro_noise / variance  # of the residual that the reference brings
        rate = np.concatenate(rates) + (share * residual) @ inverse.T
        left = (gyro_noise * share) @ (inverse**2).T
        columns = np.zeros((residual.shape[0], 3, 13))
        for i in range(3):
            columns[:, i, 3 * i : 3 * i + 3] = rate
            columns[:, i, 9 + i] = np.concatenate(ones)
        # y is taken at t + tau: the model stays and y moves, so its slope has the other sign.
        columns[:, :, 12] = -np.concatenate(slopes)
        return Linearised(residual, columns, variance, left, glitches)

    def cleaned(self, stretch: int) -> Cleaned:
        """Return one stretch in time at the current parameters, without glitches.

        A glitch lies in the reference: it is taken out of the rate and the residual.
        """
        one = self.stretches[stretch]
        measured, slope = one.measured(self.lag_s)
        full = measured - one.track.rate_rad_s @ self.gain.T - self.bias
        clipped, glitches = _clip(full, one.track.rate_rad_s)
        rate = one.track.rate_rad_s + (full - clipped) @ np.linalg.inv(self.gain).T
        return Cleaned(measured, slope, rate, clipped, glitches)

    def score_inflation(self, last: Linearised) -> float:
        """Return how much larger the score varies over chunks of time than noise would make it.

        1 where the noise is as stationary as the weights take it to be; residuals that
        grow with the motion raise it.
        """
        scores, first = [], 0
        root = np.sqrt(last.variance)
        for s, kept in zip(self.stretches, self.kept, strict=True):
            n, k = s.track.begin_s.size, int(kept.sum())
            part = slice(first, first + k)
            first += k
            white = in_time((last.residual[part] / root[part])[:, :, None], n)
            columns = in_time(last.columns[part] / root[part][:, :, None], n)
            product = np.einsum("tij,ti->tj", columns, white[:, :, 0])
            length = max(1, round(CHUNK_S / s.track.step_s))
            for begin in range(0, n - length // 2, length):
                scores.append(product[begin : begin + length].sum(axis=0))
        if len(scores) < 8:
            return 1.0
        spread = np.asarray(scores)
        meat = spread.T @ spread
        inverse = np.linalg.pinv(last.information() + np.diag(prior_std(NAMES) ** -2.0))
        robust = np.diag(inverse @ meat @ inverse)
        return float(np.median(robust / np.diag(inverse)))

    def spectrum(self) -> Spectrum:
        """Return the residual's one-sided density by bins, which is the noise model."""
        residual = self.linearised().residual
        step_s = self.stretches[0].track.step_s
        count = np.bincount(self.bin).astype(np.float64)
        centre = np.bincount(self.bin, self.frequency_hz) / count
        power = np.stack([np.bincount(self.bin, residual[:, i] ** 2) for i in range(3)], axis=1)
        return Spectrum(centre, 2.0 * step_s * power / count[:, None], count)

    def band(self, stretch: int, values: FloatArray) -> FloatArray:
        """Return the part of a series in the band, shape (n, k) as given."""
        kept = self.kept[stretch]
        return in_time(dct(values, axis=0, norm="ortho")[kept], values.shape[0])


def in_time(coefficients: FloatArray, n: int) -> FloatArray:
    """Return the series of length n whose first DCT coefficients are given; along axis 0."""
    whole = np.zeros((n, *coefficients.shape[1:]))
    whole[: coefficients.shape[0]] = coefficients
    return np.asarray(idct(whole, axis=0, norm="ortho"), dtype=np.float64)


def _bins(frequency_hz: FloatArray) -> IntArray:
    """Return a bin number for each coefficient: log spaced, none with few coefficients."""
    order = np.argsort(frequency_hz, kind="stable")
    n = frequency_hz.size
    edges = np.unique(np.rint(np.geomspace(FEWEST_IN_BIN, n, BINS)).astype(np.int64))
    keep = [int(edges[0])]
    for edge in edges[1:]:
        if edge - keep[-1] >= FEWEST_IN_BIN:
            keep.append(int(edge))
    keep[-1] = n
    found = np.empty(n, dtype=np.int64)
    found[order] = np.searchsorted(np.array(keep), np.arange(n), side="right")
    return found


def level_by_bins(power: FloatArray, frequency_hz: FloatArray) -> FloatArray:
    """Return each coefficient's expected power, (n, 3), smooth over frequency.

    Args:
        power: shape (n, 3).
        frequency_hz: shape (n,), above zero for most.
    """
    return _by_bin(power, _bins(frequency_hz), frequency_hz)


def _by_bin(power: FloatArray, bins: IntArray, frequency_hz: FloatArray) -> FloatArray:
    """Return each coefficient's expected power: bin means, joined by straight lines in log-log.

    The fit has taken four parameters an axis out of the power; that share is put back.
    """
    f = np.log(np.maximum(frequency_hz, np.min(frequency_hz[frequency_hz > 0.0])))
    count = np.bincount(bins).astype(np.float64)
    centre = np.bincount(bins, f) / count
    found = np.empty_like(power)
    for i in range(3):
        mean = np.maximum(np.bincount(bins, power[:, i]) / count, 1e-30)
        line = np.exp(np.interp(f, centre, np.log(mean)))
        level = np.bincount(bins, power[:, i] / line) / count
        found[:, i] = line * np.maximum(level, 1e-30)[bins]
    return np.asarray(found * power.shape[0] / max(power.shape[0] - 4, 1), dtype=np.float64)


def _floor(totals: Sequence[FloatArray]) -> FloatArray:
    """Return an upper bound of the gyro's white noise in DCT variance, shape (3,).

    It is the lowest the gyro's own spectrum gets anywhere: motion only adds to it.
    """
    lowest = np.full(3, np.inf)
    for total in totals:
        for block in np.array_split(total, max(1, total.shape[0] // 64)):
            lowest = np.minimum(lowest, np.mean(block**2, axis=0))
    return lowest


def _clip(residual: FloatArray, rate: FloatArray) -> tuple[FloatArray, int]:
    """Return the residual with glitches cut to their limit, and how many there are.

    Markers seen at another angle are noisier, so the limit is set by the faster half of
    the motion and not by the rests.
    """
    speed = np.linalg.norm(rate, axis=1)
    fast = np.abs(residual[speed >= np.median(speed)])
    limit = GLITCH_SIGMA * 1.4826 * np.median(fast, axis=0) + 1e-12
    clipped = np.clip(residual, -limit, limit)
    return clipped, int(np.sum(np.any(clipped != residual, axis=1)))
