"""Arrowhead matrices: sparse among many local unknowns, with a dense border of shared unknowns.

The unknowns of a motion are of two kinds: thousands that act for a short time (the start of a move,
the position of a rest) and a dozen that act all the time (a speed, the board's own parameters).
Their information matrix is an arrowhead: sparse among the local unknowns, with a dense border. The
cost of eliminating the local unknowns is proportional to their number.

What to use when: `ArrowheadMatrix` for an information matrix; `eliminate_local` for the Schur
complement of its local unknowns; `solve_arrowhead` for a linear system.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.linalg import splu

from gyrorig_solver.data import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ArrowheadMatrix:
    """A symmetric matrix over m local unknowns, then g shared ones."""

    local: csc_array  # (m, m)
    cross: FloatArray  # (m, g)
    shared: FloatArray  # (g, g)

    @classmethod
    def zero(cls, local: int, shared: int) -> Self:
        """Return the zero matrix."""
        return cls(csc_array((local, local)), np.zeros((local, shared)), np.zeros((shared, shared)))

    @property
    def size(self) -> tuple[int, int]:
        """The number of local unknowns and the number of shared ones."""
        return self.cross.shape[0], self.cross.shape[1]

    def to_dense(self) -> FloatArray:
        """Return the dense matrix, (m + g) squared; for few unknowns only."""
        return np.block([[self.local.toarray(), self.cross], [self.cross.T, self.shared]])

    def multiply(self, vector: FloatArray) -> FloatArray:
        """Return the product with a vector over all unknowns, shape (m + g,)."""
        m, _ = self.size
        local_part, shared_part = vector[:m], vector[m:]
        return np.concatenate(
            [
                self.local @ local_part + self.cross @ shared_part,
                self.cross.T @ local_part + self.shared @ shared_part,
            ]
        )

    def __add__(self, other: "ArrowheadMatrix") -> "ArrowheadMatrix":
        """Add the information of another matrix over the same unknowns."""
        return ArrowheadMatrix(
            (self.local + other.local).tocsc(), self.cross + other.cross, self.shared + other.shared
        )


@dataclass(frozen=True, slots=True, eq=False)
class SchurComplement:
    """The system of the shared unknowns, and how the local ones follow from them."""

    information: FloatArray  # (g, g)
    score: FloatArray  # (g,)
    back_substitution: FloatArray  # (m, g + 1)

    def local_solution(self, shared: FloatArray) -> FloatArray:
        """Return the local unknowns that belong to shared ones, shape (m,)."""
        return np.asarray(
            self.back_substitution[:, -1] - self.back_substitution[:, :-1] @ shared,
            dtype=np.float64,
        )


def factorise_sparse(local: csc_array) -> Callable[[FloatArray], FloatArray]:
    """Return the solver of a sparse, symmetric, positive definite system."""
    if local.shape[0] == 0:
        return np.zeros_like
    # Positive definite: without pivoting the ordering keeps the factor sparse.
    factorisation = splu(
        local,
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    return lambda right: np.asarray(factorisation.solve(right), dtype=np.float64)


def eliminate_local(matrix: ArrowheadMatrix, score: FloatArray) -> SchurComplement:
    """Eliminate the local unknowns of `matrix x = score` (Schur complement).

    Args:
        matrix: its local part positive definite.
        score: over all unknowns, shape (m + g,).

    Source: Boyd and Vandenberghe, Convex Optimization, appendix C.4.
    """
    m, _ = matrix.size
    back_substitution = factorise_sparse(matrix.local)(np.column_stack([matrix.cross, score[:m]]))
    reduced = np.column_stack([matrix.shared, score[m:]]) - matrix.cross.T @ back_substitution
    return SchurComplement(reduced[:, :-1], reduced[:, -1], back_substitution)


def solve_arrowhead(matrix: ArrowheadMatrix, score: FloatArray) -> FloatArray:
    """Return the solution of `matrix x = score`, shape (m + g,)."""
    complement = eliminate_local(matrix, score)
    shared: FloatArray = np.asarray(
        np.linalg.solve(complement.information, complement.score), dtype=np.float64
    )
    return np.concatenate([complement.local_solution(shared), shared])
