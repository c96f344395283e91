"""The gain matrix G = S T M and its unique factors (scale, non-orthogonality, misalignment).

S is diagonal, T unit lower triangular and M a rotation: the LQ factorisation of G (Delgado et al.,
eq. 8 to 10, read as an LQ factorisation, because eq. 9 as printed has the factors in the wrong
order; see docs/paper.md).
"""

from dataclasses import dataclass
from itertools import product
from typing import Self

import numpy as np

from gyrorig_solver.data import FloatArray

# The order of the nine numbers of S, T and M in every covariance.
FACTOR_NAMES = (
    "scale.x",
    "scale.y",
    "scale.z",
    "nonorthogonality.xy",
    "nonorthogonality.zx",
    "nonorthogonality.zy",
    "misalignment.x",
    "misalignment.y",
    "misalignment.z",
)
GAIN_NAMES = tuple(f"gain.{row}{column}" for row in "xyz" for column in "xyz")


@dataclass(frozen=True, slots=True, eq=False)
class GainFactors:
    """The factors S, T and M of one gain matrix."""

    scale: FloatArray  # (3,), 1 = nominal
    nonorthogonality: FloatArray  # (3,), the entries yx, zx, zy of T (named xy, zx, zy)
    misalignment_rad: FloatArray  # (3,), rotation vector of M, stage to sensor

    @property
    def S(self) -> FloatArray:
        """The scale matrix, shape (3, 3)."""
        return np.diag(self.scale)

    @property
    def T(self) -> FloatArray:
        """The non-orthogonality matrix, unit lower triangular, shape (3, 3)."""
        lower = np.eye(3)
        lower[1, 0], lower[2, 0], lower[2, 1] = self.nonorthogonality
        return lower

    @property
    def M(self) -> FloatArray:
        """The misalignment, a rotation from the stage to the sensor, shape (3, 3)."""
        return rotation_matrix(self.misalignment_rad)

    @property
    def gain(self) -> FloatArray:
        """G = S T M, shape (3, 3)."""
        return np.asarray(self.S @ self.T @ self.M, dtype=np.float64)

    def as_vector(self) -> FloatArray:
        """Return the nine numbers in the order of `FACTOR_NAMES`."""
        return np.concatenate([self.scale, self.nonorthogonality, self.misalignment_rad])

    @classmethod
    def from_vector(cls, vector: FloatArray) -> Self:
        """Return the factors of nine numbers in the order of `FACTOR_NAMES`."""
        return cls(vector[:3], vector[3:6], vector[6:])


def factorise(gain: FloatArray) -> GainFactors:
    """Return the factors S, T and M of a gain matrix (LQ factorisation).

    Args:
        gain: G, shape (3, 3), sensor rate per stage rate.

    Returns:
        The factors, with M a rotation (determinant +1). Scale factors are positive if the
        determinant of G is positive. A mirrored sensor (one axis counts backwards) has a negative
        scale factor on the axis for which M is nearest to the identity.

    Raises:
        ValueError: G is singular, so the factorisation is not unique.
    """
    if not np.all(np.isfinite(gain)) or np.linalg.cond(gain) > 1e9:
        raise ValueError("the gain matrix is singular")
    q_t, r_t = np.linalg.qr(gain.T)
    lower, rotation = r_t.T, q_t.T
    signs = np.sign(np.diag(lower))
    lower, rotation = lower * signs, signs[:, None] * rotation
    if np.linalg.det(rotation) < 0.0:
        flips = [np.array(f) for f in product((1.0, -1.0), repeat=3) if np.prod(f) < 0]
        best = max(flips, key=lambda f: float(np.trace(f[:, None] * rotation)))
        lower, rotation = lower * best, best[:, None] * rotation
    scale = np.diag(lower).copy()
    unit_lower = lower / scale[:, None]
    # T has a unit diagonal when each row of L is divided by its own scale.
    return GainFactors(
        scale=scale,
        nonorthogonality=np.array([unit_lower[1, 0], unit_lower[2, 0], unit_lower[2, 1]]),
        misalignment_rad=rotation_vector(rotation),
    )


def factor_jacobian(factors: GainFactors) -> FloatArray:
    """Return d(S, T, M)/dG, shape (9, 9): rows as `FACTOR_NAMES`, columns as `GAIN_NAMES`.

    It is the inverse of the analytic derivative of G = S T M. The rotation changes as dM = [J_l(r)
    dr]x M with the left Jacobian J_l of SO(3).
    """
    S, T, M = factors.S, factors.T, factors.M
    forward = np.zeros((9, 9))
    for i in range(3):
        unit = np.zeros((3, 3))
        unit[i, i] = 1.0
        forward[:, i] = (unit @ T @ M).ravel()
    for k, (row, column) in enumerate(((1, 0), (2, 0), (2, 1))):
        unit = np.zeros((3, 3))
        unit[row, column] = 1.0
        forward[:, 3 + k] = (S @ unit @ M).ravel()
    left = left_jacobian(factors.misalignment_rad)
    for k in range(3):
        forward[:, 6 + k] = (S @ T @ cross_matrix(left[:, k]) @ M).ravel()
    return np.asarray(np.linalg.inv(forward), dtype=np.float64)


