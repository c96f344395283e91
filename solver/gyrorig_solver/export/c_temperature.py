"""The function of the C header that takes a temperature, and its part of the self-test.

What to use when: `function_with_temperature` for the function, `TemperatureVectors` for its test,
`float_literal` for a number in any part of the header.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from gyrorig_protocol.errors import InputError
from gyrorig_solver.apply import Correction
from gyrorig_solver.data import FloatArray, TemperatureCurve

FLOAT_ULP = 2.0**-24  # half a unit in the last place of the float 1
_ROUNDINGS = 32.0  # of a result: sums and products, constants, and the temperature itself
_TEST_TEMPERATURES = 7
_TEST_SPAN_K = 20.0  # about the reference temperature, without a valid range


def function_with_temperature(correction: Correction, stem: str, scale: float) -> Iterator[str]:
    """Yield the function with a temperature: polynomials by Horner's rule, and cubic terms."""
    curves = [
        (name, curve, factor)
        for name, curve, factor in (
            ("bias", correction.bias_curve, 1.0 / scale),
            ("gain", correction.scale_curve, 1.0),
        )
        if curve is not None and not curve.is_zero
    ]
    yield "/* Returns 1 if the temperature is outside the valid range, and then uses its end. */"
    yield f"static inline int {stem}_rate_float_at(const int32_t counts[3],"
    yield "                                        float temperature_degc, float rate_rad_s[3])"
    yield "{"
    for name, curve, factor in curves:
        yield from _curve_tables(name, curve, factor)
    yield "    static const float A[3][3] = {"
    yield from float_rows(scale * correction.inverse)
    yield "    };"
    bias = float_row(correction.bias_rad_s / scale)
    yield f"    static const float b[3] = {bias};  /* counts */"
    yield "    float y[3];"
    yield "    float degc = temperature_degc;"
    yield "    int i, k;"
    yield ""
    low_high = correction.temperature_range_degc
    if low_high is not None:
        low, high = (float_literal(limit) for limit in low_high)
        yield f"    if (degc < {low}) degc = {low};"
        yield f"    if (degc > {high}) degc = {high};"
    yield "    for (i = 0; i < 3; i++) {"
    yield "        float bias = b[i], gain = 1.0f, warmth, sum;"
    yield ""
    for name, curve, _ in curves:
        yield from _curve_sum(name, curve)
    yield "        y[i] = ((float)counts[i] - bias) / gain;"
    yield "    }"
    yield "    for (i = 0; i < 3; i++) {"
    yield "        rate_rad_s[i] = A[i][0] * y[0] + A[i][1] * y[1] + A[i][2] * y[2];"
    yield "    }"
    yield "    return degc != temperature_degc;"
    yield "}"
    yield ""


def _curve_sum(name: str, curve: TemperatureCurve) -> Iterator[str]:
    """Yield the statements that add the change of a curve, from its own reference temperature."""
    yield f"        warmth = degc - {float_literal(curve.reference_degc)};"
    yield "        sum = 0.0f;"
    if len(curve.coefficients):
        yield f"        for (k = {len(curve.coefficients) - 1}; k >= 0; k--) {{"
        yield f"            sum = (sum + {name}_orders[k][i]) * warmth;"
        yield "        }"
    if curve.knots_degc.size:
        yield f"        for (k = 0; k < {curve.knots_degc.size}; k++) {{"
        yield f"            const float rise = degc - {name}_knots[k];"
        yield f"            sum += {name}_bends[k][i]"
        yield "                * ((rise > 0.0f ? rise * rise * rise : 0.0f)"
        yield f"                   - {name}_zeros[k]);"
        yield "        }"
    yield f"        {name} += sum;"


def _curve_tables(name: str, curve: TemperatureCurve, factor: float) -> Iterator[str]:
    """Yield the tables of a curve, its values multiplied by a factor."""
    tables = [(f"{name}_orders", curve.coefficients), (f"{name}_bends", curve.knot_coefficients)]
    for table, rows in tables:
        if len(rows):
            yield f"    static const float {table}[{len(rows)}][3] = {{"
            yield from float_rows(rows * factor)
            yield "    };"
    if curve.knots_degc.size:
        zeros = np.maximum(curve.reference_degc - curve.knots_degc, 0.0) ** 3
        for table, values in ((f"{name}_knots", curve.knots_degc), (f"{name}_zeros", zeros)):
            yield f"    static const float {table}[{len(values)}] = {float_row(values)};"


