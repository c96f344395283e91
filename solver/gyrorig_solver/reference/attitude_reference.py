"""Reference body rates from measured attitudes: motion capture, a robot arm, a car's pose.

What to use when: `read_attitude` converts the attitudes of a recording to an
`AttitudeReference`; its `rate_segments()` are segments without a gap, each with the mean
body rates between neighbouring attitudes. The attitudes are not interpolated.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray
from gyrorig_solver.reference.rotations import integrated_rate, relative_vectors

# A longer step, in median steps, is a gap (a lost marker, a lost frame).
MAX_GAP_STEPS = 1.5
# The fit discards the edges of a segment; nothing remains of a shorter one.
MIN_SEGMENT_ATTITUDES = 50
# Tolerance of the length of a quaternion, above rounding errors.
LENGTH_TOLERANCE = 0.01
# Above this turn per step, the mean rate between two attitudes depends on the path.
MAX_MEAN_RATE_TURN_RAD = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class BodyRateSegment:
    """Mean body rates between neighbouring attitudes of one segment without a gap."""

    begin_s: FloatArray  # (n,)
    end_s: FloatArray  # (n,), the end of a step is the begin of the next
    rate_rad_s: FloatArray  # (n, 3), mean over the step, body frame
    step_s: float  # median step


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeReference:
    """Attitudes on the capture clock; rows that are not finite are gaps."""

    time_s: FloatArray  # (n,), strictly increasing
    orientation_xyzw: FloatArray  # (n, 4), body to world; nan if lost
    standard_deviation_rad: FloatArray  # (n,), per axis; 0 if not specified

    def rate_segments(self, min_attitudes: int = MIN_SEGMENT_ATTITUDES) -> list[BodyRateSegment]:
        """Return the segments of at least `min_attitudes` attitudes without a gap."""
        if self.time_s.size < 2:
            return []
        usual_step_s = float(np.median(np.diff(self.time_s)))
        segments = []
        for first, last in self._contiguous_ranges(usual_step_s):
            if last - first < max(min_attitudes, 3):
                continue
            time_s = self.time_s[first:last]
            turns = integrated_rate(relative_vectors(self.orientation_xyzw[first:last]))
            step_s = np.diff(time_s)
            segments.append(
                BodyRateSegment(time_s[:-1], time_s[1:], turns / step_s[:, None], usual_step_s)
            )
        return segments

    def largest_turn_rad(self) -> float:
        """Return the largest turn between neighbouring attitudes of any track."""
        turns = [
            np.linalg.norm(segment.rate_rad_s, axis=1) * (segment.end_s - segment.begin_s)
            for segment in self.rate_segments()
        ]
        return float(max((turn.max() for turn in turns), default=0.0))

    def _contiguous_ranges(self, usual_step_s: float) -> list[tuple[int, int]]:
        is_known = np.all(np.isfinite(self.orientation_xyzw), axis=1)
        joined = (
            is_known[1:] & is_known[:-1] & (np.diff(self.time_s) <= MAX_GAP_STEPS * usual_step_s)
        )
        edges = np.diff(np.concatenate([[False], joined, [False]]).astype(np.int8))
        first = np.flatnonzero(edges == 1)
        last = np.flatnonzero(edges == -1) + 1
        return list(zip(first.tolist(), last.tolist(), strict=True))


def read_attitude(
    time_s: FloatArray,
    orientation_xyzw: FloatArray,
    standard_deviation_rad: FloatArray,
) -> AttitudeReference:
    """Return the reference from recorded attitudes.

    Args:
        time_s: capture time, shape (n,).
        orientation_xyzw: as recorded, body to world, shape (n, 4); a row that is not finite, or
            not of length 1, is a lost attitude.
        standard_deviation_rad: per axis, shape (n,); negative or not finite means 0.

    Raises:
        InputError: there is no usable attitude, or the times do not increase.
    """
    if time_s.size and not np.all(np.diff(time_s) > 0.0):
        raise InputError(
            "the times of the reference attitude do not increase",
            "sort the source data by time, remove duplicates, and import the data again",
        )
    length = np.linalg.norm(orientation_xyzw, axis=1)
    is_unit_length = np.abs(length - 1.0) < LENGTH_TOLERANCE
    if not is_unit_length.any():
        raise InputError(
            "none of the reference attitudes in the recording is a quaternion of length 1",
            "check the columns of the quaternion in the import map, and import the data again",
        )
    orientation = np.where(is_unit_length[:, None], orientation_xyzw, np.nan)
    is_given = np.isfinite(standard_deviation_rad) & (standard_deviation_rad > 0.0)
    return AttitudeReference(time_s, orientation, np.where(is_given, standard_deviation_rad, 0.0))
