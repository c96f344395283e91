"""Boards on one unit, fitted together: its motion was one, and all of them saw it.

When each move began, where each rest was, how fast the unit went: one board alone finds
these with its own samples and the unit's answers. Boards that were on it at once find them
together. Each keeps its own gain, biases, time offsets and noise; only the unit's unknowns
are common. In one normal matrix the boards' parameters are the border, the unit's moments
its sparse inside, which is eliminated once for all.

What to use when: `fit_on_one_unit` after a fit of each board alone. A board that does not
agree with the others on how the unit moved is left out, or it would bend all of them.

Source: block elimination as in `arrow`. The test of agreement is a score test (Rao 1948) of a
board's own say in the unit's unknowns, at the joint best; as the unit's answers hold these, it
is a weighted sum of chi-squared, taken as one of the same mean and variance (Satterthwaite 1946).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, solve_triangular

from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.arrow import Arrow
from gyrorig_solver.chance import chi2_tail
from gyrorig_solver.estimate.information import Marginal, marginalise
from gyrorig_solver.estimate.likelihood import CONVERGED_SIGMA, Solution, Work, resumed
from gyrorig_solver.estimate.normal import Normal
from gyrorig_solver.estimate.observability import decide_in
from gyrorig_solver.estimate.whitening import OWN
from gyrorig_solver.reference.motion import ReferenceMotion

ROUNDS = 8
DISAGREEMENT_P = 1e-6  # of a board, divided by how many are asked
MOST_UNKNOWNS = 1500  # of a motion: beyond, a dense matrix of them takes too long


@dataclass(frozen=True, slots=True, eq=False)
class OnOneUnit:
    """Where the joint fit ended."""

    solutions: Mapping[str, Solution]  # of the boards that took part; none where too few could
    left_out: Mapping[str, str]  # the others, and why


def fit_on_one_unit(alone: Mapping[str, Solution]) -> OnOneUnit:
    """Fit boards together that were on one unit in the same recordings.

    Args:
        alone: where the fit of each board by itself ended.
    """
    left_out = {name: why for name, one in alone.items() if (why := _unfit(one))}
    taking = {name: one for name, one in alone.items() if name not in left_out}
    for name in _of_another_motion(taking):
        left_out[name] = "its reference motion is not that of the other boards"
        del taking[name]
    while len(taking) > 1:
        work, converged = _fitted(list(taking.values()))
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
                f"it does not agree with {others} on how the unit moved "
                f"(p {max(p[worst], 1e-99):.0e}): look at screws and clocks"
            )
            del taking[name]
    return OnOneUnit({}, left_out)


def _unfit(one: Solution) -> str:
    """Return why a board's fit must not speak for the others, "" where it may."""
    if any(cause.free.size for cause in one.extensions):
        return "causes of its own are fitted to it"
    if not one.converged:
        return "its own fit did not settle"
    return ""


def _of_another_motion(solutions: Mapping[str, Solution]) -> list[str]:
    """Return the boards whose reference has other unknowns than most have."""
    layout = {
        name: tuple((type(s.reference).__name__, s.reference.information.size) for s in o.sessions)
        for name, o in solutions.items()
    }
    usual = max(layout.values(), key=list(layout.values()).count, default=())
    return [name for name, one in layout.items() if one != usual]


def _fitted(alone: Sequence[Solution]) -> tuple["_Joint", bool]:
    work = _Joint(alone)
    converged = False
    for _ in range(ROUNDS):
        step = work.round()
        if step < CONVERGED_SIGMA:
            converged = True
            break
        work.look_again(step)
    return work, converged


