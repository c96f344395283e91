"""View of the calibration report: its texts and table rows.

Units, digits and the choice of figures are decided here. The template only places the texts and
escapes everything that comes from files.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from gyrorig_solver.calibration import CalibrationDocument
from gyrorig_solver.calibration.calibration_document import ParameterUncertainty
from gyrorig_solver.calibration.calibration_wording import (
    axes_text,
    cause_groups,
    group_causes,
    level_sentence,
    shown_entries,
    value_std_pairs,
    white_noise_units,
)
from gyrorig_solver.calibration.uncertainty_wording import contribution_name
from gyrorig_solver.estimate import ClockQuality
from gyrorig_solver.model import (
    DEG_PER_RAD,
    PARAMETER_GROUPS,
    ParameterGroup,
    format_quantity,
    format_short,
    format_two_digits,
    group_of,
    parameter_label,
)
from gyrorig_solver.report.data_sheet import (
    data_sheet_noise,
    data_sheet_range,
    data_sheet_white_noise,
)
from gyrorig_solver.report.report_data import ReportData
from gyrorig_solver.report.summary_tiles import inverse_gain

_NO_SECOND_CLOCK_S = 1e-9  # a smaller latency means that there is only one clock
_NOISE_ROWS = (  # name in the document, name shown, factor, unit
    ("angle_random_walk_in_motion", "noise density in motion", DEG_PER_RAD, "deg/s/√Hz, one-sided"),
    (
        "angle_random_walk_pan_motion",
        "noise density while pan moves",
        DEG_PER_RAD,
        "deg/s/√Hz, one-sided",
    ),
    (
        "angle_random_walk_tilt_motion",
        "noise density while tilt moves",
        DEG_PER_RAD,
        "deg/s/√Hz, one-sided",
    ),
    ("noise_floor", "noise floor behind the low-pass", DEG_PER_RAD, "deg/s/√Hz, one-sided"),
    ("bias_instability", "bias instability", 3600.0 * DEG_PER_RAD, "deg/h"),
    ("rate_random_walk", "rate random walk", DEG_PER_RAD, "deg/s²/√Hz"),
)
_AXIS_COLOURS = ("var(--x)", "var(--y)", "var(--z)")
DataSheetLimits = tuple[float, float]  # the data sheet's range, in the unit that is shown
_LEFT, _RIGHT = 30.0, 170.0  # ends of the data sheet's range in a bar 200 wide


@dataclass(frozen=True, slots=True)
class RangeBar:
    """A value with its 95 % interval in the data sheet's range, in units of the drawing."""

    low: str
    middle: str
    high: str
    colour: str
    words: str


@dataclass(frozen=True, slots=True)
class ParameterRow:
    """One parameter's row; `value` is empty where it was not observable."""

    name: str
    value: str = ""
    std: str = ""
    interval: str = ""
    unit: str = ""
    bar: RangeBar | None = None


@dataclass(frozen=True, slots=True)
class ParameterTable:
    """The rows of one parameter vector."""

    name: str
    meaning: str
    rows: tuple[ParameterRow, ...]


def parameter_tables(data: ReportData) -> list[ParameterTable]:
    """Return every parameter of the document as rows of a table."""
    calibration = data.calibration
    full_scale_dps = calibration.board.config.gyro_full_scale_dps
    return [
        ParameterTable(
            group.name.replace("_", " ") + ("" if group.unit in ("", "1") else f" ({group.unit})"),
            group.meaning + _data_sheet_words(group, limits),
            tuple(_rows(calibration, group, limits)),
        )
        for group in (*PARAMETER_GROUPS, *cause_groups(calibration))
        if group.name in calibration.parameters
        for limits in [data_sheet_range(group.name, data.profile, full_scale_dps)]
    ]


def _data_sheet_words(group: ParameterGroup, limits: DataSheetLimits | None) -> str:
    """Return the data sheet's range of a group, to put behind its meaning."""
    if limits is None:
        return ""
    unit = "" if group.unit in ("", "1") else f" {group.unit}"
    return f"; the data sheet allows {format_short(limits[0])} to {format_short(limits[1])}{unit}"


