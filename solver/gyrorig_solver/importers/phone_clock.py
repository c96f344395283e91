"""A clock that nobody read, from the motion alone: offset and rate between a phone and a unit.

What to use when: `find_clock`, where a device logged by itself while a pan-tilt unit turned it
and its stamps have nothing to do with the unit's.

Theory of operation. Speeds, the norms of rates, do not care how the phone is mounted. On a grid
both are correlated over every lag; the greatest gives the offset, and has to stand out from
all others: a motion that repeats would fit twice. Then windows of 10 s, each with its own lag
from a linearised fit, lie on a line over time: its slope is how much faster one clock runs.

What a clock from the motion cannot know is the phone's own lag: it is in the offset. So the
`time_offset` of a calibration made with it says nothing of the phone.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.arrays import BoolArray, FloatArray

GRID_S = 0.01
WINDOW_S = 10.0
ROUNDS = 4
ALIKE = 0.7  # correlation below which the two saw different motions
APART_S = 2.0  # lags farther than this from the best are another place of the motion
SECOND = 0.9  # another place may be as good as this share
TURNING_RAD_S = 0.02  # rms of a window's changes of speed below which it shows no lag
MOST_SKEW = 2e-3  # crystals are good to 1e-4, ceramic resonators to 1e-3


@dataclass(frozen=True, slots=True)
class FoundClock:
    """capture time = offset_s + (1 + skew) * (stamp - first stamp)."""

    offset_s: float
    skew: float
    offset_std_s: float
    skew_std: float
    correlation: float
    windows: int

    def capture_s(self, since_first_s: FloatArray) -> FloatArray:
        """Return the unit's time of stamps that count from the first one."""
        return np.asarray(self.offset_s + (1.0 + self.skew) * since_first_s, dtype=np.float64)


def find_clock(
    since_first_s: FloatArray, speed_rad_s: FloatArray, unit_speed_rad_s: FloatArray
) -> FoundClock:
    """Return the clock between a phone's stamps and a unit's time.

    Args:
        since_first_s: the phone's stamps, from its first on, shape (n,), growing.
        speed_rad_s: the norm of its rates, bias taken out, shape (n,).
        unit_speed_rad_s: the norm of the unit's rates at k * GRID_S, shape (m,); nan where
            it is not known.

    Raises:
        InputError: the two saw different motions, or one that fits in two places.
    """
    unit = np.nan_to_num(unit_speed_rad_s)
    phone = np.interp(np.arange(0.0, since_first_s[-1], GRID_S), since_first_s, speed_rad_s)
    lag, correlation = _best_lag(phone, unit)
    offset_s, skew = lag * GRID_S, 0.0
    grid_s = np.arange(unit.size) * GRID_S
    for _ in range(ROUNDS):
        at_s = (grid_s - offset_s) / (1.0 + skew)  # of the phone, at the unit's grid
        seen = (at_s >= 0.0) & (at_s <= since_first_s[-1]) & np.isfinite(unit_speed_rad_s)
        moved = np.interp(at_s, since_first_s, speed_rad_s)
        late_s, weight, centre_s = _window_lags(moved, unit, seen)
        if late_s.size < 3:
            raise InputError(
                f"only {late_s.size} stretches of 10 s move enough to compare clocks",
                "turn the phone for a minute at least",
            )
        line = np.stack([np.ones_like(centre_s), centre_s - offset_s], axis=1)
        fit, cov = _robust_line(line, late_s, weight)
        # the phone's motion comes late by d: its stamps are to be taken earlier
        offset_s -= float(fit[0])
        skew -= float(fit[1]) * (1.0 + skew)
    if abs(skew) > MOST_SKEW:
        raise InputError(
            f"the phone's clock runs {1e6 * skew:+.0f} ppm off the unit's: its stamps are no clock",
            "look at the time column, or log with another app",
        )
    std = np.sqrt(np.diag(cov))
    return FoundClock(offset_s, skew, float(std[0]), float(std[1]), correlation, int(late_s.size))


def _best_lag(phone: FloatArray, unit: FloatArray) -> tuple[int, float]:
    """Return the lag in steps of the grid, and the correlation there."""
    a, b = phone - phone.mean(), unit - unit.mean()
    size = 1 << int(np.ceil(np.log2(a.size + b.size)))
    cross = np.fft.irfft(np.fft.rfft(b, size) * np.conj(np.fft.rfft(a, size)), size)
    scale = float(np.linalg.norm(a) * np.linalg.norm(b))
    if scale <= 0.0:
        raise InputError("the phone or the unit did not move", "record a motion")
    best = int(np.argmax(cross))
    lag = best if best < size // 2 else best - size
    near = int(APART_S / GRID_S)
    others = cross.copy()
    others[np.arange(best - near, best + near + 1) % size] = -np.inf
    overlap_a, overlap_b = _overlap(a, b, lag)
    norm = float(np.linalg.norm(overlap_a) * np.linalg.norm(overlap_b))
    alike = float(overlap_a @ overlap_b) / max(norm, 1e-30)
    if alike < ALIKE:
        raise InputError(
            f"the phone's motion is not the unit's: they correlate by {alike:.2f} at best",
            "give the recording that was made while the phone logged",
        )
    if others.max() > SECOND * cross[best]:
        raise InputError(
            "the motion fits in two places: it repeats itself",
            "record a program that does not, such as survey-130",
        )
    return lag, alike


def _overlap(a: FloatArray, b: FloatArray, lag: int) -> tuple[FloatArray, FloatArray]:
    first, last = max(0, lag), min(b.size, a.size + lag)
    return a[first - lag : last - lag], b[first:last]


def _window_lags(
    phone: FloatArray, unit: FloatArray, seen: BoolArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return each window's lag of the phone, its weight, and the unit's time of its middle."""
    length = int(WINDOW_S / GRID_S)
    slope = np.gradient(unit, GRID_S)
    lags, weights, centres = [], [], []
    for first in range(0, unit.size - length + 1, length):
        rows = slice(first, first + length)
        if not seen[rows].all() or float(np.std(unit[rows])) < TURNING_RAD_S:
            continue
        # phone(t) = c + g unit(t - d), about d = 0
        basis = np.stack([np.ones(length), unit[rows], -slope[rows]], axis=1)
        solution, *_ = np.linalg.lstsq(basis, phone[rows], rcond=None)
        gain = float(solution[1])
        if gain < 0.5:  # not the same motion in this window
            continue
        rest = phone[rows] - basis @ solution
        spread = float(np.linalg.inv(basis.T @ basis)[2, 2]) * float(rest @ rest) / (length - 3)
        lags.append(float(solution[2]) / gain)
        weights.append(gain**2 / max(spread, 1e-18))
        centres.append((first + length / 2) * GRID_S)
    return np.array(lags), np.array(weights), np.array(centres)


def _robust_line(
    line: FloatArray, late_s: FloatArray, weight: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return offset and slope, and their covariance by the scatter; windows far off count less."""
    w = weight / weight.max()
    for _ in range(5):
        gram = line.T @ (line * w[:, None])
        fit = np.linalg.solve(gram, line.T @ (w * late_s))
        rest = late_s - line @ fit
        scale = 1.4826 * float(np.median(np.abs(rest))) + 1e-9
        w = weight / weight.max() / np.maximum(1.0, np.abs(rest) / (3.0 * scale))
    inverse = np.linalg.inv(gram)
    meat = line.T @ (line * (w * rest)[:, None] ** 2)
    return fit, np.asarray(inverse @ meat @ inverse, dtype=np.float64)
