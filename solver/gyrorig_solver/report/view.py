"""From a report's data to what the page says: texts, rows and figures, ready to set.

Everything that needs a decision (units, digits, which figure) is decided here; the
template only places it, and escapes all that came from outside.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.arrays import FloatArray
from gyrorig_solver.calibration.document import Calibration
from gyrorig_solver.calibration.wording import (
    GROUPS,
    VERDICTS,
    Group,
    entries,
    level_words,
    other_groups,
    quantity,
    short,
)
from gyrorig_solver.estimate.result import Clock, FitDiagnostics
from gyrorig_solver.report.data import ReportData
from gyrorig_solver.report.data_sheet import allowed, noise_said

SINGULAR = 1e6  # condition of a gain matrix that undoes nothing; the paper's method makes such
_NO_SECOND_CLOCK_S = 1e-9  # stamps that agree to rounding are one and the same clock
_DEG = 180.0 / math.pi
_NOISE = (  # name in the document, words, factor, unit
    ("angle_random_walk", "white noise (angle random walk)", _DEG, "deg/s/√Hz"),
    ("bias_instability", "bias instability", 3600.0 * _DEG, "deg/h"),
    ("rate_random_walk", "rate random walk", _DEG, "deg/s²/√Hz"),
)
_AXIS_COLOURS = ("var(--x)", "var(--y)", "var(--z)")
Limits = tuple[float, float]  # what the data sheet allows, in the unit that is shown
_LEFT, _RIGHT = 30.0, 170.0  # of the allowed range in a bar that is 200 wide


@dataclass(frozen=True, slots=True)
class Tile:
    """One figure at the top of the page."""

    name: str
    before: str
    value: str
    note: str


@dataclass(frozen=True, slots=True)
class Bar:
    """One value inside its data sheet's range, in the units of the drawing."""

    low: str
    middle: str
    high: str
    colour: str
    words: str


@dataclass(frozen=True, slots=True)
class Row:
    """One parameter's line; `value` is empty where it was not observable."""

    name: str
    value: str = ""
    std: str = ""
    interval: str = ""
    unit: str = ""
    bar: Bar | None = None


@dataclass(frozen=True, slots=True)
class RowGroup:
    """The rows of one parameter vector."""

    name: str
    meaning: str
    rows: tuple[Row, ...]


def tiles(data: ReportData) -> list[Tile]:
    """Return the figures that say most: gain, rate error, turned angle, observability."""
    calibration = data.calibration
    out = list(_gain_tile(calibration))
    gain = inverse_gain(calibration)
    if data.diagnostics is not None:
        before, after = _window_error(data.diagnostics, gain)
        out.append(
            Tile(
                "rotation error in 1 s",
                f"{short(before)}°",
                f"{short(after)}°",
                "root mean square over the recording",
            )
        )
    seen = calibration.observability
    out.append(Tile("parameters shown", "", f"{seen.rank} of {seen.of}", "by this motion"))
    chi2 = calibration.quality.reduced_chi2
    if chi2 is not None:
        out.append(Tile("reduced chi²", "", short(chi2), "1 when only noise is left"))
    second = calibration.quality.rest_to_rest
    if second is not None:
        words = f"largest difference to the turns from rest to rest ({second.moves} moves)"
        out.append(Tile("second opinion", "", f"{second.largest_sigma:.1f} sd", words))
    return out


def groups(data: ReportData) -> list[RowGroup]:
    """Return every parameter of the document as rows of a table."""
    calibration = data.calibration
    full_scale_dps = calibration.board.config.gyro_full_scale_dps
    return [
        RowGroup(
            f"{group.name.replace('_', ' ')} ({group.unit})",
            group.meaning + _allowed(group, limits),
            tuple(_rows(calibration, group, limits)),
        )
        for group in (*GROUPS, *other_groups(calibration))
        if group.name in calibration.parameters
        for limits in [allowed(group.name, data.profile, full_scale_dps)]
    ]


