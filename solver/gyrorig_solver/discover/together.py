"""Several boards on one unit as one space: what is common to all is looked for in all.

Each board has its own gain, bias, lag, causes and noise; the unit's motion and its causes
are common. So informations and scores of a signal add up over the boards, each beside what
is the board's own, and the motion's unknowns are followed once for all, held once by what
the polls say of them: their errors are in all boards alike and would else count N times.
The same cause at one size then has N columns in one, while a cause of a single board
overlaps with it by 1/N of the energy only.

What to use when: `Together` wherever a `Projection` is asked for, to fit one common size;
`heard` for what one board has to say of a common size, `told` for what the others have.

Source: discovery notes, section 4, rule 4 (a shared column and a one-board column overlap
1/N with N boards); nuisances eliminated block by block (Schur complements), as in `arrow`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.chance import chi2_tail
from gyrorig_solver.discover.refit import Weighed
from gyrorig_solver.estimate.extension import Told
from gyrorig_solver.estimate.projection import Looked, Projection, Signal
from gyrorig_solver.model.terms.protocol import Term

VANISHED = 1e-7  # of the values' own: a direction with less information says nothing


class Together(Projection):
    """The spaces beside the fits of several boards, side by side."""

    def __init__(self, boards: Sequence[Projection]) -> None:
        """Put them side by side, in this order; they are of the same recordings."""
        self.boards = tuple(boards)
        self.stretches = tuple(s for one in boards for s in one.stretches)
        self.board = sum(one.board for one in boards)
        self._ends = np.cumsum([one.residual.size for one in boards])[:-1]
        told = [_told_causes(one) for one in boards]
        common = [name for name in told[0] if all(name in other for other in told)]
        self._parts = [
            _Part(one, np.concatenate([np.zeros(0, np.int64), *(own[name][0] for name in common)]))
            for one, own in zip(boards, told, strict=True)
        ]
        self.residual = np.concatenate([one.residual for one in self._parts])
        # What is known of the motion is one knowledge: that of the board that trusts it least.
        known = min((one.known for one in self._parts), key=lambda one: float(np.trace(one)))
        sizes = np.concatenate([np.zeros(0), *(told[0][name][1] for name in common)])
        inner = block_diag(known, np.diag(sizes**-2.0)) if sizes.size else known.copy()
        for one in self._parts:
            inner += one.information
        self._common = np.linalg.pinv(inner, hermitian=True)
        self._pull_common = sum((one.pull for one in self._parts), np.zeros(inner.shape[0]))

    def signals(self, of: Signal, exact: bool = False, term: Term | None = None) -> FloatArray:
        """Return what a function of each scene gives, whitened, (k, all)."""
        return np.concatenate([one.signals(of, exact, term) for one in self.boards], axis=1)

    def fitted(self, term: Term, values: FloatArray, free: IntArray | Sequence[int]) -> FloatArray:
        """Return a cause's derivatives and last its effect beside the fits, whitened."""
        return np.concatenate([one.fitted(term, values, free) for one in self.boards], axis=1)

    def look(self, white: FloatArray) -> Looked:
        """Return what whitened signals say beside the fits, all boards together.

        `taken` has the boards' parameters one after the other.
        """
        felt, own, common = self._followed(white)
        score = white @ self.residual - common.T @ self._pull_common
        gram = white @ white.T
        information = gram - sum((f.T @ common for f, _ in felt), np.zeros(gram.shape))
        taken = []
        for part, (_, there), step in zip(self._parts, felt, own, strict=True):
            score = score - step.T @ part.pull_own
            information = information - there.T @ step
            taken.append(part.taken(step, common).T)
        return Looked(information, score, np.diag(gram).copy(), np.concatenate(taken, axis=1))

    def left(self, white: FloatArray) -> FloatArray:
        """Return what remains of one whitened signal once the fits have followed, (all,)."""
        _, own, common = self._followed(white[None])
        return np.concatenate(
            [
                one - part.back(common[:, 0]) - part.own_rows.T @ step[:, 0]
                for part, one, step in zip(
                    self._parts, np.split(white, self._ends), own, strict=True
                )
            ]
        )

    def _followed(
        self, white: FloatArray
    ) -> tuple[list[tuple[FloatArray, FloatArray]], list[FloatArray], FloatArray]:
        """Return products with common and own rows, and the steps of own and common unknowns."""
        felt = [
            (part.felt(one.T), part.own_rows @ one.T)
            for part, one in zip(self._parts, np.split(white, self._ends, axis=1), strict=True)
        ]
        pull = sum(
            (f - part.carry.T @ o for part, (f, o) in zip(self._parts, felt, strict=True)),
            np.zeros((self._common.shape[0], len(white))),
        )
        common = self._common @ pull
        own = [
            part.own_inverse @ o - part.carry @ common
            for part, (_, o) in zip(self._parts, felt, strict=True)
        ]
        return felt, own, common

    def of_board(self, k: int, taken: FloatArray) -> FloatArray:
        """Return what of a change of all boards' parameters is one board's."""
        first = sum(one.board for one in self.boards[:k])
        return taken[first : first + self.boards[k].board]


