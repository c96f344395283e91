"""Shewhart's charts with the usual limits, as what a fleet's statistics are compared with.

A chart an individual: the mean of the first nights, three deviations by the mean moving range
(d2 = 1.128 for two neighbours; Montgomery, Introduction to Statistical Quality Control, 6.4).
A group's chart is the same of the mean of its boards. No correction for how many are asked: that
is what "the usual limits" are.
"""

import numpy as np

BASELINE_NIGHTS = 10
LIMIT = 3.0
_D2 = 1.128


def beyond(value: np.ndarray, limit: float = LIMIT, baseline: int = BASELINE_NIGHTS) -> np.ndarray:
    """Return which points are beyond the limits.

    Args:
        value: nights by boards or groups, NaN where there is none.
        limit: in deviations.
        baseline: how many measured nights make the limits.

    Returns:
        Of the same shape; False within the baseline.
    """
    measured = np.isfinite(value)
    in_base = measured & (np.cumsum(measured, axis=0) <= baseline)
    held = np.where(in_base, value, np.nan)
    count = in_base.sum(axis=0)
    centre = np.where(in_base, value, 0.0).sum(axis=0) / np.maximum(count, 1)
    sigma = _moving_range(held) / _D2
    with np.errstate(invalid="ignore"):
        out = np.abs(value - centre) > limit * sigma
    is_beyond: np.ndarray = out & measured & ~in_base & (count >= baseline)
    return is_beyond


def group_means(value: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """Return the means of groups of boards about each board's own first nights, by night."""
    measured = np.isfinite(value)
    in_base = measured & (np.cumsum(measured, axis=0) <= BASELINE_NIGHTS)
    base_mean = np.where(in_base, value, 0.0).sum(axis=0) / np.maximum(in_base.sum(axis=0), 1)
    left = np.where(measured, value - base_mean, 0.0)
    means = np.full((len(value), count), np.nan)
    for night, (row, is_measured) in enumerate(zip(left, measured, strict=True)):
        many = np.bincount(group, is_measured, count)
        total = np.bincount(group, row, count)
        means[night] = np.where(many > 0, total / np.maximum(many, 1), np.nan)
    return means


def _moving_range(held: np.ndarray) -> np.ndarray:
    """Return the mean of the absolute differences of neighbours that were measured."""
    total, pairs = np.zeros(held.shape[1]), np.zeros(held.shape[1])
    before = np.full(held.shape[1], np.nan)
    for row in held:
        step = np.abs(row - before)
        known = np.isfinite(step)
        total += np.where(known, step, 0.0)
        pairs += known
        before = np.where(np.isfinite(row), row, before)
    mean: np.ndarray = np.where(pairs > 0, total / np.maximum(pairs, 1), np.inf)
    return mean
