"""One motion law of all boards on a unit, from their joint fit.

A cause that changes the motion law affects the samples of every board and the position replies,
which all boards share. The joint fit counts the replies once. Each board then gets a prior of the
law from the joint fit, so that a fit of this board alone ends at the common law.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.discover.fitted_values import value_positions
from gyrorig_solver.discover.motion_space import MotionFitSpace
from gyrorig_solver.estimate import FittedTerm, GaussianPrior, fit_boards_jointly
from gyrorig_solver.model import Term, term_label
from gyrorig_solver.numerics import positive_part


@dataclass(frozen=True, slots=True, eq=False)
class CommonLaw:
    """A cause of the unit's motion law at its common value."""

    spaces: Mapping[str, MotionFitSpace]  # the fit of each board, with the common value
    disagreement_p: float  # p-value of the boards having one value


def fit_common_law(spaces: Mapping[str, MotionFitSpace], cause: FittedTerm) -> CommonLaw | None:
    """Fit a cause of the motion law to all boards together; None if they have no common law.

    Args:
        spaces: the fit of each board, with or without the cause.
        cause: the cause as fitted to one of the boards.
    """
    extended = {name: _with_cause(space, cause) for name, space in spaces.items()}
    label = term_label(cause.term)
    solutions = {name: space.solution for name, space in extended.items()}
    joint = fit_boards_jointly(solutions, {label})
    if set(joint.solutions) != set(spaces):
        return None
    common = {}
    for name, space in extended.items():
        term_index = _index_of(space, cause.term)
        prior = _prior_from_joint(space, MotionFitSpace(joint.solutions[name]), term_index)
        fitted_terms = list(space.fitted_terms)
        fitted_terms[term_index] = replace(fitted_terms[term_index], other_boards_prior=prior)
        common[name] = space.refit(fitted_terms)
        if not common[name].convergence.converged:
            return None
    return CommonLaw(common, min(1.0, len(common) * min(joint.agreement_p_values.values())))


def _with_cause(space: MotionFitSpace, cause: FittedTerm) -> MotionFitSpace:
    """Return the fit with the cause at the same places as in the fits of the other boards."""
    label = term_label(cause.term)
    others = [term for term in space.fitted_terms if term_label(term.term) != label]
    if len(others) < len(space.fitted_terms):
        term_index = _index_of(space, cause.term)
        if np.array_equal(space.fitted_terms[term_index].free_indices, cause.free_indices):
            return space
    return space.refit([*others, cause])


def _index_of(space: MotionFitSpace, term: Term) -> int:
    labels = [term_label(fitted_term.term) for fitted_term in space.fitted_terms]
    return labels.index(term_label(term))


def _prior_from_joint(
    single: MotionFitSpace, joint: MotionFitSpace, term_index: int
) -> GaussianPrior:
    """Return the prior with which a fit of one board ends at the values of the joint fit."""
    values, information = zip(
        *(_values_and_information(space, term_index) for space in (single, joint)), strict=True
    )
    added = positive_part(information[1] - information[0])
    pull = (information[0] + added) @ values[1] - information[0] @ values[0]
    return GaussianPrior(np.linalg.pinv(added, hermitian=True) @ pull, added)


def _values_and_information(
    space: MotionFitSpace, term_index: int
) -> tuple[FloatArray, FloatArray]:
    """Return the fitted values of a cause, and their information, other values marginalised."""
    fitted_term = space.fitted_terms[term_index]
    positions = value_positions(space, term_index)
    covariance = space.observability.covariance[np.ix_(positions, positions)]
    information = np.linalg.pinv(covariance, hermitian=True)
    return fitted_term.values[fitted_term.free_indices], np.asarray(information, np.float64)
