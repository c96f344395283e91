"""Error of a line through the least delays of timestamps: its mean and its standard deviation.

The line is below all delays and touches two of them. Therefore it is later than a delay of zero.
The difference depends on the number of delays near the least one. Their distribution there is
modelled as a power law, P(delay < x) = (x / scale)^exponent / n. The exponent is 1 for exponential
and half-normal delays, and 2 if a delay is the sum of two of these. With a larger exponent, the
least value is not sharp, and the uncertainty is that of the first hundredth of the delays. The
factors are from simulations of exponential, half-normal, uniform and gamma delays
(`test_least_delay`).
"""

import math
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.data.clocks.latency_floor import WALK_PER_SQRT_S

NEAR_SHARE, FAR_SHARE = 0.01, 0.1  # of the delays, between which the power law is estimated
MIN_NEAR = 40  # delays
MIN_EXPONENT = 0.5
MAX_EXPONENT = 1.5  # above it, the delays have no sharp least value
# standard deviation in that case, relative to the first hundredth of the delays
UNSHARP_SHARE = 1.0
MEAN_FACTOR = 1.95  # mean error = factor scale
STD_FACTOR, STD_POWER = 1.45, 0.9  # its standard deviation = factor scale / exponent^power
SCALE_STD_FACTOR = 0.8  # relative: factor log(near) / sqrt(near exponent)


@dataclass(frozen=True, slots=True)
class LineError:
    """The error of a line through the least delays."""

    mean_s: float
    std_s: float


def line_error(excess_s: FloatArray, span_s: float) -> LineError:
    """Return the mean error of a line, averaged over the recording.

    Args:
        excess_s: delays above the line, (n,).
        span_s: length of the recording, in which the clock deviates from a line.
    """
    wander_s = WALK_PER_SQRT_S * span_s**1.5 / math.sqrt(120.0)
    ordered_s = np.sort(excess_s[excess_s > 0.0])
    near = max(MIN_NEAR, round(NEAR_SHARE * ordered_s.size))
    far = round(FAR_SHARE * ordered_s.size)
    if far <= 2 * near:
        mean_s = float(np.mean(excess_s))
        return LineError(0.0, math.hypot(mean_s, wander_s))
    near_s, far_s = float(ordered_s[near - 1]), float(ordered_s[far - 1])
    exponent = math.log(far / near) / max(math.log(far_s / near_s), 1e-3)
    exponent = max(exponent, MIN_EXPONENT)
    scale_s = near_s * near ** (-1.0 / exponent)
    if exponent > MAX_EXPONENT:
        return LineError(MEAN_FACTOR * scale_s, math.hypot(UNSHARP_SHARE * near_s, wander_s))
    scale_std = SCALE_STD_FACTOR * math.log(near) / math.sqrt(near * exponent)
    relative_std = math.hypot(STD_FACTOR / exponent**STD_POWER, MEAN_FACTOR * scale_std)
    return LineError(MEAN_FACTOR * scale_s, math.hypot(scale_s * relative_std, wander_s))
