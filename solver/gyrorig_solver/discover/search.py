"""The search: what is significant is named and fitted, one cause after the other.

Forward: all causes are scored, the best few and what they are confused with are fitted
exactly, and the one with the most evidence is taken into the real fit; until nothing is
significant. Backward: a cause that the others have made needless is dropped. In the end
each is weighed once more against all others, all else fitted, and may lose its place.

What to use when: `search` for all of it; `standing` for one cause against its rivals.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.chance import chi2_tail
from gyrorig_solver.discover.banks import all_rows
from gyrorig_solver.discover.confirm import confirmed
from gyrorig_solver.discover.refit import Weighed, refit
from gyrorig_solver.discover.regain import regained
from gyrorig_solver.discover.scores import Sight, sights, where
from gyrorig_solver.discover.wandering import beside, is_calm, log_evidence, log_likelihood
from gyrorig_solver.estimate.extension import Extension
from gyrorig_solver.estimate.likelihood import Solution, solve_again
from gyrorig_solver.estimate.projection import Projection
from gyrorig_solver.model.terms.bound import bound, label, recording_of
from gyrorig_solver.model.terms.catalogue import catalogue
from gyrorig_solver.model.terms.protocol import Term, indices, value_parameters

# Share of recordings without any cause that may get a name. The tests overlap: 157 such
# recordings had three quarters of the false names that their sum allows. A little is left to
# the nameless groups, which have to see only what is large and no cause of the catalogue.
ALPHA = 0.0075
CONTENDERS = 4  # fitted exactly at a time
HOPELESS = 0.2  # of the leading statistic: a cause that sees less is not fitted
NEAR = 25.0  # a place alone this much below all places together is not fitted alone,
LITTLE = 3.0  # and all together not where they see no more than this beyond the best one
MOST_CAUSES = 12
EQUAL = {"tilt_sag": ("eccentricity",)}  # on tilt the same function of its angle
STATED = 0.95  # belief that the stated set holds the cause
MOST_DOUBTS = 3  # causes that calmed levels alone make significant: the bias does wander
SWAPS = 4  # times that named causes may lose their place in the end
CLEARLY = 1.0  # nats of evidence that a rival must be ahead by
# Share of a cause's statistic: twice what its form may leave of its effect without any noise
# (discovery notes, section 0, item 7: 0.2 %).
UNTRUE = 0.004
STOOD_FOR = {"lost_samples": "clock_step"}  # the same for small sizes: looked at once


@dataclass(frozen=True, slots=True, eq=False)
class Standing:
    """A cause against its rivals, all other causes fitted."""

    best: Weighed
    looks: float
    rivals: tuple[tuple[Weighed, float], ...]  # other causes and their posterior
    posterior: float
    here: float | None = None  # nats won on this board, where several share it

    def worth(self, real: Mapping[str, float]) -> "Standing":
        """Return it with no more won than a fit without it loses, where that is known."""
        nats = real.get(label(self.best.extension.term), np.inf)
        return self if nats >= self.best.won else replace(self, best=replace(self.best, won=nats))

    @property
    def one_of(self) -> tuple[str, ...]:
        """The other causes of the stated set."""
        names, total = [], self.posterior
        for rival, share in self.rivals:
            if total >= STATED:
                break
            names.append(rival.extension.term.cause)
            total += share
        same = EQUAL.get(self.best.extension.term.cause, ())
        return (*names, *(name for name in same if name not in names))


@dataclass(frozen=True, slots=True, eq=False)
class Doubt:
    """A cause that calmed levels alone make significant: the bias may wander instead."""

    weighed: Weighed
    looks: float
    rise: float  # nats of the likelihood, levels found beside it against levels without it
    evidence: float  # of it beside a calm bias, against a bias that wanders without it

    @classmethod
    def of(cls, best: "_Best", before: Solution, after: Solution) -> "Doubt":
        """Weigh a cause against a bias that wanders."""
        one = best.weighed
        freedom = one.won - one.evidence
        rise = log_likelihood(after) - log_likelihood(before)
        evidence = log_evidence(after, calm=True) - log_evidence(before) - freedom
        return cls(one, best.looks, rise, evidence)


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """Where a search ended."""

    solution: Solution
    standings: tuple[Standing, ...]  # of each extension of the fit, in their order
    last: Projection
    sights: tuple[Sight, ...]  # of what is left
    doubts: tuple[Doubt, ...] = ()  # where the bias was found to wander


def testable(projection: Projection) -> list[Term]:
    """Return the causes that can be looked at, those that others stand for left out."""
    every = [t for t in catalogue().values() if t.cause not in STOOD_FOR]
    return [one for term in every for one in possible(term, projection)]


def possible(term: Term, projection: Projection) -> list[Term]:
    """Return a cause if it can be looked at, one for each recording if it is a recording's."""
    numbers = sorted({scene.setting.number for scene in projection.scenes})
    apart = term.scope == "recording" and len(numbers) > 1
    return [
        one
        for one in ([bound(term, number) for number in numbers] if apart else [term])
        if one.kind == "effect" and all(one.missing(scene) is None for scene in projection.scenes)
    ]


