"""Prediction of the residuals of moves between rests, and the reason if they are much larger.

What to use when: `predict_move_variance` for the moves of a fit to gravity; `describe_excess` for
the reason that limits the verdict.

Theory of operation. The standard uncertainties of the fit are scaled to its residuals. This is
right for errors that differ between the moves and average out. Lost rows, a wrong rate or a moving
rest also change all moves in the same direction, and the residuals do not show this part. The
module therefore predicts the residual of each move from the errors that the fit knows: the noise of
the gyro and of the accelerometer, the change of the bias between the two rests, rounding, the
integration, the misfit of the accelerometer and a rotation during a rest.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate.rest_mean import MIN_SAMPLES, std_by_rounding, std_of_mean
from gyrorig_solver.model import cross_matrix
from gyrorig_solver.numerics import f_upper_tail
from gyrorig_solver.reference import StaticPoses, path_product, turn_vectors

FALSE_ALARM = 1e-4  # probability of the reason without an excess
# Smallest ratio of the standard deviations: three quarters of the variance then have a cause that
# the prediction does not contain. Of 37 measured moves of another laboratory, the ratio is 1.35.
MIN_RATIO = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class RestErrors:
    """The errors of one rest."""

    rate_rad_s: FloatArray  # (3,), mean
    rate_variance_rad2_s2: FloatArray  # (3,), of the mean
    angle_variance_rad2_s: FloatArray  # (3,), of the integral of the noise, per second
    rounding_std_rad_s: FloatArray  # (3,)
    direction_variance_rad2: float  # of gravity, in each direction


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
    halves = [half.mean(axis=0) for half in np.array_split(force, 2)]
    # The direction at an end of the rest differs from the mean by this if the board turns slowly.
    turned = np.linalg.norm(np.cross(*halves)) / gravity_m_s2**2
    # The misfit of |force| is the error of a pose along gravity; across it, it is similar. The nine
    # unknowns of the accelerometer contribute, too.
    unknowns_share = 9.0 / max(len(poses.rests) - 9, 1)
    noise = float(np.mean(_std_of_mean(force) ** 2))
    noise += poses.accel.residual_m_s2**2 * (1.0 + unknowns_share)
    # Rounding is white noise of q^2/12 in motion, and hides smaller noise at rest.
    least = samples.quantum_rad_s**2 / 12.0 * samples.period_s
    return RestErrors(
        rate_rad_s=rate.mean(axis=0),
        rate_variance_rad2_s2=rate_std**2,
        angle_variance_rad2_s=np.maximum(rate_std**2 * len(rate) * samples.period_s, least),
        rounding_std_rad_s=std_by_rounding(rate, samples.quantum_rad_s),
        direction_variance_rad2=noise / gravity_m_s2**2 + float(turned) ** 2 / 2.0,
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
    """Return the variance of the residual of a move in each direction, rad^2.

    Args:
        before: the rest before the move.
        after: the rest after it.
        step_s: between the samples of the move, (n - 1,).
        rate_rad_s: of the move, without the bias, (n, 3).
        gravity: direction at the rest before the move, (3,).
    """
    span_s = float(step_s.sum())
    # The bias during the move lies between those of the two rests.
    change = (after.rate_rad_s - before.rate_rad_s) / 2.0
    rest_variance = (before.rate_variance_rad2_s2 + after.rate_variance_rad2_s2) / 4.0
    rounding = np.maximum(before.rounding_std_rad_s, after.rounding_std_rad_s)
    density = (before.angle_variance_rad2_s + after.angle_variance_rad2_s) / 2.0
    rotation = span_s**2 * (change**2 + rest_variance + rounding**2) + span_s * density
    return (
        float(rotation.mean())
        + before.direction_variance_rad2
        + after.direction_variance_rad2
        + _integration_variance(step_s, rate_rad_s, gravity)
    )


def _integration_variance(step_s: FloatArray, rate_rad_s: FloatArray, gravity: FloatArray) -> float:
    """Return the squared difference to the integral of every second sample, in each direction."""
    if len(step_s) < 4:
        return 0.0
    even = len(step_s) // 2 * 2
    fine = path_product(turn_vectors(rate_rad_s[: even + 1], step_s[:even]))
    pairs_s = step_s[:even].reshape(-1, 2).sum(axis=1)
    coarse = path_product(turn_vectors(rate_rad_s[: even + 1 : 2], pairs_s))
    difference = cross_matrix(gravity) @ (fine @ coarse.T @ gravity)
    return float(difference @ difference) / 2.0


def describe_excess(
    sigma_rad: float, predicted_rad: float, move_count: int, rest_count: int
) -> str:
    """Return why the residuals of the moves limit the verdict, "" if they do not.

    Args:
        sigma_rad: standard deviation of the residuals in each direction.
        predicted_rad: the same, as predicted.
        move_count: number of moves.
        rest_count: number of rests, whose scatter gives the prediction.
    """
    ratio = sigma_rad / predicted_rad
    # The fit of the gain and that of the accelerometer have nine unknowns each.
    move_freedom, rest_freedom = max(2 * move_count - 9, 1), max(rest_count - 9, 1)
    if ratio < MIN_RATIO or f_upper_tail(ratio**2, move_freedom, rest_freedom) > FALSE_ALARM:
        return ""
    return (
        "the residuals of the moves have a standard deviation of "
        f"{np.degrees(sigma_rad):.2g} deg in each direction, but the noise and the rests explain "
        f"only {np.degrees(predicted_rad):.2g} deg. Lost rows without a column of times, a sample "
        "rate that changes, or a hand that accelerates the board during the rests can cause this. "
        "They also change all moves in the same direction, and the standard uncertainties do "
        "not contain this error. Import the times of the samples, lay the board down in each pose, "
        "and record again"
    )
