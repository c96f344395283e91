"""Specification tests: a named cause against smooth functions of its covariates.

An unknown effect is often close to the form of a catalogue cause, which then is significant and
better than all other causes. Each named cause is therefore tested against

 * smooth functions of its covariates (`covariates` of the term);
 * its own effect, modulated by the time, the angles and the speed, on which its size must not
   depend.

Both are score tests with the cause, its sizes, shapes and event free. If the cause is right, the
statistic of d signals is chi-squared with d degrees of freedom. The choice among sets is corrected
by Bonferroni; a right cause is rejected in at most `REJECTION_LEVEL` of sessions. A cause of an
angle is also rejected if a smooth function of that angle is decisively more probable. An excess
below `NEGLIGIBLE_SHARE` of the explained statistic is ignored, because no form is exact.

What to use when: `reject_misnamed` after a search; `find_partial_explanations` and `refit_without`
where part of the residual is unexplained.

Source: score test, Rao, Linear Statistical Inference, 6e; smooth tests of fit, Neyman 1937.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.data.arrays import FloatArray
from gyrorig_solver.discover.cause_findings import DependenceTest
from gyrorig_solver.discover.cause_search import MODEL_ERROR_SHARE, RankedCause, SearchResult
from gyrorig_solver.discover.checks.residual_dependence import (
    choose_detail,
    smooth_function_evidence,
)
from gyrorig_solver.discover.checks.smooth_alternatives import (
    BasisFamily,
    modulated_effects,
    smooth_families,
)
from gyrorig_solver.discover.exact_fit import FittedCandidate
from gyrorig_solver.estimate.converged_fit import ConvergedFit
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.likelihood_fit import refit_with_terms
from gyrorig_solver.estimate.nuisance_projector import NuisanceProjector
from gyrorig_solver.estimate.whitened_signals import join_signals
from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import ANGLE_COVARIATES, value_indices

REJECTION_LEVEL = (
    0.005  # share of right names that may be dropped: a quarter of what names may be lost
)
NEGLIGIBLE_SHARE = MODEL_ERROR_SHARE  # share of a cause's own statistic
DECISIVE_NATS = 4.6  # nats, odds of a hundred: Jeffreys, Theory of Probability, appendix B
WHOLE_STEP_SIGMA = 5.0  # that a loss must lie below a step to be none


@dataclass(frozen=True, slots=True)
class SpecificationTest:
    """A test of a named cause against a smooth function of a covariate."""

    covariate: str
    description: str
    statistic: float  # that they explain beyond the name
    degrees_of_freedom: int
    p_value: float  # all comparisons counted


def reject_misnamed(
    base: ConvergedFit, result: SearchResult
) -> tuple[SearchResult, tuple[DependenceTest, ...]]:
    """Return the search result without misspecified causes, and the tests that reject them.

    Args:
        base: the fit of the base model.
        result: where the search ended.
    """
    fitted = [
        extension for extension in result.solution.fitted_terms if extension.free_indices.size
    ]
    failures = [
        find_misspecification(result, extension, ranked)
        for extension, ranked in zip(fitted, result.ranked_causes, strict=True)
    ]
    if not any(failures):
        return result, ()
    failed = sorted(
        (extension for extension in failures if extension is not None),
        key=lambda extension: extension.p_value,
    )
    dependence_tests = tuple(
        DependenceTest(
            failure.covariate,
            failure.description,
            failure.statistic,
            failure.degrees_of_freedom,
            failure.p_value,
        )
        for failure in failed
    )
    return refit_without(
        base, result, [extension is not None for extension in failures]
    ), dependence_tests


def find_partial_explanations(
    result: SearchResult, dependences: Sequence[DependenceTest], min_share: float
) -> list[bool]:
    """Return which causes explain only a part of a larger effect of the same covariate.

    If the residual still depends as strongly on a covariate of the cause, the cause can be a part
    of a larger effect. This does not apply to causes of another kind.

    Args:
        result: where the search ended.
        dependences: significant residual dependences of its fit.
        min_share: of both that a cause must explain.
    """
    partial = []
    for ranked in result.ranked_causes:
        covariates = ranked.candidate.extension.term.covariates
        excesses = [
            test.statistic - test.degrees_of_freedom
            for test in dependences
            if covariates is None or test.covariate in covariates
        ]
        gain_nats = (
            ranked.candidate.delta_log_likelihood
            if ranked.board_gain_nats is None
            else ranked.board_gain_nats
        )
        named_statistic = 2.0 * max(gain_nats, 0.0)
        partial.append(named_statistic < min_share * (named_statistic + max(excesses, default=0.0)))
    return partial


def refit_without(
    base: ConvergedFit, result: SearchResult, removed: Sequence[bool]
) -> SearchResult:
    """Return the search result without some of its causes, all else refitted.

    If the fit with the other causes does not converge, all causes are removed.

    Args:
        base: the fit of the base model.
        result: where the search ended.
        removed: which of its standings.
    """
    fitted = [
        extension for extension in result.solution.fitted_terms if extension.free_indices.size
    ]
    removed_terms = [
        extension for extension, is_removed in zip(fitted, removed, strict=True) if is_removed
    ]
    others = [
        extension
        for extension in result.solution.fitted_terms
        if all(extension is not other for other in removed_terms)
    ]
    solution = base if all(removed) else refit_with_terms(result.solution, others)
    if not solution.converged:
        solution = refit_with_terms(base, others)
    if not solution.converged:
        solution, removed = base, [True] * len(removed)
    ranked_causes = tuple(
        ranked
        for ranked, is_removed in zip(result.ranked_causes, removed, strict=True)
        if not is_removed
    )
    return replace(
        result,
        solution=solution,
        ranked_causes=ranked_causes,
        projector=NuisanceProjector.at_fit(solution),
    )


def find_misspecification(
    result: SearchResult, extension: FittedTerm, ranked: RankedCause
) -> SpecificationTest | None:
    """Return the test that rejects a cause's form; None if the form is accepted.

    Args:
        result: where the search ended.
        extension: a cause of its fit.
        ranked: its own.
    """
    projection, explained_statistic = result.projector, 2.0 * ranked.candidate.delta_log_likelihood
    if extension.term.is_whole_steps and _is_below_one_step(result.solution, extension):
        description = "on a jump of less than one step"
        return SpecificationTest("pan_transient", description, explained_statistic, 1, 0.0)
    scenes = projection.states
    covariates = extension.term.covariates or ()
    basis_families = [
        (family, False) for family in smooth_families(scenes) if family.covariate in covariates
    ]
    basis_families += [(family, True) for family in modulated_effects(extension, scenes)]
    tests = [
        nonparametric_specification_test(projection, extension, family, is_modulation)
        for family, is_modulation in basis_families
    ]
    worst = min(
        (test for test in tests if test is not None), key=lambda test: test.p_value, default=None
    )
    if worst is not None:
        worst = replace(worst, p_value=min(1.0, worst.p_value * len(basis_families)))
        excess = worst.statistic - worst.degrees_of_freedom
        if worst.p_value < REJECTION_LEVEL and excess > NEGLIGIBLE_SHARE * explained_statistic:
            return worst
    return _likelier_angle_function(result.solution, extension, ranked.candidate)


def _likelier_angle_function(
    solution: ConvergedFit, extension: FittedTerm, candidate: FittedCandidate
) -> SpecificationTest | None:
    """Return a smooth function of an angle that is far more probable than the cause; None for none.

    A form with a few unknowns can be bent so that it leaves little of another function of the
    angle, at sizes that cancel over the range that was seen. Its evidence pays for that.

    Args:
        solution: the fit that the cause is in.
        extension: the cause as fitted.
        candidate: the same cause as the search compared it.
    """
    angle_covariates = [
        name for name in (extension.term.covariates or ()) if name in ANGLE_COVARIATES
    ]
    if not angle_covariates:
        return None
    others = [other for other in solution.fitted_terms if other is not extension]
    projector = NuisanceProjector.at_fit(
        solution, followed_terms=others, restored_terms=[extension]
    )
    for family in smooth_families(projector.states):
        if family.covariate in angle_covariates:
            lead_nats = (
                smooth_function_evidence(family.statistics(projector), family.detail)
                - candidate.log_evidence
            )
            if lead_nats > max(DECISIVE_NATS, NEGLIGIBLE_SHARE * candidate.delta_log_likelihood):
                relative_odds = float(np.exp(-lead_nats))
                return SpecificationTest(
                    family.covariate, family.description, 2.0 * lead_nats, 1, relative_odds
                )
    return None


def nonparametric_specification_test(
    projection: NuisanceProjector, extension: FittedTerm, family: BasisFamily, is_modulation: bool
) -> SpecificationTest | None:
    """Return the score test of a basis family in addition to a cause; None if nothing is testable.

    Args:
        projection: the nuisance projector at the fit with the cause.
        extension: the cause as fitted.
        family: the free functions.
        is_modulation: whether they are made of the cause's own effect.
    """
    nuisance_indices = (
        *value_indices(extension.term, role="shape"),
        *value_indices(extension.term, role="event"),
    )
    held_indices = [k for k in nuisance_indices if k not in extension.free_indices]

    def shaped(scene: SignalState) -> FloatArray:
        return extension.term.jacobian(scene, extension.values)[held_indices]

    if held_indices or is_modulation:
        whitened = family.whitened(projection, extension.term if is_modulation else None)
        if held_indices:
            whitened = join_signals(
                [projection.evaluate_signals(shaped, term=extension.term), whitened]
            )
        statistics = projection.score_statistics(whitened)
    else:
        statistics = family.statistics(projection)
    detail_test = choose_detail(statistics, family.detail, nuisance_count=len(held_indices))
    if detail_test is None:
        return None
    score_test = detail_test.score_test
    return SpecificationTest(
        family.covariate,
        family.description,
        score_test.statistic,
        score_test.degrees_of_freedom,
        detail_test.p_value,
    )


def _is_below_one_step(solution: ConvergedFit, extension: FittedTerm) -> bool:
    """Return whether a loss is significantly less than one step, which no motor loses."""
    context = solution.sessions[0].context
    if context is None or context.rad_per_step is None:
        return False
    sizes = value_indices(extension.term, role="size")
    first = solution.estimate.size - sum(
        extension.free_indices.size for extension in solution.fitted_terms
    )
    for other in solution.fitted_terms:
        if other is extension:
            break
        first += other.free_indices.size
    for j, k in enumerate(extension.free_indices):
        if k in sizes and extension.values[k] != 0.0:
            step = abs(context.rad_per_step[sizes.index(int(k))])
            std = float(np.sqrt(solution.observability.covariance[first + j, first + j]))
            if abs(float(extension.values[k])) > step - WHOLE_STEP_SIGMA * std:
                return False
    return True
