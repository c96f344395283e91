"""A second opinion that no clock can spoil: the turn from rest to rest.

Over a move from one rest to the next the gyro's integral must carry the stage from the
one attitude to the other, whenever exactly it moved. So neither a time offset nor the
shape of the ramps enters: where this and the rate-domain fit disagree, timing is the
suspect (time synchronisation notes, section 7: an offset of 20 ms costs this method
0 ppm). It is the less precise of the two, and is only ever a check.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from gyrorig_solver.arrays import BoolArray, FloatArray
from gyrorig_solver.chance import chi2_tail
from gyrorig_solver.estimate.observability import BIAS_NAMES, Decision, decide
from gyrorig_solver.model.gain import GAIN_NAMES
from gyrorig_solver.reference.rotations import prefix_products, turn_vectors

NAMES = (*GAIN_NAMES, *BIAS_NAMES)
SHORTEST_REST_S = 0.25
SETTLE_S = 0.15  # after a move: the sensor's low-pass and the mechanics come to rest
FEWEST_MOVES = 6


@dataclass(frozen=True, slots=True, eq=False)
class Path:
    """The board's block means and the stage's angles, on one time axis."""

    time_s: FloatArray  # (n,), on the reference's axis: the lag taken off
    rate_rad_s: FloatArray  # (n, 3), measured
    used: BoolArray  # (n,)
    moving: BoolArray  # (n,)
    angles_rad: FloatArray  # (2, n), pan and tilt


@dataclass(frozen=True, slots=True)
class CrossCheck:
    """How far the two solvers differ, in their combined uncertainty."""

    moves: int
    statistic: float  # chi-squared
    degrees_of_freedom: int
    p_value: float
    largest_sigma: float  # of any gain entry that both observe


@dataclass(frozen=True, slots=True, eq=False)
class _Turn:
    rate_rad_s: FloatArray  # (m + 1, 3)
    step_s: FloatArray  # (m,)
    told: FloatArray  # (3, 3), attitude at the end in the frame of the beginning
    variance_rad2: float


def cross_check(
    paths: Sequence[Path],
    gain: FloatArray,
    bias_rad_s: FloatArray,
    decision: Decision,
    density: float,
    rest_variance_rad2: float,
) -> CrossCheck | None:
    """Compare a rate-domain fit with the turns from rest to rest.

    Args:
        paths: one for each stretch of the recording.
        gain: G of the fit, shape (3, 3); the turns are linearised there.
        bias_rad_s: of the fit, shape (3,).
        decision: of the fit, with gain and bias first.
        density: the noise's one-sided density near 0.2 Hz, (rad/s)^2/Hz, worst axis.
        rest_variance_rad2: of the stage's attitude at rest, per axis.

    Returns:
        The comparison, None where there are too few moves between rests.
    """
    turns = [t for path in paths for t in _turns(path, density, rest_variance_rad2)]
    if len(turns) < FEWEST_MOVES:
        return None
    information, score = np.zeros((12, 12)), np.zeros(12)
    for turn in turns:
        left, jacobian = _linearised(turn, gain, bias_rad_s)
        information += jacobian.T @ jacobian / turn.variance_rad2
        score += jacobian.T @ left / turn.variance_rad2
    own = decide(information, NAMES)
    # One step from the fit: where they agree it is all, where they do not it says so.
    away = (own.inverse @ score)[:9]
    both = own.covariance[:9, :9] + decision.covariance[:9, :9]
    return _compared(away, both, own, decision, len(turns))


def _compared(
    away: FloatArray, both: FloatArray, own: Decision, other: Decision, moves: int
) -> CrossCheck:
    """Judge the difference in the directions that both solvers observe."""
    hidden = np.diag(own.hidden)[:9] + np.diag(other.hidden)[:9]
    seen = np.flatnonzero((hidden < 1e-6) & (np.diag(both) > 0.0))
    if not seen.size:
        return CrossCheck(moves, 0.0, 0, 1.0, 0.0)
    part, covariance = away[seen], both[np.ix_(seen, seen)]
    statistic = float(part @ np.linalg.solve(covariance, part))
    return CrossCheck(
        moves=moves,
        statistic=statistic,
        degrees_of_freedom=int(seen.size),
        p_value=chi2_tail(statistic, seen.size),
        largest_sigma=float(np.max(np.abs(part) / np.sqrt(np.diag(covariance)))),
    )


def _turns(path: Path, density: float, rest_variance_rad2: float) -> list[_Turn]:
    """Return the turns from the middle of each rest to the middle of the next."""
    middles = _rest_middles(path)
    turns = []
    for begin, end in pairwise(middles):
        if not path.used[begin : end + 1].all():
            continue
        first, last = (_attitude(path.angles_rad[:, i]) for i in (begin, end))
        span_s = float(path.time_s[end] - path.time_s[begin])
        turns.append(
            _Turn(
                rate_rad_s=path.rate_rad_s[begin : end + 1],
                step_s=np.diff(path.time_s[begin : end + 1]),
                told=(first.inv() * last).as_matrix(),
                # White noise of one-sided density S integrates to S T/2.
                variance_rad2=density * span_s / 2.0 + 2.0 * rest_variance_rad2,
            )
        )
    return turns


def _rest_middles(path: Path) -> list[int]:
    """Return the index in the middle of every rest that is long enough."""
    edges = np.flatnonzero(np.diff(np.concatenate([[1], path.moving.astype(np.int8), [1]])))
    middles = []
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        begin_s, end_s = path.time_s[begin] + SETTLE_S, path.time_s[end - 1]
        if end_s - begin_s >= SHORTEST_REST_S:
            middles.append(int(np.searchsorted(path.time_s, (begin_s + end_s) / 2.0)))
    return middles


def _attitude(angles_rad: FloatArray) -> Rotation:
    """Return R = Rz(pan) Rx(tilt), stage to base."""
    return Rotation.from_euler("ZX", angles_rad)


def _linearised(
    turn: _Turn, gain: FloatArray, bias_rad_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the turn that is missing at the end (3,), and its derivative by (G, b)."""
    inverse = np.linalg.inv(gain)
    rate = (turn.rate_rad_s - bias_rad_s) @ inverse.T
    attitude = prefix_products(turn_vectors(rate, turn.step_s))
    end = attitude[-1]
    missing = Rotation.from_matrix(end.T @ turn.told).as_rotvec()
    # A change dw of the rate over step k turns the end, in its own frame, by
    # end' P_k dw dt; and w = G^-1 (y - b) gives dw = -G^-1 (dG w + db).
    before = np.concatenate([np.eye(3)[None], attitude[:-1]])
    carried = np.einsum("ji,kjl->kil", end, (attitude + before) / 2.0) @ inverse
    middle = (rate[1:] + rate[:-1]) / 2.0
    by_gain = np.einsum("kia,kl,k->ial", carried, middle, turn.step_s).reshape(3, 9)
    by_bias = np.einsum("kia,k->ia", carried, turn.step_s)
    return missing, -np.concatenate([by_gain, by_bias], axis=1)
