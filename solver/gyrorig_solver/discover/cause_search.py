"""Stepwise selection of causes: significant causes are named and fitted one after the other.

Forward: all causes are scored, the best candidates and their confusable causes are fitted
exactly, and the candidate with the most evidence is added to the full fit, until no cause is
significant. Backward: a cause that the others make redundant is removed. At the end each cause is
compared with all alternatives, all else fitted, and can be replaced. A fit that does not converge
is no reason for any of these moves. The result is the model with the most evidence of all that the
search visited.

What to use when: `search_causes` for the whole search; `rank_against_alternatives` for one cause.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyrorig_solver.data.arrays import FloatArray
from gyrorig_solver.discover.checks.backward_elimination import eliminate_backward
from gyrorig_solver.discover.checks.typical_noise import (
    build_projector,
    has_typical_noise,
    whittle_log_evidence,
    whittle_log_likelihood,
)
from gyrorig_solver.discover.exact_fit import FittedCandidate, fit_candidate
from gyrorig_solver.discover.gain_refit import refit_gain_exactly
from gyrorig_solver.discover.model_evidence import best_model
from gyrorig_solver.discover.reply_candidate import candidate_from_replies
from gyrorig_solver.discover.score_tests import CandidateScore, scan_catalogue, testable_places
from gyrorig_solver.discover.template_choice import all_templates
from gyrorig_solver.estimate.converged_fit import ConvergedFit
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.estimate.likelihood_fit import refit_with_terms
from gyrorig_solver.estimate.nuisance_projector import NuisanceProjector
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.model.recording_scope import limit_to_recording, recording_index_of, term_label
from gyrorig_solver.model.term import Term, value_indices, value_parameters
from gyrorig_solver.numerics import chi2_upper_tail

# Share of recordings without any cause that may get a name. The tests overlap: 157 such
# recordings had three quarters of the false names that their sum allows. A little is left to
# the nameless groups, which have to see only what is large and no cause of the catalogue.
FALSE_ALARM_RATE = 0.0075
MAX_CANDIDATES = 4  # fitted exactly at a time
MIN_STATISTIC_SHARE = 0.2  # of the leading statistic: a cause that sees less is not fitted
PLACE_MARGIN = 25.0  # a place alone this much below all places together is not fitted alone,
JOINT_MARGIN = 3.0  # and all together not where they see no more than this beyond the best one
MAX_CAUSES = 12
CREDIBLE_SET_LEVEL = 0.95  # belief that the stated set holds the cause
MAX_NOISE_ALTERNATIVES = (
    3  # causes significant only with typical noise levels: the bias has a random walk
)
MAX_SWAPS = 4  # times that named causes may lose their place in the end
MIN_EVIDENCE_LEAD_NATS = 1.0  # nats of evidence that a rival must be ahead by
# Share of a cause's statistic: twice what its form may leave of its effect without any noise
# (measured on sessions without noise: 0.2 %).
MODEL_ERROR_SHARE = 0.004


@dataclass(frozen=True, slots=True, eq=False)
class RankedCause:
    """A fitted cause with its ranked alternatives, all other causes fitted."""

    candidate: FittedCandidate
    effective_trials: float
    rivals: tuple[tuple[FittedCandidate, float], ...]  # other causes and their posterior
    posterior: float
    board_gain_nats: float | None = None  # nats won on this board, where several share it

    def with_gain_limit(self, gains_by_label: Mapping[str, float]) -> "RankedCause":
        """Return it with at most the gain that a refit without the cause confirms."""
        nats = gains_by_label.get(term_label(self.candidate.extension.term), np.inf)
        return (
            self
            if nats >= self.candidate.delta_log_likelihood
            else replace(self, candidate=replace(self.candidate, delta_log_likelihood=nats))
        )

    @property
    def one_of(self) -> tuple[str, ...]:
        """The other causes of the credible set."""
        names, total = [], self.posterior
        for rival, share in self.rivals:
            if total >= CREDIBLE_SET_LEVEL:
                break
            names.append(rival.extension.term.cause)
            total += share
        equivalent = self.candidate.extension.term.equivalent_causes
        return (*names, *(name for name in equivalent if name not in names))


@dataclass(frozen=True, slots=True, eq=False)
class NoiseAlternative:
    """A cause that is significant with typical noise levels only; a bias walk may explain it."""

    candidate: FittedCandidate
    effective_trials: float
    likelihood_gain_nats: (
        float  # nats; noise levels fitted with the cause, compared with levels without it
    )
    log_evidence: float  # of the cause with a typical bias, against a random walk without it

    @classmethod
    def of(
        cls, selection: "_Selection", before: ConvergedFit, after: ConvergedFit
    ) -> "NoiseAlternative":
        """Compare a cause with a random walk of the bias."""
        candidate = selection.candidate
        occam_nats = candidate.delta_log_likelihood - candidate.log_evidence
        likelihood_gain = whittle_log_likelihood(after) - whittle_log_likelihood(before)
        evidence = (
            whittle_log_evidence(after, typical=True) - whittle_log_evidence(before) - occam_nats
        )
        return cls(candidate, selection.effective_trials, likelihood_gain, evidence)


@dataclass(frozen=True, slots=True, eq=False)
class SearchResult:
    """The result of a search: the extended fit, its causes, and the scores of the other causes."""

    solution: ConvergedFit
    ranked_causes: tuple[RankedCause, ...]  # of each extension of the fit, in their order
    projector: NuisanceProjector
    scores: tuple[CandidateScore, ...]  # of the residual
    noise_alternatives: tuple[NoiseAlternative, ...] = ()  # if the bias has a random walk
    remarks: tuple[str, ...] = ()  # on candidates whose fit did not converge


@dataclass(frozen=True, slots=True, eq=False)
class _Selection:
    """The candidate with the most evidence of one iteration."""

    candidate: FittedCandidate
    effective_trials: float
    considered: frozenset[str]  # all compared causes


def testable_terms(projection: NuisanceProjector) -> list[Term]:
    """Return the testable causes, without those that are equal to another one to first order."""
    terms = [term for term in catalogue().values() if not term.first_order_equivalent]
    return [instance for term in terms for instance in testable_instances(term, projection)]


def testable_instances(term: Term, projection: NuisanceProjector) -> list[Term]:
    """Return a cause if it is testable, once per recording if its scope is the recording."""
    recording_numbers = sorted({scene.context.recording_index for scene in projection.states})
    per_recording = term.scope == "recording" and len(recording_numbers) > 1
    return [
        instance
        for instance in (
            [limit_to_recording(term, number) for number in recording_numbers]
            if per_recording
            else [term]
        )
        if instance.kind == "effect"
        and all(instance.reason_not_testable(scene) is None for scene in projection.states)
    ]


def count_tests(terms: Sequence[Term]) -> int:
    """Return the number of tests that share the false-alarm rate."""
    return sum(len(testable_places(term)) for term in terms)


def search_causes(base: ConvergedFit) -> SearchResult:
    """Name and fit the causes of a fit's residual by stepwise selection."""
    return _Search(base).run()


