"""Candidates that change the motion law, each judged by a fit under its own law.

Samples and replies follow the moves of one law. With the moves of another law, the effect of a
candidate looks different, and the data reject the candidate for that reason only. A first-order fit
at the present model therefore cannot judge such a candidate. A full fit takes little longer.

What to use when: `fit_law_cause` for one candidate; `judge_law_cause` for a cause of a fit.

Source of the evidence: as in `exact_fit`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Generic

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.discover.exact_fit import FittedCandidate
from gyrorig_solver.discover.fit_space import Space
from gyrorig_solver.discover.fitted_values import value_positions
from gyrorig_solver.discover.score_tests import testable_places
from gyrorig_solver.estimate import FittedTerm, free_term
from gyrorig_solver.estimate.noise.outliers import OUTLIER_SIGMA
from gyrorig_solver.model import Term, value_indices, value_parameters

# A fit ends if it has not converged after these evaluations and predicts less gain than it needs.
FIRST_EVALUATIONS = 12
START_FACTORS = (1.0, 3.0)  # typical sizes, from which a fit starts if it failed from zero
SCAN_EVALUATIONS = 2  # of the fit from each of them, before the best is chosen
OPTIMUM_FACTOR = 3.0  # upper bound of the best optimum's gain, relative to the optimum found
MIN_OPTIMUM_NATS = 10.0  # smallest gain of the optimum found that the bound assumes
OUTLIER_NATS = 0.5 * OUTLIER_SIGMA**2  # log-likelihood that a rejected sample costs


@dataclass(frozen=True, slots=True, eq=False)
class LawCandidate(Generic[Space]):
    """A cause that changes the motion law, with the fit under its law."""

    space: Space  # the last fit with the cause
    candidate: FittedCandidate | None  # None: the fit did not converge


def fit_law_cause(
    space: Space,
    term: Term,
    others: Sequence[FittedTerm] | None = None,
    needed_nats: float = -np.inf,
    replaced_nats: float = 0.0,
) -> LawCandidate[Space]:
    """Fit a cause under its own law, at the place or places with the most evidence.

    The places are fitted one by one only if one of them can have the needed evidence; see
    `largest_evidence`.

    Args:
        space: the present fit, to which the gain is relative.
        term: the cause.
        others: the other causes of the new fit; None: all causes of the present fit.
        needed_nats: evidence of another candidate. With less evidence, this cause is not chosen.
        replaced_nats: gain of the log-likelihood by the causes that are only in the present fit.
    """
    other_terms = space.fitted_terms if others is None else others
    extended = space.refit([*other_terms, free_term(term)], FIRST_EVALUATIONS)
    if not extended.convergence.converged:
        extended = _fit_from_larger_start(space, other_terms, term, extended)
    if not extended.convergence.converged:
        reached = judge_law_cause(extended, len(other_terms), space).delta_log_likelihood
        if reached + extended.convergence.remaining_nats < needed_nats:
            return LawCandidate(extended, None)
        extended = extended.refit(extended.fitted_terms)
    if not extended.convergence.converged:
        return LawCandidate(extended, None)
    fitted = extended.fitted_terms[len(other_terms)]
    judged = judge_law_cause(extended, len(other_terms), space)
    if largest_evidence(judged, extended.outliers, replaced_nats) < needed_nats:
        return LawCandidate(extended, judged)
    best = extended, judged
    for place, _ in testable_places(term):
        if place is None or largest_evidence(best[1], 0, replaced_nats) < needed_nats:
            continue
        indices = np.array(value_indices(term, place, "size"), dtype=np.int64)
        values = np.zeros_like(fitted.values)
        values[indices] = fitted.values[indices]
        restricted = extended.refit([*other_terms, FittedTerm(term, values, indices)])
        if restricted.convergence.converged:
            alone = judge_law_cause(restricted, len(other_terms), space, place)
            best = max(best, (restricted, alone), key=lambda pair: pair[1].log_evidence)
    return LawCandidate(*best)


def _fit_from_larger_start(
    space: Space, others: Sequence[FittedTerm], term: Term, failed: Space
) -> Space:
    """Return the fit from the best of some larger sizes, or the failed fit if that is better.

    Without the cause, the moves begin and end at wrong times, and the likelihood can decrease from
    a size of zero to the optimum. Only causes whose sizes cannot be negative have larger starts.

    Args:
        space: the present fit.
        others: the other causes of the new fit.
        term: the cause.
        failed: the fit that started without an effect of the cause.
    """
    start, parameters = free_term(term), value_parameters(term)
    if any(parameters[k].lower < 0.0 for k in start.free_indices):
        return failed
    fits = [failed]
    for factor in START_FACTORS:
        values = start.values.copy()
        values[start.free_indices] = [
            min(factor * parameters[k].typical_size, parameters[k].upper)
            for k in start.free_indices
        ]
        fits.append(space.refit([*others, replace(start, values=values)], SCAN_EVALUATIONS))
    nats = space.log_likelihoods(fits) - OUTLIER_NATS * np.array([fit.outliers for fit in fits])
    best = fits[int(np.argmax(nats))]
    return best if best is failed else best.refit(best.fitted_terms, FIRST_EVALUATIONS)


def largest_evidence(judged: FittedCandidate, outliers: int, replaced_nats: float) -> float:
    """Return a bound on the evidence of a cause at any of its places.

    The cause at one place is a special case of the cause at all places, and the Occam factor is at
    most 1. Therefore the evidence is at most the gain at all places. Each outlier that agrees with
    the law adds at most its penalty. A fit can end at a local optimum. The gain of the best optimum
    is less than `OPTIMUM_FACTOR` times that gain (`test_law_bounds`).

    Args:
        judged: the cause at all places.
        outliers: number of outliers of its fit.
        replaced_nats: as in `fit_law_cause`.
    """
    gain_nats = judged.delta_log_likelihood + replaced_nats + OUTLIER_NATS * outliers
    return OPTIMUM_FACTOR * max(gain_nats, MIN_OPTIMUM_NATS) - replaced_nats


def judge_law_cause(
    space: Space, k: int, without: Space, place: str | None = None
) -> FittedCandidate:
    """Return a cause of a fit as a candidate, with its gain over another fit.

    Args:
        space: the fit with the cause.
        k: index of the cause in the fit.
        without: the other fit.
        place: of the cause; None: all places.
    """
    gain_nats, nats = without.log_likelihoods([space, without])
    gain_nats -= nats
    # The likelihoods leave out the outliers of both fits, but a fit rejects the samples that it
    # explains badly.
    gain_nats -= OUTLIER_NATS * (space.outliers - without.outliers)
    extension, covariance = space.fitted_terms[k], _value_covariance(space, k)
    evidence = gain_nats + _occam_nats(extension, covariance)
    return FittedCandidate(
        extension=extension,
        place=place,
        delta_log_likelihood=gain_nats,
        log_evidence=evidence,
        std=np.sqrt(np.clip(np.diag(covariance), 0.0, None)),
        absorbed=space.parameter_shift(without),
        infeasible=False,
    )


def _value_covariance(space: Space, k: int) -> FloatArray:
    positions = value_positions(space, k)
    covariance = space.observability.covariance + space.observability.unobservable_covariance
    return np.asarray(covariance[np.ix_(positions, positions)], dtype=np.float64)


def _occam_nats(extension: FittedTerm, covariance: FloatArray) -> float:
    """Return the logarithm of the Occam factor of the fitted sizes; `covariance`: of these sizes.

    A size that the data do not determine has the width of its prior and the factor 1.
    """
    parameters, indices = value_parameters(extension.term), extension.free_indices
    # A normal prior of this width has the same density at zero as the Cauchy prior.
    width = np.sqrt(np.pi / 2.0) * np.array([parameters[index].typical_size for index in indices])
    limited = covariance - covariance @ np.linalg.solve(covariance + np.diag(width**2), covariance)
    nats = 0.5 * float(np.linalg.slogdet(2.0 * np.pi * limited)[1])
    for index in indices:
        nats += parameters[index].log_prior_of_size(float(extension.values[index]))
    return nats
