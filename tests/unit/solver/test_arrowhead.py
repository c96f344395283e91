"""The arrow's algebra against dense linear algebra."""

import numpy as np
import pytest
from scipy.sparse import csc_array

from gyrorig_solver.numerics import ArrowheadMatrix, eliminate_local, solve_arrowhead


def _made(local: int, shared: int) -> tuple[np.ndarray, ArrowheadMatrix, np.ndarray]:
    rng = np.random.default_rng(local)
    size = local + shared
    jacobian = np.zeros((6 * size, size))
    for row in jacobian:
        if local:
            at = int(rng.integers(0, local))
            end = min(local, at + 3)
            row[at:end] = rng.normal(size=end - at)
        row[local:] = rng.normal(size=shared)
    dense = jacobian.T @ jacobian + 1e-6 * np.eye(size)
    m = size - shared
    matrix = ArrowheadMatrix(csc_array(dense[:m, :m]), dense[:m, m:].copy(), dense[m:, m:].copy())
    return dense, matrix, rng.normal(size=size)


@pytest.mark.parametrize("local", [0, 1, 40])
def test_solution_matches_the_dense_system(local: int) -> None:
    dense, arrow, score = _made(local, 5)
    expected = np.linalg.solve(dense, score)
    np.testing.assert_allclose(solve_arrowhead(arrow, score), expected, rtol=1e-6, atol=1e-9)
    solution = eliminate_local(arrow, score)
    covariance = np.linalg.inv(dense)[local:, local:]
    np.testing.assert_allclose(
        np.linalg.inv(solution.information), covariance, rtol=1e-6, atol=1e-12
    )
    np.testing.assert_allclose(arrow.multiply(score), dense @ score, rtol=1e-9, atol=1e-9)


def test_sum_matches_the_dense_matrix() -> None:
    dense, arrow, _ = _made(20, 3)
    np.testing.assert_allclose((arrow + arrow).to_dense(), 2.0 * dense)
    assert ArrowheadMatrix.zero(4, 2).size == (4, 2)
    assert not ArrowheadMatrix.zero(4, 2).to_dense().any()
