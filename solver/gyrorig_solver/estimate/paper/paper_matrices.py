"""Equations 7 to 10 of the paper: from angles to S, T and M.

What to use when: `gain_by_pseudoinverse` is eq. 7, `lower_factor` eq. 8, `split_lower` eq. 9 in
each of its readings, `misalignment` eq. 10. Each reports a failure as None or as a number;
`paper_method` names the failure.

With G = STM, eq. 8 to 10 are an LQ decomposition, G = L Q: S = diag(L), T = S^-1 L, M = Q.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from gyrorig_solver.data import FloatArray

Factors = Literal["by_shape", "by_position", "product"]
"""The result of eq. 9, [S, T] = LU(ST); LU of a lower L gives (L D^-1) D, D = diag(L).

`by_shape`: S = D and T = L D^-1, as eq. 3 and 4 shape them; then T S = ST, not S T.
`by_position`: S = L D^-1 and T = D, as eq. 9 lists them; then S T = ST, but S is not diagonal.
`product`: S = D and T = D^-1 L, as in the paper's Table 3.
"""


@dataclass(frozen=True, slots=True, eq=False)
class PseudoinverseFit:
    """Eq. 7, with the rank of its reference."""

    gain: FloatArray  # (3, 3), of least norm if U is rank deficient
    rank: int
    singular_values_rad: FloatArray  # (3,), of U, largest first
    unseen_directions: FloatArray  # (3, 3 - rank), unexcited directions of u


def gain_by_pseudoinverse(
    Y_rad: FloatArray, U_rad: FloatArray, smallest_rms_rad: float = 0.0
) -> PseudoinverseFit:
    """Return STM = Y U^+ (eq. 7).

    Args:
        Y_rad: measured angles, shape (3, n).
        U_rad: reference angles, shape (3, n).
        smallest_rms_rad: a direction of u with a smaller motion counts as unexcited.

    Returns:
        The gain and the rank of U. Below the tolerance max(3, n) eps s_1 of Matlab's `pinv`, which
        the paper used, a direction always counts as unexcited.
    """
    left, singular, right = np.linalg.svd(U_rad, full_matrices=False)
    rounding = max(U_rad.shape) * np.finfo(np.float64).eps * singular[0]
    excited = singular > max(rounding, smallest_rms_rad * np.sqrt(U_rad.shape[1]))
    rank = int(np.count_nonzero(excited))
    inverse = (right[:rank].T / singular[:rank]) @ left[:, :rank].T
    return PseudoinverseFit(
        gain=np.asarray(Y_rad @ inverse),
        rank=rank,
        singular_values_rad=np.asarray(singular),
        unseen_directions=np.asarray(left[:, rank:]),
    )


def lower_factor(gain: FloatArray) -> FloatArray | None:
    """Return ST = chol[STM STM^T]^T (eq. 8), or None if the product is not positive definite."""
    product = gain @ gain.T
    values = np.linalg.eigvalsh(product)
    if not values[0] > 3.0 * np.finfo(np.float64).eps * values[-1]:
        # singular within rounding: `chol` fails, or returns a factor that is only rounding
        return None
    return np.asarray(np.linalg.cholesky(product))


def split_lower(lower: FloatArray, factors: Factors = "by_shape") -> tuple[FloatArray, FloatArray]:
    """Return S and T from the lower triangular product ST (eq. 9), by one of its readings.

    Args:
        lower: shape (3, 3), lower triangular with a positive diagonal.
        factors: the reading.

    Returns:
        S and T, shape (3, 3) each. No rows are exchanged; see `exchanges_rows`.
    """
    diagonal = np.diag(np.diag(lower))
    unit_left = lower / np.diag(lower)[None, :]
    if factors == "by_position":
        return unit_left, diagonal
    if factors == "by_shape":
        return diagonal, unit_left
    return diagonal, lower / np.diag(lower)[:, None]


def exchanges_rows(lower: FloatArray) -> bool:
    """Return True if an LU factorisation with partial pivoting, as in Matlab, would exchange rows.

    A lower triangle has zeros right of its diagonal, so elimination changes no entry.
    """
    below = np.tril(np.abs(lower), -1).max(axis=0)
    return bool(np.any(below > np.abs(np.diag(lower))))


def misalignment(S: FloatArray, T: FloatArray, gain: FloatArray) -> FloatArray:
    """Return M = T^-1 S^-1 STM (eq. 10)."""
    return np.asarray(np.linalg.solve(T, np.linalg.solve(S, gain)))


def orthogonality_error(matrix: FloatArray) -> float:
    """Return the largest entry of |M M^T - I|: zero for a rotation or a reflection."""
    return float(np.abs(matrix @ matrix.T - np.eye(3)).max())
