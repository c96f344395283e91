"""The fit of a leading candidate together with a second cause.

If two causes act at the same times, for example at starts and stops, the fit with one of them has a
large misfit and may not converge, although the fit with both does. The end of the failed fit shows
the second cause, because the first one explains most of the residual there.

What to use when: `fit_pair` after the fit of a candidate that did not converge.
"""

from collections.abc import Sequence

from gyrorig_solver.discover.fit_space import Space
from gyrorig_solver.discover.score_tests import FALSE_ALARM_RATE, scan_catalogue
from gyrorig_solver.estimate import FittedTerm, NuisanceProjector, free_term
from gyrorig_solver.model import Term, value_indices, value_parameters


def fit_pair(
    space: Space,
    extension: FittedTerm,
    projection: NuisanceProjector,
    terms: Sequence[Term],
    tests: int,
) -> Space | None:
    """Return a fit with a candidate and a second cause; None if there is no such fit.

    Args:
        space: the fit without the candidate.
        extension: the candidate.
        projection: the nuisance projector at the end of the failed fit with the candidate.
        terms: the second causes to try.
        tests: how many share the false alarms.
    """
    second = _best_scored(projection, terms, tests)
    if second is None:
        return None
    # The best size of the candidate alone can be far from its size with the second cause. Such a
    # start can end at another optimum, so both sizes start at zero.
    first = extension if _has_shape(extension.term) else free_term(extension.term)
    pair = space.refit([*space.fitted_terms, first, free_term(second)])
    return pair if pair.convergence.converged else None


def _best_scored(projection: NuisanceProjector, terms: Sequence[Term], tests: int) -> Term | None:
    """Return the significant cause with the best score.

    A cause with a shape or an event has no start value, so it is not tried.
    """
    scores = scan_catalogue(projection, [term for term in terms if not _has_shape(term)], tests)
    best = max(scores, key=lambda score: score.score_test.excess, default=None)
    return None if best is None or best.p_value > FALSE_ALARM_RATE else best.term


def _has_shape(term: Term) -> bool:
    """Return whether a cause has values that are not sizes."""
    return len(value_indices(term, role="size")) < len(value_parameters(term))
