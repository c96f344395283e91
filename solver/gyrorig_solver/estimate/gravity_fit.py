"""Fit of gyro gain and bias to gravity between rests: a board turned by hand, without a rig.

Theory of operation. Over a move, the gyro's integral must rotate the direction of gravity at the
previous rest into that at the next rest: u_1 = R' u_0, R the product of exp(w dt) with w = G^-1 (y
- b). Each move gives two equations (the rotation about gravity is unobservable), and a dozen moves
about changing axes determine all of G. Rests give the bias: each move uses the mean of its two
rests, so that slow drift cancels. Moves share the errors of rests and of the accelerometer;
`gravity_covariance` has the uncertainty of G. The result refers to the orthogonalised frame of the
accelerometer: M is gyro to accelerometer here, not gyro to stage.

Source: Tedaldi et al., ICRA 2014, eq. 13 to 16 (there with the bias of the first rest).
"""

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate.fit_summary import (
    FitOutcome,
    build_gyro_fit,
    warn_of_unchecked_times,
)
from gyrorig_solver.estimate.gravity_covariance import predict_gain
from gyrorig_solver.estimate.gravity_mismatch import list_mismatches
from gyrorig_solver.estimate.gravity_residual import (
    ACCEL_UNKNOWNS,
    GAIN_UNKNOWNS,
    RestErrors,
    measure_rest_errors,
    predict_move_variance,
)
from gyrorig_solver.estimate.gravity_solver import MIN_TURN_RAD, GravityMove, GravitySolver
from gyrorig_solver.estimate.gyro_fit import GravityMoves, GyroFit
from gyrorig_solver.estimate.information import PARAMETER_NAMES
from gyrorig_solver.estimate.observability import analyse_observability
from gyrorig_solver.numerics import chi2_quantile, f_quantile
from gyrorig_solver.reference import StaticPoses, TimeInterval, find_poses

MIN_MOVES = 5
FALSE_ALARM = 1e-4  # probability of the reason without an excess
# Smallest ratio of the standard deviations: three quarters of the variance then have a cause that
# the prediction does not contain. Of 37 measured moves of another laboratory, the ratio is 1.5.
MIN_RATIO = 2.0
_CHECK_MAP = "check the units and the columns of times, gyro and accelerometer in the column map"
_RECORD_AGAIN = (
    "turn the board more slowly, hold it still for some seconds in each pose, and record again"
)
_NOT_CONVERGED = f"the fit did not converge; {_RECORD_AGAIN}"
REASON_TEXTS = {
    "x": "too few moves turned the board about its x axis; turn the board about all axes",
    "y": "too few moves turned the board about its y axis; turn the board about all axes",
    "z": "too few moves turned the board about its z axis; turn the board about all axes",
    "bias": "no rest in the recording is long enough; hold the board still for some seconds",
    "time_offset": "gravity at rest does not show the time offset; use a reference that moves",
}


