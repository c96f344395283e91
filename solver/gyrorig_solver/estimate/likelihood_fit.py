"""The maximum-likelihood fit of boards to reference motions, in the rate domain.

The fit uses trust-region iterations over each board's G, each recording's (b, tau), the causes'
values, and each reference's unknowns. After each accepted step, the noise levels are estimated
again from the residual's spectrum. Several boards that were on one unit at the same time share the
unknowns of its motion, and the values of unit-wide causes. The boards' parameters are the dense
border of the normal matrix. The motion's local unknowns are the sparse part, which is eliminated
once for all boards. One board is the case N = 1. All derivatives are analytic. See `trust_region`
for the iteration, `parameter_layout` for the order of the parameters, `linear.normal_equations` for
the algebra, `noise.noise_model` for the density, `board_fit` for one board, `session_fit` for one
recording and `observability` for the rule that decides which values are reported.

What to use when: `fit_likelihood` for a first fit of one board; `refit_with_terms` to fit the same
recordings with other causes; `confirm_fit` before values are stated; `multi_board_fit` for several
boards.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.estimate.board_fit import BoardFit
from gyrorig_solver.estimate.board_summary import summarize_board
from gyrorig_solver.estimate.converged_fit import ConvergedFit
from gyrorig_solver.estimate.executed_motion import law_columns, reference_decrease
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.information import MarginalEquations, RecordingEquations
from gyrorig_solver.estimate.linear.normal_equations import stack_boards
from gyrorig_solver.estimate.linear.whitening import BASE_PARAMETERS
from gyrorig_solver.estimate.observability import analyse_scaled_observability
from gyrorig_solver.estimate.parameter_layout import (
    ParameterBlock,
    ParameterLayout,
    eliminate_parameters,
)
from gyrorig_solver.estimate.session_fit import SessionFit
from gyrorig_solver.estimate.trust_region import Convergence, ProposedStep, minimise

MAX_EVALUATIONS = 40  # of the objective
MAX_MOTION_NOISE_UPDATES = 3  # each followed by another minimisation
MAX_CONFIRMATIONS = 4  # each with at most this number of evaluations:
CONFIRMING_EVALUATIONS = 15
ROUGH_CONFIRMATIONS = 2  # after this number, only the predicted decrease counts
CONFIRMED_SIGMA = 0.1  # of the next step with new derivatives; no stated digit changes
# predicted decrease of this step; then no parameter changes by 0.45 standard deviations
CONFIRMED_NATS = 0.1


def fit_likelihood(
    sessions: Sequence[SessionFit], fitted_terms: Sequence[FittedTerm] = ()
) -> ConvergedFit:
    """Fit one board to the reference motions of its recordings.

    Args:
        sessions: in the order of time; the result has bias and offset of the last one.
        fitted_terms: causes beyond the base model, common to all recordings.

    Raises:
        InputError: no sample has a reference.
    """
    return _fit_board(BoardFit.started(sessions, fitted_terms), MAX_EVALUATIONS)


def refit_with_terms(
    previous: ConvergedFit,
    fitted_terms: Sequence[FittedTerm],
    max_evaluations: int = MAX_EVALUATIONS,
) -> ConvergedFit:
    """Fit the same recordings with other causes, starting from a previous fit.

    Args:
        previous: the previous fit, which is not changed.
        fitted_terms: all causes of the new fit, each with good start values.
        max_evaluations: limit on the evaluations of the objective.

    Returns:
        The fit. It uses the samples that only the previous model rejected as outliers.
    """
    solution = _fit_board(BoardFit.resumed(previous, fitted_terms), max_evaluations)
    if not solution.converged or not solution.outliers:
        return solution
    board = BoardFit.resumed(solution, solution.fitted_terms)
    used = [used for session in board.sessions for used in session.used]
    if all(map(np.array_equal, used, solution.used_blocks())):
        return solution
    again = _fit_board(board, max_evaluations)
    best, other = (again, solution) if again.converged else (solution, again)
    earlier = best.convergence.earlier_evaluations + other.convergence.total_evaluations
    return replace(best, convergence=best.convergence.after(earlier))


def _is_rough_optimum(fit: "LikelihoodFit", step: ProposedStep) -> bool:
    """Return whether neither a step nor half of it decreases the objective as predicted.

    At a threshold, the derivatives are those of the samples on one side of it.
    """
    return all(fit.evaluate(step.scaled(share)) < CONFIRMED_NATS for share in (1.0, 0.5))


def confirm_fit(solution: ConvergedFit) -> ConvergedFit:
    """Return a fit after iterations until new derivatives and outlier tests do not change it.

    A fit keeps its derivatives and outliers while its steps are small. If a cause has a threshold,
    or a misfit looks like an outlier, the fit therefore ends near the optimum but not at it. After
    the first round, a rejected sample stays rejected. Otherwise, the fit could alternate between
    two sets of outliers without an end.

    Args:
        solution: a fit, which is not changed.

    Returns:
        The fit at its optimum. If steps with new derivatives still decrease the objective, it has
        not converged.
    """
    if not solution.converged:
        return solution
    for k in range(MAX_CONFIRMATIONS + 1):
        board = BoardFit.resumed(solution, solution.fitted_terms, keep_rejected=k > 0)
        fit = LikelihoodFit([board])
        step = fit.propose(0.0)
        # A threshold makes the objective rough, so the last steps do not become smaller.
        is_small = step.size_sigma < CONFIRMED_SIGMA or k >= ROUGH_CONFIRMATIONS
        is_confirmed = step.predicted_decrease < CONFIRMED_NATS and is_small
        if is_confirmed or (k >= ROUGH_CONFIRMATIONS and _is_rough_optimum(fit, step)):
            evaluations = solution.convergence.evaluations
            return replace(
                solution, convergence=Convergence(True, evaluations, step.predicted_decrease)
            )
        if k < MAX_CONFIRMATIONS:
            solution = _fit_board(board, CONFIRMING_EVALUATIONS, always_renew=True)
    largest = int(np.argmax(np.abs(step.sigmas)))
    moving = Convergence(
        False,
        solution.convergence.evaluations,
        step.predicted_decrease,
        fit.parameter_names[largest],
        step.size_sigma,
    )
    return replace(solution, convergence=moving)


def _fit_board(board: BoardFit, max_evaluations: int, always_renew: bool = False) -> ConvergedFit:
    """Fit one board, and its noise in motion."""
    fit = LikelihoodFit([board])
    convergence = minimise(fit, max_evaluations, always_renew=always_renew)
    for _ in range(MAX_MOTION_NOISE_UPDATES):
        # Before convergence, a misfit can look like noise.
        if not convergence.converged or not board.update_motion_noise():
            break
        fit, earlier = LikelihoodFit([board]), convergence.total_evaluations
        convergence = minimise(fit, max_evaluations, always_renew=always_renew).after(earlier)
    return fit.solutions(convergence)[0]


class LikelihoodFit:
    """A fit of one or more boards; a `trust_region.TrustRegionProblem`."""

    def __init__(self, boards: Sequence[BoardFit], shared_labels: Collection[str] = ()) -> None:
        """Start at the boards' values.

        Args:
            boards: of the same recordings.
            shared_labels: of the unit-wide causes.
        """
        self.boards = tuple(boards)
        self.layout = ParameterLayout.of(
            [board.fitted_terms for board in boards], len(boards[0].sessions), shared_labels
        )
        self._equations: Sequence[RecordingEquations] = ()  # at the current values
        self._information = np.zeros((0, 0))  # of the last full step
        self._sigma = np.zeros(0)  # of each parameter

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """The name of each parameter, with the recording and the board if there are several."""
        return self.layout.parameter_names

    def propose(self, damping: float) -> ProposedStep:
        """Return the step at the current values; damping 0 gives the full Gauss-Newton step."""
        if not self._equations:
            self._equations = self._recording_equations()
        marginals = [equations.marginalise(damping) for equations in self._equations]
        information, score = self._sum_marginals(marginals)
        analysis = analyse_scaled_observability(information, self.layout.prior_std)
        step = self._bounded_step(analysis.pseudo_inverse @ score, information, score)
        if not damping:
            self._information = information
            self._sigma = np.sqrt(np.clip(np.diag(analysis.covariance), 0.0, None))
        predicted = self._prior_decrease(step)
        nuisance_steps = []
        for k, (equations, marginal) in enumerate(zip(self._equations, marginals, strict=True)):
            recording_step = np.concatenate([step[index] for index in self._indices(k)])
            nuisance_steps.append(marginal.nuisance_step(recording_step))
            predicted += equations.predicted_decrease(recording_step, nuisance_steps[-1])
        sigmas = step / np.where(self._sigma > 0.0, self._sigma, np.inf)
        return ProposedStep(step, tuple(nuisance_steps), predicted, sigmas)

    def evaluate(self, proposal: ProposedStep) -> float:
        """Return the decrease of the objective after a step, nats, and keep the trial values."""
        decrease = self._prior_decrease(proposal.step)
        for k, board in enumerate(self.boards):
            decrease += board.try_step(
                proposal.step[self.layout.board_index(k)],
                proposal.nuisance_steps,
                proposal.size_sigma,
            )
        # All boards have the same reference, so its prior counts once.
        first = self.boards[0]
        for session, trial in zip(first.sessions, first.trial_sessions, strict=True):
            decrease += reference_decrease(session.reference, trial.reference)
        return decrease

    def accept(self, new_derivatives: bool) -> None:
        """Continue from the values that were evaluated last."""
        self._equations = ()
        for board in self.boards:
            board.accept(new_derivatives)

    def renew_derivatives(self) -> bool:
        """Compute better derivatives at the current values; return False if there are none."""
        renewed = [board.renew_derivatives() for board in self.boards]
        if any(renewed):
            self._equations = ()
        return any(renewed)

    def finish(self, proposal: ProposedStep) -> None:
        """Take a last, negligible step without an evaluation."""
        for k, board in enumerate(self.boards):
            board.apply_step(proposal.step[self.layout.board_index(k)], proposal.nuisance_steps)

    def solutions(self, convergence: Convergence) -> list[ConvergedFit]:
        """Return each board's result, with the other boards' parameters marginalised."""
        return [
            summarize_board(
                board,
                eliminate_parameters(
                    self._information, self.layout.board_index(k), self.layout.prior_std
                ),
                convergence,
            )
            for k, board in enumerate(self.boards)
        ]

    def _indices(self, recording: int) -> list[IntArray]:
        """Return the positions of the columns of each board's equations of a recording."""
        return [self.layout.index(recording, board) for board in range(len(self.boards))]

    def _recording_equations(self) -> list[RecordingEquations]:
        counts = [board.parameter_count for board in self.boards]
        # The replies count once, with the first board.
        columns = law_columns(self.boards[0].fitted_terms, BASE_PARAMETERS)
        equations_of_recordings = zip(
            *(board.normal_equations() for board in self.boards), strict=True
        )
        return [
            RecordingEquations.of(
                stack_boards(equations_of_boards, counts), session.reference, sum(counts), columns
            )
            for equations_of_boards, session in zip(
                equations_of_recordings, self.boards[0].sessions, strict=True
            )
        ]

    def _sum_marginals(
        self, marginals: Sequence[MarginalEquations]
    ) -> tuple[FloatArray, FloatArray]:
        """Return the information and score of all parameters, summed over the recordings."""
        size = self.layout.size
        information, score = np.zeros((size, size)), np.zeros(size)
        for k, marginal in enumerate(marginals):
            index = np.concatenate(self._indices(k))
            # Unit-wide causes occur once for each board.
            np.add.at(information, np.ix_(index, index), marginal.information)
            np.add.at(score, index, marginal.score)
        for fitted_term, block in self._distinct_terms():
            if fitted_term.other_boards_prior is not None:
                term_slice = slice(block.start, block.start + block.size)
                information[term_slice, term_slice] += fitted_term.other_boards_prior.information
                score[term_slice] += fitted_term.other_boards_prior.score(
                    fitted_term.values[fitted_term.free_indices]
                )
        return information, score

    def _bounded_step(
        self, step: FloatArray, information: FloatArray, score: FloatArray
    ) -> FloatArray:
        """Clip the Gauss-Newton step to the causes' ranges (active set), and solve the rest again.

        A cause at its bound stays there if the step would move it outside.
        """
        terms = _positions_of(self._distinct_terms())
        fixed = np.zeros(step.size, dtype=np.bool_)
        clipped = self._clip_terms(step)
        for _ in range(terms.size):
            at_bound = terms[(clipped[terms] == 0.0) & (step[terms] != 0.0) & ~fixed[terms]]
            if not at_bound.size:
                break
            fixed[at_bound] = True
            free = np.flatnonzero(~fixed)
            inverse = analyse_scaled_observability(
                information[np.ix_(free, free)], self.layout.prior_std[free]
            ).pseudo_inverse
            step = np.zeros_like(step)
            step[free] = inverse @ score[free]
            clipped = self._clip_terms(step)
        return clipped

    def _clip_terms(self, step: FloatArray) -> FloatArray:
        """Return a step whose causes stay in their ranges."""
        clipped = step.copy()
        for fitted_term, block in self._distinct_terms():
            free = fitted_term.free_indices
            stepped = fitted_term.with_step(step[block.positions])
            clipped[block.positions] = stepped.values[free] - fitted_term.values[free]
        return clipped

    def _prior_decrease(self, step: FloatArray) -> float:
        """Return the decrease of the cost of the causes' priors by a step, nats."""
        return sum(
            fitted_term.prior_cost() - fitted_term.with_step(step[block.positions]).prior_cost()
            for fitted_term, block in self._distinct_terms()
        )

    def _distinct_terms(self) -> list[tuple[FittedTerm, ParameterBlock]]:
        """Return each cause with its block; a unit-wide cause once."""
        distinct: dict[int, tuple[FittedTerm, ParameterBlock]] = {}
        for k, board in enumerate(self.boards):
            for fitted_term, block in zip(
                board.fitted_terms, self.layout.term_blocks(k), strict=True
            ):
                if block.size:
                    distinct.setdefault(block.start, (fitted_term, block))
        return list(distinct.values())


def _positions_of(terms: Sequence[tuple[FittedTerm, ParameterBlock]]) -> IntArray:
    return np.array([k for _, block in terms for k in block.positions], dtype=np.int64)
