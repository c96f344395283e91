"""What causes beside reference attitudes are worth on stretches of time left out.

What to use when: `gains` for the causes of a space, all together and one by one; `gain_of` for
any two models' residuals.
"""

import numpy as np

from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.chance import normal_limit
from gyrorig_solver.discover.attitude_terms import NAMELESS
from gyrorig_solver.discover.result import Gain, Interval
from gyrorig_solver.estimate.attitude_space import AttitudeSpace
from gyrorig_solver.estimate.extension import Extension

WINDOW_S, FOLDS, FEWEST = 10.0, 8, 4


def gains(space: AttitudeSpace) -> tuple[Gain | None, list[Gain] | None]:
    """Return what all named causes of a space are worth on windows left out, and each of all.

    None where nothing is named, or where there are too few windows.
    """
    windows = space.windows(WINDOW_S)
    count, many = int(windows.max()) + 1, len(space.extensions)
    if count < FEWEST or not many:
        return None, None
    names = [k for k, one in enumerate(space.extensions) if nameable(one)]
    models = [space.without(gone) for gone in ((), names, *([k] for k in range(many)))]
    whole, *less = space.kept_out(windows % min(FOLDS, count), models)
    how = f"windows of {WINDOW_S:.0f} s left out in turn, {count} of them"
    gains = [gain_of(space, windows, how, before, whole) for before in less]
    return gains[0] if names else None, gains[1:]


def gain_of(
    space: AttitudeSpace, windows: IntArray, how: str, before: FloatArray, after: FloatArray
) -> Gain:
    """Return the gain of one model over another from whitened residuals, (all,) each."""
    nats: FloatArray = np.asarray(0.5 * np.bincount(windows, before**2 - after**2), np.float64)
    rates = [np.concatenate(space.unwhitened(one)) for one in (before, after)]
    rms = [float(np.sqrt(np.mean(rate**2))) for rate in rates]
    change = rms[1] - rms[0]
    blocks = np.minimum(
        np.arange(rates[0].shape[0]) * nats.size // rates[0].shape[0], nats.size - 1
    )
    squares: FloatArray = np.bincount(blocks, np.sum(rates[1] ** 2 - rates[0] ** 2, axis=1)) / (
        3 * np.maximum(np.bincount(blocks), 1)
    )
    return Gain(
        how=how,
        log_likelihood=_interval(nats, float(nats.sum()), float(nats.size)),
        rms_before=rms[0],
        rms_after=rms[1],
        turn_error_before_rad=float("nan"),
        turn_error_after_rad=float("nan"),
        rms_change=_interval(squares, change, 1.0 / (rms[0] + rms[1])),
    )


def _interval(each: FloatArray, value: float, factor: float) -> Interval:
    half = normal_limit(0.025) * float(np.std(each, ddof=1) / np.sqrt(each.size)) * factor
    return Interval(value, value - half, value + half)


def nameable(one: Extension) -> bool:
    """Return whether a cause has a name, and is no signature weighed beside them."""
    return one.term.cause not in NAMELESS
