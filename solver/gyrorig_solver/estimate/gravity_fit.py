"""Fit of gyro gain and bias to gravity between rests: a board turned by hand, without a rig.

Theory of operation. Over a move, the gyro's integral must rotate the direction of gravity at the
previous rest into that at the next rest: u_1 = R' u_0, R the product of exp(w dt) with w = G^-1 (y
- b). Each move gives two equations (the rotation about gravity is unobservable), and a dozen moves
about changing axes determine all of G. Rests give the bias: each move uses the mean of its two
rests, so that slow drift cancels. The result refers to the orthogonalised frame of the
accelerometer: M is gyro to accelerometer here, not gyro to stage.

Source: Tedaldi et al., ICRA 2014, eq. 13 to 16 (there with the bias of the first rest).
"""

from dataclasses import dataclass, replace

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.samples import GyroSamples
from gyrorig_solver.estimate.fit_summary import (
    FitOutcome,
    build_gyro_fit,
    warn_of_unchecked_times,
)
from gyrorig_solver.estimate.gravity_mismatch import list_mismatches
from gyrorig_solver.estimate.gravity_residual import (
    RestErrors,
    describe_excess,
    measure_rest_errors,
    predict_move_variance,
)
from gyrorig_solver.estimate.gyro_fit import GravityMoves, GyroFit
from gyrorig_solver.estimate.information import PARAMETER_NAMES
from gyrorig_solver.estimate.observability import analyse_observability
from gyrorig_solver.model import cross_matrix
from gyrorig_solver.reference import (
    StaticPoses,
    TimeInterval,
    find_poses,
    path_product,
    prefix_products,
    turn_vectors,
)

MAX_ITERATIONS = 40
SCALE_RANGE = (0.5, 1.5)  # of the gyro's scale factor, for the initial guess
CONVERGED_SIGMA = 1e-4
# Larger residuals, from a knock or a saturated sample, have less weight (Huber).
HUBER_SIGMA = 2.5
# A smaller rotation has no information and can be a knock at rest.
MIN_TURN_RAD = 0.05
MIN_MOVES = 5
# Largest standard deviation of the residuals in each direction. Moves by hand have 0.1 to 0.5 deg.
# A bias that changes by 0.2 deg/s within a move of 10 s gives 2 deg, and an accelerometer with an
# error of 0.05 g gives 3 deg. Wrong axes or units give tens of degrees if the moves are large.
MAX_RESIDUAL_RAD = float(np.radians(5.0))
# The same of small moves, as a share of the residuals of a gyro that measures no rotation.
MAX_RESIDUAL_SHARE = 0.2
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


@dataclass(frozen=True, slots=True, eq=False)
class _Move:
    """One move: the gyro between two rests, and gravity at both."""

    step_s: FloatArray  # (n - 1,)
    rate_rad_s: FloatArray  # (n, 3), measured, minus the bias of the two rests
    gravity_before: FloatArray  # (3,), unit vector up
    gravity_after: FloatArray
    variance_rad2: float  # predicted, of the residual in each direction

    @property
    def is_large(self) -> bool:
        """Whether the gyro turned enough for the move to have information."""
        speed_rad_s = np.linalg.norm(self.rate_rad_s[1:], axis=1)
        return float(np.sum(speed_rad_s * self.step_s)) >= MIN_TURN_RAD

    def corrected(self, correction: FloatArray) -> "_Move":
        """Return the move with each rate multiplied by a matrix, (3, 3)."""
        return replace(self, rate_rad_s=self.rate_rad_s @ correction.T)


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
    rest_bias = np.array([rest.rate_rad_s for rest in rests])
    moves = _moves(samples, poses, rests)
    solver = _GravitySolver(moves)
    solver.run()
    if not solver.explains_moves():
        raise _disagreement(solver, moves)
    rounding_std = np.median([rest.rounding_std_rad_s for rest in rests], axis=0)
    information = _information(solver, rest_bias, rounding_std)
    # Of the reported gain.
    sigma_rad, predicted_rad = solver.sigma_rad, solver.predicted_sigma_rad
    excess = describe_excess(sigma_rad, predicted_rad, len(moves), len(rests))
    outcome = FitOutcome(
        estimate=np.concatenate([solver.gain.ravel(), rest_bias.mean(axis=0), [0.0]]),
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
            f"{np.degrees(sigma_rad):.2f} deg in each direction, and the standard uncertainties of "
            "the result are scaled to this value",
            *warn_of_unchecked_times([samples]),
        ),
        limited_reasons=tuple(filter(None, ("" if solver.converged else _NOT_CONVERGED, excess))),
        gravity_moves=GravityMoves(len(moves), len(rests), sigma_rad, predicted_rad),
    )
    return build_gyro_fit(outcome, [samples])


