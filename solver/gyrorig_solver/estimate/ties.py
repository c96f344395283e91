"""Causes that are the unit's: what boards on it have in common, where it is among their values.

A board's parameters are G, each recording's bias and offset, and its causes' values. Of a cause
that is the unit's, the values are the same for all boards: one unknown, in the place of each
board's own.

What to use when: `tied` before boards are fitted together, `same_values` with the labels of the
unit's causes before that; `disagreement` afterwards, of one board.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.chance import chi2_tail
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.estimate.information import Marginal
from gyrorig_solver.estimate.likelihood import Solution
from gyrorig_solver.model.terms.bound import label
from gyrorig_solver.model.terms.protocol import Term

VANISHED = 1e-9  # of the strongest direction: one with less information says nothing
Key = tuple[str, tuple[int, ...], tuple[float, ...]]


@dataclass(frozen=True, slots=True, eq=False)
class Ties:
    """Which unknown of all boards together each board's parameter is."""

    of: IntArray  # (x,), of all boards' parameters one after the other, into the unknowns
    common: BoolArray  # (x,), whether it is the unit's

    @property
    def size(self) -> int:
        """How many unknowns there are."""
        return int(self.of.max()) + 1

    def first(self, own: FloatArray) -> FloatArray:
        """Return what belongs to each unknown, of what belongs to the parameters."""
        found = np.zeros(self.size)
        found[self.of[::-1]] = own[::-1]
        return found


def is_of_unit(term: Term) -> bool:
    """Return whether a cause is the unit's by its kind, and so common to all boards on it."""
    return term.scope == "unit" or term.part == "ptu"


def is_tied(cause: Extension, common: Collection[str]) -> bool:
    """Return whether a cause is fitted as the unit's."""
    return bool(cause.free.size) and label(cause.term) in common


def same_values(alone: Sequence[Solution], common: Collection[str]) -> list[list[Extension]]:
    """Return each board's causes, the unit's at the mean of what the boards found.

    What boards were told of each other is left out: together they know it themselves.

    Args:
        alone: each board's own fit.
        common: labels of the unit's causes.
    """
    weights: dict[Key, FloatArray] = {}
    sums: dict[Key, FloatArray] = {}
    for one in alone:
        for cause, at in placed(one.extensions, one.estimate.size):
            if is_tied(cause, common):
                variance = np.diag(one.decision.covariance)[at]
                weight = 1.0 / np.where(variance > 0.0, variance, cause.prior_std**2)
                key = _key(cause)
                weights[key] = weights.get(key, np.zeros(at.size)) + weight
                sums[key] = sums.get(key, np.zeros(at.size)) + weight * cause.values[cause.free]
    found = []
    for one in alone:
        causes = []
        for cause in one.extensions:
            if is_tied(cause, common):
                values = cause.values.copy()
                values[cause.free] = sums[_key(cause)] / weights[_key(cause)]
                causes.append(replace(cause, values=values, told=None))
            else:
                causes.append(cause)
        found.append(causes)
    return found


def tied(
    boards: Sequence[Sequence[Extension]], sizes: Sequence[int], common: Collection[str]
) -> Ties:
    """Return which unknown each board's parameter is.

    Args:
        boards: each board's causes.
        sizes: how many parameters each has, its causes' values the last.
        common: labels of the unit's causes.
    """
    seen: dict[tuple[Key, int], int] = {}
    of: list[int] = []
    shared: list[bool] = []
    unknowns = 0
    for causes, size in zip(boards, sizes, strict=True):
        keys: dict[int, tuple[Key, int]] = {}
        for cause, at in placed(causes, size):
            if is_tied(cause, common):
                keys |= {int(k): (_key(cause), n) for n, k in enumerate(at)}
        for k in range(size):
            known = seen.get(keys[k]) if k in keys else None
            of.append(unknowns if known is None else known)
            shared.append(k in keys)
            if known is None:
                if k in keys:
                    seen[keys[k]] = unknowns
                unknowns += 1
    return Ties(np.array(of, dtype=np.int64), np.array(shared, dtype=np.bool_))


def disagreement(found: Sequence[Marginal], units: FloatArray, common: BoolArray) -> float:
    """Return how likely chance alone makes one board pull so hard at the unit's causes.

    Args:
        found: of each recording, over the board's G, bias, offset and causes, at the joint best.
        units: prior deviation of these, (p,).
        common: which of them are the unit's, (p,).

    Source: score test (Rao 1948) of the unit's values, the board's own taken out.
    """
    if not common.any():
        return 1.0
    likely = 1.0
    for one in found:
        scale = np.outer(units, units)
        information, score = one.information * scale, one.score * units
        mine, unit = np.flatnonzero(~common), np.flatnonzero(common)
        across = information[np.ix_(unit, mine)]
        inner = np.linalg.pinv(information[np.ix_(mine, mine)], hermitian=True)
        left = information[np.ix_(unit, unit)] - across @ inner @ across.T
        pull = score[unit] - across @ inner @ score[mine]
        strength, along = np.linalg.eigh(left)
        keep = strength > VANISHED * max(float(strength[-1]), VANISHED)
        turned = along[:, keep].T @ pull
        statistic = float(np.sum(turned**2 / strength[keep]))
        likely = min(likely, chi2_tail(statistic, int(keep.sum())) if keep.any() else 1.0)
    return likely


def placed(causes: Sequence[Extension], size: int) -> list[tuple[Extension, IntArray]]:
    """Return each fitted cause and where its values are among a board's parameters."""
    at = size - sum(one.free.size for one in causes)
    found = []
    for one in causes:
        if one.free.size:
            found.append((one, np.arange(at, at + one.free.size)))
            at += one.free.size
    return found


def _key(cause: Extension) -> Key:
    """Return what makes a cause of two boards the same: its name, and all that is not fitted."""
    kept = np.delete(cause.values, cause.free)
    return label(cause.term), tuple(cause.free.tolist()), tuple(np.round(kept, 12).tolist())
