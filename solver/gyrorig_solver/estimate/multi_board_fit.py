"""The joint fit of several boards that were on one unit at the same time.

The start of each move, the position of each rest and the speed of the unit: one board alone
estimates these from its own samples and the unit's position replies. Boards that were on it at the
same time estimate them together. Each board keeps its own gain, biases, time offsets, noise and
causes. The unit's unknowns and the unit-wide causes (`shared_parameters`) are common. In the normal
matrix the boards' parameters are the dense border and the unit's local unknowns the sparse part,
which is eliminated once for all boards.

What to use when: `fit_boards_jointly` after a fit of each board alone. A board that disagrees with
the others about the motion of the unit is left out, because it would distort all of them.

Source: block elimination as in `numerics.arrowhead`. The test of agreement is a score test (Rao
1948) of one board's information on the unit's unknowns, at the joint optimum. Because the position
replies constrain these unknowns, the statistic is a weighted sum of chi-squared variables,
approximated by one of the same mean and variance (Satterthwaite 1946).
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, solve_triangular

from gyrorig_solver.data.arrays import FloatArray, IntArray
from gyrorig_solver.estimate.fit_objective import reference_cost
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.information import RecordingEquations, marginalise
from gyrorig_solver.estimate.likelihood_fit import ConvergedFit, GaussNewtonFit, resume_fit
from gyrorig_solver.estimate.linear.normal_equations import NormalEquations
from gyrorig_solver.estimate.noise.whitening import BASE_PARAMETERS
from gyrorig_solver.estimate.observability import analyse_scaled_observability
from gyrorig_solver.estimate.shared_parameters import (
    average_shared_values,
    map_parameters,
    shared_term_p_value,
)
from gyrorig_solver.estimate.trust_region import Convergence, ProposedStep, minimise
from gyrorig_solver.numerics.arrowhead import ArrowheadMatrix
from gyrorig_solver.numerics.distributions import chi2_upper_tail
from gyrorig_solver.reference.reference_motion import ReferenceMotion

MAX_EVALUATIONS_PLAIN = 20
MAX_EVALUATIONS_WITH_CAUSES = 40
MAX_LAG_CHANGE_SIGMA = 2.0  # a larger change of a time offset in the joint fit indicates drift
NOT_CONVERGED = "the joint fit of all boards did not converge"
MIN_AGREEMENT_P = 1e-6  # of a board, divided by the number of boards
MAX_DENSE_UNKNOWNS = 1500  # of a motion: a larger dense matrix is too slow


@dataclass(frozen=True, slots=True, eq=False)
class JointFitResult:
    """The end of a joint fit."""

    solutions: Mapping[
        str, ConvergedFit
    ]  # of the boards that took part; empty if there are too few
    left_out: Mapping[str, str]  # the other boards, with the reason


def fit_boards_jointly(
    single_fits: Mapping[str, ConvergedFit], shared_labels: Collection[str] = ()
) -> JointFitResult:
    """Fit boards together that were on one unit in the same recordings.

    Args:
        single_fits: the fit of each board alone.
        shared_labels: of the unit-wide causes, for each board that has them.
    """
    left_out = {
        name: reason
        for name, solution in single_fits.items()
        if (reason := _reason_to_leave_out(solution))
    }
    included = {name: solution for name, solution in single_fits.items() if name not in left_out}
    for name in _boards_with_other_motion(included):
        left_out[name] = "its reference motion differs from that of the other boards"
        del included[name]
    while len(included) > 1:
        solver, convergence = _iterate_jointly(list(included.values()), shared_labels)
        with_causes = any(_term_value_count(solution) for solution in included.values())
        if not convergence.converged or (
            with_causes and not _lags_unchanged(included.values(), solver.lags_s())
        ):
            return JointFitResult({}, dict.fromkeys(included, NOT_CONVERGED) | left_out)
        p_values = dict(zip(included, solver.agreement_p_values(), strict=True))
        worst = min(p_values, key=lambda name: p_values[name])
        if p_values[worst] >= MIN_AGREEMENT_P / len(included):
            return JointFitResult(
                dict(zip(included, solver.solutions(convergence), strict=True)), left_out
            )
        # If two boards disagree, nothing shows which one is right.
        only_two = len(included) == 2
        removed = list(included) if only_two else [worst]
        others = "the other board" if only_two else f"{len(included) - 1} other boards"
        for name in removed:
            left_out[name] = (
                f"it disagrees with {others} about the motion of the unit "
                f"(p {max(p_values[worst], 1e-99):.0e}); check screws and clocks"
            )
            del included[name]
    return JointFitResult({}, left_out)


def _reason_to_leave_out(solution: ConvergedFit) -> str:
    """Return why a board must not take part in the joint fit, or ""."""
    return "" if solution.converged else "its own fit did not converge"


def _term_value_count(solution: ConvergedFit) -> int:
    return sum(fitted_term.free_indices.size for fitted_term in solution.fitted_terms)


def _boards_with_other_motion(solutions: Mapping[str, ConvergedFit]) -> list[str]:
    """Return the boards whose reference has other unknowns than most boards'."""
    layout = {
        name: tuple(
            (type(session.reference).__name__, session.reference.information.size)
            for session in solution.sessions
        )
        for name, solution in solutions.items()
    }
    most_common = max(layout.values(), key=list(layout.values()).count, default=())
    return [name for name, board_layout in layout.items() if board_layout != most_common]


