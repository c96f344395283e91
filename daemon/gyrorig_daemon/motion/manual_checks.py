"""Checks of rests and turns that a person executes, from the raw rates of one board.

What to use when: `RateWindow` collects the samples of a phase; `check_rest` and `check_turn` give
the reasons to repeat it, empty if it is good.

The limits are wide, because the gyroscope is not calibrated yet: a scale factor can be off by 15 %,
and a mount by several degrees. They only find a rest in which the board moved and a turn that was
not the requested one.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gyrorig_protocol.program import Turn
from gyrorig_protocol.recording.messages import ImuRaw, ImuStatus

FloatArray = NDArray[np.float64]

REST_WINDOW_S = 0.5
# Between the means of two windows at rest: 0.1 deg/s of noise and drift of a poor part.
MAX_REST_CHANGE_RAD_S = math.radians(0.3)
MAX_REST_STD_RAD_S = math.radians(2.0)  # of single samples: noise of a poor part, or vibration
ANGLE_TOLERANCE = 0.2  # of the angle, with the tolerance of the scale factor
AXIS_TOLERANCE_RAD = math.radians(20.0)  # with the misalignment of the mount
END_RATE_RAD_S = math.radians(3.0)  # at the begin and the end of a turn, beyond the bias
END_S = 0.3
MIN_SAMPLES = 8
INT16_MAX = 32767
_SATURATED = int(ImuStatus.SATURATED)


@dataclass(slots=True)
class RateWindow:
    """The samples of one board in one phase; times are on the capture clock."""

    begin_ns: int
    end_ns: int
    time_s: list[float] = field(default_factory=list)  # since `begin_ns`
    counts: list[tuple[int, int, int]] = field(default_factory=list)
    saturated: int = 0

    def add(self, message: ImuRaw, taken_ns: int) -> None:
        """Add a sample if it was taken in the phase."""
        if self.begin_ns <= taken_ns <= self.end_ns:
            self.time_s.append((taken_ns - self.begin_ns) * 1e-9)
            self.counts.append(message.gyro)
            is_at_limit = max(map(abs, message.gyro)) >= INT16_MAX
            self.saturated += bool(message.status & _SATURATED) or is_at_limit

    def rates(self, scale_rad_s: float) -> tuple[FloatArray, FloatArray]:
        """Return times, shape (n,), and rates, shape (n, 3), in order of time."""
        order = np.argsort(self.time_s, kind="stable")
        rate = np.array(self.counts, dtype=np.float64).reshape(-1, 3) * scale_rad_s
        return np.array(self.time_s)[order], rate[order]


@dataclass(frozen=True, slots=True, eq=False)
class JudgedPhase:
    """The reasons to repeat a phase, and the mean rate in it."""

    reasons: tuple[str, ...]
    mean_rad_s: FloatArray  # (3,)


def check_rest(window: RateWindow, scale_rad_s: float) -> JudgedPhase:
    """Check that the board was at rest: the means of short windows agree."""
    time_s, rate = window.rates(scale_rad_s)
    if time_s.size < MIN_SAMPLES:
        return JudgedPhase(("the board sent too few samples",), np.zeros(3))
    mean = rate.mean(axis=0)
    count = max(1, round(float(time_s[-1]) / REST_WINDOW_S))
    means = np.array([part.mean(axis=0) for part in np.array_split(rate, count) if len(part)])
    change = float(np.ptp(means, axis=0).max())
    spread = float(rate.std(axis=0).max())
    if change > MAX_REST_CHANGE_RAD_S or spread > MAX_REST_STD_RAD_S:
        size = math.degrees(max(change, spread))
        return JudgedPhase((f"the board moved (its rate changed by {size:.1f} deg/s)",), mean)
    return JudgedPhase((), mean)


def check_turn(
    window: RateWindow, scale_rad_s: float, turn: Turn, bias_rad_s: FloatArray
) -> JudgedPhase:
    """Check angle, axis, begin and end of a turn, and that no sample is saturated.

    Args:
        window: from the start signal to the end of the turn.
        scale_rad_s: nominal, per count.
        turn: the requested one.
        bias_rad_s: the mean rate of the last rest, shape (3,).
    """
    time_s, rate = window.rates(scale_rad_s)
    if time_s.size < MIN_SAMPLES:
        return JudgedPhase(("the board sent too few samples",), np.zeros(3))
    rate = rate - bias_rad_s
    reasons = []
    if window.saturated:
        reasons.append(f"the rate exceeded the range of the sensor in {window.saturated} samples")
    angle = np.trapezoid(rate, time_s, axis=0)
    turned_rad, wanted_rad = float(np.linalg.norm(angle)), math.radians(turn.angle_deg)
    along_rad = float(angle @ np.array(turn.axis))
    if abs(along_rad - wanted_rad) > ANGLE_TOLERANCE * abs(wanted_rad):
        reasons.append(
            f"the board turned by {math.degrees(along_rad):+.0f} deg instead of "
            f"{turn.angle_deg:+.0f} deg"
        )
    off_axis = math.acos(min(1.0, abs(along_rad) / turned_rad)) if turned_rad else 0.0
    if turned_rad > 0.5 and off_axis > AXIS_TOLERANCE_RAD:
        reasons.append(f"the axis was off by {math.degrees(off_axis):.0f} deg")
    for is_edge, words in (
        (time_s < END_S, "the board moved before the start signal"),
        (time_s > float(time_s[-1]) - END_S, "the turn was not finished in time"),
    ):
        if is_edge.any() and float(np.abs(rate[is_edge].mean(axis=0)).max()) > END_RATE_RAD_S:
            reasons.append(words)
    return JudgedPhase(tuple(reasons), rate.mean(axis=0))
