"""The state of the search in one of several boards on one unit."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from gyrorig_solver.discover.cause_findings import Attribution
from gyrorig_solver.discover.cause_ranking import (
    RankedCause,
    confusable_labels,
    rank_against_alternatives,
)
from gyrorig_solver.discover.cause_search import SearchResult
from gyrorig_solver.discover.fit_criticism import scan_other_causes
from gyrorig_solver.discover.motion_space import MotionFitSpace
from gyrorig_solver.discover.testable_terms import count_tests, testable_terms
from gyrorig_solver.estimate import FittedTerm, NuisanceProjector
from gyrorig_solver.model import Term, term_label


@dataclass(slots=True, eq=False)
class BoardSearch:
    """The state of one board's search."""

    name: str
    base: MotionFitSpace
    result: SearchResult[MotionFitSpace]
    space: MotionFitSpace
    ranked_causes: list[RankedCause]  # of each fitted cause, in the fit's order
    attributions: dict[str, Attribution]

    def fitted_causes(self) -> list[tuple[FittedTerm, RankedCause]]:
        """Return each fitted cause with its ranking."""
        fitted = [self.space.fitted_terms[k] for k in self.space.free_causes]
        return list(zip(fitted, self.ranked_causes, strict=True))

    def projector_without(self, dropped: FittedTerm | None) -> NuisanceProjector:
        """Return the projector of the fit, or of the fit without one of its causes."""
        if dropped is None:
            return self.space.projector()
        return self.space.projector_without(self.space.fitted_terms.index(dropped))

    def replace_cause(
        self, replaced: FittedTerm | None, cause: FittedTerm, ranked: RankedCause
    ) -> None:
        """Fit a cause, in place of another one or in addition to all, if the fit converges."""
        known_terms = self.space.terms_without(*self.space.free_causes)
        others = [pair for pair in self.fitted_causes() if pair[0] is not replaced]
        fitted_terms = [*known_terms, *(extension for extension, _ in others), cause]
        self._refit(fitted_terms, [*(ranking for _, ranking in others), ranked])

    def drop_cause(self, dropped: FittedTerm) -> None:
        """Refit without a cause, if that fit converges."""
        ranked_causes = [ranked for cause, ranked in self.fitted_causes() if cause is not dropped]
        others = [cause for cause in self.space.fitted_terms if cause is not dropped]
        self._refit(others, ranked_causes)

    def _refit(self, fitted_terms: Sequence[FittedTerm], ranked_causes: list[RankedCause]) -> None:
        refitted = self.space.refit(fitted_terms)
        if refitted.convergence.converged:
            self.ranked_causes, self.space = ranked_causes, refitted

    def take_law(self, space: MotionFitSpace, term: Term) -> None:
        """Continue with a fit in which a cause of the motion law has its common value."""
        ranked_by_label = {term_label(c.term): ranked for c, ranked in self.fitted_causes()}
        self.space = space
        terms = testable_terms(space.projector())
        rivals = confusable_labels(term, terms) | {term_label(term)}
        rivals_and_term = [other for other in terms if term_label(other) in rivals]
        self.ranked_causes = [
            ranked_by_label[term_label(space.fitted_terms[k].term)]
            if term_label(space.fitted_terms[k].term) in ranked_by_label
            else rank_against_alternatives(space, k, rivals_and_term, count_tests(terms))
            for k in space.free_causes
        ]

    def update_ranking(self, cause: FittedTerm, ranked: RankedCause) -> None:
        """Replace the ranking of a cause."""
        self.ranked_causes = [
            ranked if extension is cause else previous
            for extension, previous in self.fitted_causes()
        ]

    def finish(self) -> SearchResult[MotionFitSpace]:
        """Return the search result, with scores of the other causes for the final fit."""
        ranked_causes = tuple(self.ranked_causes)
        if self.space is self.result.space:
            return replace(self.result, ranked_causes=ranked_causes)
        projector = self.space.projector()
        scores, _ = scan_other_causes(self.space, projector)
        return SearchResult(self.space, ranked_causes, projector, tuple(scores))
