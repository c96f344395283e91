"""Type B uncertainty of a calibration: the part from causes that the fit did not identify.

What to use when: `uncertainty_budget.assess_uncertainty` for a fit to a motion, `assess_space` for
a fit to reference attitudes; `uncertainty_settings` for the prior sizes of the causes and the
limits of the verdict; `marginal_covariance` for the algebra of the total uncertainty,
`mixture_interval` for that of the intervals.
"""

from gyrorig_solver.uncertainty.gain_agreement import GainEstimate
from gyrorig_solver.uncertainty.uncertainty_budget import (
    OtherEntry,
    UncertaintyBudget,
    assess_space,
    assess_uncertainty,
)
from gyrorig_solver.uncertainty.uncertainty_settings import (
    UncertaintySettings,
    default_settings,
    read_settings,
)
from gyrorig_solver.uncertainty.unit_values import UnitPosterior

__all__ = [
    "GainEstimate",
    "OtherEntry",
    "UncertaintyBudget",
    "UncertaintySettings",
    "UnitPosterior",
    "assess_space",
    "assess_uncertainty",
    "default_settings",
    "read_settings",
]
