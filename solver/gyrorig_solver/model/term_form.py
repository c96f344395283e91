"""The form of a cause for recordings with or without the bandwidth of the sensor's low-pass.

What to use when: `form_for` before a cause of the catalogue is tested or fitted.
"""

from gyrorig_solver.model.term import Term


def form_for(term: Term, has_bandwidth: bool) -> Term:
    """Return the form of a cause for recordings of a board.

    Args:
        term: the cause in its usual form.
        has_bandwidth: whether a recording has the bandwidth of the sensor's low-pass.
    """
    other_form = term.form_without_bandwidth
    return term if has_bandwidth or other_form is None else other_form
