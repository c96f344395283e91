"""What every reference motion offers to the estimator.

A reference says at which rate the stage turned, and which of its own unknowns (a move's
start, a speed) would change that rate and how. The estimator fits those unknowns with
the board's, each held by what the reference already knows of it.
"""

from dataclasses import dataclass
from typing import Protocol, Self

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.arrow import Arrow


@dataclass(frozen=True, slots=True, eq=False)
class LocalColumn:
    """A derivative of the stage rate that is zero outside one stretch."""

    unknown: int  # which of the reference's unknowns, local ones first
    first: int  # index of its first interval
    values: FloatArray  # (m, 3), stage rate per unit of the unknown


@dataclass(frozen=True, slots=True, eq=False)
class Evaluated:
    """A reference over consecutive intervals."""

    rate_rad_s: FloatArray  # (n, 3), mean stage rate; nan where it is not known
    local: tuple[LocalColumn, ...]  # of the local unknowns that act between these edges
    shared: FloatArray  # (g, n, 3), by the shared unknowns that act on the rate


class ReferenceMotion(Protocol):
    """A stage's motion on the recording's time axis."""

    @property
    def description(self) -> str:
        """One sentence: what the rates are compared with."""
        ...

    @property
    def information(self) -> Arrow:
        """What is known of the unknowns: local ones, then shared ones.

        Those that do not act on the rate come last among the local and the shared ones.
        """
        ...

    @property
    def pull(self) -> FloatArray:
        """Where that knowledge has them, minus where they are now, shape (k + g,)."""
        ...

    @property
    def common_std_s(self) -> float:
        """One shift of the whole reference in time that nothing in it can show."""
        ...

    @property
    def differentiated(self) -> bool:
        """True where the rates come from differences of noisy attitudes."""
        ...

    def evaluate(self, edges_s: FloatArray, derivatives: bool = True) -> Evaluated:
        """Return the mean stage rate between consecutive times, shape (n + 1,).

        Without `derivatives` the columns are left out: no local ones, no shared ones.
        """
        ...

    def moved(self, step: FloatArray) -> Self:
        """Return the reference with its unknowns changed by `step`, shape (k + g,)."""
        ...
