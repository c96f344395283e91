"""Stepwise selection of causes: significant causes are named and fitted one after the other.

Forward: the search scores all causes and fits the best candidates and their confusable causes
exactly. It adds the candidate with the most evidence to the full fit, until no leading cause is
significant. If the fit with the candidate does not converge, the search tries it together with a
second cause. Backward: the search removes a cause that the others make redundant. Then it compares
each cause with all alternatives, with all other causes fitted, and can replace it. It also fits
weaker candidates. If one of these steps changes the model, the search continues. No step accepts a
fit that did not converge. The result is the visited model with the most evidence.

What to use when: `search_causes` from a fit of the base model, for any kind of reference.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Generic

from gyrorig_solver.discover.backward_elimination import eliminate_backward
from gyrorig_solver.discover.candidate_fits import (
    fit_best_place,
    fit_leading,
    global_p_value,
    is_lag_significant,
    leading_labels,
)
from gyrorig_solver.discover.cause_ranking import RankedCause
from gyrorig_solver.discover.clock_fault_comparison import compare_clock_faults
from gyrorig_solver.discover.exact_fit import FittedCandidate
from gyrorig_solver.discover.extended_fit import extend_fit, refit_events
from gyrorig_solver.discover.fit_space import FitSpace, NoiseAlternative, Space
from gyrorig_solver.discover.fitted_values import wald_p_value
from gyrorig_solver.discover.held_out_gain import cross_validate_causes
from gyrorig_solver.discover.joint_fit import fit_pair
from gyrorig_solver.discover.law_candidates import fit_law_cause
from gyrorig_solver.discover.model_evidence import best_model
from gyrorig_solver.discover.ranking_memory import RankingMemory
from gyrorig_solver.discover.score_tests import FALSE_ALARM_RATE, CandidateScore, scan_catalogue
from gyrorig_solver.discover.search_limits import SearchLimits
from gyrorig_solver.discover.search_memory import SearchMemory
from gyrorig_solver.discover.testable_terms import count_tests, select_testable, terms_not_fitted
from gyrorig_solver.estimate import FittedTerm, NuisanceProjector
from gyrorig_solver.model import Term, term_label, value_indices

MAX_CAUSES = 16
MAX_ROUNDS = 3  # of adding causes; the ranking after a round takes as long as the rest
# Number of causes that are significant with typical noise levels only. If there are so many, the
# bias has a random walk.
MAX_NOISE_ALTERNATIVES = 3


@dataclass(frozen=True, slots=True, eq=False)
class SearchResult(Generic[Space]):
    """The result of a search: the extended fit, its causes, and the scores of the other causes."""

    space: Space
    ranked_causes: tuple[RankedCause, ...]  # of each extension of the fit, in the same order
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

    @property
    def label(self) -> str:
        return term_label(self.candidate.extension.term)


def search_causes(base: Space) -> SearchResult[Space]:
    """Name and fit the causes of a fit's residual by stepwise selection."""
    return _Search(base).run()


