"""C header with floating-point and fixed-point functions and a self-test.

What to use when: `c_header` for the text. It is valid C99 and C++, includes only `stdint.h`,
uses no heap and divides only by powers of two; its names begin with that of the board. The
fixed-point form gives rates in steps of 2^-Q rad/s from 32-bit factors summed in 64 bits. Q
and the shift of the products are chosen so that no count in the range overflows.
"""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import UsageError
from gyrorig_solver.apply import Correction
from gyrorig_solver.data import FloatArray, IntArray
from gyrorig_solver.export.c_temperature import (
    FLOAT_ULP,
    TemperatureVectors,
    float_literal,
    float_row,
    float_rows,
    function_with_temperature,
)
from gyrorig_solver.export.export_source import ExportSource, comment_lines, quoted

_INT16_LIMIT = 32768
_INT32_LIMIT = 2**31 - 1
# sensors read above their nominal full scale: an L3G4200D +-287 deg/s at "250"
_FULL_SCALE_HEADROOM = 1.2
_RANDOM_VECTORS = 8
_MAX_SHIFT = 30  # 30 integer bits and 30 fraction bits fit in 62


@dataclass(frozen=True, slots=True, eq=False)
class FixedPoint:
    """The integers of the fixed-point form: rates = (matrix counts + offset) / 2^shift."""

    matrix: IntArray  # (3, 3)
    offset: tuple[int, int, int]  # 64 bits
    shift: int
    fraction_bits: int  # rates are in steps of 2^-fraction_bits rad/s

    @classmethod
    def of(cls, matrix: FloatArray, offset: FloatArray, limit: int) -> "FixedPoint":
        """Return the finest form in which no count within +-limit overflows.

        Args:
            matrix: rad/s per count, shape (3, 3).
            offset: rad/s, shape (3,).
            limit: largest count.
        """
        largest = float(np.max(np.abs(matrix).sum(axis=1) * limit + np.abs(offset)))
        fraction_bits = min(30, 30 - math.ceil(math.log2(largest)))
        room = 30 - math.ceil(math.log2(float(np.abs(matrix).max()))) - fraction_bits
        shift = max(0, min(_MAX_SHIFT, room))
        scaled = np.rint(np.ldexp(matrix, fraction_bits + shift)).astype(np.int64)
        whole = [round(math.ldexp(float(v), fraction_bits + shift)) for v in offset]
        return cls(scaled, (whole[0], whole[1], whole[2]), shift, fraction_bits)

    def rates(self, counts: Sequence[int]) -> list[int]:
        """Return the result of the C code, in steps, computed with unlimited integers."""
        half = (1 << self.shift) >> 1
        out = []
        for row, start in zip(self.matrix.tolist(), self.offset, strict=True):
            total = start + sum(a * b for a, b in zip(row, counts, strict=True))
            size = (abs(total) + half) >> self.shift
            out.append(size if total >= 0 else -size)
        return out

    def error_bound_rad_s(self, limit: int) -> float:
        """Return the largest rounding error of a rate, for counts within +-limit."""
        products = 0.5 * (3 * limit + 1) / (1 << self.shift)
        return float(math.ldexp(products + 0.5, -self.fraction_bits))


def c_header(source: ExportSource, name: str | None = None) -> str:
    """Return the header's text.

    Raises:
        InputError: a needed parameter is not known.
        UsageError: `name` is not an identifier, or the nominal scale is not known.
    """
    correction = source.correction
    scale = source.document.board.config.gyro_scale_rad_s
    if scale is None:
        raise UsageError(
            "the exported C code needs the nominal scale factor of the board to convert counts to "
            "rates, but the calibration does not contain it",
            "add gyro_scale_rad_s of the board to the rig file or the import map, then "
            "record or import again, and solve again",
        )
    stem = _identifier(source.document.board.id) if name is None else name
    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]{0,40}", stem):
        raise UsageError(
            f"the name {stem[:40]!r} is not a valid name in C",
            "choose another name with --name, with at most 41 letters, digits and "
            "underscores, and no digit at the start",
        )
    inverse, offset = correction.affine_form()
    matrix = scale * inverse
    limit = largest_count(scale, source.document.board.config.gyro_full_scale_dps)
    fixed = FixedPoint.of(matrix, offset, limit)
    vectors = _test_vectors(min(limit, 10 * _INT16_LIMIT))
    at_temperatures = (
        TemperatureVectors.of(correction, scale, vectors) if correction.needs_temperature else None
    )
    parts = [
        *_header_comment(source, stem, fixed, limit),
        *_include_guard(stem),
        *_definitions(source, stem, fixed, scale),
        *_float_function(stem, matrix, offset),
        *(
            function_with_temperature(correction, stem, scale)
            if correction.needs_temperature
            else ()
        ),
        *_fixed_function(stem, fixed),
        *_self_test_function(stem, matrix, offset, fixed, vectors, at_temperatures),
        f"#endif  /* {stem.upper()}_GYRO_H */",
    ]
    return "\n".join(parts) + "\n"


