"""The rankings of a search: each model is ranked once, and replaced by a better one.

A search often returns to a model that it ranked before. Its fit then has the same causes at almost
the same values, and a ranking would repeat dozens of fits with the same result.

What to use when: one `RankingMemory` per search.
"""

from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import dataclass
from typing import Generic

import numpy as np

from gyrorig_solver.discover.cause_ranking import RankedCause, rank_causes, swap_leading_rival
from gyrorig_solver.discover.fit_space import FitSpace, Space
from gyrorig_solver.discover.fitted_values import value_positions
from gyrorig_solver.model import Term, term_label

MAX_SWAPS = 4  # replacements of named causes in one ranking
SAME_VALUE_SIGMA = 0.1  # distance of two fits of one model whose rankings count as one


@dataclass(slots=True, eq=False)
class _Ranking(Generic[Space]):
    """The ranking of one model."""

    space: Space
    considered: dict[str, frozenset[str]]  # by label of a cause, the causes compared when found
    causes: tuple[RankedCause, ...]
    is_swap_fitted: bool = False
    swapped: Space | None = None  # the model with a better alternative; None if there is none


class RankingMemory(Generic[Space]):
    """The rankings of the models of one search."""

    def __init__(self, terms: Sequence[Term], tests: int, may_fit_laws: Callable[[], bool]) -> None:
        """Start without rankings.

        Args:
            terms: the testable causes.
            tests: how many share the false alarms.
            may_fit_laws: whether the effort allows further fits of alternatives that change the
                motion law.
        """
        self._terms, self._tests, self._may_fit_laws = terms, tests, may_fit_laws
        self._rankings: list[_Ranking[Space]] = []

    def review(
        self,
        space: Space,
        considered: Mapping[str, Set[str]],
        is_acceptable: Callable[[Space], bool],
        is_at_limit: Callable[[], bool],
    ) -> tuple[Space, tuple[RankedCause, ...]]:
        """Rank each cause against its alternatives, and replace it by a better alternative.

        Args:
            space: the fit at the end of a search.
            considered: by label, the causes that were compared with a cause when it was found.
            is_acceptable: whether a fit with a swapped cause may replace the other one.
            is_at_limit: whether the search may fit no more models.

        Returns:
            The last fit, and the ranking of each of its free causes.
        """
        ranking = self._ranking_of(space, considered)
        for _ in range(MAX_SWAPS):
            if is_at_limit():
                break
            if not ranking.is_swap_fitted:
                ranking.swapped = swap_leading_rival(ranking.space, ranking.causes)
                ranking.is_swap_fitted = True
            if ranking.swapped is None or is_at_limit() or not is_acceptable(ranking.swapped):
                break
            space = ranking.swapped
            ranking = self._ranking_of(space, considered)
        return space, ranking.causes

    def _ranking_of(self, space: Space, considered: Mapping[str, Set[str]]) -> _Ranking[Space]:
        """Return the ranking of a model, from the memory if it was ranked before."""
        labels = [term_label(space.fitted_terms[k].term) for k in space.free_causes]
        compared = {label: frozenset(considered.get(label, ())) for label in labels}
        for ranking in self._rankings:
            if ranking.considered == compared and is_same_fit(space, ranking.space):
                return ranking
        causes = rank_causes(space, self._terms, self._tests, considered, self._may_fit_laws)
        self._rankings.append(_Ranking(space, compared, causes))
        return self._rankings[-1]


def is_same_fit(space: FitSpace, other: FitSpace) -> bool:
    """Return whether two fits have the same causes in the same order, at almost the same values.

    Fitted values may differ by a small share of their standard uncertainty. Held values, such as
    the time of an event, must be equal.
    """
    if space is other:
        return True
    if len(space.fitted_terms) != len(other.fitted_terms):
        return False
    for k, (mine, theirs) in enumerate(zip(space.fitted_terms, other.fitted_terms, strict=True)):
        if term_label(mine.term) != term_label(theirs.term):
            return False
        if not np.array_equal(mine.free_indices, theirs.free_indices):
            return False
        at = value_positions(space, k)
        std = np.sqrt(np.clip(np.diag(space.observability.covariance)[at], 0.0, None))
        tolerance = np.zeros(mine.values.size)
        tolerance[mine.free_indices] = SAME_VALUE_SIGMA * std
        if np.any(np.abs(mine.values - theirs.values) > tolerance):
            return False
    return True
