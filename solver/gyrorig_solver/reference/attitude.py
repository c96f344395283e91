"""Body rates from a reference attitude: motion capture, a robot arm, a car's pose.

What to use when: `read_attitude` turns what a recording holds into an
`AttitudeReference`; its `tracks()` are the stretches without a gap, each with the mean
body rate between neighbouring attitudes, which is all the reference knows: no
interpolation stands between the attitudes and the fit.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.reference.rotations import integrated_rate, relative_vectors

# A step longer than this many usual steps is a gap (a lost marker, a lost frame).
GAP_STEPS = 1.5
# Shorter tracks hold no more than the edges that the fit drops.
SHORTEST_TRACK = 50
# A quaternion of another length than 1 is not an attitude; rounding stays below this.
LENGTH_TOLERANCE = 0.01
# From this turn per step on, the mean rate between two attitudes depends on the path.
LONG_TURN_RAD = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class RateTrack:
    """Mean body rates between neighbouring attitudes of one stretch without a gap."""

    begin_s: FloatArray  # (n,)
    end_s: FloatArray  # (n,), end of one step is the beginning of the next
    rate_rad_s: FloatArray  # (n, 3), mean over the step, body frame
    step_s: float  # the usual step


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeReference:
    """Attitudes on the capture clock; rows that are not finite are gaps."""

    time_s: FloatArray  # (n,), strictly increasing
    orientation_xyzw: FloatArray  # (n, 4), body into world; nan where lost
    standard_deviation_rad: FloatArray  # (n,), per axis; 0 where it was not said

    def tracks(self, shortest: int = SHORTEST_TRACK) -> list[RateTrack]:
        """Return the stretches of at least `shortest` attitudes without a gap."""
        if self.time_s.size < 2:
            return []
        usual_s = float(np.median(np.diff(self.time_s)))
        found = []
        for first, last in self._stretches(usual_s):
            if last - first < max(shortest, 3):
                continue
            time_s = self.time_s[first:last]
            turns = integrated_rate(relative_vectors(self.orientation_xyzw[first:last]))
            step_s = np.diff(time_s)
            found.append(RateTrack(time_s[:-1], time_s[1:], turns / step_s[:, None], usual_s))
        return found

    def largest_turn_rad(self) -> float:
        """Return the largest turn between neighbouring attitudes of any track."""
        turns = [
            np.linalg.norm(track.rate_rad_s, axis=1) * (track.end_s - track.begin_s)
            for track in self.tracks()
        ]
        return float(max((turn.max() for turn in turns), default=0.0))

    def _stretches(self, usual_s: float) -> list[tuple[int, int]]:
        good = np.all(np.isfinite(self.orientation_xyzw), axis=1)
        joined = good[1:] & good[:-1] & (np.diff(self.time_s) <= GAP_STEPS * usual_s)
        edges = np.diff(np.concatenate([[False], joined, [False]]).astype(np.int8))
        first = np.flatnonzero(edges == 1)
        last = np.flatnonzero(edges == -1) + 1
        return list(zip(first.tolist(), last.tolist(), strict=True))


def read_attitude(
    time_s: FloatArray,
    orientation_xyzw: FloatArray,
    standard_deviation_rad: FloatArray,
) -> AttitudeReference:
    """Return a reference from what a recording holds.

    Args:
        time_s: capture time, shape (n,).
        orientation_xyzw: as recorded, body into world, shape (n, 4); a row that is not
            finite, or not of length 1, is a lost attitude.
        standard_deviation_rad: per axis, shape (n,); negative or not finite reads 0.

    Raises:
        InputError: there is no usable attitude, or time stands still or runs back.
    """
    if time_s.size and not np.all(np.diff(time_s) > 0.0):
        raise InputError(
            "the reference attitude's times stand still or run back",
            "sort them at their source, and import them again",
        )
    length = np.linalg.norm(orientation_xyzw, axis=1)
    sound = np.abs(length - 1.0) < LENGTH_TOLERANCE
    if not sound.any():
        raise InputError(
            "the recording has no reference attitude of length 1", "check its import map"
        )
    orientation = np.where(sound[:, None], orientation_xyzw, np.nan)
    said = np.isfinite(standard_deviation_rad) & (standard_deviation_rad > 0.0)
    return AttitudeReference(time_s, orientation, np.where(said, standard_deviation_rad, 0.0))