class _Search(Generic[Space]):
    def __init__(self, base: Space) -> None:
        """Start from a fit of the base model."""
        self._known_terms = tuple(base.terms_without(*base.free_causes))
        self._space, self._typical = base, True
        self._projection = base.projector(typical=True)
        self._terms = select_testable(base.terms.values(), self._projection)
        self._tests = count_tests(self._terms)
        self._scores: list[CandidateScore] = []
        self._scored_projection: NuisanceProjector | None = None  # of the scores
        self._excluded: set[str] = set()
        self._doubted: set[str] = set()
        self._noise_alternatives: list[NoiseAlternative] = []
        self._considered: dict[str, set[str]] = {}
        self._rejected: set[str] = set()  # by the exact fits of the last selection
        self._has_weaker = False  # whether other candidates were significant in it
        self._gains_by_label: Mapping[str, float] = {}
        self._memory = SearchMemory(base)
        # Causes of the models to which none could be added.
        self._reviewed: list[frozenset[str]] = []
        self._limits = SearchLimits(base.effort)
        self._rankings = RankingMemory[Space](self._terms, self._tests, self._limits.may_fit_laws)

    def run(self) -> SearchResult[Space]:
        """Add, remove and replace causes until none is significant; return the ranked result.

        A search that reaches its limit ends with the best model so far.
        """
        self._add_always_present()
        while True:
            self._add_causes()
            self._settle()
            is_last = self._is_at_limit or len(self._reviewed) == MAX_ROUNDS - 1
            if is_last or self._space.labels in self._reviewed:
                return self._ranked_result()
            self._reviewed.append(self._space.labels)
            if not self._replace_causes() and not self._try_weaker():
                return self._ranked_result()

    def _add_always_present(self) -> None:
        """Add the significant causes that are always present, before causes that resemble them.

        Without such a cause, the noise model is wrong too, and a comparison with this noise model
        can prefer a cause that only resembles it.
        """
        for term in self._terms:
            if not term.is_always_present:
                continue
            scores = scan_catalogue(self._projection, [term], self._tests)
            scores = [score for score in scores if score.p_value < FALSE_ALARM_RATE]
            fitted = fit_best_place(self._projection, scores)
            if fitted is None or global_p_value(*fitted, self._tests) > FALSE_ALARM_RATE:
                continue
            self._try_cause(_Selection(*fitted, frozenset((term_label(term),))))

    def _add_causes(self) -> None:
        """Add the leading cause repeatedly, and remove causes that become redundant."""
        while not self._is_at_limit:
            selection = self._select()
            if selection is not None and len(self._space.fitted_terms) < MAX_CAUSES:
                self._try_cause(selection)
            elif selection is None and self._memory.retry_waiting():
                continue
            elif self._typical and self._doubted:
                self._use_fitted_noise()
            elif self._eliminate():
                return

    def _settle(self) -> None:
        """Continue with the best visited model, and confirm its convergence."""
        best = best_model(self._space, self._memory.visited)
        if best is not self._space:
            self._continue_with(best)
            self._gains_by_label = {}
        if self._space is not self._memory.visited[0]:
            self._continue_with(self._space.confirm())

    def _continue_with(self, space: Space) -> None:
        if space is not self._space:
            self._space.release_caches()
        self._space, self._scored_projection = space, None
        del self._projection  # before the next one is made: a projector is large
        self._projection = space.projector(self._typical)

    @property
    def _is_at_limit(self) -> bool:
        return self._limits.are_reached(self._memory)

    @property
    def _left_out(self) -> set[str]:
        return self._excluded | self._doubted | self._memory.left_out

    def _select(self, with_weaker: bool = False) -> _Selection | None:
        """Score all causes that are not fitted; return the best significant candidate.

        `with_weaker`: fit the other candidates, after the exact fits of the leading candidates
        failed.
        """
        fitted_labels = self._space.labels
        if self._scored_projection is not self._projection:
            terms = terms_not_fitted(self._terms, fitted_labels)
            self._scores = scan_catalogue(self._projection, terms, self._tests)
            self._scored_projection = self._projection
        usable = [score for score in self._scores if term_label(score.term) not in self._left_out]
        significant = [score for score in usable if score.p_value < FALSE_ALARM_RATE]
        if not significant and self._space.needs_held_out_gain and usable:
            # No cause of the first scan resembles a clock that is corrected often.
            is_late = is_lag_significant(self._projection, self._tests)
            significant = usable[:1] if is_late else []
        if with_weaker:
            significant = _without(significant, self._rejected)
        else:
            self._rejected, self._has_weaker = set(), False
        while significant:
            left_out = fitted_labels | self._left_out
            candidates = fit_leading(
                self._projection, significant, usable, left_out, self._tests, self._fit_law
            )
            considered = frozenset(term_label(other.extension.term) for other, _ in candidates)
            for candidate, trials in sorted(candidates, key=lambda pair: -pair[0].log_evidence):
                if global_p_value(candidate, trials, self._tests) < FALSE_ALARM_RATE:
                    return _Selection(candidate, trials, considered)
            self._rejected |= leading_labels(significant) | considered | self._left_out
            significant = _without(significant, self._rejected)
            if not with_weaker:
                self._has_weaker = bool(significant)
                return None
        return None

    def _fit_law(self, term: Term, needed_nats: float) -> FittedCandidate | None:
        """Fit a candidate under its own motion law; None if the fit does not converge.

        At the limit of the search, the candidate is not fitted.
        """
        if self._is_at_limit:
            return None
        fitted = fit_law_cause(self._space, term, needed_nats=needed_nats)
        if fitted.candidate is None:
            self._memory.leave_out(term_label(term), fitted.space)
        elif global_p_value(fitted.candidate, 1.0, self._tests) > FALSE_ALARM_RATE:
            self._memory.postpone(term_label(term))
        return fitted.candidate

    def _use_fitted_noise(self) -> None:
        """Repeat the search with fitted noise levels: the bias has a real random walk."""
        self._typical, self._doubted = False, set()
        self._projection = self._space.projector()

    def _eliminate(self) -> bool:
        """Remove causes that are not needed; return whether the search is complete.

        The gain is searched again before. A better gain can make other causes significant, so the
        search is then not complete.
        """
        refitted = self._space.refit_gain()
        if refitted is not self._space:
            self._memory.visit(refitted)
            self._continue_with(refitted)
            return False
        elimination = eliminate_backward(self._space, self._known_terms, self._tests)
        self._gains_by_label = elimination.delta_log_likelihood
        space = self._drop_without_gain(elimination.space)
        is_complete = not elimination.eliminated - self._excluded and space is elimination.space
        self._excluded |= elimination.eliminated
        if space is not self._space:
            self._continue_with(space)
        return is_complete

    def _replace_causes(self) -> bool:
        """Replace causes by better alternatives; return whether the model is a new one.

        A cause that was added early can represent several causes that were not yet in the model.
        Other causes can then be significant in addition to its replacement.
        """
        replaced, _ = self._rank()
        if replaced is self._space:
            replaced = compare_clock_faults(self._space, self._terms, self._tests)
        if replaced is self._space or replaced.labels in self._reviewed:
            return False
        self._excluded.clear()
        self._memory.visit(replaced)
        self._continue_with(replaced)
        return True

    def _try_weaker(self) -> bool:
        """Try a weaker candidate if no leading one passes; return whether there is one."""
        if not self._has_weaker or len(self._space.fitted_terms) >= MAX_CAUSES:
            return False
        selection = self._select(with_weaker=True)
        if selection is not None:
            self._try_cause(selection)
        return selection is not None

    def _try_cause(self, selection: _Selection) -> None:
        """Fit a cause in addition to the others, and keep it if it passes its tests."""
        name = selection.label
        extension = selection.candidate.extension
        extended = extend_fit(self._space, extension)
        # The residual of a fit that has not converged shows the time of no other event.
        if extended.convergence.converged or value_indices(extension.term, role="event"):
            extended = refit_events(extended)
        if not extended.convergence.converged:
            pair = self._fit_pair(extension, extended)
            if pair is None:
                self._memory.leave_out(name, extended)
                return
            extended = pair
        alternative = None
        if self._typical:
            alternative = self._space.noise_alternative(
                selection.candidate, selection.effective_trials, extended, self._tests
            )
        if alternative is not None:
            self._doubted.add(name)
            self._noise_alternatives.append(alternative)
            if len(self._doubted) == MAX_NOISE_ALTERNATIVES:
                self._use_fitted_noise()
            return
        self._considered.setdefault(name, set()).update(selection.considered)
        before = self._space.labels
        extended = self._drop_without_gain(self._drop_insignificant(extended))
        if extended.labels <= before:
            self._excluded.add(name)  # it was removed at once: do not try it again
        self._memory.visit(extended)
        self._continue_with(extended)

    def _fit_pair(self, extension: FittedTerm, failed: Space) -> Space | None:
        """Fit a cause, whose fit alone failed, together with a second one; None without a fit."""
        terms = [
            term
            for term in terms_not_fitted(self._terms, failed.labels)
            if term_label(term) not in self._left_out
        ]
        projection = failed.projector(self._typical)
        return fit_pair(self._space, extension, projection, terms, self._tests)

    def _drop_insignificant(self, space: Space) -> Space:
        """Remove the causes that are not significant in addition to the others.

        A cause stays if the fit without it does not converge.
        """
        needed: set[str] = set()
        while True:
            p_values = [
                (wald_p_value(space, k), k)
                for k, extension in enumerate(space.fitted_terms)
                if extension not in self._known_terms and term_label(extension.term) not in needed
            ]
            weak = [(p, k) for p, k in p_values if p * self._tests > FALSE_ALARM_RATE]
            if not weak:
                return space
            drop = max(weak)[1]
            reduced = space.refit(space.terms_without(drop))
            if not reduced.convergence.converged:
                needed.add(term_label(space.fitted_terms[drop].term))
                continue
            space = reduced

    def _drop_without_gain(self, space: Space) -> Space:
        """Remove the causes without gain on held-out data, if the space requires a gain."""
        while without := _causes_without_gain(space):
            self._excluded |= {term_label(space.fitted_terms[k].term) for k in without}
            space = space.refit(space.terms_without(*without))
        return space

    def _ranked_result(self) -> SearchResult[Space]:
        was_stopped = self._is_at_limit
        space, ranked_causes = self._rank()
        new_labels = [
            term_label(fitted_term.term)
            for fitted_term in space.fitted_terms
            if fitted_term not in self._known_terms
        ]
        remarks = self._limits.remarks(self._memory, new_labels, was_stopped)
        if space is not self._space:
            space = space.confirm()
        keep = space is self._space and (not self._typical or space.has_typical_noise)
        return SearchResult(
            space,
            tuple(ranked.with_gain_limit(self._gains_by_label) for ranked in ranked_causes),
            self._projection if keep else space.projector(),
            tuple(self._scores),
            tuple(self._noise_alternatives),
            (*remarks, *self._memory.remarks(space)),
        )

    def _rank(self) -> tuple[Space, tuple[RankedCause, ...]]:
        """Rank the causes of the model, and replace them by better alternatives."""
        return self._rankings.review(
            self._space,
            self._considered,
            lambda swapped: swapped.convergence.converged and not _causes_without_gain(swapped),
            lambda: self._is_at_limit,
        )


def _without(scores: Sequence[CandidateScore], rejected: set[str]) -> list[CandidateScore]:
    return [score for score in scores if term_label(score.term) not in rejected]


def _causes_without_gain(space: FitSpace) -> list[int]:
    """Return the causes that do not improve the prediction of held-out data."""
    if not space.needs_held_out_gain:
        return []
    gains = cross_validate_causes(space.projector(), range(len(space.fitted_terms)))
    by_cause = {} if gains is None else gains.by_cause
    return [k for k, gain in by_cause.items() if gain.log_likelihood.value <= 0.0]