def fit_gravity(
    samples: GyroSamples, gravity_m_s2: float, rest_interval: TimeInterval | None = None
) -> GyroFit:
    """Calibrate a gyro with gravity between rests.

    Args:
        samples: of one board, with its accelerometer.
        gravity_m_s2: local gravity; only the accelerometer's scale factor depends on it.
        rest_interval: a known rest; None: the ten seconds with the least motion.

    Returns:
        The fit; G maps the rate in the accelerometer's frame to the gyro's.

    Raises:
        InputError: there is no accelerometer, there are too few or too similar poses, or the
            rotations of gyro and gravity do not agree.
    """
    if samples.accel_m_s2 is None:
        raise InputError(
            "a calibration with gravity as the reference needs an accelerometer, but the recording "
            f"has no accelerometer of board {samples.board}",
            "record the accelerometer of the board too, or reference attitudes",
        )
    poses = find_poses(samples.time_s, samples.accel_m_s2, gravity_m_s2, rest_interval)
    rests = measure_rest_errors(samples, samples.accel_m_s2, poses)
    moves = _moves(samples, poses, rests)
    solver = GravitySolver(moves)
    solver.run()
    if not solver.explains_moves():
        raise _disagreement(solver, moves)
    gain = predict_gain(moves, solver.linearise(), rests, poses)
    information = _information(gain.information, rests)
    least_ratio = detectable_ratio(gain.accel_share, len(moves), len(rests))
    excess = describe_excess(gain.sigma_rad, gain.predicted_rad, least_ratio)
    outcome = FitOutcome(
        estimate=np.concatenate([solver.gain.ravel(), _mean_bias(rests), [0.0]]),
        observability=analyse_observability(information, PARAMETER_NAMES),
        reduced_chi2=float("nan"),  # the noise model of the moves comes from their scatter
        outliers=solver.downweighted,
        rms_before_rad_s=solver.rms_rad_s(np.eye(3)),
        rms_after_rad_s=solver.rms_rad_s(solver.gain),
        reference=(
            f"gravity between {len(poses.rests)} rests, {len(moves)} moves; M relates the gyro to "
            "the accelerometer's frame, not to a stage"
        ),
        reason_texts=REASON_TEXTS,
        warnings=(
            "the residuals of the moves have a standard deviation of "
            f"{np.degrees(gain.sigma_rad):.2g} deg in each direction, and the noise and the rests "
            f"explain {np.degrees(gain.predicted_rad):.2g} deg. The standard uncertainties of the "
            "result contain the larger of both",
            *warn_of_unchecked_times([samples]),
        ),
        limited_reasons=tuple(filter(None, ("" if solver.converged else _NOT_CONVERGED, excess))),
        gravity_moves=GravityMoves(len(moves), len(rests), gain.sigma_rad, gain.predicted_rad),
    )
    return build_gyro_fit(outcome, [samples])


def _mean_bias(rests: list[RestErrors]) -> FloatArray:
    return np.asarray(np.mean([rest.rate_rad_s for rest in rests], axis=0), dtype=np.float64)


def _information(gain_information: FloatArray, rests: list[RestErrors]) -> FloatArray:
    """Return the information on `PARAMETER_NAMES`: the gain's from moves, the bias' from rests.

    All rests of a board with little noise have the same error by rounding.
    """
    information = np.zeros((13, 13))
    information[:9, :9] = gain_information
    rates, count = np.array([rest.rate_rad_s for rest in rests]), len(rests)
    # Student's t of n - 1 degrees of freedom has the variance (n - 1) / (n - 3).
    scatter = np.var(rates, axis=0, ddof=1) * (count - 1) / (count - 3)
    by_noise = np.mean([rest.rate_variance_rad2_s2 for rest in rests], axis=0)
    rounding_std = np.median([rest.rounding_std_rad_s for rest in rests], axis=0)
    variance = np.maximum(np.maximum(scatter, by_noise), 1e-14) / count + rounding_std**2
    information[9:12, 9:12] = np.diag(1.0 / variance)
    return information


def detectable_ratio(accel_share: float, move_count: int, rest_count: int) -> float:
    """Return the smallest ratio of observed and predicted residuals that the tests reject.

    The first test regards all of the prediction as an estimate from the scatter of the rests (F).
    The second regards only the part by the accelerometer as such, and gives the residuals and this
    part half of the false-alarm rate each.

    Args:
        accel_share: share of the prediction that comes from the misfit of the accelerometer.
        move_count: number of moves.
        rest_count: number of rests, whose scatter gives this misfit.
    """
    freedom = max(2 * move_count - GAIN_UNKNOWNS, 1)
    rest_freedom = max(rest_count - ACCEL_UNKNOWNS, 1)
    half = FALSE_ALARM / 2.0
    largest_accel = accel_share * rest_freedom / chi2_quantile(1.0 - half, rest_freedom)
    by_parts = chi2_quantile(half, freedom) / freedom * (1.0 - accel_share + largest_accel)
    least = min(by_parts, f_quantile(FALSE_ALARM, freedom, rest_freedom))
    return max(MIN_RATIO, float(np.sqrt(least)))


