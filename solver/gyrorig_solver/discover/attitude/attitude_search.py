"""Search for causes with reference attitudes: score all causes, fit the leading ones.

What to use when: `search_attitude_causes` for the named causes, each with its compared rivals.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.discover.attitude.window_gains import cross_validate_space
from gyrorig_solver.discover.cause_search import FALSE_ALARM_RATE, confusable_labels, fit_best_place
from gyrorig_solver.discover.exact_fit import FittedCandidate, fit_candidate
from gyrorig_solver.discover.score_tests import CandidateScore, scan_catalogue
from gyrorig_solver.estimate.attitude.attitude_projector import AttitudeProjector
from gyrorig_solver.model.recording_scope import term_label
from gyrorig_solver.model.term import Term
from gyrorig_solver.numerics import chi2_upper_tail

MAX_CANDIDATES = 5  # fitted exactly at a time
MAX_CAUSES = 6
REFIT_SWEEPS = 3  # in which every named cause is fitted again with the others


@dataclass(frozen=True, slots=True, eq=False)
class RankedAttitudeCause:
    """A fitted cause with its ranked alternatives, all other causes fitted."""

    candidate: FittedCandidate
    effective_trials: float
    rivals: tuple[tuple[FittedCandidate, float], ...]
    posterior: float


def search_attitude_causes(
    space: AttitudeProjector, terms: Sequence[Term], tests: int
) -> list[RankedAttitudeCause]:
    """Name and fit the causes of a residual against attitudes by stepwise selection.

    Args:
        space: the nuisance projector at the base model's fit.
        terms: to look for.
        tests: how many of them share the false alarms.
    """
    ranked_causes: list[RankedAttitudeCause] = []
    excluded: set[str] = set()
    while len(ranked_causes) < MAX_CAUSES:
        fitted_labels = {term_label(ranked.candidate.extension.term) for ranked in ranked_causes}
        extended_space = space.with_terms([ranked.candidate.extension for ranked in ranked_causes])
        usable_terms = [term for term in terms if term_label(term) not in fitted_labels | excluded]
        scores = scan_catalogue(extended_space, usable_terms, tests)
        best = _select_leading(extended_space, scores, tests, usable_terms)
        if best is None:
            break
        trial = _refit_all(space, [*ranked_causes, best], terms, tests)
        confirmed = [
            ranked
            for ranked in trial
            if _improves_held_out(space, trial, ranked) and _is_significant(ranked, tests)
        ]
        if len(confirmed) < len(trial):
            dropped = {
                term_label(ranked.candidate.extension.term)
                for ranked in trial
                if ranked not in confirmed
            }
            excluded |= dropped
            if term_label(best.candidate.extension.term) in dropped:
                continue  # the others stand as they were
            trial = _refit_all(space, confirmed, terms, tests)
        ranked_causes = trial
    return ranked_causes


def _select_leading(
    space: AttitudeProjector, scores: Sequence[CandidateScore], tests: int, terms: Sequence[Term]
) -> RankedAttitudeCause | None:
    """Return the candidate with the most evidence among the best scores."""
    strength: dict[str, float] = {}
    for score in scores:
        if score.p_value < FALSE_ALARM_RATE:
            excess = score.score_test.statistic - score.score_test.degrees_of_freedom
            strength[term_label(score.term)] = max(
                strength.get(term_label(score.term), -np.inf), excess
            )
    order = sorted(strength, key=lambda cause: -strength[cause])[:MAX_CANDIDATES]
    if not order:
        return None
    by_cause = {term_label(term): term for term in terms}
    confusable = set().union(*(confusable_labels(by_cause[name], terms) for name in order[:1]))
    order += [name for name in sorted(confusable) if name in by_cause and name not in order]
    candidates = []
    for cause in order:
        fitted = fit_best_place(
            space, [score for score in scores if term_label(score.term) == cause]
        )
        if fitted is not None:
            candidates.append(fitted)
    candidates.sort(key=lambda pair: -pair[0].log_evidence)
    for k, (candidate, trials) in enumerate(candidates):
        if candidate_p_value(candidate, trials, tests) < FALSE_ALARM_RATE:
            return _rank(
                candidate, trials, [other for j, (other, _) in enumerate(candidates) if j != k]
            )
    return None


def _refit_all(
    space: AttitudeProjector,
    previous: Sequence[RankedAttitudeCause],
    terms: Sequence[Term],
    tests: int,
) -> list[RankedAttitudeCause]:
    """Refit each cause together with all others, and its confusable causes instead of it."""
    ranked_causes = list(previous)
    by_cause = {term_label(term): term for term in terms}
    for sweep in range(REFIT_SWEEPS if len(ranked_causes) > 1 else 1):
        for k, ranked in enumerate(ranked_causes):
            others = [f.candidate.extension for j, f in enumerate(ranked_causes) if j != k]
            reduced_space = space.with_terms(others)
            extension = ranked.candidate.extension
            refitted = fit_candidate(
                reduced_space, extension.term, ranked.candidate.place, [extension.values]
            )
            if refitted is None:
                continue
            rivals = [r for r, _ in ranked.rivals]
            if sweep == 0:
                taken = {term_label(e.term) for e in others} | {term_label(extension.term)}
                confusable = sorted(confusable_labels(extension.term, terms) - taken)
                scores = scan_catalogue(
                    reduced_space, [by_cause[c] for c in confusable if c in by_cause], tests
                )
                fitted = [
                    fit_best_place(reduced_space, [s for s in scores if term_label(s.term) == c])
                    for c in confusable
                ]
                earlier_rivals = [
                    r for r in rivals if term_label(r.extension.term) not in {*confusable, *taken}
                ]
                refitted_rivals = [
                    fit_candidate(reduced_space, r.extension.term, r.place, [r.extension.values])
                    for r in earlier_rivals
                ]
                rivals = [f[0] for f in fitted if f is not None]
                rivals += [r for r in refitted_rivals if r is not None and not r.infeasible]
            ranked_causes[k] = _rank(refitted, ranked.effective_trials, rivals)
    return ranked_causes


def _rank(
    best: FittedCandidate, effective_trials: float, rivals: Sequence[FittedCandidate]
) -> RankedAttitudeCause:
    evidence = np.array([best.log_evidence, *(rival.log_evidence for rival in rivals)])
    posterior = np.exp(evidence - evidence.max())
    posterior /= posterior.sum()
    order = np.argsort(-evidence[1:], kind="stable")
    ranked = tuple((rivals[j], float(posterior[1 + j])) for j in order)
    return RankedAttitudeCause(best, effective_trials, ranked, float(posterior[0]))


def candidate_p_value(candidate: FittedCandidate, effective_trials: float, tests: int) -> float:
    """Return the global p-value of a candidate, templates and tests counted."""
    free = candidate.extension.free_indices.size
    return min(
        1.0,
        chi2_upper_tail(2.0 * max(candidate.delta_log_likelihood, 0.0), free)
        * effective_trials
        * tests,
    )


def _is_significant(ranked: RankedAttitudeCause, tests: int) -> bool:
    return (
        not ranked.candidate.infeasible
        and candidate_p_value(ranked.candidate, ranked.effective_trials, tests) < FALSE_ALARM_RATE
    )


def _improves_held_out(
    space: AttitudeProjector,
    ranked_causes: Sequence[RankedAttitudeCause],
    ranked: RankedAttitudeCause,
) -> bool:
    """Return whether a cause improves the prediction of held-out windows."""
    extended_space = space.with_terms([cause.candidate.extension for cause in ranked_causes])
    _, gain_by_cause = cross_validate_space(extended_space)
    return (
        gain_by_cause is None
        or gain_by_cause[list(ranked_causes).index(ranked)].log_likelihood.value > 0.0
    )
