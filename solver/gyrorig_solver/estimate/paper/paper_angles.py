"""Equations 1, 2, 6, 11 and 12 of the paper: the angles that its calibration compares.

What to use when: `integrated_rad` and `line_slope` give the paper's measured angles and its bias;
`composed_attitude` and `euler_angles_rad` are eq. 12 and eq. 11. `mechanism_angles_rad` and
`ideal_integral_rad` give the true angles of a pan-tilt unit and of a perfect gyro on it, which show
the error of the paper's reference.

Source: Delgado, Silva, Quiroz, Kurka, "Automatic Calibration of Low Cost Inertial Gyroscopes with a
PTU", sections II and IV.
"""

from typing import Literal

import numpy as np

from gyrorig_solver.data import FloatArray

Composition = Literal["printed", "right", "mechanism"]
"""How eq. 12 combines increments.

`printed`: both increments from the left, as written. `right`: both from the right.
`mechanism`: pan from the left, tilt from the right, as a pan-tilt unit turns.
"""

SlopeEstimate = Literal["line", "mean"]
"""The slope of an integrated signal: of a fitted line, or from end to end."""


def integrated_rad(time_s: FloatArray, rate_rad_s: FloatArray) -> FloatArray:
    """Integrate rates by the trapezoidal rule, from zero at the first sample.

    Args:
        time_s: increasing, shape (n,).
        rate_rad_s: shape (n, 3).

    Returns:
        Angles, shape (n, 3).

    Source: eq. 1, "calculated from the integration of unbiased angular speed measurements"; the
    paper does not name the integration rule.
    """
    step_rad = 0.5 * (rate_rad_s[1:] + rate_rad_s[:-1]) * np.diff(time_s)[:, None]
    angle_rad = np.zeros_like(rate_rad_s)
    np.cumsum(step_rad, axis=0, out=angle_rad[1:])
    return angle_rad


def line_slope(
    time_s: FloatArray, angle_rad: FloatArray, slope: SlopeEstimate = "line"
) -> FloatArray:
    """Return the slope of an integrated signal, which the paper uses as the bias.

    Args:
        time_s: shape (n,), n >= 2.
        angle_rad: shape (n, 3).
        slope: `line` fits a line with an intercept, `mean` goes from end to end.

    Returns:
        Slope in rad/s, shape (3,).

    Source: section IV, "estimated through calculation of the angular coefficients of the
    interpolating lines".
    """
    if slope == "mean":
        return np.asarray((angle_rad[-1] - angle_rad[0]) / (time_s[-1] - time_s[0]))
    centred_s = time_s - time_s.mean()
    return np.asarray(centred_s @ angle_rad / (centred_s @ centred_s))


def _rotations(axis: Literal[0, 2], angle_rad: FloatArray) -> FloatArray:
    """Return active rotation matrices about x (0) or z (2), shape (n, 3, 3)."""
    first, second = (1, 2) if axis == 0 else (0, 1)
    matrices = np.zeros((angle_rad.size, 3, 3))
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    matrices[:, axis, axis] = 1.0
    matrices[:, first, first] = matrices[:, second, second] = cosine
    matrices[:, first, second], matrices[:, second, first] = -sine, sine
    return matrices


def composed_attitude(
    pan_rad: FloatArray, tilt_rad: FloatArray, composition: Composition = "printed"
) -> FloatArray:
    """Return the cumulative rotation matrices R_t of eq. 12, the identity at the first sample.

    The roll increment of eq. 12 is zero: a pan-tilt unit has no roll axis.

    Args:
        pan_rad: shape (n,).
        tilt_rad: shape (n,).
        composition: how eq. 12 is interpreted, see `Composition`.

    Returns:
        Shape (n, 3, 3).
    """
    if composition == "mechanism":
        return _rotations(2, pan_rad - pan_rad[0]) @ _rotations(0, tilt_rad - tilt_rad[0])
    product = np.empty((pan_rad.size, 3, 3))
    product[0] = np.eye(3)
    product[1:] = _rotations(2, np.diff(pan_rad)) @ _rotations(0, np.diff(tilt_rad))
    reach = 1
    while reach < pan_rad.size:  # prefix products by doubling: log2(n) array operations
        later, earlier = product[reach:], product[:-reach]
        product[reach:] = later @ earlier if composition == "printed" else earlier @ later
        reach *= 2
    return product


def euler_angles_rad(attitude: FloatArray) -> FloatArray:
    """Return the angles psi (about x), theta (about y), phi (about z) of eq. 11.

    The text writes `atan` of two arguments; here it is the four-quadrant function. The division of
    both arguments of phi by cos(theta) has no effect, because theta is within a quarter turn. At a
    quarter turn it divides by zero, so it is left out; `nearest_singularity` detects that case.

    Args:
        attitude: rotation matrices, shape (n, 3, 3).

    Returns:
        Shape (n, 3), columns x, y, z.
    """
    angle_rad = np.empty((attitude.shape[0], 3))
    angle_rad[:, 0] = np.arctan2(attitude[:, 2, 1], attitude[:, 2, 2])
    angle_rad[:, 1] = -np.arcsin(np.clip(attitude[:, 2, 0], -1.0, 1.0))
    angle_rad[:, 2] = np.arctan2(attitude[:, 1, 0], attitude[:, 0, 0])
    return angle_rad


def nearest_singularity(angle_rad: FloatArray) -> float:
    """Return the smallest cos(theta) of eq. 11; `angle_rad` as from `euler_angles_rad`."""
    return float(np.cos(angle_rad[:, 1]).min())


def mechanism_angles_rad(pan_rad: FloatArray, tilt_rad: FloatArray) -> FloatArray:
    """Return the true angles of R = Rz(pan) Rx(tilt) by eq. 11, from zero: (tilt, 0, pan).

    No path of a pan-tilt unit has a roll: the rank of a matrix U of these is at most 2.
    """
    zero = np.zeros_like(pan_rad)
    return np.column_stack((tilt_rad - tilt_rad[0], zero, pan_rad - pan_rad[0]))


def ideal_integral_rad(pan_rad: FloatArray, tilt_rad: FloatArray) -> FloatArray:
    """Return the integral of a perfect, aligned gyro on the unit, shape (n, 3).

    The stage turns at (tilt_rate, pan_rate sin tilt, pan_rate cos tilt). The integral of this rate
    depends on the path and is not zero when the unit returns: a geometric phase, not a drift.
    """
    pan_step, tilt_step = np.diff(pan_rad), np.diff(tilt_rad)
    middle_rad = 0.5 * (tilt_rad[1:] + tilt_rad[:-1])
    angle_rad = np.zeros((pan_rad.size, 3))
    angle_rad[1:, 0] = np.cumsum(tilt_step)
    angle_rad[1:, 1] = np.cumsum(pan_step * np.sin(middle_rad))
    angle_rad[1:, 2] = np.cumsum(pan_step * np.cos(middle_rad))
    return angle_rad