def _information(
    solver: "_GravitySolver", rest_bias: FloatArray, rounding_std_rad_s: FloatArray
) -> FloatArray:
    """Return the information on `PARAMETER_NAMES`: the gain's from moves, the bias' from rests.

    All rests of a board with little noise have the same error by rounding.
    """
    information = np.zeros((13, 13))
    information[:9, :9] = solver.information()
    scatter = np.maximum(rest_bias.std(axis=0, ddof=1), 1e-7)
    variance = scatter**2 / len(rest_bias) + rounding_std_rad_s**2
    information[9:12, 9:12] = np.diag(1.0 / variance)
    return information


def _moves(samples: GyroSamples, poses: StaticPoses, rests: list[RestErrors]) -> list[_Move]:
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
        unbroken.append(_Move(step_s, rate, *directions, variance))
    moves = [move for move in unbroken if move.is_large]
    if len(moves) < MIN_MOVES:
        raise _too_few_moves(unbroken, len(moves), broken_count)
    return moves


def _too_few_moves(unbroken: list[_Move], count: int, broken_count: int) -> InputError:
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


def _disagreement(solver: "_GravitySolver", moves: list[_Move]) -> InputError:
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


def _find_mismatch(moves: list[_Move]) -> str | None:
    """Return the wrong axes or units with which the fit explains the moves, None if none do."""
    best, best_cost = None, np.inf
    for mismatch in list_mismatches():
        corrected = [move.corrected(mismatch.correction) for move in moves]
        solver = _GravitySolver([move for move in corrected if move.is_large])
        if solver.move_count >= MIN_MOVES and solver.nominal_cost() < best_cost:
            best, best_cost = (mismatch, solver), solver.nominal_cost()
    if best is None:
        return None
    mismatch, solver = best
    solver.run()
    return mismatch.text or None if solver.explains_moves() else None