def largest_count(scale_rad_s: float, full_scale_dps: float | None) -> int:
    """Return the largest count of a board: 16 bits, or more if its full scale needs more."""
    if full_scale_dps is None:
        return _INT16_LIMIT if scale_rad_s > 1e-6 else _INT32_LIMIT
    needed = math.ceil(_FULL_SCALE_HEADROOM * math.radians(full_scale_dps) / scale_rad_s)
    fits_16_bits = needed <= _FULL_SCALE_HEADROOM**2 * _INT16_LIMIT
    return _INT16_LIMIT if fits_16_bits else min(_INT32_LIMIT, needed)


def _identifier(board: str) -> str:
    """Return the name of a board as a C identifier: GY80-1 becomes gy80_1."""
    plain = re.sub(r"[^a-z0-9]+", "_", board.lower()).strip("_") or "gyro"
    return (plain if plain[0].isalpha() else f"board_{plain}")[:40]


def _header_comment(
    source: ExportSource, stem: str, fixed: FixedPoint, limit: int
) -> Iterator[str]:
    inverse = "(S T M)^-1" if source.frame == "stage" else "(S T)^-1"
    lines = [
        *source.header_lines(),
        "",
        "Input: counts as the sensor sends them, in its own axes x, y, z.",
        f"Output: the true rate in rad/s, in {source.axes_text}.",
        f"    rate = A counts + c; A = scale {inverse}, c = -{inverse} b; rows first.",
        "Positive rates are counter-clockwise about their axis, seen from its tip.",
        f"{stem}_rate_float gives floats. {stem}_rate_fixed gives 32-bit integers in steps",
        f"    of 2^-{fixed.fraction_bits} rad/s; their rounding error is at most "
        f"{fixed.error_bound_rad_s(limit):.2g} rad/s.",
        f"The fixed-point function can overflow if a count is outside +-{limit}.",
        f"{stem}_self_test returns 0 if the functions give the expected results.",
        *source.omission_lines(_carried_causes(source.correction)),
    ]
    if source.correction.needs_temperature:
        lines.append(
            f"{stem}_rate_float_at also takes the temperature, and returns 1 if it is outside the "
            "valid range; the other functions are valid at "
            f"{source.correction.reference_degc:.2f} degC"
            + (
                ""
                if source.document.validity.temperature_degc is not None
                else " relative to the unknown zero of the recording"
            )
        )
    yield "/*"
    yield from comment_lines(" * ", lines)
    yield " */"


def _carried_causes(correction: Correction) -> tuple[str, ...]:
    """Return the causes that the function with a temperature contains."""
    bias = () if correction.bias_curve is None else ("thermal_bias",)
    scale = () if correction.scale_curve is None else ("thermal_scale", "temperature.scale")
    return (*bias, *scale)


def _include_guard(stem: str) -> Iterator[str]:
    yield f"#ifndef {stem.upper()}_GYRO_H"
    yield f"#define {stem.upper()}_GYRO_H"
    yield ""
    yield "#include <stdint.h>"
    yield ""


def _definitions(source: ExportSource, stem: str, fixed: FixedPoint, scale: float) -> Iterator[str]:
    upper, document = stem.upper(), source.document
    yield f"#define {upper}_BOARD {quoted(document.board.id)}"
    yield f"#define {upper}_VERSION {document.version}"
    yield f"#define {upper}_NOMINAL_SCALE_RAD_S {scale!r}  /* of one count, from the data sheet */"
    if source.time_offset_s is not None:
        yield f"#define {upper}_TIME_OFFSET_S {source.time_offset_s!r}  /* subtract it from a"
        yield "    sample's time to get the time of the motion */"
    bits = fixed.fraction_bits
    yield f"#define {upper}_FIXED_POINT {bits}  /* 1 is 2^-{bits} rad/s */"
    yield ""


