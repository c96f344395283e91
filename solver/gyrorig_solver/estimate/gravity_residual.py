"""Prediction of the residuals of moves between rests.

What to use when: `measure_rest_errors` and `predict_move_variance` for the moves of a fit to
gravity.

Theory of operation. Lost rows, a wrong rate or a moving rest change all moves in the same
direction, and the residuals show only a small part of this error. The module therefore predicts the
residual of each move from the errors that the fit knows: the noise of the gyro and of the
accelerometer, the change of the bias between the two rests, rounding, the integration, the misfit
of the accelerometer and a rotation during a rest. Much larger residuals have a cause that no
standard uncertainty covers. `gravity_covariance` adds the errors that several moves share.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate.rest_mean import MIN_SAMPLES, std_by_rounding, std_of_mean
from gyrorig_solver.model import cross_matrix
from gyrorig_solver.reference import StaticPoses, path_product, turn_vectors

SIGNIFICANT_SIGMA = 3.0
GAIN_UNKNOWNS = ACCEL_UNKNOWNS = 9


@dataclass(frozen=True, slots=True, eq=False)
class RestErrors:
    """The errors of one rest."""

    rate_rad_s: FloatArray  # (3,), mean
    rate_variance_rad2_s2: FloatArray  # (3,), of the mean
    angle_variance_rad2_s: FloatArray  # (3,), of the integral of the noise, per second
    rounding_std_rad_s: FloatArray  # (3,)
    force_variance_m2_s4: float  # of the mean specific force in each axis, by noise
    turned_variance_rad2: float  # of gravity at an end of the rest, because the board turns slowly


def measure_rest_errors(
    samples: GyroSamples, accel_m_s2: FloatArray, poses: StaticPoses
) -> list[RestErrors]:
    """Return the errors of each rest.

    Args:
        samples: of the board.
        accel_m_s2: of its accelerometer, (n, 3).
        poses: the rests.
    """
    return [
        _measure_rest(samples, poses, accel_m_s2, slice(first, last + 1))
        for first, last in zip(poses.first_sample, poses.last_sample, strict=True)
    ]


def _measure_rest(
    samples: GyroSamples, poses: StaticPoses, accel_m_s2: FloatArray, part: slice
) -> RestErrors:
    rate = samples.rate_rad_s[part][samples.usable[part]]
    force = poses.accel.apply(accel_m_s2[part][np.isfinite(accel_m_s2[part]).all(axis=1)])
    gravity_m_s2 = float(np.linalg.norm(force.mean(axis=0)))
    rate_std = _std_of_mean(rate)
    noise = float(np.mean(_std_of_mean(force) ** 2))
    halves = [half.mean(axis=0) for half in np.array_split(force, 2)]
    # The direction at an end of the rest differs from the mean by this if the board turns slowly.
    # Each half has twice the variance by noise, in two directions.
    turned_m_s2 = float(np.linalg.norm(np.cross(*halves))) / gravity_m_s2
    turned = float(_beyond_noise(np.array(turned_m_s2**2), np.array(8.0 * noise))) / 2.0
    # Rounding is white noise of q^2/12 in motion, and hides smaller noise at rest.
    least = samples.quantum_rad_s**2 / 12.0 * samples.period_s
    return RestErrors(
        rate_rad_s=rate.mean(axis=0),
        rate_variance_rad2_s2=rate_std**2,
        angle_variance_rad2_s=np.maximum(rate_std**2 * len(rate) * samples.period_s, least),
        rounding_std_rad_s=std_by_rounding(rate, samples.quantum_rad_s),
        force_variance_m2_s4=noise,
        turned_variance_rad2=turned / gravity_m_s2**2,
    )


def _std_of_mean(values: FloatArray) -> FloatArray:
    if len(values) >= 2 * MIN_SAMPLES:
        return std_of_mean(values)
    return np.asarray(np.std(values, axis=0, ddof=1) / np.sqrt(len(values)), dtype=np.float64)


def predict_move_variance(
    before: RestErrors,
    after: RestErrors,
    step_s: FloatArray,
    rate_rad_s: FloatArray,
    gravity: FloatArray,
) -> float:
    """Return the variance of the residual of a move that other moves do not share, rad^2.

    Args:
        before: the rest before the move.
        after: the rest after it.
        step_s: between the samples of the move, (n - 1,).
        rate_rad_s: of the move, without the bias, (n, 3).
        gravity: direction at the rest before the move, (3,).

    Returns:
        The variance in each of the two directions across gravity.
    """
    span_s = float(step_s.sum())
    # The bias during the move lies between those of the two rests.
    change = ((after.rate_rad_s - before.rate_rad_s) / 2.0) ** 2
    rest_variance = (before.rate_variance_rad2_s2 + after.rate_variance_rad2_s2) / 4.0
    by_change = span_s**2 * _beyond_noise(change, rest_variance)
    by_noise = span_s * (before.angle_variance_rad2_s + after.angle_variance_rad2_s) / 2.0
    noise = float(by_noise.mean())
    return (
        noise
        + float(by_change.mean())
        + before.turned_variance_rad2
        + after.turned_variance_rad2
        # Leaving out every second sample adds the noise once more.
        + float(_beyond_noise(_integration_variance(step_s, rate_rad_s, gravity), by_noise.mean()))
    )


def _beyond_noise(square: FloatArray, variance: FloatArray) -> FloatArray:
    """Return by how much a square exceeds the variance of its noise, 0 if the noise explains it."""
    return np.where(square > SIGNIFICANT_SIGMA**2 * variance, square - variance, 0.0)


def _integration_variance(
    step_s: FloatArray, rate_rad_s: FloatArray, gravity: FloatArray
) -> FloatArray:
    """Return the squared difference to the integral of every second sample, in each direction."""
    if len(step_s) < 4:
        return np.zeros(())
    even = len(step_s) // 2 * 2
    fine = path_product(turn_vectors(rate_rad_s[: even + 1], step_s[:even]))
    pairs_s = step_s[:even].reshape(-1, 2).sum(axis=1)
    coarse = path_product(turn_vectors(rate_rad_s[: even + 1 : 2], pairs_s))
    difference = cross_matrix(gravity) @ (fine @ coarse.T @ gravity)
    return np.asarray(difference @ difference / 2.0, dtype=np.float64)
