"""The fit of a leading candidate together with a second cause.

If two causes act at the same times, for example at starts and stops, the fit with one of them has a
large misfit and may not converge, although the fit with both does. The end of the failed fit shows
the second cause, because the first one explains most of the residual there.

What to use when: `fit_pair` after the fit of a candidate that did not converge.
"""

from collections.abc import Sequence, Set

from gyrorig_solver.discover.fit_space import FitSpace, Space
from gyrorig_solver.discover.score_tests import FALSE_ALARM_RATE, scan_catalogue
from gyrorig_solver.discover.testable_terms import terms_not_fitted
from gyrorig_solver.estimate import FittedTerm, free_term
from gyrorig_solver.model import Term, term_label, value_indices, value_parameters


def fit_pair(
    space: Space,
    failed: Space,
    extension: FittedTerm,
    terms: Sequence[Term],
    left_out: Set[str],
    tests: int,
) -> Space | None:
    """Return a fit with a candidate and a second cause; None if there is no such fit.

    Args:
        space: the fit without the candidate.
        failed: the fit with the candidate, which did not converge.
        extension: the candidate.
        terms: all causes.
        left_out: causes that are not tried.
        tests: how many share the false alarms.
    """
    second = _find_second(failed, terms, left_out, tests)
    if second is None:
        return None
    # The best size of one cause can be far from its size with the other. It starts at zero.
    first = extension if _has_shape(extension.term) else free_term(extension.term)
    pair = space.refit([*space.fitted_terms, first, free_term(second)])
    return pair if pair.convergence.converged else None


def _find_second(
    failed: FitSpace, terms: Sequence[Term], left_out: Set[str], tests: int
) -> Term | None:
    """Return the cause with the best score at the end of a fit.

    A cause with a shape or an event has no start value, so it is not tried.
    """
    usable = [
        term
        for term in terms_not_fitted(terms, failed.labels)
        if term_label(term) not in left_out and not _has_shape(term)
    ]
    scores = scan_catalogue(failed.projector(typical=True), usable, tests)
    best = max(scores, key=lambda score: score.score_test.excess, default=None)
    return None if best is None or best.p_value > FALSE_ALARM_RATE else best.term


def _has_shape(term: Term) -> bool:
    return len(value_indices(term, role="size")) < len(value_parameters(term))
