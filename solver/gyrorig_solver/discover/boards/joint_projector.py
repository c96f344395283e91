"""Nuisance projection for several boards on one unit, with the motion's unknowns in common.

Each board has its own gain, bias, lag, causes and noise. Therefore the information and the scores
of a signal add over the boards after the parameters of each board are eliminated. The unknowns of
the motion, and the polls that determine them, are common to all boards and count once. Otherwise
their errors would count N times. With N boards, a column of one board overlaps with a common column
by 1/N of its energy. The nuisances are eliminated block by block (Schur complements).

What to use when: `JointProjector` in place of a `NuisanceProjector`, to fit one common size;
`local_quadratic` for one board's likelihood about that size, `prior_from_others` for a board's
prior from the others.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.discover.exact_fit import FittedCandidate
from gyrorig_solver.estimate import (
    GaussianPrior,
    NuisanceProjector,
    ScoreStatistics,
    SignalFunction,
    WhitenedSignals,
)
from gyrorig_solver.estimate.whitened_signals import join_channels
from gyrorig_solver.model import SignalState, Term
from gyrorig_solver.numerics import chi2_upper_tail, positive_part

# Relative to the information of the single values; directions with less information are ignored.
MIN_RELATIVE_INFORMATION = 1e-7


class JointProjector(NuisanceProjector):
    """The nuisance projectors of several boards, with the motion's unknowns in common."""

    def __init__(self, boards: Sequence[NuisanceProjector]) -> None:
        """Join the projectors of the boards, in this order; they are of the same recordings."""
        self.boards = tuple(boards)
        self.statistics_by_family = {}
        self._solution = None
        self.segments = tuple(s for part in boards for s in part.segments)
        self.board_parameters = sum(part.board_parameters for part in boards)
        self._ends = np.cumsum([part.residual.size for part in boards])[:-1]
        shared = [_shared_cause_columns(part) for part in boards]
        common_names = [name for name in shared[0] if all(name in other for other in shared)]
        self._parts = [
            _BoardPart(
                part,
                np.concatenate(
                    [np.zeros(0, np.int64), *(board_columns[name][0] for name in common_names)]
                ),
            )
            for part, board_columns in zip(boards, shared, strict=True)
        ]
        self.residual = np.concatenate([part.residual for part in self._parts])
        # The prior of the motion counts once: that of the board with the least prior information.
        known = min((part.known for part in self._parts), key=lambda part: float(np.trace(part)))
        sizes = np.concatenate([np.zeros(0), *(shared[0][name][1] for name in common_names)])
        inner = block_diag(known, np.diag(sizes**-2.0)) if sizes.size else known.copy()
        for part in self._parts:
            inner += part.information
        self._common = np.linalg.pinv(inner, hermitian=True)
        self._pull_common = sum((part.pull for part in self._parts), np.zeros(inner.shape[0]))

    def evaluate_signals(
        self, of: SignalFunction, exact: bool = False, term: Term | None = None
    ) -> WhitenedSignals:
        """Return the signals of all boards, whitened."""
        return join_channels([board.evaluate_signals(of, exact, term) for board in self.boards])

    def evaluate_together(
        self, functions: Sequence[SignalFunction], count: int, term: Term | None = None
    ) -> WhitenedSignals:
        """Return `count` signals of several functions on all boards, whitened."""
        return join_channels(
            [board.evaluate_together(functions, count, term) for board in self.boards]
        )

    def states_before(self, term: Term) -> list[SignalState]:
        """Return the signal state of each part of all boards at a term's input."""
        return [state for board in self.boards for state in board.states_before(term)]

    def term_derivatives(
        self, term: Term, values: FloatArray, free: IntArray | Sequence[int]
    ) -> WhitenedSignals:
        """Return a cause's derivatives on all boards, whitened; the last signal is its effect."""
        return join_channels([board.term_derivatives(term, values, free) for board in self.boards])

    def score_statistics(self, signals: WhitenedSignals) -> ScoreStatistics:
        """Return the score statistics of whitened signals over all boards.

        `absorbed` contains the parameters of the boards one after the other.
        """
        white = signals.dense()
        felt, board_steps, common = self._solve_nuisances(white)
        score = white @ self.residual - common.T @ self._pull_common
        gram = white @ white.T
        information = gram - sum((f.T @ common for f, _ in felt), np.zeros(gram.shape))
        taken = []
        for part, (_, board_product), step in zip(self._parts, felt, board_steps, strict=True):
            score = score - step.T @ part.pull_own
            information = information - board_product.T @ step
            taken.append(part.parameter_shift(step, common).T)
        return ScoreStatistics(
            information, score, np.diag(gram).copy(), np.concatenate(taken, axis=1)
        )

    def orthogonal_component(self, white: FloatArray) -> FloatArray:
        """Return the component of a whitened signal orthogonal to all nuisances, (all,)."""
        _, board_steps, common = self._solve_nuisances(white[None])
        return np.concatenate(
            [
                board_signal - part.common_effect(common[:, 0]) - part.own_rows.T @ step[:, 0]
                for part, board_signal, step in zip(
                    self._parts, np.split(white, self._ends), board_steps, strict=True
                )
            ]
        )

    def _solve_nuisances(
        self, white: FloatArray
    ) -> tuple[list[tuple[FloatArray, FloatArray]], list[FloatArray], FloatArray]:
        """Return the products of signals with both kinds of derivatives, and the nuisances' steps.

        Returns:
            For each board, the products with the common and with its own derivatives; the steps of
            the parameters of each board; the steps of the common unknowns.
        """
        felt = [
            (part.common_products(board_signals.T), part.own_rows @ board_signals.T)
            for part, board_signals in zip(
                self._parts, np.split(white, self._ends, axis=1), strict=True
            )
        ]
        pull = sum(
            (f - part.carry.T @ o for part, (f, o) in zip(self._parts, felt, strict=True)),
            np.zeros((self._common.shape[0], len(white))),
        )
        common = self._common @ pull
        board_steps = [
            part.own_inverse @ o - part.carry @ common
            for part, (_, o) in zip(self._parts, felt, strict=True)
        ]
        return felt, board_steps, common

    def board_part(self, k: int, taken: FloatArray) -> FloatArray:
        """Return the part of one board in a change of the parameters of all boards."""
        first = sum(board.board_parameters for board in self.boards[:k])
        return taken[first : first + self.boards[k].board_parameters]


