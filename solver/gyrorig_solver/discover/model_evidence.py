"""One objective for the models that a search visits: the log marginal likelihood.

Laplace's approximation at a converged fit: the likelihood of the residual and of the reference's
unknowns, at one noise and over the blocks that all models use, times the Occam factor of the
causes' values. The priors are those of `exact_fit`: Cauchy for sizes, uniform for shapes.

What to use when: `best_model` for the models of one search.

Source: MacKay, Information Theory, Inference, and Learning Algorithms, chapter 28.
"""

from collections.abc import Sequence

import numpy as np

from gyrorig_solver.data.arrays import BoolArray
from gyrorig_solver.discover.checks.typical_noise import limit_to_typical
from gyrorig_solver.estimate.converged_fit import ConvergedFit
from gyrorig_solver.estimate.executed_motion import reference_cost
from gyrorig_solver.estimate.fit_objective import residual_cost
from gyrorig_solver.estimate.noise.noise_model import NoiseModel
from gyrorig_solver.model.term import value_indices, value_parameters

# A visited model replaces the last one only if noise does not explain its lead, and so that a
# cause that was removed as insignificant does not return.
MIN_LEAD_NATS = 10.0
EVENT_STD_S = 0.01  # usual uncertainty of an event's time, which a fit holds fixed


def best_model(last: ConvergedFit, visited: Sequence[ConvergedFit]) -> ConvergedFit:
    """Return the visited model with the most evidence; `last` unless another one clearly leads.

    Args:
        last: where the search ended.
        visited: other models of the same recordings; those that did not converge do not count.
    """
    candidates = [solution for solution in visited if solution.converged and solution is not last]
    if not candidates:
        return last
    models = [last, *candidates]
    # Outliers and blocks with uncertain timing differ between models.
    noises = [limit_to_typical(noise) for noise in last.noises]
    used = [
        np.logical_and.reduce(masks)
        for masks in zip(*(model.used_blocks() for model in models), strict=True)
    ]
    evidence = [_log_evidence(solution, last, noises, used) for solution in models]
    best = int(np.argmax(evidence))
    return models[best] if evidence[best] > evidence[0] + MIN_LEAD_NATS else last


def _log_evidence(
    solution: ConvergedFit,
    last: ConvergedFit,
    noises: Sequence[NoiseModel],
    used: Sequence[BoolArray],
) -> float:
    """Return the log marginal likelihood at given noises, nats, up to a common constant.

    The noise in motion is that of `last`, so that all models have the same weights.
    """
    masks = iter(used)
    total = 0.0
    for session, last_session, noise in zip(solution.sessions, last.sessions, noises, strict=True):
        total -= reference_cost(session.reference)
        residuals = session.residuals(solution.gain)
        for index, (series, residual) in enumerate(zip(session.series, residuals, strict=True)):
            masked = np.where(next(masks)[:, None], residual, 0.0)
            stds = [last_session.relative_std(index, blocks) for blocks in series.part_slices()]
            total -= residual_cost(series, masked, noise, stds)
    return total + _occam_nats(solution)


def _occam_nats(solution: ConvergedFit) -> float:
    """Return the logarithm of the Occam factor of the causes' fitted values."""
    count = sum(fitted_term.free_indices.size for fitted_term in solution.fitted_terms)
    if not count:
        return 0.0
    covariance = solution.observability.covariance + solution.observability.unobservable_covariance
    own_covariance = covariance[-count:, -count:]
    total = 0.5 * float(np.linalg.slogdet(2.0 * np.pi * own_covariance)[1])
    duration_s = sum(np.ptp(series.time_s) for s in solution.sessions for series in s.series)
    for fitted_term in solution.fitted_terms:
        events = value_indices(fitted_term.term, role="event") if fitted_term.is_active else ()
        total -= len(events) * float(np.log(duration_s / EVENT_STD_S))
        parameters = value_parameters(fitted_term.term)
        for index in fitted_term.free_indices:
            parameter = parameters[index]
            if parameter.role == "size":
                relative = float(fitted_term.values[index]) / parameter.typical_size
                total -= float(np.log(np.pi * parameter.typical_size * (1.0 + relative**2)))
            else:
                span = parameter.upper - parameter.lower
                total -= float(np.log(span if np.isfinite(span) else parameter.prior_std))
    return total
