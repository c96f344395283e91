"""The linear system of a fit of moves: banded along each axis, dense where all moves meet.

A move's starts touch only its own two rests, and a rest only its two moves: in the order
rest, starts, rest, starts, ... the local unknowns' matrix is banded. Its Cholesky factor
costs in proportion to the number of moves.

Source: Golub and Van Loan, Matrix Computations, 4th ed., section 4.3.5 (band Cholesky);
Boyd and Vandenberghe, Convex Optimization, appendix C.4 (elimination).
"""

from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.reference.table import MoveTable


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """Information and score; local unknowns (starts, then rests) first, then g shared ones."""

    place: IntArray  # (n,), where each local unknown stands in the band
    band: FloatArray  # (w + 1, n), lower half, by place
    cross: FloatArray  # (n, g), by place
    shared: FloatArray  # (g, g)
    score: FloatArray  # (n + g,), as the unknowns are numbered

    @classmethod
    def over(cls, table: MoveTable, shared: int) -> Self:
        """Return the system that knows nothing."""
        place = np.empty(table.starts + table.rests, dtype=np.int64)
        most, begin = 0, 0
        for axis in (0, 1):
            own = table.own[axis]
            orders = table.first[own + 1] - table.first[own]
            most = max(most, int(orders.max(initial=0)))
            end = begin + np.cumsum(orders + 1)
            rests = np.concatenate([[begin], end])
            place[table.starts + table.first_rest(axis) + np.arange(rests.size)] = rests
            within = np.arange(int(orders.sum())) - np.repeat(np.cumsum(orders) - orders, orders)
            starts = np.repeat(table.first[own], orders) + within
            place[starts] = np.repeat(rests[:-1] + 1, orders) + within
            begin = int(rests[-1]) + 1
        n = place.size
        return cls(
            place,
            np.zeros((most + 2, n)),
            np.zeros((n, shared)),
            np.zeros((shared, shared)),
            np.zeros(n + shared),
        )

    def add(self, local: IntArray, shared: IntArray, gram: FloatArray) -> None:
        """Add the evidence of m moves.

        Args:
            local: each move's local unknowns, shape (m, a).
            shared: its shared ones, numbered among themselves, shape (m, b).
            gram: of their slopes and, last, the residual; shape (m, a + b + 1, a + b + 1).
        """
        a, b = local.shape[1], shared.shape[1]
        place = self.place[local]
        one, two = np.tril_indices(a)
        low = np.minimum(place[:, one], place[:, two])
        np.add.at(self.band, (np.abs(place[:, one] - place[:, two]), low), gram[:, one, two])
        np.add.at(self.cross, (place[:, :, None], shared[:, None, :]), gram[:, :a, a : a + b])
        both = gram[:, a : a + b, a : a + b]
        np.add.at(self.shared, (shared[:, :, None], shared[:, None, :]), both)
        np.add.at(self.score, local, gram[:, :a, -1])
        np.add.at(self.score, self.place.size + shared, gram[:, a : a + b, -1])

    def hold(self, weight: FloatArray, pull: FloatArray) -> None:
        """Add independent priors.

        Args:
            weight: one over each unknown's prior variance, shape (n + g,).
            pull: where the prior has each, minus where it is, shape (n + g,).
        """
        n, g = self.cross.shape
        self.band[0, self.place] += weight[:n]
        self.shared[np.arange(g), np.arange(g)] += weight[n:]
        self.score[:] += weight * pull

    def solve(self) -> FloatArray:
        """Return the solution, shape (n + g,)."""
        factor, carry, left = self._eliminated(self.band)
        del factor
        shared = np.linalg.solve(left[:, :-1], left[:, -1])
        local = (carry[:, -1] - carry[:, :-1] @ shared)[self.place]
        return np.concatenate([local, shared])

    def likelihood(self, rests: slice, at: FloatArray, variance: float) -> float:
        """Return twice the log-likelihood of a prior variance of some local unknowns.

        Up to a constant: all unknowns marginalised, these about zero with `variance`.

        Args:
            rests: which unknowns they are; the system holds no prior of them.
            at: where they are now.
            variance: of each, about zero.
        """
        where = self.place[rests]
        band = self.band.copy()
        band[0, where] += 1.0 / variance
        pull = self.score.copy()
        pull[rests] -= at / variance
        chain = Chain(self.place, band, self.cross, self.shared, pull)
        factor, carry, left = chain._eliminated(band)
        shared = np.linalg.solve(left[:, :-1], left[:, -1])
        n = self.place.size
        by_place = np.empty(n)
        by_place[self.place] = pull[:n]
        explained = float(by_place @ carry[:, -1] + left[:, -1] @ shared)
        size = 2.0 * float(np.sum(np.log(factor[0]))) + float(np.linalg.slogdet(left[:, :-1])[1])
        return explained - float(at @ at) / variance - size - at.size * float(np.log(variance))

    def entries(self) -> tuple[IntArray, IntArray, FloatArray]:
        """Return rows, columns and values of the local unknowns' part, as they are numbered."""
        number = np.empty_like(self.place)
        number[self.place] = np.arange(self.place.size)
        off, at = np.nonzero(self.band)
        one, two, value = number[at + off], number[at], self.band[off, at]
        twice = off > 0
        return (
            np.concatenate([one, two[twice]]),
            np.concatenate([two, one[twice]]),
            np.concatenate([value, value[twice]]),
        )

    def _eliminated(self, band: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the band's factor, the local unknowns' carry by place, and what is left."""
        n = self.place.size
        right = np.empty((n, self.shared.shape[0] + 1))
        right[:, :-1] = self.cross
        right[self.place, -1] = self.score[:n]
        factor = cholesky_banded(band, lower=True, check_finite=False)
        carry = cho_solve_banded((factor, True), right, check_finite=False)
        both = np.column_stack([self.shared, self.score[n:]])
        return factor, carry, both - self.cross.T @ carry
