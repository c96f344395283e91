"""Candidates that change the motion law, each judged by a fit under its own law.

Samples and replies follow the moves of one law. With the moves of another law, the effect of a
candidate looks different, and the data reject the candidate for that reason only. A first-order fit
at the present model is therefore no judgement of such a candidate; a full fit takes little longer.

What to use when: `fit_law_cause` for one candidate; `judge_law_cause` for a cause of a fit.

Source of the evidence: as in `exact_fit`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic

import numpy as np

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.discover.exact_fit import FittedCandidate
from gyrorig_solver.discover.fit_space import Space
from gyrorig_solver.discover.fitted_values import value_positions
from gyrorig_solver.discover.score_tests import testable_places
from gyrorig_solver.estimate import FittedTerm, free_term
from gyrorig_solver.model import Term, value_indices, value_parameters


@dataclass(frozen=True, slots=True, eq=False)
class LawCandidate(Generic[Space]):
    """A cause that changes the motion law, with the fit under its law."""

    space: Space  # the fit with the cause, its last one
    candidate: FittedCandidate | None  # None: the fit did not converge


def fit_law_cause(
    space: Space, term: Term, others: Sequence[FittedTerm] | None = None
) -> LawCandidate[Space]:
    """Fit a cause under its own law, at the place or places with the most evidence.

    Args:
        space: the fit that the gain is relative to.
        term: the cause.
        others: the other causes of the new fit; None: all of the present fit.
    """
    other_terms = space.fitted_terms if others is None else others
    extended = space.refit([*other_terms, free_term(term)])
    if not extended.convergence.converged:
        return LawCandidate(extended, None)
    last = len(other_terms)
    place, indices = _likeliest_place(extended, last)
    if place is not None:
        fitted = extended.fitted_terms[last]
        values = np.zeros_like(fitted.values)
        values[indices] = fitted.values[indices]
        restricted = extended.refit([*other_terms, FittedTerm(term, values, indices)])
        if restricted.convergence.converged:
            extended = restricted
        else:
            place = None
    # An outlier of the other law can agree with this one.
    if extended.outliers:
        again = extended.refit(extended.fitted_terms)
        extended = again if again.convergence.converged else extended
    return LawCandidate(extended, judge_law_cause(extended, last, space, place))


def judge_law_cause(
    space: Space, k: int, without: Space, place: str | None = None
) -> FittedCandidate:
    """Return what a cause of a fit gains over another fit.

    Args:
        space: the fit with the cause.
        k: which of its causes.
        without: the other fit.
        place: of the cause; None: all.
    """
    gain_nats, nats = without.log_likelihoods([space, without])
    gain_nats -= nats
    extension, covariance = space.fitted_terms[k], _value_covariance(space, k)
    evidence = gain_nats + _occam_nats(extension, extension.free_indices, covariance)
    return FittedCandidate(
        extension=extension,
        place=place,
        delta_log_likelihood=gain_nats,
        log_evidence=evidence,
        std=np.sqrt(np.clip(np.diag(covariance), 0.0, None)),
        absorbed=space.parameter_shift(without),
        infeasible=False,
    )


def _likeliest_place(space: Space, k: int) -> tuple[str | None, IntArray]:
    """Return the place of a cause's sizes with the most evidence, and their indices.

    The values at other places become zero, and those that remain follow (Laplace's approximation).
    """
    extension, covariance = space.fitted_terms[k], _value_covariance(space, k)
    free = extension.free_indices
    values = extension.values[free]
    best: tuple[float, str | None, IntArray] | None = None
    for place, _ in testable_places(extension.term):
        at_place = np.isin(free, value_indices(extension.term, place, "size"))
        out = ~at_place
        loss, remaining = 0.0, covariance[np.ix_(at_place, at_place)]
        if out.any():
            inverse = np.linalg.pinv(covariance[np.ix_(out, out)], hermitian=True)
            loss = 0.5 * float(values[out] @ inverse @ values[out])
            cross = covariance[np.ix_(at_place, out)]
            remaining = remaining - cross @ inverse @ cross.T
        evidence = _occam_nats(extension, free[at_place], remaining) - loss
        if best is None or evidence > best[0]:
            best = evidence, place, free[at_place]
    if best is None:
        return None, free
    return best[1], best[2]


def _value_covariance(space: Space, k: int) -> FloatArray:
    positions = value_positions(space, k)
    covariance = space.observability.covariance + space.observability.unobservable_covariance
    return np.asarray(covariance[np.ix_(positions, positions)], dtype=np.float64)


def _occam_nats(extension: FittedTerm, indices: IntArray, covariance: FloatArray) -> float:
    """Return the logarithm of the Occam factor of some sizes; `covariance`: theirs."""
    parameters = value_parameters(extension.term)
    nats = 0.5 * float(np.linalg.slogdet(2.0 * np.pi * covariance)[1])
    for index in indices:
        typical = parameters[index].typical_size
        relative = float(extension.values[index]) / typical
        nats -= float(np.log(np.pi * typical * (1.0 + relative**2)))
    return nats
