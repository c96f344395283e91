"""One objective for the models that a search visits: the log marginal likelihood.

It is Laplace's approximation at a converged fit: the likelihood of the residual and of the unknowns
of the reference, times the Occam factor of the values of the causes. All models are compared with
the same noise model and on the blocks that all of them use. The priors are those of `exact_fit`:
Cauchy for sizes, uniform for shapes.

Source: MacKay, Information Theory, Inference, and Learning Algorithms, chapter 28.
"""

from collections.abc import Sequence

import numpy as np

from gyrorig_solver.discover.fit_space import FitSpace, Space
from gyrorig_solver.model import value_indices, value_parameters

# A visited model replaces the last one only with this lead. Noise does not explain the lead, and it
# is more than the gain of a cause that was removed as insignificant.
MIN_LEAD_NATS = 10.0
HELD_SHAPES = 400  # number of possible values of a held shape, for example a saw-tooth's period
EVENT_STD_S = 0.01  # typical standard uncertainty of an event's time, which a fit holds fixed


def best_model(
    last: Space, visited: Sequence[Space], min_lead_nats: float = MIN_LEAD_NATS
) -> Space:
    """Return the visited model with the most evidence; `last` unless another one clearly leads.

    Args:
        last: the model at the end of the search.
        visited: other models of the same recordings; models that did not converge are ignored.
        min_lead_nats: lead in log evidence that another model needs.
    """
    candidates = [space for space in visited if space.convergence.converged and space is not last]
    if not candidates:
        return last
    models = [last, *candidates]
    likelihoods = last.log_likelihoods(models)
    evidence = [nats + _occam_nats(model) for nats, model in zip(likelihoods, models, strict=True)]
    best = int(np.argmax(evidence))
    return models[best] if evidence[best] > evidence[0] + min_lead_nats else last


def _occam_nats(space: FitSpace) -> float:
    """Return the logarithm of the Occam factor of the causes' fitted values."""
    count = sum(fitted_term.free_indices.size for fitted_term in space.fitted_terms)
    if not count:
        return 0.0
    covariance = space.observability.covariance + space.observability.unobservable_covariance
    own_covariance = covariance[-count:, -count:]
    total = 0.5 * float(np.linalg.slogdet(2.0 * np.pi * own_covariance)[1])
    for fitted_term in space.fitted_terms:
        events = value_indices(fitted_term.term, role="event") if fitted_term.is_active else ()
        total -= len(events) * float(np.log(space.duration_s / EVENT_STD_S))
        parameters = value_parameters(fitted_term.term)
        if fitted_term.term.holds_shapes:
            held = set(value_indices(fitted_term.term, role="shape")) - {*fitted_term.free_indices}
            total -= len(held) * float(np.log(HELD_SHAPES))
        for index in fitted_term.free_indices:
            parameter = parameters[index]
            if parameter.role == "size":
                total += parameter.log_prior_of_size(float(fitted_term.values[index]))
            else:
                span = parameter.upper - parameter.lower
                total -= float(np.log(span if np.isfinite(span) else parameter.prior_std))
    return total
