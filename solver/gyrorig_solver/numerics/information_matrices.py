"""Information matrices and scores: posterior covariance, chi-squared statistic, positive part.

What to use when: `posterior_covariance` to combine information with a normal prior;
`score_statistic` to test a score; `positive_part` where a difference of matrices must not be
negative.
"""

import numpy as np

from gyrorig_solver.data import FloatArray


def posterior_covariance(information: FloatArray, prior_covariance: FloatArray) -> FloatArray:
    """Return (P^-1 + J)^-1 without the inverse of P, which a size of zero makes singular."""
    inner = np.eye(len(prior_covariance)) + information @ prior_covariance
    covariance = np.linalg.solve(inner.T, prior_covariance).T
    return np.asarray(0.5 * (covariance + covariance.T), dtype=np.float64)


def positive_part(matrix: FloatArray) -> FloatArray:
    """Return a symmetric matrix with its negative eigenvalues set to zero."""
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    return np.asarray((vectors * np.clip(values, 0.0, None)) @ vectors.T, dtype=np.float64)


def score_statistic(
    information: FloatArray, score: FloatArray, min_share: float, largest: float | None = None
) -> tuple[float, int]:
    """Return s' J^-1 s over the directions with information, and their number.

    Args:
        information: J, the covariance of the score.
        score: s.
        min_share: directions with a smaller share of the largest eigenvalue are left out.
        largest: used in place of the largest eigenvalue.
    """
    eigenvalues, eigenvectors = np.linalg.eigh(information)
    keep = eigenvalues > min_share * (eigenvalues[-1] if largest is None else largest)
    projected = eigenvectors[:, keep].T @ score
    return float(np.sum(projected**2 / eigenvalues[keep])), int(keep.sum())
