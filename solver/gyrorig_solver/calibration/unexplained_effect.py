"""Contributions to the total uncertainty that are from no cause of the catalogue.

The search states by how many standard uncertainties such an effect can bias a parameter. The bias
is as likely to have any value up to this bound, so its standard uncertainty is the bound divided
by the root of three.

If the clocks of gyro and reference differ, the fit takes the clock of the gyro. Nothing shows which
of them is right. A scale factor is relative to the clock, so the whole difference is its standard
uncertainty.

What to use when: `widen_by_unexplained` and `widen_by_clock` for the budget of a fit to reference
attitudes.

Source: JCGM 100:2008 (GUM), 4.3.7.
"""

import math

import numpy as np

from gyrorig_solver.discover import CALIBRATION_PARAMETERS
from gyrorig_solver.estimate import GyroFit
from gyrorig_solver.uncertainty import OtherEntry, UncertaintyBudget

REMEDY = (
    "read the findings report, and record with a reference that is mounted rigidly and is neither "
    "filtered nor disturbed"
)
CLOCK_REMEDY = (
    "record both with one clock, or compare each clock with a known time, and correct the times of "
    "the wrong clock"
)


def widen_by_unexplained(
    budget: UncertaintyBudget, fit: GyroFit, bias_sigma: float
) -> UncertaintyBudget:
    """Return a budget that contains an unexplained effect.

    Args:
        budget: of the fit.
        fit: the fit, with its standard uncertainties from noise.
        bias_sigma: the largest bias by the effect, in standard uncertainties from noise.
    """
    noise_std = np.array([fit.std.get(name, np.nan) for name in CALIBRATION_PARAMETERS])
    added = bias_sigma / math.sqrt(3.0) * np.nan_to_num(noise_std)
    return budget.widened(OtherEntry("unexplained_effect", added, REMEDY))


def widen_by_clock(budget: UncertaintyBudget, fit: GyroFit) -> UncertaintyBudget:
    """Return a budget that contains the difference of the clocks of gyro and reference."""
    if fit.reference_clock_skew == 0.0:
        return budget
    added = [
        abs(fit.reference_clock_skew * fit.value(name)) if name.startswith("scale.") else 0.0
        for name in CALIBRATION_PARAMETERS
    ]
    return budget.widened(OtherEntry("reference_clock", np.nan_to_num(added), CLOCK_REMEDY))
