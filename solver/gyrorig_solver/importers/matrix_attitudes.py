"""Attitudes given as rotation matrices."""

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray

MAX_DEVIATION = 0.01  # of R R^T from the identity, the same as for the length of a quaternion


def quaternions_of_matrices(rows: FloatArray) -> FloatArray:
    """Return the quaternions x, y, z, w of rotation matrices, shape (n, 4).

    Args:
        rows: one matrix per row, row by row, shape (n, 9). A row that is not finite gives a row
            of nan.

    Raises:
        InputError: a matrix is not a rotation.

    Source: S. W. Shepperd, "Quaternion from rotation matrix", J. Guidance and Control 1 (1978),
    pp. 223-224: the largest of the four squares is taken from the diagonal.
    """
    result = np.full((len(rows), 4), np.nan)
    (finite,) = np.nonzero(np.all(np.isfinite(rows), axis=1))
    matrix = rows[finite].reshape(-1, 3, 3)
    _check_rotations(matrix, finite + 1)
    trace = np.trace(matrix, axis1=1, axis2=2)
    diagonal = np.diagonal(matrix, axis1=1, axis2=2)
    squares = np.column_stack([2.0 * diagonal - trace[:, None], trace])  # x, y, z, w
    largest = np.argmax(squares, axis=1)
    for pivot in range(4):
        (at,) = np.nonzero(largest == pivot)
        r = matrix[at]
        quaternion = np.empty((at.size, 4))
        if pivot == 3:
            quaternion[:, 0] = r[:, 2, 1] - r[:, 1, 2]
            quaternion[:, 1] = r[:, 0, 2] - r[:, 2, 0]
            quaternion[:, 2] = r[:, 1, 0] - r[:, 0, 1]
            quaternion[:, 3] = 1.0 + trace[at]
        else:
            j, k = (pivot + 1) % 3, (pivot + 2) % 3
            quaternion[:, pivot] = 1.0 + squares[at, pivot]
            quaternion[:, j] = r[:, j, pivot] + r[:, pivot, j]
            quaternion[:, k] = r[:, k, pivot] + r[:, pivot, k]
            quaternion[:, 3] = r[:, k, j] - r[:, j, k]
        result[finite[at]] = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
    return result


def _check_rotations(matrix: FloatArray, row: np.ndarray) -> None:
    """Check that matrices are orthonormal and right-handed; `row` has their numbers from 1."""
    if not row.size:
        return
    deviation = np.abs(matrix @ matrix.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    worst = int(np.argmax(deviation))
    if not deviation[worst] <= MAX_DEVIATION:
        raise InputError(
            f"row {row[worst]} of the attitude columns is not a rotation matrix, because its "
            f"product with its transpose differs from the identity by {deviation[worst]:.3g}",
            "give the nine columns of the matrix row by row as `keys` under `attitude` in the "
            "import map",
        )
    left = np.flatnonzero(np.linalg.det(matrix) < 0.0)
    if left.size:
        raise InputError(
            f"the rotation matrix in row {row[left[0]]} of the attitude columns is a reflection, "
            "because its axes are left-handed",
            "correct the signs and the order of the columns in the import map",
        )
