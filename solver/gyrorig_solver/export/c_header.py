"""C: one header, floating and fixed point, with vectors by which it tests itself.

What to use when: `c_header` for the text. C99 and C++, `stdint.h` and nothing else, no heap,
no division but by powers of two; names begin with the board's. Fixed point gives rates in
steps of 2^-Q rad/s from 32-bit products summed in 64 bits; Q and the products' shift are
chosen so that nothing overflows over the whole range of the counts.
"""

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from gyrorig_protocol.errors import UsageError
from gyrorig_solver.arrays import FloatArray, IntArray
from gyrorig_solver.export.numbers import AXES, Source, printable_line, quoted

_SIXTEEN_BIT = 32768
_WIDEST = 2**31 - 1
_HEADROOM = 1.2  # codes go on beyond the nominal full scale: L3G4200D +-287 at "250"
_VECTORS = 8
_FLOAT_ULP = 2.0**-24  # half a unit in the last place of a float of 1
_MAX_SHIFT = 30  # 30 bits of a result and 30 behind the point fit in 62


@dataclass(frozen=True, slots=True, eq=False)
class FixedPoint:
    """The integers of the fixed-point form; rates are (matrix counts + offset) / 2^shift."""

    matrix: IntArray  # (3, 3)
    offset: tuple[int, int, int]  # 64 bits
    shift: int
    point: int  # rates are in steps of 2^-point rad/s

    @classmethod
    def of(cls, matrix: FloatArray, offset: FloatArray, limit: int) -> "FixedPoint":
        """Return the finest form that no reading within +-limit overflows.

        Args:
            matrix: rad/s per count, shape (3, 3).
            offset: rad/s, shape (3,).
            limit: greatest count.
        """
        largest = float(np.max(np.abs(matrix).sum(axis=1) * limit + np.abs(offset)))
        point = min(30, 30 - math.ceil(math.log2(largest)))
        room = 30 - math.ceil(math.log2(float(np.abs(matrix).max()))) - point
        shift = max(0, min(_MAX_SHIFT, room))
        scaled = np.rint(np.ldexp(matrix, point + shift)).astype(np.int64)
        whole = [round(math.ldexp(float(v), point + shift)) for v in offset]
        return cls(scaled, (whole[0], whole[1], whole[2]), shift, point)

    def rates(self, counts: Sequence[int]) -> list[int]:
        """Return what the C code gives, in its steps; integers of any length."""
        half = (1 << self.shift) >> 1
        out = []
        for row, start in zip(self.matrix.tolist(), self.offset, strict=True):
            total = start + sum(a * b for a, b in zip(row, counts, strict=True))
            size = (abs(total) + half) >> self.shift
            out.append(size if total >= 0 else -size)
        return out

    def error_bound_rad_s(self, limit: int) -> float:
        """Return the most by which rounding moves a rate, over counts within +-limit."""
        products = 0.5 * (3 * limit + 1) / (1 << self.shift)
        return float(math.ldexp(products + 0.5, -self.point))


def c_header(source: Source, name: str | None = None) -> str:
    """Return the header's text.

    Args:
        source: a calibration with its gain.
        name: what its names begin with; from the board's without it.

    Raises:
        InputError: the calibration leaves open what is needed.
        UsageError: `name` is no identifier, or what a count is worth is not known.
    """
    correction = source.whole
    scale = source.found.board.config.gyro_scale_rad_s
    if scale is None:
        raise UsageError(
            "the calibration does not say what a count is worth, and C reads counts",
            "give gyro_scale_rad_s among the board's facts (or in the import map), record and "
            "solve again",
        )
    stem = name or _identifier(source.found.board.id)
    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]{0,40}", stem):
        raise UsageError(
            f"{stem[:40]!r} is no name in C",
            "give another with --name: up to 41 letters, digits and _, no digit first",
        )
    matrix, offset = scale * correction.inverse, correction.offset()
    limit = count_limit(scale, source.found.board.config.gyro_full_scale_dps)
    fixed = FixedPoint.of(matrix, offset, limit)
    parts = [
        *_head(source, stem, fixed, limit),
        *_guard(stem),
        *_facts(source, stem, fixed, scale),
        *_float(stem, matrix, offset),
        *(_float_warm(source, stem, scale) if correction.thermal_bias.size else ()),
        *_fixed(stem, fixed),
        *_self_test(stem, matrix, offset, fixed, limit),
        f"#endif  /* {stem.upper()}_GYRO_H */",
    ]
    return "\n".join(parts) + "\n"


