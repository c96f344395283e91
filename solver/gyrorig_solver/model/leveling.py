"""Leveling by gravity: tilt zero and lean of the pan axis from an accelerometer at rest.

What to use when: `level_from_rests` for a recording of a unit; `estimate_level` for the mean
readings of rests at several tilts, preferably at several pan angles too.

At a rest, let the vertical in the base frame be u = (p, q, 1) (p, q small: the pan axis leans
relative to the vertical). The commanded tilt is t, the tilt zero z and the board's mount angle
about x is m:

    up in the stage frame = Rx(t)^T (c p + s q, c q - s p, 1),  c, s = cos, sin of pan
    reading = bias + A_x (..) + A_y (..) + A_z (..)

A's columns are the directions of the stage's axes in the accelerometer, scale factors included:
three unknown vectors. Scale factors and bias of the accelerometer are unknown too.

The data separate these quantities as follows:
- A_y and A_z: a circle over tilt, whose phase is phi = z - m. At commanded tilt -phi, the
  accelerometer's forward axis is perpendicular to the pan axis. z and m enter every reading, and
  the gyro's rates, only as their difference: no sensor on the board separates them. Only a board
  that is known to be flush (m = 0 within its tolerance), or the same board after a second mounting,
  gives a tilt zero. Over many boards with random m, the mean of phi is z.
- p and q: their contribution rotates with pan. At one pan angle, only the sum of phi and the lean
  at that angle is known, and phi is only as accurate as the level of the rig.
- The gyro's phase (its misalignment about x is m - z) does not contain the lean. Gyro and
  accelerometer are on one die within the data sheet's tolerance (1 to 2 %, or 10 to 20 mrad). The
  sum of the two phases is the forward lean of the pan axis, even at one pan angle, within that
  tolerance.
- A pan axis that is not perpendicular to the tilt axis adds a constant, which the bias absorbs.
"""

from dataclasses import dataclass, replace

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray
from gyrorig_solver.model.parameter_units import plural

LEVEL_STD_RAD = 0.035  # a rig on a table is level within about 2 deg
# Standard deviations of A's x column, which only the lean shows: the scale factor of an
# accelerometer (ADXL345: +-10 %) and its cross-axis sensitivity, relative to gravity.
CROSS_AXIS_STD = (0.1, 0.02, 0.02)
MIN_TILTS = 3  # for the bias, scale factor and phase of an axis
MIN_TILT_RANGE_RAD = 0.35  # of tilt: below 20 deg bias and phase are nearly inseparable
MIN_TILT_STEP_RAD = 0.02  # closer tilts count as one
MAX_ITERATIONS = 20
UNKNOWN_COUNT = 14  # bias, A_y, A_z, lean, error of A_x
MAX_REST_STEP_RAD = 1e-6  # between two samples; a step is a thousand times as large
SETTLING_TIME_S = 0.3  # after a stop, until the head stops ringing
MIN_REST_S = 0.5  # of a rest after settling


@dataclass(frozen=True, slots=True, eq=False)
class LevelEstimate:
    """The phase of gravity over tilt, and the lean of the pan axis."""

    offset_rad: float  # phi = tilt zero - mount angle about x, relative to the pan axis
    offset_std_rad: float  # includes the lean, even at one pan angle
    lean_rad: FloatArray  # (2,), vertical in the base frame: to the right (x), forward (y)
    lean_std_rad: FloatArray  # (2,), `LEVEL_STD_RAD` if the pan angles do not show it
    reduced_chi2: float  # 1 if the readings' standard deviations explain the residual
    rests: int


