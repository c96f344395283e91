"""Does a scatter grow by a shape? Squares of a whitened residual against shapes of a variance.

What to use when: `grown` for shapes of any kind; `by_speed` for those of whether and how
fast the stage moves.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.chance import chi2_tail, normal_tail

SPEED_WAVES = 3  # half waves over the speeds
MOVING_RAD_S = 1e-3
ALIKE = 1e-7  # of the strongest: shapes that are sums of others say nothing more


@dataclass(frozen=True, slots=True)
class Growth:
    """What a scatter says of some shapes."""

    statistic: float
    degrees_of_freedom: int
    p_value: float


NONE = Growth(0.0, 0, 1.0)


def by_speed(speed_rad_s: FloatArray, fastest_rad_s: float) -> FloatArray:
    """Return shapes of a variance: in motion, then half waves of the speed, (k, n)."""
    share = speed_rad_s / max(fastest_rad_s, MOVING_RAD_S)
    waves = np.cos(np.pi * np.arange(SPEED_WAVES + 1)[:, None] * share)
    return np.where(speed_rad_s > MOVING_RAD_S, waves, 0.0)


def grown(shapes: FloatArray, excess: FloatArray, either_way: bool = False) -> Growth:
    """Return whether a scatter grows by shapes, by the first alone or by all together.

    With w a shape less its mean and e the squares less 1, z = w e / sqrt(2 w w) is standard
    normal in noise, a sum of many terms of variance 2; all shapes give a chi-squared
    statistic, s' (2 W W')^-1 s with s = W e. What a model lacks adds scatter and takes none
    away, so only z > 0 counts. The better of the two is paid for twice.

    Args:
        shapes: (k, n), the first the sum that the others part.
        excess: squares of a whitened residual, less 1, (n,).
        either_way: less scatter counts too, as beside a cause that may have taken too much.
    """
    weights = shapes - shapes.mean(axis=1, keepdims=True)
    size = float(np.sqrt(2.0 * np.sum(weights[0] ** 2)))
    if size <= 0.0:
        return NONE
    z = float(weights[0] @ excess) / size
    alone = Growth(max(z, 0.0) ** 2, 1, normal_tail(z))
    if len(shapes) == 1 or (z <= 0.0 and not either_way):
        return alone
    strength, along = np.linalg.eigh(2.0 * weights @ weights.T)
    keep = strength > ALIKE * strength[-1]
    score = along[:, keep].T @ (weights @ excess)
    statistic, degrees = float(np.sum(score**2 / strength[keep])), int(keep.sum())
    together = Growth(statistic, degrees, chi2_tail(statistic, degrees))
    best = min(alone, together, key=lambda one: one.p_value)
    return Growth(best.statistic, best.degrees_of_freedom, min(1.0, 2.0 * best.p_value))
