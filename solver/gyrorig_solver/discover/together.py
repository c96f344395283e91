"""Several boards on one unit as one space: what is common to all is looked for in all.

Each board has its own gain, bias, lag and noise, so its space beside its fit stands for
itself: informations and scores of a signal add up over the boards. The same cause at one
size then has N columns in one, while a cause of a single board overlaps with it by 1/N of
the energy only.

What to use when: `Together` wherever a `Projection` is asked for, to fit one common size;
`heard` for what one board has to say of a common size, `told` for what the others have.

Source: discovery notes, section 4, rule 4 (a shared column and a one-board column overlap
1/N with N boards); the sum of independent log likelihoods.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

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
        """Put them side by side, in this order."""
        self.boards = tuple(boards)
        self.stretches = tuple(s for one in boards for s in one.stretches)
        self.residual = np.concatenate([one.residual for one in boards])
        self.board = sum(one.board for one in boards)
        self._ends = np.cumsum([one.residual.size for one in boards])[:-1]

    def signals(self, of: Signal, exact: bool = False, term: Term | None = None) -> FloatArray:
        """Return what a function of each scene gives, whitened, (k, all)."""
        return np.concatenate([one.signals(of, exact, term) for one in self.boards], axis=1)

    def fitted(self, term: Term, values: FloatArray, free: IntArray | Sequence[int]) -> FloatArray:
        """Return a cause's derivatives and last its effect beside the fits, whitened."""
        return np.concatenate([one.fitted(term, values, free) for one in self.boards], axis=1)

    def look(self, white: FloatArray) -> Looked:
        """Return what whitened signals say beside the fits, all boards summed.

        `taken` has the boards' parameters one after the other.
        """
        found = [one.look(part) for one, part in zip(self.boards, self._apart(white), strict=True)]
        return Looked(
            sum((one.information for one in found), np.zeros(())),
            sum((one.score for one in found), np.zeros(())),
            sum((one.raw for one in found), np.zeros(())),
            np.concatenate([one.taken for one in found], axis=1),
        )

    def left(self, white: FloatArray) -> FloatArray:
        """Return what remains of one whitened signal once the fits have followed, (all,)."""
        parts = np.split(white, self._ends)
        return np.concatenate(
            [one.left(part) for one, part in zip(self.boards, parts, strict=True)]
        )

    def _apart(self, white: FloatArray) -> list[FloatArray]:
        return np.split(white, self._ends, axis=1)

    def of_board(self, k: int, taken: FloatArray) -> FloatArray:
        """Return what of a change of all boards' parameters is one board's."""
        first = sum(one.board for one in self.boards[:k])
        return taken[first : first + self.boards[k].board]


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


def told(values: FloatArray, others: Sequence[Heard]) -> Told:
    """Return what the other boards know of a cause's fitted values.

    To second order about the values, where each was heard: their informations add, and
    together they would like the values changed by the inverse of that times their slopes.
    So a fit of one board that is told this is the fit of all, seen from that board.

    Args:
        values: of the fitted parameters, (free,), where the others were heard.
        others: all boards but the one that is to be told.
    """
    information = np.sum([one.information for one in others], axis=0)
    slope = np.sum([one.slope for one in others], axis=0)
    return Told(values + _inverse(information)[0] @ slope, information)


def disagreement(boards: Sequence[Heard]) -> float:
    """Return how likely boards that share a cause's values differ as much as these, by chance.

    Args:
        boards: each as heard at the common best.

    Source: score test of homogeneity; the sum of s' A^-1 s over boards is chi-squared with
    as many degrees of freedom as there are values that several boards see, less one each.
    """
    statistic, degrees = 0.0, 0
    for one in boards:
        inverse, rank = _inverse(one.information)
        statistic += float(one.slope @ inverse @ one.slope)
        degrees += rank
    degrees -= _inverse(np.sum([one.information for one in boards], axis=0))[1]
    return float(chi2_tail(statistic, degrees)) if degrees > 0 else 1.0


def _inverse(information: FloatArray) -> tuple[FloatArray, int]:
    """Return the inverse on what is known, whatever the units, and how much that is."""
    own = np.sqrt(np.clip(np.diag(information), 0.0, None))
    scale = np.where(own > 0.0, own, 1.0)
    strength, along = np.linalg.eigh(information / np.outer(scale, scale))
    keep = strength > VANISHED
    turned = along[:, keep] / scale[:, None]
    return (turned / strength[keep]) @ turned.T, int(keep.sum())
