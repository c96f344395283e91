"""Limits of the effort of a search for causes.

The effort counts work and no time, so that a search gives the same result on every computer.

What to use when: one `SearchLimits` per search.
"""

from collections.abc import Sequence

from gyrorig_solver.discover.fit_space import SearchEffort, Space
from gyrorig_solver.discover.search_memory import SearchMemory

# Evaluations of the likelihood in all fits, without the final ranking. A search that needs more
# tries to explain an effect that no cause explains.
MAX_SEARCH_EVALUATIONS = 6000
# The same, times the samples: an evaluation takes about 29 us per sample, so that a search takes
# about 300 s. The longest measured search of the golden set needs a twelfth.
MAX_SEARCH_SAMPLES = 10_000_000
# A search of a long recording may take longer: it has time for about six causes.
MIN_SEARCH_EVALUATIONS = 400
# Evaluations with the final ranking, relative to this limit. After it, a ranking fits no more
# alternatives that change the motion law.
RANKING_FACTOR = 1.5
# Candidates whose fit did not converge. With a large misfit that no cause explains, the derivatives
# are wrong, and most of the fits fail.
MAX_FAILED_FITS = 12


class SearchLimits:
    """The effort of one search, and whether it has reached its limits."""

    def __init__(self, effort: SearchEffort) -> None:
        """Start at the present effort.

        Args:
            effort: of the search and of what was before it.
        """
        self._effort, self._first_evaluation = effort, effort.evaluations
        affordable = MAX_SEARCH_SAMPLES // max(effort.samples, 1)
        self.max_evaluations = min(MAX_SEARCH_EVALUATIONS, max(MIN_SEARCH_EVALUATIONS, affordable))

    @property
    def _evaluations(self) -> int:
        return self._effort.evaluations - self._first_evaluation

    def are_reached(self, memory: SearchMemory[Space]) -> bool:
        """Return whether the search may fit no more models; `memory`: of the search."""
        return self._evaluations >= self.max_evaluations or memory.failed_fits >= MAX_FAILED_FITS

    def may_fit_laws(self) -> bool:
        """Return whether a ranking may fit further alternatives that change the motion law."""
        return self._evaluations < RANKING_FACTOR * self.max_evaluations

    def remarks(
        self, memory: SearchMemory[Space], labels: Sequence[str], was_stopped: bool
    ) -> tuple[str, ...]:
        """Return the remark that a search or its final ranking stopped at a limit; () if not.

        Args:
            memory: of the search.
            labels: of the causes of its result.
            was_stopped: whether the limit was reached before the final ranking.
        """
        if not self.are_reached(memory):
            return ()
        limit = (
            f"{MAX_FAILED_FITS} fits without convergence"
            if memory.failed_fits >= MAX_FAILED_FITS
            else f"{self.max_evaluations} evaluations of the likelihood"
        )
        names = ", ".join(labels) or "none"
        if not was_stopped:
            return (
                f"the comparison of the causes with their alternatives stopped at the limit of "
                f"{limit}, so that not all alternatives to these causes were fitted: {names}",
            )
        others = "" if self.may_fit_laws() else ", and not all alternatives to them were fitted"
        return (
            f"the search for causes stopped at its limit of {limit}; the causes that it had found "
            f"are {names}, and other causes are possible{others}",
        )
