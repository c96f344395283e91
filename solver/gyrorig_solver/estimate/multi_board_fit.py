"""Joint fit of several boards that were on one unit at the same time.

The start of each move, the position of each rest and the speed of the unit are unknown. A fit of
one board estimates these from the samples of this board and the unit's position replies. Boards
that were on the unit at the same time estimate them together. Each board has a separate gain,
biases, time offsets, noise and causes. The unit's unknowns and the unit-wide causes
(`shared_parameters`) are common, as `likelihood_fit` fits them.

What to use when: `fit_boards_jointly` after a separate fit of each board. A board that disagrees
with the others about the motion of the unit is left out, because it would distort all of them.

Source: the test of agreement is a score test (Rao 1948) of one board's information on the unit's
unknowns, at the joint optimum. Because the position replies constrain these unknowns, the statistic
is a weighted sum of chi-squared variables, approximated by one of the same mean and variance
(Satterthwaite 1946).
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.linalg import solve_triangular

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.estimate.board_fit import BoardFit
from gyrorig_solver.estimate.converged_fit import ConvergedFit
from gyrorig_solver.estimate.executed_motion import law_columns
from gyrorig_solver.estimate.information import marginalise
from gyrorig_solver.estimate.likelihood_fit import LikelihoodFit
from gyrorig_solver.estimate.linear.normal_equations import NormalEquations
from gyrorig_solver.estimate.linear.whitening import BASE_PARAMETERS
from gyrorig_solver.estimate.shared_parameters import average_shared_values, shared_term_p_value
from gyrorig_solver.estimate.trust_region import Convergence, minimise
from gyrorig_solver.numerics import chi2_upper_tail
from gyrorig_solver.reference import ReferenceMotion

MAX_EVALUATIONS_PLAIN = 20
MAX_EVALUATIONS_WITH_CAUSES = 40
MAX_LAG_CHANGE_SIGMA = 2.0  # a larger change of a time offset in the joint fit indicates drift
NOT_CONVERGED = "the joint fit of all boards did not converge"
MIN_AGREEMENT_P = 1e-6  # of a board, divided by the number of boards
MAX_DENSE_UNKNOWNS = 1500  # of a motion; a larger dense matrix is too slow


@dataclass(frozen=True, slots=True, eq=False)
class JointFitResult:
    """The end of a joint fit."""

    solutions: Mapping[str, ConvergedFit]  # of the participating boards; empty if there are too few
    left_out: Mapping[str, str]  # the other boards, with the reason
    # p-value of the agreement of each participating board with the others.
    agreement_p_values: Mapping[str, float] = field(default_factory=dict)


def fit_boards_jointly(
    single_fits: Mapping[str, ConvergedFit], shared_labels: Collection[str] = ()
) -> JointFitResult:
    """Fit boards together that were on one unit in the same recordings.

    Args:
        single_fits: separate fit of each board.
        shared_labels: of the unit-wide causes, for each board that has them.
    """
    left_out = {
        name: reason
        for name, solution in single_fits.items()
        if (reason := _reason_to_leave_out(solution))
    }
    included = {name: solution for name, solution in single_fits.items() if name not in left_out}
    for name in _boards_with_other_motion(included):
        left_out[name] = "the reference motion of this board differs from that of the other boards"
        del included[name]
    while len(included) > 1:
        fit, convergence = _iterate_jointly(list(included.values()), shared_labels)
        with_causes = any(_term_value_count(solution) for solution in included.values())
        if not convergence.converged or (
            with_causes and not _lags_unchanged(included.values(), fit.boards)
        ):
            return JointFitResult({}, dict.fromkeys(included, NOT_CONVERGED) | left_out)
        p_values = {name: agreement_p_value(fit, k) for k, name in enumerate(included)}
        worst = min(p_values, key=lambda name: p_values[name])
        if p_values[worst] >= MIN_AGREEMENT_P / len(included):
            return JointFitResult(
                dict(zip(included, fit.solutions(convergence), strict=True)), left_out, p_values
            )
        # If two boards disagree, the data do not show which one is right.
        only_two = len(included) == 2
        removed = list(included) if only_two else [worst]
        others = "the other board" if only_two else f"{len(included) - 1} other boards"
        for name in removed:
            left_out[name] = (
                f"the unit's motion according to this board differs from that of {others} (p = "
                f"{max(p_values[worst], 1e-99):.0e}); check screws and clocks"
            )
            del included[name]
    return JointFitResult({}, left_out)


def _reason_to_leave_out(solution: ConvergedFit) -> str:
    """Return why a board must not take part in the joint fit, or ""."""
    return "" if solution.converged else "the separate fit of this board did not converge"


def _term_value_count(solution: ConvergedFit) -> int:
    return sum(fitted_term.free_indices.size for fitted_term in solution.fitted_terms)


def _boards_with_other_motion(solutions: Mapping[str, ConvergedFit]) -> list[str]:
    """Return the boards whose reference has other unknowns or another law than most boards."""
    layout = {
        name: tuple(
            (
                type(session.reference).__name__,
                session.reference.information.size,
                tuple(law_columns(solution.fitted_terms, 0).law_values.tolist()),
            )
            for session in solution.sessions
        )
        for name, solution in solutions.items()
    }
    most_common = max(layout.values(), key=list(layout.values()).count, default=())
    return [name for name, board_layout in layout.items() if board_layout != most_common]


def _lags_unchanged(single_fits: Iterable[ConvergedFit], boards: Sequence[BoardFit]) -> bool:
    """Return whether the boards' time offsets are close to those of their single fits.

    If causes distort the motion, the derivatives by lags and moves neglect that the effects move
    with them. A common shift of both hardly changes the residual, and can therefore drift without
    an end.
    """
    for solution, board in zip(single_fits, boards, strict=True):
        current_s = np.array([session.lag_s for session in board.sessions])
        single_s = np.array([session.lag_s for session in solution.sessions])
        std_s = np.sqrt(
            [analysis.covariance[12, 12] for analysis in solution.session_observability]
        )
        if np.any(np.abs(current_s - single_s) > MAX_LAG_CHANGE_SIGMA * std_s):
            return False
    return True


def _iterate_jointly(
    single_fits: Sequence[ConvergedFit], shared_labels: Collection[str]
) -> tuple[LikelihoodFit, Convergence]:
    fit = LikelihoodFit(_resume_boards(single_fits, shared_labels), shared_labels)
    with_causes = any(_term_value_count(solution) for solution in single_fits)
    evaluations = MAX_EVALUATIONS_WITH_CAUSES if with_causes else MAX_EVALUATIONS_PLAIN
    return fit, minimise(fit, evaluations, trust_shrinkage=False)


def _resume_boards(
    single_fits: Sequence[ConvergedFit], shared_labels: Collection[str]
) -> list[BoardFit]:
    """Return the boards, all at the mean of their motions and unit-wide causes."""
    terms_of_boards = average_shared_values(single_fits, shared_labels)
    boards = [
        BoardFit.resumed(solution, fitted_terms)
        for solution, fitted_terms in zip(single_fits, terms_of_boards, strict=True)
    ]
    for sessions in zip(*(board.sessions for board in boards), strict=True):
        pulls = [session.reference.prior_offset for session in sessions]
        mean_pull = np.mean(pulls, axis=0)
        for session, pull in zip(sessions, pulls, strict=True):
            session.reference = session.reference.with_step(pull - mean_pull)
    for board in boards:
        board.update_predictions()
    return boards


def agreement_p_value(fit: LikelihoodFit, board_index: int) -> float:
    """Return the p-value of one board's agreement with the others at the joint optimum.

    It is the smaller p-value of the motion and of the unit-wide causes.
    """
    board = fit.boards[board_index]
    pairs = list(zip(board.normal_equations(), board.sessions, strict=True))
    motion_p_value = min(
        motion_agreement_p_value(normal, session.reference, board.parameter_count)
        for normal, session in pairs
    )
    index = fit.layout.index(0, board_index)
    is_shared = fit.layout.is_shared(index)
    if not is_shared.any():
        return motion_p_value
    columns = law_columns(board.fitted_terms, BASE_PARAMETERS)
    marginals = [
        marginalise(normal, session.reference, board.parameter_count, columns)
        for normal, session in pairs
    ]
    cause_p_value = shared_term_p_value(marginals, fit.layout.prior_std[index], is_shared)
    return min(motion_p_value, cause_p_value)


def motion_agreement_p_value(
    equations: NormalEquations, reference: ReferenceMotion, parameter_count: int = BASE_PARAMETERS
) -> float:
    """Return the p-value of one board's score on the unit's unknowns.

    Args:
        equations: of the board, at the joint optimum.
        reference: has the prior of the unknowns, from the position replies.
        parameter_count: number of the board's parameters.
    """
    local, _ = equations.matrix.size
    if not 0 < local <= MAX_DENSE_UNKNOWNS:
        return 1.0
    matrix = equations.matrix.to_dense()
    board_index = np.arange(local, local + parameter_count)
    unit_index = np.concatenate(
        [np.arange(local), np.arange(local + parameter_count, matrix.shape[0])]
    )
    unit_information = _reduce_information(matrix, unit_index, board_index)
    board_step = (
        np.linalg.pinv(matrix[np.ix_(board_index, board_index)], hermitian=True)
        @ equations.score[board_index]
    )
    score = equations.score[unit_index] - matrix[np.ix_(unit_index, board_index)] @ board_step
    prior_information = reference.information.to_dense()
    prior_information = _reduce_information(
        prior_information,
        np.arange(unit_index.size),
        np.arange(unit_index.size, prior_information.shape[0]),
    )
    cholesky_factor = np.linalg.cholesky(unit_information + prior_information)
    white_score = solve_triangular(cholesky_factor, score, lower=True)
    white_information = solve_triangular(
        cholesky_factor,
        solve_triangular(cholesky_factor, unit_information, lower=True).T,
        lower=True,
    )
    mean = float(np.trace(white_information))
    spread = float(np.sum(white_information * white_information))
    if not spread > 0.0:  # no board shows a move: nothing can disagree
        return 1.0
    return float(
        chi2_upper_tail(float(white_score @ white_score) * mean / spread, mean**2 / spread)
    )


def _reduce_information(matrix: FloatArray, keep: IntArray, drop: IntArray) -> FloatArray:
    """Return the information about some unknowns, with the others eliminated."""
    cross = matrix[np.ix_(keep, drop)]
    inverse = np.linalg.pinv(matrix[np.ix_(drop, drop)], hermitian=True)
    return np.asarray(matrix[np.ix_(keep, keep)] - cross @ inverse @ cross.T, dtype=np.float64)