def tests_of(terms: Sequence[Term]) -> int:
    """Return how many tests share the false alarms."""
    return sum(len(where(term)) for term in terms)


def search(base: Solution) -> Found:
    """Name the causes of a fit's residual and fit them."""
    known = tuple(one for one in base.extensions if not one.free.size)
    solution, calm = base, True
    projection = beside(solution, calm)
    terms = testable(projection)
    tests = tests_of(terms)
    found: list[Sight] = []
    seen: Projection | None = None  # what `found` is of
    barred: set[str] = set()
    doubted: set[str] = set()
    doubts: list[Doubt] = []
    fitted: dict[str, set[str]] = {}
    worth: Mapping[str, float] = {}
    while True:
        taken = {label(one.term) for one in solution.extensions}
        if seen is not projection:
            found = sights(projection, [t for t in terms if label(t) not in taken], tests)
            seen = projection
        usable = [s for s in found if label(s.term) not in barred | doubted]
        best = _next(projection, usable, taken, tests)
        if best is None or len(taken) >= MOST_CAUSES:
            if calm and doubted:  # a bias that does wander: once more, as it does
                calm, doubted = False, set()
                projection = beside(solution, calm)
                continue
            real = confirmed(solution, known, tests, ALPHA)
            solution, worth = real.solution, real.won
            if not real.refused - barred:
                break
            barred |= real.refused
            projection = beside(solution, calm)
            continue
        cause, after, doubt = _taken_in(solution, best)
        if calm and not _likelier(solution, doubt, tests):
            doubted.add(cause)
            doubts.append(doubt)
            if len(doubted) == MOST_DOUBTS:
                calm, doubted = False, set()
                projection = beside(solution, calm)
            continue
        fitted.setdefault(cause, set()).update(best.beside)
        after = _without_needless(after, known, tests)
        causes = {label(one.term) for one in after.extensions}
        if causes <= taken:  # it could not stay: not again
            barred.add(cause)
        solution = after
        projection = beside(solution, calm)
    solution, standings = _reviewed(solution, terms, tests, fitted, worth)
    as_it_is = not standings and (not calm or is_calm(solution))
    last = projection if as_it_is else beside(solution, calm=False)
    return Found(solution, standings, last, tuple(found), tuple(doubts))


@dataclass(frozen=True, slots=True, eq=False)
class _Best:
    """The cause with the most evidence in one round."""

    weighed: Weighed
    looks: float
    beside: frozenset[str]  # all that were weighed


def _next(
    projection: Projection, found: Sequence[Sight], taken: set[str], tests: int
) -> _Best | None:
    """Return the cause with the most evidence, None if none is significant."""
    significant = [s for s in found if s.p_value < ALPHA]
    if not significant:
        return None
    weighed = _contenders(projection, significant, found, taken, tests)
    for one, looks in sorted(weighed, key=lambda pair: -pair[0].evidence):
        if by_chance(one, looks, tests) < ALPHA:
            return _Best(one, looks, frozenset(label(w.extension.term) for w, _ in weighed))
    return None


def _taken_in(solution: Solution, best: _Best) -> tuple[str, Solution, Doubt]:
    """Return a cause's label, the fit with it, and what speaks against it."""
    after = _timed_anew(_with(solution, best.weighed.extension))
    return label(best.weighed.extension.term), after, Doubt.of(best, solution, after)


def _likelier(before: Solution, doubt: Doubt, tests: int) -> bool:
    """Return whether a cause that was found with calmed levels is one with those found anew.

    It stays if the likelihood rises by as much when the levels are found beside it: a bias
    that does wander does not become likelier by a step. Or if it wins as much by the levels
    that were found without it: those are taken from the rests where there are enough, and
    know nothing of what shows at the edges of moves, which no wandering bias makes.
    """
    if is_calm(before):
        return True
    one = doubt.weighed
    if by_chance(replace(one, won=doubt.rise), doubt.looks, tests) < ALPHA:
        return True
    row = one.extension.values
    found = refit(Projection.of(before), one.extension.term, one.place, [row])
    return found is not None and by_chance(found, doubt.looks, tests) < ALPHA


