"""Key figures of a calibration report: the result in one line, and the tiles at the top.

What to use when: `summary_line` and `summary_tiles` for the page; `inverse_gain` for whatever shows
the sensor matrix applied.
"""

import math
from dataclasses import dataclass

import numpy as np

from gyrorig_solver.calibration import CalibrationDocument
from gyrorig_solver.calibration.calibration_wording import (
    determined_text,
    value_std_pairs,
)
from gyrorig_solver.data import FloatArray
from gyrorig_solver.estimate import FitDiagnostics
from gyrorig_solver.model import format_short, plural
from gyrorig_solver.report.report_data import ReportData

SINGULAR_CONDITION = 1e6  # above it a sensor matrix is not inverted; the paper's method gives some
_REST_RAD_S = 0.01  # a recording with lower rates only is a recording at rest


@dataclass(frozen=True, slots=True)
class Tile:
    """One key figure at the top of the page."""

    name: str
    before: str
    value: str
    note: str


def summary_line(calibration: CalibrationDocument) -> str:
    """Return the result in one line for a reader who does not read the rest."""
    date = calibration.created[:10]
    if calibration.trust.verdict == "refused":
        return f"Calibrated on {date}. Not fit for use."
    low, high = (math.degrees(value) for value in calibration.validity.rate_rad_s)
    sentences = [f"Calibrated on {date}."]
    if is_rate_range(calibration):
        sentences.append(f"Fit for use from {low:.0f} to {high:.0f} deg/s.")
    else:
        sentences.append("The board did not turn, so the calibration contains only values at rest.")
    errors = _scale_errors(calibration)
    if errors is not None:
        sentences.append(
            f"Scale factor error {format_short(errors[0])} % before, "
            f"{format_short(errors[1])} % after (95 %)."
        )
    return " ".join(sentences)


def is_rate_range(calibration: CalibrationDocument) -> bool:
    """Return whether the recordings cover a range of rates, not only rest."""
    return max(abs(value) for value in calibration.validity.rate_rad_s) >= _REST_RAD_S


def summary_tiles(data: ReportData) -> list[Tile]:
    """Return the key figures: scale factor error, angle error, determined parameters."""
    calibration = data.calibration
    result_tiles = []
    errors = _scale_errors(calibration)
    if errors is not None:
        result_tiles.append(
            Tile(
                "scale factor error",
                f"{format_short(errors[0])} %",
                f"±\u00a0{format_short(errors[1])}\u00a0%",
                "worst axis; after: 95 % interval",
            )
        )
    if data.diagnostics is not None and is_rate_range(calibration):
        before, after = _rotation_error_deg(data.diagnostics, inverse_gain(calibration))
        result_tiles.append(
            Tile(
                "angle error after 1 s",
                f"{format_short(before)}°",
                f"{format_short(after)}°",
                "rms over this recording",
            )
        )
    determined, _, addition = determined_text(calibration).partition(", ")
    result_tiles.append(
        Tile("parameters", "", determined, f"determined, {addition}" if addition else "determined")
    )
    chi2 = calibration.quality.reduced_chi2
    if chi2 is not None:
        result_tiles.append(
            Tile("reduced chi-square", "", format_short(chi2), "residual against noise, expected 1")
        )
    rest_to_rest = calibration.quality.rest_to_rest
    if rest_to_rest is not None:
        result_tiles.append(
            Tile(
                "angle check",
                "",
                f"{rest_to_rest.largest_sigma:.1f} u",
                "largest difference from the angles between static intervals "
                f"({plural(rest_to_rest.moves, 'move')})",
            )
        )
    return result_tiles


def inverse_gain(calibration: CalibrationDocument) -> FloatArray:
    """Return G⁻¹, or the identity where G is incomplete or singular; shape (3, 3)."""
    rows = calibration.matrices.STM
    values = [v for row in rows for v in row]
    if any(v is None for v in values):
        return np.eye(3)
    gain = np.array(rows, dtype=np.float64)
    if np.linalg.cond(gain) > SINGULAR_CONDITION:
        return np.eye(3)
    return np.asarray(np.linalg.inv(gain), dtype=np.float64)


def _scale_errors(calibration: CalibrationDocument) -> tuple[float, float] | None:
    """Return the worst axis' scale factor error in %: nominal, and limit of the 95 % interval.

    The interval is that of the total uncertainty where it is stated. Its limit is its end that is
    farther from the value.
    """
    all_pairs = value_std_pairs(calibration.parameters["scale"])
    pairs = [(v, s) for v, s in all_pairs if v is not None]
    if not pairs or any(s is None for _, s in pairs):
        return None
    worst = max(abs(v - 1.0) for v, _ in pairs)
    half_widths = [1.96 * (s or 0.0) for _, s in pairs]
    if calibration.uncertainty is not None:
        entries = calibration.uncertainty.parameters
        half_widths += [
            max(abs(end - value) for end in entries[f"scale.{axis}"].interval)
            for axis, (value, _) in zip("xyz", all_pairs, strict=True)
            if value is not None and f"scale.{axis}" in entries
        ]
    return 100.0 * worst, 100.0 * max(half_widths)


def _rotation_error_deg(data: FitDiagnostics, gain: FloatArray) -> tuple[float, float]:
    """Return the rms error, in degrees, of the rate integrated over 1 s: before and after."""
    window = np.floor(data.time_s - data.time_s[0]).astype(np.int64)
    angles_deg = []
    for error in (data.rate_rad_s - data.reference_rad_s, data.residual_rad_s @ gain.T):
        known = np.isfinite(error).all(axis=1)
        count = np.bincount(window[known])
        whole = count >= 0.9 * np.median(count[count > 0])
        sums = [np.bincount(window[known], column[known])[whole] for column in error.T]
        angles = np.stack(sums) / count[whole]  # mean rate x 1 s
        angles_deg.append(math.degrees(math.sqrt(float(np.mean(np.sum(angles**2, axis=0))))))
    return angles_deg[0], angles_deg[1]
