"""Sizes of persistent causes: the values that later recordings on the same unit can reuse.

A cause whose card sets `is_persistent` is a property of the unit: its axes, its gears, its sag. Its
sizes, in the order of the catalogue, form one vector for every unit. Shapes have the start values
of the card.

What to use when: `unit_value_names` for the names; `table_covariance` for the prior of an unknown
unit; `UnitPosterior` for the result of recordings.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Self

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate import FittedTerm
from gyrorig_solver.model import (
    Term,
    recording_index_of,
    value_indices,
    value_labels,
    value_parameters,
)
from gyrorig_solver.model.catalogue import catalogue
from gyrorig_solver.numerics import posterior_covariance
from gyrorig_solver.uncertainty.uncertainty_settings import UncertaintySettings

# A fitted shape that differs more from the card's start value describes another effect, such as a
# worm error with half the period.
MAX_SHAPE_CHANGE = 3.0  # in typical sizes of the shape


@dataclass(frozen=True, slots=True, eq=False)
class UnitPosterior:
    """Mean and covariance of the sizes of a unit's persistent causes, SI."""

    mean: FloatArray  # (k,), in the order of `unit_value_names`
    covariance: FloatArray  # (k, k)

    @classmethod
    def from_table(cls, settings: UncertaintySettings) -> Self:
        """Return the prior of an unknown unit."""
        covariance = table_covariance(settings)
        return cls(np.zeros(len(covariance)), covariance)

    def after(self, days: float, settings: UncertaintySettings) -> Self:
        """Return the posterior some days later: every size may have drifted as a random walk.

        A direction whose variance would be above that of an unknown unit is forgotten: it gets the
        prior of the table, mean zero. A unit that was measured is never less known than a new one.
        """
        covariance = self.covariance + np.diag(_drift_std(settings) ** 2) * max(days, 0.0)
        table_std = np.sqrt(np.diag(table_covariance(settings)))
        scale = np.where(table_std > 0.0, table_std, 1.0)  # 0: the settings leave the cause out
        variances, directions = np.linalg.eigh(covariance / np.outer(scale, scale))
        forgotten = variances > 1.0
        if not forgotten.any():
            return replace(self, covariance=covariance)
        share = np.where(forgotten, 0.0, directions.T @ (self.mean / scale))
        capped = (directions * np.minimum(variances, 1.0)) @ directions.T
        return replace(
            self,
            mean=table_std * (directions @ share),
            covariance=capped * np.outer(table_std, table_std),
        )

    def updated(self, information: "UnitInformation") -> Self:
        """Return the posterior with the information of one more recording."""
        scale = np.sqrt(np.diag(self.covariance))
        scale = np.where(scale > 0.0, scale, 1.0)
        prior = self.covariance / np.outer(scale, scale)
        data = information.matrix * np.outer(scale, scale)
        score = (information.vector - information.matrix @ self.mean) * scale
        covariance = posterior_covariance(data, prior)
        return replace(
            self,
            mean=self.mean + scale * (covariance @ score),
            covariance=covariance * np.outer(scale, scale),
        )

    def entropy_gain(self, information: "UnitInformation") -> float:
        """Return how much a recording's information reduces the entropy, nats."""
        _, log_determinant = np.linalg.slogdet(
            np.eye(len(self.mean)) + information.matrix @ self.covariance
        )
        return 0.5 * float(log_determinant)


@dataclass(frozen=True, slots=True, eq=False)
class UnitInformation:
    """Information of one recording on the sizes: log-likelihood u'v - u'Mu/2, SI."""

    matrix: FloatArray  # (k, k)
    vector: FloatArray  # (k,)


@dataclass(frozen=True, slots=True)
class _UnitValue:
    name: str
    term: Term
    index: int  # among the values of the term


@cache
def _unit_values() -> tuple[_UnitValue, ...]:
    return tuple(
        _UnitValue(value_labels(term)[index], term, index)
        for term in catalogue().values()
        if term.is_persistent
        for index in value_indices(term, role="size")
    )


def unit_value_names() -> tuple[str, ...]:
    """Return the name of every size: cause, parameter and axis."""
    return tuple(value.name for value in _unit_values())


def unit_value_units() -> tuple[str, ...]:
    """Return the SI unit of every size."""
    return tuple(value_parameters(value.term)[value.index].unit for value in _unit_values())


def unit_value_limits() -> dict[str, float]:
    """Return the largest possible magnitude of every size, SI."""
    parameters = [
        (value.name, value_parameters(value.term)[value.index]) for value in _unit_values()
    ]
    return {name: max(abs(known.lower), abs(known.upper)) for name, known in parameters}


def unit_value_position(term: Term, index: int) -> int | None:
    """Return the position of a term's value among the sizes; None if it is not persistent."""
    if not term.is_persistent or recording_index_of(term) is not None:
        return None
    name = value_labels(term)[index]
    return unit_value_names().index(name) if name in unit_value_names() else None


def fitted_unit_values(
    fitted_terms: Sequence[FittedTerm],
) -> list[tuple[int, int, float]]:
    """Return the fitted persistent sizes.

    Args:
        fitted_terms: of a fit.

    Returns:
        For each size: its position among the fitted values of all causes, its position in
        `unit_value_names`, and its value.
    """
    located = []
    first = 0
    for fitted_term in fitted_terms:
        for offset, index in enumerate(fitted_term.free_indices):
            position = unit_value_position(fitted_term.term, int(index))
            if position is not None and _has_start_shape(fitted_term):
                located.append((first + offset, position, float(fitted_term.values[index])))
        first += fitted_term.free_indices.size
    return located


def table_covariance(settings: UncertaintySettings) -> FloatArray:
    """Return the covariance (k, k) of the sizes of an unknown unit."""
    std = [
        settings.prior_sizes[value.term.cause].std
        if value.term.cause in settings.prior_sizes
        else 0.0
        for value in _unit_values()
    ]
    return np.diag(np.square(std))


def _drift_std(settings: UncertaintySettings) -> FloatArray:
    """Return the change of each size within a day, one standard deviation, (k,)."""
    return np.array([settings.drifts.get(value.term.cause, 0.0) for value in _unit_values()])


def _has_start_shape(fitted_term: FittedTerm) -> bool:
    parameters = value_parameters(fitted_term.term)
    return all(
        abs(fitted_term.values[index] - parameters[index].start)
        <= MAX_SHAPE_CHANGE * parameters[index].typical_size
        for index in value_indices(fitted_term.term, role="shape")
    )