class _Search:
    """The state of a search."""

    def __init__(self, base: ConvergedFit) -> None:
        """Start from a fit of the base model."""
        self._known_terms = tuple(
            extension for extension in base.fitted_terms if not extension.free_indices.size
        )
        self._solution, self._typical = base, True
        self._projection = build_projector(base, typical=True)
        self._terms = testable_terms(self._projection)
        self._tests = count_tests(self._terms)
        self._scores: list[CandidateScore] = []
        self._scored_projection: NuisanceProjector | None = None  # of the scores
        self._excluded: set[str] = set()
        self._doubted: set[str] = set()
        self._noise_alternatives: list[NoiseAlternative] = []
        self._considered: dict[str, set[str]] = {}
        self._gains_by_label: Mapping[str, float] = {}
        self._memory = _SearchMemory([base])

    def run(self) -> SearchResult:
        """Add and remove causes until none is significant; rank them and return the result."""
        while True:
            selection = self._select() or self._select_by_replies()
            if selection is not None and len(self._solution.fitted_terms) < MAX_CAUSES:
                self._try_cause(selection)
            elif self._typical and self._doubted:
                self._use_fitted_noise()
            elif self._eliminate():
                break
        best = best_model(self._solution, self._memory.visited)
        if best is not self._solution:
            self._continue_with(best)
            self._gains_by_label = {}
        return self._ranked_result()

    def _continue_with(self, solution: ConvergedFit) -> None:
        if solution is not self._solution:
            self._solution.release_caches()
        self._solution, self._scored_projection = solution, None
        del self._projection  # two of them would need the memory of two
        self._projection = build_projector(solution, self._typical)

    def _select(self) -> _Selection | None:
        """Score all causes that are not fitted; return the best significant candidate."""
        fitted_labels = {term_label(extension.term) for extension in self._solution.fitted_terms}
        if self._scored_projection is not self._projection:
            terms = [term for term in self._terms if term_label(term) not in fitted_labels]
            self._scores = scan_catalogue(self._projection, terms, self._tests)
            self._scored_projection = self._projection
        left_out = self._excluded | self._doubted | self._memory.unconverged
        usable_scores = [score for score in self._scores if term_label(score.term) not in left_out]
        return _select_candidate(self._projection, usable_scores, fitted_labels, self._tests)

    def _select_by_replies(self) -> _Selection | None:
        """Return a motion law that the replies show and the samples do not, or None."""
        candidate = candidate_from_replies(self._solution, self._tests, FALSE_ALARM_RATE)
        if candidate is None:
            return None
        label = term_label(candidate.extension.term)
        if label in self._excluded | self._doubted | self._memory.unconverged:
            return None
        return _Selection(candidate, 1.0, frozenset({label}))

    def _use_fitted_noise(self) -> None:
        """Repeat the search with fitted noise levels: the bias has a real random walk."""
        self._typical, self._doubted = False, set()
        self._projection = build_projector(self._solution, typical=False)

    def _eliminate(self) -> bool:
        """Remove causes that are not needed; return whether the search is complete."""
        elimination = eliminate_backward(
            self._solution, self._known_terms, self._tests, FALSE_ALARM_RATE
        )
        self._gains_by_label = elimination.delta_log_likelihood
        if not elimination.eliminated - self._excluded:
            self._solution = elimination.solution
            return True
        self._excluded |= elimination.eliminated
        self._continue_with(elimination.solution)
        return False

    def _try_cause(self, selection: _Selection) -> None:
        """Fit a cause in addition to the others, and keep it if it passes its tests."""
        name, extended, alternative = _solve_with_candidate(self._solution, selection)
        if not extended.converged:
            self._memory.leave_out(name, extended)
            return
        if self._typical and not _raises_likelihood(self._solution, alternative, self._tests):
            self._doubted.add(name)
            self._noise_alternatives.append(alternative)
            if len(self._doubted) == MAX_NOISE_ALTERNATIVES:
                self._use_fitted_noise()
            return
        self._considered.setdefault(name, set()).update(selection.considered)
        before = {term_label(extension.term) for extension in self._solution.fitted_terms}
        extended = _drop_insignificant(extended, self._known_terms, self._tests)
        if {term_label(extension.term) for extension in extended.fitted_terms} <= before:
            self._excluded.add(name)  # it could not stay: not again
        self._memory.visit(extended)
        self._continue_with(extended)

    def _ranked_result(self) -> SearchResult:
        solution, ranked_causes = _review_ranking(
            self._solution, self._terms, self._tests, self._considered, self._gains_by_label
        )
        keep = not ranked_causes and (not self._typical or has_typical_noise(solution))
        return SearchResult(
            solution,
            ranked_causes,
            self._projection if keep else build_projector(solution, typical=False),
            tuple(self._scores),
            tuple(self._noise_alternatives),
            self._memory.remarks(solution),
        )


