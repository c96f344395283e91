"""Least squares of a gyro's gain over moves between rests, robust to outlying moves.

What to use when: `GravitySolver` over the moves of `gravity_fit`, which describes the theory.
"""

from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.information import PARAMETER_NAMES
from gyrorig_solver.estimate.observability import analyse_observability
from gyrorig_solver.model import cross_matrix
from gyrorig_solver.reference import path_product, prefix_products, turn_vectors

MAX_ITERATIONS = 40
SCALE_RANGE = (0.5, 1.5)  # of the gyro's scale factor, for the initial guess
CONVERGED_SIGMA = 1e-4
# Larger residuals, from a knock or a saturated sample, have less weight (Huber).
HUBER_SIGMA = 2.5
# A smaller rotation has no information and can be a knock at rest.
MIN_TURN_RAD = 0.05
# Largest standard deviation of the residuals in each direction. Moves by hand have 0.1 to 0.5 deg.
# A bias that changes by 0.2 deg/s within a move of 10 s gives 2 deg, and an accelerometer with an
# error of 0.05 g gives 3 deg. Wrong axes or units give tens of degrees if the moves are large.
MAX_RESIDUAL_RAD = float(np.radians(5.0))
# The same of small moves, as a share of the residuals of a gyro that measures no rotation.
MAX_RESIDUAL_SHARE = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class GravityMove:
    """One move: the gyro between two rests, and gravity at both."""

    step_s: FloatArray  # (n - 1,)
    rate_rad_s: FloatArray  # (n, 3), measured, minus the bias of the two rests
    gravity_before: FloatArray  # (3,), unit vector up
    gravity_after: FloatArray
    rest_before: int  # its number
    # Predicted, of the part of the residual in each direction that is independent of other moves.
    variance_rad2: float

    @property
    def is_large(self) -> bool:
        """Whether the gyro turned enough for the move to have information."""
        speed_rad_s = np.linalg.norm(self.rate_rad_s[1:], axis=1)
        return float(np.sum(speed_rad_s * self.step_s)) >= MIN_TURN_RAD

    def corrected(self, correction: FloatArray) -> "GravityMove":
        """Return the move with each rate multiplied by a matrix, (3, 3)."""
        return replace(self, rate_rad_s=self.rate_rad_s @ correction.T)


@dataclass(frozen=True, slots=True, eq=False)
class LinearisedMoves:
    """The residuals of m moves, their derivatives and their weights."""

    residual: FloatArray  # (m, 3), measured minus predicted gravity
    by_gain: FloatArray  # (m, 3, 9), derivative of the predicted gravity by G
    by_bias: FloatArray  # (m, 3, 3), the same by the bias
    end: FloatArray  # (m, 3, 3), attitude after the move in the frame before it
    weight: FloatArray  # (m,), of Huber


class GravitySolver:
    """Levenberg-Marquardt over G with analytic derivatives, robust to outlying moves."""

    def __init__(self, moves: list[GravityMove]) -> None:
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
            linear = self.linearise()
            residual, jacobian = linear.residual, linear.by_gain
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
        return self._information_matrix(self.linearise().by_gain)

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

    def linearise(self) -> LinearisedMoves:
        """Return the moves at the gain, and update their weights."""
        inverse = np.linalg.inv(self.gain)
        residuals, by_gain, by_bias, ends = [], [], [], []
        for move in self._moves:
            rate = move.rate_rad_s @ inverse.T
            attitude = prefix_products(turn_vectors(rate, move.step_s))
            end = attitude[-1]
            predicted = end.T @ move.gravity_before
            # A change dw of the rate over one step rotates the end by P_end' P_k dw dt, and dw =
            # -G^-1 (dG w + db); a rotation d of the end changes the predicted vector by
            # predicted x d.
            half = 0.5 * (attitude + np.concatenate([np.eye(3)[None], attitude[:-1]]))
            middle = 0.5 * (rate[1:] + rate[:-1])
            summed = np.einsum("kia,kl,k->ial", half @ inverse, middle, move.step_s)
            turn = -np.einsum("ip,ial->pal", end, summed).reshape(3, 9)
            by_gain.append(cross_matrix(predicted) @ turn)
            turn = -end.T @ np.einsum("kia,k->ia", half @ inverse, move.step_s)
            by_bias.append(cross_matrix(predicted) @ turn)
            residuals.append(move.gravity_after - predicted)
            ends.append(end)
        residual = np.array(residuals)
        self._update_weights(residual)
        return LinearisedMoves(
            residual, np.array(by_gain), np.array(by_bias), np.array(ends), self._weight
        )
