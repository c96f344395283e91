"""A cross-check without timing: the rotation from rest to rest.

Over a move from one rest to the next, the integral of the gyroscope must rotate the stage from the
first attitude to the second, regardless of the exact times of the motion. A time offset or the
shape of the ramps does not affect it (a simulated offset of 20 ms changes its result by 0 ppm). If
it disagrees with the rate-domain fit, timing is the probable cause. It is less precise than the
fit, and serves only as a check.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.estimate.observability import (
    BIAS_NAMES,
    ObservabilityAnalysis,
    analyse_observability,
)
from gyrorig_solver.model import GAIN_NAMES
from gyrorig_solver.numerics import chi2_upper_tail
from gyrorig_solver.reference import prefix_products, turn_vectors

GAIN_AND_BIAS_NAMES = (*GAIN_NAMES, *BIAS_NAMES)
MIN_REST_S = 0.25
SETTLING_TIME_S = 0.15  # after a move, for the low-pass and the mechanics
MIN_MOVES = 6


@dataclass(frozen=True, slots=True, eq=False)
class BoardPath:
    """The board's block means and the stage's angles, on one time axis."""

    time_s: FloatArray  # (n,), on the reference's time axis, without the lag
    rate_rad_s: FloatArray  # (n, 3), measured
    used: BoolArray  # (n,)
    moving: BoolArray  # (n,)
    angles_rad: FloatArray  # (2, n), pan and tilt


@dataclass(frozen=True, slots=True)
class CrossCheck:
    """The difference of the two estimates, relative to their combined uncertainty."""

    moves: int
    statistic: float  # chi-squared
    degrees_of_freedom: int
    p_value: float
    largest_sigma: float  # of any gain entry that both observe


@dataclass(frozen=True, slots=True, eq=False)
class _Turn:
    rate_rad_s: FloatArray  # (m + 1, 3)
    step_s: FloatArray  # (m,)
    reference_attitude: FloatArray  # (3, 3), final attitude in the initial frame
    variance_rad2: float


def cross_check(
    paths: Sequence[BoardPath],
    gain: FloatArray,
    bias_rad_s: FloatArray,
    observability: ObservabilityAnalysis,
    density: float,
    rest_variance_rad2: float,
) -> CrossCheck | None:
    """Compare a rate-domain fit with the rotations between rests.

    Args:
        paths: one per segment of the recording.
        gain: G of the fit, shape (3, 3), at which the rotations are linearised.
        bias_rad_s: of the fit, shape (3,).
        observability: of the fit, with gain and bias first.
        density: the noise's one-sided density near 0.2 Hz, (rad/s)^2/Hz, worst axis.
        rest_variance_rad2: of the stage's attitude at rest, per axis.

    Returns:
        The comparison, or None if there are too few moves between rests.
    """
    turns = [t for path in paths for t in _turns_between_rests(path, density, rest_variance_rad2)]
    if len(turns) < MIN_MOVES:
        return None
    information, score = np.zeros((12, 12)), np.zeros(12)
    for turn in turns:
        residual, jacobian = _linearise(turn, gain, bias_rad_s)
        information += jacobian.T @ jacobian / turn.variance_rad2
        score += jacobian.T @ residual / turn.variance_rad2
    analysis = analyse_observability(information, GAIN_AND_BIAS_NAMES)
    # One Gauss-Newton step from the fit; it is small if the two agree.
    difference = (analysis.pseudo_inverse @ score)[:9]
    summed_covariance = analysis.covariance[:9, :9] + observability.covariance[:9, :9]
    return _compare(difference, summed_covariance, analysis, observability, len(turns))


def _compare(
    difference: FloatArray,
    summed_covariance: FloatArray,
    analysis: ObservabilityAnalysis,
    fit_analysis: ObservabilityAnalysis,
    moves: int,
) -> CrossCheck:
    """Test the difference in the directions that both estimates observe."""
    unobservable = (
        np.diag(analysis.unobservable_covariance)[:9]
        + np.diag(fit_analysis.unobservable_covariance)[:9]
    )
    observed = np.flatnonzero((unobservable < 1e-6) & (np.diag(summed_covariance) > 0.0))
    if not observed.size:
        return CrossCheck(moves, 0.0, 0, 1.0, 0.0)
    observed_difference = difference[observed]
    covariance = summed_covariance[np.ix_(observed, observed)]
    statistic = float(observed_difference @ np.linalg.solve(covariance, observed_difference))
    return CrossCheck(
        moves=moves,
        statistic=statistic,
        degrees_of_freedom=int(observed.size),
        p_value=chi2_upper_tail(statistic, observed.size),
        largest_sigma=float(np.max(np.abs(observed_difference) / np.sqrt(np.diag(covariance)))),
    )


def _turns_between_rests(path: BoardPath, density: float, rest_variance_rad2: float) -> list[_Turn]:
    """Return the rotations from the middle of each rest to the middle of the next."""
    middles = _rest_middles(path)
    turns = []
    for begin, end in pairwise(middles):
        if not path.used[begin : end + 1].all():
            continue
        first, last = (_stage_attitude(path.angles_rad[:, i]) for i in (begin, end))
        span_s = float(path.time_s[end] - path.time_s[begin])
        turns.append(
            _Turn(
                rate_rad_s=path.rate_rad_s[begin : end + 1],
                step_s=np.diff(path.time_s[begin : end + 1]),
                reference_attitude=(first.inv() * last).as_matrix(),
                # White noise of one-sided density S integrates to S T/2.
                variance_rad2=density * span_s / 2.0 + 2.0 * rest_variance_rad2,
            )
        )
    return turns


def _rest_middles(path: BoardPath) -> list[int]:
    """Return the index of the middle of every rest that is long enough."""
    edges = np.flatnonzero(np.diff(np.concatenate([[1], path.moving.astype(np.int8), [1]])))
    middles = []
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        begin_s, end_s = path.time_s[begin] + SETTLING_TIME_S, path.time_s[end - 1]
        if end_s - begin_s >= MIN_REST_S:
            middles.append(int(np.searchsorted(path.time_s, (begin_s + end_s) / 2.0)))
    return middles


def _stage_attitude(angles_rad: FloatArray) -> Rotation:
    """Return R = Rz(pan) Rx(tilt), stage to base."""
    return Rotation.from_euler("ZX", angles_rad)


def _linearise(
    turn: _Turn, gain: FloatArray, bias_rad_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the rotation residual at the end (3,), and its derivative by (G, b)."""
    inverse = np.linalg.inv(gain)
    rate = (turn.rate_rad_s - bias_rad_s) @ inverse.T
    attitude = prefix_products(turn_vectors(rate, turn.step_s))
    end = attitude[-1]
    rotation_residual = Rotation.from_matrix(end.T @ turn.reference_attitude).as_rotvec()
    # A change dw of the rate over step k rotates the end, in its frame, by end' P_k dw dt; and w =
    # G^-1 (y - b) gives dw = -G^-1 (dG w + db).
    before = np.concatenate([np.eye(3)[None], attitude[:-1]])
    carried = np.einsum("ji,kjl->kil", end, (attitude + before) / 2.0) @ inverse
    middle = (rate[1:] + rate[:-1]) / 2.0
    by_gain = np.einsum("kia,kl,k->ial", carried, middle, turn.step_s).reshape(3, 9)
    by_bias = np.einsum("kia,k->ia", carried, turn.step_s)
    return rotation_residual, -np.concatenate([by_gain, by_bias], axis=1)
