"""The scope of a cause: one common size on all boards of a unit, or a size of each board.

All boards show a cause of the unit with the same size, but a cause of a board can be on one board
only. One board may not distinguish the two, for example a controller that rounds its ramps from a
low-pass of the board. Then the evidence of one common size is compared with the sum of the evidence
of separate sizes. A common size has one Occam factor, and separate sizes have one per board
(Laplace's approximation, as in `exact_fit`).

What to use when: `compare_scopes` for one candidate; `possible_owner` for its possible scopes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from gyrorig_solver.discover.boards.joint_projector import JointProjector
from gyrorig_solver.discover.candidate_fits import fit_best_place
from gyrorig_solver.discover.exact_fit import FittedCandidate
from gyrorig_solver.discover.score_tests import scan_catalogue
from gyrorig_solver.discover.template_choice import all_templates
from gyrorig_solver.estimate import NuisanceProjector, is_unit_cause
from gyrorig_solver.model import Term, term_label

Owner = Literal["unit", "board", "either"]
# A cause of the unit acts on all boards. A single board can show such an effect only if its own
# mount yields or rings like a unit. The assumed probability of that is one in 10,000.
SINGLE_BOARD_PENALTY_NATS = 9.2


@dataclass(frozen=True, slots=True, eq=False)
class ScopeHypothesis:
    """One cause with one common size, or with a separate size on each board."""

    term: Term
    common: FittedCandidate | None  # fitted to all boards together; None: separate sizes
    per_board: tuple[FittedCandidate | None, ...]  # of each board; None without positive evidence
    effective_trials: float
    log_evidence: float  # nats, of all boards
    delta_log_likelihood: float

    @property
    def name(self) -> str:
        """The cause's label, with its recording if it is limited to one."""
        return term_label(self.term)


def possible_owner(term: Term) -> Owner:
    """Return whether a cause can belong to the unit, to a board, or to either.

    A cause of a clock can belong to either: the clocks of the unit and of the host are common to
    all boards, and each board has its own clock.
    """
    if is_unit_cause(term):
        return "unit"
    return "either" if term.part == "clock" else "board"


def compare_scopes(
    boards: Sequence[NuisanceProjector], term: Term, tests: int
) -> list[ScopeHypothesis]:
    """Return the hypotheses about one cause on several boards that have positive evidence.

    Args:
        boards: the nuisance projector at the fit of each board without the cause to explain.
        term: the cause.
        tests: how many share the false alarms.
    """
    ownership = possible_owner(term)
    hypotheses: list[ScopeHypothesis] = []
    fits = [_fit_term(fitted, term, tests) for fitted in boards]
    per_board = tuple(None if fit is None or fit[0].log_evidence <= 0.0 else fit[0] for fit in fits)
    supporting = [fitted for fitted in per_board if fitted is not None]
    if supporting:
        penalty = SINGLE_BOARD_PENALTY_NATS if ownership == "unit" else 0.0
        trials = max(fit[1] for fit in fits if fit is not None)
        evidence = sum(fitted.log_evidence for fitted in supporting)
        gain = sum(fitted.delta_log_likelihood for fitted in supporting)
        hypotheses.append(ScopeHypothesis(term, None, per_board, trials, evidence - penalty, gain))
    if ownership != "board":
        fit = _fit_term(JointProjector(boards), term, tests)
        if fit is not None and fit[0].log_evidence > 0.0:
            best, trials = fit
            hypotheses.append(
                ScopeHypothesis(
                    term, best, per_board, trials, best.log_evidence, best.delta_log_likelihood
                )
            )
    return hypotheses


def _fit_term(
    projection: NuisanceProjector, term: Term, tests: int
) -> tuple[FittedCandidate, float] | None:
    return fit_best_place(
        projection, scan_catalogue(projection, [term], tests, all_templates(projection, term))
    )
