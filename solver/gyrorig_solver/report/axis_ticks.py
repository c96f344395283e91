"""Ticks of an axis, and their labels.

What to use when: `Axis.linear` or `Axis.decades` for the values to show.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np

from gyrorig_solver.data import FloatArray

MARGIN_SHARE = 0.05  # of the span, free at both ends
STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)
PLAIN_NUMBER_RANGE = (1e-4, 1e5)  # numbers outside have an exponent
FEW_DECADES_BELOW = 2.0  # below, 2 and 5 have ticks too
MAX_LABELLED_DECADES = 9
ROUNDING = 1e-9  # of a step


@dataclass(frozen=True, slots=True, eq=False)
class Axis:
    """Scale of one side of a panel, with its ticks."""

    low: float  # of the scaled values
    high: float
    ticks: tuple[tuple[float, str], ...]  # share of the side, label
    scale_function: Callable[[FloatArray], FloatArray]

    def share(self, values: FloatArray) -> FloatArray:
        """Return the positions of values, 0 at the start of the side and 1 at its end."""
        return np.asarray((self.scale_function(values) - self.low) / (self.high - self.low))

    @classmethod
    def linear(cls, values: FloatArray, max_ticks: int) -> Self:
        """Return an axis for values, with at most `max_ticks` ticks."""
        low, high = _value_range(values)
        low, high = low - MARGIN_SHARE * (high - low), high + MARGIN_SHARE * (high - low)
        step = _tick_step((high - low) / max_ticks)
        first, last = np.ceil(low / step - ROUNDING), np.floor(high / step + ROUNDING)
        positions = step * np.arange(first, last + 1.0)
        labels = _tick_labels(positions, step)
        ticks = tuple(
            (float((position - low) / (high - low)), tick_label)
            for position, tick_label in zip(positions, labels, strict=True)
        )
        return cls(low, high, ticks, lambda x: x)

    @classmethod
    def decades(cls, values: FloatArray) -> Self:
        """Return a logarithmic axis for the values above zero."""
        low, high = _value_range(np.log10(values[values > 0.0]))
        low, high = low - MARGIN_SHARE * (high - low), high + MARGIN_SHARE * (high - low)
        mantissas = (1, 2, 5) if high - low < FEW_DECADES_BELOW else (1,)
        stride = max(1, round((high - low) / MAX_LABELLED_DECADES))
        ticks = []
        for decade in range(int(np.floor(low)), int(np.ceil(high)) + 1, stride):
            for mantissa in mantissas:
                position = decade + float(np.log10(mantissa))
                if low <= position <= high:
                    ticks.append(((position - low) / (high - low), _decade_label(mantissa, decade)))
        return cls(low, high, tuple(ticks), _logarithm)


def _value_range(values: FloatArray) -> tuple[float, float]:
    finite_values = values[np.isfinite(values)]
    if not finite_values.size:
        return 0.0, 1.0
    low, high = float(finite_values.min()), float(finite_values.max())
    if high - low > ROUNDING * max(abs(low), abs(high)):
        return low, high
    half = 0.5 * abs(low) or 0.5
    return low - half, high + half


def _tick_step(least: float) -> float:
    decade = 10.0 ** np.floor(np.log10(least))
    return float(next(decade * s for s in STEPS if decade * s >= least * (1.0 - ROUNDING)))


def _tick_labels(positions: FloatArray, step: float) -> list[str]:
    """Return tick labels with the number of digits of the step."""
    largest = float(np.max(np.abs(positions), initial=step))
    power = (
        0
        if PLAIN_NUMBER_RANGE[0] <= largest < PLAIN_NUMBER_RANGE[1]
        else int(np.floor(np.log10(largest)))
    )
    unit = 10.0**power
    digits = max(0, -int(np.floor(np.log10(step / unit) + ROUNDING)))
    digits += int(abs(round(step / unit, digits) - step / unit) > 1e-6 * step / unit)  # 2.5
    tail = f"e{power}" if power else ""
    return [
        _typographic_minus(f"{position / unit + 0.0:.{digits}f}{tail}") if position else "0"
        for position in np.round(positions, 15)
    ]


def _decade_label(mantissa: int, decade: int) -> str:
    value = mantissa * 10.0**decade
    plain = PLAIN_NUMBER_RANGE[0] <= value < PLAIN_NUMBER_RANGE[1]
    return _typographic_minus(f"{value:.{max(0, -decade)}f}" if plain else f"{mantissa}e{decade}")


def _typographic_minus(text: str) -> str:
    return text.replace("-", "\N{MINUS SIGN}")


def _logarithm(values: FloatArray) -> FloatArray:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(values > 0.0, np.log10(values), np.nan)
