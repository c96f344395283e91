"""Reference body rates from measured attitudes: motion capture, a robot arm, a car's pose.

What to use when: `read_attitude` converts the attitudes of a recording to an `AttitudeReference`;
its `rate_segments()` are segments without a gap, each with the mean body rates between neighbouring
attitudes. The attitudes are not interpolated: if a few frames are missing, the rate is the mean
over the longer step.
"""

from dataclasses import dataclass, replace

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import BoolArray, FloatArray, IntArray
from gyrorig_solver.reference.attitude_stamps import AttitudeStamps, read_stamps
from gyrorig_solver.reference.rotations import integrated_rate, relative_vectors

# A longer step, in frames, is a gap, except for `MAX_BRIDGED_S`.
MAX_GAP_STEPS = 1.5
# Missing frames within this time make one longer step; a longer gap ends a segment.
MAX_BRIDGED_S = 0.1
# The fit discards the edges of a segment; a shorter segment would have no other samples.
MIN_SEGMENT_ATTITUDES = 50
# Tolerance of the length of a quaternion, above rounding errors.
LENGTH_TOLERANCE = 0.01
# Above this turn per step, the mean rate between two attitudes depends on the path.
MAX_MEAN_RATE_TURN_RAD = 0.5
# Jitter of timestamps can swap neighbours, but not attitudes that are further apart.
MAX_DISORDER_S = 0.1
# If an attitude equals the previous one although its neighbours turn by this many times the
# smallest turn between any two attitudes, it was not measured.
MIN_REPEATED_TURN = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class BodyRateSegment:
    """Mean body rates between neighbouring attitudes of one segment without a gap.

    A step over missing frames has one row for each frame, all with the mean over the whole step.
    """

    begin_s: FloatArray  # (n,), of the step
    end_s: FloatArray  # (n,), the end of a step is the beginning of the next
    rate_rad_s: FloatArray  # (n, 3), turn over `duration_s`, body frame
    step_s: float  # median step of a frame
    duration_s: FloatArray  # (n,), divisor of the turns; not the step with jitter
    edge_s: FloatArray  # (n + 1,), edges of the frames, without the jitter of timestamps

    def rows(self, is_used: BoolArray) -> "BodyRateSegment":
        """Return the part from the first to the last of the given rows."""
        first, last = (int(k) for k in np.flatnonzero(is_used)[[0, -1]])
        part = slice(first, last + 1)
        return BodyRateSegment(
            self.begin_s[part],
            self.end_s[part],
            self.rate_rad_s[part],
            self.step_s,
            self.duration_s[part],
            self.edge_s[first : last + 2],
        )


@dataclass(frozen=True, slots=True, eq=False)
class DriftCorrection:
    """Time shifts that were added, because two clocks drift and step."""

    shift_s: FloatArray  # (n,), its mean is zero
    is_cut: BoolArray  # (n,), only a step of a clock follows, no other jump
    has_sawtooth: bool


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeReference:
    """Attitudes on the capture clock; rows that are not finite are gaps."""

    time_s: FloatArray  # (n,), strictly increasing
    orientation_xyzw: FloatArray  # (n, 4), body to world; nan if lost
    standard_deviation_rad: FloatArray  # (n,), per axis; 0 if not specified
    stamps: AttitudeStamps | None = None  # analysis of the recorded timestamps
    repeated: int = 0  # attitudes that equal the previous one in motion; they count as lost
    is_cut: BoolArray | None = None  # (n,), a jump follows: the next row starts another segment
    even_s: FloatArray | None = None  # (n,), times without jitter; None: those of `time_s`
    drift: DriftCorrection | None = None  # in `time_s`

    def alternatives(self) -> list["AttitudeReference"]:
        """Return the reference with each candidate for its times."""
        if self.stamps is None:
            return [self]
        smoothest_s = self.stamps.candidates[0].time_s
        return [
            replace(self, time_s=times.time_s, even_s=None if times.is_even else smoothest_s)
            for times in self.stamps.candidates
        ]

    def without_drift_correction(self) -> "AttitudeReference":
        """Return the reference on its times before the correction of drift and steps."""
        if self.drift is None:
            return self
        is_cut = None if self.is_cut is None else self.is_cut & ~self.drift.is_cut
        return replace(
            self,
            time_s=self.time_s - self.drift.shift_s,
            even_s=None if self.even_s is None else self.even_s - self.drift.shift_s,
            is_cut=None if is_cut is None or not is_cut.any() else is_cut,
            drift=None,
        )

    def rate_segments(self) -> list[BodyRateSegment]:
        """Return the segments of at least `MIN_SEGMENT_ATTITUDES` attitudes without a gap."""
        is_known = np.all(np.isfinite(self.orientation_xyzw), axis=1)
        rows = np.flatnonzero(is_known)
        if self.time_s.size < 2 or rows.size < 2:
            return []
        step_s = float(np.median(np.diff(self.time_s)))
        even_s = self.time_s if self.even_s is None else self.even_s
        if self.stamps is None:
            frames = np.rint(np.diff(self.time_s[rows]) / step_s).astype(np.int64)
        else:
            frames = np.diff(self.stamps.frame[rows])
            step_s = min(step_s, self.stamps.period_s)
        frames = np.maximum(frames, 1)
        longest = max(MAX_GAP_STEPS, 1.0 + MAX_BRIDGED_S / step_s)
        joined = np.diff(even_s[rows]) <= longest * step_s
        if self.is_cut is not None:
            # A cut after any row between two known rows separates these.
            cuts = np.concatenate([[0], np.cumsum(self.is_cut)])
            joined &= cuts[rows[1:]] == cuts[rows[:-1]]
        segments = []
        for first, last in _true_ranges(joined):
            if last - first < MIN_SEGMENT_ATTITUDES:
                continue
            used = rows[first:last]
            segments.append(
                _rate_segment(
                    self.time_s[used],
                    even_s[used],
                    self.orientation_xyzw[used],
                    frames[first : last - 1],
                    float(np.median(np.diff(self.time_s))),
                )
            )
        return segments

    def largest_turn_rad(self) -> float:
        """Return the largest turn between neighbouring attitudes of any segment."""
        turns = [
            np.linalg.norm(segment.rate_rad_s, axis=1) * segment.duration_s
            for segment in self.rate_segments()
        ]
        return float(max((turn.max() for turn in turns), default=0.0))


