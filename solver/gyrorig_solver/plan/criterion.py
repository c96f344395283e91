"""What makes one program better than another: one number from what it will show."""

from typing import Literal, get_args

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.estimate.observability import Decision
from gyrorig_solver.model.gain import factor_jacobian, factorise
from gyrorig_solver.plan.sensor import MOUNT

Criterion = Literal["worst", "mean", "worst-factor", "mean-factor"]
CRITERIA: tuple[str, ...] = get_args(Criterion)
# How far above its floor a program may leave a bias. The floor is the noise over the same time
# at rest, which no motion passes under; above it is what the rests' detents shift the mean by.
BIAS_EXCESS = 0.002
STEEP = 100.0  # one per cent beyond that doubles the cost

_FACTORS = factor_jacobian(factorise(MOUNT))


def cost(decision: Decision, criterion: Criterion) -> float:
    """Return the largest or the mean standard deviation of nine numbers, least is best.

    `worst` and `mean` look at the entries of the gain, `worst-factor` and `mean-factor` at
    scale, non-orthogonality and misalignment. What cannot be seen has its prior's.
    """
    covariance = (decision.covariance + decision.hidden)[:9, :9]
    if criterion.endswith("factor"):
        covariance = _FACTORS @ covariance @ _FACTORS.T
    std = np.sqrt(np.clip(np.diag(covariance), 0.0, None))
    return float(std.max() if criterion.startswith("worst") else std.mean())


def bias_excess(decision: Decision, floor_rad_s: FloatArray) -> float:
    """Return by what part the worst bias's standard deviation lies above its floor.

    Args:
        decision: over gain, bias and time offset.
        floor_rad_s: the deviation of the noise's mean over the recording, shape (3,).
    """
    std = np.sqrt(np.diag(decision.covariance + decision.hidden)[9:12])
    return float(np.max(std / floor_rad_s) - 1.0)


def drawback(decision: Decision, floor_rad_s: FloatArray) -> float:
    """Return by what a program's cost counts more for what it does to the bias, 1 or more."""
    return 1.0 + STEEP * max(0.0, bias_excess(decision, floor_rad_s) - BIAS_EXCESS)
