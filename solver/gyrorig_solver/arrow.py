"""Symmetric matrices that are sparse among many local unknowns and dense around a few shared.

A motion's unknowns are of two kinds: thousands that act for a moment (when a move began,
where a rest is) and a dozen that act everywhere (a speed, the board's own parameters).
Their information matrix is an arrow: sparse where local ones meet, with a dense border.
Eliminating the local ones costs in proportion to their number.

What to use when: `Arrow` for an information matrix; `solve_arrow` for its linear system.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from gyrorig_solver.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Arrow:
    """A symmetric matrix over m local unknowns, then g shared ones."""

    local: csc_array  # (m, m)
    cross: FloatArray  # (m, g)
    shared: FloatArray  # (g, g)

    @classmethod
    def zero(cls, local: int, shared: int) -> Self:
        """Return the matrix that knows nothing."""
        return cls(csc_array((local, local)), np.zeros((local, shared)), np.zeros((shared, shared)))

    @classmethod
    def from_dense(cls, matrix: FloatArray, shared: int) -> Self:
        """Return a matrix of any structure whose last `shared` unknowns are the shared ones."""
        m = matrix.shape[0] - shared
        return cls(csc_array(matrix[:m, :m]), matrix[:m, m:].copy(), matrix[m:, m:].copy())

    @property
    def size(self) -> tuple[int, int]:
        """How many unknowns are local, and how many shared."""
        return self.cross.shape[0], self.cross.shape[1]

    def to_dense(self) -> FloatArray:
        """Return the whole matrix, (m + g) squared: for few unknowns only."""
        return np.block([[self.local.toarray(), self.cross], [self.cross.T, self.shared]])

    def times(self, vector: FloatArray) -> FloatArray:
        """Return the product with a vector over all unknowns, shape (m + g,)."""
        m, _ = self.size
        one, two = vector[:m], vector[m:]
        return np.concatenate(
            [self.local @ one + self.cross @ two, self.cross.T @ one + self.shared @ two]
        )

    def __add__(self, other: "Arrow") -> "Arrow":
        """Add the evidence of another matrix over the same unknowns."""
        return Arrow(
            (self.local + other.local).tocsc(), self.cross + other.cross, self.shared + other.shared
        )


@dataclass(frozen=True, slots=True, eq=False)
class Eliminated:
    """What a system says of the shared unknowns, and how the local ones follow them."""

    information: FloatArray  # (g, g), the local unknowns taken out
    score: FloatArray  # (g,)
    carry: FloatArray  # (m, g + 1)

    def local(self, shared: FloatArray) -> FloatArray:
        """Return the local unknowns that go with shared ones, shape (m,)."""
        return np.asarray(self.carry[:, -1] - self.carry[:, :-1] @ shared, dtype=np.float64)


def factor(local: csc_array) -> Callable[[FloatArray], FloatArray]:
    """Return the solver of a sparse, symmetric, positive definite system."""
    if local.shape[0] == 0:
        return np.zeros_like
    # Positive definite: no pivoting, so that the order keeps the factor sparse.
    factored = splu(
        local,
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    return lambda right: np.asarray(factored.solve(right), dtype=np.float64)


def eliminate(matrix: Arrow, score: FloatArray) -> Eliminated:
    """Take the local unknowns out of `matrix x = score`.

    Args:
        matrix: its local part positive definite.
        score: over all unknowns, shape (m + g,).

    Source: Schur complement; Boyd and Vandenberghe, Convex Optimization, appendix C.4.
    """
    m, _ = matrix.size
    carry = factor(matrix.local)(np.column_stack([matrix.cross, score[:m]]))
    both = np.column_stack([matrix.shared, score[m:]]) - matrix.cross.T @ carry
    return Eliminated(both[:, :-1], both[:, -1], carry)


def solve_arrow(matrix: Arrow, score: FloatArray) -> FloatArray:
    """Return the solution of `matrix x = score`, shape (m + g,)."""
    found = eliminate(matrix, score)
    shared: FloatArray = np.asarray(
        np.linalg.solve(found.information, found.score), dtype=np.float64
    )
    return np.concatenate([found.local(shared), shared])
