"""What makes one program better than another: one number from what it will show."""

from typing import Literal, get_args

import numpy as np

from gyrorig_solver.estimate.observability import Decision
from gyrorig_solver.model.gain import factor_jacobian, factorise
from gyrorig_solver.plan.sensor import MOUNT

Criterion = Literal["worst", "mean", "worst-factor", "mean-factor"]
CRITERIA: tuple[str, ...] = get_args(Criterion)
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