class _Joint:
    """The joint fit under way: the boards' own works, side by side."""

    def __init__(self, alone: Sequence[Solution]) -> None:
        self._works = self._begun(alone)
        sizes = [work.units().size for work in self._works]
        ends = np.cumsum(sizes)
        self._own = [slice(end - size, end) for end, size in zip(ends, sizes, strict=True)]
        self._units = np.concatenate([work.units() for work in self._works])
        self._information = np.zeros((0, 0))

    def _begun(self, alone: Sequence[Solution]) -> list[Work]:
        """Return the boards' works, all of them at the motion that is their mean."""
        works = [resumed(one, one.extensions) for one in alone]
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
            index = self._index(k)
            information[np.ix_(index, index)] += marginal.information
            score[index] += marginal.score
        self._information = information
        decision = decide_in(information, self._units)
        step = decision.inverse @ score
        sigma = np.sqrt(np.clip(np.diag(decision.covariance), 0.0, None))
        motions = [m.nuisance(step[self._index(k)]) for k, m in enumerate(found)]
        for work, own in zip(self._works, self._own, strict=True):
            work.take(step[own], motions)
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

    def agreements(self) -> list[float]:
        """Return how likely each board would say so much else of the unit, by chance."""
        return [
            min(
                agreement(normal, session.reference)
                for normal, session in zip(work.normals(), work.sessions, strict=True)
            )
            for work in self._works
        ]

    def _of_board(self, own: slice) -> FloatArray:
        """Return the information about one board's parameters, all others' taken out."""
        drop = np.setdiff1d(np.arange(self._units.size), np.arange(own.start, own.stop))
        # A hair of prior: what a board's motion does not show is not known of the others.
        inner = self._information[np.ix_(drop, drop)] + np.diag(1e-6 / self._units[drop] ** 2)
        across = self._information[own, drop]
        left = self._information[own, own] - across @ np.linalg.solve(inner, across.T)
        return np.asarray((left + left.T) / 2.0, dtype=np.float64)

    def _index(self, k: int) -> IntArray:
        """Return where the boards' parameters of recording `k` are among all."""
        pairs = zip(self._works, self._own, strict=True)
        return np.concatenate([own.start + work.index(k) for work, own in pairs])

    def _marginals(self) -> list[Marginal]:
        """Return what each recording tells of all boards, the unit's unknowns taken out."""
        normals = zip(*(work.normals() for work in self._works), strict=True)
        return [
            marginalise(side_by_side(boards), session.reference, OWN * len(boards))
            for boards, session in zip(normals, self._works[0].sessions, strict=True)
        ]


def agreement(normal: Normal, reference: ReferenceMotion) -> float:
    """Return how likely chance alone makes one board pull so hard at the unit's unknowns.

    Args:
        normal: of the board, at the best of all boards.
        reference: what the unit's answers know of the unknowns.
    """
    local, _ = normal.matrix.size
    if not 0 < local <= MOST_UNKNOWNS:
        return 1.0
    matrix = normal.matrix.to_dense()
    own = np.arange(local, local + OWN)
    unit = np.concatenate([np.arange(local), np.arange(local + OWN, matrix.shape[0])])
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


def side_by_side(boards: Sequence[Normal]) -> Normal:
    """Return one recording's equations over (local | each board's own, the unit's shared).

    Args:
        boards: of each, over (local | own, shared), of the same local and shared unknowns.
    """
    local = boards[0].matrix.size[0]
    mine, rest = slice(0, OWN), slice(OWN, None)
    near = boards[0].matrix.local
    for other in boards[1:]:
        near = (near + other.matrix.local).tocsc()
    inner = block_diag(*(b.matrix.shared[mine, mine] for b in boards))
    shared = np.sum([b.matrix.shared[rest, rest] for b in boards], axis=0)
    border = np.vstack([b.matrix.shared[mine, rest] for b in boards])
    cross = [b.matrix.cross[:, mine] for b in boards]
    far = np.sum([b.matrix.cross[:, rest] for b in boards], axis=0)
    matrix = Arrow(near, np.hstack([*cross, far]), np.block([[inner, border], [border.T, shared]]))
    own = [b.score[local : local + OWN] for b in boards]
    total = np.sum([b.score for b in boards], axis=0)
    return Normal(matrix, np.concatenate([total[:local], *own, total[local + OWN :]]))