class _BoardPart:
    """Derivatives of one board by its separate unknowns and by the common unknowns."""

    def __init__(self, board: NuisanceProjector, moved: IntArray) -> None:
        """Split a board; `moved`: the indices of its unknowns that are common to all boards."""
        apart = board.normal_blocks()
        stay = np.setdiff1d(np.arange(board.board_parameters), moved)
        self._moved, self._stay = moved, stay
        self._local = apart.local_derivatives
        self._dense = np.vstack([apart.shared_derivatives, apart.board_derivatives[moved]])
        self.own_rows = apart.board_derivatives[stay]
        self.known = apart.motion_prior_information
        # Start from the motion of the polls, so that all boards have the same motion.
        away = np.concatenate([apart.motion_prior_offset, np.zeros(moved.size)])
        self.residual = board.residual - self.common_effect(away)
        inner = self.own_rows @ self.own_rows.T + apart.board_prior_information[np.ix_(stay, stay)]
        self.own_inverse = np.linalg.pinv(inner, hermitian=True)
        across = self.common_products(self.own_rows.T)
        self.carry = self.own_inverse @ across.T
        near = (self._local @ self._local.T).toarray()
        cross = self._local @ self._dense.T
        gram = np.block([[near, cross], [cross.T, self._dense @ self._dense.T]])
        self.information = gram - across @ self.carry
        self.pull = self.common_products(self.residual)
        self.pull_own = self.own_rows @ self.residual + apart.board_prior_score[stay]

    def common_products(self, white: FloatArray) -> FloatArray:
        """Return the products of the common unknowns' derivatives with signals, (all, ...)."""
        return np.concatenate([self._local @ white, self._dense @ white])

    def common_effect(self, step: FloatArray) -> FloatArray:
        """Return the effect of a step of the common unknowns, (all,)."""
        local = self._local.shape[0]
        return np.asarray(self._local.T @ step[:local] + self._dense.T @ step[local:], np.float64)

    def parameter_shift(self, board_steps: FloatArray, common: FloatArray) -> FloatArray:
        """Return steps of the board's parameters, (board, k), in their usual order."""
        shift = np.zeros((self._stay.size + self._moved.size, board_steps.shape[1]))
        shift[self._stay] = board_steps
        shift[self._moved] = common[common.shape[0] - self._moved.size :]
        return shift