def count_limit(scale_rad_s: float, full_scale_dps: float | None) -> int:
    """Return the greatest count that a board can send: 16 bits, or more where they do not do."""
    if full_scale_dps is None:
        return _SIXTEEN_BIT if scale_rad_s > 1e-6 else _WIDEST
    wanted = math.ceil(_HEADROOM * math.radians(full_scale_dps) / scale_rad_s)
    sixteen = wanted <= _HEADROOM**2 * _SIXTEEN_BIT
    return _SIXTEEN_BIT if sixteen else min(_WIDEST, wanted)


def _identifier(board: str) -> str:
    """Return a board's name as C has names: GY80-1 becomes gy80_1."""
    plain = re.sub(r"[^a-z0-9]+", "_", board.lower()).strip("_") or "gyro"
    return (plain if plain[0].isalpha() else f"board_{plain}")[:40]


def _head(source: Source, stem: str, fixed: FixedPoint, limit: int) -> Iterator[str]:
    lines = [
        *source.head(),
        "",
        "What goes in: counts as the sensor sends them, in its own x, y, z, signs as they come.",
        f"What comes out: the true rate in rad/s, in {AXES[source.frame]}.",
        "    rate = A counts + c;  A = scale (S T M)^-1, c = -(S T M)^-1 b; rows first.",
        "Positive rates turn counter-clockwise about their axis, seen from its tip.",
        f"{stem}_rate_float: float. {stem}_rate_fixed: 32-bit integers,",
        f"    1 is 2^-{fixed.point} rad/s; rounding moves them by at most "
        f"{fixed.error_bound_rad_s(limit):.2g} rad/s.",
        f"Counts are within +-{limit}: beyond that fixed point may overflow.",
        f"{stem}_self_test returns 0 if compiler and processor give what they should.",
        *source.left_out(("thermal_bias",)),
    ]
    if source.whole.thermal_bias.size:
        lines.append(
            f"{stem}_rate_float_at takes the temperature too; the others hold at "
            f"{source.whole.reference_degc:.2f} degC"
            + (
                ""
                if source.found.validity.temperature_degc is not None
                else ", counted as the recording counts: from a zero that is not known"
            )
        )
    yield "/*"
    yield from (f" * {printable_line(line) if line.strip() == line else line}".rstrip()
                for line in lines)  # fmt: skip
    yield " */"


def _guard(stem: str) -> Iterator[str]:
    yield f"#ifndef {stem.upper()}_GYRO_H"
    yield f"#define {stem.upper()}_GYRO_H"
    yield ""
    yield "#include <stdint.h>"
    yield ""


def _facts(source: Source, stem: str, fixed: FixedPoint, scale: float) -> Iterator[str]:
    upper, found = stem.upper(), source.found
    yield f"#define {upper}_BOARD {quoted(found.board.id)}"
    yield f"#define {upper}_VERSION {found.version}"
    yield f"#define {upper}_NOMINAL_SCALE_RAD_S {scale!r}  /* of one count, by the data sheet */"
    if source.time_offset_s is not None:
        yield f"#define {upper}_TIME_OFFSET_S {source.time_offset_s!r}  /* subtract it from a"
        yield "    sample's time: then it is when the motion was so */"
    yield f"#define {upper}_FIXED_POINT {fixed.point}  /* 1 is 2^-{fixed.point} rad/s */"
    yield ""


def _float(stem: str, matrix: FloatArray, offset: FloatArray) -> Iterator[str]:
    yield f"static inline void {stem}_rate_float(const int32_t counts[3], float rate_rad_s[3])"
    yield "{"
    yield "    static const float A[3][3] = {"
    yield from (f"        {{{', '.join(_f(v) for v in row)}}}," for row in matrix)
    yield "    };"
    yield f"    static const float c[3] = {{{', '.join(_f(v) for v in offset)}}};"
    yield "    int i;"
    yield ""
    yield "    for (i = 0; i < 3; i++) {"
    yield "        rate_rad_s[i] = A[i][0] * (float)counts[0] + A[i][1] * (float)counts[1]"
    yield "            + A[i][2] * (float)counts[2] + c[i];"
    yield "    }"
    yield "}"
    yield ""


