"""Whether the times of gyro and reference attitudes differ by more than the fit permits.

The fit searches the time offset within `MAX_LAG_S`. With a larger difference it would find wrong
gains and an offset at the limit. The speeds of gyro and reference do not depend on the mount of the
sensor, so their correlation over all shifts shows a difference roughly. Near the best shift, a
regression of the rates, with a gain and a bias, gives its value.

What to use when: `check_time_shift` and `check_rate_unit` before a fit.
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from scipy import fft

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate.attitude.attitude_matching import MAX_LAG_S, MAX_SPEED_RATIO
from gyrorig_solver.reference import AttitudeReference

STEP_S = 0.05  # of the mean rates that are compared
MAX_STEPS = 1 << 20  # 14 hours
REFINED_STEPS = 40  # on both sides of the best correlation, which an unknown bias shifts
MIN_OVERLAP = 0.3  # of the shorter series; with less, few seconds agree by chance
MIN_COMMON_STEPS = 100  # 5 s; a gyro that is clipped most of the time has fewer
# A shift outside the range must explain this share of the gyro's variance. It must also explain
# this much more than every shift inside, or leave less than this share of what that one leaves.
# Agreement by chance at rest, and of motion that repeats, is smaller.
MIN_EXPLAINED, MIN_GAIN, MAX_REMAINING_RATIO = 0.5, 0.3, 0.25
# If no shift fits all data: parts of the recording with separate shifts, and the largest of them.
SPEED_PARTS, MAX_CHANGING_SHIFT_S = 4, 3.0
# Speed of the gyro relative to the attitudes, the unit that explains it, and the stated unit.
UNIT_RATIOS = (
    (float(np.degrees(1.0)), "deg/s", "rad/s"),
    (float(np.radians(1.0)), "rad/s", "deg/s"),
)
UNIT_TOLERANCE = 0.2  # of the logarithm; gains of gyros differ by less


def check_time_shift(samples: GyroSamples, reference: AttitudeReference) -> None:
    """Raise an error if gyro and attitudes agree well only with a large shift of the times.

    Args:
        samples: of one board, on the time axis of the reference.
        reference: the attitudes.

    Raises:
        InputError: the times differ by more than `MAX_LAG_S`; the error states the difference.
    """
    shift_s = find_time_shift(samples, reference)
    if shift_s is not None:
        _check_clock_speed(samples, reference)
        word = "later" if shift_s > 0.0 else "earlier"
        raise InputError(
            f"the times of the gyroscope are about {abs(shift_s):.2f} s {word} than those of the "
            f"reference attitudes, and the fit permits {MAX_LAG_S:g} s",
            f"add {shift_s:.2f} s to the times of the attitudes (in an import map with `origin_s` "
            "under `time`), and import again",
        )


def find_time_shift(samples: GyroSamples, reference: AttitudeReference) -> float | None:
    """Return gyro time minus reference time, s; None if it may be within `MAX_LAG_S`."""
    both = _mean_rates(samples, reference)
    if both is None:
        return None
    gyro, attitudes = both
    lags = np.arange(1 - attitudes.valid.size, gyro.valid.size)
    begin_s = gyro.begin_s - attitudes.begin_s
    is_near = np.abs(lags * STEP_S + begin_s) <= MAX_LAG_S
    best = int(np.argmax(_speed_correlation(gyro, attitudes)))
    around = lags[max(best - REFINED_STEPS, 0) : best + REFINED_STEPS + 1]
    share, lag = max((_explained_share(gyro, attitudes, int(k)), int(k)) for k in around)
    nearest = max([0.0, *(_explained_share(gyro, attitudes, int(k)) for k in lags[is_near])])
    is_better = share > nearest + MIN_GAIN or 1.0 - share < MAX_REMAINING_RATIO * (1.0 - nearest)
    shift_s = lag * STEP_S + begin_s
    return shift_s if is_better and share > MIN_EXPLAINED and abs(shift_s) > MAX_LAG_S else None


def check_rate_unit(samples: GyroSamples, reference: AttitudeReference) -> None:
    """Raise an error if the gyro turns 57.3 or 1/57.3 times as fast as the attitudes.

    Raises:
        InputError: the unit of the rates is wrong; the error states both units.
    """
    both = _mean_rates(samples, reference)
    if both is None:
        return
    gyro, attitudes = both
    lags = np.arange(1 - attitudes.valid.size, gyro.valid.size)
    is_near = np.abs(lags * STEP_S + gyro.begin_s - attitudes.begin_s) <= MAX_LAG_S
    fits = [_regress(gyro, attitudes, int(lag)) for lag in lags[is_near]]
    share, gain = max(fits, key=lambda fit: fit[0], default=(0.0, np.eye(3)))
    ratios = np.linalg.svd(gain, compute_uv=False)
    for unit_ratio, written, stated in UNIT_RATIOS:
        is_unit = np.all(np.abs(np.log(np.maximum(ratios, 1e-9) / unit_ratio)) < UNIT_TOLERANCE)
        if share > MIN_EXPLAINED and is_unit:
            raise InputError(
                f"the gyro turns {unit_ratio:.3g} times as fast as the reference attitudes, as if "
                f"its rates are in {written} and the import stated {stated}",
                "correct `unit` under `gyro` in the import map, and import again",
            )


def _check_clock_speed(samples: GyroSamples, reference: AttitudeReference) -> None:
    """Raise an error if the shift of the times changes steadily, so that no shift is right.

    Raises:
        InputError: the clocks run at different speeds; the error states the shifts.
    """
    both = _mean_rates(samples, reference)
    if both is None:
        return
    gyro, attitudes = both
    begin_s = gyro.begin_s - attitudes.begin_s
    lags = np.arange(1 - attitudes.valid.size, gyro.valid.size)
    lags = lags[np.abs(lags * STEP_S + begin_s) <= MAX_CHANGING_SHIFT_S]
    if not lags.size:
        return
    shares, shifts_s = [], []
    for rows in np.array_split(np.arange(gyro.valid.size), SPEED_PARTS):
        valid = np.zeros(gyro.valid.size)
        valid[rows] = gyro.valid[rows]
        part = replace(gyro, valid=valid)
        share, lag = max((_explained_share(part, attitudes, int(k)), int(k)) for k in lags)
        shares.append(share)
        shifts_s.append(lag * STEP_S + begin_s)
    steps_s = np.diff(shifts_s)
    is_steady = np.all(steps_s > 0.0) or np.all(steps_s < 0.0)
    if min(shares) > MIN_EXPLAINED and is_steady:
        raise InputError(
            "the times of the gyroscope minus those of the reference attitudes change from "
            f"{shifts_s[0]:+.2f} s to {shifts_s[-1]:+.2f} s during the recording, so their clocks "
            "run at different speeds",
            "correct the times of the wrong clock (in an import map with `rate_hz` or `unit` under "
            "`time`, or in the file), and import again",
        )


def _mean_rates(
    samples: GyroSamples, reference: AttitudeReference
) -> "tuple[_MeanRates, _MeanRates] | None":
    """Return the mean rates of gyro and attitudes, None without attitudes or with too many."""
    tracks = reference.rate_segments()
    if not tracks:
        return None
    gyro = _MeanRates.of(samples.time_s[samples.usable], samples.rate_rad_s[samples.usable])
    attitudes = _MeanRates.of(
        np.concatenate([0.5 * (track.begin_s + track.end_s) for track in tracks]),
        np.concatenate([track.rate_rad_s for track in tracks]),
    )
    return None if max(gyro.valid.size, attitudes.valid.size) > MAX_STEPS else (gyro, attitudes)


@dataclass(frozen=True, slots=True, eq=False)
class _MeanRates:
    """Mean rates in equal steps of time."""

    begin_s: float
    rate_rad_s: FloatArray  # (n, 3), 0 without data
    valid: FloatArray  # (n,), 1 with data, otherwise 0

    @classmethod
    def of(cls, time_s: FloatArray, rate_rad_s: FloatArray) -> Self:
        """Return the means of rates (m, 3) at times (m,)."""
        begin_s = float(time_s.min())
        step: IntArray = np.floor((time_s - begin_s) / STEP_S).astype(np.int64)
        count = np.bincount(step)
        sums = np.stack([np.bincount(step, axis) for axis in rate_rad_s.T], axis=1)
        return cls(begin_s, sums / np.maximum(count, 1)[:, None], (count > 0).astype(np.float64))

    def speeds(self, limit_rad_s: float) -> FloatArray:
        """Return limited speeds relative to the median rate, minus their mean, (n,)."""
        has_data = self.valid > 0.0
        middle = np.median(self.rate_rad_s[has_data], axis=0)
        speed = np.minimum(np.linalg.norm(self.rate_rad_s - middle, axis=1), limit_rad_s)
        return np.where(has_data, speed - speed[has_data].mean(), 0.0)

    @property
    def largest_rad_s(self) -> float:
        """The largest mean speed."""
        return float(np.linalg.norm(self.rate_rad_s, axis=1).max())


def _speed_correlation(gyro: _MeanRates, attitudes: _MeanRates) -> FloatArray:
    """Return the correlation of the speeds at each shift; 0 where the series hardly overlap."""
    # A board is never much faster than its gyro shows; larger speeds are outliers of the reference.
    limit_rad_s = MAX_SPEED_RATIO * gyro.largest_rad_s
    first, second = gyro.speeds(limit_rad_s), attitudes.speeds(limit_rad_s)
    product, count, power, other_power = (
        _correlate(a, b)
        for a, b in (
            (first, second),
            (gyro.valid, attitudes.valid),
            (first**2, attitudes.valid),
            (gyro.valid, second**2),
        )
    )
    enough = count > MIN_OVERLAP * min(gyro.valid.sum(), attitudes.valid.sum())
    scale = np.sqrt(np.maximum(power * other_power, 0.0))
    return np.where(enough & (scale > 0.0), product / np.maximum(scale, 1e-30), 0.0)


def _correlate(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the sum of first[k + lag] second[k] over k, for lags from 1 - second.size."""
    size = first.size + second.size - 1
    length = fft.next_fast_len(size, real=True)
    product = fft.rfft(first, length) * np.conj(fft.rfft(second, length))
    return np.asarray(np.roll(fft.irfft(product, length), second.size - 1)[:size], np.float64)