def _shared_cause_columns(
    board: NuisanceProjector,
) -> dict[tuple[str, ...], tuple[IntArray, FloatArray]]:
    """Return the columns and prior widths of causes that the boards have in common."""
    columns: dict[tuple[str, ...], tuple[IntArray, FloatArray]] = {}
    at = board.board_parameters - sum(
        fitted_term.free_indices.size for fitted_term in board.fitted_terms
    )
    for fitted_term in board.fitted_terms:
        if fitted_term.other_boards_prior is not None:
            columns[fitted_term.names] = (
                np.arange(at, at + fitted_term.free_indices.size),
                fitted_term.prior_std,
            )
        at += fitted_term.free_indices.size
    return columns


@dataclass(frozen=True, slots=True, eq=False)
class LocalQuadratic:
    """One board's log-likelihood as a quadratic function of a cause's values."""

    information: FloatArray  # (free, free), at the values
    slope: FloatArray  # (free,), gradient of this board's log-likelihood at the values
    delta_log_likelihood: float  # nats, at the values minus that of the fit without the cause


def local_quadratic(projection: NuisanceProjector, candidate: FittedCandidate) -> LocalQuadratic:
    """Return a board's log-likelihood about a cause's fitted values.

    Args:
        projection: the nuisance projector at the board's fit without the cause.
        candidate: the cause, fitted to this or other boards.
    """
    extension = candidate.extension
    statistics = projection.score_statistics(
        projection.term_derivatives(extension.term, extension.values, extension.free_indices)
    )
    count = extension.free_indices.size
    return LocalQuadratic(
        statistics.information[:count, :count],
        statistics.score[:count] - statistics.information[:count, count],
        float(statistics.score[count]) - 0.5 * float(statistics.information[count, count]),
    )


def prior_from_others(
    values: FloatArray, joint: LocalQuadratic, single: LocalQuadratic
) -> GaussianPrior:
    """Return one board's prior: joint minus own information, centred on the joint optimum.

    The prior contains the information of all boards minus that of the single board, so that the
    fit of the single board converges to the joint estimate.

    Args:
        values: of the fitted parameters, (free,), at the point of linearisation.
        joint: all boards together.
        single: the board that receives the prior.
    """
    information = positive_part(joint.information - single.information)
    return GaussianPrior(values - _pseudo_inverse(information)[0] @ single.slope, information)


def homogeneity_p_value(boards: Sequence[LocalQuadratic]) -> float:
    """Return the p-value of a score test that the boards have the same values.

    Args:
        boards: the likelihood of each board at the common optimum.

    Source: score test of homogeneity. The statistic is the sum of s' A^-1 s over the boards, minus
    the same of the sums of s and A. It is chi-squared. Each value adds one degree of freedom less
    than the number of boards that show it.
    """
    statistic, degrees = 0.0, 0
    for quadratic in boards:
        inverse, rank = _pseudo_inverse(quadratic.information)
        statistic += float(quadratic.slope @ inverse @ quadratic.slope)
        degrees += rank
    inverse, rank = _pseudo_inverse(np.sum([quadratic.information for quadratic in boards], axis=0))
    slope = np.sum([quadratic.slope for quadratic in boards], axis=0)
    statistic -= float(slope @ inverse @ slope)
    degrees -= rank
    return float(chi2_upper_tail(statistic, degrees)) if degrees > 0 else 1.0


def _pseudo_inverse(information: FloatArray) -> tuple[FloatArray, int]:
    """Return the pseudo-inverse on the observable subspace, scale-free, and its rank."""
    root_diagonal = np.sqrt(np.clip(np.diag(information), 0.0, None))
    scale = np.where(root_diagonal > 0.0, root_diagonal, 1.0)
    eigenvalues, eigenvectors = np.linalg.eigh(information / np.outer(scale, scale))
    keep = eigenvalues > MIN_RELATIVE_INFORMATION
    scaled = eigenvectors[:, keep] / scale[:, None]
    return (scaled / eigenvalues[keep]) @ scaled.T, int(keep.sum())
