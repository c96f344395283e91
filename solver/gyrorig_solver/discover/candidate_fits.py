"""Exact fits of the leading candidates of a score scan, each at its best place.

What to use when: `fit_leading` for the causes with the best scores, `fit_best_place` for one.
"""

from collections.abc import Callable, Mapping, Sequence, Set

import numpy as np

from gyrorig_solver.discover.exact_fit import FittedCandidate, fit_candidate
from gyrorig_solver.discover.lag_series import LagSeries
from gyrorig_solver.discover.score_tests import (
    FALSE_ALARM_RATE,
    CandidateScore,
    scan_catalogue,
    testable_places,
)
from gyrorig_solver.discover.template_choice import all_templates
from gyrorig_solver.discover.testable_terms import testable_instances
from gyrorig_solver.estimate import FittedTerm, NuisanceProjector
from gyrorig_solver.model import Term, recording_index_of, term_label, value_indices
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.numerics import chi2_upper_tail

MAX_CANDIDATES = 4  # fitted exactly at a time
MIN_STATISTIC_SHARE = 0.2  # of the leading statistic; causes with less are not fitted
PLACE_MARGIN = 25.0  # a single place is not fitted if its statistic is this much below the best
MAX_RESIDUAL_VALUES = 500_000  # for the lag by time, whose windows need memory
JOINT_MARGIN = 3.0  # all places together are fitted only with this lead over the best single one


def fit_leading(
    projection: NuisanceProjector,
    leading: Sequence[CandidateScore],
    scores: Sequence[CandidateScore],
    left_out: Set[str],
    tests: int,
    fit_law: Callable[[Term, float], FittedCandidate | None],
) -> list[tuple[FittedCandidate, float]]:
    """Fit the causes with the best scores and their confusable causes, each at its best place.

    A cause that changes the motion law is fitted if its p-value is below 1, because its first-order
    score does not predict its gain.

    Args:
        projection: the nuisance projector at the fit.
        leading: the scores from which the causes are taken.
        scores: of all places of all causes.
        left_out: causes that are not tried, for example those of the fit.
        tests: how many share the false alarms.
        fit_law: fits a cause that changes the motion law under its own law. Its second argument is
            the evidence that the cause needs to be the best one.

    Returns:
        Each fitted cause with the effective number of its trials.
    """
    strength = _strength_by_label(leading)
    term_by_label = {term_label(score.term): score.term for score in leading}
    threshold = MIN_STATISTIC_SHARE * max(strength.values())
    terms = [term_by_label[label] for label in _strongest(strength)]
    law_terms = {
        label: term
        for label, term in term_by_label.items()
        if label not in left_out and projection.law_statistics(term) is not None
    }
    shown = {term_label(score.term) for score in leading if score.p_value < 1.0}
    terms = [term for term in terms if term not in law_terms.values()]
    # Add causes that the scan of the catalogue left out because a chosen cause represents them.
    terms += [
        instance
        for equivalent in catalogue().values()
        for term in terms
        if term.cause == equivalent.first_order_equivalent
        for instance in testable_instances(equivalent, projection)
        if recording_index_of(instance) == recording_index_of(term) and instance not in terms
        if equivalent.template_search != "lag_series"
    ]
    # The lag by time shows an error of a clock that no single step resembles.
    if is_lag_significant(projection, tests):
        terms += lag_series_terms(projection)
    candidates: list[tuple[FittedCandidate, float]] = []
    for term in terms:
        if term_label(term) in left_out:
            continue
        term_scores = [score for score in scores if term_label(score.term) == term_label(term)]
        term_scores = term_scores or scan_catalogue(
            projection, [term], tests, all_templates(projection, term)
        )
        if _is_much_weaker(term, term_scores, threshold):
            continue
        fitted = fit_best_place(projection, term_scores)
        if fitted is not None:
            candidates.append(fitted)
    needed_nats = max(
        (
            candidate.log_evidence
            for candidate, trials in candidates
            if global_p_value(candidate, trials, tests) < FALSE_ALARM_RATE
        ),
        default=-np.inf,
    )
    for label, term in law_terms.items():
        law = fit_law(term, needed_nats) if label in shown else None
        if law is not None:
            candidates.append((law, 1.0))
            needed_nats = max(needed_nats, law.log_evidence)
    return candidates


