"""Shared parameters: values of unit-wide causes that all boards on the unit have in common.

A board's parameters are G, each recording's bias and offset, and its causes' values. The values of
a unit-wide cause are the same for all boards: one unknown instead of one per board.

What to use when: `average_shared_values` for common start values, then `map_parameters` before
boards are fitted together; `shared_term_p_value` afterwards, for one board.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.data.arrays import BoolArray, FloatArray, IntArray
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.information import MarginalEquations
from gyrorig_solver.estimate.likelihood_fit import ConvergedFit
from gyrorig_solver.model.recording_scope import term_label
from gyrorig_solver.model.term import Term
from gyrorig_solver.numerics.distributions import chi2_upper_tail

MIN_RELATIVE_INFORMATION = 1e-9  # of the strongest direction: less information is ignored
TermKey = tuple[str, tuple[int, ...], tuple[float, ...]]


@dataclass(frozen=True, slots=True, eq=False)
class ParameterMap:
    """The index of the joint unknown of every board's parameter."""

    unknown_index: IntArray  # (x,), for all boards' parameters in a row
    is_shared: BoolArray  # (x,), unit-wide

    @property
    def unknown_count(self) -> int:
        """The number of unknowns."""
        return int(self.unknown_index.max()) + 1

    def first_per_unknown(self, per_parameter: FloatArray) -> FloatArray:
        """Return per-parameter values as per-unknown values."""
        per_unknown = np.zeros(self.unknown_count)
        per_unknown[self.unknown_index[::-1]] = per_parameter[::-1]
        return per_unknown


def is_unit_cause(term: Term) -> bool:
    """Return whether a cause is unit-wide by its kind, and so common to all boards."""
    return term.scope == "unit" or term.part == "ptu"


def is_shared_term(fitted_term: FittedTerm, shared_labels: Collection[str]) -> bool:
    """Return whether a term is fitted as unit-wide."""
    return bool(fitted_term.free_indices.size) and term_label(fitted_term.term) in shared_labels


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
        for fitted_term, positions in locate_fitted_terms(
            solution.fitted_terms, solution.estimate.size
        ):
            if is_shared_term(fitted_term, shared_labels):
                variance = np.diag(solution.observability.covariance)[positions]
                weight = 1.0 / np.where(variance > 0.0, variance, fitted_term.prior_std**2)
                key = _term_key(fitted_term)
                weights[key] = weights.get(key, np.zeros(positions.size)) + weight
                sums[key] = (
                    sums.get(key, np.zeros(positions.size))
                    + weight * fitted_term.values[fitted_term.free_indices]
                )
    averaged = []
    for solution in solutions:
        board_terms = []
        for fitted_term in solution.fitted_terms:
            if is_shared_term(fitted_term, shared_labels):
                values = fitted_term.values.copy()
                values[fitted_term.free_indices] = (
                    sums[_term_key(fitted_term)] / weights[_term_key(fitted_term)]
                )
                board_terms.append(replace(fitted_term, values=values, other_boards_prior=None))
            else:
                board_terms.append(fitted_term)
        averaged.append(board_terms)
    return averaged


def map_parameters(
    terms_of_boards: Sequence[Sequence[FittedTerm]],
    parameter_counts: Sequence[int],
    shared_labels: Collection[str],
) -> ParameterMap:
    """Return the joint unknown of each board's parameter.

    Args:
        terms_of_boards: each board's causes.
        parameter_counts: number of parameters per board, its causes' values last.
        shared_labels: of the unit-wide causes.
    """
    unknown_of_key: dict[tuple[TermKey, int], int] = {}
    unknown_index: list[int] = []
    is_shared: list[bool] = []
    unknowns = 0
    for fitted_terms, parameter_count in zip(terms_of_boards, parameter_counts, strict=True):
        keys: dict[int, tuple[TermKey, int]] = {}
        for fitted_term, positions in locate_fitted_terms(fitted_terms, parameter_count):
            if is_shared_term(fitted_term, shared_labels):
                keys |= {int(k): (_term_key(fitted_term), part) for part, k in enumerate(positions)}
        for k in range(parameter_count):
            existing = unknown_of_key.get(keys[k]) if k in keys else None
            unknown_index.append(unknowns if existing is None else existing)
            is_shared.append(k in keys)
            if existing is None:
                if k in keys:
                    unknown_of_key[keys[k]] = unknowns
                unknowns += 1
    return ParameterMap(
        np.array(unknown_index, dtype=np.int64), np.array(is_shared, dtype=np.bool_)
    )


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


def locate_fitted_terms(
    fitted_terms: Sequence[FittedTerm], parameter_count: int
) -> list[tuple[FittedTerm, IntArray]]:
    """Return each fitted term and the positions of its values in a board's parameters."""
    first = parameter_count - sum(fitted_term.free_indices.size for fitted_term in fitted_terms)
    located = []
    for fitted_term in fitted_terms:
        if fitted_term.free_indices.size:
            located.append((fitted_term, np.arange(first, first + fitted_term.free_indices.size)))
            first += fitted_term.free_indices.size
    return located


def _term_key(fitted_term: FittedTerm) -> TermKey:
    """Return the key that identifies a term on two boards: its name and all fixed values."""
    fixed_values = np.delete(fitted_term.values, fitted_term.free_indices)
    return (
        term_label(fitted_term.term),
        tuple(fitted_term.free_indices.tolist()),
        tuple(np.round(fixed_values, 12).tolist()),
    )