def noise_rows(data: ReportData) -> list[dict[str, str]]:
    """Return the noise coefficients in the units of data sheets, row by row."""
    rows = []
    white = data.calibration.noise.get("angle_random_walk")
    if white is not None:
        sheet_texts = data_sheet_white_noise(data.profile)
        rows = [
            {"name": name, "axes": axes, "unit": unit, "sheet": sheet}
            for (name, axes, unit), sheet in zip(
                white_noise_units(white.value), sheet_texts, strict=True
            )
        ]
    for name, words, factor, unit in _NOISE_ROWS:
        figure = data.calibration.noise.get(name)
        if figure is None:
            continue
        axes = axes_text([None if v is None else v * factor for v in figure.value])
        sheet = data_sheet_noise(name, data.profile)
        rows.append({"name": words, "axes": axes, "unit": unit, "sheet": sheet})
    return rows


def uncertainty_rows(calibration: CalibrationDocument) -> list[dict[str, Any]]:
    """Return the uncertainty budget row by row; empty if it was not evaluated."""
    record = calibration.uncertainty
    if record is None:
        return []
    rows = []
    for name, entry in record.parameters.items():
        group = group_of(name)
        factor, unit = (1.0, "") if group is None else (group.factor, group.unit)
        rows.append(
            {
                "name": name,
                "unit": "" if unit == "1" else unit,
                "type_a": format_two_digits(entry.type_a * factor),
                "type_b": format_two_digits(entry.type_b * factor),
                "total": format_two_digits(entry.total * factor),
                "interval": _interval_text(entry, factor),
                "limit": format_short(entry.limit * factor),
                "above": entry.total > entry.limit,
                "contributions": [
                    {
                        "name": contribution_name(row),
                        "size": format_two_digits(row.contribution * factor),
                        "share": f"{100.0 * row.share:.0f} %",
                    }
                    for row in record.budget
                    if row.parameter == name
                ],
            }
        )
    return rows


def _interval_text(entry: ParameterUncertainty, factor: float) -> str:
    """Return the interval, rounded as by its standard uncertainty if all errors were normal."""
    low, high = (factor * end for end in entry.interval)
    return " to ".join(format_quantity(end, 0.25 * (high - low))[0] for end in (low, high))


def contribution_remedies(calibration: CalibrationDocument) -> list[dict[str, str]]:
    """Return what reduces the contribution of each cause in the budget, each cause once."""
    record = calibration.uncertainty
    remedies = {} if record is None else {row.cause: row.remedy for row in record.budget}
    return [
        {"cause": cause.replace("_", " "), "remedy": remedy} for cause, remedy in remedies.items()
    ]


def findings_text(calibration: CalibrationDocument) -> str:
    """Return the result of the search for causes, empty where there was none."""
    findings = calibration.findings
    if findings is None:
        return ""
    page_name = findings.file.replace(".yaml", ".html")
    if findings.verdict == "adequate":
        words = "No error of the rig model was found"
    elif findings.causes:
        fitted, in_gain, others = group_causes(calibration)
        named = ". ".join(
            f"{start}: {', '.join(cause.replace('_', ' ') for cause in causes)}"
            for start, causes in (
                ("The fit includes the identified causes", fitted),
                ("The gain, and so the correction, includes the identified causes", in_gain),
                ("Identified causes that are not terms of the fit", others),
            )
            if causes
        )
        remainder = (
            ""
            if findings.verdict == "explained"
            else ". No cause explains the rest of the residual"
        )
        words = f"{named}{remainder}"
    else:
        words = "No known cause explains a part of the residual"
    return f"{words}. The figures are in {page_name}, in the same folder as this file."


def clock_rows(clock: ClockQuality) -> list[tuple[str, str]]:
    """Return the statistics of the board's clock, as names and texts."""
    if clock.latency_max_s < _NO_SECOND_CLOCK_S:
        return [
            (
                "timestamps",
                "the data have one column of times, and no second clock to compare with",
            ),
            ("time base of the scale factor", clock.truth),
        ]
    direction = "faster" if clock.skew_ppm > 0.0 else "slower"
    return [
        (
            "frequency offset",
            f"{format_short(abs(clock.skew_ppm))} ppm {direction} than the capture clock",
        ),
        ("clock-mapping uncertainty", f"{format_short(clock.wander_bound_s * 1e6)} µs"),
        (
            "latency",
            f"median {format_short(clock.latency_median_s * 1e3)} ms, "
            f"maximum {format_short(clock.latency_max_s * 1e3)} ms",
        ),
        ("resets, counter overflows", f"{clock.restarts}, {clock.wraps}"),
        ("time base of the scale factor", clock.truth),
    ]


