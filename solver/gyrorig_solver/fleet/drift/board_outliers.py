"""Outliers: boards that differ from the other boards of their sensor in all parameters together.

What to use when: `outlier_p_values` for one p value per board. Each board is compared with the
mean and the covariance of the other boards that have the same parameters. Both are estimated;
therefore the statistic is Hotelling's T squared (1931) and not chi-square.

Source: Anderson, An Introduction to Multivariate Statistical Analysis, 3rd edition, 2003, section
5.2; for one parameter it is the test of an outlier by Grubbs (1950).
"""

import numpy as np
from scipy import special

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.fleet.drift.population import MIN_BOARDS, OUTLIER_SIGMA

# With fewer boards per parameter, the covariance is too uncertain to reveal an outlier.
_MIN_BOARDS_PER_PARAMETER = 2
_RELATIVE_RANK_LIMIT = 1e-10  # smaller eigenvalues of a correlation are rounding errors


def outlier_p_values(z: FloatArray) -> FloatArray:
    """Return the p value of each board as an outlier over all its parameters.

    If there are fewer than two boards per parameter, each parameter is tested alone, and the
    smallest p value is multiplied by their number (Bonferroni).

    Args:
        z: standardised deviations, shape (boards, parameters); NaN where there is none.

    Returns:
        Shape (boards,); NaN for a board without a parameter that enough boards have.
    """
    known = np.isfinite(z)
    p_values = np.full(len(z), np.nan)
    single_p_values: FloatArray | None = None
    patterns, pattern_of_board = np.unique(known, axis=0, return_inverse=True)
    for number, pattern in enumerate(patterns):
        boards = pattern_of_board.reshape(-1) == number
        comparable = np.all(known[:, pattern], axis=1)
        needed = max(_MIN_BOARDS_PER_PARAMETER * int(pattern.sum()), MIN_BOARDS)
        if not pattern.any():
            continue
        if comparable.sum() >= needed:
            hotelling = _hotelling_p_values(z[np.ix_(comparable, pattern)])
            p_values[boards] = hotelling[boards[comparable]]
            continue
        if single_p_values is None:
            single_p_values = _single_parameter_p_values(z, known)
        p_values[boards] = _bonferroni(single_p_values[np.ix_(boards, pattern)])
    return p_values


def _single_parameter_p_values(z: FloatArray, known: BoolArray) -> FloatArray:
    """Return p values of each parameter alone, as `z`; NaN where too few boards have it."""
    p_values = np.full(z.shape, np.nan)
    for column in range(z.shape[1]):
        rows = known[:, column]
        if rows.sum() >= MIN_BOARDS:
            p_values[rows, column] = _hotelling_p_values(z[rows, column][:, None])
    return p_values


def _bonferroni(p_values: FloatArray) -> FloatArray:
    """Return the p value of the smallest of several, (boards,), NaN without any."""
    count = np.isfinite(p_values).sum(axis=1)
    smallest = np.where(np.isfinite(p_values), p_values, np.inf).min(axis=1)
    combined: FloatArray = np.where(count > 0, np.minimum(count * smallest, 1.0), np.nan)
    return combined


def _hotelling_p_values(z: FloatArray) -> FloatArray:
    """Return the p value of each board, compared with the other ones.

    The other boards count with at most `OUTLIER_SIGMA`, so that an outlier hides no second one.
    Their mean and covariance are those of all boards without the contribution of the tested board
    (Sherman and Morrison 1950).

    Args:
        z: standardised deviations, shape (boards, parameters), all finite.
    """
    boards, parameters = z.shape
    limited = np.clip(z, -OUTLIER_SIGMA, OUTLIER_SIGMA)
    deviation = limited - limited.mean(axis=0)
    scale = np.sqrt(np.maximum((deviation * deviation).sum(axis=0), 1e-300))
    deviation = deviation / scale
    inverse = np.linalg.pinv(deviation.T @ deviation, rcond=_RELATIVE_RANK_LIMIT, hermitian=True)
    removed_share = boards / (boards - 1.0)  # of a deviation's square, in the sum of squares
    from_others = deviation / (1.0 - 1.0 / boards) + (z - limited) / scale
    leverage = removed_share * np.einsum("ij,jk,ik->i", deviation, inverse, deviation)
    cross = np.einsum("ij,jk,ik->i", from_others, inverse, deviation)
    square = np.einsum("ij,jk,ik->i", from_others, inverse, from_others)
    square += removed_share * cross * cross / np.maximum(1.0 - leverage, 1e-12)
    degrees = boards - 1 - parameters
    f_statistic = square * (boards - 1.0) / boards * degrees / parameters
    p_values: FloatArray = special.fdtrc(parameters, degrees, f_statistic)
    return p_values
