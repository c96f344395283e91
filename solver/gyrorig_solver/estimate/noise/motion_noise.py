"""White noise that is larger while the stage moves, from the residual's high frequencies.

The vibration of the motors adds white noise in motion. The variance of one sensor axis, relative to
that at rest, is

    v = 1 + c_0 m + c_1 m_pan + c_2 m_tilt + c_3 (s_pan / S_pan)^2 + c_4 (s_tilt / S_tilt)^2

with m = 1 in motion, m_pan and m_tilt the same of one axis, s the speed and S the largest speed. No
c is negative. Noise must not explain effects of the rig: causes are smooth, or they act at the
starts and stops of moves. Therefore only a part of the residual is used. Its frequencies are near
the sensor's bandwidth. Its samples are at rest or at a constant speed, some time after the last
change of speed. If a program has hardly any constant speeds, constant accelerations are used as
well. v stays exactly 1 unless the excess of this part is significant. If all samples agree with it,
they are used, because they give v more accurately.

What to use when: `estimate_motion_noise` at a converged fit; `relative_variance` for the weights.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import dct, idct
from scipy.optimize import nnls

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.estimate.noise.noise_estimation import SETTLING_TIME_S
from gyrorig_solver.estimate.noise.noise_model import NoiseModel, Sampling, dct_frequencies_hz
from gyrorig_solver.numerics import normal_quantile

FALSE_ALARM = 1e-4  # probability of an excess in a recording without noise in motion
MIN_EXCESS = 0.05  # relative variance: a smaller excess changes a standard deviation by 2 %
MIN_VALUES = 100.0  # independent values at rest and in motion
MOVING_RAD_S = 0.003  # of one axis
# a smaller acceleration, or change of it from sample to sample, counts as zero
STEADY_RAD_S2 = 0.05
# of the samples in motion; with fewer, constant accelerations are used as well
MIN_CONSTANT_SPEED_SHARE = 0.2
LEAD_TIME_S = 0.1  # before a change of speed, for the low-pass and the reference's uncertainty
AGREEMENT_SIGMA = 2.0  # between all samples and those at constant speed
SHAPES = 5
MAX_ROWS = 1 << 19  # of a long recording
CLIP_SIGMA = 3.0
CLIPPED_MEAN = 0.99495  # mean of a squared standard normal value that is clipped there
ITERATIONS = 6


@dataclass(frozen=True, slots=True, eq=False)
class MotionNoise:
    """The relative variance of the white noise in motion, as a function of the motion."""

    coefficients: FloatArray  # (3, 5), c of each sensor axis
    max_speed_rad_s: FloatArray  # (2,), S of pan and tilt

    def relative_variance(self, rate_rad_s: FloatArray) -> FloatArray:
        """Return v, shape (n, 3).

        Args:
            rate_rad_s: of the stage, shape (n, 3).
        """
        shapes = _shapes(axis_speeds(rate_rad_s), self.max_speed_rad_s)
        return np.asarray(1.0 + shapes @ self.coefficients.T, dtype=np.float64)

    def mean_ratios(self, rate_rad_s: FloatArray) -> dict[str, FloatArray]:
        """Return the rms relative noise while the stage, pan and tilt move, (3,) each.

        Args:
            rate_rad_s: of the stage, shape (n, 3).
        """
        variance = self.relative_variance(rate_rad_s)
        moving = axis_speeds(rate_rad_s) > MOVING_RAD_S
        states = {
            "in_motion": moving.any(axis=1),
            "pan_motion": moving[:, 0],
            "tilt_motion": moving[:, 1],
        }
        return {
            name: np.sqrt(variance[mask].mean(axis=0))
            for name, mask in states.items()
            if mask.any()
        }


@dataclass(frozen=True, slots=True, eq=False)
class MotionResidual:
    """The residual and the motion of one series; block means."""

    residual: FloatArray  # (n, 3), zero where unused
    rate_rad_s: FloatArray  # (n, 3), stage
    used: BoolArray  # (n,)
    parts: list[slice]


def axis_speeds(rate_rad_s: FloatArray) -> FloatArray:
    """Return the speeds of pan and tilt for stage rates (n, 3), shape (n, 2).

    The stage rate is (tilt', pan' sin tilt, pan' cos tilt).
    """
    pan = np.hypot(rate_rad_s[:, 1], rate_rad_s[:, 2])
    return np.stack([pan, np.abs(rate_rad_s[:, 0])], axis=1)


def estimate_motion_noise(
    series: Sequence[MotionResidual], noise: NoiseModel
) -> MotionNoise | None:
    """Return the noise in motion; None if no axis has a significant excess.

    Args:
        series: of one recording.
        noise: at rest.
    """
    strict = _Squares.collect(series, noise, _STRICT)
    if strict is None:
        return None
    significant = strict.significant_axes()
    if not significant.any():
        return None
    # All samples give a smaller uncertainty. They are used if no cause contributes to them.
    everything = _Squares.collect(series, noise, _EVERYTHING)
    coefficients = np.zeros((3, SHAPES))
    for axis in np.flatnonzero(significant).tolist():
        coefficients[axis] = strict.fit_axis(axis)
        if everything is not None and everything.agrees_with(strict, axis):
            coefficients[axis] = everything.fit_axis(axis)
    return MotionNoise(coefficients, strict.max_speed_rad_s)


@dataclass(frozen=True, slots=True)
class _Selection:
    """The part of the residual that is used."""

    lower_share: float  # lower limit of the band, relative to the upper one
    ends_at_bandwidth: bool  # otherwise at the Nyquist frequency
    only_steady: bool


_STRICT = _Selection(1.0 / 3.0, ends_at_bandwidth=True, only_steady=True)
_EVERYTHING = _Selection(0.1, ends_at_bandwidth=False, only_steady=False)


@dataclass(frozen=True, slots=True, eq=False)
class _Squares:
    """Squares of the whitened residual in a band, at rest and in motion."""

    squares: FloatArray  # (m, 3), mean 1 if the noise is the model's
    shapes: FloatArray  # (m, 5), zero at rest
    max_speed_rad_s: FloatArray  # (2,)
    std: float  # of the ratio of the means in motion and at rest if the noise is equal

    @classmethod
    def collect(
        cls, series: Sequence[MotionResidual], noise: NoiseModel, selection: _Selection
    ) -> "_Squares | None":
        """Return the values; None if there are too few at rest or in motion."""
        rate_hz = noise.sampling.rate_hz
        speeds = [axis_speeds(residual.rate_rad_s) for residual in series]
        max_speed = np.max([speed.max(axis=0, initial=0.0) for speed in speeds], axis=0)
        stride = max(1, sum(speed.shape[0] for speed in speeds) // MAX_ROWS)
        masks = [residual.used for residual in series]
        if selection.only_steady:
            masks = _choose_steady(speeds, masks, rate_hz)
        squares, shapes = [], []
        for residual, speed, mask in zip(series, speeds, masks, strict=True):
            for part in residual.parts:
                rows = np.flatnonzero(mask[part])[::stride]
                band = _band_signal(residual.residual[part], noise, selection)
                squares.append(band[rows] ** 2)
                shapes.append(_shapes(speed[part][rows], max_speed))
        all_shapes = np.concatenate(shapes)
        gain = _band_gain(np.linspace(0.0, rate_hz / 2.0, 1024), noise.sampling, selection)
        share = min(1.0, stride * float(np.mean(gain**2) ** 2 / np.mean(gain**4)))
        moving = int(np.sum(all_shapes[:, 0] > 0.0))
        counts = share * np.array([moving, all_shapes.shape[0] - moving])
        if counts.min() < MIN_VALUES:
            return None
        std = float(np.sqrt(2.0 * np.sum(1.0 / counts)))
        return cls(np.concatenate(squares), all_shapes, max_speed, std)

    def variance_ratio(self, axis: int) -> float:
        """Return the mean variance in motion over that at rest."""
        moving = self.shapes[:, 0] > 0.0
        at_rest = _clipped_mean(self.squares[~moving, axis])
        return _clipped_mean(self.squares[moving, axis]) / at_rest if at_rest > 0.0 else 1.0

    def significant_axes(self) -> BoolArray:
        """Return which sensor axes have a significant excess in motion, (3,).

        Vibration acts on all axes. The test uses their mean excess, and the excess of each axis.
        """
        excess = np.array([self.variance_ratio(axis) - 1.0 for axis in range(3)])
        limit = normal_quantile(FALSE_ALARM / (1 + excess.size)) * self.std
        if excess.mean() > max(MIN_EXCESS, limit / np.sqrt(excess.size)):
            return np.ones(3, dtype=np.bool_)
        return np.asarray(excess > max(MIN_EXCESS, limit), dtype=np.bool_)

    def agrees_with(self, other: "_Squares", axis: int) -> bool:
        """Return whether the variance in motion is the same within the other's uncertainty."""
        ratio, theirs = self.variance_ratio(axis), other.variance_ratio(axis)
        return abs(ratio - theirs) < AGREEMENT_SIGMA * other.std * theirs

    def fit_axis(self, axis: int) -> FloatArray:
        """Return c of one sensor axis, (5,)."""
        moving = self.shapes[:, 0] > 0.0
        at_rest = _clipped_mean(self.squares[~moving, axis])
        if at_rest <= 0.0:
            return np.zeros(SHAPES)
        return _fit_variance(self.squares[moving, axis] / at_rest, self.shapes[moving])


def _clipped_mean(squares: FloatArray) -> float:
    mean = float(np.mean(squares))
    for _ in range(ITERATIONS):
        mean = float(np.mean(np.minimum(squares, CLIP_SIGMA**2 * mean))) / CLIPPED_MEAN
    return mean


def _fit_variance(squares: FloatArray, shapes: FloatArray) -> FloatArray:
    """Return the coefficients of 1 + shapes c that fit squares of mean 1 at rest, none negative.

    Args:
        squares: in motion, shape (m,).
        shapes: shape (m, k).
    """
    coefficients = np.zeros(shapes.shape[1])
    coefficients[0] = max(float(np.mean(squares)) - 1.0, 0.0)
    for _ in range(ITERATIONS):
        variance = 1.0 + shapes @ coefficients
        clipped = np.minimum(squares, CLIP_SIGMA**2 * variance) / CLIPPED_MEAN
        both = np.column_stack([shapes, clipped - 1.0]) / variance[:, None]
        # The triangle of the QR decomposition has few rows and gives the same solution.
        triangle = np.asarray(np.linalg.qr(both, mode="r"))
        coefficients = np.asarray(nnls(triangle[:, :-1], triangle[:, -1])[0])
    return coefficients


def _choose_steady(
    speeds: Sequence[FloatArray], used: Sequence[BoolArray], rate_hz: float
) -> list[BoolArray]:
    """Return which used samples are at constant speed, or acceleration if those are few."""
    moving = [
        mask & (speed > MOVING_RAD_S).any(axis=1) for speed, mask in zip(speeds, used, strict=True)
    ]
    for constant_acceleration in (False, True):
        masks = [
            steady_mask(speed, rate_hz, constant_acceleration) & mask
            for speed, mask in zip(speeds, used, strict=True)
        ]
        count = sum(int(np.sum(a & b)) for a, b in zip(masks, moving, strict=True))
        if count >= MIN_CONSTANT_SPEED_SHARE * sum(int(mask.sum()) for mask in moving):
            break
    return masks


def steady_mask(
    speed_rad_s: FloatArray, rate_hz: float, constant_acceleration: bool = False
) -> BoolArray:
    """Return which samples are some time away from any change of speed, (n,).

    Args:
        speed_rad_s: of pan and tilt, shape (n, 2).
        rate_hz: of the samples.
        constant_acceleration: only changes of acceleration count, not of speed.
    """
    n = speed_rad_s.shape[0]
    acceleration = np.diff(speed_rad_s, axis=0, append=speed_rad_s[-1:]) * rate_hz
    if constant_acceleration:
        acceleration = np.diff(acceleration, axis=0, prepend=acceleration[:1])
    changes = np.abs(acceleration).max(axis=1) > STEADY_RAD_S2
    lead, settling = round(LEAD_TIME_S * rate_hz), round(SETTLING_TIME_S * rate_hz)
    near = np.convolve(changes, np.ones(lead + settling + 1))[lead : lead + n] > 0.5
    return np.asarray(~near, dtype=np.bool_)


def _shapes(speed_rad_s: FloatArray, max_speed_rad_s: FloatArray) -> FloatArray:
    """Return the functions of the motion that the coefficients multiply, (n, 5)."""
    moving = (speed_rad_s > MOVING_RAD_S).astype(np.float64)
    share = speed_rad_s / np.maximum(max_speed_rad_s, MOVING_RAD_S)
    return np.column_stack([moving.max(axis=1), moving, moving * share**2])


def _band_signal(residual: FloatArray, noise: NoiseModel, selection: _Selection) -> FloatArray:
    """Return a band of the residual in units of its noise, (n, 3)."""
    n = residual.shape[0]
    gain = _band_gain(dct_frequencies_hz(n, noise.sampling.rate_hz), noise.sampling, selection)
    gain /= np.sqrt(np.mean(gain**2))
    spectrum = dct(residual, axis=0, norm="ortho") * (
        gain[:, None] / np.sqrt(noise.dct_variance(n))
    )
    return np.asarray(idct(spectrum, axis=0, norm="ortho"), dtype=np.float64)


def _band_gain(frequency_hz: FloatArray, sampling: Sampling, selection: _Selection) -> FloatArray:
    """Return the gain of a smooth band-pass below the bandwidth or the Nyquist frequency."""
    upper = sampling.rate_hz / 2.0
    if sampling.bandwidth_hz is not None:
        upper = min(upper, sampling.bandwidth_hz)
    lower = selection.lower_share * upper
    rise = np.clip((frequency_hz - 0.5 * lower) / lower, 0.0, 1.0)
    fall = np.clip((upper + 0.5 * lower - frequency_hz) / lower, 0.0, 1.0)
    if not selection.ends_at_bandwidth:
        fall = np.ones_like(frequency_hz)
    return np.asarray(np.sin(0.5 * np.pi * rise) * np.sin(0.5 * np.pi * fall), dtype=np.float64)