def level_text(calibration: CalibrationDocument) -> str:
    """Return the unit's leveling from the board's accelerometer; empty if not estimated."""
    level = calibration.quality.level
    return "" if level is None else level_sentence(level)


def recording_rows(calibration: CalibrationDocument) -> list[dict[str, str]]:
    """Return bias and time offset of each recording of a joint solve, row by row."""
    return [
        {
            "name": recording.name,
            "bias": ", ".join(
                _value_with_std(value, std, math.degrees(1.0))
                for value, std in zip(recording.bias, recording.bias_std, strict=True)
            ),
            "time_offset": _value_with_std(recording.time_offset, recording.time_offset_std, 1e3),
        }
        for recording in calibration.quality.recordings or []
    ]


def _value_with_std(value: float | None, std: float | None, factor: float) -> str:
    if value is None:
        return "not observable"
    text, error = format_quantity(factor * value, None if std is None else factor * std)
    return f"{text} ± {error}" if error else text


def matrix_text(calibration: CalibrationDocument) -> str:
    """Return the inverse sensor matrix and the bias, to copy; empty if not known."""
    rows, bias = calibration.matrices.STM, value_std_pairs(calibration.parameters["bias"])
    if any(v is None for row in rows for v in row) or any(v is None for v, _ in bias):
        return ""
    inverse = inverse_gain(calibration)
    lines = ["(S T M)⁻¹ ="]
    lines += ["  [" + ", ".join(f"{v:+.9f}" for v in row) + "]" for row in inverse]
    lines.append("b = [" + ", ".join(f"{v or 0.0:+.9f}" for v, _ in bias) + "] rad/s")
    return "\n".join(lines)


def time_offset_text(calibration: CalibrationDocument) -> str:
    """Return one sentence on the time offset; empty if it was not determined."""
    parameter = calibration.parameters.get("time_offset")
    value = value_std_pairs(parameter)[0][0] if parameter else None
    if value is None:
        return ""
    side = "before" if value >= 0.0 else "after"
    return (
        f"A sample shows the motion {format_short(abs(value) * 1e3)} ms {side} its timestamp: "
        "subtract the time offset from the timestamp."
    )


def _rows(
    calibration: CalibrationDocument, group: ParameterGroup, limits: DataSheetLimits | None
) -> Iterator[ParameterRow]:
    parameter = calibration.parameters[group.name]
    for axis, (label, value, std) in enumerate(shown_entries(parameter, group)):
        name = parameter_label(group.name, label)
        if value is None:
            yield ParameterRow(name)
            continue
        shown, error = value * group.factor, None if std is None else std * group.factor
        text, error_text = format_quantity(shown, error)
        interval = ""
        if error is not None and error > 0.0:
            low, high = (format_quantity(shown + k * 1.96 * error, error)[0] for k in (-1.0, 1.0))
            interval = f"{low} to {high}"
        bar = None if limits is None else _bar(limits, group.unit, axis, shown, error or 0.0)
        yield ParameterRow(name, text, error_text, interval, group.unit, bar)


def _bar(limits: DataSheetLimits, unit: str, axis: int, value: float, std: float) -> RangeBar:
    low, high = limits

    def place(x: float) -> str:
        at = _LEFT + (x - low) / (high - low) * (_RIGHT - _LEFT)
        return f"{min(196.0, max(4.0, at)):.1f}"

    inside = low <= value <= high
    side = "inside" if inside else "outside"
    words = f"{side} the data sheet's {format_short(low)} to {format_short(high)} {unit}"
    colour = _AXIS_COLOURS[axis % 3] if inside else "var(--refused)"
    return RangeBar(
        place(value - 1.96 * std), place(value), place(value + 1.96 * std), colour, words
    )
