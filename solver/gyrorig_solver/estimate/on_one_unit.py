"""Boards on one unit, fitted together: its motion was one, and all of them saw it.

When each move began, where each rest was, how fast the unit went: one board alone finds
these with its own samples and the unit's answers. Boards that were on it at once find them
together. Each keeps its own gain, biases, time offsets, noise and causes; the unit's unknowns,
and the causes that are the unit's (`ties`), are common. In one normal matrix the boards'
parameters are the border, the unit's moments its sparse inside, which is eliminated once for all.

What to use when: `fit_on_one_unit` after a fit of each board alone. A board that does not
agree with the others on how the unit moved is left out, or it would bend all of them.

Source: block elimination as in `arrow`. The test of agreement is a score test (Rao 1948) of a
board's own say in the unit's unknowns, at the joint best; as the unit's answers hold these, it
is a weighted sum of chi-squared, taken as one of the same mean and variance (Satterthwaite 1946).
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, solve_triangular

from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.arrow import Arrow
from gyrorig_solver.chance import chi2_tail
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.estimate.information import Marginal, marginalise
from gyrorig_solver.estimate.likelihood import CONVERGED_SIGMA, Solution, Work, resumed
from gyrorig_solver.estimate.normal import Normal
from gyrorig_solver.estimate.observability import decide_in
from gyrorig_solver.estimate.ties import disagreement, same_values, tied
from gyrorig_solver.estimate.whitening import OWN
from gyrorig_solver.reference.motion import ReferenceMotion

ROUNDS = 8
ROUNDS_OF_CAUSES = 16
MOVED_SIGMA = 2.0  # a time offset that all boards' fit moves by more says that it crept away
UNSETTLED = "the fit of all boards with their causes did not settle"
DISAGREEMENT_P = 1e-6  # of a board, divided by how many are asked
MOST_UNKNOWNS = 1500  # of a motion: beyond, a dense matrix of them takes too long


@dataclass(frozen=True, slots=True, eq=False)
class OnOneUnit:
    """Where the joint fit ended."""

    solutions: Mapping[str, Solution]  # of the boards that took part; none where too few could
    left_out: Mapping[str, str]  # the others, and why


def fit_on_one_unit(alone: Mapping[str, Solution], common: Collection[str] = ()) -> OnOneUnit:
    """Fit boards together that were on one unit in the same recordings.

    Args:
        alone: where the fit of each board by itself ended.
        common: labels of causes that are the unit's; of each board that has them.
    """
    left_out = {name: why for name, one in alone.items() if (why := _unfit(one))}
    taking = {name: one for name, one in alone.items() if name not in left_out}
    for name in _of_another_motion(taking):
        left_out[name] = "its reference motion is not that of the other boards"
        del taking[name]
    while len(taking) > 1:
        work, converged = _fitted(list(taking.values()), common)
        with_causes = any(_causes(one) for one in taking.values())
        if with_causes and not (converged and _stayed(taking.values(), work.lags_s())):
            return OnOneUnit({}, dict.fromkeys(taking, UNSETTLED) | left_out)
        p = dict(zip(taking, work.agreements(), strict=True))
        worst = min(p, key=lambda name: p[name])
        if p[worst] >= DISAGREEMENT_P / len(taking):
            return OnOneUnit(dict(zip(taking, work.solutions(converged), strict=True)), left_out)
        # Of two that disagree nobody can say which is right.
        two = len(taking) == 2
        gone = list(taking) if two else [worst]
        others = "the other board" if two else f"{len(taking) - 1} other boards"
        for name in gone:
            left_out[name] = (
                f"it does not agree with {others} on what the unit did "
                f"(p {max(p[worst], 1e-99):.0e}): look at screws and clocks"
            )
            del taking[name]
    return OnOneUnit({}, left_out)


def _unfit(one: Solution) -> str:
    """Return why a board's fit must not speak for the others, "" where it may."""
    return "" if one.converged else "its own fit did not settle"


def _causes(one: Solution) -> int:
    """Return how many values of causes are fitted to a board."""
    return sum(cause.free.size for cause in one.extensions)


def _of_another_motion(solutions: Mapping[str, Solution]) -> list[str]:
    """Return the boards whose reference has other unknowns than most have."""
    layout = {
        name: tuple((type(s.reference).__name__, s.reference.information.size) for s in o.sessions)
        for name, o in solutions.items()
    }
    usual = max(layout.values(), key=list(layout.values()).count, default=())
    return [name for name, one in layout.items() if one != usual]


