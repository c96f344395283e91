"""The interface of reference motions to the estimator.

A reference gives the rate of the stage and its derivatives by the unknowns of the reference (for
example the start time of a move, or a speed). The estimator fits these unknowns with the
parameters of the board; each has a prior from the reference.
"""

from dataclasses import dataclass, field
from typing import Protocol, Self

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.numerics import ArrowheadMatrix


@dataclass(frozen=True, slots=True, eq=False)
class LocalDerivative:
    """A derivative of the stage rate that is zero outside some consecutive intervals."""

    unknown: int  # index of the unknown, local ones first
    first_interval: int  # index of its first interval
    values: FloatArray  # (m, 3), stage rate per unit of the unknown


@dataclass(frozen=True, slots=True, eq=False)
class EvaluatedMotion:
    """A reference motion evaluated over consecutive intervals."""

    rate_rad_s: FloatArray  # (n, 3), mean stage rate; nan if not known
    local: tuple[LocalDerivative, ...]  # by the local unknowns that act between these edges
    shared: FloatArray  # (g, n, 3), by the shared unknowns that act on the rate
    # (q, n, 3), by the values of the motion law that it follows; see `unit.motion_law`.
    law: FloatArray = field(default_factory=lambda: np.zeros((0, 0, 3)))


class ReferenceMotion(Protocol):
    """The motion of a stage on the time axis of a recording."""

    @property
    def description(self) -> str:
        """One sentence on the reference."""
        ...

    @property
    def information(self) -> ArrowheadMatrix:
        """Information about the unknowns: local ones, then shared ones.

        Unknowns that do not act on the rate are last among the local and the shared ones.
        """
        ...

    @property
    def prior_offset(self) -> FloatArray:
        """Prior mean of the unknowns minus their current values, shape (k + g,)."""
        ...

    @property
    def common_shift_std_s(self) -> float:
        """Standard deviation of a common time shift that the reference cannot determine."""
        ...

    @property
    def is_differentiated(self) -> bool:
        """Whether the rates are differences of noisy attitudes."""
        ...

    def evaluate(self, edges_s: FloatArray, derivatives: bool = True) -> EvaluatedMotion:
        """Return the mean stage rate between consecutive times, shape (n + 1,).

        Without `derivatives` the result has no local and no shared derivatives.
        """
        ...

    def with_step(self, step: FloatArray) -> Self:
        """Return the reference with its unknowns changed by `step`, shape (k + g,)."""
        ...