@dataclass(frozen=True, slots=True, eq=False)
class TemperatureVectors:
    """Counts at temperatures, with the expected rates of the function with a temperature."""

    counts: Sequence[Sequence[int]]
    degc: FloatArray  # (n,)
    rates_rad_s: FloatArray  # (n, 3)
    tolerance_rad_s: float

    @classmethod
    def of(cls, correction: Correction, scale: float, vectors: Sequence[Sequence[int]]) -> Self:
        """Return the last vectors at temperatures of the whole valid range."""
        reference = correction.reference_degc
        low, high = correction.temperature_range_degc or (
            reference - _TEST_SPAN_K,
            reference + _TEST_SPAN_K,
        )
        steps = np.linspace(low, high, _TEST_TEMPERATURES).astype(np.float32)
        degc = np.clip(steps.astype(np.float64), low, high)
        counts = vectors[-_TEST_TEMPERATURES:]
        bias, gain = np.tile(correction.bias_rad_s, (len(degc), 1)), np.ones((len(degc), 3))
        bias_size, gain_size = np.abs(bias), gain.copy()
        if correction.bias_curve is not None:
            bias = bias + correction.bias_curve.change(degc)
            bias_size += _largest_terms(correction.bias_curve, degc)
        if correction.scale_curve is not None:
            gain = gain + correction.scale_curve.change(degc)
            gain_size += _largest_terms(correction.scale_curve, degc)
        readings = scale * np.array(counts, dtype=np.float64)
        rates = (readings - bias) / gain @ correction.inverse.T
        sizes = (np.abs(readings) + bias_size) * gain_size / gain**2
        size = float((sizes @ np.abs(correction.inverse).T).max())
        return cls(counts, degc, rates, _ROUNDINGS * FLOAT_ULP * size)

    def tables(self) -> Iterator[str]:
        """Yield the tables of the self-test."""
        count = len(self.degc)
        yield f"    static const int32_t warm_counts[{count}][3] = {{"
        yield from (f"        {{{', '.join(str(v) for v in row)}}}," for row in self.counts)
        yield "    };"
        yield f"    static const float warm_degc[{count}] = {float_row(self.degc)};"
        yield f"    static const float warm_rates[{count}][3] = {{  /* rad/s */"
        yield from float_rows(self.rates_rad_s)
        yield "    };"

    def comparison(self, stem: str, first: int) -> Iterator[str]:
        """Yield the statements of the self-test; the vectors are numbered from `first` + 1."""
        high, low = float_literal(self.tolerance_rad_s), float_literal(-self.tolerance_rad_s)
        yield f"    for (k = 0; k < {len(self.degc)}; k++) {{"
        yield "        float rate[3];"
        yield f"        (void){stem}_rate_float_at(warm_counts[k], warm_degc[k], rate);"
        yield "        for (i = 0; i < 3; i++) {"
        yield "            const float off = rate[i] - warm_rates[k][i];"
        yield f"            if (off > {high} || off < {low}) {{"
        yield f"                return {first} + k + 1;  /* wrong result at this temperature */"
        yield "            }"
        yield "        }"
        yield "    }"


def _largest_terms(curve: TemperatureCurve, degc: FloatArray) -> FloatArray:
    """Return the sum of the sizes of a curve's terms, (n, 3), which bounds its rounding errors.

    The rise is that of the sum of the temperatures, because a difference of floats is as uncertain
    as its larger operand.
    """
    rise = (np.abs(degc) + abs(curve.reference_degc))[:, None]
    total = np.zeros((degc.size, 3))
    for order, row in enumerate(curve.coefficients, start=1):
        total += order * np.abs(row) * rise**order
    for knot, row in zip(curve.knots_degc, curve.knot_coefficients, strict=True):
        total += 6.0 * np.abs(row) * np.maximum(rise, np.abs(degc)[:, None] + abs(knot)) ** 3
    return total


def float_rows(rows: FloatArray) -> Iterator[str]:
    """Yield the lines of a table of floats."""
    yield from (f"        {float_row(row)}," for row in rows)


def float_row(values: FloatArray) -> str:
    """Return a row of floats in braces."""
    return f"{{{', '.join(float_literal(v) for v in values)}}}"


def float_literal(value: float) -> str:
    """Return a float literal; nine digits give exactly the same float.

    Raises:
        InputError: the value is too large for a float.
    """
    with np.errstate(over="ignore"):
        rounded = float(np.float32(value))
    if not math.isfinite(rounded):
        raise InputError(
            f"the calibration needs the number {value:.3g}, which is too large for a float in C",
            "solve the recording again, or use the format json",
        )
    text = f"{rounded:.9g}"
    return f"{text}f" if any(c in text for c in ".e") else f"{text}.0f"