def estimate_level(
    pan_rad: FloatArray, tilt_rad: FloatArray, reading_m_s2: FloatArray, std_m_s2: float
) -> LevelEstimate:
    """Estimate tilt zero and lean from the readings at rest (Gauss-Newton).

    Args:
        pan_rad: commanded, shape (m,).
        tilt_rad: commanded, shape (m,).
        reading_m_s2: mean of each rest, counts times nominal scale, board frame, (m, 3).
        std_m_s2: of each mean, per axis.

    Raises:
        InputError: there are too few tilts, or they are too close to each other.
    """
    ordered = np.sort(tilt_rad)
    tilts = 1 + int(np.sum(np.diff(ordered) > MIN_TILT_STEP_RAD)) if ordered.size else 0
    if tilts < MIN_TILTS or ordered[-1] - ordered[0] < MIN_TILT_RANGE_RAD:
        raise InputError(
            "the tilt angle at which the board is level cannot be measured, because the unit "
            f"rested at only {plural(tilts, 'tilt angle')} in a range of "
            f"{np.degrees(np.ptp(ordered)) if tilts else 0.0:.0f} deg",
            f"record rests at {MIN_TILTS} or more tilt angles that span at least "
            f"{np.degrees(MIN_TILT_RANGE_RAD):.0f} deg",
        )
    estimate, covariance, chi2 = _fit(pan_rad, tilt_rad, reading_m_s2, std_m_s2)
    ahead, up = estimate[4], estimate[7]  # A_y and A_z of the forward (y) axis
    slope = np.zeros(UNKNOWN_COUNT)
    slope[4], slope[7] = np.array([-up, ahead]) / (ahead**2 + up**2)
    return LevelEstimate(
        offset_rad=float(np.arctan2(up, ahead)),
        offset_std_rad=float(np.sqrt(slope @ covariance @ slope)),
        lean_rad=estimate[9:11],
        lean_std_rad=np.sqrt(np.diag(covariance)[9:11]),
        reduced_chi2=chi2,
        rests=int(tilt_rad.size),
    )


def _fit(
    pan_rad: FloatArray, tilt_rad: FloatArray, reading: FloatArray, std: float
) -> tuple[FloatArray, FloatArray, float]:
    """Return the unknowns, their covariance, and chi2 per degree of freedom.

    A_x is perpendicular to A_y and A_z except for the prior of `CROSS_AXIS_STD`.
    """
    sine, cosine = np.sin(tilt_rad), np.cos(tilt_rad)
    design = np.column_stack([np.ones_like(sine), sine, cosine])
    start = np.linalg.lstsq(design, reading, rcond=None)[0]
    estimate = np.concatenate([start.ravel(), np.zeros(UNKNOWN_COUNT - 9)])
    prior = np.zeros(UNKNOWN_COUNT)
    prior[9:11] = LEVEL_STD_RAD**-2.0
    prior[11:] = np.array(CROSS_AXIS_STD) ** -2.0
    for _ in range(MAX_ITERATIONS):
        model, jacobian = _model(pan_rad, sine, cosine, estimate)
        residual = (reading - model).ravel()
        information = jacobian.T @ jacobian / std**2 + np.diag(prior)
        scale = 1.0 / np.sqrt(np.diag(information))
        inverse = scale[:, None] * np.linalg.pinv(information * np.outer(scale, scale)) * scale
        step = inverse @ (jacobian.T @ residual / std**2 - prior * estimate)
        estimate = estimate + step
        if np.max(np.abs(step) * np.sqrt(np.diag(information))) < 1e-6:
            break
    residual = (reading - _model(pan_rad, sine, cosine, estimate)[0]).ravel()
    degrees_of_freedom = max(1, residual.size - UNKNOWN_COUNT)
    return estimate, inverse, float(residual @ residual / std**2 / degrees_of_freedom)


