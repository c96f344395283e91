"""Several boards on one unit, explained together.

Each board is first searched for itself. Then whatever a board named that may be the
unit's, or may be taken for something of the unit's, is asked of all boards at once: one
common size, or each board's own (`hypotheses`). A cause that is the unit's is fitted to
every board with what the others know of it (`together.told`), which is the joint fit.
At last what no board saw alone is looked for in all of them together.

What to use when: `explain_boards` from a fit of the base model to each board.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.discover.finder import conclude
from gyrorig_solver.discover.hypotheses import Hypothesis, owner, weigh
from gyrorig_solver.discover.refit import Weighed
from gyrorig_solver.discover.result import Explained, Whose
from gyrorig_solver.discover.scores import sights
from gyrorig_solver.discover.search import (
    ALPHA,
    CONTENDERS,
    Found,
    Standing,
    by_chance,
    search,
    siblings,
    testable,
    tests_of,
)
from gyrorig_solver.discover.together import Heard, Together, disagreement, heard, told
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.estimate.likelihood import Solution, solve_again
from gyrorig_solver.estimate.projection import Projection
from gyrorig_solver.model.terms.bound import label
from gyrorig_solver.model.terms.protocol import Term

SEEN_NATS = 4.0  # won on a board's own data: less may be chance (once in 200 for one size)
CLOSE_NATS = 30.0  # of evidence behind: no more than a look at all boards might make good
MOST_UNKNOWNS = 4000  # of a motion: beyond, a dense matrix over them takes too much memory
MOST_WEAK = 4  # causes that only all boards together show

Asked = dict[int, tuple[Extension, Standing]]  # by board: what is to be explained


@dataclass(slots=True, eq=False)
class _Board:
    """One board under way."""

    name: str
    base: Solution
    found: Found
    solution: Solution
    standings: list[Standing]  # of each fitted cause, in the fit's order
    whose: dict[str, Whose]

    def fitted(self) -> list[tuple[Extension, Standing]]:
        free = [one for one in self.solution.extensions if one.free.size]
        return list(zip(free, self.standings, strict=True))

    def beside(self, gone: Extension | None) -> Projection:
        """Return the space beside the fit, or beside it without one of its causes."""
        if gone is None:
            return Projection.of(self.solution)
        others = [one for one in self.solution.extensions if one is not gone]
        return Projection.of(self.solution, extensions=others, back=[gone])

    def put(self, gone: Extension | None, cause: Extension, standing: Standing) -> None:
        """Fit a cause, in the place of another or beside all others."""
        stay = [(one, s) for one, s in self.fitted() if one is not gone]
        known = [one for one in self.solution.extensions if not one.free.size]
        self.standings = [*(s for _, s in stay), standing]
        self.solution = solve_again(self.solution, [*known, *(one for one, _ in stay), cause])

    def drop(self, gone: Extension) -> None:
        """Fit without a cause."""
        self.standings = [standing for one, standing in self.fitted() if one is not gone]
        stay = [one for one in self.solution.extensions if one is not gone]
        self.solution = solve_again(self.solution, stay)

    def judge(self, cause: Extension, standing: Standing) -> None:
        """Put another standing in the place of a cause's."""
        fitted = self.fitted()
        self.standings = [standing if one is cause else s for one, s in fitted]

    def ended(self) -> Found:
        """Return where the search ended, what may be there unseen brought up to date."""
        if self.solution is self.found.solution:
            return replace(self.found, standings=tuple(self.standings))
        last = Projection.of(self.solution)
        terms = testable(last)
        taken = {label(one.term) for one in self.solution.extensions}
        seen = sights(last, [t for t in terms if label(t) not in taken], tests_of(terms))
        return Found(self.solution, tuple(self.standings), last, tuple(seen))


def explain_boards(bases: Mapping[str, Solution]) -> dict[str, Explained]:
    """Find what the base model gets wrong for the boards on one unit, all of them together.

    Where motions differ, or are of thousands of moves, each board is explained for itself.

    Args:
        bases: the fit of the base model to each board, of the same recordings.
    """
    begin = time.monotonic()
    boards = []
    for name, base in bases.items():
        found = search(base)
        boards.append(_Board(name, base, found, found.solution, list(found.standings), {}))
    if len(boards) > 1 and _of_one_motion(list(bases.values())):
        for asked in _questions(boards):
            _answer(boards, asked)
        _weak(boards)
        _own(boards)
    return {b.name: conclude(b.base, b.ended(), b.name, begin, b.whose) for b in boards}


def _of_one_motion(bases: Sequence[Solution]) -> bool:
    """Return whether fits follow the same motion, and one short enough to be followed at once."""
    sizes = [[session.reference.information.size for session in b.sessions] for b in bases]
    many = sum(local + shared for local, shared in sizes[0])
    return many <= MOST_UNKNOWNS and all(one == sizes[0] for one in sizes)


def _questions(boards: Sequence[_Board]) -> list[Asked]:
    """Return what the boards named that may be one thing, the strongest first.

    Of each board at most one cause takes part: the same, or one that was taken for it.
    """
    named = [(k, one, s) for k, board in enumerate(boards) for one, s in board.fitted()]
    named.sort(key=lambda entry: -entry[2].best.won)
    found: list[Asked] = []
    used: list[Extension] = []
    for k, one, standing in named:
        if any(one is other for other in used):
            continue
        asked: Asked = {k: (one, standing)}
        names = _names(standing)
        for j, other, rival in sorted(named, key=lambda e: label(e[1].term) != label(one.term)):
            if j not in asked and not any(other is u for u in used) and names & _names(rival):
                asked[j] = (other, rival)
        used += [one for one, _ in asked.values()]
        if any(owner(term) != "board" for term in _terms(asked).values()):
            found.append(asked)
    return found


