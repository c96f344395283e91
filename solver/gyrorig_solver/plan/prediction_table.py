"""Tables of predicted standard uncertainties: total, and the part from noise in parentheses."""

import math
from collections.abc import Sequence

import numpy as np

from gyrorig_solver.data.text_table import format_table
from gyrorig_solver.model import PARAMETER_GROUPS, parameter_label, plural
from gyrorig_solver.plan.prediction import CALIBRATION_PARAMETERS, Prediction
from gyrorig_solver.plan.total_prediction import TotalPrediction


def predictions_table(
    predictions: Sequence[Prediction], totals: Sequence[TotalPrediction], details: bool = False
) -> str:
    """Return the standard uncertainties of programs side by side.

    One program has a column with the largest contribution to each parameter. Without `details`,
    a parameter that no program determines has no row.
    """
    names = (
        f"{p.program.name}, {p.duration_s:.1f} s, {plural(p.move_count, 'move')}"
        for p in predictions
    )
    rows = [["", *names]]
    has_contributions = len(totals) == 1 and bool(totals[0].contributions)
    if has_contributions:
        rows[0].append("largest contribution")
    for group in PARAMETER_GROUPS:
        for label in group.labels:
            name = parameter_label(group.name, label)
            if not details and all(math.isnan(p.std[name]) for p in predictions):
                continue
            unit = "ratio" if group.unit == "1" else group.unit
            cells = (
                _total_and_noise(t.std[name] * group.factor, p.std[name] * group.factor)
                for p, t in zip(predictions, totals, strict=True)
            )
            rows.append([f"{name}, {unit}", *cells])
            if has_contributions:
                rows[-1].append(_contribution_name(predictions[0], totals[0], name))
    if details:
        for column, axis in enumerate(("tilt", "roll", "pan")):
            stds = (float(np.max(p.gain_std[:, column])) for p in predictions)
            label = f"gain, column {'xyz'[column]} ({axis}), ratio"
            rows.append([label, *(_number(std) for std in stds)])
        stds_ms = (p.motion_offset_std_s * 1e3 for p in predictions)
        rows.append(["time_offset from the motion alone, ms", *(_number(s) for s in stds_ms)])
        ranks = (f"{p.observability.rank} of {p.observability.of}" for p in predictions)
        rows.append(["observable parameters", *ranks])
    cells_of_rows = [[*row, *[""] * (len(rows[0]) - len(row))] for row in rows]
    lines = format_table(cells_of_rows, right=range(1, 1 + len(predictions)))
    return "\n".join(f"  {line}" for line in lines)


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


def undetermined_parameters(prediction: Prediction) -> list[str]:
    """Return the parameters without a prediction; a group's name if none of its values has one."""
    names = []
    for group in PARAMETER_GROUPS:
        labels = [parameter_label(group.name, label) for label in group.labels]
        missing = [label for label in labels if math.isnan(prediction.std[label])]
        names += [group.name] if missing == labels else missing
    return names


def _contribution_name(prediction: Prediction, total: TotalPrediction, parameter: str) -> str:
    """Return the cause, or the noise, with the largest contribution; "" if there is no value."""
    noise = prediction.std[parameter]
    if math.isnan(noise):
        return ""
    largest = total.main_contribution(parameter)
    index = CALIBRATION_PARAMETERS.index(parameter)
    return largest.cause if largest.std[index] > noise else "noise"


def _total_and_noise(total: float, noise: float) -> str:
    return f"{_number(total)} ({_number(noise)})" if math.isfinite(noise) else "-"


def _number(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else "-"
