"""Which order a temperature polynomial has, by windows that were not fitted.

A cubic through a few kelvin fits anything and holds nowhere (peers' notes, section 6, case
8): below 10 K no temperature term is taken, and above it the order is the least whose
prediction of windows left out is as good as any, within one standard error.
"""

from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import FloatArray

LEAST_SPAN_K = 10.0
ORDERS = (0, 1, 2, 3)
FEWEST_WINDOWS = 12
FOLDS = 6


@dataclass(frozen=True, slots=True, eq=False)
class OrderChoice:
    """What held-out windows say of each order."""

    order: int  # 0: the bias does not follow the temperature
    span_k: float
    error: FloatArray  # (orders,), mean squared standardised error of windows left out


def choose_order(
    temperature_k: FloatArray, bias_rad_s: FloatArray, std_rad_s: FloatArray
) -> OrderChoice:
    """Choose the order of b(T) from window means.

    Args:
        temperature_k: of each window, about any origin, shape (w,).
        bias_rad_s: what is left of each window's rate, shape (w, 3).
        std_rad_s: of such a mean, shape (3,).
    """
    span_k = float(np.ptp(temperature_k)) if temperature_k.size else 0.0
    windows = temperature_k.size
    if span_k < LEAST_SPAN_K or windows < FEWEST_WINDOWS:
        return OrderChoice(0, span_k, np.full(len(ORDERS), np.nan))
    unit = (temperature_k - np.mean(temperature_k)) / span_k
    # Folds of warmth in turn, so that every fold is left out inside the range.
    fold = np.empty(windows, dtype=np.int64)
    fold[np.argsort(unit, kind="stable")] = np.arange(windows) % FOLDS
    squares = np.empty((len(ORDERS), windows))
    for order in ORDERS:
        design = unit[:, None] ** np.arange(order + 1)
        for k in range(FOLDS):
            train, test = fold != k, fold == k
            found = np.linalg.lstsq(design[train], bias_rad_s[train], rcond=None)[0]
            left = (bias_rad_s[test] - design[test] @ found) / std_rad_s
            squares[order, test] = np.mean(left**2, axis=1)
    error = squares.mean(axis=1)
    best = int(np.argmin(error))
    for order in ORDERS:
        worse = squares[order] - squares[best]
        if float(worse.mean()) <= float(worse.std() / np.sqrt(windows)):
            return OrderChoice(order, span_k, error)
    return OrderChoice(best, span_k, error)
