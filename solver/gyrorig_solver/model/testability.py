"""Whether recordings can show a cause, and if not, why.

What to use when: `why_not_testable` before a test of a cause; `why_not_computable` where a cause
counts that the averaging of a long recording hides.
"""

from collections.abc import Sequence

from gyrorig_solver.model.signal_state import SignalState
from gyrorig_solver.model.term import LONG_RECORDING, Term
from gyrorig_solver.model.term_instances import is_active_in


def why_not_testable(term: Term, states: Sequence[SignalState]) -> str | None:
    """Return why recordings that are fitted together cannot show a cause; None if they can.

    Args:
        term: the cause.
        states: of all parts of the recordings.
    """
    for state in states:
        is_hidden = term.is_brief and not (term.needs_moves and state.is_at_rest)
        if is_hidden and state.context.is_averaged and is_active_in(term, state):
            return LONG_RECORDING.format(state.context.mean_duration_s)
    return why_not_computable(term, states)


def why_not_computable(term: Term, states: Sequence[SignalState]) -> str | None:
    """Return why recordings at any sample rate cannot show a cause; None if they can.

    Each recording needs the data to compute the effect. One of them must excite it: a rest beside a
    survey does not prevent the test of a cause that needs moves.
    """
    active = [state for state in states if is_active_in(term, state)]
    for state in active:
        missing = term.missing_data(state)
        if missing is not None:
            return missing
    reasons = [term.missing_excitation(state) for state in active]
    return None if not reasons or None in reasons else reasons[0]