class _GravitySolver:
    """Levenberg-Marquardt over G with analytic derivatives, robust to outlying moves."""

    def __init__(self, moves: list[_Move]) -> None:
        self._moves = moves
        self.gain = np.eye(3)
        self.sigma_rad = 0.01
        self.downweighted = 0
        self.converged = False
        self._weight = np.ones(len(moves))
        self._limit_rad = np.inf

    def run(self) -> None:
        """Iterate to the robust least squares.

        Levenberg's damping is necessary: with a scale factor that is wrong by a quarter, a long
        move rotates gravity out of the range of a Newton step.
        """
        scales = np.linspace(*SCALE_RANGE, 41)
        costs = [self._cost(scale * np.eye(3)) for scale in scales]
        self.gain = float(scales[int(np.argmin(costs))]) * np.eye(3)
        damping = 1e-3
        for _ in range(MAX_ITERATIONS):
            residual, jacobian = self._linearise(self.gain)
            self._update_weights(residual)
            normal = self._information_matrix(jacobian)
            score = np.einsum("mij,mi->j", jacobian * self._weight[:, None, None], residual)
            score = score / self.sigma_rad**2
            curvature = np.diag(normal) + 1e-9 * np.trace(normal)
            while damping < 1e9:
                step = np.linalg.solve(normal + damping * np.diag(curvature), score)
                trial = self.gain + step.reshape(3, 3)
                if abs(np.linalg.det(trial)) > 1e-3 and self._cost(trial) <= self._cost(self.gain):
                    self.gain, damping = trial, max(damping * 0.1, 1e-12)
                    break
                damping *= 10.0
            if damping >= 1e9 or float(np.max(np.abs(step) * np.sqrt(curvature))) < CONVERGED_SIGMA:
                self.converged = (
                    damping < 1e9 or float(np.max(np.abs(score) / np.sqrt(curvature))) < 1e-3
                )
                break
        self._reset_unobserved()

    @property
    def move_count(self) -> int:
        """The number of moves."""
        return len(self._moves)

    @property
    def predicted_sigma_rad(self) -> float:
        """The predicted standard deviation of the residuals in each direction.

        Moves with much larger errors than the others have less weight, as in the fit.
        """
        variance = np.array([move.variance_rad2 for move in self._moves])
        limit_rad = HUBER_SIGMA * np.sqrt(np.median(variance))
        return float(np.sqrt(np.mean(np.minimum(variance, limit_rad * np.sqrt(variance)))))

    def nominal_cost(self) -> float:
        """Return the mean squared residual of the nominal gain, rad^2."""
        return float(np.mean(np.sum(self._residuals(np.eye(3)) ** 2, axis=1)))

    def explains_moves(self) -> bool:
        """Return whether the residuals are small enough for the gain to be correct.

        A fit that did not converge is accepted only if it moves along unobservable directions.
        """
        information = self.information()
        rank = analyse_observability(information, PARAMETER_NAMES[:9]).rank
        changes = [move.gravity_after - move.gravity_before for move in self._moves]
        change_std_rad = float(np.sqrt(np.mean(np.sum(np.square(changes), axis=1)) / 2.0))
        limit_rad = min(MAX_RESIDUAL_RAD, MAX_RESIDUAL_SHARE * change_std_rad)
        return (self.converged or rank < 9) and self.sigma_rad <= limit_rad

    def _reset_unobserved(self) -> None:
        """Set unobservable directions to nominal."""
        information = self.information()
        difference = (self.gain - np.eye(3)).ravel()
        observed = (
            analyse_observability(information, PARAMETER_NAMES[:9]).pseudo_inverse
            @ information
            @ difference
        )
        self.gain = np.eye(3) + observed.reshape(3, 3)

    def _cost(self, gain: FloatArray) -> float:
        """Return Huber's cost of all moves at the current standard deviation."""
        length = np.linalg.norm(self._residuals(gain), axis=1)
        limit = self._limit_rad
        inside = length <= limit
        return float(np.sum(np.where(inside, length**2, limit * (2.0 * length - limit))))

    def information(self) -> FloatArray:
        """Return the final information on G, scaled by the residual, (9, 9)."""
        residual, jacobian = self._linearise(self.gain)
        self._update_weights(residual)
        return self._information_matrix(jacobian)

    def rms_rad_s(self, gain: FloatArray) -> float:
        """Return the rms direction error of the moves over their duration."""
        residuals = self._residuals(gain)
        span_s = np.array([move.step_s.sum() for move in self._moves])
        return float(np.sqrt(np.mean(np.sum(residuals**2, axis=1) / 2.0 / span_s**2)))

    def _information_matrix(self, jacobian: FloatArray) -> FloatArray:
        weighted = jacobian * self._weight[:, None, None] / self.sigma_rad**2
        return np.asarray(np.einsum("mij,mik->jk", weighted, jacobian), dtype=np.float64)

    def _update_weights(self, residual: FloatArray) -> None:
        """Estimate the standard deviation of one direction, and each move's Huber weight."""
        length = np.linalg.norm(residual, axis=1)
        # Both directions have the same standard deviation; the median length is 1.1774 times it.
        robust = float(np.median(length)) / 1.1774
        limit = self._limit_rad = HUBER_SIGMA * robust * float(np.sqrt(2.0))
        self._weight = np.where(length > limit, limit / np.maximum(length, 1e-12), 1.0)
        self.downweighted = int(np.sum(self._weight < 1.0))
        degrees_of_freedom = max(2 * len(self._moves) - 9, 1)
        self.sigma_rad = (
            float(np.sqrt(np.sum(self._weight * length**2) / degrees_of_freedom)) + 1e-9
        )

    def _residuals(self, gain: FloatArray) -> FloatArray:
        """Return measured minus predicted gravity, shape (m, 3)."""
        inverse = np.linalg.inv(gain)
        ends = [
            path_product(turn_vectors(move.rate_rad_s @ inverse.T, move.step_s))
            for move in self._moves
        ]
        return np.array(
            [
                m.gravity_after - end.T @ m.gravity_before
                for m, end in zip(self._moves, ends, strict=True)
            ]
        )

    def _linearise(self, gain: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return measured minus predicted gravity (m, 3), and its derivative (m, 3, 9)."""
        inverse = np.linalg.inv(gain)
        residuals, jacobians = [], []
        for move in self._moves:
            rate = move.rate_rad_s @ inverse.T
            attitude = prefix_products(turn_vectors(rate, move.step_s))
            end = attitude[-1]
            predicted = end.T @ move.gravity_before
            # A change dw of the rate over one step rotates the end by P_end' P_k dw dt, and dw =
            # -G^-1 dG w; a rotation d of the end changes the predicted vector by predicted x d.
            half = 0.5 * (attitude + np.concatenate([np.eye(3)[None], attitude[:-1]]))
            middle = 0.5 * (rate[1:] + rate[:-1])
            summed = np.einsum("kia,kl,k->ial", half @ inverse, middle, move.step_s)
            turn = -np.einsum("ip,ial->pal", end, summed).reshape(3, 9)
            jacobians.append(cross_matrix(predicted) @ turn)
            residuals.append(move.gravity_after - predicted)
        return np.array(residuals), np.array(jacobians)
