"""Gauss-Newton iterations of the fit to a reference attitude, in the DCT domain.

What to use when: only inside `attitude_fit.solve_attitude`, whose module has the theory.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import dct, idct

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.estimate.attitude.attitude_matching import (
    MAX_LAG_S,
    AttitudeSegment,
    coarse_lag_s,
)
from gyrorig_solver.estimate.attitude.linearised_model import MIN_SLOPE_SHARE, LinearisedModel
from gyrorig_solver.estimate.noise.residual_spectrum import Spectrum
from gyrorig_solver.estimate.observability import analyse_scaled_observability, prior_std
from gyrorig_solver.estimate.parameter_layout import (
    GAIN_PARAMETERS,
    SESSION_PARAMETERS,
    ParameterLayout,
)

MAX_ITERATIONS = 15
LAG_LIMIT_S = 0.95 * MAX_LAG_S  # of the search; the gyro covers a margin of `MAX_LAG_S`
CONVERGED_SIGMA = 1e-3
# With fewer values per bin, the weights overfit the residual: with 12, the true errors were 1.2
# times the standard deviations over 30 simulated runs, with 80 they were 1.02 to 1.09 times.
BINS = 10
MIN_PER_BIN = 80
# Degrees of freedom that are subtracted from n values. The inverse of a variance from n values is
# too large by 2 / n, and weights that follow the residual fit it by the same amount again.
WEIGHT_FREEDOM = 4.0
# The floor of the gyro's noise is the lowest of some 100 means of 64 values, so it is too low by up
# to this factor.
FLOOR_FACTOR = 2.0
# A residual of more robust standard deviations is a glitch of the reference.
GLITCH_SIGMA = 8.0
# Chunks for the variance of the score; longer than its correlation.
CHUNK_S = 5.0
# as long as the correlation of a score, so that each parameter has many chunks
FACTOR_CHUNK_S = 1.0
MIN_CHUNKS = 8


@dataclass(frozen=True, slots=True, eq=False)
class CleanedSegment:
    """One segment in time: the gyro over the reference's steps, and the reference."""

    measured: FloatArray  # (n, 3), without the effect of causes
    slope: FloatArray  # (n, 3), of `measured` by the lag
    rate: FloatArray  # (n, 3), body rate, without glitches
    residual: FloatArray  # (n, 3)
    glitches: int


