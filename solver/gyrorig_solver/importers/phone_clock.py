"""Clock offset and skew between a phone and a pan-tilt unit, by correlation of the motion.

What to use when: `find_phone_clock`, if a device logged by a separate clock while a pan-tilt
unit turned it.

Theory of operation: speeds are the norms of rates and do not depend on the mounting of the
phone. Both speeds are put on a grid and correlated at every lag. The largest correlation gives
the offset; it must be clearly larger than at all distant lags, because a periodic motion fits
more than once. Then the lags of windows of 10 s, each from a linearised fit, are fitted by a
line over time. Its slope is the skew.

The delay of the phone itself is part of the offset and cannot be separated. Therefore the
`time_offset` of a calibration made with this clock has no meaning.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import BoolArray, FloatArray

GRID_S = 0.01
WINDOW_S = 10.0
ITERATIONS = 4
MIN_CORRELATION = 0.7  # below this correlation the two motions are different
MIN_SECOND_DISTANCE_S = 2.0  # lags farther than this from the best are a second solution
MAX_SECOND_SHARE = 0.9  # largest correlation of a second solution, relative to the best
MIN_SPEED_CHANGE_RAD_S = 0.02  # rms speed change below which a window determines no lag
MAX_SKEW = 2e-3  # crystals are good to 1e-4, ceramic resonators to 1e-3
# Of times that the log states wrongly, if the motions do not agree: the largest difference in
# speed, the time at its ends by which two tested speeds differ, and the length that is compared.
MAX_WRONG_SKEW, SKEW_STEP_S, COMPARED_S = 0.06, 0.2, 300.0
# Of 120 simulated other motions, the largest correlation at any of these speeds is 0.85.
MIN_STRETCHED_CORRELATION = 0.9


@dataclass(frozen=True, slots=True)
class PhoneClock:
    """capture time = offset_s + (1 + skew) * (stamp - first stamp)."""

    offset_s: float
    skew: float
    offset_std_s: float
    skew_std: float
    correlation: float
    windows: int

    def capture_s(self, since_first_s: FloatArray) -> FloatArray:
        """Return the unit's time for timestamps relative to the first one."""
        return np.asarray(self.offset_s + (1.0 + self.skew) * since_first_s, dtype=np.float64)


def find_phone_clock(
    since_first_s: FloatArray, speed_rad_s: FloatArray, unit_speed_rad_s: FloatArray
) -> PhoneClock:
    """Return the clock map from a phone's timestamps to a unit's time.

    Args:
        since_first_s: the phone's timestamps relative to the first, shape (n,), increasing.
        speed_rad_s: norm of its rates without bias, shape (n,).
        unit_speed_rad_s: norm of the unit's rates at k * GRID_S, shape (m,); nan if unknown.

    Raises:
        InputError: the motions differ, or the motion fits at two lags.
    """
    unit = np.nan_to_num(unit_speed_rad_s)
    phone = np.interp(np.arange(0.0, since_first_s[-1], GRID_S), since_first_s, speed_rad_s)
    lag, correlation = _best_lag(phone, unit)
    if correlation < MIN_CORRELATION:
        _check_clock_speed(phone, unit)
        raise InputError(
            "the phone did not move together with the pan-tilt unit: the correlation of their "
            f"rates is only {correlation:.2f}",
            "give the recording that was made at the same time as the phone's log",
        )
    offset_s, skew = lag * GRID_S, 0.0
    grid_s = np.arange(unit.size) * GRID_S
    for _ in range(ITERATIONS):
        at_s = (grid_s - offset_s) / (1.0 + skew)  # the phone's time on the unit's grid
        is_common = (at_s >= 0.0) & (at_s <= since_first_s[-1]) & np.isfinite(unit_speed_rad_s)
        phone_speed = np.interp(at_s, since_first_s, speed_rad_s)
        late_s, weight, centre_s = _lag_per_window(phone_speed, unit, is_common)
        if late_s.size < 3:
            raise InputError(
                f"the phone's log has only {late_s.size} intervals of 10 s with enough "
                "motion to compare the phone's clock with that of the rig, but 3 are needed",
                "record again, and turn the phone with the unit for at least a minute",
            )
        line = np.stack([np.ones_like(centre_s), centre_s - offset_s], axis=1)
        fit, cov = _robust_line(line, late_s, weight)
        # the phone's motion is late by d, therefore its timestamps are moved earlier
        offset_s -= float(fit[0])
        skew -= float(fit[1]) * (1.0 + skew)
    if abs(skew) > MAX_SKEW:
        raise _wrong_speed(f"{1e6 * skew:+.0f} ppm")
    std = np.sqrt(np.diag(cov))
    return PhoneClock(offset_s, skew, float(std[0]), float(std[1]), correlation, int(late_s.size))


def _wrong_speed(difference: str) -> InputError:
    return InputError(
        f"the rates of the phone's clock and of the rig's clock differ by {difference}, which is "
        "too much for a clock",
        "check the time column of the log, or record the log with another app",
    )


