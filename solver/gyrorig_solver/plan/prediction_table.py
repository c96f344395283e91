"""Tables of predicted standard uncertainties: total, and the part from noise in parentheses."""

import math
from collections.abc import Sequence

import numpy as np

from gyrorig_solver.model.parameter_units import PARAMETER_GROUPS, parameter_label
from gyrorig_solver.plan.prediction import Prediction
from gyrorig_solver.plan.total_prediction import TotalPrediction


def predictions_table(
    predictions: Sequence[Prediction], totals: Sequence[TotalPrediction], details: bool = False
) -> str:
    """Return the standard uncertainties of programs side by side.

    Args:
        predictions: from noise.
        totals: of the same programs.
        details: with the gain's columns, from noise.
    """
    rows = [
        ["", *(p.program.name for p in predictions)],
        ["duration, s", *(f"{p.duration_s:.1f}" for p in predictions)],
        ["moves", *(str(p.move_count) for p in predictions)],
    ]
    for group in PARAMETER_GROUPS:
        for label in group.labels:
            name = parameter_label(group.name, label)
            unit = "ratio" if group.unit == "1" else group.unit
            cells = (
                _total_and_noise(t.std[name] * group.factor, p.std[name] * group.factor)
                for p, t in zip(predictions, totals, strict=True)
            )
            rows.append([f"{name}, {unit}", *cells])
    if details:
        for column, axis in enumerate(("tilt", "roll", "pan")):
            stds = (float(np.max(p.gain_std[:, column])) for p in predictions)
            label = f"gain, column {'xyz'[column]} ({axis}), ratio"
            rows.append([label, *(_number(std) for std in stds)])
        stds_ms = (p.motion_offset_std_s * 1e3 for p in predictions)
        rows.append(["time_offset from the motion alone, ms", *(_number(s) for s in stds_ms)])
    ranks = (f"{p.observability.rank} of {p.observability.of}" for p in predictions)
    rows.append(["observable parameters", *ranks])
    first = max(len(row[0]) for row in rows)
    rest = [max(len(row[k]) for row in rows) for k in range(1, len(rows[0]))]
    return "\n".join(
        "  "
        + row[0].ljust(first)
        + "".join(f"  {cell:>{width}}" for cell, width in zip(row[1:], rest, strict=True))
        for row in rows
    )


def contributions_text(total: TotalPrediction) -> str:
    """Return the largest contribution to the worst value of each kind of parameter."""
    names = []
    for group in PARAMETER_GROUPS:
        labels = [parameter_label(group.name, label) for label in group.labels]
        known = [name for name in labels if math.isfinite(total.std[name])]
        if known and total.contributions:
            worst = max(known, key=total.std.__getitem__)
            names.append(f"{worst} {total.main_contribution(worst).cause}")
    return ", ".join(names)


def _total_and_noise(total: float, noise: float) -> str:
    return f"{_number(total)} ({_number(noise)})" if math.isfinite(noise) else "-"


def _number(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else "-"
