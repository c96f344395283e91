"""Gyro gain and bias from gravity between rests: a board turned by hand, no rig at all.

What to use when: `fit_gravity` for one board with an accelerometer that was held still in
many poses and turned between them.

Theory of operation. Over a move, the gyro's integral must carry the direction of gravity
from the rest before to the rest after: u_1 = R' u_0, R the product of exp(w dt) with
w = G^-1 (y - b). Each move gives two equations (what it turned about gravity itself is
not seen), a dozen moves about changing axes give all of G. Rests give the bias: each move
takes the mean of its two rests, so that slow drift does not enter. What it relates to is
the accelerometer's own frame, made orthogonal: M here is gyro against accelerometer, not
against any stage.

Source: Tedaldi et al., ICRA 2014, eq. 13 to 16 (there with the bias held at the first rest).
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.estimate.conclusion import NAMES, Evidence, gyro_fit
from gyrorig_solver.estimate.observability import decide
from gyrorig_solver.estimate.result import GyroFit
from gyrorig_solver.model.gain import cross_matrix
from gyrorig_solver.reference.gravity import Poses, find_poses
from gyrorig_solver.reference.rotations import prefix_products, turn_vectors
from gyrorig_solver.reference.turns import Interval
from gyrorig_solver.samples import GyroSamples

ROUNDS = 40
SCALE_RANGE = (0.5, 1.5)  # of the gyro against nominal, tried at the start
CONVERGED_SIGMA = 1e-4
# Beyond this many deviations a move counts less (Huber): a knock, a saturated sample.
HUBER_SIGMA = 2.5
# A move shorter than this turn tells nothing and may be a knock at rest.
SMALLEST_TURN_RAD = 0.05
_UNSETTLED = "the fit did not settle: turn slower, rest for some seconds in each pose, record again"
WORDS = {
    "x": "too few moves turned about the board's x axis; tumble it about all axes",
    "y": "too few moves turned about the board's y axis; tumble it about all axes",
    "z": "too few moves turned about the board's z axis; tumble it about all axes",
    "bias": "there is no rest long enough; hold the board still for some seconds",
    "time_offset": "gravity at rest has no time in it; use a moving reference",
}


@dataclass(frozen=True, slots=True, eq=False)
class _Move:
    """One move: the gyro between two rests, and gravity at both."""

    step_s: FloatArray  # (n - 1,)
    rate_rad_s: FloatArray  # (n, 3), as measured less the bias of the two rests
    before: FloatArray  # (3,), unit vector up
    after: FloatArray


def fit_gravity(
    samples: GyroSamples, gravity_m_s2: float, quiet: Interval | None = None
) -> GyroFit:
    """Calibrate a gyro by gravity between rests.

    Args:
        samples: of one board, with its accelerometer.
        gravity_m_s2: local gravity; only the accelerometer's scale depends on it.
        quiet: a stretch known to be at rest; None: the quietest ten seconds.

    Returns:
        The fit; G maps the rate in the accelerometer's frame to the gyro's.

    Raises:
        InputError: no accelerometer, or too few or too similar poses.
    """
    if samples.accel_m_s2 is None:
        raise InputError(
            f"board {samples.board} has no accelerometer in this recording",
            "gravity between rests needs one; use another reference",
        )
    poses = find_poses(samples.time_s, samples.accel_m_s2, gravity_m_s2, quiet)
    rest_bias = _rest_bias(samples, poses)
    moves = _moves(samples, poses, rest_bias)
    work = _Work(moves)
    converged = work.run()
    information = _information(work, rest_bias)
    sigma_rad = work.sigma_rad  # of the gain that is reported
    evidence = Evidence(
        estimate=np.concatenate([work.gain.ravel(), rest_bias.mean(axis=0), [0.0]]),
        decision=decide(information, NAMES),
        reduced_chi2=float("nan"),  # the moves' own spread is their noise model
        outliers=work.downweighed,
        rms_before_rad_s=work.rms_rad_s(np.eye(3)),
        rms_after_rad_s=work.rms_rad_s(work.gain),
        reference=(
            f"gravity between {len(poses.rests)} rests, {len(moves)} moves; M is the gyro against "
            "the accelerometer's frame, not against a stage"
        ),
        words=WORDS,
        warnings=(
            f"a move leaves {np.degrees(sigma_rad):.2f} deg (one direction); standard deviations "
            "are scaled to that",
        ),
        distrust=() if converged else (_UNSETTLED,),
        extra={
            "moves": float(len(moves)),
            "poses": float(len(poses.rests)),
            "move_sigma_rad": sigma_rad,
            "accel_residual_m_s2": poses.accel.residual_m_s2,
        },
    )
    return gyro_fit(evidence, [samples])


def _information(work: "_Work", rest_bias: FloatArray) -> FloatArray:
    """Return the information on `NAMES`: the gain's from the moves, the bias' from the rests."""
    information = np.zeros((13, 13))
    information[:9, :9] = work.information()
    scatter = np.maximum(rest_bias.std(axis=0, ddof=1), 1e-7)
    information[9:12, 9:12] = np.diag(len(rest_bias) / scatter**2)
    return information


def _rest_bias(samples: GyroSamples, poses: Poses) -> FloatArray:
    """Return the gyro's mean at every rest, shape (n, 3)."""
    means = []
    for first, last in zip(poses.first, poses.last, strict=True):
        good = samples.good[first : last + 1]
        means.append(samples.rate_rad_s[first : last + 1][good].mean(axis=0))
    return np.array(means)