def _lags_unchanged(single_fits: Iterable[ConvergedFit], lags_s: Sequence[FloatArray]) -> bool:
    """Return whether the boards' time offsets are close to those of their single fits.

    If causes distort the motion, the derivatives by lags and moves neglect how the effects move
    with them. A common shift of both, which hardly changes the residual, can then drift without
    end.
    """
    for solution, current_s in zip(single_fits, lags_s, strict=True):
        single_s = np.array([session.lag_s for session in solution.sessions])
        std_s = np.sqrt(
            [analysis.covariance[12, 12] for analysis in solution.session_observability]
        )
        if np.any(np.abs(current_s - single_s) > MAX_LAG_CHANGE_SIGMA * std_s):
            return False
    return True


def _iterate_jointly(
    single_fits: Sequence[ConvergedFit], shared_labels: Collection[str]
) -> tuple["_JointSolver", Convergence]:
    solver = _JointSolver(single_fits, shared_labels)
    with_causes = any(_term_value_count(solution) for solution in single_fits)
    evaluations = MAX_EVALUATIONS_WITH_CAUSES if with_causes else MAX_EVALUATIONS_PLAIN
    return solver, minimise(solver, evaluations, trust_shrinkage=False)


class _JointSolver:
    """A joint fit, with one solver per board; a `trust_region.TrustRegionProblem`."""

    def __init__(self, single_fits: Sequence[ConvergedFit], shared_labels: Collection[str]) -> None:
        terms_of_boards = average_shared_values(single_fits, shared_labels)
        self._solvers = self._resume_boards(single_fits, terms_of_boards)
        sizes = [solver.prior_std().size for solver in self._solvers]
        ends = np.cumsum(sizes)
        self._slices = [slice(end - size, end) for end, size in zip(ends, sizes, strict=True)]
        self._parameters_per_session = [
            BASE_PARAMETERS + _term_value_count(solution) for solution in single_fits
        ]  # per recording
        self._parameter_map = map_parameters(terms_of_boards, sizes, shared_labels)
        self._prior_std = self._parameter_map.first_per_unknown(
            np.concatenate([solver.prior_std() for solver in self._solvers])
        )
        self._information = np.zeros((0, 0))
        self._sigma = np.zeros(0)  # of each unknown
        self._equations: list[RecordingEquations] = []  # at the current values
        self.parameter_names = self._unknown_names()

    def _resume_boards(
        self, single_fits: Sequence[ConvergedFit], terms_of_boards: list[list[FittedTerm]]
    ) -> list[GaussNewtonFit]:
        """Return the boards' solvers, all of them at the mean of their motions."""
        solvers = [
            resume_fit(solution, board_terms)
            for solution, board_terms in zip(single_fits, terms_of_boards, strict=True)
        ]
        for sessions in zip(*(solver.sessions for solver in solvers), strict=True):
            pulls = [session.reference.prior_offset for session in sessions]
            mean_pull = np.mean(pulls, axis=0)
            for session, pull in zip(sessions, pulls, strict=True):
                session.reference = session.reference.with_step(pull - mean_pull)
        for solver in solvers:
            solver.update_predictions()
        return solvers

    def _unknown_names(self) -> tuple[str, ...]:
        """Return the name of each unknown; those of a board with the board's number."""
        names = [""] * self._prior_std.size
        labels = [
            f"{name} of board {number}"
            for number, solver in enumerate(self._solvers, start=1)
            for name in solver.parameter_names
        ]
        for unknown, label in zip(self._parameter_map.unknown_index, labels, strict=True):
            names[unknown] = names[unknown] or label
        return tuple(names)

    def propose(self, damping: float) -> ProposedStep:
        """Return the step of all boards; damping 0 gives the full Gauss-Newton step."""
        if not self._equations:
            self._equations = self._recording_equations()
        marginals = [equations.marginalise(damping) for equations in self._equations]
        size = self._prior_std.size
        information, score = np.zeros((size, size)), np.zeros(size)
        for recording_index, marginal in enumerate(marginals):
            index = self._parameter_map.unknown_index[
                self._parameter_index(recording_index)
            ]  # unit-wide causes occur once per board
            np.add.at(information, np.ix_(index, index), marginal.information)
            np.add.at(score, index, marginal.score)
        analysis = analyse_scaled_observability(information, self._prior_std)
        step = analysis.pseudo_inverse @ score
        if not damping:
            self._information = information
            self._sigma = np.sqrt(np.clip(np.diag(analysis.covariance), 0.0, None))
        parameter_step = step[self._parameter_map.unknown_index]
        nuisance_steps, predicted = [], 0.0
        for recording_index, (equations, marginal) in enumerate(
            zip(self._equations, marginals, strict=True)
        ):
            own_step = parameter_step[self._parameter_index(recording_index)]
            nuisance_steps.append(marginal.nuisance_step(own_step))
            predicted += equations.predicted_decrease(own_step, nuisance_steps[-1])
        sigmas = step / np.where(self._sigma > 0.0, self._sigma, np.inf)
        return ProposedStep(step, tuple(nuisance_steps), predicted, sigmas)

    def evaluate(self, proposal: ProposedStep) -> float:
        """Return the decrease of the objective after a step, nats, and keep the trial values."""
        parameter_step = proposal.step[self._parameter_map.unknown_index]
        decrease = sum(
            solver.try_step(
                parameter_step[board_slice], proposal.nuisance_steps, proposal.size_sigma
            )
            for solver, board_slice in zip(self._solvers, self._slices, strict=True)
        )
        # All boards have the same reference, so its prior counts once.
        for session, nuisance_step in zip(
            self._solvers[0].sessions, proposal.nuisance_steps, strict=True
        ):
            decrease += reference_cost(session.reference)
            decrease -= reference_cost(session.reference.with_step(nuisance_step))
        return decrease

    def accept(self, new_derivatives: bool) -> None:
        """Continue from the values that were evaluated last."""
        self._equations = []
        for solver in self._solvers:
            solver.accept(new_derivatives)

    def renew_derivatives(self) -> bool:
        """Compute new derivatives at the current values; return False if they are new."""
        renewed = [solver.renew_derivatives() for solver in self._solvers]
        if any(renewed):
            self._equations = []
        return any(renewed)

    def finish(self, proposal: ProposedStep) -> None:
        """Take a last, negligible step without an evaluation."""
        parameter_step = proposal.step[self._parameter_map.unknown_index]
        for solver, board_slice in zip(self._solvers, self._slices, strict=True):
            solver.apply_step(parameter_step[board_slice], proposal.nuisance_steps)

    def solutions(self, convergence: Convergence) -> list[ConvergedFit]:
        """Return each board's result, the other boards' parameters marginalised."""
        return [
            solver.summarize(convergence, self._board_information(board_slice))
            for solver, board_slice in zip(self._solvers, self._slices, strict=True)
        ]

    def lags_s(self) -> list[FloatArray]:
        """Return each board's lags, per recording."""
        return [
            np.array([session.lag_s for session in solver.sessions]) for solver in self._solvers
        ]

    def agreement_p_values(self) -> list[float]:
        """Return the p-value of each board's agreement with the others."""
        return [self._agreement_p_value(board_index) for board_index in range(len(self._solvers))]

    def _agreement_p_value(self, board_index: int) -> float:
        """Return the smaller p-value of the motion and of the unit-wide causes."""
        solver, parameter_count = (
            self._solvers[board_index],
            self._parameters_per_session[board_index],
        )
        pairs = list(zip(solver.normal_equations(), solver.sessions, strict=True))
        motion_p_value = min(
            motion_agreement_p_value(normal, session.reference, parameter_count)
            for normal, session in pairs
        )
        is_shared = self._parameter_map.is_shared[self._slices[board_index]][
            solver.parameter_index(0)
        ]
        if not is_shared.any():
            return motion_p_value
        marginals = [
            marginalise(normal, session.reference, parameter_count) for normal, session in pairs
        ]
        return min(
            motion_p_value,
            shared_term_p_value(
                marginals, solver.prior_std()[solver.parameter_index(0)], is_shared
            ),
        )

    def _board_information(self, board_slice: slice) -> FloatArray:
        """Return the information about one board's parameters, all others eliminated."""
        keep = self._parameter_map.unknown_index[board_slice]
        drop = np.setdiff1d(np.arange(self._prior_std.size), keep)
        # A weak prior: the others' unobservable parameters are not determined.
        dropped_information = self._information[np.ix_(drop, drop)] + np.diag(
            1e-6 / self._prior_std[drop] ** 2
        )
        cross = self._information[np.ix_(keep, drop)]
        reduced = self._information[np.ix_(keep, keep)] - cross @ np.linalg.solve(
            dropped_information, cross.T
        )
        return np.asarray((reduced + reduced.T) / 2.0, dtype=np.float64)

    def _parameter_index(self, recording_index: int) -> IntArray:
        """Return the positions of all boards' parameters of one recording."""
        solvers_and_slices = zip(self._solvers, self._slices, strict=True)
        return np.concatenate(
            [
                board_slice.start + solver.parameter_index(recording_index)
                for solver, board_slice in solvers_and_slices
            ]
        )

    def _recording_equations(self) -> list[RecordingEquations]:
        """Return each recording's equations of all boards."""
        equations_of_boards = zip(
            *(solver.normal_equations() for solver in self._solvers), strict=True
        )
        return [
            RecordingEquations.of(
                stack_boards(boards, self._parameters_per_session),
                session.reference,
                sum(self._parameters_per_session),
            )
            for boards, session in zip(equations_of_boards, self._solvers[0].sessions, strict=True)
        ]


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
    mean, spread = (
        float(np.trace(white_information)),
        float(np.sum(white_information * white_information)),
    )
    return float(
        chi2_upper_tail(float(white_score @ white_score) * mean / spread, mean**2 / spread)
    )