def _allowed(group: Group, limits: Limits | None) -> str:
    """Return what the data sheet allows of a group, as words behind its meaning."""
    if limits is None:
        return ""
    unit = "" if group.unit == "1" else f" {group.unit}"
    return f"; the data sheet allows {short(limits[0])} to {short(limits[1])}{unit}"


def noise_rows(data: ReportData) -> list[dict[str, str]]:
    """Return the noise's coefficients in the units that data sheets have, row by row."""
    rows = []
    for name, words, factor, unit in _NOISE:
        figure = data.calibration.noise.get(name)
        if figure is None:
            continue
        axes = ["not seen" if v is None else short(v * factor) for v in figure.value]
        said = noise_said(name, data.profile)
        rows.append({"name": words, "axes": ", ".join(axes), "unit": unit, "sheet": said})
    return rows


def findings_text(calibration: Calibration) -> str:
    """Return what a search for causes found, empty where none was made."""
    found = calibration.findings
    if found is None:
        return ""
    page = found.file.replace(".yaml", ".html")
    if found.verdict == "adequate":
        words = "The model leaves nothing but noise: no cause beyond it was found"
    elif found.causes:
        named = ", ".join(cause.replace("_", " ") for cause in found.causes)
        left = "" if found.verdict == "explained" else "; something is left without a name"
        words = f"Found, and taken into the fit: {named}{left}"
    else:
        words = "Something is left that no known cause explains"
    return f"{words}. Its figures are in {page}, beside this file."


def clock_rows(clock: Clock) -> list[tuple[str, str]]:
    """Return what the board's clock did, as names and texts."""
    if clock.latency_max_s < _NO_SECOND_CLOCK_S:
        return [
            ("stamps", "one column of times: there is no second clock to set beside it"),
            ("common gain rests on", clock.truth),
        ]
    speed = "faster" if clock.skew_ppm > 0.0 else "slower"
    rows = [
        ("speed", f"{short(abs(clock.skew_ppm))} ppm {speed} than the capture clock"),
        ("map good to", f"{short(clock.wander_bound_s * 1e6)} µs"),
        ("samples late by", f"{short(clock.latency_median_s * 1e3)} ms in the middle, "
         f"{short(clock.latency_max_s * 1e3)} ms at most"),
        ("restarts, wraps", f"{clock.restarts}, {clock.wraps}"),
        ("common gain rests on", clock.truth),
    ]  # fmt: skip
    return rows


def level_text(calibration: Calibration) -> str:
    """Return how the unit stands by the board's accelerometer; empty if it was not seen."""
    level = calibration.quality.level
    if level is None:
        return ""
    zero = level.tilt_zero, level.tilt_zero_std
    return level_words(zero, level.lean, level.lean_std, level.rests)


def apart_rows(calibration: Calibration) -> list[dict[str, str]]:
    """Return what is each recording's own in a joint solve, row by row."""
    return [
        {
            "name": own.name,
            "bias": ", ".join(
                _pair(value, std, math.degrees(1.0))
                for value, std in zip(own.bias, own.bias_std, strict=True)
            ),
            "time_offset": _pair(own.time_offset, own.time_offset_std, 1e3),
        }
        for own in calibration.quality.recordings or []
    ]


def _pair(value: float | None, std: float | None, factor: float) -> str:
    if value is None:
        return "not shown"
    text, error = quantity(factor * value, None if std is None else factor * std)
    return f"{text} ± {error}" if error else text


def inverse_gain(calibration: Calibration) -> FloatArray:
    """Return G⁻¹, or the identity where G is not all known or has none; shape (3, 3)."""
    rows = calibration.matrices.STM
    values = [v for row in rows for v in row]
    if any(v is None for v in values):
        return np.eye(3)
    gain = np.array(rows, dtype=np.float64)
    if np.linalg.cond(gain) > SINGULAR:
        return np.eye(3)
    return np.asarray(np.linalg.inv(gain), dtype=np.float64)


