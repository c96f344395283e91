"""The parameters of the document, derived from an estimate of gain, bias and time offset.

A number that the data do not determine is null, and a reason states a motion that determines it.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate.factor_covariance import is_observable_number, propagate_to_factors
from gyrorig_solver.estimate.gyro_fit import ObservabilityReport
from gyrorig_solver.estimate.observability import (
    BIAS_NAMES,
    PRIOR_STD,
    ObservabilityAnalysis,
    prior_std,
)
from gyrorig_solver.model import FACTOR_NAMES


@dataclass(frozen=True, slots=True, eq=False)
class DerivedParameters:
    """The document's parameters: values, standard deviations, covariance; nan if unobservable."""

    gain: FloatArray  # (3, 3)
    gain_std: FloatArray  # (3, 3)
    values: dict[str, float]
    std: dict[str, float]
    order: tuple[str, ...]
    covariance: FloatArray
    observability: ObservabilityReport

    def values_of_group(self, group: str) -> FloatArray:
        """Return the three values of a group such as `scale`, shape (3,)."""
        return np.array([v for n, v in self.values.items() if n.startswith(group + ".")])


def derive_parameters(
    estimate: FloatArray,
    names: tuple[str, ...],
    analysis: ObservabilityAnalysis,
    reason_texts: Mapping[str, str],
    unit_std: FloatArray | None = None,
) -> DerivedParameters:
    """Convert an estimate of (gain, bias, offset) to the parameters of the document.

    A derived number is unobservable if the prior, through the unobservable directions, changes it
    by more than the data's uncertainty. In this case, the prior would determine the number. The
    factors depend on the gain nonlinearly, and the prior is propagated through the exact
    factorisation (`factor_covariance`).

    Args:
        estimate: values of `names`, shape (n,); unobservable directions at their prior mean.
        names: `GAIN_NAMES`, then any of `BIAS_NAMES`, then optionally `time_offset`, then
            optionally values of causes beyond the base model.
        analysis: of the same names.
        reason_texts: for each gain column `x`, `y`, `z` and for `bias` and `time_offset`, a reason
            why the data could not show it, and a remedy.
        unit_std: prior standard deviation of each name; required if there are causes.
    """
    unit_std = prior_std(names) if unit_std is None else unit_std
    derived = propagate_to_factors(estimate, analysis.covariance, analysis.unobservable_covariance)
    derived_names = (*FACTOR_NAMES, *names[9:])
    is_observed = derived.is_observable(
        np.concatenate([np.full(9, PRIOR_STD["gain"]), unit_std[9:]])
    )
    gain_observed = is_observable_number(
        np.diag(analysis.covariance)[:9],
        np.diag(analysis.unobservable_covariance)[:9],
        np.full(9, PRIOR_STD["gain"]),
    ).reshape(3, 3)
    gain_std = np.sqrt(np.diag(analysis.covariance + analysis.unobservable_covariance)[:9]).reshape(
        3, 3
    )
    values, total_covariance = derived.values, derived.total
    document_order = _document_order(derived_names)
    position = {name: i for i, name in enumerate(derived_names)}
    observed_names = [name for name in document_order if is_observed[position[name]]]
    observed_positions = [position[name] for name in observed_names]
    unobserved_names = tuple(name for name in document_order if not is_observed[position[name]])
    base_positions = [i for i, n in enumerate(names) if n.startswith(("gain", "bias"))]
    direction_count = len(base_positions)
    lost_count = _unobservable_directions(
        analysis.unobservable_covariance, unit_std, base_positions
    )
    return DerivedParameters(
        gain=np.where(gain_observed, estimate[:9].reshape(3, 3), np.nan),
        gain_std=np.where(gain_observed, gain_std, np.nan),
        values={
            n: float(values[position[n]]) if is_observed[position[n]] else np.nan
            for n in document_order
        },
        std={
            n: float(np.sqrt(total_covariance[position[n], position[n]]))
            if is_observed[position[n]]
            else np.nan
            for n in document_order
        },
        order=tuple(observed_names),
        covariance=total_covariance[np.ix_(observed_positions, observed_positions)],
        observability=ObservabilityReport(
            rank=direction_count - lost_count,
            of=direction_count,
            condition=analysis.condition,
            unobservable=unobserved_names,
            reasons=_reason_texts(
                analysis.unobservable_covariance / np.outer(unit_std, unit_std),
                unobserved_names,
                reason_texts,
            ),
        ),
    )


def _unobservable_directions(
    unobservable: FloatArray, unit_std: FloatArray, base_positions: list[int]
) -> int:
    """Return the number of directions of gain and bias that the data do not determine."""
    inner = (unobservable / np.outer(unit_std, unit_std))[np.ix_(base_positions, base_positions)]
    return int(np.sum(np.linalg.eigvalsh(inner) > 0.5))


def _document_order(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the names in the document's order: bias, factors, time offset, causes."""
    bias = [name for name in names if name in BIAS_NAMES]
    factors = [name for name in names if name in FACTOR_NAMES]
    leading = (*bias, *factors, *(name for name in names if name == "time_offset"))
    return (*leading, *(name for name in names if name not in leading))


def _reason_texts(
    unobservable: FloatArray, unobserved_names: tuple[str, ...], reason_texts: Mapping[str, str]
) -> tuple[str, ...]:
    """Return one reason per unobservable group; `unobservable` in units of the prior."""
    column_share = np.diag(unobservable)[:9].reshape(3, 3).max(axis=0)
    # A column belongs to an unobservable direction if a tenth of its prior remains. A direction
    # that contains many parameters belongs to the column with the largest share of it.
    least_share = 0.1
    if any(n in FACTOR_NAMES for n in unobserved_names):
        least_share = min(least_share, 0.999 * float(column_share.max()))
    columns = [
        column
        for column, share in zip("xyz", column_share, strict=True)
        if share > least_share and column in reason_texts
    ]
    reasons: list[str] = []
    for text in dict.fromkeys(reason_texts[column] for column in columns):
        same_reason = [column for column in columns if reason_texts[column] == text]
        reasons.append(
            f"column{'s' * (len(same_reason) > 1)} {', '.join(same_reason)} of the gain: {text}"
        )
    if any(n in BIAS_NAMES for n in unobserved_names) and "bias" in reason_texts:
        reasons.append(f"bias: {reason_texts['bias']}")
    if "time_offset" in unobserved_names and "time_offset" in reason_texts:
        reasons.append(f"time offset: {reason_texts['time_offset']}")
    reasons += [
        f"{n}: {reason_texts[n]}"
        for n in unobserved_names
        if n in reason_texts and n != "time_offset"
    ]
    return tuple(reasons)