def _moves(samples: GyroSamples, poses: Poses, rest_bias: FloatArray) -> list[_Move]:
    """Return the moves that can be integrated: unbroken, unsaturated, and turning."""
    found, spoiled = [], 0
    for k in range(len(poses.rests) - 1):
        part = slice(poses.last[k], poses.first[k + 1] + 1)
        step_s = np.diff(samples.time_s[part])
        whole = np.all(np.diff(samples.number[part]) == 1) and samples.good[part].all()
        if not whole or np.any(np.diff(samples.segment[part]) != 0) or np.any(step_s <= 0.0):
            spoiled += 1
            continue
        rate = samples.rate_rad_s[part] - (rest_bias[k] + rest_bias[k + 1]) / 2.0
        if float(np.sum(np.linalg.norm(rate[1:], axis=1) * step_s)) < SMALLEST_TURN_RAD:
            continue
        found.append(_Move(step_s, rate, poses.direction[k], poses.direction[k + 1]))
    if len(found) < 5:
        raise InputError(
            f"{len(found)} moves between rests can be integrated ({spoiled} have gaps or are "
            "saturated)",
            "turn the board slower, and in more moves",
        )
    return found


class _Work:
    """Gauss-Newton over G with analytic derivatives of the rotation, robust to odd moves."""

    def __init__(self, moves: list[_Move]) -> None:
        self._moves = moves
        self.gain = np.eye(3)
        self.sigma_rad = 0.01
        self.downweighed = 0
        self._weight = np.ones(len(moves))
        self._limit_rad = np.inf

    def run(self) -> bool:
        """Iterate to the least squares; return whether it settled.

        Levenberg's damping: a move turns far enough that a nominal scale a quarter off
        carries gravity out of the reach of a plain Newton step.
        """
        scales = np.linspace(*SCALE_RANGE, 41)
        costs = [self._cost(scale * np.eye(3)) for scale in scales]
        self.gain = float(scales[int(np.argmin(costs))]) * np.eye(3)
        damping, settled = 1e-3, False
        for _ in range(ROUNDS):
            left, jacobian = self._linearised(self.gain)
            self._weigh(left)
            normal = self._normal(jacobian)
            score = np.einsum("mij,mi->j", jacobian * self._weight[:, None, None], left)
            score = score / self.sigma_rad**2
            curve = np.diag(normal) + 1e-9 * np.trace(normal)
            while damping < 1e9:
                step = np.linalg.solve(normal + damping * np.diag(curve), score)
                trial = self.gain + step.reshape(3, 3)
                if abs(np.linalg.det(trial)) > 1e-3 and self._cost(trial) <= self._cost(self.gain):
                    self.gain, damping = trial, max(damping * 0.1, 1e-12)
                    break
                damping *= 10.0
            if damping >= 1e9 or float(np.max(np.abs(step) * np.sqrt(curve))) < CONVERGED_SIGMA:
                settled = damping < 1e9 or float(np.max(np.abs(score) / np.sqrt(curve))) < 1e-3
                break
        self._hold_unseen()
        return settled

    def _hold_unseen(self) -> None:
        """Put what the moves do not show back to nominal; what they show stays."""
        information = self.information()
        away = (self.gain - np.eye(3)).ravel()
        seen = decide(information, NAMES[:9]).inverse @ information @ away
        self.gain = np.eye(3) + seen.reshape(3, 3)

    def _cost(self, gain: FloatArray) -> float:
        """Return Huber's cost of all moves at the current deviation."""
        length = np.linalg.norm(self._lefts(gain), axis=1)
        limit = self._limit_rad
        inside = length <= limit
        return float(np.sum(np.where(inside, length**2, limit * (2.0 * length - limit))))

    def information(self) -> FloatArray:
        """Return the information on G at the end, scaled by the residual, (9, 9)."""
        left, jacobian = self._linearised(self.gain)
        self._weigh(left)
        return self._normal(jacobian)

    def rms_rad_s(self, gain: FloatArray) -> float:
        """Return the rms direction error of the moves over their duration."""
        left = self._lefts(gain)
        span_s = np.array([move.step_s.sum() for move in self._moves])
        return float(np.sqrt(np.mean(np.sum(left**2, axis=1) / 2.0 / span_s**2)))

    def _normal(self, jacobian: FloatArray) -> FloatArray:
        weighed = jacobian * self._weight[:, None, None] / self.sigma_rad**2
        return np.asarray(np.einsum("mij,mik->jk", weighed, jacobian), dtype=np.float64)

    def _weigh(self, left: FloatArray) -> None:
        """Find the deviation of one direction and the Huber weight of each move."""
        length = np.linalg.norm(left, axis=1)
        # Two directions of one deviation: the median length is 1.1774 of it.
        robust = float(np.median(length)) / 1.1774
        limit = self._limit_rad = HUBER_SIGMA * robust * float(np.sqrt(2.0))
        self._weight = np.where(length > limit, limit / np.maximum(length, 1e-12), 1.0)
        self.downweighed = int(np.sum(self._weight < 1.0))
        freedom = max(2 * len(self._moves) - 9, 1)
        self.sigma_rad = float(np.sqrt(np.sum(self._weight * length**2) / freedom)) + 1e-9

    def _carry(self, gain: FloatArray, move: _Move) -> tuple[FloatArray, FloatArray]:
        """Return the calibrated rate at the samples and the attitude after each step."""
        rate = move.rate_rad_s @ np.linalg.inv(gain).T
        return rate, prefix_products(turn_vectors(rate, move.step_s))

    def _lefts(self, gain: FloatArray) -> FloatArray:
        """Return measured minus carried gravity, shape (m, 3)."""
        ends = [self._carry(gain, move)[1][-1] for move in self._moves]
        return np.array(
            [m.after - end.T @ m.before for m, end in zip(self._moves, ends, strict=True)]
        )

    def _linearised(self, gain: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return measured minus carried gravity (m, 3), and its derivative (m, 3, 9)."""
        inverse = np.linalg.inv(gain)
        lefts, jacobians = [], []
        for move in self._moves:
            rate, attitude = self._carry(gain, move)
            end = attitude[-1]
            carried = end.T @ move.before
            # A change dw of the rate over one step turns the end by P_end' P_k dw dt, and
            # dw = -G^-1 dG w; a turn d of the end moves the carried vector by carried x d.
            half = 0.5 * (attitude + np.concatenate([np.eye(3)[None], attitude[:-1]]))
            middle = 0.5 * (rate[1:] + rate[:-1])
            summed = np.einsum("kia,kl,k->ial", half @ inverse, middle, move.step_s)
            turn = -np.einsum("ip,ial->pal", end, summed).reshape(3, 9)
            jacobians.append(cross_matrix(carried) @ turn)
            lefts.append(move.after - carried)
        return np.array(lefts), np.array(jacobians)
