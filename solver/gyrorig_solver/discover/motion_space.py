"""The fit of a board on a pan-tilt unit, or at rest all the time, as a space for the search.

What to use when: `MotionFitSpace` for a fit of `likelihood_fit`.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Self

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray
from gyrorig_solver.discover.calibration_changes import CalibrationValues
from gyrorig_solver.discover.candidate_fits import global_p_value
from gyrorig_solver.discover.cause_findings import DependenceTest
from gyrorig_solver.discover.checks.residual_dependence import (
    limited_dependence_tests,
    most_significant,
    residual_dependence_tests,
)
from gyrorig_solver.discover.checks.typical_noise import (
    build_projector,
    build_usual_projector,
    has_typical_noise,
    limit_to_typical,
    measure_bias_walk,
    whittle_log_evidence,
    whittle_log_likelihood,
)
from gyrorig_solver.discover.exact_fit import FittedCandidate, fit_candidate
from gyrorig_solver.discover.extended_fit import refit_gain_exactly
from gyrorig_solver.discover.fit_space import FitSpace, NoiseAlternative, SearchEffort
from gyrorig_solver.discover.score_tests import FALSE_ALARM_RATE
from gyrorig_solver.estimate import (
    MAX_EVALUATIONS,
    ConvergedFit,
    FittedTerm,
    NoiseModel,
    NuisanceProjector,
    ParameterLayout,
    confirm_fit,
    reference_cost,
    refit_with_terms,
)
from gyrorig_solver.estimate.fit_objective import residual_cost
from gyrorig_solver.estimate.fit_segments import negative_log_likelihood
from gyrorig_solver.estimate.fit_summary import BASE_TERMS
from gyrorig_solver.estimate.law_effects import unit_references
from gyrorig_solver.estimate.uncertainty_widening import reduced_chi2
from gyrorig_solver.model import Term
from gyrorig_solver.model.catalogue import catalogue


class MotionFitSpace(FitSpace):
    """A fit to the motion of a unit or to rest."""

    def __init__(self, solution: ConvergedFit, effort: SearchEffort | None = None) -> None:
        """Use a fit whose recordings have contexts; `effort`: of the search that made it."""
        series = [series for session in solution.sessions for series in session.series]
        samples = sum(each.time_s.size for each in series)
        self.effort = SearchEffort(samples) if effort is None else effort
        self.solution, self.terms = solution, catalogue()
        self.fitted_terms, self.convergence = solution.fitted_terms, solution.convergence
        self.observability, self.outliers = solution.observability, solution.outliers
        self.has_typical_noise = has_typical_noise(solution)
        causes = (fitted_term.term.cause for fitted_term in self.fitted_terms)
        self.base_terms = (*BASE_TERMS, "time_offset", *causes)
        contexts = (session.context for session in solution.sessions)
        self.recording_names = tuple("" if c is None else c.recording_name for c in contexts)
        self.offset_recording = solution.offset_recording
        self.duration_s = float(sum(np.ptp(each.time_s) for each in series))

    def projector(self, typical: bool = False) -> NuisanceProjector:
        """Return the nuisance projector, with fitted or typical noise levels."""
        return self.effort.count_signals(build_projector(self.solution, typical))

    def projector_without(self, *dropped: int) -> NuisanceProjector:
        """Return the projector without some causes, with their effects added to the residual.

        A cause that changes the motion law is removed by a fit under the law without it.
        """
        others = self.terms_without(*dropped)
        removed = [self.fitted_terms[k] for k in dropped]
        if any(self.changes_law(fitted_term.term) for fitted_term in removed):
            without = self.refit(others)
            if without.convergence.converged:
                return without.projector()
        return self.effort.count_signals(NuisanceProjector.at_fit(self.solution, others, removed))

    def refit(
        self, fitted_terms: Sequence[FittedTerm], max_evaluations: int = MAX_EVALUATIONS
    ) -> Self:
        """Return the fit with these causes, started from the values of this fit."""
        refitted = refit_with_terms(self.solution, fitted_terms, max_evaluations)
        space = type(self)(refitted, self.effort)
        self.effort.add(space)
        return space

    def changes_law(self, term: Term) -> bool:
        """Return whether a cause changes the motion law of the unit."""
        return term.law_quantity is not None and bool(unit_references(self.solution))

    def parameter_shift(self, other: Self) -> FloatArray:
        """Return the change of G, the stated b and the stated tau to another fit, (board,)."""
        layout = ParameterLayout.of([()], len(self.solution.sessions))
        shift = np.zeros(layout.size)
        index = layout.index(
            len(self.solution.sessions) - 1, offset_recording=self.offset_recording
        )
        before, after = (fit.solution.estimate[: index.size] for fit in (self, other))
        shift[index] = after - before
        return shift

    def release_caches(self) -> None:
        """Free the caches of the sessions, which they compute again when needed."""
        self.solution.release_caches()

    def confirm(self) -> Self:
        """Return the fit, continued if new derivatives would change its values."""
        return type(self)(confirm_fit(self.solution), self.effort)

    def refit_gain(self) -> Self:
        """Return the fit with its gain searched again if a threshold or limit hides rates."""
        refitted = refit_gain_exactly(self.solution, self.effort)
        return self if refitted is self.solution else type(self)(refitted, self.effort)

    def negative_log_likelihood(self, noise_of: Self) -> float:
        """Return the negative log-likelihood of the fit at the typical noise levels of another."""
        noises = [limit_to_typical(noise) for noise in noise_of.solution.noises]
        return negative_log_likelihood(self.solution, noises)

    def log_likelihoods(self, models: Sequence[Self]) -> list[float]:
        """Return the log-likelihood of each model, up to a constant, at this fit's typical noise.

        Only blocks that all models use take part, because outliers and blocks with uncertain timing
        differ between models.
        """
        noises = [limit_to_typical(noise) for noise in self.solution.noises]
        used = [
            np.logical_and.reduce(masks)
            for masks in zip(*(model.solution.used_blocks() for model in models), strict=True)
        ]
        return [self._log_likelihood(model.solution, noises, used) for model in models]

    def _log_likelihood(
        self, solution: ConvergedFit, noises: Sequence[NoiseModel], used: Sequence[BoolArray]
    ) -> float:
        """Return the log-likelihood of one model, with the noise in motion of this fit."""
        masks = iter(used)
        total = 0.0
        for session, own_session, noise in zip(
            solution.sessions, self.solution.sessions, noises, strict=True
        ):
            total -= reference_cost(session.reference)
            residuals = session.residuals(solution.gain)
            for index, (series, residual) in enumerate(zip(session.series, residuals, strict=True)):
                mask = next(masks)
                masked = np.where(mask[:, None], residual, 0.0)
                stds = [own_session.relative_std(index, blocks) for blocks in series.part_slices()]
                total -= residual_cost(series, masked, mask, noise, stds)
        return total

    def noise_alternative(
        self, candidate: FittedCandidate, trials: float, extended: Self, tests: int
    ) -> NoiseAlternative | None:
        """Return a candidate that the fitted noise levels do not confirm; None if they do.

        The candidate is confirmed if its gain is significant with noise levels that are fitted
        in both models. If the bias has a real random walk, a step does not explain the walk.
        The candidate is also confirmed if its gain is significant with the levels that were fitted
        without it. With enough rests, these levels come from the rests only. They then contain no
        effects at the edges of moves, which a random walk of the bias does not produce.
        """
        # A random walk of the bias does not imitate a change of the moves, which the replies show.
        if self.has_typical_noise or self.changes_law(candidate.extension.term):
            return None
        before, after, extension = self.solution, extended.solution, candidate.extension
        gain_nats = whittle_log_likelihood(after) - whittle_log_likelihood(before)
        with_levels = replace(candidate, delta_log_likelihood=gain_nats)
        if global_p_value(with_levels, trials, tests) < FALSE_ALARM_RATE:
            return None
        refitted = fit_candidate(
            self.projector(), extension.term, candidate.place, [extension.values]
        )
        if refitted is not None and global_p_value(refitted, trials, tests) < FALSE_ALARM_RATE:
            return None
        occam_nats = candidate.delta_log_likelihood - candidate.log_evidence
        evidence = whittle_log_evidence(after, typical=True) - whittle_log_evidence(before)
        return NoiseAlternative(candidate, trials, gain_nats, evidence - occam_nats)

    def reduced_chi2(self) -> float:
        """Return the reduced chi-square of the residual."""
        return reduced_chi2(self.solution)

    def calibration(self) -> CalibrationValues:
        """Return the calibration parameters of the fit."""
        return CalibrationValues.of(self.solution)

    def dependence_tests(self, projector: NuisanceProjector) -> list[DependenceTest]:
        """Test the residual for smooth functions, and the bias for a random walk."""
        if self.has_typical_noise:
            return residual_dependence_tests(projector)
        tests = limited_dependence_tests(
            projector.states,
            partial(self.projector, typical=True),
            partial(build_usual_projector, self.solution),
        )
        return most_significant([*tests, measure_bias_walk(self.solution)])
