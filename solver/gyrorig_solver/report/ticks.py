"""Where an axis has its ticks, and how their numbers read.

What to use when: `Axis.linear` or `Axis.decades` for the values that are to be shown.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self

import numpy as np

from gyrorig_solver.arrays import FloatArray

MARGIN = 0.05  # of the span, left free at both ends
STEPS = (1.0, 2.0, 2.5, 5.0, 10.0)
PLAIN = (1e-4, 1e5)  # numbers within are written out
FEW_DECADES = 2.0  # below so many, twos and fives have ticks too
MOST_DECADES = 9
ROUNDING = 1e-9  # of a step


@dataclass(frozen=True, slots=True, eq=False)
class Axis:
    """From values to shares of a side, and its ticks."""

    low: float  # of the scaled values
    high: float
    ticks: tuple[tuple[float, str], ...]  # share of the side, and what stands there
    scaled: Callable[[FloatArray], FloatArray]

    def share(self, values: FloatArray) -> FloatArray:
        """Return where values lie, 0 at the side's beginning and 1 at its end."""
        return np.asarray((self.scaled(values) - self.low) / (self.high - self.low))

    @classmethod
    def linear(cls, values: FloatArray, most: int) -> Self:
        """Return an axis for values, with at most so many ticks."""
        low, high = _span(values)
        low, high = low - MARGIN * (high - low), high + MARGIN * (high - low)
        step = _step((high - low) / most)
        first, last = np.ceil(low / step - ROUNDING), np.floor(high / step + ROUNDING)
        at = step * np.arange(first, last + 1.0)
        words = _written(at, step)
        ticks = tuple((float((v - low) / (high - low)), w) for v, w in zip(at, words, strict=True))
        return cls(low, high, ticks, lambda x: x)

    @classmethod
    def decades(cls, values: FloatArray) -> Self:
        """Return a logarithmic axis for those values that are above zero."""
        low, high = _span(np.log10(values[values > 0.0]))
        low, high = low - MARGIN * (high - low), high + MARGIN * (high - low)
        mantissas = (1, 2, 5) if high - low < FEW_DECADES else (1,)
        stride = max(1, round((high - low) / MOST_DECADES))
        ticks = []
        for decade in range(int(np.floor(low)), int(np.ceil(high)) + 1, stride):
            for mantissa in mantissas:
                at = decade + float(np.log10(mantissa))
                if low <= at <= high:
                    ticks.append(((at - low) / (high - low), _number(mantissa, decade)))
        return cls(low, high, tuple(ticks), _logarithm)


def _span(values: FloatArray) -> tuple[float, float]:
    some = values[np.isfinite(values)]
    if not some.size:
        return 0.0, 1.0
    low, high = float(some.min()), float(some.max())
    if high - low > ROUNDING * max(abs(low), abs(high)):
        return low, high
    half = 0.5 * abs(low) or 0.5
    return low - half, high + half


def _step(least: float) -> float:
    decade = 10.0 ** np.floor(np.log10(least))
    return float(next(decade * s for s in STEPS if decade * s >= least * (1.0 - ROUNDING)))


def _written(at: FloatArray, step: float) -> list[str]:
    """Return ticks as numbers of as many digits as their step has."""
    largest = float(np.max(np.abs(at), initial=step))
    power = 0 if PLAIN[0] <= largest < PLAIN[1] else int(np.floor(np.log10(largest)))
    unit = 10.0**power
    digits = max(0, -int(np.floor(np.log10(step / unit) + ROUNDING)))
    digits += int(abs(round(step / unit, digits) - step / unit) > 1e-6 * step / unit)  # 2.5
    tail = f"e{power}" if power else ""
    return [_minus(f"{v / unit + 0.0:.{digits}f}{tail}") if v else "0" for v in np.round(at, 15)]


def _number(mantissa: int, decade: int) -> str:
    value = mantissa * 10.0**decade
    plain = PLAIN[0] <= value < PLAIN[1]
    return _minus(f"{value:.{max(0, -decade)}f}" if plain else f"{mantissa}e{decade}")


def _minus(text: str) -> str:
    return text.replace("-", "\N{MINUS SIGN}")


def _logarithm(values: FloatArray) -> FloatArray:
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(values > 0.0, np.log10(values), np.nan)