def _explained_share(gyro: _MeanRates, attitudes: _MeanRates, lag: int) -> float:
    """Return the share of the gyro's variance that the attitudes explain, with gain and bias."""
    return _regress(gyro, attitudes, lag)[0]


def _regress(gyro: _MeanRates, attitudes: _MeanRates, lag: int) -> tuple[float, FloatArray]:
    """Return the share that the attitudes explain, and the gain, (3, 3)."""
    first, second = max(lag, 0), max(-lag, 0)
    size = min(gyro.valid.size - first, attitudes.valid.size - second)
    rows, others = slice(first, first + size), slice(second, second + size)
    has_both = (gyro.valid[rows] * attitudes.valid[others]) > 0.0
    least = max(MIN_OVERLAP * min(gyro.valid.sum(), attitudes.valid.sum()), MIN_COMMON_STEPS)
    if has_both.sum() < least:
        return 0.0, np.eye(3)
    measured = gyro.rate_rad_s[rows][has_both]
    design = np.column_stack([attitudes.rate_rad_s[others][has_both], np.ones(len(measured))])
    solution = np.linalg.lstsq(design, measured, rcond=None)[0]
    residual = measured - design @ solution
    variance = float(np.sum((measured - measured.mean(axis=0)) ** 2))
    share = 1.0 - float(np.sum(residual**2)) / variance if variance > 0.0 else 0.0
    return share, np.asarray(solution[:3].T, np.float64)