class _SearchMemory:
    """The visited models, and the candidates whose fit did not converge."""

    def __init__(self, visited: list[ConvergedFit]) -> None:
        """Start with some visited models."""
        self.visited = visited
        self.unconverged: set[str] = set()  # labels that are left out in the present model
        self._reasons: dict[str, str] = {}

    def visit(self, solution: ConvergedFit) -> ConvergedFit:
        """Remember a model; in addition to it, candidates may converge that did not before."""
        self.visited.append(solution)
        self.unconverged.clear()
        return solution

    def leave_out(self, label: str, solution: ConvergedFit) -> None:
        """Leave a candidate out of the present model, because the fit did not converge."""
        self.unconverged.add(label)
        self._reasons[label] = solution.convergence.reason

    def remarks(self, final: ConvergedFit) -> tuple[str, ...]:
        """Return one remark for each candidate that is not in the final model."""
        fitted = {term_label(fitted_term.term) for fitted_term in final.fitted_terms}
        return tuple(
            f"the cause {label} was left out: {reason}"
            for label, reason in self._reasons.items()
            if label not in fitted
        )


def _select_candidate(
    projection: NuisanceProjector,
    scores: Sequence[CandidateScore],
    fitted_labels: set[str],
    tests: int,
) -> _Selection | None:
    """Return the candidate with the most evidence; None if no candidate is significant."""
    significant = [score for score in scores if score.p_value < FALSE_ALARM_RATE]
    if not significant:
        return None
    candidates = _fit_leading(projection, significant, scores, fitted_labels, tests)
    for candidate, trials in sorted(candidates, key=lambda pair: -pair[0].log_evidence):
        if global_p_value(candidate, trials, tests) < FALSE_ALARM_RATE:
            return _Selection(
                candidate,
                trials,
                frozenset(term_label(candidate.extension.term) for candidate, _ in candidates),
            )
    return None


