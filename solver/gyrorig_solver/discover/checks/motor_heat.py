"""A bias that follows the heat of the motors, as an alternative to causes of the time.

Motors heat the board while they run, and the thermometer of the board may not show it. The bias
then follows the time for which the motors have run, with a lag. If a program moves most of the
time, this looks like a warm-up, a step or a random walk of the bias. No cause of the catalogue has
this form; see decision 0074.

What to use when: `motor_heat_families` as one of the functions that a named cause must lead.
"""

from collections.abc import Sequence

import numpy as np

from gyrorig_solver.data import FloatArray
from gyrorig_solver.discover.checks.basis_family import BasisFamily
from gyrorig_solver.discover.checks.smooth_alternatives import on_each_axis
from gyrorig_solver.model import Signals, SignalState

COVARIATE = "motor_heat"
# Assumed, because no rig with this effect was measured. In most recordings, a longer lag is a ramp.
LAGS_S = np.array([3.0, 10.0, 30.0, 100.0])


def motor_heat_families(scenes: Sequence[SignalState]) -> list[BasisFamily]:
    """Return the bias of each axis that lags behind the running motors; none without moves.

    There is one signal per axis and lag.
    """
    if not any(scene.context.motion_profiles for scene in scenes):
        return []
    description = "on how long the motors have run (the bias changes)"
    detail = np.ones(3 * LAGS_S.size)
    return [BasisFamily(COVARIATE, description, (_heat_signals,), detail)]


def lagged_running_share(spans_s: FloatArray, lags_s: FloatArray, time_s: FloatArray) -> FloatArray:
    """Return the first-order lagged response to a signal that is 1 while a motor runs, else 0.

    Args:
        spans_s: start and end of each move, (m, 2).
        lags_s: shape (k,).
        time_s: in increasing order, (n,).

    Returns:
        Shape (k, n); 0 before the first move.
    """
    if not spans_s.size:
        return np.zeros((lags_s.size, time_s.size))
    knots_s = np.unique(spans_s)
    begun = np.searchsorted(np.sort(spans_s[:, 0]), knots_s, side="right")
    ended = np.searchsorted(np.sort(spans_s[:, 1]), knots_s, side="right")
    running = (begun > ended).astype(np.float64)  # from each knot to the next
    levels = np.zeros((knots_s.size, lags_s.size))
    for k, decay in enumerate(np.exp(-np.diff(knots_s)[:, None] / lags_s)):
        levels[k + 1] = running[k] + (levels[k] - running[k]) * decay
    last = np.searchsorted(knots_s, time_s, side="right") - 1
    knot = np.maximum(last, 0)
    since_s = np.maximum(time_s - knots_s[knot], 0.0)
    share = running[knot] + (levels[knot].T - running[knot]) * np.exp(-since_s / lags_s[:, None])
    return np.asarray(np.where(last >= 0, share, 0.0), dtype=np.float64)


def _heat_signals(scene: SignalState) -> Signals:
    moves = [profile for _, profile in scene.context.motion_profiles]
    spans_s = np.array([(float(move.start_s[0]), float(move.end_s)) for move in moves])
    spans_s = spans_s.reshape(-1, 2)  # a recording at rest has none
    return on_each_axis(scene, lagged_running_share(spans_s, LAGS_S, scene.time_s))
