"""Outlier detection: isolated samples in a residual that are neither motion nor noise."""

import numpy as np

from gyrorig_solver.data import BoolArray, FloatArray

OUTLIER_SIGMA = 6.0  # the noise of the model very rarely reaches this
MAX_SAMPLES_FOR_SPREAD = 8192  # samples for the standard deviation
NEIGHBOURS_PER_SIDE = 4  # a glitch of up to four samples is visible among nine
GROSS_FACTOR = 8.0  # times the limit: 48 standard deviations
MIN_INLIERS = 3


def find_outliers(residual: FloatArray, use: BoolArray, quantum_rad_s: float) -> BoolArray:
    """Return which rows are outliers: far from all rows, and far from their neighbours.

    A wrong start or a wrong model causes a residual that is smooth over several samples. Such rows
    are kept, because excluding them would hide the error.
    """
    median, deviation = robust_spread(residual, use, quantum_rad_s)
    limit = OUTLIER_SIGMA * deviation
    outlier = np.asarray((np.abs(residual - median) > limit).any(axis=1) & use, dtype=np.bool_)
    if not outlier.any():
        return outlier
    outlier_rows = np.flatnonzero(outlier)
    # At the ends, the window moves inwards and keeps its length.
    window_begin = np.clip(
        outlier_rows - NEIGHBOURS_PER_SIDE,
        0,
        max(0, residual.shape[0] - 2 * NEIGHBOURS_PER_SIDE - 1),
    )
    neighbours = np.minimum(
        window_begin[:, None] + np.arange(2 * NEIGHBOURS_PER_SIDE + 1), residual.shape[0] - 1
    )
    usable = use[neighbours]
    # All neighbours count, so that a transient of the rig is kept. For an error larger than any
    # transient, only the inliers among the neighbours count, because glitches can come in pairs.
    gross = (np.abs(residual[outlier_rows] - median) > GROSS_FACTOR * limit).any(axis=1)
    inlier = usable & ~outlier[neighbours]
    has_enough_inliers = inlier.sum(axis=1) >= MIN_INLIERS
    reference_rows = np.where((gross & has_enough_inliers)[:, None], inlier, usable)
    neighbour_residual = np.where(reference_rows[:, :, None], residual[neighbours], np.nan)
    isolated = np.abs(residual[outlier_rows] - np.nanmedian(neighbour_residual, axis=1)) > limit
    outlier[outlier_rows] = isolated.any(axis=1)
    return outlier


def robust_spread(
    residual: FloatArray, use: BoolArray, quantum_rad_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return median and robust standard deviation of a residual's used rows, (3,) each."""
    subsample = (residual if use.all() else residual[use])[
        :: max(1, int(use.sum()) // MAX_SAMPLES_FOR_SPREAD)
    ]
    median = np.median(subsample, axis=0)
    deviation = 1.4826 * np.median(np.abs(subsample - median), axis=0)
    return np.asarray(median), np.maximum(deviation, quantum_rad_s)
