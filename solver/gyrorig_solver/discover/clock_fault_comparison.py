"""Several clock faults of a model, compared with fewer and with other clock faults.

A skew with a saw-tooth fits a step of a clock nearly as well as the step. A step with a saw-tooth
imitates a skew, and a skew with a saw-tooth imitates a skew with a step. A search that adds one
cause at a time can end with the wrong pair, because its first cause was the best one before the
model contained other causes.

What to use when: `compare_clock_faults` for a model to which no cause can be added.
"""

import math
from collections.abc import Sequence
from itertools import combinations

from gyrorig_solver.data import FloatArray
from gyrorig_solver.discover.exact_fit import fit_candidate
from gyrorig_solver.discover.extended_fit import refit_events
from gyrorig_solver.discover.fit_space import Space
from gyrorig_solver.discover.model_evidence import best_model
from gyrorig_solver.discover.score_tests import FALSE_ALARM_RATE, scan_catalogue
from gyrorig_solver.model import Term, term_label, value_indices

MIN_LEAD_NATS = 1.0  # lead in log evidence by which another fault replaces one fault


def compare_clock_faults(space: Space, terms: Sequence[Term], tests: int) -> Space:
    """Return the model with another clock fault in place of two or of one, if more probable.

    The second fault can be any of the tested causes, each with the same prior probability.
    Therefore the log evidence for two faults must exceed that for one by the logarithm of the
    number of tests.

    Args:
        space: the fit of the model; with fewer than two clock faults it is returned.
        terms: the testable causes.
        tests: how many share the false alarms.
    """
    faults = [k for k in space.free_causes if space.fitted_terms[k].term.part == "clock"]
    if len(faults) < 2:
        return space
    others = [
        term for term in terms if term.part == "clock" and term_label(term) not in space.labels
    ]
    for replaced, min_lead_nats in (
        (list(combinations(faults, 2)), -math.log(tests)),
        ([(k,) for k in faults], MIN_LEAD_NATS),
    ):
        models = [
            model for causes in replaced for model in _replacements(space, causes, others, tests)
        ]
        best = best_model(space, models, min_lead_nats)
        if best is not space:
            return best
    return space


def _replacements(
    space: Space, replaced: tuple[int, ...], terms: Sequence[Term], tests: int
) -> list[Space]:
    """Return the model with each significant clock fault in place of some causes.

    The fit starts with the event of the best template and with the events of the replaced causes.
    From a start far away, the fit cannot find the true event, because it rejects the samples next
    to that event as outliers.
    """
    projector = space.projector_without(*replaced)
    remaining = space.terms_without(*replaced)
    events_s = [
        float(space.fitted_terms[k].values[index])
        for k in replaced
        for index in value_indices(space.fitted_terms[k].term, role="event")
    ]
    models = []
    for term in terms:
        scores = scan_catalogue(projector, [term], tests)
        if not scores or scores[0].p_value >= FALSE_ALARM_RATE:
            continue
        starts = [scores[0].template, *_with_events(term, scores[0].template, events_s)]
        for start in starts:
            fitted = fit_candidate(projector, term, None, [start])
            if fitted is not None and not fitted.infeasible:
                models.append(refit_events(space.refit([*remaining, fitted.extension])))
    return models


def _with_events(term: Term, template: FloatArray, events_s: Sequence[float]) -> list[FloatArray]:
    """Return a template with each of some times in place of its event."""
    indices = list(value_indices(term, role="event"))
    templates = []
    for event_s in events_s if indices else ():
        moved = template.copy()
        moved[indices] = event_s
        templates.append(moved)
    return templates
