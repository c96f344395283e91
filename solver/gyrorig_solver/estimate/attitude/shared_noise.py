"""Whether reference attitudes repeat the noise of the gyro, because they were computed from it.

Attitudes of another instrument have other noise, so that gyro and reference differ by at least the
noise of the gyro, about every direction of the world. Attitudes that were integrated from the
gyro do not. A filter that corrects them with an accelerometer changes only the direction of
gravity: the heading is the integral of the gyro, with its noise sample by sample. So the turns
about the vertical show what was computed. The fit to such attitudes gives a gain of one and a part
of the bias, for every gyro.

What to use when: `shared_noise_reasons` after a fit to reference attitudes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.fft import dct, idct
from scipy.spatial.transform import Rotation

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate.attitude.attitude_matching import AttitudeSegment
from gyrorig_solver.estimate.attitude.attitude_solver import AttitudeSolver
from gyrorig_solver.reference import AttitudeReference

CHUNK = 64  # coefficients of a mean power
MIN_CHUNKS = 4
# Of the power of the noise. Exact references have 0.47 or more, most computed ones less than 0.1
# (`tests/unit/references/test_computed_attitudes.py`).
MAX_RESIDUAL_SHARE = 0.2
# The noise is known only if it is white above the used frequencies, up to this multiple of the
# reference's: at least this share of the chunks has less than the given power of the lowest one.
# If the power falls, a motion can hide a smaller noise. If it grows, the noise is smaller below.
HIGHER_BAND = 4.0
MIN_WHITE_SHARE = 0.5
MAX_WHITE_RATIO = 3.0
MAX_QUIET_RATIO = 4.0  # to the noise, of a chunk without motion
MAX_TESTED_RATIO = 8.0  # to the noise, of a chunk with little motion
MIN_CALM_SHARE = 0.5
TIME_PARTS = 20  # the window rises in the first one and falls in the last one
MAX_SAMPLES = 1 << 15
MAX_INTEGRAL_SAMPLES = 1 << 17
MAX_INTEGRAL_SHARE = 0.1  # of the gyro's power; without shared noise the share is at least 1
# Frequencies for the fit of gain and bias. Noise alone would decrease the gain, and below the
# lowest frequency the estimate of a bias by a filter changes.
MIN_MOTION_RATIO = 100.0  # of the gyro's power over its noise
MIN_FIT_HZ = 0.2
MIN_FIT_ROWS = 64
# Highest frequency, of the gyro's highest one. Above it, the mean of the gyro over a step depends
# on the interpolation between its samples.
MAX_FREQUENCY_SHARE = 1.0 / 3.0
SHARED_NOISE = (
    "the reference attitudes repeat the noise of the gyroscope, so they were computed from its "
    "rates and do not show its errors: the values are those of the attitudes' computation. Use "
    "attitudes of another instrument"
)


@dataclass(frozen=True, slots=True, eq=False)
class _GyroNoise:
    """The gyro's noise in the power of a step's mean rate."""

    power: float  # of the quietest axis, 0 if it is not known
    is_quiet: BoolArray  # (chunks,), used chunks without motion
    is_tested: BoolArray  # (chunks,), those with little motion; a slow reference may have none: all
    is_motion: BoolArray  # (n,), frequencies of the reference that show gain and bias
    calm_part: int  # of the time, in which the board turns least
    calm_power: float  # of the quietest axis in this part and the quiet chunks; 0: not known


@dataclass(frozen=True, slots=True, eq=False)
class _TurnDifference:
    """Turns by the gyro minus turns by the reference, as rates in the frame of the world."""

    rate_rad_s: FloatArray  # (n, 3)
    derivatives: FloatArray  # (n, 3, 13), by the inverse gain, the bias and the time offset
    attitude: Rotation  # body to world at the begin of each step

    def least_share(self, direction: FloatArray, noise: _GyroNoise) -> float:
        """Return the least power about a direction over that of the noise, after a fit.

        It is the least one of all chunks of frequencies, and of the time with the least motion:
        Madgwick's filter multiplies the rates by a random factor, so that it repeats them best
        at rest.
        """
        rate = _spectrum(self.rate_rad_s @ direction)
        if np.sum(noise.is_motion) > MIN_FIT_ROWS:
            design = _spectrum(np.einsum("i,nij->nj", direction, self.derivatives))
            fitted = design[noise.is_motion]
            scale = np.linalg.norm(fitted, axis=0) + 1e-300
            step = np.linalg.lstsq(fitted / scale, rate[noise.is_motion], rcond=1e-9)[0] / scale
            rate = rate - design @ step
        share = float(
            _chunk_powers(rate)[: noise.is_tested.size][noise.is_tested].min() / noise.power
        )
        if noise.calm_power == 0.0:
            return share
        parts = _part_powers(_band_series(rate, noise.is_quiet))
        return min(share, float(parts[noise.calm_part] / noise.calm_power))

    def quietest_direction(self) -> FloatArray:
        """Return the direction of the smallest difference in the second quarter of the band."""
        n = len(self.rate_rad_s)
        spectrum = _spectrum(self.rate_rad_s)[n // 4 : n // 2]
        return np.asarray(np.linalg.eigh(spectrum.T @ spectrum)[1][:, 0], dtype=np.float64)


def shared_noise_reasons(
    solver: AttitudeSolver, recordings: Sequence[tuple[GyroSamples, AttitudeReference]]
) -> tuple[str, ...]:
    """Return the reason to refuse a calibration if the attitudes were computed from the gyro.

    Args:
        solver: of the converged fit; its longest segment is tested.
        recordings: samples and attitudes on the times of the fit.
    """
    lengths = [segment.track.begin_s.size for segment in solver.segments]
    longest = int(np.argmax(lengths))
    if lengths[longest] <= MIN_CHUNKS * CHUNK:
        return ()
    gyro, reference = recordings[solver.recording_of_segment[longest]]
    if _is_integral(solver, longest, gyro):
        return (SHARED_NOISE,)
    segment = solver.segments[longest]
    count = min(segment.track.begin_s.size, MAX_SAMPLES // _parts(segment, gyro.period_s))
    measured = segment.mean_rate(solver.lag_s_of(longest))[0][:count]
    noise = _gyro_noise(gyro, segment, measured, solver.bias_of(longest))
    if noise.power == 0.0:
        return ()
    difference = _turn_difference(solver, longest, count, gyro.period_s, reference)
    directions = [*np.eye(3)[::-1], difference.quietest_direction()]
    upward = _upward(gyro, segment, difference.attitude)
    if upward is not None:
        directions.append(upward)
    least_share = min(difference.least_share(each, noise) for each in directions)
    return (SHARED_NOISE,) if least_share < MAX_RESIDUAL_SHARE else ()


def _is_integral(solver: AttitudeSolver, number: int, samples: GyroSamples) -> bool:
    """Return whether the residual is far smaller than the gyro's rate at every frequency.

    Attitudes without corrections show this also if a motion hides most of the noise. Only the lower
    half of the frequencies is used, because of the interpolation between the samples.
    """
    cleaned, track = solver.clean_segment(number), solver.segments[number].track
    if len(cleaned.measured) // 2 <= MIN_CHUNKS * CHUNK:
        return False
    gyro, residual = (
        _chunk_powers(dct(series, axis=0, norm="ortho")[: len(series) // 2])
        for series in (cleaned.measured, cleaned.residual)
    )
    longest = max(samples.contiguous_slices(1), key=lambda rows: rows.stop - rows.start)
    rows = slice(longest.start, min(longest.stop, longest.start + MAX_INTEGRAL_SAMPLES))
    powers = _chunk_powers(dct(samples.gyro.values(rows), axis=0, norm="ortho"))
    white = powers.min(axis=0) if len(powers) else np.zeros(3)
    per_step = min(samples.period_s / track.step_s, 1.0)
    is_quiet = gyro.min(axis=0) < MAX_QUIET_RATIO * per_step * white
    is_repeated = np.max(residual / np.maximum(gyro, 1e-30), axis=0) < MAX_INTEGRAL_SHARE
    return bool(np.all(is_quiet & is_repeated))


def _parts(segment: AttitudeSegment, period_s: float) -> int:
    """Return the number of samples in a step of the reference."""
    return max(1, round(segment.track.step_s / period_s))


def _turn_difference(
    solver: AttitudeSolver, number: int, count: int, period_s: float, reference: AttitudeReference
) -> _TurnDifference:
    """Return the differences of the first steps of a segment, at the fit.

    The gyro's rates are integrated in steps of a sample, because a filter does so. A mean rate over
    a long step is another turn if the axis moves.
    """
    segment = solver.segments[number]
    track, parts = segment.track, _parts(segment, period_s)
    begin_s, end_s, duration_s = (
        each[:count, None] for each in (track.begin_s, track.end_s, track.duration_s)
    )
    at_s = begin_s + (end_s - begin_s) * np.arange(parts + 1) / parts + solver.lag_s_of(number)
    angle = np.diff(segment.angle_spline(at_s), axis=1)
    slope = np.diff(segment.rate_spline(at_s), axis=1)
    inverse, part_s = np.linalg.inv(solver.gain), duration_s / parts
    bias_rad = part_s * (inverse @ solver.bias_of(number))
    turn, derivatives = Rotation.identity(count), np.zeros((count, 3, 13))
    for k in range(parts):
        part = angle[:, k] @ inverse.T - bias_rad
        middle = (turn * Rotation.from_rotvec(0.5 * part)).as_matrix()
        by_gain = middle[:, :, :, None] * angle[:, k][:, None, None, :]
        derivatives[:, :, :9] += by_gain.reshape(count, 3, 9)
        derivatives[:, :, 9:12] += middle * part_s[:, :, None]
        derivatives[:, :, 12] += np.einsum("nij,nj->ni", middle, slope[:, k] @ inverse.T)
        turn = turn * Rotation.from_rotvec(part)
    first, last = np.searchsorted(reference.time_s, np.stack([begin_s[:, 0], end_s[:, 0]]))
    attitude = Rotation.from_quat(reference.orientation_xyzw[first])
    after = Rotation.from_quat(reference.orientation_xyzw[last])
    # A filter corrects its attitude before or in the middle of a sample's turn.
    to_world = (attitude * Rotation.from_rotvec(-turn.as_rotvec() / (2 * parts))).as_matrix()
    difference = (turn * after.inv() * attitude).as_rotvec() / duration_s
    return _TurnDifference(
        np.einsum("nij,nj->ni", to_world, difference),
        np.einsum("nij,njk->nik", to_world, derivatives) / duration_s[:, :, None],
        attitude,
    )


def _upward(
    samples: GyroSamples, segment: AttitudeSegment, attitude: Rotation
) -> FloatArray | None:
    """Return the mean direction of the specific force in the world; None without accelerations."""
    if samples.accel_m_s2 is None:
        return None
    at = np.searchsorted(samples.time_s, segment.track.begin_s[: len(attitude)])
    force = attitude.apply(samples.accel_m_s2[np.minimum(at, samples.time_s.size - 1)])
    mean = np.mean(force[np.all(np.isfinite(force), axis=1)], axis=0)
    length = float(np.linalg.norm(mean))
    return np.asarray(mean / length, np.float64) if length > 0.0 else None


def _gyro_noise(
    samples: GyroSamples, segment: AttitudeSegment, measured: FloatArray, bias_rad_s: FloatArray
) -> _GyroNoise:
    """Return the white noise of a gyro during a segment.

    It is the lowest mean power of a chunk of the samples. Motion and vibration increase it only if
    they are at all frequencies.

    Args:
        samples: of the recording.
        segment: of the reference.
        measured: mean rate of the gyro over each step, (n, 3).
        bias_rad_s: of the fit, (3,).
    """
    none = np.zeros(0, np.bool_)
    track, unknown = segment.track, _GyroNoise(0.0, none, none, none, 0, 0.0)
    is_inside = (samples.time_s >= track.begin_s[0]) & (samples.time_s <= track.end_s[-1])
    rows = np.flatnonzero(is_inside & samples.usable)[:MAX_SAMPLES]
    powers = _chunk_powers(_spectrum(samples.rate_rad_s[rows]))
    chunk_hz = CHUNK / (2.0 * rows.size * samples.period_s)
    reference_hz = 0.5 / track.step_s
    powers = powers[: int(HIGHER_BAND * reference_hz / chunk_hz)]
    if len(powers) < MIN_CHUNKS:
        return unknown
    lowest = powers.min(axis=0)
    per_step = min(samples.period_s / track.step_s, 1.0)
    spectrum = _spectrum(measured)
    step_hz = 1.0 / (2.0 * len(measured) * track.step_s)
    used_hz = min(0.5 * MAX_FREQUENCY_SHARE / samples.period_s, reference_hz)
    higher = powers[int(used_hz / chunk_hz) :]
    is_white = np.mean(higher < MAX_WHITE_RATIO * lowest, axis=0) >= MIN_WHITE_SHARE
    if not np.all(is_white):
        return unknown
    used = _chunk_powers(spectrum)[: int(used_hz / (CHUNK * step_hz))]
    ratio = np.max(used / (per_step * lowest), axis=1)
    is_quiet, is_tested = ratio < MAX_QUIET_RATIO, ratio < MAX_TESTED_RATIO
    if not is_tested.any():
        if reference_hz > used_hz:
            return unknown  # the motion could hide a smaller noise at all of these frequencies
        is_tested = np.ones_like(is_tested)
    ratios = np.mean(spectrum**2 / (per_step * lowest), axis=1)
    motion_ratio = np.convolve(ratios, np.full(CHUNK, 1.0 / CHUNK), mode="same")
    frequency_hz = step_hz * np.arange(len(measured))
    is_motion = (motion_ratio > MIN_MOTION_RATIO) & (frequency_hz > MIN_FIT_HZ)
    calm = int(np.argmin(np.sum(_part_powers(measured - bias_rad_s), axis=1)))
    part_powers = _part_powers(_band_series(spectrum, is_quiet))
    # The noise of rounded samples is smaller at rest, where they do not change.
    is_steady = np.all(part_powers[calm] > MIN_CALM_SHARE * np.median(part_powers, axis=0))
    calm_power = float(part_powers[calm].min()) if is_quiet.any() and is_steady else 0.0
    return _GyroNoise(
        power=per_step * float(lowest.min()),
        is_quiet=is_quiet,
        is_tested=is_tested,
        is_motion=is_motion,
        calm_part=calm,
        calm_power=calm_power,
    )


def _band_series(spectrum: FloatArray, is_used: BoolArray) -> FloatArray:
    """Return the series of some chunks of a spectrum."""
    used = np.zeros_like(spectrum)
    rows = 1 + np.flatnonzero(np.repeat(is_used, CHUNK))
    used[rows] = spectrum[rows]
    return np.asarray(idct(used, axis=0, norm="ortho"), dtype=np.float64)


def _part_powers(series: FloatArray) -> FloatArray:
    """Return the mean power in each part of the time, without the ends under the window."""
    edges = np.linspace(0, len(series), TIME_PARTS + 1).astype(np.int64)[1:-1]
    return np.stack([np.mean(series[i:j] ** 2, axis=0) for i, j in pairwise(edges.tolist())])


def _spectrum(series: FloatArray) -> FloatArray:
    """Return the cosine transform of a series along axis 0, under a window.

    Without a window, a motion at the begin or the end of the series has power at all frequencies.
    """
    count = len(series)
    from_end = np.minimum(np.arange(count), np.arange(count)[::-1]) * (TIME_PARTS / count)
    window = 0.5 - 0.5 * np.cos(np.pi * np.minimum(from_end, 1.0))  # Tukey's
    shape = (-1, *[1] * (series.ndim - 1))
    return np.asarray(dct(series * window.reshape(shape), axis=0, norm="ortho"), dtype=np.float64)


def _chunk_powers(coefficients: FloatArray) -> FloatArray:
    """Return the mean power of chunks of frequencies, (chunks, ...), without the constant."""
    power = coefficients[1:] ** 2
    count = len(power) // CHUNK
    chunks = power[: count * CHUNK].reshape(count, CHUNK, *power.shape[1:])
    return np.asarray(chunks.mean(axis=1), np.float64)
