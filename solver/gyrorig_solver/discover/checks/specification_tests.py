"""Specification tests: a named cause against smooth functions of its covariates.

An unknown effect is often similar to the form of a cause of the catalogue. This cause is then
significant and better than all other causes. Therefore each named cause is tested against

 * smooth functions of its covariates (`covariates` of the term);
 * its own effect, modulated by the time, the angles and the speed, on which its size must not
   depend.

Both are score tests with the cause in the model, its sizes, shapes and event free. If the cause is
right, the statistic of d signals is chi-squared with d degrees of freedom. The p-value includes a
Bonferroni correction for the choice among sets. A right cause is rejected in at most
`REJECTION_LEVEL` of sessions. A cause of an angle is also rejected if a smooth function of that
angle is decisively more probable. A cause of the time is also rejected if the heat of the motors is
decisively more probable (`motor_heat`). An excess below `NEGLIGIBLE_SHARE` of the explained
statistic is ignored, because no form is exact. A rejected cause keeps its name if it explains far
more than a smooth function alone; see decisions 0071 and 0078.

What to use when: `SpecificationCheck` after a search.

Source: score test, Rao, Linear Statistical Inference, 6e; smooth tests of fit, Neyman 1937.
"""

from dataclasses import replace

from gyrorig_solver.data import FloatArray
from gyrorig_solver.discover.candidate_fits import global_p_value
from gyrorig_solver.discover.cause_findings import DependenceTest
from gyrorig_solver.discover.cause_ranking import MODEL_ERROR_SHARE, RankedCause
from gyrorig_solver.discover.checks.basis_family import BasisFamily
from gyrorig_solver.discover.checks.model_check import JudgedModel, Verdict
from gyrorig_solver.discover.checks.motor_heat import motor_heat_families
from gyrorig_solver.discover.checks.residual_dependence import (
    choose_detail,
    find_likelier_function,
    smooth_function_evidence,
)
from gyrorig_solver.discover.checks.smooth_alternatives import (
    modulated_effects,
    smooth_families,
)
from gyrorig_solver.discover.fit_space import FitSpace, Space
from gyrorig_solver.discover.fitted_values import value_stds
from gyrorig_solver.estimate import FittedTerm, NuisanceProjector, join_signals
from gyrorig_solver.model import SignalState, recording_index_of, value_indices
from gyrorig_solver.model.cause_categories import ANGLE_COVARIATES

# Share of right names that the test may reject: a quarter of the right names that may be lost.
REJECTION_LEVEL = 0.005
NEGLIGIBLE_SHARE = MODEL_ERROR_SHARE  # share of a cause's own statistic
# Share of a cause's gain by which it must lead a smooth function: half of the effect has its form.
FORM_ERROR_SHARE = 0.5
LONE_FORM_SHARE = 0.2  # the same, if only model error is left in addition to the cause
DECISIVE_NATS = 4.6  # odds of a hundred: Jeffreys, Theory of Probability, appendix B
WHOLE_STEP_SIGMA = 5.0  # standard uncertainties by which a rejected loss is below one step


class SpecificationCheck:
    """Removes the names of causes whose form a smooth function of their covariates rejects."""

    removes_names = True

    def judge(self, model: JudgedModel[Space]) -> Verdict:
        """Return the causes with a wrong form, and the tests that reject them."""
        failures = [find_misspecification(model, k, ranked) for k, ranked in model.fitted_causes]
        rejecting = sorted((test for test in failures if test), key=lambda test: test.p_value)
        removed = [
            test is not None and not is_better_than_functions(model, k, ranked)
            for test, (k, ranked) in zip(failures, model.fitted_causes, strict=True)
        ]
        return Verdict(tuple(removed), tuple(rejecting))


def is_better_than_functions(model: JudgedModel[Space], k: int, ranked: RankedCause) -> bool:
    """Return whether a cause and a smooth function are far more probable than a function alone.

    Then the effect has the form of the cause, and a second effect acts as well. The name stays, and
    the rest is reported in addition to it. The second effect must be smaller than the cause. With a
    larger unknown effect, the cause can be the part of it that no smooth function follows. If the
    rest is not larger than the error of a right form, there is no second effect. A smaller lead is
    then enough.

    Args:
        model: the model with the cause.
        k: index of the cause in its fit.
        ranked: the ranking of the cause.
    """
    candidate, term = ranked.candidate, model.space.fitted_terms[k].term
    beside_nats = best_function_nats(model.result.projector)
    if term.is_whole_steps or beside_nats > candidate.log_evidence:
        return False
    alone_nats = best_function_nats(model.space.projector_without(k))
    lead_nats = candidate.log_evidence + beside_nats - alone_nats
    explained_nats = candidate.delta_log_likelihood
    is_alone = beside_nats <= NEGLIGIBLE_SHARE * explained_nats
    needed_share = LONE_FORM_SHARE if is_alone else FORM_ERROR_SHARE
    return lead_nats > max(DECISIVE_NATS, needed_share * explained_nats)


