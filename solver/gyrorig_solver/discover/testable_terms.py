"""The causes that a residual can be tested for.

What to use when: `testable_terms` for the catalogue, `select_testable` for other causes,
`testable_instances` for one.
"""

from collections.abc import Iterable, Sequence, Set

from gyrorig_solver.discover.score_tests import testable_places
from gyrorig_solver.estimate import NuisanceProjector
from gyrorig_solver.model import (
    Term,
    form_for,
    limit_to_recording,
    occurrence_after,
    why_not_computable,
    why_not_testable,
)
from gyrorig_solver.model.catalogue import catalogue


def testable_terms(projection: NuisanceProjector) -> list[Term]:
    """Return the testable causes of the catalogue; see `select_testable`."""
    return select_testable(catalogue().values(), projection)


def select_testable(causes: Iterable[Term], projection: NuisanceProjector) -> list[Term]:
    """Return the testable causes, without those that are equal to another one to first order.

    Args:
        causes: some causes.
        projection: the nuisance projector at a fit.
    """
    return [
        instance
        for term in causes
        if not term.first_order_equivalent
        for instance in testable_instances(term, projection)
    ]


def testable_instances(term: Term, projection: NuisanceProjector) -> list[Term]:
    """Return a cause if it is testable, once per recording if its scope is the recording.

    The cause has its form for the projection's recordings.
    """
    return [
        instance
        for instance in acting_instances(form_of(term, projection), projection)
        if why_not_testable(instance, projection.states) is None
    ]


def form_of(term: Term, projection: NuisanceProjector) -> Term:
    """Return the form of a cause for the recordings of a projection."""
    return form_for(term, any(state.low_pass is not None for state in projection.states))


def acting_instances(term: Term, projection: NuisanceProjector) -> list[Term]:
    """Return a cause that can act, testable or not, once per recording if that is its scope."""
    recording_numbers = sorted({scene.context.recording_index for scene in projection.states})
    per_recording = term.scope == "recording" and len(recording_numbers) > 1
    instances = (
        [limit_to_recording(term, number) for number in recording_numbers]
        if per_recording
        else [term]
    )
    return [
        instance
        for instance in instances
        if instance.kind == "effect" and why_not_computable(instance, projection.states) is None
    ]


def terms_not_fitted(terms: Sequence[Term], fitted_labels: Set[str]) -> list[Term]:
    """Return the causes that a fit lacks; of a cause that can recur, its next occurrence."""
    others = (occurrence_after(term, fitted_labels) for term in terms)
    return [term for term in others if term is not None]


def count_tests(terms: Sequence[Term]) -> int:
    """Return the number of tests that share the false-alarm rate."""
    return sum(len(testable_places(term)) for term in terms)
