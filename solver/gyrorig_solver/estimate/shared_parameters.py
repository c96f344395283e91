"""Shared parameters: values of unit-wide causes that all boards on the unit have in common.

`parameter_layout` makes one unknown of them instead of one per board.

What to use when: `average_shared_values` for common start values, before boards are fitted
together; `shared_term_p_value` afterwards, for one board.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.estimate.converged_fit import ConvergedFit
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.information import MarginalEquations
from gyrorig_solver.estimate.parameter_layout import (
    ParameterLayout,
    TermKey,
    identify_term,
    is_shared_term,
)
from gyrorig_solver.model import Term
from gyrorig_solver.numerics import chi2_upper_tail

MIN_RELATIVE_INFORMATION = 1e-9  # of the strongest direction: less information is ignored


def is_unit_cause(term: Term) -> bool:
    """Return whether a cause is unit-wide by its kind, and so common to all boards."""
    return term.scope == "unit" or term.part == "ptu"


def average_shared_values(
    solutions: Sequence[ConvergedFit], shared_labels: Collection[str]
) -> list[list[FittedTerm]]:
    """Return each board's terms, the unit-wide ones at the weighted mean of the boards.

    Priors from other boards are removed, because the joint fit has their data.

    Args:
        solutions: each board's own fit.
        shared_labels: of the unit-wide causes.
    """
    weights: dict[TermKey, FloatArray] = {}
    sums: dict[TermKey, FloatArray] = {}
    for solution in solutions:
        layout = ParameterLayout.of([solution.fitted_terms], 1)  # as of `ConvergedFit.estimate`
        for fitted_term, block in zip(solution.fitted_terms, layout.term_blocks(), strict=True):
            if is_shared_term(fitted_term, shared_labels):
                variance = np.diag(solution.observability.covariance)[block.positions]
                weight = 1.0 / np.where(variance > 0.0, variance, fitted_term.prior_std**2)
                key = identify_term(fitted_term)
                weights[key] = weights.get(key, np.zeros(block.size)) + weight
                sums[key] = (
                    sums.get(key, np.zeros(block.size))
                    + weight * fitted_term.values[fitted_term.free_indices]
                )
    averaged = []
    for solution in solutions:
        board_terms = []
        for fitted_term in solution.fitted_terms:
            if is_shared_term(fitted_term, shared_labels):
                values = fitted_term.values.copy()
                values[fitted_term.free_indices] = (
                    sums[identify_term(fitted_term)] / weights[identify_term(fitted_term)]
                )
                board_terms.append(replace(fitted_term, values=values, other_boards_prior=None))
            else:
                board_terms.append(fitted_term)
        averaged.append(board_terms)
    return averaged


def shared_term_p_value(
    marginals: Sequence[MarginalEquations], prior_std: FloatArray, is_shared: BoolArray
) -> float:
    """Return the p-value of one board's score on the unit-wide causes.

    Args:
        marginals: of each recording, over the board's G, bias, offset and causes, at the joint
            optimum.
        prior_std: of these parameters, (p,).
        is_shared: which of them are unit-wide, (p,).

    Source: score test (Rao 1948) of the shared values, the board's own parameters eliminated.
    """
    if not is_shared.any():
        return 1.0
    p_value = 1.0
    for marginal in marginals:
        scale = np.outer(prior_std, prior_std)
        information, score = marginal.information * scale, marginal.score * prior_std
        separate, shared = np.flatnonzero(~is_shared), np.flatnonzero(is_shared)
        cross = information[np.ix_(shared, separate)]
        inner = np.linalg.pinv(information[np.ix_(separate, separate)], hermitian=True)
        reduced = information[np.ix_(shared, shared)] - cross @ inner @ cross.T
        reduced_score = score[shared] - cross @ inner @ score[separate]
        eigenvalues, eigenvectors = np.linalg.eigh(reduced)
        informative = eigenvalues > MIN_RELATIVE_INFORMATION * max(
            float(eigenvalues[-1]), MIN_RELATIVE_INFORMATION
        )
        projected_score = eigenvectors[:, informative].T @ reduced_score
        statistic = float(np.sum(projected_score**2 / eigenvalues[informative]))
        p_value = min(
            p_value,
            chi2_upper_tail(statistic, int(informative.sum())) if informative.any() else 1.0,
        )
    return p_value