class AttitudeSolver:
    """The iterations of the fit: one gain, and a bias and a time offset of each recording."""

    def __init__(
        self,
        segments: Sequence[AttitudeSegment],
        band_hz: float,
        recording_of_segment: Sequence[int] | None = None,
        effects: Sequence[FloatArray] | None = None,
        lags_s: FloatArray | None = None,
    ) -> None:
        """Start with a coarse time offset of each recording.

        Args:
            segments: of all recordings.
            band_hz: higher frequencies are not used.
            recording_of_segment: number of each segment's recording; None: all of one recording.
            effects: contribution of causes to each segment's mean rates, (n, 3); None: no causes.
            lags_s: initial time offset of each recording, if known.
        """
        self.segments, self.band_hz = tuple(segments), band_hz
        recordings = [0] * len(segments) if recording_of_segment is None else recording_of_segment
        self.recording_of_segment = tuple(recordings)
        self.effects = None if effects is None else tuple(effects)
        count = 1 + max(self.recording_of_segment)
        self.layout = ParameterLayout.of([()], count)
        self.gain, self.biases = np.eye(3), np.zeros((count, 3))
        self.lags_s = np.zeros(count) if lags_s is None else lags_s
        for k in set(self.recording_of_segment) if lags_s is None else ():
            self.lags_s[k] = coarse_lag_s(
                [s for s, r in zip(segments, recordings, strict=True) if r == k]
            )
        self.converged = False
        frequency, self.in_band = [], []
        for segment in segments:
            n = segment.track.begin_s.size
            f = np.arange(n) / (2.0 * n * segment.track.step_s)
            self.in_band.append(f <= band_hz)
            frequency.append(f[self.in_band[-1]])
        self.frequency_hz = np.concatenate(frequency)
        # Share of each residual that the fit removes; the fit has four parameters per axis.
        rows = self.frequency_hz.size
        self._leverage = np.full((rows, 3), min(4.0 / rows, 0.5))
        self.bin = _log_bins(self.frequency_hz)

    def recordings_with_lag(self, linearised: LinearisedModel) -> list[int]:
        """Return the recordings whose motion shows the time offset."""
        lags = [int(self.layout.index(k)[-1]) for k in range(len(self.lags_s))]
        return [k for k, lag in enumerate(lags) if linearised.slope_share(lag) > MIN_SLOPE_SHARE]

    def run(self) -> LinearisedModel:
        """Iterate to convergence and return the last linearisation."""
        self._initialise()
        for _ in range(MAX_ITERATIONS):
            linearised = self.linearise()
            inverse = analyse_scaled_observability(
                linearised.information(), self.layout.prior_std
            ).pseudo_inverse
            self._leverage = linearised.leverage(inverse)
            step = inverse @ linearised.score()
            by_recording = step[GAIN_PARAMETERS:].reshape(-1, SESSION_PARAMETERS)
            self.gain = self.gain + step[:GAIN_PARAMETERS].reshape(3, 3)
            self.biases = self.biases + by_recording[:, :3]
            self.lags_s = np.clip(self.lags_s + by_recording[:, 3], -LAG_LIMIT_S, LAG_LIMIT_S)
            sigma = np.sqrt(np.maximum(np.diag(inverse), 1e-30))
            if float(np.max(np.abs(step) / sigma)) < CONVERGED_SIGMA:
                self.converged = True
                break
        return self.linearise()

    def _initialise(self) -> None:
        """Start with least squares in the band; unexcited axes stay nominal."""
        rate = np.concatenate([segment.track.rate_rad_s for segment in self.segments])
        measured = np.concatenate(
            [self._measured(k, self.lag_s_of(k))[0] for k in range(len(self.segments))]
        )
        lengths = [segment.track.begin_s.size for segment in self.segments]
        recording = np.repeat(self.recording_of_segment, lengths)
        count = len(self.biases)
        design = np.column_stack([rate, (recording[:, None] == np.arange(count)).astype(float)])
        names = ("gain", "gain", "gain", *("bias",) * count)
        ridge = np.diag(prior_std(names) ** -2.0 * float(np.var(measured - rate)))
        nominal = np.vstack([np.eye(3), np.zeros((count, 3))])
        parameters = np.linalg.solve(
            design.T @ design + ridge, design.T @ measured + ridge @ nominal
        )
        self.gain, self.biases = parameters[:3].T.copy(), parameters[3:].copy()
        if abs(np.linalg.det(self.gain)) < 1e-3:
            self.gain = np.eye(3)

    def bias_of(self, segment_index: int) -> FloatArray:
        """Return the bias of a segment's recording, (3,)."""
        return np.asarray(self.biases[self.recording_of_segment[segment_index]], np.float64)

    def lag_s_of(self, segment_index: int) -> float:
        """Return the time offset of a segment's recording."""
        return float(self.lags_s[self.recording_of_segment[segment_index]])

    def _measured(self, segment_index: int, lag_s: float) -> tuple[FloatArray, FloatArray]:
        """Return the mean gyro rates without the effect of causes, and their slope."""
        measured, slope = self.segments[segment_index].mean_rate(lag_s)
        if self.effects is not None:
            measured = measured - self.effects[segment_index]
        return measured, slope

    def linearise(self) -> LinearisedModel:
        """Return residual, derivatives and noise at the current parameters."""
        rates, slopes, constants, residuals, gyro_spectra = [], [], [], [], []
        glitches = 0
        inverse = np.linalg.inv(self.gain)
        for segment_index, in_band in enumerate(self.in_band):
            cleaned = self.clean_segment(segment_index)
            glitches += cleaned.glitches
            constant = dct(self.segments[segment_index].bias_share, norm="ortho")
            # One transform of all columns is faster than four.
            columns = (cleaned.rate, cleaned.slope, cleaned.residual, cleaned.measured)
            spectra = np.split(dct(np.column_stack(columns), axis=0, norm="ortho"), 4, axis=1)
            rates.append(spectra[0][in_band])
            slopes.append(spectra[1][in_band])
            residuals.append(spectra[2][in_band])
            gyro_spectra.append(spectra[3][1:])
            constants.append(constant[in_band])
        residual = np.concatenate(residuals)
        variance = _binned_power(residual**2, self.bin, self.frequency_hz, self._leverage)
        gyro_noise = np.minimum(_gyro_noise_floor(gyro_spectra), variance)
        # share of the residual that comes from the reference
        reference_share = 1.0 - gyro_noise / variance
        rate = np.concatenate(rates) + (reference_share * residual) @ inverse.T
        regressor_noise = (gyro_noise * reference_share) @ (inverse**2).T
        jacobian = np.zeros((residual.shape[0], 3, self.layout.size))
        for i in range(3):
            jacobian[:, i, 3 * i : 3 * i + 3] = rate
        lag_index = np.empty(residual.shape[0], dtype=np.int64)
        first = 0
        for recording, constant, slope in zip(
            self.recording_of_segment, constants, slopes, strict=True
        ):
            part = slice(first, first + constant.size)
            first += constant.size
            session = self.layout.index(recording)[GAIN_PARAMETERS:]
            for i in range(3):
                jacobian[part, i, session[i]] = constant
            # The gyro is sampled at t + tau: the lag moves y, not the model. So the sign is minus.
            jacobian[part, :, session[3]] = -slope
            lag_index[part] = session[3]
        noise_bound = FLOOR_FACTOR * gyro_noise
        slope_noise = noise_bound * (2.0 * np.pi * self.frequency_hz[:, None]) ** 2
        return LinearisedModel(
            residual, jacobian, variance, regressor_noise, slope_noise, lag_index, glitches
        )

    def clean_segment(self, segment_index: int) -> CleanedSegment:
        """Return one segment in time at the current parameters, without glitches.

        Glitches are errors of the reference. They are removed from the rate and the residual.
        """
        segment = self.segments[segment_index]
        measured, slope = self._measured(segment_index, self.lag_s_of(segment_index))
        bias = segment.bias_share[:, None] * self.bias_of(segment_index)
        raw_residual = measured - segment.track.rate_rad_s @ self.gain.T - bias
        clipped, glitches = _clip_glitches(raw_residual, segment.track.rate_rad_s)
        rate = segment.track.rate_rad_s + (raw_residual - clipped) @ np.linalg.inv(self.gain).T
        return CleanedSegment(measured, slope, rate, clipped, glitches)

    def score_inflation(self, linearised: LinearisedModel) -> float:
        """Return the variance of the score over chunks of time, relative to that from the noise.

        It is 1 if the noise is as stationary as the weights assume. Residuals that grow with the
        motion increase it.
        """
        ratios = self._score_ratios(linearised, CHUNK_S)
        return 1.0 if ratios is None else float(np.median(ratios))

    def variance_factors(self, linearised: LinearisedModel) -> FloatArray:
        """Return each parameter's variance relative to that from its information, at least 1, (p,).

        The noise of a reference grows with the motion, so it is largest where the information is
        largest. Source: White, Econometrica 48 (1980) 817, with chunks for the correlation.
        """
        ratios = self._score_ratios(linearised, FACTOR_CHUNK_S)
        return np.ones(self.layout.size) if ratios is None else np.maximum(ratios, 1.0)

    def _score_ratios(self, linearised: LinearisedModel, chunk_s: float) -> FloatArray | None:
        """Return each parameter's variance from scores of chunks over that from the noise, (p,)."""
        scores, first = [], 0
        root = np.sqrt(linearised.variance)
        for segment, in_band in zip(self.segments, self.in_band, strict=True):
            step_count, coefficient_count = segment.track.begin_s.size, int(in_band.sum())
            part = slice(first, first + coefficient_count)
            first += coefficient_count
            white = inverse_band_dct(
                (linearised.residual[part] / root[part])[:, :, None], step_count
            )
            columns = inverse_band_dct(
                linearised.jacobian[part] / root[part][:, :, None], step_count
            )
            product = np.einsum("tij,ti->tj", columns, white[:, :, 0])
            length = max(1, round(chunk_s / segment.track.step_s))
            for begin in range(0, step_count - length // 2, length):
                scores.append(product[begin : begin + length].sum(axis=0))
        if len(scores) < MIN_CHUNKS:
            return None
        spread = np.asarray(scores)
        outer_products = spread.T @ spread
        inverse = np.linalg.pinv(linearised.information() + np.diag(self.layout.prior_std**-2.0))
        robust = np.diag(inverse @ outer_products @ inverse)
        return np.asarray(robust / np.diag(inverse), dtype=np.float64)

    def spectrum(self) -> Spectrum:
        """Return the residual's one-sided density in bins, which is the noise model."""
        residual = self.linearise().residual
        step_s = self.segments[0].track.step_s
        count = np.bincount(self.bin).astype(np.float64)
        centre = np.bincount(self.bin, self.frequency_hz) / count
        power = np.stack([np.bincount(self.bin, residual[:, i] ** 2) for i in range(3)], axis=1)
        return Spectrum(centre, 2.0 * step_s * power / count[:, None], count)

    def band_limit(self, segment_index: int, values: FloatArray) -> FloatArray:
        """Return the part of a series in the band, shape (n, k) as given."""
        in_band = self.in_band[segment_index]
        return inverse_band_dct(dct(values, axis=0, norm="ortho")[in_band], values.shape[0])


def inverse_band_dct(coefficients: FloatArray, n: int) -> FloatArray:
    """Return the series of length n with the given first DCT coefficients, along axis 0."""
    padded = np.zeros((n, *coefficients.shape[1:]))
    padded[: coefficients.shape[0]] = coefficients
    return np.asarray(idct(padded, axis=0, norm="ortho"), dtype=np.float64)


def _log_bins(frequency_hz: FloatArray) -> IntArray:
    """Return a bin number per coefficient: log spaced, with enough coefficients in each bin."""
    order = np.argsort(frequency_hz, kind="stable")
    n = frequency_hz.size
    edges = np.unique(np.rint(np.geomspace(MIN_PER_BIN, n, BINS)).astype(np.int64))
    kept_edges = [int(edges[0])]
    for edge in edges[1:]:
        if edge - kept_edges[-1] >= MIN_PER_BIN:
            kept_edges.append(int(edge))
    kept_edges[-1] = n
    bin_of_coefficient = np.empty(n, dtype=np.int64)
    bin_of_coefficient[order] = np.searchsorted(np.array(kept_edges), np.arange(n), side="right")
    return bin_of_coefficient


def smooth_power(power: FloatArray, frequency_hz: FloatArray) -> FloatArray:
    """Return each coefficient's expected power, (n, 3), smooth over frequency.

    The fit has removed four parameters per axis from the power; this share is added back.

    Args:
        power: shape (n, 3).
        frequency_hz: shape (n,), above zero for most.
    """
    removed = np.full(power.shape, min(4.0 / power.shape[0], 0.5))
    return _binned_power(power, _log_bins(frequency_hz), frequency_hz, removed)


def _binned_power(
    power: FloatArray, bins: IntArray, frequency_hz: FloatArray, leverage: FloatArray
) -> FloatArray:
    """Return each coefficient's expected power: bin means, interpolated linearly in log-log.

    The result is corrected for the share of the power that the fit has removed, `leverage` (n, 3),
    and for weights that are too certain because they come from few values.
    """
    f = np.log(np.maximum(frequency_hz, np.min(frequency_hz[frequency_hz > 0.0])))
    count = np.bincount(bins).astype(np.float64)
    centre = np.bincount(bins, f) / count
    levels = np.empty_like(power)
    for i in range(3):
        free = np.bincount(bins, 1.0 - leverage[:, i]) - min(WEIGHT_FREEDOM, count.min() / 2.0)
        mean = np.maximum(np.bincount(bins, power[:, i]) / free, 1e-30)
        interpolated = np.exp(np.interp(f, centre, np.log(mean)))
        level = np.bincount(bins, power[:, i] / interpolated) / free
        levels[:, i] = interpolated * np.maximum(level, 1e-30)[bins]
    return levels


def _gyro_noise_floor(totals: Sequence[FloatArray]) -> FloatArray:
    """Return an upper bound of the gyro's white noise in DCT variance, shape (3,).

    It is the minimum of the gyro's spectrum, because motion only adds to it.
    """
    lowest = np.full(3, np.inf)
    for total in totals:
        length, longer = divmod(total.shape[0], max(1, total.shape[0] // 64))
        lengths = length + (np.arange(max(1, total.shape[0] // 64)) < longer)
        sums = np.add.reduceat(total**2, np.cumsum(lengths) - lengths, axis=0)
        lowest = np.minimum(lowest, np.min(sums / lengths[:, None], axis=0))
    return lowest


def _clip_glitches(residual: FloatArray, rate: FloatArray) -> tuple[FloatArray, int]:
    """Return the residual with glitches clipped, and their number.

    Markers in motion are noisier, because cameras see them at other angles. Therefore the faster
    half of the motion determines the limit, not the rests.
    """
    speed = np.linalg.norm(rate, axis=1)
    fast = np.abs(residual[speed >= np.median(speed)])
    limit = GLITCH_SIGMA * 1.4826 * np.median(fast, axis=0) + 1e-12
    clipped = np.clip(residual, -limit, limit)
    return clipped, int(np.sum(np.any(clipped != residual, axis=1)))
