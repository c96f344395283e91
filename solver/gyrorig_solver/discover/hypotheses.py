"""Whose a cause is: one common size over all boards of a unit, or each board's own.

What a unit does, all boards on it show at one size; what a board has, no other one needs
to have. A name that a single board leaves open between the two (a controller that rounds
its ramps, a low-pass of its own) is decided by all boards together: the evidence of one
common size, found in all data at once, against the sum of what own sizes earn.

What to use when: `weigh` for one candidate; `owner` for whose it can be.

Source: discovery notes, section 4, rule 4; Laplace's evidence as in `refit`: a common size
pays Occam's factor once, own sizes each time.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from gyrorig_solver.discover.banks import all_rows
from gyrorig_solver.discover.refit import Weighed
from gyrorig_solver.discover.scores import sights
from gyrorig_solver.discover.search import best_fit
from gyrorig_solver.discover.together import Together
from gyrorig_solver.estimate.projection import Projection
from gyrorig_solver.estimate.ties import is_of_unit
from gyrorig_solver.model.terms.bound import label
from gyrorig_solver.model.terms.protocol import Term

Owner = Literal["unit", "board", "either"]
# What is a unit's by its kind acts on all boards. That it shows on one alone takes a mount of
# its own that yields or rings as a unit would: believed once in ten thousand.
UNLIKELY_NATS = 9.2


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """One cause, at a common size or at each board's own."""

    term: Term
    common: Weighed | None  # fitted to all boards at once; None: each board's own
    own: tuple[Weighed | None, ...]  # of each board, None where it earns nothing
    looks: float
    evidence: float  # nats, all boards
    won: float

    @property
    def name(self) -> str:
        """The cause, with its recording where it has one."""
        return label(self.term)

    @property
    def whose(self) -> Literal["unit", "board"]:
        """The unit's where its size is common, else each board's."""
        return "board" if self.common is None else "unit"


def owner(term: Term) -> Owner:
    """Return whose a cause can be.

    A clock is either: the unit's and the host's are common to all boards, each board has
    its own.
    """
    if is_of_unit(term):
        return "unit"
    return "either" if term.part == "clock" else "board"


def weigh(boards: Sequence[Projection], term: Term, tests: int) -> list[Hypothesis]:
    """Return what can be made of one cause on several boards, nothing that earns nothing.

    Args:
        boards: the space beside each board's fit without what is to be explained.
        term: the cause.
        tests: how many share the false alarms.
    """
    whose = owner(term)
    found: list[Hypothesis] = []
    fits = [_fit(one, term, tests) for one in boards]
    own = tuple(None if fit is None or fit[0].evidence <= 0.0 else fit[0] for fit in fits)
    some = [one for one in own if one is not None]
    if some:
        less = UNLIKELY_NATS if whose == "unit" else 0.0
        looks = max(fit[1] for fit in fits if fit is not None)
        evidence, won = sum(w.evidence for w in some), sum(w.won for w in some)
        found.append(Hypothesis(term, None, own, looks, evidence - less, won))
    if whose != "board":
        fit = _fit(Together(boards), term, tests)
        if fit is not None and fit[0].evidence > 0.0:
            best, looks = fit
            found.append(Hypothesis(term, best, own, looks, best.evidence, best.won))
    return found


def _fit(projection: Projection, term: Term, tests: int) -> tuple[Weighed, float] | None:
    return best_fit(projection, sights(projection, [term], tests, all_rows(projection, term)))