def _stayed(alone: Iterable[Solution], lags_s: Sequence[FloatArray]) -> bool:
    """Return whether boards' time offsets are still what each found for itself.

    Where causes bend the motion, derivatives by lags and moves leave out how their effects move
    with them, and a common shift of both, which hardly changes anything, may creep on and on.
    """
    for one, now_s in zip(alone, lags_s, strict=True):
        before_s = np.array([session.lag_s for session in one.sessions])
        std_s = np.sqrt([own.covariance[12, 12] for own in one.own])
        if np.any(np.abs(now_s - before_s) > MOVED_SIGMA * std_s):
            return False
    return True


def _fitted(alone: Sequence[Solution], common: Collection[str]) -> tuple["_Joint", bool]:
    work = _Joint(alone, common)
    for _ in range(ROUNDS if not any(_causes(one) for one in alone) else ROUNDS_OF_CAUSES):
        step = work.round()
        if step < CONVERGED_SIGMA:
            return work, True
        work.look_again(step)
    return work, False


class _Joint:
    """The joint fit under way: the boards' own works, side by side."""

    def __init__(self, alone: Sequence[Solution], common: Collection[str]) -> None:
        causes = same_values(alone, common)
        self._works = self._begun(alone, causes)
        sizes = [work.units().size for work in self._works]
        ends = np.cumsum(sizes)
        self._own = [slice(end - size, end) for end, size in zip(ends, sizes, strict=True)]
        self._widths = [OWN + _causes(one) for one in alone]  # of a recording's
        self._ties = tied(causes, sizes, common)
        self._units = self._ties.first(np.concatenate([work.units() for work in self._works]))
        self._information = np.zeros((0, 0))

    def _begun(self, alone: Sequence[Solution], causes: list[list[Extension]]) -> list[Work]:
        """Return the boards' works, all of them at the motion that is their mean."""
        works = [resumed(one, own) for one, own in zip(alone, causes, strict=True)]
        for sessions in zip(*(work.sessions for work in works), strict=True):
            pulls = [session.reference.pull for session in sessions]
            middle = np.mean(pulls, axis=0)
            for session, pull in zip(sessions, pulls, strict=True):
                session.reference = session.reference.moved(pull - middle)
        for work in works:
            work.look_again(np.inf)
        return works

    def round(self) -> float:
        """Take one Gauss-Newton step of all boards; return its largest size in deviations."""
        found = self._marginals()
        size = self._units.size
        information, score = np.zeros((size, size)), np.zeros(size)
        for k, marginal in enumerate(found):
            index = self._ties.of[self._index(k)]  # with the unit's causes once for each board
            np.add.at(information, np.ix_(index, index), marginal.information)
            np.add.at(score, index, marginal.score)
        self._information = information
        decision = decide_in(information, self._units)
        step = decision.inverse @ score
        sigma = np.sqrt(np.clip(np.diag(decision.covariance), 0.0, None))
        every = step[self._ties.of]
        motions = [m.nuisance(every[self._index(k)]) for k, m in enumerate(found)]
        for work, own in zip(self._works, self._own, strict=True):
            work.take(every[own], motions)
        return float(np.max(np.abs(step) / np.where(sigma > 0.0, sigma, np.inf)))

    def look_again(self, size: float) -> None:
        """Predict anew after a step of that size."""
        for work in self._works:
            work.look_again(size)

    def solutions(self, converged: bool) -> list[Solution]:
        """Return each board's result, the other boards' parameters taken out."""
        return [
            work.solution(converged, self._of_board(own))
            for work, own in zip(self._works, self._own, strict=True)
        ]

    def lags_s(self) -> list[FloatArray]:
        """Return each board's lags, of each recording."""
        return [np.array([session.lag_s for session in work.sessions]) for work in self._works]

    def agreements(self) -> list[float]:
        """Return how likely each board would say so much else of the unit, by chance."""
        return [self._agreement(k) for k in range(len(self._works))]

    def _agreement(self, k: int) -> float:
        """Return it for one board: on the motion, and on the causes that are the unit's."""
        work, width = self._works[k], self._widths[k]
        both = list(zip(work.normals(), work.sessions, strict=True))
        of_motion = min(agreement(normal, one.reference, width) for normal, one in both)
        common = self._ties.common[self._own[k]][work.index(0)]
        if not common.any():
            return of_motion
        told = [marginalise(normal, one.reference, width) for normal, one in both]
        return min(of_motion, disagreement(told, work.units()[work.index(0)], common))

    def _of_board(self, own: slice) -> FloatArray:
        """Return the information about one board's parameters, all others' taken out."""
        keep = self._ties.of[own]
        drop = np.setdiff1d(np.arange(self._units.size), keep)
        # A hair of prior: what a board's motion does not show is not known of the others.
        inner = self._information[np.ix_(drop, drop)] + np.diag(1e-6 / self._units[drop] ** 2)
        across = self._information[np.ix_(keep, drop)]
        left = self._information[np.ix_(keep, keep)] - across @ np.linalg.solve(inner, across.T)
        return np.asarray((left + left.T) / 2.0, dtype=np.float64)

    def _index(self, k: int) -> IntArray:
        """Return where the boards' parameters of recording `k` are among all."""
        pairs = zip(self._works, self._own, strict=True)
        return np.concatenate([own.start + work.index(k) for work, own in pairs])

    def _marginals(self) -> list[Marginal]:
        """Return what each recording tells of all boards, the unit's unknowns taken out."""
        normals = zip(*(work.normals() for work in self._works), strict=True)
        return [
            marginalise(side_by_side(boards, self._widths), session.reference, sum(self._widths))
            for boards, session in zip(normals, self._works[0].sessions, strict=True)
        ]


