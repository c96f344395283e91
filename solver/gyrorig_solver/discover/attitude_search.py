"""The search beside reference attitudes: a pass over all causes, the leading ones fitted.

What to use when: `search_beside` a space; each `Standing` has what else was weighed.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.chance import chi2_tail
from gyrorig_solver.discover.attitude_gain import gains
from gyrorig_solver.discover.refit import Weighed, refit
from gyrorig_solver.discover.scores import Sight, sights
from gyrorig_solver.discover.search import ALPHA, best_fit, siblings
from gyrorig_solver.estimate.attitude_space import AttitudeSpace
from gyrorig_solver.model.terms.bound import label
from gyrorig_solver.model.terms.protocol import Term

CONTENDERS = 5  # fitted exactly at a time
MOST_CAUSES = 6
SWEEPS = 3  # in which every named cause is fitted anew beside the others


@dataclass(frozen=True, slots=True, eq=False)
class Standing:
    """A cause fitted beside all others, with what else was weighed in its place."""

    best: Weighed
    looks: float
    rivals: tuple[tuple[Weighed, float], ...]
    posterior: float


def search_beside(space: AttitudeSpace, terms: Sequence[Term], tests: int) -> list[Standing]:
    """Return the causes that a residual shows, each fitted beside all others.

    Args:
        space: beside the base model's fit.
        terms: to look for.
        tests: how many of them share the false alarms.
    """
    named: list[Standing] = []
    barred: set[str] = set()
    while len(named) < MOST_CAUSES:
        taken = {label(one.best.extension.term) for one in named}
        there = space.with_causes([one.best.extension for one in named])
        usable = [t for t in terms if label(t) not in taken | barred]
        found = sights(there, usable, tests)
        best = _leading(there, found, tests, usable)
        if best is None:
            break
        trial = _again(space, [*named, best], terms, tests)
        kept = [one for one in trial if _worth(space, trial, one) and _sure(one, tests)]
        if len(kept) < len(trial):
            gone = {label(one.best.extension.term) for one in trial if one not in kept}
            barred |= gone
            if label(best.best.extension.term) in gone:
                continue  # the others stand as they were
            trial = _again(space, kept, terms, tests)
        named = trial
    return named


def _leading(
    space: AttitudeSpace, found: Sequence[Sight], tests: int, terms: Sequence[Term]
) -> Standing | None:
    """Return the cause of most evidence among the leading ones and their siblings."""
    strength: dict[str, float] = {}
    for s in found:
        if s.p_value < ALPHA:
            seen = s.seen.statistic - s.seen.degrees_of_freedom
            strength[label(s.term)] = max(strength.get(label(s.term), -np.inf), seen)
    order = sorted(strength, key=lambda cause: -strength[cause])[:CONTENDERS]
    if not order:
        return None
    by_cause = {label(term): term for term in terms}
    alike = set().union(*(siblings(by_cause[c], terms) for c in order[:1]))
    order += [c for c in sorted(alike) if c in by_cause and c not in order]
    weighed = []
    for cause in order:
        fitted = best_fit(space, [s for s in found if label(s.term) == cause])
        if fitted is not None:
            weighed.append(fitted)
    weighed.sort(key=lambda pair: -pair[0].evidence)
    for k, (one, looks) in enumerate(weighed):
        if p_value(one, looks, tests) < ALPHA:
            return _stand(one, looks, [w for j, (w, _) in enumerate(weighed) if j != k])
    return None


def _again(
    space: AttitudeSpace, named: Sequence[Standing], terms: Sequence[Term], tests: int
) -> list[Standing]:
    """Fit each cause anew beside all others, its siblings in its place too."""
    found = list(named)
    by_cause = {label(term): term for term in terms}
    for sweep in range(SWEEPS if len(found) > 1 else 1):
        for k, one in enumerate(found):
            others = [f.best.extension for j, f in enumerate(found) if j != k]
            beside = space.with_causes(others)
            own = one.best.extension
            again = refit(beside, own.term, one.best.place, [own.values])
            if again is None:
                continue
            rivals = [r for r, _ in one.rivals]
            if sweep == 0:
                taken = {label(e.term) for e in others} | {label(own.term)}
                like = sorted(siblings(own.term, terms) - taken)
                near = sights(beside, [by_cause[c] for c in like if c in by_cause], tests)
                fitted = [best_fit(beside, [s for s in near if label(s.term) == c]) for c in like]
                old = [r for r in rivals if label(r.extension.term) not in {*like, *taken}]
                again_old = [
                    refit(beside, r.extension.term, r.place, [r.extension.values]) for r in old
                ]
                rivals = [f[0] for f in fitted if f is not None]
                rivals += [r for r in again_old if r is not None and not r.impossible]
            found[k] = _stand(again, one.looks, rivals)
    return found


def _stand(best: Weighed, looks: float, rivals: Sequence[Weighed]) -> Standing:
    evidence = np.array([best.evidence, *(one.evidence for one in rivals)])
    belief = np.exp(evidence - evidence.max())
    belief /= belief.sum()
    order = np.argsort(-evidence[1:], kind="stable")
    ranked = tuple((rivals[j], float(belief[1 + j])) for j in order)
    return Standing(best, looks, ranked, float(belief[0]))


def p_value(one: Weighed, looks: float, tests: int) -> float:
    """Return how likely chance alone wins as much, scans and tests counted."""
    free = one.extension.free.size
    return min(1.0, chi2_tail(2.0 * max(one.won, 0.0), free) * looks * tests)


def _sure(one: Standing, tests: int) -> bool:
    return not one.best.impossible and p_value(one.best, one.looks, tests) < ALPHA


def _worth(space: AttitudeSpace, named: Sequence[Standing], one: Standing) -> bool:
    """Return whether leaving a cause out loses on data that were left out."""
    last = space.with_causes([n.best.extension for n in named])
    _, each = gains(last)
    return each is None or each[list(named).index(one)].log_likelihood.value > 0.0