def _solve_with_candidate(
    solution: ConvergedFit, selection: _Selection
) -> tuple[str, ConvergedFit, NoiseAlternative]:
    """Return a cause's label, the fit with it, and its alternative, a random walk of the bias."""
    extended = _refit_events(_solve_with(solution, selection.candidate.extension))
    return (
        term_label(selection.candidate.extension.term),
        extended,
        NoiseAlternative.of(selection, solution, extended),
    )


def _raises_likelihood(base: ConvergedFit, alternative: NoiseAlternative, tests: int) -> bool:
    """Return whether a cause found with typical noise is confirmed with fitted levels.

    It is kept if the likelihood rises by as much when the levels are fitted with it: a step does
    not explain a real random walk of the bias. It is also kept if it gains as much by the levels
    that were fitted without it. With enough rests these levels come from the rests only, so that
    they do not contain effects at the edges of moves, which no random walk of the bias produces.
    """
    if has_typical_noise(base):
        return True
    candidate = alternative.candidate
    if (
        global_p_value(
            replace(candidate, delta_log_likelihood=alternative.likelihood_gain_nats),
            alternative.effective_trials,
            tests,
        )
        < FALSE_ALARM_RATE
    ):
        return True
    values = candidate.extension.values
    refitted = fit_candidate(
        NuisanceProjector.at_fit(base), candidate.extension.term, candidate.place, [values]
    )
    return (
        refitted is not None
        and global_p_value(refitted, alternative.effective_trials, tests) < FALSE_ALARM_RATE
    )


def global_p_value(candidate: FittedCandidate, effective_trials: float, tests: int) -> float:
    """Return the global p-value of a candidate: with all scanned templates and tests counted.

    Shapes are not counted as degrees of freedom: the looks along them are.
    """
    sizes = sum(
        1
        for k in candidate.extension.free_indices
        if k in value_indices(candidate.extension.term, role="size")
    )
    return min(
        1.0,
        chi2_upper_tail(2.0 * max(candidate.delta_log_likelihood, 0.0), sizes)
        * effective_trials
        * tests,
    )