def agreement(normal: Normal, reference: ReferenceMotion, width: int = OWN) -> float:
    """Return how likely chance alone makes one board pull so hard at the unit's unknowns.

    Args:
        normal: of the board, at the best of all boards.
        reference: what the unit's answers know of the unknowns.
        width: how many parameters are the board's.
    """
    local, _ = normal.matrix.size
    if not 0 < local <= MOST_UNKNOWNS:
        return 1.0
    matrix = normal.matrix.to_dense()
    own = np.arange(local, local + width)
    unit = np.concatenate([np.arange(local), np.arange(local + width, matrix.shape[0])])
    said = _without(matrix, unit, own)
    follow = np.linalg.pinv(matrix[np.ix_(own, own)], hermitian=True) @ normal.score[own]
    score = normal.score[unit] - matrix[np.ix_(unit, own)] @ follow
    known = reference.information.to_dense()
    known = _without(known, np.arange(unit.size), np.arange(unit.size, known.shape[0]))
    half = np.linalg.cholesky(said + known)
    pull = solve_triangular(half, score, lower=True)
    inner = solve_triangular(half, solve_triangular(half, said, lower=True).T, lower=True)
    mean, spread = float(np.trace(inner)), float(np.sum(inner * inner))
    return float(chi2_tail(float(pull @ pull) * mean / spread, mean**2 / spread))


def _without(matrix: FloatArray, keep: IntArray, drop: IntArray) -> FloatArray:
    """Return the information about some unknowns, others taken out."""
    across = matrix[np.ix_(keep, drop)]
    inner = np.linalg.pinv(matrix[np.ix_(drop, drop)], hermitian=True)
    return np.asarray(matrix[np.ix_(keep, keep)] - across @ inner @ across.T, dtype=np.float64)


def side_by_side(boards: Sequence[Normal], widths: Sequence[int] = ()) -> Normal:
    """Return one recording's equations over (local | each board's own, the unit's shared).

    Args:
        boards: of each, over (local | own, shared), of the same local and shared unknowns.
        widths: how many parameters each board has of its own, where they have causes.
    """
    local = boards[0].matrix.size[0]
    each = list(zip(boards, widths or [OWN] * len(boards), strict=True))
    near = boards[0].matrix.local
    for other in boards[1:]:
        near = (near + other.matrix.local).tocsc()
    inner = block_diag(*(b.matrix.shared[:own, :own] for b, own in each))
    shared = np.sum([b.matrix.shared[own:, own:] for b, own in each], axis=0)
    border = np.vstack([b.matrix.shared[:own, own:] for b, own in each])
    cross = [b.matrix.cross[:, :own] for b, own in each]
    far = np.sum([b.matrix.cross[:, own:] for b, own in each], axis=0)
    matrix = Arrow(near, np.hstack([*cross, far]), np.block([[inner, border], [border.T, shared]]))
    mine = [b.score[local : local + own] for b, own in each]
    rest = np.sum([b.score[local + own :] for b, own in each], axis=0)
    first = np.sum([b.score[:local] for b in boards], axis=0)
    return Normal(matrix, np.concatenate([first, *mine, rest]))
