"""The cost of a program, from its predicted covariance."""

from typing import Literal, get_args

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate import ObservabilityAnalysis, propagate_to_factors
from gyrorig_solver.estimate.typical_board import TYPICAL_PARAMETERS

Criterion = Literal["worst", "mean", "worst-factor", "mean-factor"]
CRITERIA: tuple[str, ...] = get_args(Criterion)
# Largest relative excess of a bias uncertainty over its floor. The floor is the noise of a
# recording of the same length at rest; no motion has a smaller uncertainty. The excess comes from
# the detents of the rests, which shift the mean rate.
MAX_BIAS_EXCESS = 0.002
BIAS_PENALTY_SLOPE = 100.0  # an excess of one per cent beyond that doubles the cost


def cost(decision: ObservabilityAnalysis, criterion: Criterion) -> float:
    """Return the largest or the mean standard uncertainty of nine parameters.

    `worst` and `mean` use the entries of the gain, `worst-factor` and `mean-factor` use scale,
    non-orthogonality and misalignment. An unobservable parameter has the uncertainty of its prior.
    """
    if criterion.endswith("factor"):
        covariance = propagate_to_factors(
            TYPICAL_PARAMETERS, decision.covariance, decision.unobservable_covariance
        ).total
    else:
        covariance = decision.covariance + decision.unobservable_covariance
    std = np.sqrt(np.clip(np.diag(covariance)[:9], 0.0, None))
    return float(std.max() if criterion.startswith("worst") else std.mean())


def bias_excess(decision: ObservabilityAnalysis, floor_rad_s: FloatArray) -> float:
    """Return the relative excess of the worst bias uncertainty over its floor.

    Args:
        decision: over gain, bias and time offset.
        floor_rad_s: the standard deviation of the noise's mean over the recording, shape (3,).
    """
    std = np.sqrt(np.diag(decision.covariance + decision.unobservable_covariance)[9:12])
    return float(np.max(std / floor_rad_s) - 1.0)


def bias_penalty(decision: ObservabilityAnalysis, floor_rad_s: FloatArray) -> float:
    """Return the factor, 1 or more, by which a bias above its floor increases the cost."""
    return 1.0 + BIAS_PENALTY_SLOPE * max(0.0, bias_excess(decision, floor_rad_s) - MAX_BIAS_EXCESS)