def _fit_leading(
    projection: NuisanceProjector,
    leading: Sequence[CandidateScore],
    scores: Sequence[CandidateScore],
    fitted_labels: set[str],
    tests: int,
) -> list[tuple[FittedCandidate, float]]:
    """Fit the causes with the best scores and their confusable ones, each at its best place."""
    strength: dict[str, float] = {}
    term_by_label: dict[str, Term] = {}
    for score in leading:
        excess, name = (
            score.score_test.statistic - score.score_test.degrees_of_freedom,
            term_label(score.term),
        )
        strength[name] = max(strength.get(name, -np.inf), excess)
        term_by_label[name] = score.term
    order = sorted(strength, key=lambda name: -strength[name])[:MAX_CANDIDATES]
    threshold = MIN_STATISTIC_SHARE * strength[order[0]]
    terms = [term_by_label[c] for k, c in enumerate(order) if k < 2 or strength[c] > threshold]
    # What others stand for in the pass over all takes part where they do.
    terms += [
        instance
        for equivalent in catalogue().values()
        for term in terms
        if term.cause == equivalent.first_order_equivalent
        for instance in testable_instances(equivalent, projection)
        if recording_index_of(instance) == recording_index_of(term) and instance not in terms
    ]
    candidates = []
    for term in terms:
        if term_label(term) in fitted_labels:
            continue
        term_scores = [score for score in scores if term_label(score.term) == term_label(term)]
        term_scores = term_scores or scan_catalogue(
            projection, [term], tests, all_templates(projection, term)
        )
        fitted = fit_best_place(projection, term_scores)
        if fitted is not None:
            candidates.append(fitted)
    return candidates


def fit_best_place(
    projection: NuisanceProjector, scores: Sequence[CandidateScore]
) -> tuple[FittedCandidate, float] | None:
    """Fit one cause at each promising place; return the fit with the most evidence."""
    best_statistic = max((score.score_test.statistic for score in scores), default=0.0)
    best_separate = max(
        (score.score_test.statistic for score in scores if score.place is not None), default=-np.inf
    )
    best: tuple[FittedCandidate, float] | None = None
    for score in scores:
        if score.place is not None and score.score_test.statistic < best_statistic - PLACE_MARGIN:
            continue
        if score.place is None and score.score_test.statistic < best_separate + JOINT_MARGIN:
            continue
        candidate = fit_candidate(projection, score.term, score.place, [score.template])
        if candidate is None or candidate.infeasible:
            continue
        if best is None or candidate.log_evidence > best[0].log_evidence:
            best = candidate, score.effective_trials
    return best


def _solve_with(solution: ConvergedFit, extension: FittedTerm) -> ConvergedFit:
    """Refit with one more cause; hold its shapes if the fit does not converge with them free."""
    others = solution.fitted_terms
    extended = refit_with_terms(solution, [*others, extension])
    sizes = [
        k for k in extension.free_indices if value_parameters(extension.term)[k].role == "size"
    ]
    if not extended.converged and len(sizes) < extension.free_indices.size:
        sizes_only = replace(extension, free_indices=np.array(sizes, dtype=np.int64))
        extended = refit_with_terms(solution, [*others, sizes_only])
    if not extended.converged:
        return extended
    # An outlier of the previous model can agree with this one.
    return refit_gain_exactly(
        _prefer_converged(refit_with_terms(extended, extended.fitted_terms), extended)
        if extended.outliers
        else extended
    )


def _prefer_converged(refitted: ConvergedFit, previous: ConvergedFit) -> ConvergedFit:
    """Return a refit if it converged, otherwise the previous fit."""
    return refitted if refitted.converged else previous