def _rate_segment(
    time_s: FloatArray,
    even_s: FloatArray,
    orientation_xyzw: FloatArray,
    frames: IntArray,
    step_s: float,
) -> BodyRateSegment:
    duration_s = np.diff(even_s)
    turns = integrated_rate(relative_vectors(orientation_xyzw), duration_s)
    rate = turns / duration_s[:, None]
    # Position of each frame within its step, as a fraction of the step.
    first = np.repeat(np.cumsum(frames) - frames, frames)
    fraction = (np.arange(first.size) - first) / np.repeat(frames, frames)
    edge_s = np.repeat(even_s[:-1], frames) + fraction * np.repeat(duration_s, frames)
    return BodyRateSegment(
        np.repeat(time_s[:-1], frames),
        np.repeat(time_s[1:], frames),
        np.repeat(rate, frames, axis=0),
        step_s,
        np.repeat(duration_s, frames),
        np.append(edge_s, even_s[-1]),
    )


def _true_ranges(joined: BoolArray) -> list[tuple[int, int]]:
    edges = np.diff(np.concatenate([[False], joined, [False]]).astype(np.int8))
    first = np.flatnonzero(edges == 1)
    last = np.flatnonzero(edges == -1) + 1
    return list(zip(first.tolist(), last.tolist(), strict=True))


def read_attitude(
    time_s: FloatArray,
    orientation_xyzw: FloatArray,
    standard_deviation_rad: FloatArray,
    stamp: str = "",
    rate_hz: float | None = None,
) -> AttitudeReference:
    """Return the reference from recorded attitudes.

    Args:
        time_s: timestamps on the capture clock, shape (n,), in the order of the attitudes.
        orientation_xyzw: as recorded, body to world, shape (n, 4); a row that is not finite, or
            not of length 1, is a lost attitude.
        standard_deviation_rad: per axis, shape (n,); negative or not finite means 0.
        stamp: `arrival`, `sampled`, or empty if the recording does not state the kind of
            timestamps.
        rate_hz: the nominal rate of the attitudes, if known.

    Raises:
        InputError: there is no usable attitude, or the times do not increase.
    """
    stamps = read_stamps(time_s, stamp, rate_hz) if time_s.size > 1 else None
    disorder_s = np.maximum.accumulate(time_s) - time_s
    if stamps is not None and (
        np.any(disorder_s > MAX_DISORDER_S)
        or not np.all(np.diff(stamps.candidates[0].time_s) > 0.0)
    ):
        raise InputError(
            "the times of the reference attitude do not increase",
            "sort the source data by time, remove duplicates, and import the data again",
        )
    with np.errstate(over="ignore"):  # of a damaged row; its length is infinite
        length = np.linalg.norm(orientation_xyzw, axis=1)
    is_unit_length = np.abs(length - 1.0) < LENGTH_TOLERANCE
    if not is_unit_length.any():
        raise InputError(
            "none of the reference attitudes in the recording is a quaternion of length 1",
            "check the columns of the quaternion in the import map, and import the data again",
        )
    is_repeated = _repeated_rows(orientation_xyzw, is_unit_length)
    is_usable = is_unit_length & ~is_repeated
    is_given = np.isfinite(standard_deviation_rad) & (standard_deviation_rad > 0.0)
    return AttitudeReference(
        time_s if stamps is None else stamps.candidates[0].time_s,
        np.where(is_usable[:, None], orientation_xyzw, np.nan),
        np.where(is_given, standard_deviation_rad, 0.0),
        stamps,
        int(np.sum(is_repeated)),
    )


def _repeated_rows(orientation_xyzw: FloatArray, is_unit_length: BoolArray) -> BoolArray:
    """Return which rows equal the previous row although the body turns, (n,)."""
    is_same = np.zeros(is_unit_length.size, dtype=np.bool_)
    is_same[1:] = np.all(orientation_xyzw[1:] == orientation_xyzw[:-1], axis=1)
    is_same &= is_unit_length
    if not is_same.any():
        return is_same
    rows = np.flatnonzero(is_unit_length & ~is_same)
    if rows.size < 3:
        return np.zeros_like(is_same)
    turn_rad = np.linalg.norm(relative_vectors(orientation_xyzw[rows]), axis=1)
    smallest_rad = float(np.percentile(turn_rad, 1.0))
    # The larger of the turns before and after a repeated row.
    after = np.clip(np.searchsorted(rows, np.flatnonzero(is_same)), 1, rows.size - 1)
    near_rad = np.maximum(turn_rad[after - 1], turn_rad[np.minimum(after, turn_rad.size - 1)])
    is_moving = np.zeros_like(is_same)
    is_moving[np.flatnonzero(is_same)[near_rad > MIN_REPEATED_TURN * smallest_rad]] = True
    return is_moving