def _check_clock_speed(phone: FloatArray, unit: FloatArray) -> None:
    """Raise an error if the motions agree after a change of the phone's speed of time.

    Raises:
        InputError: the clock of the phone runs at a wrong speed.
    """
    part = phone[: int(COMPARED_S / GRID_S)]
    steps = round(MAX_WRONG_SKEW * part.size * GRID_S / SKEW_STEP_S)
    best = (0.0, 0.0)
    for skew in MAX_WRONG_SKEW * np.arange(-steps, steps + 1) / max(steps, 1):
        at = np.arange(0.0, (part.size - 1) * (1.0 + skew)) / (1.0 + skew)
        stretched = np.interp(at, np.arange(part.size), part)
        best = max(best, (_best_lag(stretched, unit)[1], float(skew)))
    if best[0] > MIN_STRETCHED_CORRELATION:
        raise _wrong_speed(f"about {100.0 * best[1]:+.1f} %")


def _best_lag(phone: FloatArray, unit: FloatArray) -> tuple[int, float]:
    """Return the lag of largest correlation in grid steps, and that correlation.

    Raises:
        InputError: one of them did not move, or the motion repeats itself.
    """
    a, b = phone - phone.mean(), unit - unit.mean()
    size = 1 << int(np.ceil(np.log2(a.size + b.size)))
    cross = np.fft.irfft(np.fft.rfft(b, size) * np.conj(np.fft.rfft(a, size)), size)
    scale = float(np.linalg.norm(a) * np.linalg.norm(b))
    if scale <= 0.0:
        still = "the phone" if not np.any(a) else "the pan-tilt unit"
        raise InputError(
            f"{still} did not move during the log",
            "record a motion in which the unit moves the phone",
        )
    best = int(np.argmax(cross))
    lag = best if best < b.size else best - size
    near = int(MIN_SECOND_DISTANCE_S / GRID_S)
    others = cross.copy()
    others[np.arange(best - near, best + near + 1) % size] = -np.inf
    overlap_a, overlap_b = _overlap(a, b, lag)
    norm = float(np.linalg.norm(overlap_a) * np.linalg.norm(overlap_b))
    correlation = float(overlap_a @ overlap_b) / max(norm, 1e-30)
    if correlation > MIN_CORRELATION and others.max() > MAX_SECOND_SHARE * cross[best]:
        raise InputError(
            "the motion repeats itself, so the program cannot determine at which time of the "
            "unit's recording the phone's log began",
            "record again with a motion program that does not repeat itself, such as survey-130",
        )
    return lag, correlation


def _overlap(a: FloatArray, b: FloatArray, lag: int) -> tuple[FloatArray, FloatArray]:
    first, last = max(0, lag), min(b.size, a.size + lag)
    return a[first - lag : last - lag], b[first:last]


def _lag_per_window(
    phone: FloatArray, unit: FloatArray, is_common: BoolArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the phone's lag in each window, its weight, and the middle of the window."""
    length = int(WINDOW_S / GRID_S)
    slope = np.gradient(unit, GRID_S)
    lags, weights, centres = [], [], []
    for first in range(0, unit.size - length + 1, length):
        rows = slice(first, first + length)
        if not is_common[rows].all() or float(np.std(unit[rows])) < MIN_SPEED_CHANGE_RAD_S:
            continue
        # phone(t) = c + g unit(t - d), about d = 0
        basis = np.stack([np.ones(length), unit[rows], -slope[rows]], axis=1)
        solution, *_ = np.linalg.lstsq(basis, phone[rows], rcond=None)
        gain = float(solution[1])
        if gain < 0.5:  # the motions differ in this window
            continue
        residual = phone[rows] - basis @ solution
        variance = (
            float(np.linalg.inv(basis.T @ basis)[2, 2]) * float(residual @ residual) / (length - 3)
        )
        lags.append(float(solution[2]) / gain)
        weights.append(gain**2 / max(variance, 1e-18))
        centres.append((first + length / 2) * GRID_S)
    return np.array(lags), np.array(weights), np.array(centres)


def _robust_line(
    line: FloatArray, late_s: FloatArray, weight: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return offset and slope by robust least squares, and their sandwich covariance."""
    w = weight / weight.max()
    for _ in range(5):
        gram = line.T @ (line * w[:, None])
        fit = np.linalg.solve(gram, line.T @ (w * late_s))
        residual = late_s - line @ fit
        scale = 1.4826 * float(np.median(np.abs(residual))) + 1e-9
        w = weight / weight.max() / np.maximum(1.0, np.abs(residual) / (3.0 * scale))
    inverse = np.linalg.inv(gram)
    middle_matrix = line.T @ (line * (w * residual)[:, None] ** 2)
    return fit, np.asarray(inverse @ middle_matrix @ inverse, dtype=np.float64)
