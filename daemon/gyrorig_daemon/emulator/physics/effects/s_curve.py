"""S-curve: the controller sends the mean of its plan over a window, not the plan itself.

A moving average of length L over a trapezoid of speed rounds its corners: the common way to
limit jerk in a step generator. The motion then comes L / 2 late on the average and ends L
late; the counted position goes with it. The plan is made of parabolas x(t), so the mean is
exact: the difference of its antiderivative at t and at t - L, over L.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gyrorig_daemon.emulator.physics.motion_law import Segment

FloatArray = NDArray[np.float64]


def antiderivative(
    pieces: Sequence[Segment], start_s: float, offsets_s: FloatArray, reference_steps: float
) -> FloatArray:
    """Return the integral of planned position minus a reference from `start_s` on, (n,).

    Args:
        pieces: the segments that hold from `start_s` to the last offset; their positions
            count from one zero.
        start_s: where the integral begins.
        offsets_s: ascending, not negative, (n,).
        reference_steps: taken off, so that the sum stays small.
    """
    edges = [segment.start_s - start_s for segment in pieces[1:]]
    cuts = [0, *np.searchsorted(offsets_s, edges).tolist(), len(offsets_s)]
    result = np.empty_like(offsets_s)
    total = 0.0
    for k, segment in enumerate(pieces):
        begin_s = start_s if k == 0 else segment.start_s
        steps, speed = segment.at(begin_s)
        steps -= reference_steps
        half, sixth = 0.5 * speed, segment.acceleration_steps_s2 / 6.0
        dt = offsets_s[cuts[k] : cuts[k + 1]] + (start_s - begin_s)
        result[cuts[k] : cuts[k + 1]] = total + dt * (steps + dt * (half + dt * sixth))
        if k + 1 < len(pieces):
            whole = pieces[k + 1].start_s - begin_s
            total += whole * (steps + whole * (half + whole * sixth))
    return result
