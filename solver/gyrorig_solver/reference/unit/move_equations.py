"""Normal equations of the fit of moves: banded for local, dense for shared unknowns.

The starts of a move are coupled only with its two rests, and a rest only with its two moves. In
the order rest, starts, rest, starts, ... the matrix of the local unknowns is banded, and the cost
of its Cholesky factor is proportional to the number of moves.

Source: Golub and Van Loan, Matrix Computations, 4th ed., section 4.3.5 (band Cholesky);
Boyd and Vandenberghe, Convex Optimization, appendix C.4 (elimination).
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.reference.unit.move_table import MoveTable


@dataclass(frozen=True, slots=True, eq=False)
class BandedNormalEquations:
    """Information and score: local unknowns (starts, then rests), then g shared ones."""

    band_position: IntArray  # (n,), position of each local unknown in the band
    band: FloatArray  # (w + 1, n), lower half, by band position
    cross: FloatArray  # (n, g), by band position
    shared: FloatArray  # (g, g)
    score: FloatArray  # (n + g,), in the order of the unknowns

    @classmethod
    def empty(cls, table: MoveTable, shared: int) -> Self:
        """Return the system without information."""
        band_position = np.empty(table.command_count + table.rest_count, dtype=np.int64)
        max_commands, begin = 0, 0
        for axis in (0, 1):
            axis_moves = table.moves_of_axis[axis]
            command_counts = table.first_command[axis_moves + 1] - table.first_command[axis_moves]
            max_commands = max(max_commands, int(command_counts.max(initial=0)))
            end = begin + np.cumsum(command_counts + 1)
            rests = np.concatenate([[begin], end])
            band_position[table.command_count + table.first_rest(axis) + np.arange(rests.size)] = (
                rests
            )
            index_in_move = np.arange(int(command_counts.sum())) - np.repeat(
                np.cumsum(command_counts) - command_counts, command_counts
            )
            starts = np.repeat(table.first_command[axis_moves], command_counts) + index_in_move
            band_position[starts] = np.repeat(rests[:-1] + 1, command_counts) + index_in_move
            begin = int(rests[-1]) + 1
        n = band_position.size
        return cls(
            band_position,
            np.zeros((max_commands + 2, n)),
            np.zeros((n, shared)),
            np.zeros((shared, shared)),
            np.zeros(n + shared),
        )

    def add(self, local: IntArray, shared: IntArray, gram: FloatArray) -> None:
        """Add the information of m moves.

        Args:
            local: each move's local unknowns, shape (m, a).
            shared: its shared unknowns, numbered among themselves, shape (m, b).
            gram: of their derivatives and, last, the residual; shape (m, a + b + 1, a + b + 1).
        """
        a, b = local.shape[1], shared.shape[1]
        band_position = self.band_position[local]
        row, column = np.tril_indices(a)
        lower = np.minimum(band_position[:, row], band_position[:, column])
        np.add.at(
            self.band,
            (np.abs(band_position[:, row] - band_position[:, column]), lower),
            gram[:, row, column],
        )
        np.add.at(
            self.cross, (band_position[:, :, None], shared[:, None, :]), gram[:, :a, a : a + b]
        )
        shared_gram = gram[:, a : a + b, a : a + b]
        np.add.at(self.shared, (shared[:, :, None], shared[:, None, :]), shared_gram)
        np.add.at(self.score, local, gram[:, :a, -1])
        np.add.at(self.score, self.band_position.size + shared, gram[:, a : a + b, -1])

    def add_prior(self, weight: FloatArray, prior_offset: FloatArray) -> None:
        """Add independent priors.

        Args:
            weight: one over the prior variance of each unknown, shape (n + g,).
            prior_offset: prior mean minus current value, shape (n + g,).
        """
        n, g = self.cross.shape
        self.band[0, self.band_position] += weight[:n]
        self.shared[np.arange(g), np.arange(g)] += weight[n:]
        self.score[:] += weight * prior_offset

    def without_last_shared(self, count: int) -> "BandedNormalEquations":
        """Return the system in which the last `count` shared unknowns are fixed."""
        remaining = self.shared.shape[0] - count
        return BandedNormalEquations(
            self.band_position,
            self.band,
            np.ascontiguousarray(self.cross[:, :remaining]),
            np.ascontiguousarray(self.shared[:remaining, :remaining]),
            self.score[: self.score.size - count],
        )

    def solve(self) -> FloatArray:
        """Return the solution, shape (n + g,)."""
        factor, local_solution, reduced = self._eliminate_local(self.band)
        del factor
        shared = np.linalg.solve(reduced[:, :-1], reduced[:, -1])
        local = (local_solution[:, -1] - local_solution[:, :-1] @ shared)[self.band_position]
        return np.concatenate([local, shared])

    def log_evidence(self, rests: slice, rest_steps: FloatArray, variance: float) -> float:
        """Return twice the log-evidence of a prior variance of some local unknowns.

        It is correct up to a constant, with all unknowns marginalised.

        Args:
            rests: slice of these unknowns; the system has no prior of them.
            rest_steps: current values of these unknowns.
            variance: of their prior with mean zero.
        """
        rest_positions = self.band_position[rests]
        band = self.band.copy()
        band[0, rest_positions] += 1.0 / variance
        score = self.score.copy()
        score[rests] -= rest_steps / variance
        marginal = BandedNormalEquations(self.band_position, band, self.cross, self.shared, score)
        factor, local_solution, reduced = marginal._eliminate_local(band)
        shared = np.linalg.solve(reduced[:, :-1], reduced[:, -1])
        n = self.band_position.size
        by_place = np.empty(n)
        by_place[self.band_position] = score[:n]
        explained = float(by_place @ local_solution[:, -1] + reduced[:, -1] @ shared)
        log_determinant = 2.0 * float(np.sum(np.log(factor[0]))) + float(
            np.linalg.slogdet(reduced[:, :-1])[1]
        )
        return (
            explained
            - float(rest_steps @ rest_steps) / variance
            - log_determinant
            - rest_steps.size * float(np.log(variance))
        )

    def entries(self) -> tuple[IntArray, IntArray, FloatArray]:
        """Return rows, columns and values of the local block, in the order of the unknowns."""
        number = np.empty_like(self.band_position)
        number[self.band_position] = np.arange(self.band_position.size)
        diagonal, position = np.nonzero(self.band)
        row = number[position + diagonal]
        column = number[position]
        value = self.band[diagonal, position]
        is_off_diagonal = diagonal > 0
        return (
            np.concatenate([row, column[is_off_diagonal]]),
            np.concatenate([column, row[is_off_diagonal]]),
            np.concatenate([value, value[is_off_diagonal]]),
        )

    def _eliminate_local(self, band: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the band factor, the local solutions and the Schur complement."""
        n = self.band_position.size
        right_side = np.empty((n, self.shared.shape[0] + 1))
        right_side[:, :-1] = self.cross
        right_side[self.band_position, -1] = self.score[:n]
        factor = cholesky_banded(band, lower=True, check_finite=False)
        local_solution = cho_solve_banded((factor, True), right_side, check_finite=False)
        shared_system = np.column_stack([self.shared, self.score[n:]])
        return factor, local_solution, shared_system - self.cross.T @ local_solution
