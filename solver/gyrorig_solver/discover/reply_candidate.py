"""A cause of the motion law that the replies of the unit show, while the samples show little.

A wrong base speed makes every move shorter. Starts and time offset absorb that, but the replies
during the ramps show it.

What to use when: `candidate_from_replies` in a search when no cause is significant in the samples.
"""

import numpy as np

from gyrorig_solver.discover.cause_findings import NamedCause
from gyrorig_solver.discover.checks.ramp_acceleration import ACCELERATION_ERROR, detect_ramp_error
from gyrorig_solver.discover.exact_fit import FittedCandidate
from gyrorig_solver.estimate.converged_fit import ConvergedFit
from gyrorig_solver.estimate.fitted_term import FittedTerm
from gyrorig_solver.model.term import value_parameters


def candidate_from_replies(
    solution: ConvergedFit, tests: int, alpha: float
) -> FittedCandidate | None:
    """Return a law that explains the replies better than fitted accelerations do, or None.

    The accelerations of the moves are unknowns of every fit, so they are no candidate.

    Args:
        solution: the fit of a search.
        tests: how many share the false alarms.
        alpha: rate of false alarms of all of them.
    """
    named = detect_ramp_error(solution, tests, alpha).named
    if named is None or named.term.cause == ACCELERATION_ERROR:
        return None
    return _candidate_of(named, solution)


def _candidate_of(named: NamedCause, solution: ConvergedFit) -> FittedCandidate:
    parameters = value_parameters(named.term)
    values = named.extension.values
    free = np.flatnonzero(values)
    stds = np.array([named.values[k].std for k in free])
    known = np.where(np.isfinite(stds), stds, [parameters[k].prior_std for k in free])
    gain_nats = 0.5 * named.statistic
    typical = np.array([parameters[k].typical_size for k in free])
    # Laplace's approximation with a Cauchy prior, as in `exact_fit`.
    occam_nats = np.log(np.pi * typical * (1.0 + (values[free] / typical) ** 2))
    occam_nats -= 0.5 * np.log(2.0 * np.pi * known**2)
    return FittedCandidate(
        extension=FittedTerm(named.term, values, free),
        place=None,
        delta_log_likelihood=gain_nats,
        log_evidence=gain_nats - float(np.sum(occam_nats)),
        std=known,
        absorbed=np.zeros(solution.estimate.size),
        infeasible=False,
    )
