"""From an accelerometer's samples and the unit's angles to a level: the rests in between.

What to use when: `level_by_rests` on a recording of a unit; `leveling` says what its result
means and what it cannot tell.
"""

from dataclasses import dataclass, replace

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.model.terms.leveling import Level, tilt_zero_from_accelerometer

STANDING_RAD = 1e-6  # between two samples; a step is a thousand times that
SETTLING_S = 0.3  # after a stop, until the head has rung out
SHORTEST_S = 0.5  # of what is left of a rest


@dataclass(frozen=True, slots=True, eq=False)
class RestMeans:
    """The mean reading of every rest."""

    pan_rad: FloatArray  # (m,)
    tilt_rad: FloatArray  # (m,)
    reading_m_s2: FloatArray  # (m, 3)
    std_m_s2: float  # of each mean, one axis, by the scatter inside the rests


def rest_means(time_s: FloatArray, accel_m_s2: FloatArray, angle_rad: FloatArray) -> RestMeans:
    """Return the rests of a recording.

    Args:
        time_s: of the samples, shape (n,), not decreasing.
        accel_m_s2: counts times nominal scale, (n, 3); rows that are not finite are left out.
        angle_rad: told pan and tilt at the samples, (2, n).

    Raises:
        InputError: nothing stands still for long enough.
    """
    still = np.all(np.abs(np.diff(angle_rad, axis=1)) < STANDING_RAD, axis=0)
    change = np.diff(np.concatenate([[False], still, [False]]).astype(np.int8))
    begins, ends = np.flatnonzero(change == 1), np.flatnonzero(change == -1)
    pans, tilts, means, scatter = [], [], [], []
    for begin, end in zip(begins, ends, strict=True):
        # The recording's own begin is no stop.
        from_s = time_s[begin] + (SETTLING_S if begin else 0.0)
        inside = np.arange(begin, end + 1)
        inside = inside[(time_s[inside] >= from_s) & np.isfinite(accel_m_s2[inside]).all(axis=1)]
        if inside.size < 2 or time_s[inside[-1]] - time_s[inside[0]] < SHORTEST_S:
            continue
        pans.append(angle_rad[0, inside[0]])
        tilts.append(angle_rad[1, inside[0]])
        means.append(accel_m_s2[inside].mean(axis=0))
        scatter.append(accel_m_s2[inside].var(axis=0, ddof=1).mean() / inside.size)
    if not means:
        raise InputError(
            "the unit never stands still while the accelerometer is recorded",
            f"rest for {SETTLING_S + SHORTEST_S:.1f} s or more at several tilts",
        )
    return RestMeans(
        np.array(pans), np.array(tilts), np.stack(means), float(np.sqrt(np.median(scatter)))
    )


def level_by_rests(
    time_s: FloatArray,
    accel_m_s2: FloatArray,
    angle_rad: FloatArray,
    nominal: FloatArray | None = None,
) -> Level:
    """Return tilt zero and lean by all rests of a recording.

    Where the rests scatter by more than the samples in them, as they do by a bias that
    wanders and by where a stepper comes to stand, the deviations are made wider by that.

    Args:
        time_s: of the samples, shape (n,).
        accel_m_s2: shape (n, 3).
        angle_rad: told pan and tilt at the samples, (2, n).
        nominal: how the board is meant to be mounted, stage to board, (3, 3).

    Raises:
        InputError: too few rests, tilts too few or too near each other.
    """
    rests = rest_means(time_s, accel_m_s2, angle_rad)
    at = rests.pan_rad, rests.tilt_rad, rests.reading_m_s2
    first = tilt_zero_from_accelerometer(*at, rests.std_m_s2, nominal)
    if first.reduced_chi2 <= 1.0:
        return first
    wider = rests.std_m_s2 * float(np.sqrt(first.reduced_chi2))
    again = tilt_zero_from_accelerometer(*at, wider, nominal)
    return replace(again, reduced_chi2=first.reduced_chi2)
