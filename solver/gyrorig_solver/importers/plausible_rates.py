"""Whether rates and times are plausibly in the units that a source states.

What to use when: `rate_warnings` for a stream before it is written. A warning is a remark of the
import; nothing is changed.
"""

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.importers.measured_streams import GyroStream, PoseStream

DEGREES = float(np.degrees(1.0))
# Full scale of the usual gyros is 2000 deg/s = 35 rad/s, of the fastest 4000 deg/s = 70 rad/s.
LARGEST_RATE_RAD_S = 75.0
# The ratio of the typical rates of the gyro and of the attitudes: 57.3 or 1/57.3, not about 1.
RATIO_TOLERANCE = 2.0
MIN_ROWS = 50
MIN_SAMPLE_RATE_HZ, MAX_SAMPLE_RATE_HZ = 1.0, 50e3  # of logs of gyros; the fastest give 32 kHz


def rate_warnings(gyro: GyroStream, poses: PoseStream | None, name: str) -> list[str]:
    """Return what is implausible about the units of the rates and of the times.

    Args:
        gyro: of the board.
        poses: the reference attitudes on the same times, if there are any.
        name: of the board.
    """
    values = gyro.values * (gyro.scale_rad_s or 1.0)
    values = values[np.isfinite(values).all(axis=1)]
    if len(values) < MIN_ROWS:
        return []
    warnings = _time_warnings(gyro, name)
    rate = np.linalg.norm(values, axis=1)
    high = float(np.quantile(rate, 0.99))
    if high > LARGEST_RATE_RAD_S:
        warnings.append(
            f"{name}: 1 % of the rates are above {high:.4g} rad/s, which is more than gyros "
            "measure; the source probably writes deg/s although it states rad/s"
        )
    # A bias, or a column that does not change, is no motion.
    ratio = _ratio_to_poses(np.linalg.norm(values - np.median(values, axis=0), axis=1), poses)
    for factor, units in ((DEGREES, "deg/s although rad/s is stated"),
                          (1.0 / DEGREES, "rad/s although deg/s is stated")):  # fmt: skip
        if ratio is not None and factor / RATIO_TOLERANCE < ratio < factor * RATIO_TOLERANCE:
            warnings.append(
                f"{name}: the gyro turns {ratio:.3g} times as fast as the reference attitudes; the "
                f"source probably writes {units}"
            )
    return warnings


def _time_warnings(gyro: GyroStream, name: str) -> list[str]:
    """Return a warning if no gyro is read at the rate of the rows."""
    period_s = float(np.median(np.diff(gyro.time_s)))
    if gyro.stamp != "sampled" or period_s <= 0.0:
        return []
    rate_hz = 1.0 / period_s
    if MIN_SAMPLE_RATE_HZ <= rate_hz <= MAX_SAMPLE_RATE_HZ:
        return []
    return [
        f"{name}: the times give {rate_hz:.3g} samples per second, which is not usual for a "
        "gyroscope; check the unit of the times (in an import map `unit` under `time`)"
    ]


def _ratio_to_poses(rate: FloatArray, poses: PoseStream | None) -> float | None:
    """Return the ratio of the typical rates, None if the attitudes hardly move."""
    if poses is None or poses.time_s.size < MIN_ROWS:
        return None
    before, after = poses.orientation_xyzw[:-1], poses.orientation_xyzw[1:]
    sign = np.where(np.sum(before * after, axis=1) < 0.0, -1.0, 1.0)
    # the chord between unit quaternions of a turn by an angle is 2 sin(angle / 4)
    chord = np.linalg.norm(after - sign[:, None] * before, axis=1)
    turn = 4.0 * np.arcsin(np.minimum(chord / 2.0, 1.0))
    step_s = float(np.median(np.diff(poses.time_s)))
    if step_s <= 0.0:
        return None
    typical = float(np.quantile(turn, 0.75)) / step_s
    return float(np.quantile(rate, 0.75)) / typical if typical > 0.05 else None
