"""Check whether a section that is marked as a rest is at rest.

An import map or a motion program states the rests, and nothing in the data proves it. If the board
moves in such a section, the bias is wrong without any sign of it: its scatter can be small.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_protocol.profile import SensorProfile
from gyrorig_protocol.recording.recording import Recording
from gyrorig_solver.calibration import find_profile
from gyrorig_solver.data import BoolArray, FloatArray, IntArray
from gyrorig_solver.data.metadata_numbers import positive_number
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.reference import TimeInterval

MEAN_S, WINDOW_S = 0.1, 1.0  # of short means, and of the windows in which they are compared
MIN_WINDOWS = 2
# A hand that holds a board still causes larger rates; vibration has no mean over 0.1 s.
MIN_MOTION_RAD_S = float(np.radians(0.3))
NOISE_FACTOR = 8.0  # above the noise of a short mean
MAX_NOISE_RAD_S = float(np.radians(0.1))  # of a short mean of a part without a profile
MAX_MOVING_SHARE = 0.2  # of the windows; knocks are fewer
# integrated over the windows with motion, relative to the median rate
MAX_TURN_RAD = float(np.radians(10.0))
# Relative to the data sheet's zero-rate limit, which is valid for a new part at 25 degC. Soldered
# parts can differ by several deg/s (config/boards/BMI270.yaml).
ZERO_RATE_FACTOR = 2.0
MIN_BIAS_LIMIT_RAD_S = float(np.radians(5.0))
MAX_BIAS_RAD_S = float(np.radians(30.0))  # of a part without a profile
MAX_FORCE_STEP_M_S2 = 0.15  # between two windows: gravity turns by 0.9 deg
# over a rest; larger than the change of the offset with the temperature
MAX_FORCE_CHANGE_M_S2 = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class _Windows:
    """A section in windows of one second."""

    scatter_rad_s: FloatArray  # (n,), of the short means of each window, largest axis
    mean_rad_s: FloatArray  # (n, 3)
    force_m_s2: FloatArray | None  # (n, 3)


def check_rests(recording: Recording, samples: GyroSamples, rests: Sequence[TimeInterval]) -> None:
    """Check that the board does not move in the rests of a recording.

    Args:
        recording: the recording.
        samples: of the board in it.
        rests: on the samples' time axis.

    Raises:
        InputError: the board moves in a rest, or its mean rate cannot be a bias.
    """
    sensor = recording.metadata.get(f"gyrorig.board.{samples.board}", {}).get("sensor", "")
    profile = find_profile(sensor)
    full_scale_dps = positive_number(samples.metadata, "gyro_full_scale_dps")
    for rest in rests:
        evidence = _evidence_of_motion(samples, rest, profile, full_scale_dps)
        if evidence:
            raise InputError(
                f"the section of {recording.path.name} from {rest.begin_s:.1f} s to "
                f"{rest.end_s:.1f} s is marked as a rest, but {evidence}",
                "correct the start and the end of the section in the import map or in the motion "
                "program, or remove it",
            )


def _evidence_of_motion(
    samples: GyroSamples,
    rest: TimeInterval,
    profile: SensorProfile | None,
    full_scale_dps: float | None,
) -> str:
    windows = _cut_windows(samples, rest)
    if windows is None:
        return ""
    median_rad_s = np.median(windows.mean_rad_s, axis=0)
    limit_dps = None if profile is None else profile.zero_rate_limit_dps(full_scale_dps)
    limit_rad_s = MAX_BIAS_RAD_S
    if limit_dps is not None:
        limit_rad_s = max(ZERO_RATE_FACTOR * float(np.radians(limit_dps)), MIN_BIAS_LIMIT_RAD_S)
    worst = int(np.argmax(np.abs(median_rad_s)))
    if abs(median_rad_s[worst]) > limit_rad_s:
        origin = "a gyroscope" if profile is None else f"the {profile.sensor} (see its data sheet)"
        return (
            f"its mean rate about {'xyz'[worst]} is {np.degrees(median_rad_s[worst]):+.1f} deg/s, "
            f"and a bias of {origin} is at most {np.degrees(limit_rad_s):.3g} deg/s. The "
            "board moves, or the unit of the rates is wrong"
        )
    is_moving = _find_motion(windows, profile)
    share = float(np.mean(is_moving))
    turn_rad = WINDOW_S * float(
        np.linalg.norm((windows.mean_rad_s - median_rad_s)[is_moving], axis=1).sum()
    )
    if share > MAX_MOVING_SHARE or turn_rad > MAX_TURN_RAD:
        deviation = np.abs(windows.mean_rad_s - median_rad_s).max(axis=1) + windows.scatter_rad_s
        return (
            f"the board moves in {100.0 * share:.3g} % of it, with rates up to "
            f"{np.degrees(deviation.max()):.2g} deg/s from the median"
        )
    return _evidence_of_force(windows.force_m_s2)


def _evidence_of_force(force: FloatArray | None) -> str:
    if force is None:
        return ""
    steps = np.linalg.norm(np.diff(force, axis=0), axis=1)
    change = np.linalg.norm(force - np.median(force, axis=0), axis=1)
    share = float(np.mean(steps > MAX_FORCE_STEP_M_S2))
    if (
        share <= MAX_MOVING_SHARE
        and float(np.median(np.sort(change)[-3:])) <= MAX_FORCE_CHANGE_M_S2
    ):
        return ""
    return (
        "the accelerometer shows that the board turns or accelerates there: its reading changes by "
        f"up to {change.max():.2g} m/s²"
    )


def _find_motion(windows: _Windows, profile: SensorProfile | None) -> BoolArray:
    quiet = float(np.percentile(windows.scatter_rad_s, 10.0))
    noise = min(quiet, MAX_NOISE_RAD_S)
    if profile is not None and profile.noise_density_dps_rthz is not None:
        density = float(np.radians(profile.noise_density_dps_rthz))
        noise = min(quiet, 2.0 * density * float(np.sqrt(0.5 / MEAN_S)))
    limit = max(MIN_MOTION_RAD_S, NOISE_FACTOR * noise)
    step = np.linalg.norm(
        np.diff(windows.mean_rad_s, axis=0, append=windows.mean_rad_s[-1:]), axis=1
    )
    return np.asarray((windows.scatter_rad_s > limit) | (step > limit), dtype=np.bool_)


def _cut_windows(samples: GyroSamples, rest: TimeInterval) -> _Windows | None:
    """Return a section in windows, None if it is too short."""
    used = samples.usable & (samples.time_s >= rest.begin_s) & (samples.time_s <= rest.end_s)
    time_s, rate = samples.time_s[used], samples.rate_rad_s[used]
    count = int((rest.end_s - rest.begin_s) / WINDOW_S)
    if count < MIN_WINDOWS or time_s.size < 8 * count:
        return None
    per_window = round(WINDOW_S / MEAN_S)
    short = np.minimum(((time_s - rest.begin_s) / MEAN_S).astype(np.int64), count * per_window - 1)
    in_short = np.bincount(short, minlength=count * per_window)
    means = _group_means(rate, short, in_short).reshape(count, per_window, 3)
    window = short // per_window
    in_window = np.bincount(window, minlength=count)
    is_filled = in_window > 0
    force = samples.accel_m_s2
    return _Windows(
        np.nanmax(np.nanstd(means[is_filled], axis=1), axis=1),
        _group_means(rate, window, in_window)[is_filled],
        None if force is None else _force_means(force[used], window, count),
    )


def _force_means(force: FloatArray, window: IntArray, count: int) -> FloatArray | None:
    """Return the mean of each window with accelerations, None if these are too few."""
    is_known = np.isfinite(force).all(axis=1)
    in_window = np.bincount(window[is_known], minlength=count)
    if np.count_nonzero(in_window) < MIN_WINDOWS:
        return None
    means = _group_means(force[is_known], window[is_known], in_window)
    return np.asarray(means[in_window > 0])


def _group_means(values: FloatArray, group: IntArray, count: IntArray) -> FloatArray:
    """Return the mean of each group, (groups, 3), nan if it is empty."""
    sums = np.stack([np.bincount(group, axis, count.size) for axis in values.T], axis=1)
    return np.asarray(sums / np.where(count > 0, count, np.nan)[:, None], dtype=np.float64)