class _Part:
    """One board's share: its own unknowns, and those that it has in common with the others."""

    def __init__(self, board: Projection, moved: IntArray) -> None:
        """Take a board apart; `moved`: which of its own unknowns are common to all boards."""
        apart = board.apart()
        stay = np.setdiff1d(np.arange(board.board), moved)
        self._moved, self._stay = moved, stay
        self._local = apart.local
        self._dense = np.vstack([apart.shared, apart.own[moved]])
        self.own_rows = apart.own[stay]
        self.known = apart.motion_known
        # As if the motion were what the polls say: so all boards speak of the same motion.
        away = np.concatenate([apart.motion_away, np.zeros(moved.size)])
        self.residual = board.residual - self.back(away)
        inner = self.own_rows @ self.own_rows.T + apart.own_known[np.ix_(stay, stay)]
        self.own_inverse = np.linalg.pinv(inner, hermitian=True)
        across = self.felt(self.own_rows.T)
        self.carry = self.own_inverse @ across.T
        near = (self._local @ self._local.T).toarray()
        cross = self._local @ self._dense.T
        gram = np.block([[near, cross], [cross.T, self._dense @ self._dense.T]])
        self.information = gram - across @ self.carry
        self.pull = self.felt(self.residual)
        self.pull_own = self.own_rows @ self.residual + apart.own_pull[stay]

    def felt(self, white: FloatArray) -> FloatArray:
        """Return the products of the common unknowns' derivatives with signals, (all, ...)."""
        return np.concatenate([self._local @ white, self._dense @ white])

    def back(self, step: FloatArray) -> FloatArray:
        """Return what a step of the common unknowns changes, (all,)."""
        local = self._local.shape[0]
        return np.asarray(self._local.T @ step[:local] + self._dense.T @ step[local:], np.float64)

    def taken(self, own: FloatArray, common: FloatArray) -> FloatArray:
        """Return steps of the board's parameters, (board, k), in their usual order."""
        found = np.zeros((self._stay.size + self._moved.size, own.shape[1]))
        found[self._stay] = own
        found[self._moved] = common[common.shape[0] - self._moved.size :]
        return found


def _told_causes(board: Projection) -> dict[tuple[str, ...], tuple[IntArray, FloatArray]]:
    """Return where the causes that boards have in common are, and how wide they may be."""
    found: dict[tuple[str, ...], tuple[IntArray, FloatArray]] = {}
    at = board.board - sum(one.free.size for one in board.extensions)
    for one in board.extensions:
        if one.told is not None:
            found[one.names] = np.arange(at, at + one.free.size), one.prior_std
        at += one.free.size
    return found


@dataclass(frozen=True, slots=True, eq=False)
class Heard:
    """What one board has to say of a cause at some values."""

    information: FloatArray  # (free, free), about them
    slope: FloatArray  # (free,), towards what this board alone would like better
    won: float  # nats that these values win of what the fit without the cause leaves


def heard(projection: Projection, weighed: Weighed) -> Heard:
    """Return what a board has to say of a cause at the values found.

    Args:
        projection: the space beside the board's fit without the cause.
        weighed: the cause, fitted to this or other boards.
    """
    one = weighed.extension
    looked = projection.look(projection.fitted(one.term, one.values, one.free))
    f = one.free.size
    return Heard(
        looked.information[:f, :f],
        looked.score[:f] - looked.information[:f, f],
        float(looked.score[f]) - 0.5 * float(looked.information[f, f]),
    )


def told(values: FloatArray, everyone: Heard, own: Heard) -> Told:
    """Return what the other boards know of a cause's fitted values.

    What all together know beyond what one board knows for itself is what it is to be told;
    and it is to be told so that it comes to rest where all together do.

    Args:
        values: of the fitted parameters, (free,), where they were heard.
        everyone: all boards together.
        own: the board that is to be told.
    """
    strength, along = np.linalg.eigh(everyone.information - own.information)
    information = (along * np.clip(strength, 0.0, None)) @ along.T
    return Told(values - _inverse(information)[0] @ own.slope, information)


def disagreement(boards: Sequence[Heard]) -> float:
    """Return how likely boards that share a cause's values differ as much as these, by chance.

    Args:
        boards: each as heard at the common best.

    Source: score test of homogeneity; the sum of s' A^-1 s over boards, less that of
    the boards' sums, is chi-squared with as many degrees of freedom as there are values that
    several boards see, less one each.
    """
    statistic, degrees = 0.0, 0
    for one in boards:
        inverse, rank = _inverse(one.information)
        statistic += float(one.slope @ inverse @ one.slope)
        degrees += rank
    inverse, rank = _inverse(np.sum([one.information for one in boards], axis=0))
    slope = np.sum([one.slope for one in boards], axis=0)
    statistic -= float(slope @ inverse @ slope)
    degrees -= rank
    return float(chi2_tail(statistic, degrees)) if degrees > 0 else 1.0


def _inverse(information: FloatArray) -> tuple[FloatArray, int]:
    """Return the inverse on what is known, whatever the units, and how much that is."""
    own = np.sqrt(np.clip(np.diag(information), 0.0, None))
    scale = np.where(own > 0.0, own, 1.0)
    strength, along = np.linalg.eigh(information / np.outer(scale, scale))
    keep = strength > VANISHED
    turned = along[:, keep] / scale[:, None]
    return (turned / strength[keep]) @ turned.T, int(keep.sum())
