"""The causes' fitted values in a space: their uncertainty and their significance.

What to use when: `value_stds` for the standard uncertainties, `wald_p_value` for all sizes of a
cause together.
"""

import numpy as np

from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.discover.fit_space import FitSpace
from gyrorig_solver.model import value_indices
from gyrorig_solver.numerics import chi2_upper_tail


def value_positions(space: FitSpace, k: int) -> IntArray:
    """Return the positions of a cause's fitted values among the parameters of a fit."""
    counts = [fitted_term.free_indices.size for fitted_term in space.fitted_terms]
    first = space.observability.covariance.shape[0] - sum(counts[k:])
    return np.arange(first, first + counts[k])


def value_stds(space: FitSpace, k: int, event_std: float | None = None) -> FloatArray:
    """Return the standard uncertainty of each value of a cause, (k,); inf if not observable.

    Args:
        space: the fit.
        k: index of the cause in the fit.
        event_std: standard uncertainty of the time of an event, which the fit holds fixed.
    """
    extension, positions = space.fitted_terms[k], value_positions(space, k)
    variance = np.diag(space.observability.covariance)[positions]
    observable = [space.observability.is_observable(int(position)) for position in positions]
    stds = np.full(extension.values.size, np.inf)
    stds[extension.free_indices] = np.where(
        observable, np.sqrt(np.clip(variance, 0.0, None)), np.inf
    )
    if event_std is not None:
        events = value_indices(extension.term, role="event")
        stds[[j for j in events if j not in extension.free_indices]] = event_std
    return stds


def wald_p_value(space: FitSpace, k: int) -> float:
    """Return the p-value of a Wald test of a cause's sizes."""
    extension = space.fitted_terms[k]
    is_size = np.isin(extension.free_indices, value_indices(extension.term, role="size"))
    if not is_size.any():
        return 0.0
    positions = value_positions(space, k)[is_size]
    value = extension.values[extension.free_indices[is_size]]
    covariance = space.observability.covariance[np.ix_(positions, positions)]
    indices = np.flatnonzero(np.diag(covariance) > 0.0)
    if not indices.size:
        return 1.0
    inverse = np.linalg.pinv(covariance[np.ix_(indices, indices)], hermitian=True)
    return chi2_upper_tail(float(value[indices] @ inverse @ value[indices]), indices.size)