def _float_warm(source: Source, stem: str, scale: float) -> Iterator[str]:
    """Write the form with a temperature: the bias' polynomial, in counts, by Horner's rule."""
    correction = source.whole
    orders = correction.thermal_bias / scale
    yield f"static inline void {stem}_rate_float_at(const int32_t counts[3],"
    yield "                                         float temperature_degc, float rate_rad_s[3])"
    yield "{"
    yield f"    static const float bias[{len(orders)}][3] = {{  /* counts/K, /K^2, ... */"
    yield from (f"        {{{', '.join(_f(v) for v in row)}}}," for row in orders)
    yield "    };"
    yield "    static const float A[3][3] = {"
    yield from (
        f"        {{{', '.join(_f(v) for v in row)}}}," for row in scale * correction.inverse
    )
    yield "    };"
    yield f"    static const float c[3] = {{{', '.join(_f(v) for v in correction.offset())}}};"
    yield f"    const float warmth = temperature_degc - {_f(correction.reference_degc)};"
    yield "    float y[3];"
    yield "    int i, k;"
    yield ""
    yield "    for (i = 0; i < 3; i++) {"
    yield "        float drift = 0.0f;"
    yield f"        for (k = {len(orders) - 1}; k >= 0; k--) {{"
    yield "            drift = (drift + bias[k][i]) * warmth;"
    yield "        }"
    yield "        y[i] = (float)counts[i] - drift;"
    yield "    }"
    yield "    for (i = 0; i < 3; i++) {"
    yield "        rate_rad_s[i] = A[i][0] * y[0] + A[i][1] * y[1] + A[i][2] * y[2] + c[i];"
    yield "    }"
    yield "}"
    yield ""


def _fixed(stem: str, fixed: FixedPoint) -> Iterator[str]:
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


def _self_test(
    stem: str, matrix: FloatArray, offset: FloatArray, fixed: FixedPoint, limit: int
) -> Iterator[str]:
    vectors = _vectors(min(limit, 10 * _SIXTEEN_BIT))
    rates = [matrix @ np.array(v, dtype=np.float64) + offset for v in vectors]
    sizes = [np.abs(matrix) @ np.abs(np.array(v, dtype=np.float64)) + np.abs(offset)
             for v in vectors]  # fmt: skip
    # Three products and three sums, each rounded, and constants that are rounded themselves.
    most = 8.0 * _FLOAT_ULP * max(float(s.max()) for s in sizes)
    many = len(vectors)
    yield f"static inline int {stem}_self_test(void)"
    yield "{"
    yield f"    static const int32_t counts[{many}][3] = {{"
    yield from (f"        {{{', '.join(str(v) for v in row)}}}," for row in vectors)
    yield "    };"
    yield f"    static const float rates[{many}][3] = {{  /* rad/s */"
    yield from (f"        {{{', '.join(_f(v) for v in row)}}}," for row in rates)
    yield "    };"
    yield f"    static const int32_t steps[{many}][3] = {{  /* 2^-{fixed.point} rad/s */"
    yield from (f"        {{{', '.join(str(v) for v in fixed.rates(row))}}}," for row in vectors)
    yield "    };"
    yield "    int i, k;"
    yield ""
    yield f"    for (k = 0; k < {many}; k++) {{"
    yield "        float rate[3];"
    yield "        int32_t step[3];"
    yield f"        {stem}_rate_float(counts[k], rate);"
    yield f"        {stem}_rate_fixed(counts[k], step);"
    yield "        for (i = 0; i < 3; i++) {"
    yield "            const float off = rate[i] - rates[k][i];"
    yield f"            if (off > {_f(most)} || off < {_f(-most)} || step[i] != steps[k][i]) {{"
    yield "                return k + 1;  /* this vector comes out wrong */"
    yield "            }"
    yield "        }"
    yield "    }"
    yield "    return 0;"
    yield "}"
    yield ""


def _vectors(limit: int) -> list[list[int]]:
    """Return counts to test with: rest, each axis both ways, corners, and some by chance."""
    rows = [[0, 0, 0]]
    rows += [[sign * limit * (i == k) for k in range(3)] for i in range(3) for sign in (1, -1)]
    rows += [[limit - 1] * 3, [-limit] * 3, [1, -1, 1]]
    chance = np.random.default_rng(1).integers(-limit, limit, size=(_VECTORS, 3))
    return rows + [[int(v) for v in row] for row in chance]


def _f(value: float) -> str:
    """Return a float's literal: nine digits bring back the very same one."""
    text = f"{float(np.float32(value)):.9g}"
    return f"{text}f" if any(c in text for c in ".e") else f"{text}.0f"
