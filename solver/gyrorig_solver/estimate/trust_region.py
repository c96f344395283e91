"""Trust-region iteration for the fits: Levenberg-Marquardt with a gain ratio.

A problem proposes a step from its quadratic model and evaluates its objective (negative
log-likelihood plus priors, at fixed noise) after the step. The gain ratio is the actual decrease
divided by the predicted one. A step with a poor ratio is rejected and tried again with new
derivatives or with more damping. Without damping, the step is the full Gauss-Newton step.

What to use when: `minimise` for a fit that implements `TrustRegionProblem`.

Source: Levenberg-Marquardt after More, The Levenberg-Marquardt Algorithm (1978); gain ratio after
Conn, Gould and Toint, Trust Region Methods, chapter 6.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.data import FloatArray

CONVERGED_SIGMA = 1e-2  # of the last step
STEP_SHRINKAGE = 0.1  # after a step that is smaller by this factor, the next one is negligible
NEGLIGIBLE_NATS = 1e-3  # of predicted decrease
INSIGNIFICANT_NATS = 3.0  # of predicted decrease: a step of two standard deviations or less
MAX_INCREASE_NATS = 20.0  # of the objective by all steps with insignificant predicted decreases
LATE_EVALUATIONS = 20  # later, such a step increases the objective by at most INSIGNIFICANT_NATS
# A fit ends without convergence after this many evaluations without progress, of which so many
# steps were rejected. The derivatives are then wrong, because the misfit is large.
STALLED_EVALUATIONS, STALLED_REJECTIONS = 12, 4
PROGRESS_NATS = 1.0  # decrease of the lowest objective that counts as progress
MIN_GAIN_RATIO = 0.05  # a step with a lower ratio is rejected
REFRESH_GAIN_RATIO = 0.25  # a step with a lower ratio renews the derivatives
GOOD_GAIN_RATIO = 0.75  # a step with a higher ratio reduces the damping
FIRST_DAMPING, MIN_DAMPING, MAX_DAMPING = 1e-2, 1e-4, 1e6  # of the diagonal of the information
DAMPING_FACTOR = 10.0
# Small steps in one direction that decrease slowly are extrapolated (Aitken) after this many
# evaluations; steps that alternate at once.
PLAIN_EVALUATIONS = 12
MIN_SHRINKAGE, MAX_SHRINKAGE, MIN_COSINE = 0.3, 0.95, 0.9
# relative, of two full steps; with a smaller one, the second step starts a cycle
CYCLE_DIFFERENCE = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class ProposedStep:
    """A step with the decrease that the quadratic model predicts for it."""

    step: FloatArray  # (p,), of the parameters
    nuisance_steps: tuple[FloatArray, ...]  # of the unknowns of each recording's reference
    predicted_decrease: float  # nats
    sigmas: FloatArray  # (p,), the step in standard deviations

    @property
    def size_sigma(self) -> float:
        """The largest change of a parameter in standard deviations."""
        return float(np.max(np.abs(self.sigmas), initial=0.0))

    def scaled(self, factor: float) -> "ProposedStep":
        """Return a multiple of the step, with the predicted decrease of the whole step."""
        nuisance_steps = tuple(factor * step for step in self.nuisance_steps)
        return replace(
            self,
            step=factor * self.step,
            nuisance_steps=nuisance_steps,
            sigmas=factor * self.sigmas,
        )


@dataclass(frozen=True, slots=True)
class Convergence:
    """The end of an iteration."""

    converged: bool
    evaluations: int  # of the objective, in the last round
    remaining_nats: float  # predicted decrease of one more full step
    moving: str = ""  # parameter with the largest last step; empty after convergence
    moving_sigma: float = 0.0  # that step in standard deviations
    earlier_evaluations: int = 0  # of earlier rounds, with other noise levels or outliers

    @property
    def total_evaluations(self) -> int:
        """The evaluations of all rounds; the first derivatives of a round count as one more."""
        return self.earlier_evaluations + self.evaluations + 1

    def after(self, earlier_evaluations: int) -> "Convergence":
        """Return the end of the last round of a fit; the argument: of the rounds before it."""
        return replace(self, earlier_evaluations=earlier_evaluations)

    @property
    def reason(self) -> str:
        """One clause on a fit that did not converge."""
        return (
            f"the fit did not converge in {self.evaluations} steps, and {self.moving} still moves "
            f"by {self.moving_sigma:.2g} standard deviations"
        )


class NotConvergedError(InputError):
    """A fit to a recording did not converge, so it has no result.

    Attributes:
        moving: the parameter that still moves.
    """

    def __init__(self, convergence: Convergence, remedy: str) -> None:
        """State the parameter that still moves, and the remedy."""
        super().__init__(convergence.reason, remedy)
        self.moving = convergence.moving


class TrustRegionProblem(Protocol):
    """A fit that `minimise` can iterate."""

    @property
    def parameter_names(self) -> Sequence[str]:
        """The name of each parameter of a step."""
        ...

    def propose(self, damping: float) -> ProposedStep:
        """Return the step at the current values; damping 0 gives the full step."""
        ...

    def evaluate(self, proposal: ProposedStep) -> float:
        """Return the decrease of the objective after a step, nats, and keep the trial values."""
        ...

    def accept(self, new_derivatives: bool) -> None:
        """Continue from the values that were evaluated last."""
        ...

    def renew_derivatives(self) -> bool:
        """Compute better derivatives at the current values; return False if there are none."""
        ...

    def finish(self, proposal: ProposedStep) -> None:
        """Take a last, negligible step without an evaluation."""
        ...


def minimise(
    problem: TrustRegionProblem,
    max_evaluations: int,
    trust_shrinkage: bool = True,
    always_renew: bool = False,
) -> Convergence:
    """Iterate until the predicted decrease is negligible and the last step was accepted.

    Args:
        problem: at its start values.
        max_evaluations: limit on the evaluations of the objective.
        trust_shrinkage: whether a step that became much smaller is the last one, before it is
            small.
        always_renew: compute new derivatives after each step, even if the last ones are sufficient,
            and accept no step that increases the objective.
    """
    shrinkage_limit = STEP_SHRINKAGE if trust_shrinkage else 0.0
    damping, previous_sigma, was_accepted = 0.0, np.inf, True
    previous: ProposedStep | None = None
    progress = _Progress()
    undamped: list[FloatArray] = []  # the full steps that were accepted in sequence
    full = problem.propose(0.0)
    for evaluation in range(max_evaluations):
        is_late = evaluation >= LATE_EVALUATIONS
        if was_accepted and _is_negligible(full, previous_sigma, shrinkage_limit, is_late):
            problem.finish(full)
            return Convergence(True, evaluation, full.predicted_decrease)
        if _leads_back(full, undamped, bool(damping) or not was_accepted):
            return _not_converged(problem, full, evaluation)
        proposal = problem.propose(damping) if damping else full
        is_plain = not damping and full.predicted_decrease < INSIGNIFICANT_NATS
        if is_plain and previous is not None:
            proposal = _extrapolate(full, previous, evaluation >= PLAIN_EVALUATIONS)
        previous = full if is_plain and proposal is full else None
        decrease = problem.evaluate(proposal)
        allowed = _allowed_increase(always_renew, evaluation, progress.lost_nats)
        ratio = _gain_ratio(decrease, proposal.predicted_decrease, allowed)
        was_accepted = ratio >= MIN_GAIN_RATIO
        progress.add(decrease, was_accepted)
        if progress.has_stalled:
            return _not_converged(problem, full, evaluation + 1)
        if was_accepted:
            problem.accept(new_derivatives=always_renew or ratio < REFRESH_GAIN_RATIO)
            previous_sigma = full.size_sigma if proposal is full else np.inf
            before, full = full.predicted_decrease, problem.propose(0.0)
            if max(before, full.predicted_decrease) < INSIGNIFICANT_NATS:
                # whether the steps become smaller
                ratio = 1.0 if full.predicted_decrease < before else 0.0
            if ratio > GOOD_GAIN_RATIO:
                damping = damping / DAMPING_FACTOR if damping > MIN_DAMPING else 0.0
        if ratio < REFRESH_GAIN_RATIO:
            if problem.renew_derivatives():
                full = problem.propose(0.0)
            else:
                damping = max(DAMPING_FACTOR * damping, FIRST_DAMPING)
                if damping > MAX_DAMPING:
                    return _not_converged(problem, full, evaluation + 1)
    return _not_converged(problem, full, max_evaluations)


class _Progress:
    """The objective of a fit so far, relative to its start."""

    def __init__(self) -> None:
        """Begin at 0 nats."""
        self._level_nats = self._lowest_nats = self._reference_nats = 0.0
        self._evaluations = self._rejections = 0  # since the objective was at the reference

    @property
    def lost_nats(self) -> float:
        """The increase of the objective since its lowest value."""
        return self._level_nats - self._lowest_nats

    @property
    def has_stalled(self) -> bool:
        """Whether the last evaluations rejected steps, and the objective did not decrease."""
        return self._evaluations >= STALLED_EVALUATIONS and self._rejections >= STALLED_REJECTIONS

    def add(self, decrease: float, was_accepted: bool) -> None:
        """Count an evaluation."""
        self._evaluations += 1
        self._rejections += not was_accepted
        if was_accepted:
            self._level_nats -= decrease
            self._lowest_nats = min(self._lowest_nats, self._level_nats)
        if self._lowest_nats < self._reference_nats - PROGRESS_NATS:
            self._reference_nats = self._lowest_nats
            self._evaluations = self._rejections = 0


def _is_negligible(
    full: ProposedStep, previous_sigma: float, shrinkage_limit: float, is_late: bool
) -> bool:
    """Return whether a full step, and those that would follow, are negligible.

    Successive steps shrink by a factor, and their predicted decreases by its square. Late in a fit,
    small steps that do not shrink follow a derivative that the objective does not have. For
    example, if the stage comes to rest in a gap, the contact changes by whole grid intervals.
    """
    size = full.size_sigma
    shrinkage = size / previous_sigma if 0.0 < previous_sigma < np.inf else 1.0
    has_shrunk = shrinkage < shrinkage_limit or is_late
    is_small = size < CONVERGED_SIGMA or (size < STEP_SHRINKAGE and has_shrunk)
    remaining = full.predicted_decrease * min(1.0, shrinkage) ** 2
    return is_small and remaining < NEGLIGIBLE_NATS


def _leads_back(full: ProposedStep, previous: list[FloatArray], restarts: bool) -> bool:
    """Return whether a full step repeats one of the previous ones; add it to them.

    After each step, the noise levels and the outliers are those of the new values. If a model has a
    large misfit, they can lead back: each step decreases the objective, and no step is the last.

    Args:
        full: the step.
        previous: the full steps that were accepted in sequence, in standard deviations.
        restarts: whether the last step was damped or rejected. Small steps are not compared.
    """
    if restarts or full.predicted_decrease < INSIGNIFICANT_NATS:
        previous.clear()
        return False
    limit = CYCLE_DIFFERENCE * float(np.linalg.norm(full.sigmas))
    is_repeated = any(float(np.linalg.norm(full.sigmas - other)) < limit for other in previous)
    previous.append(full.sigmas)
    return is_repeated


def _extrapolate(full: ProposedStep, previous: ProposedStep, may_extend: bool) -> ProposedStep:
    """Return the sum of all steps that would follow if they changed as the last two did.

    Derivatives with small errors make the steps shrink by a constant factor. If the curvature of
    the objective is twice that of its quadratic model, the steps alternate without an end. The sum
    is then half a step.

    Args:
        full: the step.
        previous: the step before it.
        may_extend: whether the sum may be longer than the step.
    """
    length = float(np.linalg.norm(previous.sigmas))
    shrinkage = float(full.sigmas @ previous.sigmas) / max(length, 1e-30) ** 2
    cosine = shrinkage * length / max(float(np.linalg.norm(full.sigmas)), 1e-30)
    if abs(cosine) < MIN_COSINE:
        return full
    is_slow = may_extend and MIN_SHRINKAGE < shrinkage < MAX_SHRINKAGE
    return full.scaled(1.0 / (1.0 - shrinkage)) if is_slow or shrinkage < -MIN_SHRINKAGE else full


def _allowed_increase(is_strict: bool, evaluation: int, lost: float) -> float:
    """Return the increase of the objective that a step may cause, nats.

    With `is_strict` it is negligible, because at a threshold two steps can alternate.
    """
    if is_strict:
        return NEGLIGIBLE_NATS
    return MAX_INCREASE_NATS - lost if evaluation < LATE_EVALUATIONS else INSIGNIFICANT_NATS


def _gain_ratio(decrease: float, predicted: float, allowed_increase: float) -> float:
    """Return the actual decrease divided by the predicted one; 1 if both are insignificant.

    Derivatives have small errors, whose effect on the gradient grows with the misfit. Near the
    optimum of a model that lacks a cause, these errors hide the decrease of a step. Such a step may
    increase the objective by less than `allowed_increase`. Late in a fit this limit is small,
    because the fit could alternate between two points without an end.
    """
    if not np.isfinite(decrease):
        return -np.inf
    if predicted < INSIGNIFICANT_NATS:
        return 1.0 if -decrease < allowed_increase else -np.inf
    return decrease / predicted


def _not_converged(
    problem: TrustRegionProblem, full: ProposedStep, evaluations: int
) -> Convergence:
    largest = int(np.argmax(np.abs(full.sigmas)))
    return Convergence(
        False,
        evaluations,
        full.predicted_decrease,
        problem.parameter_names[largest],
        abs(float(full.sigmas[largest])),
    )
