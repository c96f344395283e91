"""What an extended model is worth on data that it was not fitted to.

The recording is cut into windows of some moves each. Each in turn is left out: gain, bias,
time offset and causes are fitted to the others, in the window only the motion's own
unknowns (a start of each move) follow, in both models alike.

What to use when: `held_out` for two fits of the same recordings.
"""

import numpy as np
from scipy.stats import norm

from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.discover.result import Gain, Interval
from gyrorig_solver.estimate.projection import Projection

WINDOW_S = 10.0
FOLDS = 8  # windows are dealt out to so many folds: each fit lacks one fold
FEWEST = 4  # windows; less is not worth an interval
SETTLE_S = 0.3  # a move's end that the low-pass still carries


def held_out(before: Projection, after: Projection) -> Gain | None:
    """Return the gain of one fit over another, None where there are too few windows.

    Args:
        before: the space beside the base model's fit.
        after: the same beside the extended one, with the same noise.
    """
    windows = _windows(after)
    count = int(windows.max()) + 1
    if count < FEWEST:
        return None
    folds = windows % min(FOLDS, count)
    left = [one.kept_out(folds) for one in (before, after)]
    costs = [np.asarray(np.bincount(windows, one**2, count), np.float64) for one in left]
    nats: FloatArray = 0.5 * (costs[0] - costs[1])
    rates = [one.unwhitened(white) for one, white in zip((before, after), left, strict=True)]
    squares = [_squares(after, rate) for rate in rates]
    used = sum(int(u.sum()) for s in after.stretches for u in s.used)
    rms = [float(np.sqrt(sum(np.sum(r**2) for r in rate) / (3 * used))) for rate in rates]
    change = [float(s) for s in squares[1] - squares[0]]
    turns = [_turn_error(after, rate) for rate in rates]
    return Gain(
        how=f"windows of {WINDOW_S:.0f} s left out in turn, {count} of them",
        log_likelihood=_interval(nats, float(np.sum(nats)), float(count)),
        rms_before=rms[0],
        rms_after=rms[1],
        turn_error_before_rad=turns[0],
        turn_error_after_rad=turns[1],
        rms_change=_interval(np.array(change), rms[1] - rms[0], 1.0 / (rms[0] + rms[1])),
    )


def _interval(each: FloatArray, value: float, factor: float) -> Interval:
    """Return a figure with the 95 % interval that its windows' scatter gives it."""
    half = float(norm.isf(0.025) * np.std(each, ddof=1) / np.sqrt(each.size)) * factor
    return Interval(value, value - half, value + half)


def _windows(projection: Projection) -> IntArray:
    """Return to which window each whitened value belongs, counted over all recordings."""
    found, first = [], 0
    for s in projection.stretches:
        for scene, used in zip(s.scenes, s.used, strict=True):
            length = float(scene.edges_s[-1] - scene.edges_s[0])
            many = max(1, round(length / WINDOW_S))
            own = first + np.arange(used.size) * many // used.size
            found.append(np.tile(own, 3))
            first += many
    return np.concatenate(found).astype(np.int64)


def _squares(projection: Projection, rates: list[FloatArray]) -> FloatArray:
    """Return the mean square of each window, (windows,)."""
    windows = _windows(projection)
    flat = np.concatenate([rate.T.ravel() for rate in rates])
    return np.asarray(
        np.bincount(windows, flat**2) / np.maximum(np.bincount(windows), 1), dtype=np.float64
    )


def _turn_error(projection: Projection, rates: list[FloatArray]) -> float:
    """Return the rms over moves of the residual's integral over each, rad."""
    found, part = [], 0
    for s in projection.stretches:
        for scene, used in zip(s.scenes, s.used, strict=True):
            rate = rates[part]
            part += 1
            step_s = float(scene.edges_s[-1] - scene.edges_s[0]) / used.size
            for _, course in scene.setting.courses:
                first = round((float(course.start_s[0]) - float(scene.edges_s[0])) / step_s)
                last = round((float(course.end_s) + SETTLE_S - float(scene.edges_s[0])) / step_s)
                if 0 <= first < last <= used.size:
                    found.append(np.sum(rate[first:last], axis=0) * step_s)
    return float(np.sqrt(np.mean(np.sum(np.square(found), axis=1)))) if found else float("nan")
