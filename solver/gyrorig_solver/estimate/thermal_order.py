"""Which order a temperature polynomial has, by windows that were not fitted.

A cubic through a few kelvin fits anything and holds nowhere (peers' notes, section 6, case
8): below 10 K no temperature term is taken, and above it the order is the least whose
prediction of windows left out is as good as any, within one standard error.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import FloatArray

LEAST_SPAN_K = 10.0
ORDERS = (0, 1, 2, 3)
FEWEST_WINDOWS = 12
FOLDS = 6


@dataclass(frozen=True, slots=True, eq=False)
class OrderChoice:
    """What held-out windows say."""

    order: int  # 0: the bias does not follow the temperature
    look: int  # which of the temperatures that were tried
    span_k: float


def choose_order(
    looks: Sequence[FloatArray], bias_rad_s: FloatArray, std_rad_s: FloatArray
) -> OrderChoice:
    """Choose the order of b(T), and the temperature, from window means.

    Args:
        looks: temperature of each window about any origin, (w,) each, the likeliest first;
            more than one where the sensor's may lag behind the thermometer's.
        bias_rad_s: what is left of each window's rate, shape (w, 3).
        std_rad_s: of such a mean, shape (3,).
    """
    span_k, windows = float(np.ptp(looks[0])) if looks[0].size else 0.0, looks[0].size
    if span_k < LEAST_SPAN_K or windows < FEWEST_WINDOWS:
        return OrderChoice(0, 0, span_k)
    squares = {
        (order, look): _left_out(looks[look], bias_rad_s / std_rad_s, order)
        for order in ORDERS
        for look in range(len(looks) if order else 1)
    }
    best = min(squares, key=lambda key: float(squares[key].mean()))
    for order, look in sorted(squares):
        worse = squares[order, look] - squares[best]
        if float(worse.mean()) <= float(worse.std() / np.sqrt(windows)):
            return OrderChoice(order, look, span_k)
    return OrderChoice(*best, span_k)


def _left_out(temperature_k: FloatArray, bias: FloatArray, order: int) -> FloatArray:
    """Return the mean squared error of each window by the others' polynomial, (w,)."""
    windows = temperature_k.size
    unit = (temperature_k - np.mean(temperature_k)) / max(float(np.ptp(temperature_k)), 1e-9)
    design = unit[:, None] ** np.arange(order + 1)
    # Folds of warmth in turn, so that every fold is left out inside the range.
    fold = np.empty(windows, dtype=np.int64)
    fold[np.argsort(unit, kind="stable")] = np.arange(windows) % FOLDS
    squares = np.empty(windows)
    for k in range(FOLDS):
        train, test = fold != k, fold == k
        found = np.linalg.lstsq(design[train], bias[train], rcond=None)[0]
        squares[test] = np.mean((bias[test] - design[test] @ found) ** 2, axis=1)
    return squares
