"""A calibration as a few lines for a terminal."""

import math

from gyrorig_solver.calibration.document import Calibration
from gyrorig_solver.calibration.wording import (
    GROUPS,
    NEXT,
    VERDICTS,
    Group,
    entries,
    nothing_text,
    other_groups,
    quantity,
    short,
)

_DEG = 180.0 / math.pi


def summary(calibration: Calibration) -> str:
    """Return the verdict and what to do next, the parameters and the reasons, line by line."""
    board, quality = calibration.board, calibration.quality
    title, sentence = VERDICTS[calibration.trust.verdict]
    lines = [
        f"{board.id} ({board.sensor}), version {calibration.version}: {title.lower()}",
        f"  {sentence}",
        f"  Next: {NEXT[calibration.trust.verdict]}",
    ]
    for group in (*GROUPS, *other_groups(calibration)):
        lines += _rows(calibration, group)
    seen = calibration.observability
    lines.append(f"  observable            {seen.rank} of {seen.of}")
    if quality.reduced_chi2 is not None:
        lines.append(
            f"  reduced chi2          {short(quality.reduced_chi2)}   (1: nothing but noise)"
        )
    if quality.boards_together is not None:
        lines.append(f"  solved together       {quality.boards_together} boards on this unit")
    if quality.boards_on_one_clock is not None and quality.clock_moved_s is not None:
        lines.append(
            f"  on one clock          {quality.boards_on_one_clock} boards of a bus, "
            f"{quality.clock_moved_s * 1e6:.1f} us moved"
        )
    lines += _recordings(calibration)
    for reason in calibration.trust.reasons:
        lines.append(f"  ! {reason}")
    lines += [f"  remark: {warning}" for warning in quality.warnings]
    return "\n".join(lines)


def _rows(calibration: Calibration, group: Group) -> list[str]:
    parameter = calibration.parameters.get(group.name)
    if parameter is None:
        return []
    rows = []
    for label, (value, std) in zip(group.labels, entries(parameter), strict=True):
        head = f"  {group.name.replace('_', ' ') + ' ' + label:<21} "
        if value is None:
            rows.append(head + nothing_text(calibration))
            continue
        shown = quantity(value * group.factor, None if std is None else std * group.factor)
        rows.append(f"{head}{shown[0]:>12} ± {shown[1]:<10} {group.unit}")
    return rows


def _recordings(calibration: Calibration) -> list[str]:
    """Return what is each recording's own, where several were solved together."""
    lines = []
    for own in calibration.quality.recordings or []:
        bias = ", ".join("unknown" if v is None else f"{v * _DEG:+.4f}" for v in own.bias)
        offset = "not observable" if own.time_offset is None else f"{own.time_offset * 1e3:+.2f} ms"
        lines.append(f"  {own.name}: bias {bias} deg/s, time offset {offset}")
    return lines
