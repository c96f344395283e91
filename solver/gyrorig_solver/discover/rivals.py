"""What else was weighed for a cause, and in words why it lost.

What to use when: `rivals_of` for any search that weighs causes against one another.
"""

from collections.abc import Iterable

from gyrorig_solver.discover.refit import Weighed
from gyrorig_solver.discover.result import Rival


def rivals_of(best: Weighed, others: Iterable[tuple[Weighed, float]]) -> tuple[Rival, ...]:
    """Return the rivals of a cause.

    Args:
        best: the cause that was taken.
        others: what else was weighed, each with its posterior.
    """
    return tuple(
        Rival(
            one.extension.term.cause,
            one.won - best.won,
            share,
            _why(one.won - best.won, one.evidence - best.evidence),
        )
        for one, share in others
    )


def _why(won: float, evidence: float) -> str:
    if evidence > 0.0:
        return "it fits as well; the data do not tell them apart"
    if won > -1.0:
        return "it fits as well, but needs more unknowns or an unlikely size for it"
    return f"its best fit leaves {-won:.1f} nats more unexplained"
