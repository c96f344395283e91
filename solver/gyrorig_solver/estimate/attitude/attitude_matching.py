"""Matching of gyro and reference attitude: means of the gyro over the steps of the reference.

The reference shows only the mean body rate between two attitudes. The gyro has more samples, or is
at least smoother. Therefore the gyro is averaged over the reference's steps (exactly, by the
integral of a cubic spline), and the reference is not interpolated.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline

from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.reference import AttitudeReference
from gyrorig_solver.reference.attitude_reference import BodyRateSegment

# Range of the time offset; it covers a loaded link and a low-pass.
MAX_LAG_S = 0.3
# The spline does not bridge longer gaps of the gyro's samples.
MAX_BRIDGED_PERIODS = 3.5
MIN_BLOCKS = 64
MAX_SPEED_RATIO = 1.5  # of the reference over the gyro
# Sufficient points to separate two lags by correlation.
MAX_CORRELATION_POINTS = 4000


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeSegment:
    """One segment of the reference whose times the gyro covers."""

    track: BodyRateSegment
    rate_spline: CubicSpline[np.float64]  # rate, sensor frame
    angle_spline: CubicSpline[np.float64]  # its integral

    def mean_rate(self, lag_s: float) -> tuple[FloatArray, FloatArray]:
        """Return the mean gyro rate over each step, and its derivative by the lag.

        Args:
            lag_s: delay of the gyro's timestamps after the motion.
        """
        begin, end = self.track.begin_s + lag_s, self.track.end_s + lag_s
        step = self.track.duration_s[:, None]
        mean = (self.angle_spline(end) - self.angle_spline(begin)) / step
        slope = (self.rate_spline(end) - self.rate_spline(begin)) / step
        return np.asarray(mean, dtype=np.float64), np.asarray(slope, dtype=np.float64)

    @property
    def bias_share(self) -> FloatArray:
        """The share of a bias in each mean rate, (n,): 1 without jitter of the timestamps."""
        return np.asarray(
            (self.track.end_s - self.track.begin_s) / self.track.duration_s, dtype=np.float64
        )


def match_segments(samples: GyroSamples, reference: AttitudeReference) -> list[AttitudeSegment]:
    """Return every segment in which neither gyro nor reference has a gap.

    Args:
        samples: of one board, times on the reference's axis.
        reference: attitudes; the gyro must cover a margin of `MAX_LAG_S` on both sides.
    """
    good = samples.usable
    time_s, rate = samples.time_s[good], samples.rate_rad_s[good]
    segment = samples.segment[good]
    step = np.diff(time_s)
    is_gap = (
        (np.diff(segment) != 0) | (step > MAX_BRIDGED_PERIODS * samples.period_s) | (step <= 0.0)
    )
    bounds = np.concatenate([[0], np.flatnonzero(is_gap) + 1, [time_s.size]])
    # The tracks of all segments of the gyro are parts of the same arrays.
    tracks = reference.rate_segments()
    segments = []
    for first, last in pairwise(bounds.tolist()):
        if last - first < MIN_BLOCKS:
            continue
        rate_spline = CubicSpline(time_s[first:last], rate[first:last])
        low, high = time_s[first] + MAX_LAG_S, time_s[last - 1] - MAX_LAG_S
        for track in tracks:
            inside = (track.begin_s >= low) & (track.end_s <= high)
            if inside.sum() >= MIN_BLOCKS:
                segments.append(
                    AttitudeSegment(track.rows(inside), rate_spline, rate_spline.antiderivative())
                )
    return segments


def coarse_lag_s(segments: Sequence[AttitudeSegment]) -> float:
    """Return the lag of maximum correlation of the two speeds, over all segments together.

    A single segment can be at rest, which shows no lag. Speeds do not depend on the mount of the
    sensor. The steps are one reference step or 10 ms, whichever is longer; the fit refines the
    result.
    """
    count = sum(segment.track.begin_s.size for segment in segments)
    stride = slice(None, None, max(1, count // MAX_CORRELATION_POINTS))
    middles_s = [0.5 * (s.track.begin_s + s.track.end_s)[stride] for s in segments]
    reference_speed = np.concatenate(
        [np.linalg.norm(segment.track.rate_rad_s[stride], axis=1) for segment in segments]
    )
    # The board is never much faster than the gyro shows; larger speeds are outliers.
    fastest = np.max(_gyro_speed(segments, middles_s, 0.0))
    reference_speed = np.minimum(reference_speed, MAX_SPEED_RATIO * fastest)
    reference_speed = reference_speed - reference_speed.mean()
    step_s = max(0.01, *(segment.track.step_s for segment in segments))
    max_lag_steps = int(0.9 * MAX_LAG_S / step_s)
    lags = np.arange(-max_lag_steps, max_lag_steps + 1) * step_s
    scores = []
    for lag_s in lags:
        gyro_speed = _gyro_speed(segments, middles_s, lag_s)
        gyro_speed = gyro_speed - gyro_speed.mean()
        scores.append(
            float(reference_speed @ gyro_speed) / (float(np.linalg.norm(gyro_speed)) + 1e-30)
        )
    return float(lags[int(np.argmax(scores))])


def _gyro_speed(
    segments: Sequence[AttitudeSegment], middles_s: Sequence[FloatArray], lag_s: float
) -> FloatArray:
    """Return the speed of the gyro at the given times of each segment plus a lag, rad/s, (n,)."""
    rates = [s.rate_spline(t + lag_s) for s, t in zip(segments, middles_s, strict=True)]
    return np.asarray(np.linalg.norm(np.concatenate(rates), axis=1), dtype=np.float64)