def best_function_nats(projector: NuisanceProjector, covariate: str | None = None) -> float:
    """Return the log evidence of the most probable smooth function, relative to no function.

    Args:
        projector: the nuisance projector at a fit.
        covariate: the covariate of the functions; None: all covariates.
    """
    nats_of_function: dict[tuple[str, str], float] = {}
    for family in (*smooth_families(projector.states), *motor_heat_families(projector.states)):
        if covariate not in (None, family.covariate):
            continue
        # Each recording has its own function of the time. Their evidences add.
        is_limited = family.recording_index is not None
        function = (family.covariate, "" if is_limited else family.description)
        evidence_nats = smooth_function_evidence(family.statistics(projector), family.detail)
        nats_of_function[function] = nats_of_function.get(function, 0.0) + evidence_nats
    return max(nats_of_function.values(), default=0.0)


def find_misspecification(
    model: JudgedModel[Space], k: int, ranked: RankedCause
) -> DependenceTest | None:
    """Return the test that rejects a cause's form; None if the form is accepted.

    Args:
        model: the model with the cause.
        k: index of the cause in its fit.
        ranked: the ranking of the cause.
    """
    projection, extension = model.result.projector, model.space.fitted_terms[k]
    explained_statistic = 2.0 * ranked.candidate.delta_log_likelihood
    if extension.term.is_whole_steps and _is_below_one_step(model.space, projection, k):
        description = "on a jump of less than one step"
        p_value = global_p_value(ranked.candidate, ranked.effective_trials, model.tests)
        return DependenceTest("pan_transient", description, explained_statistic, 1, p_value)
    scenes = projection.states
    covariates = extension.term.covariates or ()
    candidates = [
        (family, False) for family in smooth_families(scenes) if family.covariate in covariates
    ]
    candidates += [(family, True) for family in modulated_effects(extension, scenes)]
    recording_index = recording_index_of(extension.term)
    basis_families = [  # another recording cannot reject a cause of one recording
        (family, is_modulation)
        for family, is_modulation in candidates
        if recording_index is None or family.recording_index in (None, recording_index)
    ]
    tests = [
        nonparametric_specification_test(projection, extension, family, is_modulation)
        for family, is_modulation in basis_families
    ]
    worst = min(
        (test for test in tests if test is not None), key=lambda test: test.p_value, default=None
    )
    if worst is not None:
        worst = replace(worst, p_value=min(1.0, worst.p_value * len(basis_families)))
        is_relevant = worst.excess > NEGLIGIBLE_SHARE * explained_statistic
        if worst.p_value < REJECTION_LEVEL and is_relevant:
            return worst
    return _likelier_function(model.space, k, ranked)


def _likelier_function(space: FitSpace, k: int, ranked: RankedCause) -> DependenceTest | None:
    """Return the test of a smooth function that is far more probable than a cause; None if none is.

    The functions are those of the angles of the cause. A form with a few unknowns can imitate
    another function of the angle, with large sizes that cancel over the measured range. The
    evidence of the cause contains the penalty for these sizes. A cause of the time also competes
    with a bias that follows the heat of the motors.
    """
    term, candidate = space.fitted_terms[k].term, ranked.candidate
    covariates = term.covariates or ()
    angle_covariates = [name for name in covariates if name in ANGLE_COVARIATES]
    is_slow = "bias_time" in covariates and term.template_search != "spectral_lines"
    if not angle_covariates and not is_slow:
        return None
    projector = space.projector_without(k)
    families = [
        family
        for family in (smooth_families(projector.states) if angle_covariates else ())
        if family.covariate in angle_covariates
    ]
    families += motor_heat_families(projector.states) if is_slow else []
    needed_nats = max(DECISIVE_NATS, NEGLIGIBLE_SHARE * candidate.delta_log_likelihood)
    return find_likelier_function(projector, families, candidate.log_evidence, needed_nats)


def nonparametric_specification_test(
    projection: NuisanceProjector, extension: FittedTerm, family: BasisFamily, is_modulation: bool
) -> DependenceTest | None:
    """Return the score test of a basis family in addition to a cause; None if nothing is testable.

    Args:
        projection: the nuisance projector at the fit with the cause.
        extension: the cause as fitted.
        family: the smooth functions.
        is_modulation: whether they are modulations of the cause's own effect.
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
    test = choose_detail(statistics, family.detail, nuisance_count=len(held_indices))
    return None if test is None else test.on(family.covariate, family.description)


def _is_below_one_step(space: FitSpace, projector: NuisanceProjector, k: int) -> bool:
    """Return whether a loss is significantly smaller than one step, which is not possible."""
    steps = (state.context.rad_per_step for state in projector.states)
    rad_per_step = next((step for step in steps if step is not None), None)
    if rad_per_step is None:
        return False
    extension, stds = space.fitted_terms[k], value_stds(space, k)
    sizes = value_indices(extension.term, role="size")
    for index in extension.free_sizes:
        if extension.values[index] != 0.0:
            step = abs(rad_per_step[sizes.index(index)])
            if abs(float(extension.values[index])) > step - WHOLE_STEP_SIGMA * stds[index]:
                return False
    return True
