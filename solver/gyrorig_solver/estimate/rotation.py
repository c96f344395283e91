"""How far a calibrated gyro's rotation is from the reference's, over windows.

What to use when: `window_rotation_error` on data that the fit has not seen: it judges a
calibration by what users do with a gyro, without any of the fit's own assumptions.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from gyrorig_protocol.errors import InputError
from gyrorig_solver.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.reference.attitude import AttitudeReference
from gyrorig_solver.reference.rotations import total_rotation

# Steps of the integration: short against any motion of a hand, at gyro rates from 50 Hz on.
STEP_S = 0.005
BOOTSTRAPS = 2000
INTERVAL = (2.5, 97.5)  # percent
SEED = 20260131  # so that the same input gives the same interval


@dataclass(frozen=True, slots=True, eq=False)
class RotationError:
    """Angle between integrated and true rotation, one value a window."""

    angle_rad: FloatArray  # (n,)
    begin_s: FloatArray  # (n,), of each window
    window_s: float
    rms_rad: float
    interval_rad: tuple[float, float]  # 95 %, bootstrap over windows

    @property
    def median_rad(self) -> float:
        """The median over the windows."""
        return float(np.median(self.angle_rad))


def window_rotation_error(
    time_s: FloatArray,
    rate_rad_s: FloatArray,
    attitude: AttitudeReference,
    window_s: float = 1.0,
    use: BoolArray | None = None,
) -> RotationError:
    """Integrate a rate over windows and compare with the reference's rotation.

    Args:
        time_s: of the rates, with the time offset already taken off, shape (n,).
        rate_rad_s: calibrated body rate, shape (n, 3).
        attitude: on the same time axis.
        window_s: length of each window; windows follow each other without overlap.
        use: of the reference's rows, where windows may begin; None: everywhere.

    Returns:
        The angle errors of the windows that both cover, their rms and its 95 % interval.

    Raises:
        InputError: no window is covered by both.
    """
    begin, end = _windows(time_s, attitude, window_s, use)
    if begin.size == 0:
        raise InputError(
            f"gyro and reference attitude have no window of {window_s:g} s in common",
            "record both for longer",
        )
    steps = max(2, int(np.ceil(window_s / STEP_S)))
    spline = CubicSpline(time_s, rate_rad_s)
    first, last = attitude.time_s[begin], attitude.time_s[end]
    fraction = np.linspace(0.0, 1.0, steps + 1)
    at = first[:, None] + fraction * (last - first)[:, None]
    rate = spline(at.ravel()).reshape(begin.size, steps + 1, 3)
    angle_sum = spline.antiderivative()(at.ravel()).reshape(begin.size, steps + 1, 3)
    step_s = np.diff(at, axis=1)[:, :, None]
    # The integral of the rate, and the coning term of `rotations.turn_vectors`.
    vectors = np.diff(angle_sum, axis=1) + np.cross(rate[:, :-1], rate[:, 1:]) * step_s**2 / 12.0
    q = attitude.orientation_xyzw
    true = Rotation.from_quat(q[begin]).inv() * Rotation.from_quat(q[end])
    angle = np.asarray((true.inv() * total_rotation(vectors)).magnitude(), dtype=np.float64)
    return RotationError(
        angle_rad=angle,
        begin_s=first,
        window_s=window_s,
        rms_rad=float(np.sqrt(np.mean(angle**2))),
        interval_rad=_interval(angle),
    )


def _windows(
    time_s: FloatArray, attitude: AttitudeReference, window_s: float, use: BoolArray | None
) -> tuple[IntArray, IntArray]:
    """Return the rows at which each window begins and ends."""
    there = np.all(np.isfinite(attitude.orientation_xyzw), axis=1)
    row = np.flatnonzero(there & (attitude.time_s >= time_s[0]) & (attitude.time_s <= time_s[-1]))
    reference_s = attitude.time_s[row]
    if row.size < 2:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    step_s = float(np.median(np.diff(reference_s)))
    starts = np.arange(reference_s[0], reference_s[-1] - window_s + 0.5 * step_s, window_s)
    first = np.searchsorted(reference_s, starts - 0.5 * step_s)
    last = np.clip(np.searchsorted(reference_s, starts + window_s - 0.5 * step_s), 0, row.size - 1)
    near = (np.abs(reference_s[first] - starts) <= 0.51 * step_s) & (
        np.abs(reference_s[last] - starts - window_s) <= 0.51 * step_s
    )
    if use is not None:
        near &= use[row[first]]
    return row[first[near]].astype(np.int64), row[last[near]].astype(np.int64)


def _interval(angle: FloatArray) -> tuple[float, float]:
    rng = np.random.default_rng(SEED)
    drawn = rng.integers(0, angle.size, size=(BOOTSTRAPS, angle.size))
    low, high = np.percentile(np.sqrt(np.mean(angle[drawn] ** 2, axis=1)), INTERVAL)
    return float(low), float(high)
