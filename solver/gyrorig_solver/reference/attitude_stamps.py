"""Times of a camera's frames from the timestamps of its attitudes.

A timestamp is not the time of an attitude: it jitters, or it is the time at which the attitude
arrived. But most references are frames of a camera at a regular rate. So each attitude gets the
number of its frame, and a smooth clock over the frame numbers gives its time. If the timestamps are
late by a delay that is never negative, this clock is their lower envelope, else their mean. The
timestamps alone do not show how smooth the clock is, or whether the frames are regular. The fit to
the gyro decides between the candidates (`estimate.attitude`).
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray, IntArray
from gyrorig_solver.data.clocks.latency_floor import MAX_LINE_SPAN_S, find_latency_floor
from gyrorig_solver.reference.least_delay import line_error

# Timestamps with less jitter, in frame periods, are used as times.
MAX_EXACT_JITTER = 0.002
# Jitter above this share of a period hides which frame is missing at a single timestamp.
MAX_CLEAR_JITTER = 0.12
STALL_FRAMES = 32  # a link that stalls for longer looks as if it had lost frames
SMOOTHING_S = (10.0, 1.0, 0.3)  # of the clock, if it is not a line
# Half-normal delays have a skewness of 1.0, exponential ones of 2, symmetric jitter none.
MIN_LATE_SKEWNESS = 0.5
MIN_STAMPS = 50
_BLOCK_STAMPS, _LOW_PERCENT, _EARLY_SHARE = 200, 3.0, 0.4  # of `_is_too_early`
_MIN_JITTER = 0.02  # of a period, for sums
_LOOP_GAIN = 0.05  # of the running offset in `number_frames`
_MIN_JUMP = 0.5  # of a period; a larger jump is a missing frame
# Jitter of a period above which the numbers are uncertain: symmetric, and of late timestamps.
_MAX_HIDDEN_JITTER, _MAX_HIDDEN_DELAY = 0.25, 0.65
_TRIED_MISSING = (0.005, 0.01, 0.02, 0.03, 0.05, 0.1)  # shares of frames
_CUSUM_NATS = 16.0  # a false jump in ten million frames
_MAX_EXCESS = 1.15  # of the scatter about a line relative to that about a running mean


@dataclass(frozen=True, slots=True, eq=False)
class FrameTimes:
    """One candidate for the times of the attitudes."""

    description: str
    time_s: FloatArray  # (n,), strictly increasing
    is_even: bool = True  # False: with the jitter of the timestamps


@dataclass(frozen=True, slots=True, eq=False)
class AttitudeStamps:
    """Results of the analysis of a reference's timestamps."""

    stamp_s: FloatArray  # (n,), as recorded
    frame: IntArray  # (n,), the number of each attitude's frame, strictly increasing
    period_s: float
    jitter_s: float  # standard deviation of the timestamps about a smooth clock
    is_late: bool  # the timestamps are late by a delay that changes
    offset_std_s: float  # of the common offset of the times
    candidates: tuple[FrameTimes, ...]  # the smoothest clock first; one if the timestamps are times
    is_resolved: bool = True  # False: jitter hides which frames are missing

    @property
    def missing(self) -> int:
        """The number of frames without an attitude."""
        return int(self.frame[-1] - self.frame[0]) + 1 - self.frame.size