def by_chance(one: Weighed, looks: float, tests: int) -> float:
    """Return how likely noise alone lets a cause win as much somewhere, at most 1.

    Shapes are not counted as degrees of freedom: the looks along them are.
    """
    sizes = sum(1 for k in one.extension.free if k in indices(one.extension.term, role="size"))
    return min(1.0, chi2_tail(2.0 * max(one.won, 0.0), sizes) * looks * tests)


def _contenders(
    projection: Projection,
    leading: Sequence[Sight],
    found: Sequence[Sight],
    taken: set[str],
    tests: int,
) -> list[tuple[Weighed, float]]:
    """Return the leading causes and their siblings, each at its best place, fitted."""
    strength: dict[str, float] = {}
    of: dict[str, Term] = {}
    for s in leading:
        seen, name = s.seen.statistic - s.seen.degrees_of_freedom, label(s.term)
        strength[name] = max(strength.get(name, -np.inf), seen)
        of[name] = s.term
    order = sorted(strength, key=lambda name: -strength[name])[:CONTENDERS]
    hopeless = HOPELESS * strength[order[0]]
    terms = [of[c] for k, c in enumerate(order) if k < 2 or strength[c] > hopeless]
    # What others stand for in the pass over all takes part where they do.
    terms += [
        one
        for cause, other in STOOD_FOR.items()
        for term in terms
        if term.cause == other
        for one in possible(catalogue()[cause], projection)
        if recording_of(one) == recording_of(term) and one not in terms
    ]
    weighed = []
    for term in terms:
        if label(term) in taken:
            continue
        own = [s for s in found if label(s.term) == label(term)]
        own = own or sights(projection, [term], tests, all_rows(projection, term))
        best = best_fit(projection, own)
        if best is not None:
            weighed.append(best)
    return weighed


def best_fit(projection: Projection, own: Sequence[Sight]) -> tuple[Weighed, float] | None:
    """Fit one cause at each of its promising places; return the one of most evidence."""
    most = max((s.seen.statistic for s in own), default=0.0)
    alone = max((s.seen.statistic for s in own if s.place is not None), default=-np.inf)
    best: tuple[Weighed, float] | None = None
    for s in own:
        if s.place is not None and s.seen.statistic < most - NEAR:
            continue
        if s.place is None and s.seen.statistic < alone + LITTLE:
            continue
        one = refit(projection, s.term, s.place, [s.row])
        if one is None or one.impossible:
            continue
        if best is None or one.evidence > best[0].evidence:
            best = one, s.looks
    return best


def _with(solution: Solution, one: Extension) -> Solution:
    """Return the fit with one cause more; with its shapes held where they do not settle."""
    others = solution.extensions
    after = solve_again(solution, [*others, one])
    sizes = [k for k in one.free if value_parameters(one.term)[k].role == "size"]
    if not after.converged and len(sizes) < one.free.size:
        held = replace(one, free=np.array(sizes, dtype=np.int64))
        after = solve_again(solution, [*others, held])
    # What was a spike beside the model before may be none beside this one.
    return regained(solve_again(after, after.extensions) if after.outliers else after)


def _timed_anew(solution: Solution) -> Solution:
    """Return the fit with each event where it is now best.

    An event is found when other causes are still to come, and beside a base model that what
    it did has bent; what its time is off by then, later ones would have to fill.
    """
    causes = list(solution.extensions)
    moved = False
    for k, one in enumerate(causes):
        if not one.free.size or not indices(one.term, role="event"):
            continue
        others = [other for j, other in enumerate(solution.extensions) if j != k]
        beside_it = Projection.of(solution, extensions=others, back=[one])
        again = refit(beside_it, one.term, _place_of(one), [one.values], about=True)
        if again is not None and not again.impossible:
            causes[k] = replace(one, values=again.extension.values)
            moved = True
    return solve_again(solution, causes) if moved else solution


def _without_needless(solution: Solution, known: tuple[Extension, ...], tests: int) -> Solution:
    """Return the fit without causes that are not significant beside the others."""
    while True:
        judged = [
            (size_p_value(solution, k), k)
            for k, one in enumerate(solution.extensions)
            if one not in known
        ]
        weak = [(p, k) for p, k in judged if p * tests > ALPHA]
        if not weak:
            return solution
        drop = max(weak)[1]
        left = [one for k, one in enumerate(solution.extensions) if k != drop]
        solution = solve_again(solution, left)