def factorise_near(gains: FloatArray, near: GainFactors) -> FloatArray:
    """Return the nine factors of many gain matrices, on the branch of one factorisation.

    The signs of the scale factors are those of `near`, so that the factors are continuous functions
    of the gain around it.

    Args:
        gains: matrices, shape (n, 3, 3).
        near: factors of a gain among them.

    Returns:
        Factors in the order of `FACTOR_NAMES`, shape (n, 9); NaN if the branch ends: the matrix is
        singular, its determinant has the other sign, or M is half a turn.
    """
    q_t, r_t = np.linalg.qr(np.swapaxes(gains, 1, 2))
    lower, rotation = np.swapaxes(r_t, 1, 2), np.swapaxes(q_t, 1, 2)
    signs = np.sign(np.diagonal(lower, axis1=1, axis2=2)) * np.sign(near.scale)
    lower, rotation = lower * signs[:, None, :], signs[:, :, None] * rotation
    scale = np.diagonal(lower, axis1=1, axis2=2)
    skew = np.stack(
        [rotation[:, k - 1, k - 2] - rotation[:, k - 2, k - 1] for k in range(3)], axis=1
    )
    sine = np.linalg.norm(skew, axis=1) / 2.0
    cosine = (np.trace(rotation, axis1=1, axis2=2) - 1.0) / 2.0
    is_small = sine < 1e-7
    half_angle_ratio = np.where(
        is_small, 0.5, np.arctan2(sine, cosine) / (2.0 * np.where(is_small, 1.0, sine))
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        unit_lower = lower / scale[:, :, None]
    factors = np.concatenate(
        [
            scale,
            unit_lower[:, [1, 2, 2], [0, 0, 1]],
            skew * half_angle_ratio[:, None],
        ],
        axis=1,
    )
    is_lost = (np.linalg.det(rotation) < 0.5) | (is_small & (cosine < 0.0))
    is_lost |= ~np.isfinite(factors).all(axis=1)
    return np.where(is_lost[:, None], np.nan, factors)


def cross_matrix(v: FloatArray) -> FloatArray:
    """Return the cross-product matrix [v]x, with [v]x w = v x w."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def rotation_matrix(vector_rad: FloatArray) -> FloatArray:
    """Return exp([r]x), Rodrigues' formula, shape (3, 3)."""
    angle = float(np.linalg.norm(vector_rad))
    k = cross_matrix(vector_rad)
    if angle < 1e-8:
        return np.asarray(np.eye(3) + k + k @ k / 2.0, dtype=np.float64)
    return np.asarray(
        np.eye(3) + np.sin(angle) / angle * k + (1.0 - np.cos(angle)) / angle**2 * (k @ k),
        dtype=np.float64,
    )


def rotation_vector(rotation: FloatArray) -> FloatArray:
    """Return the rotation vector (rad) of a rotation matrix; the angle is at most pi."""
    skew = np.array(
        [
            rotation[2, 1] - rotation[1, 2],
            rotation[0, 2] - rotation[2, 0],
            rotation[1, 0] - rotation[0, 1],
        ]
    )
    sine, cosine = float(np.linalg.norm(skew)) / 2.0, (float(np.trace(rotation)) - 1.0) / 2.0
    angle = float(np.arctan2(sine, cosine))
    if sine > 1e-7:
        return np.asarray(skew / (2.0 * sine) * angle, dtype=np.float64)
    if cosine > 0.0:
        return np.asarray(skew / 2.0, dtype=np.float64)
    # Half a turn: the axis is the eigenvector of eigenvalue 1.
    outer = (rotation + np.eye(3)) / 2.0
    column = int(np.argmax(np.diag(outer)))
    axis = outer[:, column] / np.sqrt(outer[column, column])
    return np.asarray(axis * angle, dtype=np.float64)


def left_jacobian(vector_rad: FloatArray) -> FloatArray:
    """Return the left Jacobian of SO(3) at a rotation vector, shape (3, 3)."""
    angle = float(np.linalg.norm(vector_rad))
    k = cross_matrix(vector_rad)
    if angle < 1e-6:
        return np.asarray(np.eye(3) + k / 2.0 + k @ k / 6.0, dtype=np.float64)
    return np.asarray(
        np.eye(3)
        + (1.0 - np.cos(angle)) / angle**2 * k
        + (angle - np.sin(angle)) / angle**3 * (k @ k),
        dtype=np.float64,
    )
