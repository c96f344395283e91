"""The finding of a named cause: all that the report states about it.

What to use when: `name_cause` for a cause of a fit; `name_outside_fit` for a cause that the mean of
the residual does not show.
"""

from collections.abc import Sequence

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.discover.calibration_changes import CalibrationValues
from gyrorig_solver.discover.candidate_fits import global_p_value
from gyrorig_solver.discover.cause_findings import (
    FittedValue,
    HeldOutGain,
    NamedCause,
    RivalCause,
)
from gyrorig_solver.discover.cause_ranking import RankedCause
from gyrorig_solver.discover.fit_space import FitSpace
from gyrorig_solver.discover.fitted_values import value_stds
from gyrorig_solver.estimate import FittedTerm
from gyrorig_solver.model import (
    Term,
    components_of,
    recording_index_of,
    value_indices,
    value_names,
    value_parameters,
)

ACTING_SIGMA = 3.0  # standard deviations from zero of a part on which a cause acts


def name_cause(
    space: FitSpace,
    k: int,
    ranked: RankedCause,
    calibration: CalibrationValues,
    tests: int,
    gain: HeldOutGain | None,
) -> NamedCause:
    """Return the finding of a cause of a fit.

    Args:
        space: the fit.
        k: index of the cause in the fit.
        ranked: the ranking of the cause.
        calibration: the calibration of the fit.
        tests: how many share the false alarms.
        gain: the gain of the cause on held-out data.
    """
    extension, candidate = space.fitted_terms[k], ranked.candidate
    left_out = calibration.propagate(candidate.absorbed)
    number = recording_index_of(extension.term)
    return NamedCause(
        term=extension.term,
        where=_acting_parts(extension, value_stds(space, k)),
        extension=extension,
        values=_fitted_values(extension, value_stds(space, k, candidate.event_std)),
        statistic=2.0 * max(candidate.delta_log_likelihood, 0.0),
        degrees_of_freedom=len(extension.free_sizes),
        p_value=global_p_value(candidate, ranked.effective_trials, tests),
        posterior=ranked.posterior,
        one_of=ranked.one_of,
        rivals=ranked.describe_rivals(),
        changes=calibration.changes_from(calibration.values + left_out),
        gain=gain,
        recording=None if number is None else space.recording_names[number],
    )


def name_outside_fit(
    term: Term,
    sizes: Sequence[float] | FloatArray,
    stds: Sequence[float] | FloatArray,
    where: tuple[str, ...],
    *,
    statistic: float,
    degrees_of_freedom: int,
    p_value: float,
    posterior: float = 1.0,
    one_of: tuple[str, ...] = (),
    rivals: tuple[RivalCause, ...] = (),
) -> NamedCause:
    """Return the finding of a cause that is not in the fit and does not bias the calibration.

    Args:
        term: the cause.
        sizes: all its values, (k,).
        stds: their standard uncertainties, (k,).
        where: the parts on which it acts.
        statistic: twice the gain of the log-likelihood.
        degrees_of_freedom: of the statistic.
        p_value: with all tests counted.
        posterior: probability among its rivals.
        one_of: the rivals that the data do not exclude.
        rivals: all rivals.
    """
    extension = FittedTerm(term, np.asarray(sizes, np.float64), np.zeros(0, dtype=np.int64))
    return NamedCause(
        term=term,
        where=where,
        extension=extension,
        values=_fitted_values(extension, stds),
        statistic=statistic,
        degrees_of_freedom=degrees_of_freedom,
        p_value=p_value,
        posterior=posterior,
        one_of=one_of,
        rivals=rivals,
        changes=(),
        gain=None,
    )


def _fitted_values(
    extension: FittedTerm, stds: Sequence[float] | FloatArray
) -> tuple[FittedValue, ...]:
    return tuple(
        FittedValue(name, float(value), float(std), parameter.unit, parameter.typical_size)
        for name, value, std, parameter in zip(
            value_names(extension.term),
            extension.values,
            stds,
            value_parameters(extension.term),
            strict=True,
        )
    )


def _acting_parts(extension: FittedTerm, stds: FloatArray) -> tuple[str, ...]:
    """Return the parts with significant sizes of a cause, at least the most significant part."""
    sigma = np.abs(extension.values) / stds
    strength = {
        place: float(sigma[value_indices(extension.term, place, "size")].max())
        for place in components_of(extension.term)
    }
    acting = tuple(place for place, size in strength.items() if size > ACTING_SIGMA)
    if acting or not strength:
        return acting
    return (max(strength, key=lambda place: strength[place]),)
