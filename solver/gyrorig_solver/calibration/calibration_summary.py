"""A calibration as a few lines for a terminal."""

from gyrorig_solver.calibration.calibration_document import CalibrationDocument
from gyrorig_solver.calibration.calibration_wording import (
    cause_groups,
    determined_text,
    missing_value_text,
    next_step,
    shown_entries,
    temperature_sentences,
    verdict_sentence,
    white_noise_units,
)
from gyrorig_solver.calibration.uncertainty_wording import contribution_name, main_contribution
from gyrorig_solver.model import (
    DEG_PER_RAD,
    PARAMETER_GROUPS,
    ParameterGroup,
    format_quantity,
    format_short,
    format_two_digits,
    group_of,
    parameter_label,
    plural,
)

CONTRIBUTIONS = 3  # causes that are named


def calibration_summary(calibration: CalibrationDocument) -> str:
    """Return the verdict, the next step, the parameters and the reasons, line by line."""
    board, quality = calibration.board, calibration.quality
    lines = [
        f"{board.id} ({board.sensor}), version {calibration.version}: {calibration.trust.verdict}",
        f"  {verdict_sentence(calibration)}",
        f"  Next: {next_step(calibration)}",
    ]
    for group in (*PARAMETER_GROUPS, *cause_groups(calibration)):
        lines += _rows(calibration, group)
    lines += _contribution_rows(calibration)
    lines += _noise_rows(calibration)
    lines.append(f"  determined            {determined_text(calibration)}")
    if quality.reduced_chi2 is not None:
        lines.append(f"  reduced chi-square    {format_short(quality.reduced_chi2)} (expected 1)")
    if quality.boards_together is not None:
        lines.append(
            f"  solved together       {plural(quality.boards_together, 'board')} on this unit"
        )
    if quality.boards_on_one_clock is not None and quality.clock_moved_s is not None:
        lines.append(
            f"  common time base      {plural(quality.boards_on_one_clock, 'board')} on one bus, "
            f"times changed by {quality.clock_moved_s * 1e6:.1f} us rms"
        )
    if calibration.temperature is not None:
        sentences = temperature_sentences(calibration.temperature)
        labels = ["temperature", *[""] * len(sentences)]
        lines += [f"  {label:<21} {text}" for label, text in zip(labels, sentences, strict=False)]
    lines += _recordings(calibration)
    for reason in calibration.trust.reasons:
        lines.append(f"  ! {reason}")
    lines += [f"  remark: {warning}" for warning in quality.warnings]
    return "\n".join(lines)


def _noise_rows(calibration: CalibrationDocument) -> list[str]:
    """Return the white noise of each axis, as angle random walk and as one-sided density."""
    figure = calibration.noise.get("angle_random_walk")
    if figure is None:
        return []
    return [f"  {name:<21} {axes}  {unit}" for name, axes, unit in white_noise_units(figure.value)]


def _rows(calibration: CalibrationDocument, group: ParameterGroup) -> list[str]:
    parameter = calibration.parameters.get(group.name)
    if parameter is None:
        return []
    rows = []
    unit = "" if group.unit == "1" else group.unit
    for label, value, std in shown_entries(parameter, group):
        label_text = f"  {parameter_label(group.name, label):<21} "
        if value is None:
            rows.append(label_text + missing_value_text(calibration))
            continue
        texts = format_quantity(value * group.factor, None if std is None else std * group.factor)
        row = f"{label_text}{texts[0]:>12} ± {texts[1]:<10} {unit}"
        total = _total_text(calibration, parameter_label(group.name, label), group.factor)
        rows.append(f"{row:<57}{total}".rstrip() if total else row.rstrip())
    return rows


def _total_text(calibration: CalibrationDocument, name: str, factor: float) -> str:
    """Return the total standard uncertainty of a parameter; empty where it is not known."""
    record = calibration.uncertainty
    if record is None or name not in record.parameters:
        return ""
    return f"total ± {format_two_digits(record.parameters[name].total * factor)}"


def _contribution_rows(calibration: CalibrationDocument) -> list[str]:
    """Return the largest contribution to the parameters that are closest to their limits."""
    record = calibration.uncertainty
    if record is None:
        return []
    nearest = sorted(
        record.parameters,
        key=lambda name: -record.parameters[name].total / record.parameters[name].limit,
    )
    rows: dict[str, str] = {}
    for name in nearest:
        row, group = main_contribution(name, record), group_of(name)
        if row is None or group is None or row.cause in rows:
            continue
        unit = "" if group.unit == "1" else f" {group.unit}"
        size = format_two_digits(row.contribution * group.factor)
        rows[row.cause] = (
            f"{name}: {contribution_name(row)} ± {size}{unit}; to reduce it: {row.remedy}"
        )
    labels = ["largest contributions", *[""] * CONTRIBUTIONS]
    return [
        f"  {label:<21} {text}"
        for label, text in zip(labels, list(rows.values())[:CONTRIBUTIONS], strict=False)
    ]


def _recordings(calibration: CalibrationDocument) -> list[str]:
    """Return the bias and time offset of each recording, where several were solved together."""
    lines = []
    for recording in calibration.quality.recordings or []:
        bias = ", ".join(
            "unknown" if bias_rad_s is None else f"{bias_rad_s * DEG_PER_RAD:+.4f}"
            for bias_rad_s in recording.bias
        )
        offset = (
            "not observable"
            if recording.time_offset is None
            else f"{recording.time_offset * 1e3:+.2f} ms"
        )
        lines.append(f"  {recording.name}: bias {bias} deg/s, time offset {offset}")
    return lines
