"""Gyro and reference attitude brought together, step by step of the reference.

The reference knows the mean body rate between two attitudes and nothing in between; the
gyro is the denser or at least the smoother of the two, so the gyro is averaged over the
reference's steps (exactly, through a cubic spline's integral), not the other way round.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicSpline

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.reference.attitude import AttitudeReference, RateTrack
from gyrorig_solver.samples import GyroSamples

# The time offset is looked for within this range; it covers a loaded link and a low-pass.
SEARCH_S = 0.3
# A hole in the gyro's samples of more periods than this is not bridged by the spline.
BRIDGED_PERIODS = 3.5
SHORTEST_BLOCKS = 64
# Points enough to tell one lag from the next by correlation.
COARSE_POINTS = 4000


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """One track of the reference, with a gyro that covers it."""

    track: RateTrack
    gyro: CubicSpline[np.float64]  # rate, sensor frame
    angle: CubicSpline[np.float64]  # its integral

    def measured(self, lag_s: float) -> tuple[FloatArray, FloatArray]:
        """Return mean gyro rate over each step, and its derivative by the lag.

        Args:
            lag_s: how much later than the motion the gyro's stamps are.
        """
        begin, end = self.track.begin_s + lag_s, self.track.end_s + lag_s
        step = (self.track.end_s - self.track.begin_s)[:, None]
        mean = (self.angle(end) - self.angle(begin)) / step
        slope = (self.gyro(end) - self.gyro(begin)) / step
        return np.asarray(mean, dtype=np.float64), np.asarray(slope, dtype=np.float64)


def match(samples: GyroSamples, reference: AttitudeReference) -> list[Stretch]:
    """Return every stretch where both the gyro and the reference have no hole.

    Args:
        samples: of one board, times on the reference's axis.
        reference: attitudes; a margin of `SEARCH_S` of gyro is kept on both sides.
    """
    keep = samples.good
    time_s, rate = samples.time_s[keep], samples.rate_rad_s[keep]
    segment = samples.segment[keep]
    step = np.diff(time_s)
    hole = (np.diff(segment) != 0) | (step > BRIDGED_PERIODS * samples.period_s) | (step <= 0.0)
    bounds = np.concatenate([[0], np.flatnonzero(hole) + 1, [time_s.size]])
    found = []
    for first, last in pairwise(bounds.tolist()):
        if last - first < SHORTEST_BLOCKS:
            continue
        gyro = CubicSpline(time_s[first:last], rate[first:last])
        low, high = time_s[first] + SEARCH_S, time_s[last - 1] - SEARCH_S
        for track in reference.tracks():
            inside = (track.begin_s >= low) & (track.end_s <= high)
            if inside.sum() >= SHORTEST_BLOCKS:
                part = RateTrack(
                    track.begin_s[inside],
                    track.end_s[inside],
                    track.rate_rad_s[inside],
                    track.step_s,
                )
                found.append(Stretch(part, gyro, gyro.antiderivative()))
    return found


def coarse_lag_s(stretches: Sequence[Stretch]) -> float:
    """Return the lag at which the lengths of both rates are most alike.

    Lengths do not depend on how the sensor is mounted. Steps of one reference step or
    10 ms, whichever is longer; the fit goes on from there.
    """
    track = max(stretches, key=lambda s: s.track.begin_s.size)
    count = track.track.begin_s.size
    some = slice(None, None, max(1, count // COARSE_POINTS))
    middle = 0.5 * (track.track.begin_s + track.track.end_s)[some]
    turning = np.linalg.norm(track.track.rate_rad_s[some], axis=1)
    turning = turning - turning.mean()
    step_s = max(track.track.step_s, 0.01)
    reach = int(0.9 * SEARCH_S / step_s)
    lags = np.arange(-reach, reach + 1) * step_s
    scores = []
    for lag_s in lags:
        length = np.linalg.norm(track.gyro(middle + lag_s), axis=1)
        length = length - length.mean()
        scores.append(float(turning @ length) / (float(np.linalg.norm(length)) + 1e-30))
    return float(lags[int(np.argmax(scores))])