def _reduce_information(matrix: FloatArray, keep: IntArray, drop: IntArray) -> FloatArray:
    """Return the information about some unknowns, the others eliminated."""
    cross = matrix[np.ix_(keep, drop)]
    inverse = np.linalg.pinv(matrix[np.ix_(drop, drop)], hermitian=True)
    return np.asarray(matrix[np.ix_(keep, keep)] - cross @ inverse @ cross.T, dtype=np.float64)


def stack_boards(
    boards: Sequence[NormalEquations], parameter_counts: Sequence[int] = ()
) -> NormalEquations:
    """Return one recording's equations over (local | each board's own, the unit's shared).

    Args:
        boards: of each, over (local | own, shared), of the same local and shared unknowns.
        parameter_counts: number of each board's own parameters, if they have causes.
    """
    local = boards[0].matrix.size[0]
    boards_and_counts = list(
        zip(boards, parameter_counts or [BASE_PARAMETERS] * len(boards), strict=True)
    )
    local_information = boards[0].matrix.local
    for other in boards[1:]:
        local_information = (local_information + other.matrix.local).tocsc()
    board_information = block_diag(
        *(equations.matrix.shared[:count, :count] for equations, count in boards_and_counts)
    )
    shared = np.sum(
        [equations.matrix.shared[count:, count:] for equations, count in boards_and_counts], axis=0
    )
    border = np.vstack(
        [equations.matrix.shared[:count, count:] for equations, count in boards_and_counts]
    )
    cross = [equations.matrix.cross[:, :count] for equations, count in boards_and_counts]
    shared_cross = np.sum(
        [equations.matrix.cross[:, count:] for equations, count in boards_and_counts], axis=0
    )
    matrix = ArrowheadMatrix(
        local_information,
        np.hstack([*cross, shared_cross]),
        np.block([[board_information, border], [border.T, shared]]),
    )
    board_scores = [
        equations.score[local : local + count] for equations, count in boards_and_counts
    ]
    shared_score = np.sum(
        [equations.score[local + count :] for equations, count in boards_and_counts], axis=0
    )
    local_score = np.sum([equations.score[:local] for equations in boards], axis=0)
    return NormalEquations(matrix, np.concatenate([local_score, *board_scores, shared_score]))
