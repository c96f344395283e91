"""Order of a temperature polynomial, by cross-validation over windows.

A cubic that is fitted over a few kelvin is useless outside them. Below 10 K, no temperature term is
used. Above, the order is the lowest whose prediction of held-out windows is as good as the best,
within one standard error.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.data import FloatArray

MIN_SPAN_K = 10.0
ORDERS = (0, 1, 2, 3)
MIN_WINDOWS = 12
FOLDS = 6


@dataclass(frozen=True, slots=True, eq=False)
class OrderChoice:
    """The result of the cross-validation."""

    order: int  # 0: the bias does not depend on the temperature
    temperature_index: int  # of the temperature signals
    span_k: float


def choose_order(
    temperatures_k: Sequence[FloatArray], bias_rad_s: FloatArray, std_rad_s: FloatArray
) -> OrderChoice:
    """Choose the order of b(T), and the temperature signal, from window means.

    Args:
        temperatures_k: of each window relative to any origin, (w,) each, the most likely first;
            several if the die can lag behind the thermometer.
        bias_rad_s: mean residual rate of each window, shape (w, 3).
        std_rad_s: of such a mean, shape (3,).
    """
    span_k = float(np.ptp(temperatures_k[0])) if temperatures_k[0].size else 0.0
    windows = temperatures_k[0].size
    if span_k < MIN_SPAN_K or windows < MIN_WINDOWS:
        return OrderChoice(0, 0, span_k)
    squares = {
        (order, temperature_index): _held_out_squares(
            temperatures_k[temperature_index], bias_rad_s / std_rad_s, order
        )
        for order in ORDERS
        for temperature_index in range(len(temperatures_k) if order else 1)
    }
    best = min(squares, key=lambda key: float(squares[key].mean()))
    for order, temperature_index in sorted(squares):
        excess = squares[order, temperature_index] - squares[best]
        if float(excess.mean()) <= float(excess.std() / np.sqrt(windows)):
            return OrderChoice(order, temperature_index, span_k)
    return OrderChoice(*best, span_k)


def _held_out_squares(temperature_k: FloatArray, bias: FloatArray, order: int) -> FloatArray:
    """Return each window's mean squared error by the polynomial of the others, (w,)."""
    windows = temperature_k.size
    normalised = (temperature_k - np.mean(temperature_k)) / max(float(np.ptp(temperature_k)), 1e-9)
    design = normalised[:, None] ** np.arange(order + 1)
    # Interleaved folds by temperature, so that every fold is inside the range.
    fold = np.empty(windows, dtype=np.int64)
    fold[np.argsort(normalised, kind="stable")] = np.arange(windows) % FOLDS
    squares = np.empty(windows)
    for k in range(FOLDS):
        train, test = fold != k, fold == k
        coefficients = np.linalg.lstsq(design[train], bias[train], rcond=None)[0]
        squares[test] = np.mean((bias[test] - design[test] @ coefficients) ** 2, axis=1)
    return squares
