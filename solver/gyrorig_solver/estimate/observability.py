"""Observability: which parameters the data determine, relative to their physical range.

Parameters have different units, so a condition number alone has no meaning. Here each direction of
parameter space is measured in units of its prior: the possible deviation of a real board's value
from nominal. A direction whose standard deviation is above half of the prior's is unobservable: its
value stays null, although a solver would print a number. (SciPy reports success with 1.75 or 15.6
for an unexcited parameter of true value 0.03; see docs/explain/bound.md.)
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from gyrorig_solver.data import FloatArray

BIAS_NAMES = ("bias.x", "bias.y", "bias.z")

# Deviation of real parts from nominal. Gain entries: scale factor +-15 % at worst (L3G4200D
# family), mount and cross-axis a few degrees. Bias: +-25 dps at worst. Offset: a loaded link.
PRIOR_STD = {"gain": 0.1, "bias": 0.45, "time_offset": 0.1}
# A direction is observable if the data alone give at most half of its prior standard deviation.
MAX_STD_RATIO = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class ObservabilityAnalysis:
    """The split of parameter space into observable and unobservable directions."""

    covariance: FloatArray  # (n, n), from the data, zero along unobservable directions
    unobservable_covariance: FloatArray  # (n, n), of the prior, along unobservable directions
    pseudo_inverse: FloatArray  # (n, n), of the information, along observable directions
    rank: int
    condition: float

    def widened(self, factors: FloatArray) -> Self:
        """Return the analysis with each parameter's standard deviation times a factor, (n,)."""
        covariance = self.covariance * np.outer(factors, factors)
        return replace(self, covariance=covariance)

    def is_observable(self, index: int) -> bool:
        """Return whether a parameter's variance is larger from the data than from the prior."""
        return bool(
            0.0 < self.covariance[index, index] > self.unobservable_covariance[index, index]
        )


def prior_std(names: tuple[str, ...]) -> FloatArray:
    """Return the prior standard deviation of each named parameter, shape (n,)."""
    return np.array([PRIOR_STD[name.partition(".")[0]] for name in names])


def analyse_observability(information: FloatArray, names: tuple[str, ...]) -> ObservabilityAnalysis:
    """Split the space of named parameters by their information matrix.

    Args:
        information: inverse covariance of the parameters, with nuisances marginalised, (n, n).
        names: of the parameters, as in `GAIN_NAMES`, `BIAS_NAMES` and `time_offset`.
    """
    return analyse_scaled_observability(information, prior_std(names))


def analyse_scaled_observability(
    information: FloatArray, prior_std: FloatArray
) -> ObservabilityAnalysis:
    """Split a space of parameters of any kind, each in units of its prior.

    Args:
        information: inverse covariance of the parameters, with nuisances marginalised, (n, n).
        prior_std: prior standard deviation of each, shape (n,).
    """
    values, vectors = np.linalg.eigh(information * np.outer(prior_std, prior_std))
    observed = values > 1.0 / MAX_STD_RATIO**2
    directions = prior_std[:, None] * vectors
    inverse = (directions[:, observed] / values[observed]) @ directions[:, observed].T
    unobservable = directions[:, ~observed] @ directions[:, ~observed].T
    return ObservabilityAnalysis(
        covariance=inverse,
        unobservable_covariance=unobservable,
        pseudo_inverse=inverse,
        rank=int(np.sum(observed)),
        condition=_condition_number(information, bool(observed.all())),
    )


def _condition_number(information: FloatArray, all_observed: bool) -> float:
    """Return the column-normalised condition number of the Jacobian of the information."""
    diagonal = np.sqrt(np.clip(np.diag(information), 0.0, None))
    nonzero = diagonal > 0.0
    if not nonzero.any():
        return float("inf")
    normalised = information[np.ix_(nonzero, nonzero)] / np.outer(
        diagonal[nonzero], diagonal[nonzero]
    )
    values = np.linalg.eigvalsh(normalised)
    values = values[values > (0.0 if all_observed else 1e-9)]
    return float(np.sqrt(values[-1] / values[0])) if values.size else float("inf")