def _refit_events(solution: ConvergedFit) -> ConvergedFit:
    """Refit the time of each event together with all other causes.

    An event is found before other causes, and while its effect still biases the base model.
    Without a refit, later causes would absorb the error of its time.
    """
    causes = list(solution.fitted_terms)
    changed = False
    for k, extension in enumerate(causes):
        if not extension.free_indices.size or not value_indices(extension.term, role="event"):
            continue
        others = [other for j, other in enumerate(solution.fitted_terms) if j != k]
        projector = NuisanceProjector.at_fit(
            solution, followed_terms=others, restored_terms=[extension]
        )
        refitted = fit_candidate(
            projector,
            extension.term,
            _fitted_place(extension),
            [extension.values],
            search_event=True,
        )
        if refitted is not None and not refitted.infeasible:
            causes[k] = replace(extension, values=refitted.extension.values)
            changed = True
    return _prefer_converged(refit_with_terms(solution, causes), solution) if changed else solution


def _drop_insignificant(
    solution: ConvergedFit, known_terms: tuple[FittedTerm, ...], tests: int
) -> ConvergedFit:
    """Remove the causes that are not significant in addition to the others.

    A cause without which the fit does not converge stays.
    """
    needed: set[str] = set()
    while True:
        p_values = [
            (wald_p_value(solution, k), k)
            for k, extension in enumerate(solution.fitted_terms)
            if extension not in known_terms and term_label(extension.term) not in needed
        ]
        weak = [(p, k) for p, k in p_values if p * tests > FALSE_ALARM_RATE]
        if not weak:
            return solution
        drop = max(weak)[1]
        others = [extension for k, extension in enumerate(solution.fitted_terms) if k != drop]
        reduced = refit_with_terms(solution, others)
        if not reduced.converged:
            needed.add(term_label(solution.fitted_terms[drop].term))
            continue
        solution = reduced


def wald_p_value(solution: ConvergedFit, k: int) -> float:
    """Return the p-value of a Wald test of a cause's sizes."""
    extension = solution.fitted_terms[k]
    first = solution.estimate.size - sum(
        extension.free_indices.size for extension in solution.fitted_terms
    )
    first += sum(extension.free_indices.size for extension in solution.fitted_terms[:k])
    positions = [
        first + j
        for j, index in enumerate(extension.free_indices)
        if index in value_indices(extension.term, role="size")
    ]
    if not positions:
        return 0.0
    value = solution.estimate[positions]
    covariance = solution.observability.covariance[np.ix_(positions, positions)]
    observable = np.diag(covariance) > 0.0
    if not observable.any():
        return 1.0
    indices = np.flatnonzero(observable)
    inverse = np.linalg.pinv(covariance[np.ix_(indices, indices)], hermitian=True)
    return chi2_upper_tail(float(value[indices] @ inverse @ value[indices]), indices.size)


def _review_ranking(
    solution: ConvergedFit,
    terms: Sequence[Term],
    tests: int,
    considered: Mapping[str, set[str]],
    gains_by_label: Mapping[str, float],
) -> tuple[ConvergedFit, tuple[RankedCause, ...]]:
    """Rank each cause against its alternatives, all else fitted, and swap in better ones.

    A swap is made only if the fit with the rival converges.

    `gains_by_label`: what a fit without a cause loses, in nats, where that is known.
    """
    for swap in range(MAX_SWAPS + 1):
        ranked_causes, replacement = [], None
        for k, extension in enumerate(solution.fitted_terms):
            if not extension.free_indices.size:
                continue
            confusable = considered.get(term_label(extension.term), set()) | confusable_labels(
                extension.term, terms
            )
            candidates = [
                term
                for term in terms
                if term_label(term) in confusable or term_label(term) == term_label(extension.term)
            ]
            ranked = rank_against_alternatives(solution, k, candidates, tests)
            ranked_causes.append(ranked)
            lead = (
                ranked.rivals and ranked.rivals[0][0].log_evidence - ranked.candidate.log_evidence
            )
            if replacement is None and lead and lead > MIN_EVIDENCE_LEAD_NATS:
                replacement = k, ranked.rivals[0][0].extension
        if replacement is None or swap == MAX_SWAPS:
            return solution, _limit_gains(ranked_causes, gains_by_label)
        k, other = replacement
        others = [extension for j, extension in enumerate(solution.fitted_terms) if j != k]
        swapped = _solve_with(refit_with_terms(solution, others), other)
        if not swapped.converged:
            return solution, _limit_gains(ranked_causes, gains_by_label)
        solution = swapped
    return solution, ()


