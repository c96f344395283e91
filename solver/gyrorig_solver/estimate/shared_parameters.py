"""Shared parameters: values of unit-wide causes that are equal for all boards on the unit.

`parameter_layout` makes one unknown of them instead of one per board.

What to use when: `homogeneity_p_values` decides from single fits whether a cause can have one
value; `average_shared_values` for common start values, before boards are fitted together;
`shared_term_p_value` afterwards, for one board.

Source: the chi-squared test of the consistency of several results, Cox, Metrologia 39 (2002) 589.
"""

from collections.abc import Collection, Iterable, Sequence
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

MIN_RELATIVE_INFORMATION = 1e-9  # relative to the strongest direction; less information is ignored


# Below this p-value, a cause of the unit is treated as a cause of each board's mount. Boards that
# differ by less have a common value whose uncertainty is at most 2.6 times too small (two boards).
MIN_HOMOGENEITY_P = 0.01


def is_unit_cause(term: Term) -> bool:
    """Return whether a cause is unit-wide by its kind, and so common to all boards."""
    return term.scope == "unit" or term.part == "ptu"


def average_shared_values(
    solutions: Sequence[ConvergedFit], shared_labels: Collection[str]
) -> list[list[FittedTerm]]:
    """Return each board's terms, with the unit-wide terms at the weighted mean of the boards.

    Priors from other boards are removed, because the joint fit has their data.

    Args:
        solutions: separate fit of each board.
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


def homogeneity_p_values(
    solutions: Iterable[ConvergedFit], shared_labels: Collection[str]
) -> dict[str, float]:
    """Return the p-value that the boards have the same value, by label of each unit-wide cause.

    A cause with a prior from other boards is left out: its estimates are not independent.

    Args:
        solutions: separate fit of each board.
        shared_labels: of the unit-wide causes.
    """
    estimates: dict[TermKey, list[tuple[FloatArray, FloatArray]]] = {}
    for solution in solutions:
        layout = ParameterLayout.of([solution.fitted_terms], 1)  # as of `ConvergedFit.estimate`
        for fitted_term, block in zip(solution.fitted_terms, layout.term_blocks(), strict=True):
            if (
                not is_shared_term(fitted_term, shared_labels)
                or fitted_term.other_boards_prior is not None
            ):
                continue
            covariance = solution.observability.covariance
            estimates.setdefault(identify_term(fitted_term), []).append(
                (
                    fitted_term.values[fitted_term.free_indices],
                    covariance[np.ix_(block.positions, block.positions)],
                )
            )
    p_values: dict[str, float] = {}
    for key, board_estimates in estimates.items():
        p_values[key[0]] = min(p_values.get(key[0], 1.0), _homogeneity_p_value(board_estimates))
    return p_values


def _homogeneity_p_value(estimates: Sequence[tuple[FloatArray, FloatArray]]) -> float:
    """Return the p-value of the estimates' squared distances from their weighted mean."""
    if len(estimates) < 2:
        return 1.0
    weights = [np.linalg.pinv(covariance, hermitian=True) for _, covariance in estimates]
    inverse = np.linalg.pinv(np.sum(weights, axis=0), hermitian=True)
    pulls = [weight @ values for (values, _), weight in zip(estimates, weights, strict=True)]
    mean = inverse @ np.sum(pulls, axis=0)
    statistic = sum(
        float((values - mean) @ weight @ (values - mean))
        for (values, _), weight in zip(estimates, weights, strict=True)
    )
    ranks = [int(np.linalg.matrix_rank(weight, hermitian=True)) for weight in weights]
    degrees = sum(ranks) - int(np.linalg.matrix_rank(inverse, hermitian=True))
    return chi2_upper_tail(statistic, degrees) if degrees > 0 else 1.0


def shared_term_p_value(
    marginals: Sequence[MarginalEquations], prior_std: FloatArray, is_shared: BoolArray
) -> float:
    """Return the p-value of one board's score on the unit-wide causes.

    Args:
        marginals: of each recording, over the board's G, bias, offset and causes, at the joint
            optimum.
        prior_std: of these parameters, (p,).
        is_shared: which of them are unit-wide, (p,).

    Source: score test (Rao 1948) of the shared values, with the board's parameters eliminated.
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
