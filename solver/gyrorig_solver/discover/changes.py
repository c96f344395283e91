"""What causes do to the numbers of a calibration, in its own names.

What to use when: `Board.of` at a fit; `changes` between two fits, `moved` for what an effect
that nobody knows of would move, to first order.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.discover.result import CalibrationChange
from gyrorig_solver.estimate.likelihood import GAINS, PER_SESSION, Solution
from gyrorig_solver.estimate.observability import BIAS_NAMES
from gyrorig_solver.model.gain import FACTOR_NAMES, factor_jacobian, factorise

PARAMETERS = (*FACTOR_NAMES, *BIAS_NAMES, "time_offset")
UNITS = ("1",) * 6 + ("rad",) * 3 + ("rad/s",) * 3 + ("s",)


@dataclass(frozen=True, slots=True, eq=False)
class Board:
    """The calibration of a fit: values and deviations over `PARAMETERS`."""

    values: FloatArray  # (13,)
    std: FloatArray  # (13,), nan where the data say nothing
    turn: FloatArray  # (13, 13), from the fit's own parameters

    @classmethod
    def of(cls, solution: Solution) -> Self:
        """Return the calibration of a fit, of its last recording."""
        factors = factorise(solution.gain)
        turn = np.eye(GAINS + PER_SESSION)
        turn[:GAINS, :GAINS] = factor_jacobian(factors)
        own = slice(0, GAINS + PER_SESSION)
        covariance = turn @ solution.decision.covariance[own, own] @ turn.T
        hidden = np.diag(turn @ solution.decision.hidden[own, own] @ turn.T)
        variance = np.diag(covariance)
        std = np.where(variance > hidden, np.sqrt(np.clip(variance, 0.0, None)), np.nan)
        values = np.concatenate([factors.as_vector(), solution.estimate[GAINS : own.stop]])
        return cls(values, std, turn)

    def moved(self, taken: FloatArray) -> FloatArray:
        """Return the change of each parameter, (13,), of the fit's own (G, (b, tau)s, ...)."""
        return np.asarray(self.turn @ taken, dtype=np.float64)

    def changes(self, before: FloatArray) -> tuple[CalibrationChange, ...]:
        """Return each known parameter's change from values (13,), the largest first."""
        found = [
            CalibrationChange(name, float(old), float(new), float(std), unit)
            for name, old, new, std, unit in zip(
                PARAMETERS, before, self.values, self.std, UNITS, strict=True
            )
            if np.isfinite(std)
        ]
        return tuple(sorted(found, key=lambda one: -one.sigma))


def own_part(taken: FloatArray, recordings: int) -> FloatArray:
    """Return what of a change of all fitted parameters is the last recording's, (13,)."""
    last = GAINS + PER_SESSION * (recordings - 1)
    return np.concatenate([taken[:GAINS], taken[last : last + PER_SESSION]])