def describe_excess(sigma_rad: float, predicted_rad: float, least_ratio: float) -> str:
    """Return why the residuals of the moves limit the verdict, "" if they do not.

    Args:
        sigma_rad: standard deviation of the residuals in each direction.
        predicted_rad: the same, as predicted.
        least_ratio: of both, that the test rejects.
    """
    if sigma_rad < least_ratio * predicted_rad:
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


def _moves(samples: GyroSamples, poses: StaticPoses, rests: list[RestErrors]) -> list[GravityMove]:
    """Return the usable moves: without gaps, unsaturated, and with enough rotation."""
    unbroken, broken_count = [], 0
    for k in range(len(poses.rests) - 1):
        part = slice(poses.last_sample[k], poses.first_sample[k + 1] + 1)
        step_s = np.diff(samples.time_s[part])
        is_unbroken = np.all(np.diff(samples.number[part]) == 1) and samples.usable[part].all()
        if not is_unbroken or np.any(np.diff(samples.segment[part]) != 0) or np.any(step_s <= 0.0):
            broken_count += 1
            continue
        before, after = rests[k], rests[k + 1]
        rate = samples.rate_rad_s[part] - (before.rate_rad_s + after.rate_rad_s) / 2.0
        variance = predict_move_variance(before, after, step_s, rate, poses.direction[k])
        directions = (poses.direction[k], poses.direction[k + 1])
        unbroken.append(GravityMove(step_s, rate, *directions, k, variance))
    moves = [move for move in unbroken if move.is_large]
    if len(moves) < MIN_MOVES:
        raise _too_few_moves(unbroken, len(moves), broken_count)
    return moves


def _too_few_moves(unbroken: list[GravityMove], count: int, broken_count: int) -> InputError:
    """Return the error of fewer than `MIN_MOVES` moves with enough rotation."""
    mismatch = _find_mismatch(unbroken)
    if mismatch is not None:
        return InputError(mismatch, _CHECK_MAP)
    small_count = len(unbroken) - count
    return InputError(
        f"a calibration by gravity needs {MIN_MOVES} moves between rests, but only {count} are "
        f"usable ({broken_count} have gaps or saturated samples, and in {small_count} the gyro "
        f"turned by less than {np.degrees(MIN_TURN_RAD):.0f} deg)",
        "turn the board more slowly, and in more moves"
        if broken_count >= small_count
        else f"turn the board further, and in more moves. If it turned further, {_CHECK_MAP}",
    )


def _disagreement(solver: "GravitySolver", moves: list[GravityMove]) -> InputError:
    """Return the error of a fit that does not explain the moves."""
    mismatch = _find_mismatch(moves)
    if mismatch is not None:
        return InputError(mismatch, _CHECK_MAP)
    return InputError(
        "the rotation that the gyro measures does not agree with that of gravity: the residuals "
        f"of the moves have a standard deviation of {np.degrees(solver.sigma_rad):.2g} deg in each "
        "direction after the fit" + ("" if solver.converged else ", which did not converge"),
        f"{_CHECK_MAP}. If they are correct, {_RECORD_AGAIN}",
    )


def _find_mismatch(moves: list[GravityMove]) -> str | None:
    """Return the wrong axes or units with which the fit explains the moves, None if none do."""
    best, best_cost = None, np.inf
    for mismatch in list_mismatches():
        corrected = [move.corrected(mismatch.correction) for move in moves]
        solver = GravitySolver([move for move in corrected if move.is_large])
        if solver.move_count >= MIN_MOVES and solver.nominal_cost() < best_cost:
            best, best_cost = (mismatch, solver), solver.nominal_cost()
    if best is None:
        return None
    mismatch, solver = best
    solver.run()
    return mismatch.text or None if solver.explains_moves() else None