def _names(standing: Standing) -> set[str]:
    close = standing.best.evidence - CLOSE_NATS
    rivals = {label(w.extension.term) for w, _ in standing.rivals if w.evidence > close}
    return {label(standing.best.extension.term), *rivals}


def _terms(asked: Asked) -> dict[str, Term]:
    """Return all candidates for what is to be explained, the likeliest first."""
    weighed = [w for _, s in asked.values() for w in (s.best, *(r for r, _ in s.rivals))]
    some = set().union(*(_names(s) for _, s in asked.values()))
    weighed.sort(key=lambda w: -w.evidence)
    every = {label(w.extension.term): w.extension.term for w in weighed}
    return {name: term for name, term in every.items() if name in some}


def _answer(boards: Sequence[_Board], asked: Asked) -> None:
    """Decide what it is and whose, and fit it so."""
    besides = [b.beside(asked[k][0] if k in asked else None) for k, b in enumerate(boards)]
    tests = tests_of(testable(besides[0]))
    taken = [
        {label(e.term) for e in b.solution.extensions if k not in asked or e is not asked[k][0]}
        for k, b in enumerate(boards)
    ]
    found = [
        one
        for name, term in _terms(asked).items()
        if not any(name in some for some in taken)
        for one in weigh(besides, term, tests)
    ]
    if not found:
        return
    found.sort(key=lambda one: -one.evidence)
    if found[0].evidence <= 0.0:
        # What a unit does all boards show: on one alone, and as little, it is chance.
        for k, (cause, _) in asked.items():
            boards[k].drop(cause)
    elif found[0].common is not None:
        _shared(boards, besides, asked, found)
    else:
        _apart(boards, asked, found)


def _shared(
    boards: Sequence[_Board], besides: Sequence[Projection], asked: Asked, found: list[Hypothesis]
) -> None:
    """Fit a unit's cause to all boards at one common size."""
    joint = found[0].common
    if joint is None:
        return
    each = [heard(beside, joint) for beside in besides]
    whose = Whose("unit", sum(h.won > SEEN_NATS for h in each), len(each), disagreement(each))
    together = Together(besides)
    everyone = heard(together, joint)
    for k, board in enumerate(boards):
        others = told(joint.extension.values[joint.extension.free], everyone, each[k])
        cause = replace(joint.extension, told=others)
        best = replace(joint, extension=cause, taken=together.of_board(k, joint.taken))
        board.put(asked[k][0] if k in asked else None, cause, _standing(best, found, each[k]))
        board.whose[label(cause.term)] = whose


def _apart(boards: Sequence[_Board], asked: Asked, found: list[Hypothesis]) -> None:
    """Give each board that needs one its own cause."""
    for k, board in enumerate(boards):
        best = found[0].own[k]
        if k not in asked or best is None:
            continue
        cause, _ = asked[k]
        if label(cause.term) == found[0].name:
            board.judge(cause, _standing(replace(best, extension=cause), found, None))
        else:
            board.put(cause, best.extension, _standing(best, found, None))


def _standing(best: Weighed, found: list[Hypothesis], here: Heard | None) -> Standing:
    """Return the standing of the first of some hypotheses, all boards' evidence counted."""
    first = found[0]
    evidence = np.array([one.evidence for one in found])
    belief = np.exp(evidence - evidence.max())
    belief /= belief.sum()
    shares: dict[str, tuple[Weighed, float]] = {}
    for one, share in zip(found[1:], belief[1:], strict=True):
        if one.name == first.name:
            continue
        fit = one.common or next(w for w in one.own if w is not None)
        # On the scale of the cause that is named: what all boards together lose by it.
        rival = replace(
            fit,
            won=best.won + one.won - first.won,
            evidence=best.evidence + one.evidence - first.evidence,
        )
        before = shares.get(one.name, (rival, 0.0))
        shares[one.name] = before[0], before[1] + float(share)
    rivals = tuple(sorted(shares.values(), key=lambda pair: -pair[1]))
    posterior = 1.0 - sum(share for _, share in rivals)
    return Standing(best, first.looks, rivals, posterior, None if here is None else here.won)


def _weak(boards: Sequence[_Board]) -> None:
    """Name what no board shows alone but all of them together do; as the unit's only."""
    for _ in range(MOST_WEAK):
        besides = [board.beside(None) for board in boards]
        together = Together(besides)
        terms = testable(together)
        taken = {label(e.term) for b in boards for e in b.solution.extensions}
        free = [t for t in terms if label(t) not in taken]
        units = [t for t in free if owner(t) != "board"]
        tests = tests_of(units)
        seen = [s for s in sights(together, units, tests) if s.p_value < ALPHA]
        if not seen:
            return
        leading = {label(s.term): s.term for s in seen[:CONTENDERS]}
        like = siblings(seen[0].term, free)
        leading |= {label(t): t for t in free if label(t) in like}
        found = [one for term in leading.values() for one in weigh(besides, term, tests)]
        found.sort(key=lambda one: -one.evidence)
        best = found[0].common if found else None
        if best is None or by_chance(best, found[0].looks, tests) > ALPHA:
            return
        _shared(boards, besides, {}, found)


def _own(boards: Sequence[_Board]) -> None:
    """Say of what is left that it is the boards' own, and how many have it."""
    names = [[label(one.term) for one, _ in board.fitted()] for board in boards]
    for board, own in zip(boards, names, strict=True):
        for name in own:
            many = sum(name in other for other in names)
            board.whose.setdefault(name, Whose("board", many, len(boards), None))