def leading_labels(scores: Sequence[CandidateScore]) -> frozenset[str]:
    """Return the labels of the causes with the best scores, which `fit_leading` fits."""
    return frozenset(_strongest(_strength_by_label(scores)))


def _strength_by_label(scores: Sequence[CandidateScore]) -> dict[str, float]:
    """Return by how much the best score of each cause exceeds its degrees of freedom."""
    strength: dict[str, float] = {}
    for score in scores:
        label = term_label(score.term)
        strength[label] = max(strength.get(label, -np.inf), score.score_test.excess)
    return strength


def _strongest(strength: Mapping[str, float]) -> list[str]:
    """Return the labels of the two strongest causes, and of others that are not much weaker."""
    order = sorted(strength, key=lambda label: -strength[label])[:MAX_CANDIDATES]
    threshold = MIN_STATISTIC_SHARE * strength[order[0]]
    return [label for k, label in enumerate(order) if k < 2 or strength[label] > threshold]


def _is_much_weaker(term: Term, scores: Sequence[CandidateScore], threshold: float) -> bool:
    """Return whether a lag by time has too small a statistic, because its fit is expensive."""
    strength = max((score.score_test.excess for score in scores), default=-np.inf)
    return term.template_search == "lag_series" and strength < threshold


def is_lag_significant(projection: NuisanceProjector, tests: int) -> bool:
    """Return whether the lag changes with time; False if the recording is too long for the test."""
    if projection.residual.size > MAX_RESIDUAL_VALUES:
        return False
    return LagSeries.at(projection).p_value * tests < FALSE_ALARM_RATE


def lag_series_terms(projection: NuisanceProjector) -> list[Term]:
    """Return the causes whose templates are compared with the lag by time."""
    return [
        instance
        for term in catalogue().values()
        if term.template_search == "lag_series"
        for instance in testable_instances(term, projection)
    ]


def fit_best_place(
    projection: NuisanceProjector, scores: Sequence[CandidateScore], with_infeasible: bool = False
) -> tuple[FittedCandidate, float] | None:
    """Fit one cause at each promising place; return the fit with the most evidence.

    `with_infeasible`: also accept fits whose best values are outside their ranges.
    """
    best_statistic = max((score.score_test.statistic for score in scores), default=0.0)
    best_separate = max(
        (score.score_test.statistic for score in scores if score.place is not None), default=-np.inf
    )
    best: tuple[FittedCandidate, float] | None = None
    for score in scores:
        if score.place is not None and score.score_test.statistic < best_statistic - PLACE_MARGIN:
            continue
        if score.place is None and score.score_test.statistic < best_separate + JOINT_MARGIN:
            continue
        candidate = fit_candidate(projection, score.term, score.place, [score.template])
        if candidate is None or (candidate.infeasible and not with_infeasible):
            continue
        if best is None or candidate.log_evidence > best[0].log_evidence:
            best = candidate, score.effective_trials
    return best


def global_p_value(candidate: FittedCandidate, effective_trials: float, tests: int) -> float:
    """Return the global p-value of a candidate, with all scanned templates and tests counted.

    Only the sizes are degrees of freedom; the trials account for the scanned shapes.
    """
    sizes = len(candidate.extension.free_sizes)
    local = chi2_upper_tail(2.0 * max(candidate.delta_log_likelihood, 0.0), sizes)
    return min(1.0, local * effective_trials * tests)


def fitted_place(extension: FittedTerm) -> str | None:
    """Return the place if only its sizes are fitted; None for all places."""
    sizes = extension.free_sizes
    for place, _ in testable_places(extension.term):
        if place is not None and value_indices(extension.term, place, "size") == sizes:
            return place
    return None