def _float_function(stem: str, matrix: FloatArray, offset: FloatArray) -> Iterator[str]:
    yield f"static inline void {stem}_rate_float(const int32_t counts[3], float rate_rad_s[3])"
    yield "{"
    yield "    static const float A[3][3] = {"
    yield from float_rows(matrix)
    yield "    };"
    yield f"    static const float c[3] = {float_row(offset)};"
    yield "    int i;"
    yield ""
    yield "    for (i = 0; i < 3; i++) {"
    yield "        rate_rad_s[i] = A[i][0] * (float)counts[0] + A[i][1] * (float)counts[1]"
    yield "            + A[i][2] * (float)counts[2] + c[i];"
    yield "    }"
    yield "}"
    yield ""


def _fixed_function(stem: str, fixed: FixedPoint) -> Iterator[str]:
    yield f"static inline void {stem}_rate_fixed(const int32_t counts[3], int32_t rate[3])"
    yield "{"
    yield "    static const int32_t A[3][3] = {"
    yield from (f"        {{{', '.join(str(v) for v in row)}}}," for row in fixed.matrix.tolist())
    yield "    };"
    whole = ", ".join(f"INT64_C({v})" for v in fixed.offset)
    yield f"    static const int64_t c[3] = {{{whole}}};"
    yield f"    const int64_t one = INT64_C(1) << {fixed.shift};"
    yield "    int i;"
    yield ""
    yield "    for (i = 0; i < 3; i++) {"
    yield "        const int64_t sum = c[i] + (int64_t)A[i][0] * counts[0]"
    yield "            + (int64_t)A[i][1] * counts[1] + (int64_t)A[i][2] * counts[2];"
    yield "        rate[i] = (int32_t)((sum >= 0 ? sum + one / 2 : sum - one / 2) / one);"
    yield "    }"
    yield "}"
    yield ""


def _self_test_function(
    stem: str,
    matrix: FloatArray,
    offset: FloatArray,
    fixed: FixedPoint,
    vectors: Sequence[Sequence[int]],
    at_temperatures: TemperatureVectors | None,
) -> Iterator[str]:
    rates = [matrix @ np.array(v, dtype=np.float64) + offset for v in vectors]
    magnitudes = [np.abs(matrix) @ np.abs(np.array(v, dtype=np.float64)) + np.abs(offset)
             for v in vectors]  # fmt: skip
    # Three products and three sums are rounded, and so are the constants.
    tolerance = 8.0 * FLOAT_ULP * max(float(s.max()) for s in magnitudes)
    vector_count = len(vectors)
    yield f"static inline int {stem}_self_test(void)"
    yield "{"
    yield f"    static const int32_t counts[{vector_count}][3] = {{"
    yield from (f"        {{{', '.join(str(v) for v in row)}}}," for row in vectors)
    yield "    };"
    yield f"    static const float rates[{vector_count}][3] = {{  /* rad/s */"
    yield from (f"        {{{', '.join(float_literal(v) for v in row)}}}," for row in rates)
    yield "    };"
    unit = f"2^-{fixed.fraction_bits} rad/s"
    yield f"    static const int32_t steps[{vector_count}][3] = {{  /* {unit} */"
    yield from (f"        {{{', '.join(str(v) for v in fixed.rates(row))}}}," for row in vectors)
    yield "    };"
    if at_temperatures is not None:
        yield from at_temperatures.tables()
    yield "    int i, k;"
    yield ""
    yield f"    for (k = 0; k < {vector_count}; k++) {{"
    yield "        float rate[3];"
    yield "        int32_t step[3];"
    yield f"        {stem}_rate_float(counts[k], rate);"
    yield f"        {stem}_rate_fixed(counts[k], step);"
    yield "        for (i = 0; i < 3; i++) {"
    yield "            const float off = rate[i] - rates[k][i];"
    high, low = float_literal(tolerance), float_literal(-tolerance)
    yield f"            if (off > {high} || off < {low} || step[i] != steps[k][i]) {{"
    yield "                return k + 1;  /* wrong result for this vector */"
    yield "            }"
    yield "        }"
    yield "    }"
    if at_temperatures is not None:
        yield from at_temperatures.comparison(stem, vector_count)
    yield "    return 0;"
    yield "}"
    yield ""


def _test_vectors(limit: int) -> list[list[int]]:
    """Return test counts: zero, each axis in both directions, corners and random counts."""
    rows = [[0, 0, 0]]
    rows += [[sign * limit * (i == k) for k in range(3)] for i in range(3) for sign in (1, -1)]
    rows += [[limit - 1] * 3, [-limit] * 3, [1, -1, 1]]
    random_counts = np.random.default_rng(1).integers(-limit, limit, size=(_RANDOM_VECTORS, 3))
    return rows + [[int(v) for v in row] for row in random_counts]