def _limit_gains(
    ranked_causes: Sequence[RankedCause], gains_by_label: Mapping[str, float]
) -> tuple[RankedCause, ...]:
    return tuple(ranked.with_gain_limit(gains_by_label) for ranked in ranked_causes)


def confusable_labels(term: Term, terms: Sequence[Term]) -> set[str]:
    """Return the labels of the causes that are confusable with a cause."""
    recording = recording_index_of(term)
    return {
        term_label(other_term)
        for other_term in terms
        if (other_term.cause in term.confused_with or term.cause in other_term.confused_with)
        and (recording is None or recording_index_of(other_term) in (None, recording))
    }


def rank_against_alternatives(
    solution: ConvergedFit, k: int, terms: Sequence[Term], tests: int
) -> RankedCause:
    """Rank one cause of a fit against the alternatives in its place.

    Args:
        solution: the fit.
        k: which of its causes.
        terms: those that might, itself among them.
        tests: how many share the false alarms.
    """
    extension = solution.fitted_terms[k]
    others = [other for j, other in enumerate(solution.fitted_terms) if j != k]
    projector = NuisanceProjector.at_fit(
        solution, followed_terms=others, restored_terms=[extension]
    )
    fitted_labels = {term_label(other.term) for other in others}
    scores = scan_catalogue(
        projector, [t for t in terms if term_label(t) not in fitted_labels], tests
    )
    candidates = _fit_leading(projector, scores, scores, fitted_labels, tests)
    same_cause = [
        (candidate, looks)
        for candidate, looks in candidates
        if term_label(candidate.extension.term) == term_label(extension.term)
    ]
    place = _fitted_place(extension)
    refitted = fit_candidate(
        projector, extension.term, place, [extension.values], search_event=True
    )
    if refitted is not None and (
        not same_cause or refitted.log_evidence > same_cause[0][0].log_evidence
    ):
        same_cause = [(refitted, same_cause[0][1] if same_cause else 1.0)]
    alternatives = [
        candidate
        for candidate, _ in candidates
        if term_label(candidate.extension.term) != term_label(extension.term)
    ]
    evidence = np.array(
        [same_cause[0][0].log_evidence, *(candidate.log_evidence for candidate in alternatives)]
    )
    posterior = posterior_probabilities(evidence, same_cause[0][0].delta_log_likelihood)
    order = np.argsort(-evidence[1:], kind="stable")
    rivals = tuple((alternatives[j], float(posterior[1 + j])) for j in order)
    return RankedCause(same_cause[0][0], same_cause[0][1], rivals, float(posterior[0]))


def posterior_probabilities(log_evidence: FloatArray, best_gain_nats: float) -> FloatArray:
    """Return the posterior probability of each cause, with an allowance for model error.

    What a rival leaves of a large effect may be what the right form leaves as well, so the
    likelihood counts for less the more there is of it. A small effect is judged by noise
    alone: the two errors, a nat of noise's and the share that forms are untrue by, are
    independent and add in squares.

    Source: after the coarsened posterior; Miller and Dunson, J. Am. Statist. Assoc. 114
    (2019) 1113.

    Args:
        log_evidence: of each, nats, the named one's first.
        best_gain_nats: by the named one, nats.
    """
    belief = np.exp(
        (log_evidence - log_evidence.max()) / np.hypot(1.0, MODEL_ERROR_SHARE * best_gain_nats)
    )
    return np.asarray(belief / belief.sum(), dtype=np.float64)


def _fitted_place(extension: FittedTerm) -> str | None:
    """Return the place whose sizes alone are fitted; None for all places."""
    sizes: FloatArray = np.array(
        [k for k in extension.free_indices if k in value_indices(extension.term, role="size")]
    )
    for place, _ in testable_places(extension.term):
        if place is not None and value_indices(extension.term, place, "size") == sizes.tolist():
            return place
    return None
