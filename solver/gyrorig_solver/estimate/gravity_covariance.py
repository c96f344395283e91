"""Covariance of the residuals of moves between rests, and of the gain that is fitted to them.

What to use when: `predict_gain` for the information on the gain at the end of `gravity_fit`.

Theory of operation. The errors of the moves are not independent. Two moves share the direction of
gravity and the rate at the rest between them, and all moves share the errors of the nine unknowns
of the accelerometer, which come from the same rests. The residuals r of all moves therefore have a
covariance C with terms outside of its diagonal. The gain of a fit with weights W has the covariance
K C K', K = (J'WJ)^-1 J'W. C is predicted from the noise at the rests and from the misfit of the
accelerometer. If the residuals are larger than predicted, C is scaled to them. Few rests and few
moves determine these two scales badly. Student's t distribution therefore widens both.

Sources: White, Econometrica 48 (1980), for the covariance of an estimate with other weights; GUM,
JCGM 100:2008, G.3, for few degrees of freedom.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.gravity_residual import ACCEL_UNKNOWNS, GAIN_UNKNOWNS, RestErrors
from gyrorig_solver.estimate.gravity_solver import GravityMove, LinearisedMoves
from gyrorig_solver.numerics import student_factor
from gyrorig_solver.reference import StaticPoses

# Smaller eigenvalues of the normalised normal matrix are rounding errors of zero.
_LEAST_EIGENVALUE = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class GainPrediction:
    """What the errors of moves and rests state of the gain."""

    information: FloatArray  # (9, 9), on G
    sigma_rad: float  # standard deviation of the residuals in each direction
    predicted_rad: float  # the same, as predicted
    accel_share: float  # of the predicted variance, by the accelerometer


def predict_gain(
    moves: Sequence[GravityMove],
    linear: LinearisedMoves,
    rests: Sequence[RestErrors],
    poses: StaticPoses,
) -> GainPrediction:
    """Return the information on the gain, and the observed and the predicted residuals.

    Args:
        moves: of the fit.
        linear: the same moves at the fitted gain.
        rests: all rests of the recording.
        poses: the directions of gravity at the rests.
    """
    by_gyro, by_accel = _residual_covariances(moves, linear, rests, poses)
    size = 3 * len(moves)
    jacobian = linear.by_gain.reshape(size, 9)
    weight = np.repeat(linear.weight, 3)
    normal = jacobian.T @ (weight[:, None] * jacobian)
    inverse = _pseudo_inverse(normal)
    # The fit removes a part of the errors from the residuals.
    remover = np.eye(size) - jacobian @ inverse @ (jacobian.T * weight)
    gyro_sum, accel_sum = (
        float(weight @ np.einsum("ij,jk,ik->i", remover, covariance, remover, optimize=True))
        for covariance in (by_gyro, by_accel)
    )
    predicted_sum = gyro_sum + accel_sum
    observed_sum = float(weight @ linear.residual.ravel() ** 2)
    freedom = max(2 * len(moves) - GAIN_UNKNOWNS, 1)
    weighted = jacobian * weight[:, None]
    rest_freedom = max(len(rests) - ACCEL_UNKNOWNS, 1)
    covariance = by_gyro + by_accel * student_factor(rest_freedom) ** 2
    observed_scale = observed_sum / predicted_sum * float(student_factor(freedom)) ** 2
    score_covariance = weighted.T @ covariance @ weighted * max(1.0, observed_scale)
    return GainPrediction(
        information=normal @ _pseudo_inverse(score_covariance) @ normal,
        sigma_rad=float(np.sqrt(observed_sum / freedom)),
        predicted_rad=float(np.sqrt(predicted_sum / freedom)),
        accel_share=accel_sum / predicted_sum,
    )


def _residual_covariances(
    moves: Sequence[GravityMove],
    linear: LinearisedMoves,
    rests: Sequence[RestErrors],
    poses: StaticPoses,
) -> tuple[FloatArray, FloatArray]:
    """Return the covariances of all residuals by the gyro and by the accelerometer, (3m, 3m)."""
    size, rest_size = 3 * len(moves), 3 * len(rests)
    by_direction = np.zeros((size, rest_size))
    by_bias = np.zeros((size, rest_size))
    by_gyro = np.zeros((size, size))
    for k, move in enumerate(moves):
        rows = slice(3 * k, 3 * k + 3)
        before, after = (slice(3 * i, 3 * i + 3) for i in (move.rest_before, move.rest_before + 1))
        by_direction[rows, before] = -linear.end[k].T
        by_direction[rows, after] = np.eye(3)
        # Each move uses the mean of the rates at its two rests.
        by_bias[rows, before] = by_bias[rows, after] = linear.by_bias[k] / 2.0
        across = np.eye(3) - np.outer(move.gravity_after, move.gravity_after)
        by_gyro[rows, rows] = move.variance_rad2 * across
    variances = np.concatenate([rest.rate_variance_rad2_s2 for rest in rests])
    by_gyro += (by_bias * variances) @ by_bias.T
    # All rests have the same error by rounding.
    rounding_std = np.median([rest.rounding_std_rad_s for rest in rests], axis=0)
    by_rounding = by_bias.reshape(size, -1, 3).sum(axis=1) * rounding_std
    by_gyro += by_rounding @ by_rounding.T
    directions = _direction_covariance(rests, poses)
    return by_gyro, by_direction @ directions @ by_direction.T


def _direction_covariance(rests: Sequence[RestErrors], poses: StaticPoses) -> FloatArray:
    """Return the covariance of the directions of gravity at all rests, (3n, 3n), rad^2.

    The misfit is the error of a pose along gravity. Its excess over the noise also acts across
    gravity. The errors along gravity are also those of the nine unknowns.
    """
    noise = np.array([rest.force_variance_m2_s4 for rest in rests])
    variance = noise + max(poses.accel.residual_m_s2**2 - float(noise.mean()), 0.0)
    up, matrix, gravity_m_s2 = poses.direction, poses.accel.matrix, poses.gravity_m_s2
    centred = gravity_m_s2 * up @ np.linalg.inv(matrix).T
    by_unknowns = np.zeros((len(up), 3, ACCEL_UNKNOWNS))
    for column, (i, j) in enumerate(zip(*np.triu_indices(3), strict=True)):
        by_unknowns[:, i, column] = centred[:, j]
    by_unknowns[:, :, 6:] = -matrix
    along = np.einsum("ni,nij->nj", up, by_unknowns)
    scale = np.linalg.norm(along, axis=0)
    solve = np.linalg.pinv(along / scale) / scale[:, None]
    across = np.eye(3) - up[:, :, None] * up[:, None, :]
    shared = (across @ by_unknowns).reshape(-1, ACCEL_UNKNOWNS) @ solve * np.sqrt(variance)
    covariance = shared @ shared.T
    for k in range(len(up)):
        rows = slice(3 * k, 3 * k + 3)
        covariance[rows, rows] += variance[k] * across[k]
    return np.asarray(covariance / gravity_m_s2**2, dtype=np.float64)


def _pseudo_inverse(matrix: FloatArray) -> FloatArray:
    """Return the inverse of a positive matrix; directions with a value of zero stay zero."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    values, vectors = np.linalg.eigh(matrix / np.outer(scale, scale))
    observed = values > _LEAST_EIGENVALUE * max(float(values[-1]), 1e-300)
    scaled = vectors[:, observed] / scale[:, None]
    return np.asarray((scaled / values[observed]) @ scaled.T, dtype=np.float64)
