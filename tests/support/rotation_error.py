"""Rotation error of a calibrated gyro relative to the reference, over windows.

What to use when: `window_rotation_error` on held-out data: it tests a calibration in the way users
apply a gyro, without any assumption of the fit.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import BoolArray, FloatArray, IntArray
from gyrorig_solver.reference import AttitudeReference

# Integration step: short relative to hand motion, for gyro rates of 50 Hz or more.
INTEGRATION_STEP_S = 0.005
BOOTSTRAP_COUNT = 2000
INTERVAL_PERCENT = (2.5, 97.5)  # percent
SEED = 20260131  # makes the interval reproducible


@dataclass(frozen=True, slots=True, eq=False)
class RotationError:
    """The angle between integrated and true rotation, one value per window."""

    angle_rad: FloatArray  # (n,)
    begin_s: FloatArray  # (n,), of each window
    window_s: float
    rms_rad: float
    interval_rad: tuple[float, float]  # 95 %, bootstrap over windows

    @property
    def median_rad(self) -> float:
        """The median over the windows."""
        return float(np.median(self.angle_rad))


def total_rotation(vectors_rad: FloatArray) -> Rotation:
    """Return exp(v_0) exp(v_1) ... of each path.

    Args:
        vectors_rad: rotation vectors, shape (paths, steps, 3), steps at least 1.

    Returns:
        One rotation per path; neighbours are multiplied pairwise, log2(steps) passes.
    """
    paths, steps, _ = vectors_rad.shape
    single = Rotation.from_rotvec(vectors_rad.reshape(-1, 3)).as_quat()
    quaternion: FloatArray = single.reshape(paths, steps, 4)
    while quaternion.shape[1] > 1:
        even = quaternion.shape[1] // 2 * 2
        left = Rotation.from_quat(quaternion[:, 0:even:2].reshape(-1, 4))
        right = Rotation.from_quat(quaternion[:, 1:even:2].reshape(-1, 4))
        pairs = (left * right).as_quat().reshape(paths, -1, 4)
        quaternion = np.concatenate([pairs, quaternion[:, even:]], axis=1)
    return Rotation.from_quat(quaternion[:, 0])


def window_rotation_error(
    time_s: FloatArray,
    rate_rad_s: FloatArray,
    attitude: AttitudeReference,
    window_s: float = 1.0,
    start_mask: BoolArray | None = None,
) -> RotationError:
    """Integrate a rate over windows and compare with the reference's rotation.

    Args:
        time_s: of the rates, without the time offset, shape (n,).
        rate_rad_s: calibrated body rate, shape (n, 3).
        attitude: on the same time axis.
        window_s: length of each window; windows follow each other without overlap.
        start_mask: of the reference's rows, where windows can start; None: everywhere.

    Returns:
        The angle errors of the windows that both cover, their rms and its 95 % interval.

    Raises:
        InputError: no window is covered by both.
    """
    begin, end = _windows(time_s, attitude, window_s, start_mask)
    if begin.size == 0:
        raise InputError(
            f"gyro and reference attitude have no common window of {window_s:g} s",
            "record both for longer",
        )
    first, last = attitude.time_s[begin], attitude.time_s[end]
    measured = window_rotations(time_s, rate_rad_s, first, last, window_s)
    q = attitude.orientation_xyzw
    true = Rotation.from_quat(q[begin]).inv() * Rotation.from_quat(q[end])
    angle = np.asarray((true.inv() * measured).magnitude(), dtype=np.float64)
    return RotationError(
        angle_rad=angle,
        begin_s=first,
        window_s=window_s,
        rms_rad=float(np.sqrt(np.mean(angle**2))),
        interval_rad=_interval(angle),
    )


def window_rotations(
    time_s: FloatArray,
    rate_rad_s: FloatArray,
    first_s: FloatArray,
    last_s: FloatArray,
    window_s: float,
) -> Rotation:
    """Return the rotation of a body rate over each window, as one `Rotation` of n windows.

    Args:
        time_s: of the rates, shape (m,).
        rate_rad_s: body rates, shape (m, 3).
        first_s: begin of each window, shape (n,).
        last_s: end of each window, shape (n,).
        window_s: nominal length, for the number of integration steps.
    """
    steps = max(2, int(np.ceil(window_s / INTEGRATION_STEP_S)))
    spline = CubicSpline(time_s, rate_rad_s)
    fraction = np.linspace(0.0, 1.0, steps + 1)
    at = first_s[:, None] + fraction * (last_s - first_s)[:, None]
    rate = spline(at.ravel()).reshape(first_s.size, steps + 1, 3)
    angle_sum = spline.antiderivative()(at.ravel()).reshape(first_s.size, steps + 1, 3)
    step_s = np.diff(at, axis=1)[:, :, None]
    # The integral of the rate, and the coning term of `rotations.turn_vectors`.
    vectors = np.diff(angle_sum, axis=1) + np.cross(rate[:, :-1], rate[:, 1:]) * step_s**2 / 12.0
    return total_rotation(vectors)


def _windows(
    time_s: FloatArray, attitude: AttitudeReference, window_s: float, start_mask: BoolArray | None
) -> tuple[IntArray, IntArray]:
    """Return the first and last row of each window."""
    is_known = np.all(np.isfinite(attitude.orientation_xyzw), axis=1)
    row = np.flatnonzero(
        is_known & (attitude.time_s >= time_s[0]) & (attitude.time_s <= time_s[-1])
    )
    reference_s = attitude.time_s[row]
    if row.size < 2:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    step_s = float(np.median(np.diff(reference_s)))
    starts = np.arange(reference_s[0], reference_s[-1] - window_s + 0.5 * step_s, window_s)
    first = np.searchsorted(reference_s, starts - 0.5 * step_s)
    last = np.clip(np.searchsorted(reference_s, starts + window_s - 0.5 * step_s), 0, row.size - 1)
    is_covered = (np.abs(reference_s[first] - starts) <= 0.51 * step_s) & (
        np.abs(reference_s[last] - starts - window_s) <= 0.51 * step_s
    )
    if start_mask is not None:
        is_covered &= start_mask[row[first]]
    return row[first[is_covered]].astype(np.int64), row[last[is_covered]].astype(np.int64)


def _interval(angle: FloatArray) -> tuple[float, float]:
    rng = np.random.default_rng(SEED)
    drawn = rng.integers(0, angle.size, size=(BOOTSTRAP_COUNT, angle.size))
    low, high = np.percentile(np.sqrt(np.mean(angle[drawn] ** 2, axis=1)), INTERVAL_PERCENT)
    return float(low), float(high)