def size_p_value(solution: Solution, k: int) -> float:
    """Return how likely chance alone gives a cause of the fit sizes like its own."""
    one = solution.extensions[k]
    first = solution.estimate.size - sum(e.free.size for e in solution.extensions)
    first += sum(e.free.size for e in solution.extensions[:k])
    at = [first + j for j, index in enumerate(one.free) if index in indices(one.term, role="size")]
    if not at:
        return 0.0
    value = solution.estimate[at]
    covariance = solution.decision.covariance[np.ix_(at, at)]
    seen = np.diag(covariance) > 0.0
    if not seen.any():
        return 1.0
    some = np.flatnonzero(seen)
    inverse = np.linalg.pinv(covariance[np.ix_(some, some)], hermitian=True)
    return chi2_tail(float(value[some] @ inverse @ value[some]), some.size)


def _reviewed(
    solution: Solution,
    terms: Sequence[Term],
    tests: int,
    fitted: Mapping[str, set[str]],
    worth: Mapping[str, float],
) -> tuple[Solution, tuple[Standing, ...]]:
    """Weigh each cause against all others, all else fitted; let the better ones in.

    `worth`: what a fit without a cause loses, in nats, where that is known.
    """
    for swap in range(SWAPS + 1):
        standings, better = [], None
        for k, one in enumerate(solution.extensions):
            if not one.free.size:
                continue
            like = fitted.get(label(one.term), set()) | siblings(one.term, terms)
            near = [t for t in terms if label(t) in like or label(t) == label(one.term)]
            standing = standing_of(solution, k, near, tests)
            standings.append(standing)
            ahead = standing.rivals and standing.rivals[0][0].evidence - standing.best.evidence
            if better is None and ahead and ahead > CLEARLY:
                better = k, standing.rivals[0][0].extension
        if better is None or swap == SWAPS:
            return solution, tuple(one.worth(worth) for one in standings)
        k, other = better
        left = [one for j, one in enumerate(solution.extensions) if j != k]
        solution = _with(solve_again(solution, left), other)
    return solution, ()


def siblings(term: Term, terms: Sequence[Term]) -> set[str]:
    """Return the causes that a cause is taken for, or that are taken for it, as labelled."""
    own = recording_of(term)
    return {
        label(t)
        for t in terms
        if (t.cause in term.confused_with or term.cause in t.confused_with)
        and (own is None or recording_of(t) in (None, own))
    }


def standing_of(solution: Solution, k: int, terms: Sequence[Term], tests: int) -> Standing:
    """Weigh one cause of a fit against what might be in its place.

    Args:
        solution: the fit.
        k: which of its causes.
        terms: those that might, itself among them.
        tests: how many share the false alarms.
    """
    one = solution.extensions[k]
    others = [e for j, e in enumerate(solution.extensions) if j != k]
    beside = Projection.of(solution, extensions=others, back=[one])
    taken = {label(e.term) for e in others}
    found = sights(beside, [t for t in terms if label(t) not in taken], tests)
    weighed = _contenders(beside, found, found, taken, tests)
    own = [(w, looks) for w, looks in weighed if label(w.extension.term) == label(one.term)]
    place = _place_of(one)
    again = refit(beside, one.term, place, [one.values], about=True)
    if again is not None and (not own or again.evidence > own[0][0].evidence):
        own = [(again, own[0][1] if own else 1.0)]
    rest = [w for w, _ in weighed if label(w.extension.term) != label(one.term)]
    evidence = np.array([own[0][0].evidence, *(w.evidence for w in rest)])
    belief = belief_in(evidence, own[0][0].won)
    order = np.argsort(-evidence[1:], kind="stable")
    rivals = tuple((rest[j], float(belief[1 + j])) for j in order)
    return Standing(own[0][0], own[0][1], rivals, float(belief[0]))


def belief_in(evidence: FloatArray, won: float) -> FloatArray:
    """Return how likely each of some causes is, no form being truer than it is.

    What a rival leaves of a large effect may be what the right form leaves as well, so the
    likelihood counts for less the more there is of it. A small effect is judged by noise
    alone: the two errors, a nat of noise's and the share that forms are untrue by, are
    independent and add in squares.

    Source: after the coarsened posterior; Miller and Dunson, J. Am. Statist. Assoc. 114
    (2019) 1113.

    Args:
        evidence: of each, nats, the named one's first.
        won: by the named one, nats.
    """
    belief = np.exp((evidence - evidence.max()) / np.hypot(1.0, UNTRUE * won))
    return np.asarray(belief / belief.sum(), dtype=np.float64)


def _place_of(one: Extension) -> str | None:
    """Return the place whose sizes alone are fitted, None for all."""
    sizes: FloatArray = np.array([k for k in one.free if k in indices(one.term, role="size")])
    for place, _ in where(one.term):
        if place is not None and indices(one.term, place, "size") == sizes.tolist():
            return place
    return None