def read_stamps(
    stamp_s: FloatArray, stamp: str = "", nominal_hz: float | None = None
) -> AttitudeStamps:
    """Return the frames of a series of timestamps.

    Args:
        stamp_s: in the order of the frames, shape (n,); neighbours can be equal or swapped.
        stamp: `arrival`, `sampled`, or empty if the recording does not state their kind.
        nominal_hz: the rate of the frames, if known.
    """
    period_s = _frame_period(stamp_s) if nominal_hz is None else 1.0 / nominal_hz
    is_increasing = bool(np.all(np.diff(stamp_s) > 0.0))
    as_recorded = FrameTimes("the timestamps as recorded", stamp_s)
    frame = np.arange(stamp_s.size, dtype=np.int64)
    if stamp_s.size < MIN_STAMPS or period_s <= 0.0:
        return AttitudeStamps(stamp_s, frame, max(period_s, 1e-9), 0.0, False, 0.0, (as_recorded,))
    step_s = np.diff(stamp_s)
    jitter_s = 1.4826 * float(np.median(np.abs(step_s - np.median(step_s)))) / np.sqrt(2.0)
    is_resolved, is_hidden = True, False
    if jitter_s < MAX_CLEAR_JITTER * period_s:
        frame, _, _ = min(
            (_number_from(stamp_s, period_s, jitter_s, by_least) for by_least in (True, False)),
            key=lambda numbered: numbered[1],
        )
    elif not _is_line(stamp_s, frame):
        is_hidden = True
        hidden = _number_hidden(stamp_s, period_s, jitter_s)
        frame, is_resolved = (frame, False) if hidden is None else hidden
    period_s = _regression_period(stamp_s, frame)
    offset_s = stamp_s - period_s * frame
    scatter_s = offset_s - _running_mean(offset_s, max(5, round(1.0 / period_s)))
    middle_s = float(np.median(scatter_s))
    jitter_s = 1.4826 * float(np.median(np.abs(scatter_s - middle_s)))
    if is_increasing and jitter_s < MAX_EXACT_JITTER * period_s:
        return AttitudeStamps(stamp_s, frame, period_s, jitter_s, False, 0.0, (as_recorded,))
    near = np.clip(scatter_s - middle_s, -5.0 * jitter_s, 5.0 * jitter_s)
    deviation_s = max(float(np.std(near)), 1e-12)
    skewness = float(np.mean((near - near.mean()) ** 3)) / deviation_s**3
    is_late = stamp == "arrival" or (stamp == "" and skewness > MIN_LATE_SKEWNESS)
    candidates, offset_std_s = _candidates(stamp_s, frame, period_s, deviation_s, is_late)
    if is_hidden:
        offset_std_s = float(np.hypot(offset_std_s, period_s))
    if is_increasing:
        shift_s = float(np.mean(candidates[0].time_s - stamp_s)) if is_late else 0.0
        candidates.append(FrameTimes(as_recorded.description, stamp_s + shift_s, False))
    return AttitudeStamps(
        stamp_s, frame, period_s, deviation_s, is_late, offset_std_s, tuple(candidates), is_resolved
    )


def _number_hidden(
    stamp_s: FloatArray, period_s: float, jitter_s: float
) -> tuple[IntArray, bool] | None:
    """Return frame numbers if jitter hides which frames are missing, and whether they are certain.

    The period is less well known in this case. Several periods are tried, and the most likely
    numbers are returned; None if no period gives timestamps on a line.
    """
    mean_s = float(stamp_s[-1] - stamp_s[0]) / (stamp_s.size - 1)
    numbered = [
        (*_number_from(stamp_s, start_s, jitter_s, by_least), by_least)
        for start_s in (period_s, *(mean_s * (1.0 - share) for share in _TRIED_MISSING))
        for by_least in (True, False)
    ]
    likely = [each for each in numbered if _is_line(stamp_s, each[0])]
    if not likely:
        return None
    frame, _, found_s, by_least = min(likely, key=lambda each: each[1])
    largest_share = _MAX_HIDDEN_DELAY if by_least else _MAX_HIDDEN_JITTER
    return frame, jitter_s < largest_share * found_s


def _number_from(
    stamp_s: FloatArray, period_s: float, jitter_s: float, by_least: bool
) -> tuple[IntArray, float, float]:
    """Return the numbers of frames from a first period, their cost in nats, and the period."""
    frame = np.zeros(0, np.int64)
    for _ in range(3):
        frame = number_frames(stamp_s, period_s, jitter_s, by_least)
        period_s = _regression_period(stamp_s, frame)
    delay_s = stamp_s - period_s * frame
    scatter_s = delay_s - _robust_line(frame.astype(np.float64), delay_s, max(jitter_s, 1e-9))
    missing = int(frame[-1] - frame[0]) + 1 - frame.size
    cost = frame.size * float(np.log(np.std(scatter_s) + 1e-9)) + _CUSUM_NATS * missing
    return frame, cost, period_s