def _model(
    pan_rad: FloatArray, sine: FloatArray, cosine: FloatArray, estimate: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return readings (m, 3) and their derivatives (3 m, 14)."""
    bias, ahead, up = estimate[:3], estimate[3:6], estimate[6:9]
    length = np.sqrt(float(np.linalg.norm(ahead) * np.linalg.norm(up)))
    across = np.cross(ahead, up) / length + length * estimate[11:]
    c, s = np.cos(pan_rad), np.sin(pan_rad)
    # The two components of the lean in the frame of the tilt axis's carrier.
    right = np.column_stack([c, s])
    forward = np.column_stack([-s, c])
    lean_right, lean_forward = right @ estimate[9:11], forward @ estimate[9:11]
    y, z = sine + cosine * lean_forward, cosine - sine * lean_forward
    model = bias + np.outer(lean_right, across) + np.outer(y, ahead) + np.outer(z, up)
    jacobian = np.zeros((pan_rad.size, 3, UNKNOWN_COUNT))
    for axis in range(3):
        jacobian[:, axis, axis] = 1.0
        jacobian[:, axis, 3 + axis] = y
        jacobian[:, axis, 6 + axis] = z
        tilt_derivative = cosine * ahead[axis] - sine * up[axis]
        jacobian[:, axis, 9:11] = right * across[axis] + forward * tilt_derivative[:, None]
        jacobian[:, axis, 11 + axis] = lean_right * length
    return model, jacobian.reshape(-1, UNKNOWN_COUNT)


@dataclass(frozen=True, slots=True, eq=False)
class RestMeans:
    """The mean accelerometer reading of every rest."""

    pan_rad: FloatArray  # (m,)
    tilt_rad: FloatArray  # (m,)
    reading_m_s2: FloatArray  # (m, 3)
    std_m_s2: float  # of each mean, per axis, from the scatter within the rests


def rest_means(time_s: FloatArray, accel_m_s2: FloatArray, angle_rad: FloatArray) -> RestMeans:
    """Return the mean readings of the rests of a recording.

    Args:
        time_s: of the samples, shape (n,), not decreasing.
        accel_m_s2: counts times nominal scale, (n, 3); rows that are not finite are ignored.
        angle_rad: commanded pan and tilt at the samples, (2, n).

    Raises:
        InputError: there is no rest that is long enough.
    """
    at_rest = np.all(np.abs(np.diff(angle_rad, axis=1)) < MAX_REST_STEP_RAD, axis=0)
    change = np.diff(np.concatenate([[False], at_rest, [False]]).astype(np.int8))
    begins, ends = np.flatnonzero(change == 1), np.flatnonzero(change == -1)
    pans, tilts, readings, scatter = [], [], [], []
    for begin, end in zip(begins, ends, strict=True):
        # At the beginning of a recording, no stop precedes the rest.
        settled_s = time_s[begin] + (SETTLING_TIME_S if begin else 0.0)
        inside = np.arange(begin, end + 1)
        inside = inside[(time_s[inside] >= settled_s) & np.isfinite(accel_m_s2[inside]).all(axis=1)]
        if inside.size < 2 or time_s[inside[-1]] - time_s[inside[0]] < MIN_REST_S:
            continue
        pans.append(angle_rad[0, inside[0]])
        tilts.append(angle_rad[1, inside[0]])
        readings.append(accel_m_s2[inside].mean(axis=0))
        scatter.append(accel_m_s2[inside].var(axis=0, ddof=1).mean() / inside.size)
    if not readings:
        raise InputError(
            "the recording has no accelerometer samples from a rest of the unit",
            f"rest for {SETTLING_TIME_S + MIN_REST_S:.1f} s or longer at several tilt angles",
        )
    return RestMeans(
        np.array(pans), np.array(tilts), np.stack(readings), float(np.sqrt(np.median(scatter)))
    )


def level_from_rests(
    time_s: FloatArray, accel_m_s2: FloatArray, angle_rad: FloatArray
) -> LevelEstimate:
    """Estimate tilt zero and lean from all rests of a recording.

    The bias drifts, and a stepper does not always stop at the same place. If the rests scatter more
    than the samples within them, the standard deviations are scaled up accordingly.

    Args:
        time_s: of the samples, shape (n,).
        accel_m_s2: shape (n, 3).
        angle_rad: commanded pan and tilt at the samples, (2, n).

    Raises:
        InputError: there are too few rests or tilts, or the tilts are too close to each other.
    """
    rests = rest_means(time_s, accel_m_s2, angle_rad)
    positions_and_readings = rests.pan_rad, rests.tilt_rad, rests.reading_m_s2
    first = estimate_level(*positions_and_readings, rests.std_m_s2)
    if first.reduced_chi2 <= 1.0:
        return first
    widened_std = rests.std_m_s2 * float(np.sqrt(first.reduced_chi2))
    widened = estimate_level(*positions_and_readings, widened_std)
    return replace(widened, reduced_chi2=first.reduced_chi2)
