"""Whether rates that a source states in rad/s are plausibly in rad/s.

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


def rate_warnings(gyro: GyroStream, poses: PoseStream | None, name: str) -> list[str]:
    """Return what is implausible about the unit of the rates.

    Args:
        gyro: of the board.
        poses: the reference attitudes on the same times, if there are any.
        name: of the board.
    """
    rate = np.linalg.norm(gyro.values * (gyro.scale_rad_s or 1.0), axis=1)
    rate = rate[np.isfinite(rate)]
    if rate.size < MIN_ROWS:
        return []
    warnings = []
    high = float(np.quantile(rate, 0.99))
    if high > LARGEST_RATE_RAD_S:
        warnings.append(
            f"{name}: 1 % of the rates are above {high:.4g} rad/s, which is more than gyros "
            "measure; the source probably writes deg/s although it states rad/s"
        )
    ratio = _ratio_to_poses(rate, poses)
    for factor, unit in ((DEGREES, "deg/s although rad/s is stated"),
                         (1.0 / DEGREES, "rad/s although deg/s is stated")):  # fmt: skip
        if ratio is not None and factor / RATIO_TOLERANCE < ratio < factor * RATIO_TOLERANCE:
            warnings.append(
                f"{name}: the gyro turns {ratio:.3g} times as fast as the reference attitudes; the "
                f"source probably writes {unit}"
            )
    return warnings


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