def matrix_text(calibration: Calibration) -> str:
    """Return the inverse gain and the bias as a person copies them; empty if not known."""
    rows, bias = calibration.matrices.STM, entries(calibration.parameters["bias"])
    if any(v is None for row in rows for v in row) or any(v is None for v, _ in bias):
        return ""
    inverse = inverse_gain(calibration)
    lines = ["(S T M)⁻¹ ="]
    lines += ["  [" + ", ".join(f"{v:+.9f}" for v in row) + "]" for row in inverse]
    lines.append("b = [" + ", ".join(f"{v or 0.0:+.9f}" for v, _ in bias) + "] rad/s")
    return "\n".join(lines)


def lag_text(calibration: Calibration) -> str:
    """Return one sentence on the time offset; empty if it was not found."""
    parameter = calibration.parameters.get("time_offset")
    value = entries(parameter)[0][0] if parameter else None
    if value is None:
        return ""
    side = "behind" if value >= 0.0 else "ahead of"
    return (
        f"A sample tells of the motion {short(abs(value) * 1e3)} ms {side} its stamp's time: "
        "subtract the time offset from the stamp."
    )


def verdict(calibration: Calibration) -> tuple[str, str]:
    """Return the verdict's title and sentence."""
    return VERDICTS[calibration.trust.verdict]


def _gain_tile(calibration: Calibration) -> Iterator[Tile]:
    shown = [(v, s) for v, s in entries(calibration.parameters["scale"]) if v is not None]
    if shown:
        worst = max(abs(v - 1.0) for v, _ in shown)
        left = max(1.96 * (s or 0.0) for _, s in shown)
        yield Tile(
            "scale error",
            f"{short(100 * worst)} %",
            f"±\u00a0{short(100 * left)}\u00a0%",
            "worst axis; after: 95 % interval",
        )


def _rows(calibration: Calibration, group: Group, limits: Limits | None) -> Iterator[Row]:
    parameter = calibration.parameters[group.name]
    for axis, (label, (value, std)) in enumerate(
        zip(group.labels, entries(parameter), strict=True)
    ):
        name = label or group.name.replace("_", " ")
        if value is None:
            yield Row(name)
            continue
        shown, error = value * group.factor, None if std is None else std * group.factor
        text, error_text = quantity(shown, error)
        interval = ""
        if error is not None and error > 0.0:
            low, high = (quantity(shown + k * 1.96 * error, error)[0] for k in (-1.0, 1.0))
            interval = f"{low} … {high}"
        bar = None if limits is None else _bar(limits, group.unit, axis, shown, error or 0.0)
        yield Row(name, text, error_text, interval, group.unit, bar)


def _bar(limits: Limits, unit: str, axis: int, value: float, std: float) -> Bar:
    low, high = limits

    def place(x: float) -> str:
        at = _LEFT + (x - low) / (high - low) * (_RIGHT - _LEFT)
        return f"{min(196.0, max(4.0, at)):.1f}"

    inside = low <= value <= high
    side = "inside" if inside else "outside"
    words = f"{side} the data sheet's {short(low)} to {short(high)} {unit}"
    colour = _AXIS_COLOURS[axis % 3] if inside else "var(--refused)"
    return Bar(place(value - 1.96 * std), place(value), place(value + 1.96 * std), colour, words)


def _window_error(data: FitDiagnostics, gain: FloatArray) -> tuple[float, float]:
    """Return the rms angle, in degrees, by which 1 s of integration goes wrong."""
    window = np.floor(data.time_s - data.time_s[0]).astype(np.int64)
    out = []
    for error in (data.rate_rad_s - data.reference_rad_s, data.residual_rad_s @ gain.T):
        known = np.isfinite(error).all(axis=1)
        count = np.bincount(window[known])
        whole = count >= 0.9 * np.median(count[count > 0])
        sums = [np.bincount(window[known], column[known])[whole] for column in error.T]
        angles = np.stack(sums) / count[whole]  # mean rate x 1 s
        out.append(math.degrees(math.sqrt(float(np.mean(np.sum(angles**2, axis=0))))))
    return out[0], out[1]
