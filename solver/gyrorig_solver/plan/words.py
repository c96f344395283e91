"""A prediction for a person's eye: a table of standard deviations, and what stays hidden."""

import math
from collections.abc import Sequence

import numpy as np

from gyrorig_solver.plan.predict import Prediction

# Name, factor from the calibration's unit to the one shown, and that unit.
GROUPS = (
    ("scale", 1e6, "ppm"),
    ("nonorthogonality", 1e6, "ppm"),
    ("misalignment", 1e6, "urad"),
    ("bias", math.degrees(1.0) * 3600.0, "deg/h"),
)


def table(predictions: Sequence[Prediction]) -> str:
    """Return the standard deviations of programs side by side."""
    rows = [["", *(p.program.name for p in predictions)]]
    rows.append(["duration, s", *(f"{p.duration_s:.1f}" for p in predictions)])
    rows.append(["moves", *(str(p.moves) for p in predictions)])
    for column, axis in enumerate(("tilt", "roll", "pan")):
        label = f"gain, column {'xyz'[column]} ({axis}), ppm"
        rows.append([label, *(_number(_column(p, column) * 1e6) for p in predictions)])
    for group, factor, unit in GROUPS:
        names = [n for n in predictions[0].std if n.startswith(group + ".")]
        for name in names:
            rows.append([f"{name}, {unit}", *(_number(p.std[name] * factor) for p in predictions)])
    rows.append(["time_offset, ms", *(_number(p.std["time_offset"] * 1e3) for p in predictions)])
    rows.append(
        ["  by the motion alone, us", *(_number(p.motion_offset_std_s * 1e6) for p in predictions)]
    )
    rows.append(
        [
            "parameters shown",
            *(f"{p.observability.rank} of {p.observability.of}" for p in predictions),
        ]
    )
    first = max(len(row[0]) for row in rows)
    rest = [max(len(row[k]) for row in rows) for k in range(1, len(rows[0]))]
    return "\n".join(
        "  "
        + row[0].ljust(first)
        + "".join(f"  {cell:>{width}}" for cell, width in zip(row[1:], rest, strict=True))
        for row in rows
    )


def hidden(prediction: Prediction) -> tuple[str, ...]:
    """Return what a program cannot show, each with its remedy."""
    return prediction.observability.reasons


def _column(prediction: Prediction, column: int) -> float:
    """Return the largest standard deviation of a gain's column, nan where one is hidden."""
    return float(np.max(prediction.gain_std[:, column]))


def _number(value: float) -> str:
    if not math.isfinite(value):
        return "-"
    return f"{value:.0f}" if value >= 100.0 else f"{value:.3g}"