def number_frames(
    stamp_s: FloatArray, period_s: float, jitter_s: float, by_least: bool
) -> IntArray:
    """Return the number of each attitude's frame, shape (n,), strictly increasing.

    If a frame is missing, all later timestamps are later by a period. So each timestamp is tested
    together with the following ones, relative to a running offset.

    Args:
        stamp_s: in the order of the frames, shape (n,).
        period_s: of the camera, to about 1 %.
        jitter_s: standard deviation of the timestamps.
        by_least: test the least delay of some timestamps, for late timestamps, instead of the sum
            of all.
    """
    row = np.arange(stamp_s.size, dtype=np.int64)
    offset_s = stamp_s - period_s * row
    if by_least:
        from scipy.ndimage import minimum_filter1d  # noqa: PLC0415 - slow to load

        least_s = minimum_filter1d(
            offset_s, STALL_FRAMES, mode="nearest", origin=-(STALL_FRAMES // 2)
        )
        return row + _count_jumps(least_s / period_s)
    return row + _count_hidden_jumps(offset_s / period_s, max(jitter_s / period_s, _MIN_JITTER))


def _count_jumps(offset: FloatArray) -> IntArray:
    """Return the number of missing frames before each row; offsets in periods, (n,)."""
    missing, total, running = np.zeros(offset.size, np.int64), 0, float(offset[0])
    for k, value in enumerate(offset.tolist()):
        error = value - running - total
        if error > _MIN_JUMP:
            total += round(error)
            error = value - running - total
        running += _LOOP_GAIN * min(max(error, -0.3), 0.3)
        missing[k] = total
    return missing


def _count_hidden_jumps(offset: FloatArray, jitter: float) -> IntArray:
    """Return the same if the jitter is as large as a period, by a cumulative sum test.

    The test of Page (Biometrika 41, 1954) adds the log-likelihood ratio of one missing frame.
    """
    missing, total = np.zeros(offset.size, np.int64), 0
    usual_delay = 2.0 * _CUSUM_NATS * jitter**2  # frames until a missing frame is detected
    gain = 1.0 / max(50.0, 5.0 * usual_delay)
    running = float(np.mean(offset[: max(5, round(usual_delay))]))
    evidence, start = 0.0, 0
    for k, value in enumerate(offset.tolist()):
        error = value - running - total
        if evidence <= 0.0:
            evidence, start = 0.0, k
        evidence += (error - 0.5) / jitter**2
        if evidence > _CUSUM_NATS or error > 8.0 * jitter + 2.0:
            start = start if evidence > _CUSUM_NATS else k
            total += max(1, round(float(np.mean(offset[start : k + 1])) - running - total))
            missing[start : k + 1] = total
            evidence = 0.0
        elif evidence <= 0.0:
            running += gain * error
        missing[k] = total
    return missing


def _frame_period(stamp_s: FloatArray) -> float:
    """Return the usual period; over several steps if single ones scatter too much."""
    period_s = 0.0
    for span in (1, 2, 4, 8, 16):
        if stamp_s.size <= 4 * span:
            break
        steps = (stamp_s[span:] - stamp_s[:-span]) / span
        period_s = float(np.median(steps))
        spread_s = 1.4826 * span * float(np.median(np.abs(steps - period_s)))
        if period_s > 0.0 and spread_s < 0.25 * period_s:
            break
    return period_s


def _is_line(stamp_s: FloatArray, frame: IntArray) -> bool:
    """Return whether timestamps scatter about a line as little as about their running mean."""
    frame_s = _regression_period(stamp_s, frame) * (frame - frame[0]).astype(np.float64)
    delay_s = stamp_s - frame_s
    width = max(5, round(1.0 / float(np.mean(np.diff(stamp_s)))))
    near_s = delay_s - _running_mean(delay_s, width)
    spread_s = 1.4826 * float(np.median(np.abs(near_s - np.median(near_s))))
    far_s = delay_s - _robust_line(frame_s, delay_s, max(spread_s, 1e-9))
    return 1.4826 * float(np.median(np.abs(far_s - np.median(far_s)))) < _MAX_EXCESS * spread_s


def _regression_period(stamp_s: FloatArray, frame: IntArray) -> float:
    """Return the median slope between timestamps that are half the recording apart."""
    half = stamp_s.size // 2
    slopes = (stamp_s[half:] - stamp_s[:-half]) / (frame[half:] - frame[:-half])
    return float(np.median(slopes))


def _candidates(
    stamp_s: FloatArray, frame: IntArray, period_s: float, jitter_s: float, is_late: bool
) -> tuple[list[FrameTimes], float]:
    """Return regular times, from the smoothest clock on, and the uncertainty of their offset."""
    frame_s = period_s * (frame - frame[0]).astype(np.float64)
    delay_s = stamp_s - frame_s
    line_s = _robust_line(frame_s, delay_s, jitter_s)
    if is_late:
        sound = ~_is_too_early(delay_s, period_s)
        floor = find_latency_floor(frame_s[sound], delay_s[sound])
        span_s = float(frame_s[-1] - frame_s[0])
        floor_s = floor.envelope.delay_at(frame_s)
        error = line_error(delay_s[sound] - floor_s[sound], min(span_s, MAX_LINE_SPAN_S))
        floor_s = floor_s - error.mean_s
        candidates = [FrameTimes("regular frames at the least delay", frame_s + floor_s)]
        shift_s = float(np.mean(floor_s - line_s))
        wander_s = floor.wander_bound_s if span_s > MAX_LINE_SPAN_S else 0.0
        offset_std_s = float(np.hypot(error.std_s, wander_s))
    else:
        candidates = [FrameTimes("regular frames", frame_s + line_s)]
        shift_s, offset_std_s = 0.0, jitter_s / np.sqrt(stamp_s.size)
    scatter_s = np.clip(delay_s - line_s, -1e3 * jitter_s, 1e3 * jitter_s)
    for smoothing_s in SMOOTHING_S:
        width = max(3, round(smoothing_s / period_s))
        if width < stamp_s.size // 2:
            time_s = frame_s + line_s + _running_mean(scatter_s, width) + shift_s
            if np.all(np.diff(time_s) > 0.0):
                description = f"frames of a clock that is smooth over {smoothing_s:g} s"
                candidates.append(FrameTimes(description, time_s))
    return candidates, float(offset_std_s)


def _is_too_early(delay_s: FloatArray, period_s: float) -> BoolArray:
    """Return which delays are too small by a part of a period, (n,): their number is wrong."""
    blocks = np.array_split(delay_s, max(1, delay_s.size // _BLOCK_STAMPS))
    usual_s = np.concatenate(
        [np.full(block.size, np.percentile(block, _LOW_PERCENT)) for block in blocks]
    )
    return np.asarray(delay_s < usual_s - _EARLY_SHARE * period_s)


def _robust_line(x: FloatArray, y: FloatArray, scale: float) -> FloatArray:
    """Return a line through points, (n,), evaluated at x; distant points count less (Huber)."""
    centred = x - x.mean()
    slope, level = 0.0, float(np.median(y))
    weight = np.ones(x.size)
    for _ in range(10):
        total = weight.sum()
        middle = float(weight @ centred) / total
        level = float(weight @ y) / total
        slope = float((weight * (centred - middle)) @ y) / float(weight @ (centred - middle) ** 2)
        residual = np.abs(y - level - slope * (centred - middle))
        weight = np.minimum(1.0, 3.0 * scale / np.maximum(residual, 1e-15))
        level -= slope * middle
    return np.asarray(level + slope * centred, dtype=np.float64)


def _running_mean(values: FloatArray, width: int) -> FloatArray:
    from scipy.ndimage import uniform_filter1d  # noqa: PLC0415 - slow to load

    return np.asarray(uniform_filter1d(values, min(width, values.size), mode="nearest"), np.float64)
